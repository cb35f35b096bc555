"""A disk that fills up in the middle of a file, for exports."""

import pytest
from click.testing import CliRunner

from synth3dlanes.formats.format import format_names
from tests.formats.test_segmentation import passes_of
from tests.small_files import withstands
from tests.thorough import first

FIRST = ("tusimple", "masks")


@pytest.fixture(scope="module")
def small(tmp_path_factory, write_split):
    root = tmp_path_factory.mktemp("small")
    write_split(root, "test", 2, ["road.topology=1", "camera.width_px=480"], passes_of)
    return root


# Cosmos has clips: its writer is that of the others.
@pytest.mark.parametrize(
    "format_name", first(2, sorted({*format_names()} - {"cosmos"}, key=lambda name: (name not in FIRST, name)))
)
def test_a_full_disk(small, tmp_path, format_name):
    from synth3dlanes_cli.main import main

    words = ["export", str(small), "--format", format_name, "--out", str(tmp_path / "out")]
    (tmp_path / "out").mkdir()
    withstands(lambda: CliRunner().invoke(main, words), tmp_path / "out")
