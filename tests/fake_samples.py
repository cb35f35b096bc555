"""Sample makers without Blender, for tests of what happens around them; `python -m tests.fake_samples` is a run."""

import errno
import json
import os
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.format import LABELS, Picture, encode
from synth3dlanes.dataset.write import Shard
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneGraph, Segment
from synth3dlanes.labels.object_labels import as_seen
from synth3dlanes.params.params import Params, load_params
from synth3dlanes.params.shots import SINGLE, Shots
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import EncodedSample, Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.system.errors import DrawError
from synth3dlanes.truth.ground_truth import label
from tests.scenes import FLAT

BAD = 3
SETTINGS = RenderSettings()


@cache
def tiny(overrides: tuple[str, ...]) -> Params:
    """Read once; the tests ask for recipes many thousand times."""
    return load_params("tiny", overrides)


def recipe(
    seed: int = 7,
    split: str = "train",
    image_format: str = "png",
    overrides: tuple[str, ...] = (),
    shots: Shots = SINGLE,
    settings: RenderSettings = SETTINGS,
) -> Recipe:
    return Recipe(Scenes(tiny(overrides), seed, split, shots=shots), settings, image_format)


def labels(index: int, time_s: float | None = None) -> Labels:
    y_m = np.arange(0.0, 60)
    camera = CameraLabel(24, 16, np.eye(3), 1.5, 0.02, np.eye(4), np.eye(4))
    xyz_cam = np.stack([np.full_like(y_m, index % 3), y_m, 0.1 * y_m - 1.5], axis=1)
    seen = y_m > 5
    lane = Lane("c1", "centerline", "main", "none", None, None, xyz_cam, seen, seen, y_m > 7)
    graph = LaneGraph((Segment("s1", "main", 1, -100.0, 100.0, None, None, ("c1",)),), {"s1": ()}, None)
    return Labels(camera, (lane,), graph, time_s=time_s)


def image(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 256, (16, 24, 3), dtype=np.uint8)


def make(recipe: Recipe, index: int) -> EncodedSample:
    camera = FLAT.camera.model_copy(update={"width_px": 24, "height_px": 16})
    place, shots = recipe.scenes.shots.place(index), recipe.scenes.shots
    shot = Shot(n_frames=shots.frames, fps=shots.fps, frame=place.frame, n_cameras=shots.n_cameras, camera=place.camera)
    world = {"seed": recipe.scenes.seed, "split": recipe.scenes.split, "index": place.scene, "shot": shot}
    scene = FLAT.model_copy(update={**world, "camera": camera})
    time_s = shot.time_s if shots.frames > 1 else None
    members = encode(Picture(image(index), labels(index, time_s)), scene_module.to_json(scene), recipe.image_format)
    return EncodedSample(members, {"fake": 0.0})


def make_labelled(recipe: Recipe, index: int) -> EncodedSample:
    """Scene and labels are true, the image is black."""
    world = recipe.world(index)
    black = np.zeros((world.scene.camera.height_px, world.scene.camera.width_px, 3), np.uint8)
    members = encode(Picture(black, label(world, world.view)), scene_module.to_json(world.scene), recipe.image_format)
    return EncodedSample(members, {"fake": 0.0})


