"""A damaged file anywhere in a drive is refused by lines that name a file of it, or the drive is read and checked."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.recorded.drives.checks import drive_findings
from synth3dlanes.recorded.drives.open import open_drive
from synth3dlanes.recorded.drives.top_view import top_view
from synth3dlanes.system.errors import FormatError, InputError
from tests.drives import road as made
from tests.hostile import damaged, files, refused_or_read

WRITERS = {
    "described": made.write_described,
    "sequence": made.write_sequence,
    "raw": made.write_raw,
    "argoverse": made.write_argoverse,
}


@pytest.fixture(scope="module")
def drives(tmp_path_factory) -> dict[str, Path]:
    short = made.road(4)
    short.world = short.world[::20]
    return {name: write(tmp_path_factory.mktemp(name), short) for name, write in WRITERS.items()}


def parts(root: Path) -> list[Path]:
    """One file of each kind: of many scans and images the first."""
    found = sorted(path for path in root.rglob("*") if path.is_file())
    return list({(path.parent, path.suffix): path for path in reversed(found)}.values())


def read(folder: Path) -> None:
    drive = open_drive(str(folder))
    assert all(np.isfinite(frame.world_from_host).all() for frame in drive.frames)
    assert all("\n" not in line for line in drive_findings(drive))
    top_view(drive)


@pytest.mark.thorough
@files
@given(data=st.data(), name=st.sampled_from(list(WRITERS)))
def test_a_damaged_file_is_refused_or_read(drives, data, name):
    folder = drives[name]
    root = folder.parents[1] if name in ("sequence", "raw") else folder
    path = data.draw(st.sampled_from(parts(root)))
    good = path.read_bytes()
    try:
        path.write_bytes(data.draw(damaged(good)))
        refused_or_read(lambda: read(folder), str(root), "monday", "frames", error=(FormatError, InputError))
    finally:
        path.write_bytes(good)
