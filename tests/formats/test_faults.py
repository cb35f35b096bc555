"""`verify` finds every fault of tests/formats/faults.py in every format, and says in which file, of which lane, how
far."""

import re
import shutil

import pytest

from synth3dlanes.formats.export import Export
from synth3dlanes.formats.format import format_names
from synth3dlanes.formats.plan import open_reader
from tests.formats.faults import FAULTS, PLANTED
from tests.formats.planting import problems
from tests.formats.test_segmentation import passes_of
from tests.thorough import first


@pytest.fixture(scope="module")
def two_frames(tmp_path_factory, write_split):
    root = tmp_path_factory.mktemp("two_frames")
    # Neither the road nor the camera's place on it is symmetric.
    write_split(root, "test", 2, ["road.topology=1", "road.n_lanes=3", "camera.width_px=480"], passes_of)
    return root


# Each format meets one of the faults, and each fault two of the formats; `make check` has all.
ALL = [(name, fault) for name in sorted(PLANTED) for fault in FAULTS]
QUICK = {(name, FAULTS[number % len(FAULTS)]) for number, name in enumerate(sorted(PLANTED))}


@pytest.fixture(scope="module", params=sorted(PLANTED))
def exported(request, two_frames, tmp_path_factory):
    job = Export(str(two_frames), tmp_path_factory.mktemp("faults") / request.param, request.param)
    job.write()
    assert not problems(two_frames, job.out, request.param)
    return job


def test_every_format_is_here_but_that_without_lanes():
    assert set(format_names()) - set(PLANTED) == {"cosmos", "kitti"}, "each needs a row in faults.py"


@pytest.mark.parametrize(
    ("exported", "fault"),
    first(len(QUICK), sorted(ALL, key=lambda case: case not in QUICK)),
    indirect=["exported"],
)
def test_a_planted_fault_is_told_with_its_file_its_lane_and_how_far(exported, fault, two_frames, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(exported.out, out, symlinks=True)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    PLANTED[exported.format_name](out, fault)
    changed = [path.name for path, data in before.items() if path.read_bytes() != data]
    assert changed
    found = problems(two_frames, out, exported.format_name)
    lanes = {lane.id for i in range(2) for lane in open_reader(f"{two_frames}/test").labels(i).lanes}
    lanes |= {segment.id for segment in open_reader(f"{two_frames}/test").labels(0).graph.segments}
    told = [
        problem
        for problem in found
        if any(lane in problem for lane in lanes)
        and re.search(r"\d(\.\d+)? (m|px)\b", problem)
        and any(name.split(".")[0] in problem or "00000000" in problem for name in changed)
    ]
    assert told, found
