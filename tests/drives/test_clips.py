"""Our own clips as drives, and the commands on them."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.format import Picture, encode
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.write import Shard
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.sweep import Sweep, directions
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.recorded.drives.open import open_drive
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.truth.ground_truth import ground_truth

LIDAR = LidarSpec(
    elevations_deg={"beams": 24, "top": -2, "bottom": -30}, azimuths=360, max_range_m=60.0, height_m=1.9, forward_m=0.4
)
FLAT_ROAD = ["terrain.n_gaussians=0", "trees.n=0", "cars.n=0"]


@pytest.fixture(scope="module")
def split(tmp_path_factory) -> Path:
    """Two clips of six frames, whose lidar sees a level ground in the world, half of it paint."""
    scenes = Scenes(load_params("tiny", FLAT_ROAD), shots=Shots(frames=6, fps=5, lidar=LIDAR))
    recipe = Recipe(scenes, RenderSettings(passes=("lidar",)), "png")
    root = tmp_path_factory.mktemp("clips") / "d"
    with claim(root, {**recipe.description(), "shard_size": 12}, "train", 12, range(1)) as found:
        shard = Shard(found, 0, 12, recipe.names)
        for index in shard.indices(12):
            scene = sample_scene(scenes, index)
            labels = ground_truth(scene)
            camera, lidar = labels.camera, labels.lidar
            rays = directions(np.array(lidar.elevations_rad), lidar.azimuths)
            pose = camera.world_from_cam @ lidar.cam_from_lidar
            range_m = pose[2, 3] / -(rays @ pose[2, :3])
            range_m = np.where((range_m > 1) & (range_m < 60), range_m, np.inf).astype(np.float32)
            semantic = np.where(np.isfinite(range_m), np.where(np.arange(360) % 2, 4, 2), 0).astype(np.uint8)
            sweep = Sweep(lidar, range_m, semantic, np.zeros(range_m.shape, np.uint16))
            image = np.full((camera.height_px, camera.width_px, 3), 9 * index, np.uint8)
            shard.write_part(index, encode(Picture(image, labels, {}, sweep), scene_module.to_json(scene), "png"))
        shard.join(12)
    return root / "train"


def test_a_clip_has_one_name_however_its_address_is_written(split, monkeypatch):
    monkeypatch.chdir(split.parent)
    names = {open_drive(place).name for place in (f"{split}:1", "train:1", f"file://{split}:1", f"{split}/../train:1")}
    assert names == {"d/train:00000006"}


def test_a_clip_is_a_drive_of_which_the_truth_is_known(split):
    drive = open_drive(f"{split}:1")
    reader = Reader(str(split))
    assert len(drive.frames) == 6
    for number, frame in enumerate(drive.frames):
        labels = reader.labels(6 + number)
        assert (frame.name, frame.time_s) == (f"{6 + number:08d}", pytest.approx(number / 5))
        scan = frame.scan()
        points = transform(scan.world_from_host @ drive.host_from_lidar, scan.xyz_lidar)
        assert np.abs(points[:, 2]).max() < 1e-4
        assert set(scan.intensity.tolist()) == {0.15, 0.8}
        world_from_cam = frame.world_from_host @ drive.camera.host_from_cam
        assert np.abs(world_from_cam - labels.camera.world_from_cam).max() < 1e-8
        seen = [part for lane in labels.lanes if lane.kind == "delimiter" for part in lane.visible_parts()]
        assert len(frame.lanes_px) == len([part for part in seen if len(part) > 1])
        assert frame.load_image() == reader.member(6 + number, "png")
    way = drive.frames[5].world_from_host[:3, 3] - drive.frames[0].world_from_host[:3, 3]
    assert way @ drive.frames[2].world_from_host[:3, 1] > 0.9 * np.linalg.norm(way) > 1


def run(*arguments: object) -> object:
    from synth3dlanes_cli.main import main

    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_the_commands(split, tmp_path):
    checked = run("drive", "check", split, "--json")
    document = json.loads(checked.stdout)
    assert (checked.exit_code, document["findings"], document["frames"]) == (0, [], 6)
    assert "6 frames in 1 s" in run("drive", "check", f"{split}:1").stdout
    marked = run("drive", "mark", split, "--out", tmp_path / "m.html", "--frames", "0:2", "--cell", "0.5")
    assert marked.stdout.startswith(f"Page: {tmp_path}/m.html, ")
    assert 'id="marking-data"' in (tmp_path / "m.html").read_text()
    review = run("drive", "review", split, "--out", tmp_path / "r.html", "--every", 5)
    assert review.stdout == f"Page: {tmp_path}/r.html, 3 frames of 12\n"
    assert (tmp_path / "r.html").read_text().count('class="reviewed off"') == 3


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("check", "nowhere"), "nowhere: expected drive.yaml, a log of Argoverse 2"),
        (("mark", "{split}", "--frames", "9:"), "frames: expected some of 0:6, got none"),
        (("mark", "{split}", "--frames", "x"), "expected FIRST:END, as in 0:200, got 'x'"),
        (("check", "{split}", "--camera", "left"), "expected a camera of "),
        (("check", "{split}", "--marked", "none.geojson"), "none.geojson: cannot be read"),
    ],
)
def test_bad_arguments_are_told_in_one_line(split, tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    result = run("drive", *(argument.format(split=split) for argument in arguments))
    assert result.exit_code == 2
    assert told in result.stderr
    assert len(result.stderr.splitlines()) == 1
