"""Scenes of `streets` hold what they promise: validate finds nothing in their renders, and finds ids that are moved."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.dataset.format import read_passes, write_passes
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.params.params import load_params
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene.instance_ids import numbers_of
from synth3dlanes.scene.scene import from_json
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from tests.validate.sealing import Members, check, read_members, seal

pytestmark = [pytest.mark.render, pytest.mark.thorough]
N = 4


@pytest.fixture(scope="module")
def streets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("streets") / "data"
    settings = RenderSettings(samples=2, passes=("depth", "normal", "semantic", "instance"))
    # Something of every kind: not every scene has it.
    changes = ["road.n_oncoming=2", "road.median_m=4", "roadside.median=guardrail", "symbols.arrow_rows=2"]
    recipe = Recipe(Scenes(load_params("streets", [*changes, "weather.daytime=day"]), 2026, "train"), settings, "jpg")
    assert generate(Plan(root, N, recipe, workers=1), lambda event: None).exit_code == 0
    return root


def test_validate_finds_nothing(streets):
    assert check(streets).problems == []
    scenes = [from_json(members["scene.json"], "") for members in read_members(streets).values()]
    assert all(scene.road.n_oncoming == 2 and scene.symbols and scene.roadside.rails for scene in scenes)
    assert any(car.lane.startswith("oncoming") for scene in scenes for car in scene.cars)


def test_ids_of_structures_and_symbols_are_in_the_passes(streets):
    seen = set()
    for members in read_members(streets).values():
        passes = read_passes(members["passes.exr"], "")
        kinds = {
            "structure": numbers_of("structure", passes["instance"]) >= 0,
            "symbol": passes["semantic"] == SEMANTIC_IDS["symbol"],
            "barrier": passes["semantic"] == SEMANTIC_IDS["barrier"],
        }
        seen |= {kind for kind, pixels in kinds.items() if pixels.any()}
    assert seen == {"structure", "symbol", "barrier"}


def test_structures_of_other_ids_are_found(streets, tmp_path):
    """All pixels of structures carry the id of the next one."""
    root = Path(shutil.copytree(streets, tmp_path / "data"))

    def change(samples: dict[int, Members]) -> None:
        for members in samples.values():
            passes = read_passes(members["passes.exr"], "")
            ids = passes["instance"].astype(int)
            is_structure = numbers_of("structure", ids) >= 0
            passes["instance"] = np.where(is_structure, ids + 1, ids).astype(np.uint16)
            members["passes.exr"] = write_passes(passes)

    seal(root, change)
    problems = check(root).problems
    assert any("pixels of structure" in problem.reason for problem in problems), problems
