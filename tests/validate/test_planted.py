"""The table of docs/validate_measured.md in small: each planted fault is found and named, clean data sets are clean."""

import re
import shutil
from pathlib import Path

import pytest

from synth3dlanes.params.params import load_params
from tests.validate import planted
from tests.validate.examining import evidence_of, reasons
from tests.validate.faults import FAULTS
from tests.validate.sealing import check, describe, read_members, seal

pytestmark = [pytest.mark.render, pytest.mark.timeout(900)]

# Samples for other worlds and for what needs several; one is enough for all else.
N, SEED = 4, 20
STREETS_N, STREETS_SEED = 3, 7
# Small images from near a junction: merges show the exit's paint, splits its ramp.
CHANGES = ["camera.width_px=320", "camera.height_px=240", "camera.y_m=[-36, -28]", "cars.n=8", "trees.n=25"]
CHANGES += ["road.topology=[2, 4]", "road.exit_angle_deg=[3, 5]", "road.exit_offset_m=[5, 10]"]
CHANGES += ["road.shoulder_factor=0.2", "road.ramp_slope=[4, 4.5]", "markings.grayscale=0.9", "markings.width_m=0.15"]
CHANGES += ["terrain.magnitude_m=[-20, 20]", "terrain.sd_m=[80, 250]"]
# One for each check that finds one of them in a sample, but for those that test_pixels.py and test_origin.py have.
ONE_OF_EACH = {
    "labels": "n_lanes edited in the scene",
    "bonnet": "bonnet missing",
    "lidar": "rear half of the sweep three columns on",
    "points": "object_visible moved by a point",
    "height": "height map 3 cm up",
    "pavement": "depth 1 cm too long",
    "ids": "barriers and kerbs swapped",
    "cars": "car_visible_fraction + 0.08",
    "appearance": "white lines yellow",
    "sky": "a hole in the ground",
}
NEED_SOME = ("world:", "height map one row", "rows of the index")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple:
    """The clean data set, and the faults to plant in it."""
    folder = tmp_path_factory.mktemp("planted")
    return planted.render(folder, load_params("appendix_i", CHANGES), SEED, N, workers=1)


@pytest.fixture
def small_streets(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STREETS", "WORKS"):
        small = [*getattr(planted, name), "camera.width_px=320", "camera.height_px=240"]
        monkeypatch.setattr(planted, name, small)


def first(clean: Path, n: int, to: Path) -> Path:
    """The first samples of a data set."""
    root = Path(shutil.copytree(clean, to))
    seal(root, lambda samples: [samples.pop(index) for index in range(n, N)] and None)
    describe(root, lambda document: document.update(splits={"train": {"n": n}}))
    return root


def test_a_fault_of_each_kind_is_found_and_named(small_streets, tmp_path):
    """By its check alone; all checks are asked in the thorough tests."""
    clean, of_streets = planted.render_streets(tmp_path, STREETS_SEED, 1, 1)
    assert check(clean).problems == []
    (whole,) = read_members(clean).values()
    faults = {fault.name: fault for fault in (*FAULTS, *of_streets)}
    for check_name, planted_one in ONE_OF_EACH.items():
        fault, members = faults[planted_one], dict(whole)
        fault.spoil(members)
        assert re.search(fault.words, reasons(evidence_of(members), check_name)), fault.name


@pytest.mark.thorough
def test_every_planted_fault_is_found_and_named(rendered, tmp_path):
    clean, faults = rendered
    some = [fault for fault in faults if fault.name.startswith(NEED_SOME)]
    in_one = [fault for fault in faults if fault not in some]
    results = [*planted.table(clean, some, tmp_path), *planted.table(first(clean, 1, tmp_path / "1"), in_one, tmp_path)]
    assert len(results) == len(faults)
    assert missed(results) == []


def missed(results: list) -> list[str]:
    """The rows of faults that are not found."""
    return [result.row() for result in results if not result.is_found]


@pytest.mark.thorough
@pytest.mark.parametrize("render", [planted.render_streets, planted.render_works])
def test_every_fault_of_what_streets_and_works_have_is_found_and_named(small_streets, tmp_path, render):
    clean, faults = render(tmp_path, STREETS_SEED, STREETS_N, 1)
    assert missed(list(planted.table(clean, faults, tmp_path))) == []
