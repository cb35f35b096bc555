"""Samples as they are made again: on another machine, and of other scenes."""

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from synth3dlanes.dataset.format import (
    HEIGHT,
    LABELS,
    LIDAR,
    PASSES,
    Picture,
    decode_image,
    read_passes,
    read_sweep,
    write_passes,
)
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.scene.scene import Scene
from tests.validate.sealing import Members


def picture_of(members: Members) -> Picture:
    """The picture that was encoded as these members."""
    labels = labels_module.from_json(members[LABELS], LABELS)
    passes = read_passes(members[PASSES], PASSES) | read_passes(members[HEIGHT], HEIGHT)
    sweep = read_sweep(members[LIDAR], LIDAR, labels.lidar) if LIDAR in members else None
    return Picture(decode_image(members["jpg"], "jpg"), labels, passes, sweep)


# -- other scenes


def each(path: str, parts: Sequence[Any], change: Callable[[Any], dict[str, Any]]) -> list[str]:
    """A change of every part of a tuple of the scene."""
    return [f"{path}.{i}.{name}={value}" for i, part in enumerate(parts) for name, value in change(part).items()]


def other_arrow(symbol: Any) -> dict[str, str]:
    is_arrow = symbol.kind.startswith("arrow")
    return {"kind": "arrow_right" if symbol.kind == "arrow_left" else "arrow_left"} if is_arrow else {}


def other_face(post: Any) -> dict[str, int]:
    return {"face": (post.face + 3) % 8 + 1} if post.kind == "sign" else {}


# Changes of a scene whose picture and passes then lie beside the labels of the first.
WORLDS: dict[str, Callable[[Scene], list[str]]] = {
    "the left line's colour": lambda s: [
        f"markings.left_yellow={'false' if s.markings.left_yellow else 'true'}",
    ],
    "cars 0.3 m on": lambda s: each("cars", s.cars, lambda car: {"s_m": car.s_m + 0.3}),
    "other colours of cars": lambda s: each(
        "cars", s.cars, lambda car: {"color": [0.6, 0.05, 0.05] if car.color[0] < 0.4 else [0.05, 0.1, 0.5]}
    ),
    "rails 15 % higher": lambda s: each(
        "roadside.rails", s.roadside.rails, lambda rail: {"height_m": 1.15 * rail.height_m}
    ),
    "buildings 10 % higher": lambda s: each(
        "roadside.buildings", s.roadside.buildings, lambda house: {"height_m": 1.1 * house.height_m}
    ),
    "trees 10 % larger": lambda s: each("trees", s.trees, lambda tree: {"scale": 1.1 * tree.scale}),
    "trees turned": lambda s: each("trees", s.trees, lambda tree: {"yaw_rad": (tree.yaw_rad + 1) % 6.28}),
    "the sun 90 degrees off": lambda s: [f"light.sun_azimuth_rad={(s.light.sun_azimuth_rad + 1.5708) % 6.2831}"],
    "exposure x 1.3": lambda s: [f"light.exposure={1.3 * s.light.exposure}"],
    "other faces of signs": lambda s: each("roadside.posts", s.roadside.posts, other_face),
    "dashes 20 % shorter": lambda s: [f"markings.dash_fraction={0.8 * s.markings.dash_fraction}"],
    "arrows elsewhere": lambda s: each("symbols", s.symbols, other_arrow),
}


# -- another machine


def other_rounding(members: Members) -> None:
    """Depths, heights and points rounded otherwise, a few pixels that see the other side of a seam, a point that
    grazes."""
    random = np.random.default_rng(1)
    passes = read_passes(members[PASSES], PASSES)
    depth_m = passes["depth"] * (1 + 1e-6 * random.normal(size=passes["depth"].shape)).astype(np.float32)
    is_other = random.random(depth_m.shape) < 5e-4
    other = {
        name: np.where(is_other, np.roll(passes[name], 1, axis=1), passes[name]) for name in ("semantic", "instance")
    }
    members[PASSES] = write_passes({**passes, **other, "depth": depth_m.astype(np.float32)})
    height_m = read_passes(members[HEIGHT], HEIGHT)["height"]
    members[HEIGHT] = write_passes({"height": height_m + np.float32(1e-5)})
    document = json.loads(members[LABELS])
    document["lanes"][0]["xyz_cam"][0][1] += 1e-4
    seen = next(lane["object_visible"] for lane in document["lanes"] if sum(lane["object_visible"]) > 0)
    seen[seen.index(1)] = 0
    members[LABELS] = json.dumps(document, separators=(",", ":")).encode()
