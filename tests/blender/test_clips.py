"""Pictures of one scene: the build is shared, the bytes do not tell, and killed runs go on to the same bytes."""

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from synth3dlanes.blender import render as renderer
from synth3dlanes.dataset.format import decode_image, read_passes
from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw import sample
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots, clips
from synth3dlanes.production.recipe import Recipe, make_sample
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS

pytestmark = pytest.mark.render

PASSES = ("depth", "semantic", "instance")
STREET = (
    "trees.n=30", "cars.n=4", "vegetation.grass_m=0.2", "symbols.arrow_rows=1", "surface.tar=0.5",
    "host.bonnet=0.1",
)  # fmt: skip
RECIPE = Recipe(
    Scenes(load_params("tiny", [*STREET, "roadside.outer=guardrail", "sensor.noise=3"]), 5, "train", shots=clips(3, 4)),
    RenderSettings(1, PASSES, "cpu"),
    "png",
)


def forget():
    """As in a process that has made nothing yet, but for the assets."""
    sample._latest.cache_clear()
    renderer.studio().ground = None


@pytest.mark.thorough
def test_scenes_of_all_weathers_in_any_order_give_the_bytes_of_each_alone():
    """What a studio keeps (materials, lamps, sky, names of objects) must not show in the next scene."""
    weathers = (
        ["light.sun_zenith_deg=40", "markings.wear=0.5", "host.bonnet=0"],
        ["light.sun_zenith_deg=100", "weather.headlights=true", "weather.rain=0.8", "surface.wetness=0.9"],
        ["weather.snow=0.8", "weather.snowfall=0.5", "weather.snow_on_road=0.4", "vegetation.grass_m=0"],
    )
    recipes = [
        replace(RECIPE, scenes=Scenes(load_params("tiny", [*STREET, *changes]), 7 + i, "train"))
        for i, changes in enumerate(weathers)
    ]
    alone = []
    for recipe in recipes:
        renderer.opened.cache_clear()
        alone.append(make_sample(recipe, 0).members)
    assert len({members["png"] for members in alone}) == 3
    for i in (1, 0, 2, 1, 2, 0):
        assert make_sample(recipes[i], 0).members == alone[i], i


@pytest.mark.thorough
def test_two_cameras_and_two_frames_in_any_order_give_the_bytes_of_each_alone(tmp_path):
    """What stands still is shared; what one camera or frame sees must not show in another's."""
    (tmp_path / "rig.yaml").write_text(
        "front: {width_px: 64, height_px: 48, fx: 60}\n"
        "left: {width_px: 48, height_px: 40, fx: 30, yaw_deg: 70, right_m: -0.8, roll_deg: 3}\n"
    )
    shots = Shots(frames=2, fps=4.0, cameras=load_rig(str(tmp_path / "rig.yaml")))
    recipe = replace(RECIPE, scenes=replace(RECIPE.scenes, shots=shots))
    alone = []
    for index in range(4):
        forget()
        alone.append(make_sample(recipe, index).members)
    assert len({members["png"] for members in alone}) == 4
    forget()
    for index in (0, 3, 1, 2):
        assert make_sample(recipe, index).members == alone[index], index


def test_objects_of_the_ground_stay_and_others_are_those_of_the_frame():
    forget()
    counts, kept = [], []
    for index in (3, 4, 3):
        make_sample(RECIPE, index)
        names = {name: list(bpy.data.collections[name].objects) for name in ("ground", "structures")}
        counts.append((len(bpy.data.objects), len(bpy.data.meshes)))
        kept.append([item.data.as_pointer() for name in ("ground", "structures") for item in names[name]])
    assert len(set(counts)) == 1
    assert kept[0] == kept[1] == kept[2]
    scene, cars = RECIPE.scene(3), bpy.data.collections["objects"].objects
    poses = RECIPE.world(3).view.world_from_cars
    assert len(cars) == len(scene.cars) == 4
    for item, pose in zip(cars, poses, strict=True):
        assert np.allclose(np.array(item.matrix_world)[:3, 3], pose[:3, 3], atol=1e-4)


def test_what_moves_and_what_stays_in_the_pixels():
    """The road before a camera that moves is another one, the bonnet is the same."""
    members = [make_sample(RECIPE, index).members for index in (0, 2)]
    pictures = [
        (decode_image(at["png"], "png").astype(float), read_passes(at["passes.exr"], "exr")["semantic"])
        for at in members
    ]
    hood = [semantic == SEMANTIC_IDS["host"] for _, semantic in pictures]
    assert (hood[0] == hood[1]).all()
    assert hood[0].any()
    assert np.abs(pictures[0][0] - pictures[1][0])[~hood[0]].mean() > 1


RUN = [sys.executable, "-m", "synth3dlanes", "generate", "--n", "8", "--frames", "3", "--fps", "4", "--params", "tiny"]


def run(out: Path, workers: int) -> list[str]:
    return [*RUN, "--seed", "5", "--samples", "1", "--device", "cpu", "--workers", str(workers), "--out", str(out)]


@pytest.mark.thorough
def test_killed_clips_resume_with_equal_bytes(tmp_path):
    subprocess.run(run(tmp_path / "whole", 1), check=True, capture_output=True, timeout=280)
    process = subprocess.Popen(run(tmp_path / "killed", 1), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    parts = tmp_path / "killed/train/00000.parts"
    until = time.monotonic() + 200
    while len(list(parts.glob("0*.tar"))) < 2 and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    process.kill()
    process.wait()
    made = {path.name for path in parts.glob("0*.tar")}
    assert 2 <= len(made) < 8, "the run was killed within a clip"
    subprocess.run(run(tmp_path / "killed", 2), check=True, capture_output=True, timeout=280)
    for name in ("00000.tar", "00000.parquet"):
        assert (tmp_path / "killed/train" / name).read_bytes() == (tmp_path / "whole/train" / name).read_bytes()
    reader = Reader(f"{tmp_path}/killed/train")
    assert [len(reader.clip(scene)) for scene in reader.scenes] == [3, 3, 2]
