"""Faults to plant in a data set, and words that a finding of each must say.

A fault of samples changes their members; a fault of files changes what lies in a copy of the data set; a world is a
change of scenes whose images and passes then stand beside labels of the scenes as they were.
"""

import io
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from synth3dlanes.dataset.format import (
    LABELS,
    PASSES,
    SCENE,
    decode_image,
    encode_image,
    read_passes,
    write_passes,
)
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.world.world import resolve
from tests.validate.sealing import Members, describe, seal

Passes = dict[str, np.ndarray]
Changes = Callable[[Scene], list[str]]


class Fault(NamedTuple):
    """What is planted, how in a data set, a pattern that a problem must match, and whether a sample's first problem
    must."""

    name: str
    plant: Callable[[Path], None]
    words: str
    is_first: bool = False


class World(NamedTuple):
    """What differs, the changes of a scene (none where it has nothing of the kind), a pattern as a fault's, and whether
    it shows over many samples only."""

    name: str
    changes: Changes
    words: str
    needs_many: bool = False


# -- members of samples


def in_samples(spoil: Callable[[Members], None]) -> Callable[[Path], None]:
    """Spoil every sample of a data set."""

    def change(samples: dict[int, Members]) -> None:
        for members in samples.values():
            spoil(members)

    return lambda root: seal(root, change)


def of_passes(change: Callable[[Passes, Labels], Passes]) -> Callable[[Path], None]:
    """Change the passes of the image's pixels."""

    def spoil(members: Members) -> None:
        labels = labels_module.from_json(members[LABELS], LABELS)
        members[PASSES] = write_passes(change(read_passes(members[PASSES], PASSES), labels))

    return in_samples(spoil)


def of_pass(name: str, change: Callable[[np.ndarray, Labels], np.ndarray]) -> Callable[[Path], None]:
    """Change one pass."""
    return of_passes(lambda passes, labels: {**passes, name: change(passes[name], labels)})


def of_image(change: Callable[[Image.Image], Image.Image]) -> Callable[[Path], None]:
    """Change the image."""

    def spoil(members: Members) -> None:
        name = next(iter(members))
        image = Image.fromarray(decode_image(members[name], name))
        members[name] = encode_image(np.array(change(image)), name)

    return in_samples(spoil)


