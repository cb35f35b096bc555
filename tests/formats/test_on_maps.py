"""Scenes on maps go out in every format, and what is wrong in them is found as on other roads."""

import re
from pathlib import Path

import pytest

from synth3dlanes.draw.sample import Scenes
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.format import format_names
from synth3dlanes.formats.verify import verify
from synth3dlanes.params.params import load_params
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene.settings import RenderSettings
from tests import fake_samples
from tests.thorough import first

TOWN = (
    *("town.junction={crossing: 1, roundabout: 1}", "town.host_place=before", "town.host_m=15", "town.n_more=0"),
    *(
        "town.traffic=0.2",
        "town.parked=0.8",
        "town.parking=true",
        "town.fronts=0",
        "trees.n=0",
        "camera.horizontal_fov_deg=60",
    ),
)
# These need rendered pictures: passes, or which cars are seen.
OF_PICTURES = {"coco", "cosmos", "kitti", "masks", "yolo"}
SLOW = ["argoverse2", "nuscenes", "openlane_v2"]
QUICK = sorted({*format_names()} - OF_PICTURES - {*SLOW})


@pytest.fixture(scope="module")
def towns(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labelled scenes of a town without pictures of it."""
    root = tmp_path_factory.mktemp("towns") / "data"
    recipe = Recipe(Scenes(load_params("town", TOWN), 3, "train"), RenderSettings(), "jpg")
    generate(Plan(str(root), 3, recipe, workers=1, maker=fake_samples.make_labelled), lambda event: None)
    return root


def problems(root: Path, out: Path, name: str) -> list[str]:
    return [problem for result in verify(Export(str(root), out, name), 9) for problem in result.problems]


@pytest.mark.parametrize("name", first(len(QUICK), [*QUICK, *SLOW]))
def test_an_export_is_as_in_the_labels(towns: Path, tmp_path: Path, name: str) -> None:
    out = tmp_path / name
    summary = Export(str(towns), out, name).write()
    assert sum(summary.n_frames.values()) > 0
    assert problems(towns, out, name) == []


def test_a_lane_moved_aside_and_a_lost_link_are_found(towns: Path, tmp_path: Path) -> None:
    out = tmp_path / "opendrive"
    Export(str(towns), out, "opendrive").write()
    path = next(out.glob("*/*.xodr"))
    text = path.read_text()
    for pattern, replacement, expected in (
        (r'(<laneOffset s="0" a=")[^"]*', r"\g<1>0.4", "within 0.15 m of the labels"),
        (r'(<lane id="-1".*?<successor id=")[^"]*', r"\g<1>-9", "expected its successor to be there"),
    ):
        path.write_text(re.sub(pattern, replacement, text, flags=re.DOTALL))
        found = problems(towns, out, "opendrive")
        assert any(expected in problem for problem in found), (pattern, found[:3])
