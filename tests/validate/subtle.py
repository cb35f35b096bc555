"""Faults that few measures see: of labels, pictures, passes, sweeps and files, as bugs of a generator would make them.

SUBTLE may be planted in any data set, OF_STREETS need what `streets` has: many cars, oncoming lanes, structures,
symbols, a bonnet and a lidar; OF_WORKS need road works.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from PIL import Image

from synth3dlanes.dataset.format import (
    HEIGHT,
    LABELS,
    LIDAR,
    PASSES,
    decode_image,
    encode_image,
    read_passes,
    read_sweep,
    write_passes,
    write_sweep,
)
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.instance_ids import instance_id, numbers_of
from synth3dlanes.scene.things import SEMANTIC_IDS
from tests.validate.faults import Fault, in_samples, of_image, of_json, of_pass, of_passes, swapped, with_shares
from tests.validate.sealing import Members

Pixels = np.ndarray


# -- pictures


def of_pixels(change: Callable[[Pixels], Pixels]) -> Callable[[Path], None]:
    """Change the image as an array of floats."""
    return of_image(
        lambda image: Image.fromarray(np.clip(change(np.asarray(image).astype(float)), 0, 255).astype("u1"))
    )


def by_ids(change: Callable[[Pixels, dict[str, Pixels], Labels], Pixels]) -> Callable[[Path], None]:
    """Change the image where its passes say what it shows."""

    def spoil(members: Members) -> None:
        name, labels = next(iter(members)), labels_module.from_json(members[LABELS], LABELS)
        image = change(decode_image(members[name], name).copy(), read_passes(members[PASSES], PASSES), labels)
        members[name] = encode_image(image, name)

    return in_samples(spoil)


def turned_hue(image: Image.Image) -> Image.Image:
    """All hues by a sixth of the circle."""
    hue, saturation, value = image.convert("HSV").split()
    return Image.merge("HSV", (hue.point(lambda h: (h + 43) % 256), saturation, value)).convert("RGB")


def with_black_block(pixels: Pixels) -> Pixels:
    """A block of 3 % of the picture black, in its lower half."""
    height, width = pixels.shape[:2]
    rows, columns = round(height * 0.15), round(width * 0.2)
    pixels = pixels.copy()
    pixels[-rows - height // 8 : -height // 8, width // 3 : width // 3 + columns] = 0
    return pixels


def without_paint(image: Pixels, passes: dict[str, Pixels], labels: Labels, only: int | None = None) -> Pixels:
    """Paint, of all lines or of the nth, as gray as the road."""
    road = np.median(image[passes["semantic"] == SEMANTIC_IDS["road"]], axis=0)
    at = passes["semantic"] == SEMANTIC_IDS["marking"]
    if only is not None:
        ids, n = np.unique(passes["instance"][at], return_counts=True)
        at = passes["instance"] == ids[np.argsort(-n)][min(only, len(ids) - 1)]
    grown = at | np.roll(at, 1, axis=1) | np.roll(at, -1, axis=1)
    image[grown] = road
    return image


def a_line_as_road(passes: dict[str, Pixels], _: Labels) -> dict[str, Pixels]:
    """The line with most pixels as road."""
    at = passes["instance"] == most_seen("delimiter", passes)
    semantic = np.where(at, SEMANTIC_IDS["road"], passes["semantic"]).astype("u1")
    return {**passes, "semantic": semantic, "instance": np.where(at, 0, passes["instance"]).astype("u2")}


def most_seen(kind: str, passes: dict[str, Pixels]) -> int:
    """The id of a kind with most pixels; -1 without any."""
    ids, n = np.unique(passes["instance"], return_counts=True)
    n = n * (numbers_of(kind, ids.astype(int)) >= 0)
    return int(ids[n.argmax()]) if n.any() else -1


def a_car_farther(passes: dict[str, Pixels], _: Labels) -> dict[str, Pixels]:
    """The depth of the car with most pixels 3 % more."""
    at = passes["instance"] == most_seen("car", passes)
    return {**passes, "depth": np.where(at, passes["depth"] * 1.03, passes["depth"]).astype("f4")}


def in_other_paint(image: Pixels, passes: dict[str, Pixels], labels: Labels) -> Pixels:
    """White lines yellow."""
    lines = [lane for lane in labels.lanes if lane.kind == "delimiter"]
    for i, lane in enumerate(lines):
        at = passes["instance"] == instance_id("delimiter", i)
        if lane.color == "white":
            image[at] = (image[at] * [1, 0.85, 0.35]).astype("u1")
    return image


# -- passes, labels, sweeps


def one_row_off(members: Members) -> None:
    """The height map a row farther."""
    height_m = read_passes(members[HEIGHT], HEIGHT)["height"]
    members[HEIGHT] = write_passes({"height": np.roll(height_m, -1, axis=0)})


def lifted(members: Members) -> None:
    """The height map 3 cm up."""
    height_m = read_passes(members[HEIGHT], HEIGHT)["height"]
    members[HEIGHT] = write_passes({"height": height_m + np.float32(0.03)})


def rounded(depth_m: Pixels, _: Labels) -> Pixels:
    """Depth in steps of 5 cm."""
    return np.asarray(np.where(np.isfinite(depth_m), np.round(depth_m * 20) / 20, depth_m).astype(np.float32))


def a_point_on(document: dict[str, Any]) -> None:
    """Every `object_visible` moved by a point."""
    for lane in document["lanes"]:
        lane["object_visible"] = lane["object_visible"][-1:] + lane["object_visible"][:-1]


def more_visible(document: dict[str, Any]) -> None:
    """Every `car_visible_fraction` 0.08 more."""
    with_shares(lambda shares: [min(1.0, round(share + 0.08, 3)) for share in shares])(document)


def undirected(document: dict[str, Any]) -> None:
    """Lanes without their directions."""
    for lane in document["lanes"]:
        lane.pop("direction", None)


def without_symbols(passes: dict[str, Pixels], _: Labels) -> dict[str, Pixels]:
    """Symbols as road."""
    at = passes["semantic"] == SEMANTIC_IDS["symbol"]
    semantic = np.where(at, SEMANTIC_IDS["road"], passes["semantic"]).astype("u1")
    return {**passes, "semantic": semantic, "instance": np.where(at, 0, passes["instance"]).astype("u2")}


def with_a_hole(passes: dict[str, Pixels], _: Labels) -> dict[str, Pixels]:
    """The sky at one pixel of the nearest road."""
    at = tuple(np.argwhere(passes["semantic"] == SEMANTIC_IDS["road"])[-1])
    holed = {name: values.copy() for name, values in passes.items()}
    for name, values in holed.items():
        values[at] = np.inf if name == "depth" else 0
    return holed


def without_bonnet(passes: dict[str, Pixels], _: Labels) -> dict[str, Pixels]:
    """The bonnet as road."""
    at = passes["semantic"] == SEMANTIC_IDS["host"]
    semantic = np.where(at, SEMANTIC_IDS["road"], passes["semantic"]).astype("u1")
    return {**passes, "semantic": semantic, "instance": np.where(at, 0, passes["instance"]).astype("u2")}


def of_sweep(change: Callable[[Sweep], Sweep]) -> Callable[[Path], None]:
    """Change the sweep."""

    def spoil(members: Members) -> None:
        lidar = labels_module.from_json(members[LABELS], LABELS).lidar
        assert lidar is not None
        members[LIDAR] = write_sweep(change(read_sweep(members[LIDAR], LIDAR, lidar)))

    return in_samples(spoil)


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
    quarter = sweep.range_m.shape[1] // 4
    ids = sweep.instance.copy()
    behind = np.ones(ids.shape, dtype=bool)
    behind[:, quarter:-quarter] = False
    at = behind & (sweep.semantic == SEMANTIC_IDS["car"]) & (numbers_of("car", ids) >= 0)
    ids[at] += 1
    return replace(sweep, instance=ids)


# -- road works


def is_temporary(lane: dict[str, Any]) -> bool:
    """Whether a lane of labels is a line that holds along works alone."""
    return bool(lane["id"].startswith("works_line"))


def where_they_were(document: dict[str, Any]) -> None:
    """Temporary lines labelled a metre aside, where the removed ones are."""
    for lane in filter(is_temporary, document["lanes"]):
        lane["xyz_cam"] = [[round(x + 1.0, 4), y, z] for x, y, z in lane["xyz_cam"]]


def as_usual_lines(document: dict[str, Any]) -> None:
    """Temporary lines labelled as white."""
    for lane in filter(is_temporary, document["lanes"]):
        lane["color"] = "white"


def unlabelled(document: dict[str, Any]) -> None:
    """Temporary lines without labels."""
    document["lanes"] = [lane for lane in document["lanes"] if not is_temporary(lane)]


def without_temporary_lines(passes: dict[str, Pixels], labels: Labels) -> dict[str, Pixels]:
    """Temporary lines as road."""
    lines = [lane.id for lane in labels.lanes if lane.kind == "delimiter"]
    own = [instance_id("delimiter", i) for i, name in enumerate(lines) if name.startswith("works_line")]
    at = np.isin(passes["instance"], own)
    semantic = np.where(at, SEMANTIC_IDS["road"], passes["semantic"]).astype("u1")
    return {**passes, "semantic": semantic, "instance": np.where(at, 0, passes["instance"]).astype("u2")}


def device_aside(document: dict[str, Any]) -> None:
    """The cone or barrel with most pixels labelled half a metre aside."""
    devices = [item for item in document["objects"] if item["category"] in ("cone", "barrel")]
    if devices:
        seen = [item["seen_box_px"] or [0, 0, 0, 0] for item in devices]
        device = devices[int(np.argmax([(x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in seen]))]
        device["center_cam"][0] = round(device["center_cam"][0] + 0.5, 4)


# -- files


def reorder_index(root: Path) -> None:
    """The index with its rows from last to first."""
    path = root / "train/00000.parquet"
    rows = pq.read_table(path)
    pq.write_table(rows.take(list(range(rows.num_rows))[::-1]), path)


def edit_readme(root: Path) -> None:
    """Another number of rays in README.md."""
    path = root / "README.md"
    path.write_text(path.read_text().replace("Synthetic 3D lanes", "Synthetic 4D lanes"))


def edit_croissant(root: Path) -> None:
    """A shard less in croissant.json."""
    path = root / "croissant.json"
    path.write_text(path.read_text().replace("train/00000.tar", "train/00001.tar"))


SUBTLE = [
    Fault("car_visible_fraction + 0.08", of_json(LABELS, more_visible), "car_visible_fraction"),
    Fault("image red and green swapped", of_pixels(lambda p: p[..., [1, 0, 2]]), "red over green"),
    Fault("image with its hue turned", of_image(turned_hue), "image: expected (grass|leaves|red)"),
    Fault("image four times darker", of_pixels(lambda p: p / 4), "expected daylight"),
    Fault("passes without one line", of_passes(a_line_as_road), "of the line in all of its paint"),
    Fault("depth of a car 3 % more", of_passes(a_car_farther), "pixels of car|pixels in its box|its pixels"),
    Fault("image gray", of_image(lambda i: i.convert("L").convert("RGB")), "of blue over the road"),
    Fault("image with a black block of 3 %", of_pixels(with_black_block), "of the picture black"),
    Fault("image mirrored", of_pixels(lambda p: p[:, ::-1]), "image: expected (edges|paint|its|the line)"),
    Fault("all paint erased", by_ids(without_paint), "of paint brighter"),
    Fault("paint of one line erased", by_ids(partial(without_paint, only=0)), "of paint brighter"),
    Fault("white lines yellow", by_ids(in_other_paint), "expected white paint, got yellow"),
    Fault("depth rounded to 5 cm", of_pass("depth", rounded), "the pavement within"),
    Fault(
        "depth 1 cm too long", of_pass("depth", lambda depth_m, _: depth_m + np.float32(0.01)), "the pavement within"
    ),
    Fault(
        "depth in millimetres",
        of_pass("depth", lambda depth_m, _: depth_m * np.float32(1000)),
        "depth: expected pixels at lines within",
    ),
    Fault("a hole in the ground", of_passes(with_a_hole), "sky at 1 pixels"),
    Fault("height map 3 cm up", in_samples(lifted), "got 2858 of 2858 elsewhere"),
    Fault("height map one row off", in_samples(one_row_off), "cells on the scene's ground"),
    Fault("rows of the index reordered", reorder_index, "in the order of their samples"),
    Fault("README.md edited", edit_readme, "expected what dataset.json gives"),
    Fault("croissant.json edited", edit_croissant, "expected what dataset.json gives"),
]

OF_STREETS = [
    Fault("object_visible moved by a point", of_json(LABELS, a_point_on), "object_visible: expected what the passes"),
    Fault("directions removed", of_json(LABELS, undirected), 'direction: expected "oncoming"'),
    Fault("poles and signs swapped", of_pass("semantic", partial(swapped, "pole", "sign")), "on faces of (pole|sign)"),
    Fault(
        "barriers and kerbs swapped",
        of_pass("semantic", partial(swapped, "barrier", "kerb")),
        "on faces of (barrier|kerb)",
    ),
    Fault("symbols missing", of_passes(without_symbols), "in all of its paint", True),
    Fault("bonnet missing", of_passes(without_bonnet), "expected the bonnet", True),
    Fault("rear half of the sweep three columns on", of_sweep(rear_turned), "lidar"),
    Fault("ids of the next car behind the host", of_sweep(other_cars_behind), "lidar: expected points of car"),
]

OF_WORKS = [
    Fault("works: lines labelled where they were before", of_json(LABELS, where_they_were), "xyz_cam.0.0: expected"),
    Fault("works: yellow lines labelled white", of_json(LABELS, as_usual_lines), 'color: expected "yellow"'),
    Fault("works: lines without labels", of_json(LABELS, unlabelled), "(lanes|left|right): expected"),
    Fault("works: passes without the lines", of_passes(without_temporary_lines), "of the line in all of its paint"),
    Fault("works: a cone labelled 0.5 m aside", of_json(LABELS, device_aside), "center_cam.0: expected|in its box"),
]
