"""Samples made again: clean ones are equal, also to those of another machine; faults are told with their layer."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import CliRunner

from synth3dlanes.draw.sample import Scenes
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import Params, load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import SINGLE, Shots
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe, make_sample
from synth3dlanes.production.run import generate
from synth3dlanes.production.workers import Limits, call
from synth3dlanes.scene.change import change_scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError, MissingPackageError
from synth3dlanes.validate.made_again import compare, some_of
from synth3dlanes.validate.run import validate
from synth3dlanes.world.world import World, resolve
from tests import warm
from tests.validate.faults import FAULTS, MORE_AGAIN, OF_STREETS, UNSEEN
from tests.validate.redone import WORLDS, other_rounding, picture_of
from tests.validate.sealing import Members, describe, read_members, seal

pytestmark = [pytest.mark.render, pytest.mark.timeout(900)]

PASSES = ("depth", "normal", "semantic", "instance", "height")
# Something of every kind, near enough to be seen.
CHANGES = ["camera.width_px=320", "camera.height_px=180", "road.n_oncoming=2", "road.median_m=4", "cars.n=20"]
CHANGES += ["roadside.median=guardrail", "symbols.arrow_rows=2", "weather.daytime=day", "weather.kind=clear"]
CHANGES += ["roadside.n_signs=8", "roadside.n_houses=8", "markings.missing=0", "markings.left_yellow=true"]
SEED = 2026
AGAIN = {fault.name: fault for fault in (*FAULTS, *OF_STREETS, *UNSEEN, *MORE_AGAIN) if fault.again}
# Where arrows are 11 m ahead: at 30 m they are 3 px high, which tells no kind.
NEAR_ARROWS = ("camera.y_m=-8",)


@dataclass(frozen=True)
class Changed(Recipe):
    """Sample 0 in other worlds: sample i has the changes i."""

    changes: tuple[tuple[str, ...], ...] = ()

    def world(self, index: int) -> World:
        return resolve(change_scene(super().world(0).scene, self.changes[index]))


def made(root: Path, recipe: Recipe, n: int) -> Path:
    assert generate(Plan(root, n, recipe, workers=1), lambda event: None).exit_code == 0
    return root


def streets() -> Params:
    return load_params("streets", CHANGES)


def tiny(shots: Shots, passes: tuple[str, ...]) -> Recipe:
    return Recipe(Scenes(load_params("tiny"), 3, "train", shots=shots), RenderSettings(2, passes), "jpg")


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sample of `streets`."""
    recipe = Recipe(Scenes(streets(), SEED, "train"), RenderSettings(4, PASSES), "jpg")
    return made(tmp_path_factory.mktemp("rerender") / "streets", recipe, 1)