def make_with_passes(recipe: Recipe, index: int) -> EncodedSample:
    """Scene and labels are true; the image is blocks of grey, the depth that of a leaning wall, the cars of the
    passes are rectangles, and a lidar has a round wall with them as stripes."""
    world = sample_world(recipe.scenes, index)
    camera, found = world.scene.camera, label(world, world.view)
    rows, columns = -(-camera.height_px // 16), -(-camera.width_px // 16)
    blocks = np.random.default_rng(index).integers(0, 256, (rows, columns, 1), dtype=np.uint8).repeat(3, axis=2)
    picture = blocks.repeat(16, axis=0).repeat(16, axis=1)[: camera.height_px, : camera.width_px]
    semantic = np.full(picture.shape[:2], SEMANTIC_IDS["building"], np.uint8)
    instance = np.zeros(semantic.shape, np.uint16)
    for item in found.objects or ():
        if item.box_px is not None:
            left, top, right, bottom = (int(edge) for edge in item.box_px)
            semantic[top:bottom, left:right], instance[top:bottom, left:right] = SEMANTIC_IDS["car"], item.id
    depth_m = np.repeat(np.linspace(100.0, 3.0, camera.height_px, dtype=np.float32)[:, None], camera.width_px, axis=1)
    sweep = None if found.lidar is None else _sweep(found)
    seen = as_seen(found.objects or (), instance, None if sweep is None else sweep.points().instance)
    found = replace(found, objects=seen).with_seen_shares([float(item.seen_box_px is not None) for item in seen])
    passes = {"depth": depth_m, "semantic": semantic, "instance": instance}
    wanted = {name: passes[name] for name in recipe.settings.passes if name in passes}
    members = encode(Picture(picture, found, wanted, sweep), scene_module.to_json(world.scene), recipe.image_format)
    return EncodedSample(members, {"fake": 0.0})


def _sweep(found: Labels) -> Sweep:
    lidar = found.lidar
    assert lidar is not None, "asked only of those that have one"
    range_m = np.full((len(lidar.elevations_rad), lidar.azimuths), 20.0, np.float32)
    instance = np.zeros(range_m.shape, np.uint16)
    for count, item in enumerate(found.objects or ()):
        instance[:, 2 * count : 2 * count + 2] = item.id
    semantic = np.where(instance > 0, SEMANTIC_IDS["car"], SEMANTIC_IDS["building"]).astype(np.uint8)
    return Sweep(lidar, range_m, semantic, instance)


def data_set(root: Path, indices: Iterable[int], n: int, size: int, split: str = "train", seed: int = 7) -> Path:
    """Those of these samples that are not there yet, of `n` that are asked for, in shards of `size`: as `generate`
    makes them, by this process instead of workers."""
    made, wanted = recipe(seed=seed, split=split), set(indices)
    description = {**made.description(), "shard_size": size}
    numbers = sorted({index // size for index in wanted})
    with claim(root, description, split, n, numbers) as folder:
        for number in numbers:
            shard = Shard(folder, number, size, made.names, recipe_text(description)).claimed()
            shard.open()
            for index in sorted(wanted.intersection(shard.missing(n))):
                shard.write_part(index, make(made, index).members)
            if shard.needs_join(n):
                shard.join(n)
            shard.close()
    return root


def sign(recipe: Recipe, index: int) -> EncodedSample:
    """Note who made which sample."""
    time.sleep(0.05)
    (Path(os.environ["SYNTH3DLANES_TEST_MARK"]) / f"{index}-{os.getpid()}").touch()
    return make(recipe, index)


def make_slowly(recipe: Recipe, index: int) -> EncodedSample:
    time.sleep(0.15)
    return make(recipe, index)


def crash_on_bad(recipe: Recipe, index: int) -> EncodedSample:
    if index == BAD:
        raise ValueError("this scene is bad")
    return make(recipe, index)


def fail_to_draw_bad(recipe: Recipe, index: int) -> EncodedSample:
    if index == BAD:
        raise DrawError("cars.n: no room for this scene")
    return make(recipe, index)


def make_what_no_reader_takes(recipe: Recipe, index: int) -> EncodedSample:
    made = make(recipe, index)
    if index != BAD:
        return made
    document = json.loads(made.members[LABELS])
    document["camera"]["height_px"] = -1
    return replace(made, members={**made.members, LABELS: json.dumps(document).encode()})


def always_crash(recipe: Recipe, index: int) -> EncodedSample:
    raise ValueError(f"no scene is good, nor is {index}")


def hang_on_bad_and_spin_on_the_next(recipe: Recipe, index: int) -> EncodedSample:
    if index == BAD:
        time.sleep(1000)
    while index == BAD + 1:
        pass
    return make(recipe, index)


def eat_memory_on_bad(recipe: Recipe, index: int) -> EncodedSample:
    if index == BAD:
        eaten = np.ones(1 << 28)
        time.sleep(1000 * float(eaten[0]))
    return make(recipe, index)


def miss_a_library(recipe: Recipe, index: int) -> EncodedSample:
    raise ImportError("libmissing.so.1: cannot open shared object file")


def find_the_disk_full(recipe: Recipe, index: int) -> EncodedSample:
    """As long as there is a ballast. Sample 1 says so late."""
    if (Path(os.environ["SYNTH3DLANES_TEST_MARK"]) / "ballast").exists():
        time.sleep(3.0 * (index == 1))
        number = int(os.environ.get("SYNTH3DLANES_TEST_ERRNO", errno.ENOSPC))
        raise OSError(number, os.strerror(number))
    return make(recipe, index)


def insist_on_one_core(recipe: Recipe, index: int) -> EncodedSample:
    assert len(os.sched_getaffinity(0)) == 1
    return make(recipe, index)


def main() -> None:
    """Arguments: folder, n, workers, and the address of a Ray cluster if it is to do it."""
    (out, n, workers), address = sys.argv[1:4], sys.argv[4:]
    if address:
        from synth3dlanes.production import cluster

        # On a busy machine, the program that asks for the cluster's health takes its time.
        cluster.HEALTH_S = 120.0
    plan = Plan(out, int(n), recipe(), workers=int(workers), shard_size=10, maker=make_slowly)

    def tell(event: object) -> None:
        print(event, flush=True)  # noqa: T201

    sys.exit(generate(plan, tell, "ray" if address else "local", "".join(address)).exit_code)


if __name__ == "__main__":
    # Workers must find the makers under the module's own name, not as __main__.
    from tests.fake_samples import main as main_of_module

    main_of_module()
