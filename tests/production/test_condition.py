"""`generate --where`: each sample shows the first of its scenes that fits, whoever makes it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Condition, Recipe, fitting_world
from synth3dlanes.production.run import generate
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.origin import read_origin
from tests import fake_samples

FEW = ("cars.n=1", "trees.n=4")
QUERY = "max_grade > 0.05 and junction = 'merge'"
OF_ONE = 100_000


def recipe(query: str | None = QUERY, frames: int = 1, tries: int = 100) -> Recipe:
    motion = () if frames == 1 else ("motion.host_speed_m_s=10",)
    scenes = Scenes(load_params("tiny", [*FEW, *motion]), 5, "train", shots=clips(frames, 5.0))
    condition = Condition(query, tries) if query else None
    return Recipe(scenes, RenderSettings(), "png", where=condition)


def is_steep_merge(scene: Scene) -> bool:
    """The same condition from the scene and the points of its labels, without the index."""
    labels = ground_truth(scene)
    up_cam = labels.camera.world_from_cam[2, :3]
    grades = [0.0]
    for lane in labels.lanes:
        if lane.kind == "centerline" and lane.road == "main":
            steps = np.diff(lane.xyz_cam, axis=0)
            rises = steps @ up_cam
            grades.append(np.abs(rises / np.sqrt((steps**2).sum(axis=1) - rises**2)).max())
    assert scene.road is not None
    return scene.road.topology > 1 and scene.road.flip_lateral and max(grades) > 0.05


def test_a_sample_shows_the_first_of_its_scenes_that_fits() -> None:
    """And no other: all scenes before it are drawn here, and judged without the index."""
    made = recipe()
    for n in range(3):
        shown = made.scene(n)
        tried = (sample_scene(made.scenes, number) for number in range(n * OF_ONE, n * OF_ONE + 100))
        first = next(scene for scene in tried if is_steep_merge(scene))
        assert shown == first
        assert first.index // OF_ONE == n
    assert any(made.scene(n).index % OF_ONE for n in range(3)), "not only first scenes fit"


def test_all_frames_of_a_clip_show_the_scene_that_its_first_one_fits() -> None:
    made = recipe(frames=3)
    scenes = [made.scene(index) for index in range(3, 6)]
    assert {scene.index for scene in scenes} == {fitting_world(made.scenes, made.where, 1).scene.index}  # type: ignore[arg-type]
    assert [scene.shot.frame for scene in scenes] == [0, 1, 2]
    assert is_steep_merge(scenes[0])


@pytest.mark.thorough
def test_a_set_is_the_same_for_other_workers_and_after_a_stop(tmp_path: Path) -> None:
    plan = Plan(tmp_path / "whole", 5, recipe(), 1, maker=fake_samples.make_labelled)
    generate(plan, lambda event: None)
    for n in (2, 5):
        generate(replace(plan, out=tmp_path / "more", n=n, workers=2), lambda event: None)
    whole, more = ((tmp_path / name / "train/00000.tar").read_bytes() for name in ("whole", "more"))
    assert whole == more
    description = json.loads((tmp_path / "whole/dataset.json").read_text())
    assert description["where"] == QUERY
    reader = Reader(tmp_path / "whole/train")
    assert reader.index["junction"].to_pylist() == ["merge"] * 5
    assert min(reader.index["max_grade"].to_pylist()) > 0.05
    with pytest.raises(InputError, match="where"):
        generate(replace(plan, recipe=recipe(None)), lambda event: None)


def test_the_scene_of_a_sample_is_checked_against_the_condition() -> None:
    made = recipe()
    origin = read_origin(json.loads(json.dumps(made.description())))
    shown = [made.scene(n) for n in range(2)]
    assert [origin.fault(scene, "train", n) for n, scene in enumerate(shown)] == ["", ""]
    assert "index: expected one of the scenes of sample 0, got " in origin.fault(shown[1], "train", 0)
    unfit = next(
        scene for scene in (sample_scene(made.scenes, number) for number in range(100)) if not is_steep_merge(scene)
    )
    assert f"expected a scene where {QUERY}, got another" in origin.fault(unfit, "train", 0)
    edited = shown[0].model_copy(update={"air": shown[0].air.model_copy(update={"overcast": 0.5})})
    assert "overcast" in origin.fault(edited, "train", 0)


def test_the_share_that_fits_is_said(in_tmp_path: Path) -> None:
    command = ["generate", "--n", "2", "--params", "tiny", "--out", "d", "--device", "cpu", "--dry-run"]
    scenes = Scenes(load_params("tiny"), 0, "train")
    n_lanes = [sample_scene(scenes, number).paper_road.n_lanes for number in range(30)]
    told = CliRunner().invoke(main, [*command, "--where", "n_lanes = 3"]).stdout
    assert f"where n_lanes = 3 ({n_lanes.count(3)} of the first 30 scenes drawn fit)" in told