@pytest.fixture(scope="module")
def lidar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Samples of `tiny` with a lidar."""
    shots = SINGLE.model_copy(update={"lidar": load_lidar("hdl_32e")})
    recipe = tiny(shots, ("depth", "semantic", "instance", "height", "lidar"))
    return made(tmp_path_factory.mktemp("rerender") / "lidar", recipe, 2)


@pytest.fixture(scope="module")
def elsewhere() -> Members:
    """The sample of `clean` with another noise of rendering, as of another machine."""
    recipe = Recipe(Scenes(streets(), SEED, "train"), RenderSettings(4, PASSES), "jpg")
    # What it does to Blender must not meet other tests.
    warm.use(is_warm=False)
    members: Members = call(Limits(), _with_other_noise, recipe, pinned=True).result("other noise")
    return members


def _with_other_noise(recipe: Recipe) -> Members:
    import bpy

    from synth3dlanes.blender import render

    configure = render.configure

    def with_seed(settings: RenderSettings, film: float) -> None:
        configure(settings, film)
        bpy.context.scene.cycles.seed = 1

    render.configure = with_seed
    return make_sample(recipe, 0).members


def rerender(root: Path, n: int) -> tuple[list[str], dict[str, str]]:
    report = validate(root, 1, None, lambda done, total: None, rerender=n)
    return [problem.line() for problem in report.problems if "made again" in problem.reason], report.made_again


@pytest.mark.thorough
def test_samples_made_again_are_equal_bytes(clean, lidar):
    for root, n in ((clean, 1), (lidar, 2)):
        faults, verdicts = rerender(root, n)
        assert not faults
        assert set(verdicts.values()) == {"equal bytes"}
        assert len(verdicts) == n


@pytest.mark.thorough
@pytest.mark.parametrize("passes", [(), ("height",)])
def test_frames_of_clips_by_a_rig_are_equal_bytes(tmp_path, passes):
    """Also without the passes that say what pixels show, which are then made beside."""
    (tmp_path / "rig.yaml").write_text(
        "front: {width_px: 64, height_px: 48, fx: 60}\nleft: {width_px: 48, height_px: 48, fx: 30, yaw_deg: 90}\n"
    )
    recipe = tiny(Shots(frames=2, fps=10.0, cameras=load_rig(str(tmp_path / "rig.yaml"))), passes)
    faults, verdicts = rerender(made(tmp_path / "clips", recipe, 8), 3)
    assert not faults
    assert list(verdicts.values()) == ["equal bytes"] * 3


@pytest.mark.thorough
@pytest.mark.parametrize("name", AGAIN)
def test_a_fault_is_found_and_its_layer_named(clean, lidar, elsewhere, name):
    fault = AGAIN[name]
    is_of_sweep = fault.again.startswith("lidar")
    before = read_members(lidar if is_of_sweep else clean)[0]
    found = dict(before)
    fault.spoil(found)
    assert found != before
    for again in (before,) if is_of_sweep else (before, elsewhere):
        faults = list(compare(picture_of(again), again, found))
        assert any(re.search(fault.again, line) for line in faults), faults


@pytest.mark.thorough
def test_another_machine_raises_no_alarm(clean, elsewhere):
    before = read_members(clean)[0]
    assert before["jpg"] != elsewhere["jpg"]
    assert not list(compare(picture_of(elsewhere), elsewhere, before))
    found = dict(before)
    other_rounding(found)
    assert all(found[name] != before[name] for name in ("passes.exr", "height.exr", "labels.json"))
    assert not list(compare(picture_of(before), before, found))


@pytest.mark.thorough
def test_a_picture_of_another_scene_is_found(clean, elsewhere, tmp_path):
    before = read_members(clean)[0]
    recipe = Recipe(Scenes(streets(), SEED, "train"), RenderSettings(4, PASSES), "jpg")
    scene = recipe.scene(0)
    worlds = {name: tuple(changes(scene)) for name, changes in WORLDS.items()}
    assert all(worlds.values())
    worlds["arrows elsewhere"] = NEAR_ARROWS + worlds["arrows elsewhere"]
    changed = (*worlds.values(), NEAR_ARROWS)
    others = Changed(recipe.scenes, recipe.settings, recipe.image_format, changes=changed)
    *rendered, near = read_members(made(tmp_path / "worlds", others, len(changed))).values()
    for name, other in zip(worlds, rendered, strict=True):
        made_again = (near,) if name == "arrows elsewhere" else (before, elsewhere)
        for again in made_again:
            beside = {**other, "scene.json": again["scene.json"], "labels.json": again["labels.json"]}
            assert list(compare(picture_of(again), again, beside)), name


def test_the_command_names_the_sample_and_the_layer(lidar, tmp_path):
    from synth3dlanes_cli.main import main

    root = Path(shutil.copytree(lidar, tmp_path / "data"))
    seal(root, lambda samples: AGAIN["image 20 % darker"].spoil(samples[1]))
    result = CliRunner().invoke(main, ["validate", str(root), "--rerender", "2", "--workers", "1"])
    assert result.exit_code == 1, result.exception
    assert re.search(
        r"train:00000001: made again: image: \d+ of \d+ pixels differ \(u 0-\d+, v 0-\d+; [\d.]+ levels", result.stdout
    )
    assert "equal bytes: train:00000000\n" in result.stdout
    assert "not equal: train:00000001\n" in result.stdout


def test_the_choice_is_repeated_and_grows():
    some = [some_of(list(range(100)), n, seed=5) for n in (4, 4, 8, 200)]
    assert some[0] == some[1]
    assert set(some[0]) < set(some[2])
    assert some[3] == list(range(100))
    assert some_of(list(range(100)), 4, seed=6) != some[0]


def test_what_cannot_be_made_again_is_refused_in_a_line(lidar, tmp_path, monkeypatch):
    from synth3dlanes_cli.main import main

    root = Path(shutil.copytree(lidar, tmp_path / "data"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match="bpy is not installed"):
        validate(root, 1, None, lambda done, total: None, rerender=1)
    monkeypatch.undo()
    describe(root, lambda document: document["assets"].update(skies={"dawn": _sky()}))
    with pytest.raises(InputError, match=r"skies: expected 'dawn' with digest abc.* got the built-in ones"):
        validate(root, 1, None, lambda done, total: None, rerender=1)
    describe(root, lambda document: document.update(generator="0.2.0"))
    result = CliRunner().invoke(main, ["validate", str(root), "--rerender", "1"])
    assert result.exit_code == 2
    assert "made by version 0.2.0" in result.output


def _sky() -> dict[str, object]:
    return {"name": "dawn", "sun_azimuth_rad": 0.0, "sha256": "abc"}