def of_json(member: str, change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    """Change the scene or the labels as JSON."""

    def spoil(members: Members) -> None:
        document = json.loads(members[member])
        change(document)
        members[member] = json.dumps(document, separators=(",", ":")).encode()

    return in_samples(spoil)


def with_shares(change: Callable[[list[float]], list[float]]) -> Callable[[dict[str, Any]], None]:
    """Change the seen shares of cars, in the list of them and in the objects."""

    def of_labels(document: dict[str, Any]) -> None:
        document["car_visible_fraction"] = change(document["car_visible_fraction"])
        # Behind the cars are people, riders and road works.
        for item, share in zip(document["objects"], document["car_visible_fraction"], strict=False):
            item["visible_fraction"] = share

    return of_labels


def to_the_right(pixels: np.ndarray, by: int) -> np.ndarray:
    """The same picture `by` pixels to the right; its left border is repeated."""
    return np.concatenate([np.repeat(pixels[:, :1], by, axis=1), pixels[:, :-by]], axis=1)


def in_the_world(normals: np.ndarray, labels: Labels) -> np.ndarray:
    """Normals of the camera frame, in the world's."""
    return normals @ labels.camera.world_from_cam[:3, :3].T.astype(np.float32)


def off_by_one(ids: np.ndarray, _: Labels) -> np.ndarray:
    """Ids that count from the next."""
    return ids + (ids > 0).astype(ids.dtype)


def swapped(a: str, b: str, ids: np.ndarray, _: Labels) -> np.ndarray:
    """Semantic ids of which two are taken for each other."""
    one, other = SEMANTIC_IDS[a], SEMANTIC_IDS[b]
    return np.where(ids == one, other, np.where(ids == other, one, ids)).astype(ids.dtype)


def stretched(image: Image.Image) -> Image.Image:
    """5 % wider, cut to its size."""
    width, height = image.size
    wide = image.resize((round(width * 1.05), height))
    left = (wide.width - width) // 2
    return wide.crop((left, 0, left + width, height))


def coarse(image: Image.Image) -> Image.Image:
    """Of half its resolution, in its size."""
    return image.resize((image.width // 2, image.height // 2)).resize(image.size)


def without_normal_z(members: Members) -> None:
    """The passes without one of their channels."""
    channels = OpenEXR.File(io.BytesIO(members[PASSES]), separate_channels=True).channels()
    kept = {name: np.ascontiguousarray(channel.pixels) for name, channel in channels.items() if name != "normal.Z"}
    stream = io.BytesIO()
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, kept).write(stream)
    members[PASSES] = stream.getvalue()


def truncated(members: Members) -> None:
    """The passes cut short."""
    members[PASSES] = members[PASSES][: len(members[PASSES]) * 2 // 3]


# -- files of a data set


def edit_index(column: str, more: float, root: Path) -> None:
    """Other values in a column of the index."""
    path = root / "train/00000.parquet"
    rows = pq.read_table(path)
    at = rows.column_names.index(column)
    values = pa.array([value + more for value in rows[column].to_pylist()], rows.schema.field(at).type)
    pq.write_table(rows.set_column(at, rows.schema.field(at), values), path)


def under_new_numbers(root: Path) -> None:
    """A test split that is the train split, its scenes said to be drawn for it."""
    (root / "train").rename(root / "test")
    describe(root, lambda document: document.update(splits={"test": document["splits"]["train"]}))

    def change(samples: dict[int, Members]) -> None:
        for members in samples.values():
            members[SCENE] = json.dumps(json.loads(members[SCENE]) | {"split": "test"}).encode()

    seal(root, change, "test")


# -- worlds


def scaled(path: str, factor: float) -> Changes:
    """A number of the scene times a factor."""

    def changes(scene: Scene) -> list[str]:
        part, name = path.split(".")
        return [f"{path}={factor * getattr(getattr(scene, part), name)}"]

    return changes


def longer_lens(scene: Scene) -> list[str]:
    """1 % more focal length."""
    return [*scaled("camera.fx_px", 1.01)(scene), *scaled("camera.fy_px", 1.01)(scene)]


def to_the_side(scene: Scene) -> list[str]:
    """The principal point a pixel to the right."""
    return [f"camera.cx_px={scene.camera.cx_px + 1}"]


def wider_exit(scene: Scene) -> list[str]:
    """0.3 degrees more to the exit, where there is one."""
    angle_rad = scene.road.exit_angle_rad + float(np.radians(0.3))
    return [f"road.exit_angle_rad={angle_rad}"] if scene.road.topology > 1 else []


def higher_ramp(scene: Scene) -> list[str]:
    """A ramp of 10 % more height, where it is used."""
    is_used = any(road.ramp for road in resolve(scene).network.roads)
    return scaled("road.ramp_height_m", 1.1)(scene) if is_used else []


def higher_hills(scene: Scene) -> list[str]:
    """2 % more of every height of the terrain."""
    return [
        f"terrain.gaussians.{i}.magnitude_m={1.02 * gaussian.magnitude_m}"
        for i, gaussian in enumerate(scene.terrain.gaussians)
    ]


FAULTS = [
    Fault(
        "passes 1 px to the right",
        of_passes(lambda passes, _: {name: to_the_right(pixels, 1) for name, pixels in passes.items()}),
        "right|aside|shift|centroid",
    ),
    Fault("normals in the world frame", of_pass("normal", in_the_world), "normal"),
    Fault("normals negated", of_pass("normal", lambda normals, _: -normals), "normal"),
    Fault("normals zero", of_pass("normal", lambda normals, _: 0 * normals), "normal"),
    Fault("instance ids zero", of_pass("instance", lambda ids, _: 0 * ids), "instance"),
    Fault("instance ids off by one", of_pass("instance", off_by_one), "instance"),
    Fault(
        "car_visible_fraction reversed",
        of_json(LABELS, with_shares(lambda shares: shares[::-1])),
        "car_visible_fraction|visible fraction",
    ),
    Fault("ids of car and tree swapped", of_pass("semantic", partial(swapped, "car", "tree")), "car|tree"),
    Fault("ids of road and shoulder swapped", of_pass("semantic", partial(swapped, "road", "shoulder")), "shoulder"),
    Fault("image 3 px to the right", of_image(lambda i: Image.fromarray(to_the_right(np.asarray(i), 3))), "image"),
    Fault("image stretched by 5 %", of_image(stretched), "image"),
    Fault("image BGR", of_image(lambda i: Image.fromarray(np.asarray(i)[..., ::-1].copy())), "image"),
    Fault("image of half its resolution", of_image(coarse), "image"),
    Fault(
        "exposure edited in the scene",
        of_json(SCENE, lambda document: document["light"].update(exposure=1.3 * document["light"]["exposure"])),
        "exposure",
    ),
    Fault(
        "params edited in dataset.json",
        lambda root: describe(root, lambda document: document["params"]["camera"].update(height_m=[1.0, 1.1])),
        "height_m|recipe|dataset.json",
    ),
    Fault(
        "generator's version edited in dataset.json",
        lambda root: describe(root, lambda document: document.update(generator="9.9")),
        "generator|recipe|dataset.json",
    ),
    Fault(
        "samples a pixel edited in dataset.json",
        lambda root: describe(root, lambda document: document["render"].update(samples=64)),
        "samples|recipe|dataset.json",
    ),
    Fault("lane_width_m edited in the index", partial(edit_index, "lane_width_m", 0.1), "lane_width_m"),
    Fault("max_grade edited in the index", partial(edit_index, "max_grade", 0.01), "max_grade"),
    Fault("test made of train's scenes", under_new_numbers, "scene"),
    Fault(
        "depth x 1.005", of_pass("depth", lambda depth_m, _: depth_m * np.float32(1.005)), "depth|the pavement within"
    ),
    Fault(
        "n_lanes edited in the scene",
        of_json(SCENE, lambda document: document["road"].update(n_lanes=document["road"]["n_lanes"] + 1)),
        "n_lanes|lanes",
    ),
    Fault("passes without normal.Z", in_samples(without_normal_z), "normal"),
    Fault("passes truncated", in_samples(truncated), "passes"),
]

WORLDS = [
    World("world: lanes 1 % wider", scaled("road.lane_width_m", 1.01), "paint", needs_many=True),
    World("world: ramp 10 % higher", higher_ramp, "the pavement within"),
    World("world: focal length 1 % longer", longer_lens, "focal|the pavement within"),
    World("world: cx 1 px to the right", to_the_side, "right", needs_many=True),
    World("world: exit angle 0.3 deg wider", wider_exit, "exit|paint|pavement|ramp"),
    World("world: hills 2 % higher", higher_hills, "hills|terrain"),
]
