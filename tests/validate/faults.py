"""Faults to plant in a data set: words that a finding of each must say, and those of the sample made again.

A fault of samples changes their members; a fault of files changes what lies in a copy of the data set; a world is a
change of scenes whose images and passes then stand beside labels of the scenes as they were. FAULTS may be planted in
any data set, OF_STREETS need what `streets` has: many cars, oncoming lanes, structures, symbols, a bonnet and a lidar;
OF_WORKS need road works; files do not tell, or not always, of UNSEEN.
"""

import io
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image
from scipy.ndimage import distance_transform_edt, uniform_filter

from synth3dlanes.dataset.format import (
    HEIGHT,
    LABELS,
    LIDAR,
    PASSES,
    SCENE,
    read_passes,
    read_sweep,
    write_passes,
    write_sweep,
)
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.instance_ids import instance_id, numbers_of
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.world.world import resolve
from tests.validate.sealing import Members, describe, seal

Pixels = np.ndarray
Passes = dict[str, Pixels]
Spoil = Callable[[Members], object]
Changes = Callable[[Scene], list[str]]


class Fault(NamedTuple):
    """What is planted, how in the members of a sample, or else in a data set, a pattern that a problem must match, one
    that what is told of the sample made again must match ("" where it is not asked), and whether a sample's first
    problem must match."""

    name: str
    spoil: Spoil | None
    words: str
    again: str = ""
    is_first: bool = False
    edit: Callable[[Path], object] = lambda root: None

    def plant(self, root: Path) -> None:
        """Spoil every sample of a data set, or its files."""
        if self.spoil is None:
            self.edit(root)
            return
        spoil = self.spoil
        seal(root, lambda samples: [spoil(members) for members in samples.values()] and None)


class World(NamedTuple):
    """What differs, the changes of a scene (none where it has nothing of the kind), and a pattern as a fault's."""

    name: str
    changes: Changes
    words: str


# -- members of samples


def of_passes(change: Callable[[Passes, Labels], Passes], member: str = PASSES) -> Spoil:
    """Change the passes of the image's pixels, or the height map."""

    def spoil(members: Members) -> None:
        labels = labels_module.from_json(members[LABELS], LABELS)
        members[member] = write_passes(change(read_passes(members[member], member), labels))

    return spoil


def of_pass(name: str, change: Callable[[Pixels, Labels], Pixels]) -> Spoil:
    """Change one pass."""
    member = HEIGHT if name == "height" else PASSES
    return of_passes(lambda passes, labels: {**passes, name: change(passes[name], labels)}, member)


def of_image(change: Callable[[Pixels, Passes, Labels], Pixels], quality: int | None = None) -> Spoil:
    """Change the image's levels, with passes and labels at hand; encoded as the JPEG was, or in another quality."""

    def spoil(members: Members) -> None:
        before, labels = Image.open(io.BytesIO(members["jpg"])), labels_module.from_json(members[LABELS], LABELS)
        passes = read_passes(members[PASSES], PASSES)
        after = np.clip(np.round(change(np.asarray(before).astype(float), passes, labels)), 0, 255).astype(np.uint8)
        if quality is None and np.array_equal(after, np.asarray(before)):
            return
        stream, how = io.BytesIO(), {"qtables": before.quantization} if quality is None else {"quality": quality}
        Image.fromarray(after).save(stream, "JPEG", **how)
        members["jpg"] = stream.getvalue()

    return spoil


def of_json(member: str, change: Callable[[dict[str, Any]], object]) -> Spoil:
    """Change the scene or the labels as JSON."""

    def spoil(members: Members) -> None:
        document = json.loads(members[member])
        change(document)
        members[member] = json.dumps(document, separators=(",", ":")).encode()

    return spoil


def of_sweep(change: Callable[[Sweep], Sweep]) -> Spoil:
    """Change the sweep."""

    def spoil(members: Members) -> None:
        lidar = labels_module.from_json(members[LABELS], LABELS).lidar
        assert lidar is not None
        members[LIDAR] = write_sweep(change(read_sweep(members[LIDAR], LIDAR, lidar)))

    return spoil


