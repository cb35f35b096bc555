"""`verify` finds every fault of tests/formats/faults.py in every format, and says in which file, of which lane, how
far."""

import re
import shutil

import pytest

from synth3dlanes.formats.format import format_names
from synth3dlanes.formats.plan import open_reader
from tests.formats.faults import FAULTS, PLANTED
from tests.formats.planting import problems
from tests.thorough import first

# Each format meets one of the faults, and each fault two of the formats; `make check` has all.
ALL = [(name, fault) for name in sorted(PLANTED) for fault in FAULTS]
QUICK = {(name, FAULTS[number % len(FAULTS)]) for number, name in enumerate(sorted(PLANTED))}


def test_every_format_is_here_but_that_without_lanes():
    assert set(format_names()) - set(PLANTED) == {"cosmos", "kitti"}, "each needs a row in faults.py"


@pytest.mark.parametrize(("name", "fault"), first(len(QUICK), sorted(ALL, key=lambda case: case not in QUICK)))
def test_a_planted_fault_is_told_with_its_file_its_lane_and_how_far(name, fault, export_of, two_frames, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(export_of(name).out, out, symlinks=True)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    PLANTED[name](out, fault)
    changed = [path.name for path, data in before.items() if path.read_bytes() != data]
    assert changed
    found = problems(two_frames, out, name)
    lanes = {lane.id for i in range(2) for lane in open_reader(f"{two_frames}/test").labels(i).lanes}
    lanes |= {segment.id for segment in open_reader(f"{two_frames}/test").labels(0).graph.segments}
    told = [
        problem
        for problem in found
        if any(lane in problem for lane in lanes)
        and re.search(r"\d(\.\d+)? (m|px)\b", problem)
        and any(file.split(".")[0] in problem or "00000000" in problem for file in changed)
    ]
    assert told, found