# -- pictures


def aside(pixels: Pixels, by: int) -> Pixels:
    """The same picture `by` pixels to the right; its left border is repeated."""
    return np.concatenate([np.repeat(pixels[:, :1], by, axis=1), pixels[:, :-by]], axis=1)


def drawn(change: Callable[[Image.Image], Image.Image]) -> Callable[[Pixels, Passes, Labels], Pixels]:
    """A change by Pillow."""
    return lambda image, *_: np.array(change(Image.fromarray(image.astype(np.uint8))).convert("RGB")).astype(float)


def scaled_by(share: float, image: Image.Image) -> Image.Image:
    """Wider and higher, cut to its size."""
    width, height = image.size
    cut_px = share / (1 + share) / 2
    box = (width * cut_px, height * cut_px, width * (1 - cut_px), height * (1 - cut_px))
    return image.resize(image.size, Image.Resampling.BICUBIC, box=box)


def stretched(by: float, image: Image.Image) -> Image.Image:
    """Wider, cut to its size."""
    width, height = image.size
    wide = image.resize((round(width * by), height))
    left = (wide.width - width) // 2
    return wide.crop((left, 0, left + width, height))


def coarse(how: Image.Resampling, image: Image.Image) -> Image.Image:
    """Of half its resolution, in its size."""
    return image.resize((image.width // 2, image.height // 2), Image.Resampling.BOX).resize(image.size, how)


def turned_hue(by: int, image: Image.Image) -> Image.Image:
    """All hues by a part of the circle, of 256."""
    hue, saturation, value = image.convert("HSV").split()
    return Image.merge("HSV", (hue.point(lambda h: (h + by) % 256), saturation, value))


def with_black_block(image: Pixels, *_: Any) -> Pixels:
    """A block of 3 % of the picture black, in its lower half."""
    height, width = image.shape[:2]
    rows, columns = round(height * 0.15), round(width * 0.2)
    image[-rows - height // 8 : -height // 8, width // 3 : width // 3 + columns] = 0
    return image


def lower_half_aside(image: Pixels, *_: Any) -> Pixels:
    """The lower half 2 px to the right."""
    half = len(image) // 2
    image[half:] = np.roll(image[half:], 2, axis=1)
    return image


def erased(which: Callable[[Pixels], Pixels], image: Pixels, passes: Passes, _: Labels) -> Pixels:
    """Lines painted over with what is beside them; `which` chooses from the ids that are seen, the largest first."""
    lines = passes["instance"] * (passes["semantic"] == SEMANTIC_IDS["marking"])
    ids, counts = np.unique(lines[lines > 0], return_counts=True)
    here = np.isin(lines, which(ids[np.argsort(-counts)]))
    is_paint = uniform_filter((lines > 0).astype(float), 3) > 0.05
    row, column = distance_transform_edt(is_paint, return_distances=False, return_indices=True)
    wide = uniform_filter(here.astype(float), 3) > 0.05
    return np.where(wide[..., None], image[row, column], image)


def yellow_for_white(image: Pixels, passes: Passes, labels: Labels) -> Pixels:
    """White lines yellow."""
    for i, lane in enumerate(lane for lane in labels.lanes if lane.kind == "delimiter"):
        if lane.color == "white":
            image[passes["instance"] == instance_id("delimiter", i)] *= [1, 0.85, 0.35]
    return image


def white_for_yellow(image: Pixels, passes: Passes, _: Labels) -> Pixels:
    """Yellow lines white, and white ones yellow."""
    at = passes["semantic"] == SEMANTIC_IDS["marking"]
    red, green, blue = image[at].T
    is_yellow = blue < 0.7 * red
    image[at] = np.stack([red, np.where(is_yellow, red, 0.8 * green), np.where(is_yellow, 0.97 * red, 0.3 * blue)], -1)
    return image


def other_cars(image: Pixels, passes: Passes, _: Labels) -> Pixels:
    """The red and blue of cars swapped."""
    at = passes["semantic"] == SEMANTIC_IDS["car"]
    image[at] = image[at][:, ::-1]
    return image


# -- passes


def in_the_world(normals: Pixels, labels: Labels) -> Pixels:
    """Normals of the camera frame, in the world's."""
    return normals @ labels.camera.world_from_cam[:3, :3].T.astype(np.float32)


def off_by_one(ids: Pixels, _: Labels) -> Pixels:
    """Ids that count from the next."""
    return ids + (ids > 0).astype(ids.dtype)


def swapped(a: str, b: str) -> Callable[[Pixels, Labels | None], Pixels]:
    """Semantic ids of which two are taken for each other."""
    one, other = SEMANTIC_IDS[a], SEMANTIC_IDS[b]
    return lambda ids, _: np.where(ids == one, other, np.where(ids == other, one, ids)).astype(ids.dtype)


def in_steps(depth_m: Pixels, _: Labels) -> Pixels:
    """Depth in steps of 5 cm."""
    return np.where(np.isfinite(depth_m), np.round(depth_m * 20) / 20, depth_m).astype(np.float32)


def as_road(which: Callable[[Passes, Labels], Pixels]) -> Spoil:
    """Some pixels as road."""

    def change(passes: Passes, labels: Labels) -> Passes:
        at = which(passes, labels)
        semantic = np.where(at, SEMANTIC_IDS["road"], passes["semantic"]).astype("u1")
        return {**passes, "semantic": semantic, "instance": np.where(at, 0, passes["instance"]).astype("u2")}

    return of_passes(change)


def most_seen(kind: str, passes: Passes, *_: Any) -> Pixels:
    """The pixels of the thing of a kind that has most; none without any."""
    ids, n = np.unique(passes["instance"], return_counts=True)
    n = n * (numbers_of(kind, ids.astype(int)) >= 0)
    return passes["instance"] == (int(ids[n.argmax()]) if n.any() else -1)


def of_class(name: str, passes: Passes, *_: Any) -> Pixels:
    """The pixels of a semantic class."""
    return passes["semantic"] == SEMANTIC_IDS[name]


def temporary(passes: Passes, labels: Labels) -> Pixels:
    """The pixels of lines that hold along works alone."""
    lines = [lane.id for lane in labels.lanes if lane.kind == "delimiter"]
    own = [instance_id("delimiter", i) for i, name in enumerate(lines) if name.startswith("works_line")]
    return np.isin(passes["instance"], own)


def a_car_farther(passes: Passes, _: Labels) -> Passes:
    """The depth of the car with most pixels 3 % more."""
    farther = np.where(most_seen("car", passes), passes["depth"] * 1.03, passes["depth"])
    return {**passes, "depth": farther.astype("f4")}


def with_a_hole(passes: Passes, _: Labels) -> Passes:
    """The sky at one pixel of the nearest road."""
    at = tuple(np.argwhere(passes["semantic"] == SEMANTIC_IDS["road"])[-1])
    holed = {name: values.copy() for name, values in passes.items()}
    for name, values in holed.items():
        values[at] = np.inf if name == "depth" else 0
    return holed


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


# -- sweeps


def rear_turned(sweep: Sweep) -> Sweep:
    """The rear half three columns on."""
    quarter = sweep.range_m.shape[1] // 4

    def turned(values: Pixels) -> Pixels:
        rear = np.concatenate([values[:, -quarter:], values[:, :quarter]], axis=1)
        rear = np.roll(rear, 3, axis=1)
        return np.concatenate([rear[:, quarter:], values[:, quarter:-quarter], rear[:, :quarter]], axis=1)

    return replace(sweep, **{name: turned(getattr(sweep, name)) for name in ("range_m", "semantic", "instance")})


def other_cars_behind(sweep: Sweep) -> Sweep:
    """Cars behind the host with the ids of the next."""
    quarter, ids = sweep.range_m.shape[1] // 4, sweep.instance.copy()
    behind = np.ones(ids.shape, dtype=bool)
    behind[:, quarter:-quarter] = False
    ids[behind & (sweep.semantic == SEMANTIC_IDS["car"]) & (numbers_of("car", ids) >= 0)] += 1
    return replace(sweep, instance=ids)


def swapped_in_sweep(a: str, b: str) -> Spoil:
    """Semantic ids of points of which two are taken for each other."""
    return of_sweep(lambda sweep: replace(sweep, semantic=swapped(a, b)(sweep.semantic, None)))


def as_road_in_sweep(name: str) -> Spoil:
    """Points of a class as road."""

    def change(sweep: Sweep) -> Sweep:
        at = sweep.semantic == SEMANTIC_IDS[name]
        semantic = np.where(at, SEMANTIC_IDS["road"], sweep.semantic).astype(sweep.semantic.dtype)
        return replace(sweep, semantic=semantic, instance=np.where(at, 0, sweep.instance).astype(sweep.instance.dtype))

    return of_sweep(change)


def longer(sweep: Sweep) -> Sweep:
    """Ranges 2 cm too long."""
    return replace(sweep, range_m=sweep.range_m + np.float32(0.02) * (sweep.range_m < 190))


# -- labels


def with_shares(change: Callable[[list[float]], list[float]]) -> Spoil:
    """Change the seen shares of cars, in the list of them and in the objects."""

    def of_labels(document: dict[str, Any]) -> None:
        document["car_visible_fraction"] = change(document["car_visible_fraction"])
        # Behind the cars are people, riders and road works.
        for item, share in zip(document["objects"], document["car_visible_fraction"], strict=False):
            item["visible_fraction"] = share

    return of_json(LABELS, of_labels)


def of_lanes(change: Callable[[dict[str, Any]], object], only_temporary: bool = False) -> Spoil:
    """Change the labels of each lane, or of each line that holds along works alone."""

    def of_labels(document: dict[str, Any]) -> None:
        for lane in document["lanes"]:
            if not only_temporary or lane["id"].startswith("works_line"):
                change(lane)

    return of_json(LABELS, of_labels)


def moved(points: list[list[float]], by_m: tuple[float, float, float]) -> list[list[float]]:
    """Points aside, ahead and up."""
    return np.round(np.add(points, by_m), 4).tolist()


def a_line_aside(document: dict[str, Any]) -> None:
    """The first lane 5 cm to the right."""
    document["lanes"][0]["xyz_cam"] = moved(document["lanes"][0]["xyz_cam"], (0.05, 0, 0))


def symbols_on(document: dict[str, Any]) -> None:
    """Symbols 10 cm farther."""
    for symbol in document.get("symbols", ()):
        symbol["xyz_cam"] = moved(symbol["xyz_cam"], (0, 0.1, 0))


def unlabelled(document: dict[str, Any]) -> None:
    """Temporary lines without labels."""
    document["lanes"] = [lane for lane in document["lanes"] if not lane["id"].startswith("works_line")]


def device_aside(document: dict[str, Any]) -> None:
    """The cone or barrel with most pixels labelled half a metre aside."""
    devices = [item for item in document["objects"] if item["category"] in ("cone", "barrel")]
    if devices:
        seen = [item["seen_box_px"] or [0, 0, 0, 0] for item in devices]
        device = devices[int(np.argmax([(x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in seen]))]
        device["center_cam"][0] = round(device["center_cam"][0] + 0.5, 4)


# -- files of a data set


def edit_index(column: str, more: float, root: Path) -> None:
    """Other values in a column of the index."""
    path = root / "train/00000.parquet"
    rows = pq.read_table(path)
    at = rows.column_names.index(column)
    values = pa.array([value + more for value in rows[column].to_pylist()], rows.schema.field(at).type)
    pq.write_table(rows.set_column(at, rows.schema.field(at), values), path)


def reorder_index(root: Path) -> None:
    """The index with its rows from last to first."""
    path = root / "train/00000.parquet"
    rows = pq.read_table(path)
    pq.write_table(rows.take(list(range(rows.num_rows))[::-1]), path)


def edit_text(name: str, old: str, new: str, root: Path) -> None:
    """Other words in a file."""
    (root / name).write_text((root / name).read_text().replace(old, new))


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


IN_DESCRIPTION = {
    "params": (lambda document: document["params"]["camera"].update(height_m=[1.0, 1.1]), "height_m"),
    "generator's version": (lambda document: document.update(generator="9.9"), "generator"),
    "samples a pixel": (lambda document: document["render"].update(samples=64), "samples"),
}

FAULTS = [
    Fault(
        "passes 1 px to the right",
        of_passes(lambda passes, _: {name: aside(pixels, 1) for name, pixels in passes.items()}),
        "paint where the line",
    ),
    Fault("normals in the world frame", of_pass("normal", in_the_world), "road's in the camera frame", "normal: "),
    Fault("normals negated", of_pass("normal", lambda normals, _: -normals), "expected it to face the camera"),
    Fault("normals zero", of_pass("normal", lambda normals, _: 0 * normals), "zero in the sky and only there"),
    Fault("instance ids zero", of_pass("instance", lambda ids, _: 0 * ids), "instance: expected ids of the kind"),
    Fault("instance ids off by one", of_pass("instance", off_by_one), "instance: expected pixels of", "instance: "),
    Fault(
        "car_visible_fraction reversed",
        with_shares(lambda shares: shares[::-1]),
        "car_visible_fraction|visible fraction",
    ),
    Fault(
        "ids of car and tree swapped", of_pass("semantic", swapped("car", "tree")), "ids of the kind tree", "semantic: "
    ),
    Fault("ids of road and shoulder swapped", of_pass("semantic", swapped("road", "shoulder")), "road by the plan"),
    Fault("image 3 px to the right", of_image(lambda image, *_: aside(image, 3)), "image"),
    Fault("image stretched by 5 %", of_image(drawn(partial(stretched, 1.05))), "image"),
    Fault("image BGR", of_image(lambda image, *_: image[..., ::-1]), "image", "image: "),
    Fault("image of half its resolution", of_image(drawn(partial(coarse, Image.Resampling.BICUBIC))), "image"),
    Fault(
        "exposure edited in the scene",
        of_json(SCENE, lambda document: document["light"].update(exposure=1.3 * document["light"]["exposure"])),
        "exposure",
    ),
    *(
        Fault(
            f"{what} edited in dataset.json",
            None,
            f"{words}|recipe|dataset.json",
            edit=partial(describe, change=change),
        )
        for what, (change, words) in IN_DESCRIPTION.items()
    ),
    *(
        Fault(f"{column} edited in the index", None, column, edit=partial(edit_index, column, more))
        for column, more in (("lane_width_m", 0.1), ("max_grade", 0.01))
    ),
    Fault("test made of train's scenes", None, "scene", edit=under_new_numbers),
    Fault("depth x 1.005", of_pass("depth", lambda d, _: d * np.float32(1.005)), "the pavement within", "depth: "),
    Fault(
        "n_lanes edited in the scene",
        of_json(SCENE, lambda document: document["road"].update(n_lanes=document["road"]["n_lanes"] + 1)),
        "n_lanes|lanes",
    ),
    Fault("passes without normal.Z", without_normal_z, "normal"),
    Fault("passes truncated", truncated, "passes"),
    Fault(
        "car_visible_fraction + 0.08",
        with_shares(lambda shares: [min(1.0, round(share + 0.08, 3)) for share in shares]),
        "car_visible_fraction",
        "car_visible_fraction.0: expected",
    ),
    Fault("image red and green swapped", of_image(lambda i, *_: i[..., [1, 0, 2]]), "red over green", "image: "),
    Fault("image with its hue turned", of_image(drawn(partial(turned_hue, 43))), "image: expected (grass|leaves|red)"),
    Fault("image four times darker", of_image(lambda image, *_: image / 4), "expected daylight"),
    Fault("passes without one line", as_road(partial(most_seen, "delimiter")), "of the line in all of its paint"),
    Fault("depth of a car 3 % more", of_passes(a_car_farther), "pixels of car"),
    Fault("image gray", of_image(drawn(lambda image: image.convert("L"))), "of blue over the road", "image: "),
    Fault("image with a black block of 3 %", of_image(with_black_block), "of the picture black", "image: "),
    Fault(
        "image mirrored",
        of_image(lambda image, *_: image[:, ::-1]),
        "image: expected (edges|paint|its|the line)",
        "image: ",
    ),
    Fault("all paint erased", of_image(partial(erased, lambda ids: ids)), "of paint brighter", "image: "),
    Fault("paint of one line erased", of_image(partial(erased, lambda ids: ids[:1])), "of paint brighter", "image: "),
    Fault("white lines yellow", of_image(yellow_for_white), "expected white paint, got yellow"),
    Fault("depth rounded to 5 cm", of_pass("depth", in_steps), "the pavement within", "depth: "),
    Fault(
        "depth 1 cm too long",
        of_pass("depth", lambda depth_m, _: depth_m + np.float32(0.01)),
        "the pavement within",
        r"depth: .*0\.01 m in the median",
    ),
    Fault(
        "depth in millimetres",
        of_pass("depth", lambda depth_m, _: depth_m * np.float32(1000)),
        "depth: expected pixels at lines within",
    ),
    Fault("a hole in the ground", of_passes(with_a_hole), "sky at 1 pixels"),
    Fault(
        "height map 3 cm up",
        of_pass("height", lambda height_m, _: height_m + np.float32(0.03)),
        r"cells on the scene's ground, got .* elsewhere, by \+0\.0",
        r"height: .*0\.03 m in the median",
    ),
    Fault(
        "height map one row off",
        of_pass("height", lambda height_m, _: np.roll(height_m, -1, axis=0)),
        "cells on the scene's ground",
        "height: ",
    ),
    Fault("rows of the index reordered", None, "in the order of their samples", edit=reorder_index),
    *(
        Fault(f"{name} edited", None, "expected what dataset.json gives", edit=partial(edit_text, name, *words))
        for name, words in (
            ("README.md", ("Synthetic 3D lanes", "Synthetic 4D lanes")),
            ("croissant.json", ("train/00000.tar", "train/00001.tar")),
        )
    ),
]

OF_STREETS = [
    Fault(
        "object_visible moved by a point",
        of_lanes(lambda lane: lane.update(object_visible=lane["object_visible"][-1:] + lane["object_visible"][:-1])),
        "object_visible: expected what the passes",
        r"object_visible\.\d+: expected",
    ),
    Fault(
        "directions removed",
        of_lanes(lambda lane: lane.pop("direction", None)),
        'direction: expected "oncoming"',
        'lanes.0.direction: expected "(same|oncoming)", got null',
    ),
    *(
        Fault(
            f"{a}s and {b}s swapped",
            of_pass("semantic", swapped(a, b)),
            f"on faces of ({a}|{b})",
            "semantic: ",
        )
        for a, b in (("pole", "sign"), ("barrier", "kerb"))
    ),
    Fault("symbols missing", as_road(partial(of_class, "symbol")), "in all of its paint", is_first=True),
    Fault("bonnet missing", as_road(partial(of_class, "host")), "expected the bonnet", is_first=True),
    Fault("rear half of the sweep three columns on", of_sweep(rear_turned), "lidar", "lidar range: "),
    Fault(
        "ids of the next car behind the host",
        of_sweep(other_cars_behind),
        "lidar: expected points of car",
        "lidar instance: ",
    ),
    Fault(
        "poles and barriers swapped in the sweep", swapped_in_sweep("pole", "barrier"), "lidar: expected .* on faces of"
    ),
    Fault("lines as road in the sweep", as_road_in_sweep("marking"), "lidar: expected points of the line in all"),
    Fault("symbols as road in the sweep", as_road_in_sweep("symbol"), "lidar: expected points of symbol . in all"),
]

OF_WORKS = [
    Fault(
        "works: lines labelled where they were before",
        of_lanes(lambda lane: lane.update(xyz_cam=moved(lane["xyz_cam"], (1, 0, 0))), only_temporary=True),
        "xyz_cam.0.0: expected",
    ),
    Fault(
        "works: yellow lines labelled white",
        of_lanes(lambda lane: lane.update(color="white"), only_temporary=True),
        'color: expected "yellow"',
    ),
    Fault("works: lines without labels", of_json(LABELS, unlabelled), "(lanes|left|right): expected"),
    Fault("works: passes without the lines", as_road(temporary), "of the line in all of its paint"),
    Fault("works: a cone labelled 0.5 m aside", of_json(LABELS, device_aside), "center_cam.0: expected|in its box"),
]

# What files do not tell, or not always.
UNSEEN = [
    Fault("image gamma 1.1", of_image(lambda image, *_: 255 * (image / 255) ** 1.1), "", "image: "),
    Fault("image 20 % darker", of_image(lambda image, *_: 0.8 * image), "", "image: "),
    Fault("image of half the contrast", of_image(lambda i, *_: i.mean() + 0.5 * (i - i.mean())), "", "image: "),
    Fault(
        "image with noise", of_image(lambda i, *_: i + np.random.default_rng(1).normal(0, 8, i.shape)), "", "image: "
    ),
    Fault("lower half of the image 2 px aside", of_image(lower_half_aside), "", "image: "),
    Fault("image upside down", of_image(lambda image, *_: image[::-1]), "", "image: "),
    Fault("image enlarged by 0.5 %", of_image(drawn(partial(scaled_by, 0.005))), "", "image: "),
    Fault("JPEG of quality 25", of_image(lambda image, *_: image, quality=25), "", "image: "),
    Fault("red and blue of cars swapped", of_image(other_cars), "", "image: "),
    Fault("yellow lines white, white ones yellow", of_image(white_for_yellow), "", "image: "),
    Fault("every second line erased", of_image(partial(erased, lambda ids: ids[::2])), "", "image: "),
    Fault("hues turned by 35 degrees", of_image(drawn(partial(turned_hue, 25))), "", "image: "),
]

# Planted in samples made again alone.
MORE_AGAIN = [
    Fault("depth mirrored", of_pass("depth", lambda depth_m, _: depth_m[:, ::-1]), "", "depth: "),
    Fault("ranges 2 cm too long", of_sweep(longer), "", r"lidar range: .*0\.02 m in the median"),
    Fault("a line 5 cm aside", of_json(LABELS, a_line_aside), "", "lanes.0.xyz_cam.0.0: expected"),
    Fault("symbols 10 cm on", of_json(LABELS, symbols_on), "", "symbols.0.xyz_cam.0.1: expected"),
    Fault("symbols removed", of_json(LABELS, lambda d: d.update(symbols=[])), "", "masks: expected|symbols: expected"),
    Fault(
        "yellow as white",
        of_lanes(lambda lane: lane.update(color="white") if lane.get("color") == "yellow" else None),
        "",
        'color: expected "yellow", got "white"',
    ),
]

WORLDS = [
    World("world: lanes 1 % wider", scaled("road.lane_width_m", 1.01), "paint where the line"),
    World("world: ramp 10 % higher", higher_ramp, "the pavement within"),
    World("world: focal length 1 % longer", longer_lens, "the pavement within"),
    World("world: cx 1 px to the right", to_the_side, "paint where the line"),
    World("world: exit angle 0.3 deg wider", wider_exit, "exit|paint|pavement|ramp"),
    World("world: hills 2 % higher", higher_hills, "hills|terrain"),
]
