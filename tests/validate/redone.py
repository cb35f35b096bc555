"""Faults that making a sample again finds: what is done to its members, and a pattern that a line must match."""

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt, uniform_filter

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
    write_sweep,
)
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.scene.instance_ids import numbers_of
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import SEMANTIC_IDS
from tests.validate.faults import with_shares
from tests.validate.sealing import Members

Change = Callable[[Members], None]
# Of JPEG as the scene asks for it.
QUALITY = 95


class Done(NamedTuple):
    """What is done to a sample's members (nothing where they have nothing of the kind), and a pattern that a fault must
    match."""

    change: Change
    words: str


def picture_of(members: Members) -> Picture:
    """The picture that was encoded as these members."""
    labels = labels_module.from_json(members[LABELS], LABELS)
    passes = read_passes(members[PASSES], PASSES) | read_passes(members[HEIGHT], HEIGHT)
    sweep = read_sweep(members[LIDAR], LIDAR, labels.lidar) if LIDAR in members else None
    return Picture(decode_image(members["jpg"], "jpg"), labels, passes, sweep)


# -- pictures


def of_image(change: Callable[[np.ndarray, dict[str, np.ndarray]], np.ndarray], quality: int = QUALITY) -> Change:
    """Change the picture's levels, with the passes at hand; encoded as the scene's JPEG is."""

    def spoil(members: Members) -> None:
        passes = read_passes(members[PASSES], PASSES)
        before = Image.open(io.BytesIO(members["jpg"]))
        after = change(np.asarray(before).astype(float), passes)
        if quality == QUALITY and np.array_equal(after, np.asarray(before)):
            return
        stream = io.BytesIO()
        image = Image.fromarray(np.clip(np.round(after), 0, 255).astype(np.uint8))
        tables = {"quality": quality} if quality != QUALITY else {"qtables": before.quantization}
        image.save(stream, "JPEG", **tables)
        members["jpg"] = stream.getvalue()

    return spoil


def hue_turned(image: np.ndarray, _: Any) -> np.ndarray:
    hsv = np.array(Image.fromarray(image.astype(np.uint8)).convert("HSV"))
    hsv[..., 0] += np.uint8(25)
    return np.array(Image.fromarray(hsv, "HSV").convert("RGB"))


def gray(image: np.ndarray, _: Any) -> np.ndarray:
    return np.repeat(np.array(Image.fromarray(image.astype(np.uint8)).convert("L"))[..., None], 3, axis=-1)


def block(image: np.ndarray, _: Any) -> np.ndarray:
    """A black block of 3 % of the picture."""
    height, width, _c = image.shape
    tall, wide = round(0.17 * height), round(0.17 * width)
    image[height // 2 : height // 2 + tall, width // 3 : width // 3 + wide] = 0
    return image


def noisy(image: np.ndarray, _: Any) -> np.ndarray:
    return image + np.random.default_rng(1).normal(0, 8, image.shape)


def lower_half_aside(image: np.ndarray, _: Any) -> np.ndarray:
    half = len(image) // 2
    image[half:] = np.roll(image[half:], 2, axis=1)
    return image


def at(kind: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray, Any], np.ndarray]:
    """Change colours at the pixels of a semantic class."""

    def spoil(image: np.ndarray, passes: dict[str, np.ndarray]) -> np.ndarray:
        here = passes["semantic"] == SEMANTIC_IDS[kind]
        image[here] = change(image[here])
        return image

    return spoil


def white_and_yellow(colours: np.ndarray) -> np.ndarray:
    """Yellow paint gets its blue from its red, other paint less."""
    is_yellow = colours[:, 2] < 0.7 * colours[:, 0]
    blue = np.where(is_yellow, 0.97 * colours[:, 0], 0.3 * colours[:, 2])
    return np.stack([colours[:, 0], np.where(is_yellow, colours[:, 0], 0.8 * colours[:, 1]), blue], axis=-1)


def erased(which: Callable[[np.ndarray], np.ndarray], image: np.ndarray, passes: dict[str, np.ndarray]) -> np.ndarray:
    """Lines painted over with what is beside them; `which` chooses from the ids that are seen, the largest first."""
    lines = passes["instance"] * (passes["semantic"] == SEMANTIC_IDS["marking"])
    ids, counts = np.unique(lines[lines > 0], return_counts=True)
    here = np.isin(lines, which(ids[np.argsort(-counts)]))
    is_paint = uniform_filter((lines > 0).astype(float), 3) > 0.05
    row, column = distance_transform_edt(is_paint, return_distances=False, return_indices=True)
    wide = uniform_filter(here.astype(float), 3) > 0.05
    return np.where(wide[..., None], image[row, column], image)


def enlarged(image: np.ndarray, _: Any) -> np.ndarray:
    height, width, _c = image.shape
    box = (width * 0.0025, height * 0.0025, width * 0.9975, height * 0.9975)
    return np.array(Image.fromarray(image.astype(np.uint8)).resize((width, height), Image.Resampling.BICUBIC, box=box))


# Faults of the picture: all are told of the layer `image`.
PICTURES = {
    "red and green swapped": of_image(lambda i, _: i[..., [1, 0, 2]]),
    "blue and red swapped": of_image(lambda i, _: i[..., ::-1]),
    "hue turned": of_image(hue_turned),
    "gray": of_image(gray),
    "a black block of 3 %": of_image(block),
    "gamma 1.1": of_image(lambda i, _: 255 * (i / 255) ** 1.1),
    "20 % darker": of_image(lambda i, _: 0.8 * i),
    "half the contrast": of_image(lambda i, _: i.mean() + 0.5 * (i - i.mean())),
    "noise": of_image(noisy),
    "lower half 2 px aside": of_image(lower_half_aside),
    "mirrored": of_image(lambda i, _: i[:, ::-1]),
    "upside down": of_image(lambda i, _: i[::-1]),
    "enlarged by 0.5 %": of_image(enlarged),
    "JPEG of quality 25": of_image(lambda i, _: i, quality=25),
    "cars' red and blue swapped": of_image(at("car", lambda c: c[:, ::-1])),
    "yellow lines white, white ones yellow": of_image(at("marking", white_and_yellow)),
    "paint of one line erased": of_image(partial(erased, lambda ids: ids[:1])),
    "every second line erased": of_image(partial(erased, lambda ids: ids[::2])),
    "all paint erased": of_image(partial(erased, lambda ids: ids)),
}

# -- passes


def of_pass(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def spoil(members: Members) -> None:
        member = HEIGHT if name == "height" else PASSES
        passes = read_passes(members[member], member)
        members[member] = write_passes({**passes, name: change(passes[name])})

    return spoil


def exchanged(a: str, b: str, ids: np.ndarray) -> np.ndarray:
    one, other = SEMANTIC_IDS[a], SEMANTIC_IDS[b]
    return np.where(ids == one, other, np.where(ids == other, one, ids)).astype(ids.dtype)


def rounded(step_m: float, depth_m: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(depth_m), np.round(depth_m / step_m) * step_m, depth_m).astype(np.float32)


LAYERS = {
    "poles and signs swapped": Done(of_pass("semantic", partial(exchanged, "pole", "sign")), "semantic: "),
    "barriers and kerbs swapped": Done(of_pass("semantic", partial(exchanged, "barrier", "kerb")), "semantic: "),
    "cars and trees swapped": Done(of_pass("semantic", partial(exchanged, "car", "tree")), "semantic: "),
    "ids of trees one higher": Done(
        of_pass("instance", lambda i: (i + (numbers_of("tree", i) >= 0)).astype(i.dtype)), "instance: "
    ),
    "depth rounded to 5 cm": Done(of_pass("depth", partial(rounded, 0.05)), "depth: "),
    "depth 1 cm too long": Done(of_pass("depth", lambda d: d + np.float32(0.01)), r"depth: .*0\.01 m in the median"),
    "depth x 1.005": Done(of_pass("depth", lambda d: d * np.float32(1.005)), "depth: "),
    "depth mirrored": Done(of_pass("depth", lambda d: d[:, ::-1]), "depth: "),
    "normals in another frame": Done(of_pass("normal", lambda n: n[..., [0, 2, 1]]), "normal: "),
    "height map 3 cm up": Done(of_pass("height", lambda h: h + np.float32(0.03)), r"height: .*0\.03 m in the median"),
    "height map a row off": Done(of_pass("height", lambda h: np.roll(h, 1, axis=0)), "height: "),
}


def of_sweep(change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> Change:
    def spoil(members: Members) -> None:
        if LIDAR in members:
            lidar = labels_module.from_json(members[LABELS], LABELS).lidar
            sweep = read_sweep(members[LIDAR], LIDAR, lidar)
            names = ("range_m", "semantic", "instance")
            members[LIDAR] = write_sweep(replace(sweep, **change({name: getattr(sweep, name) for name in names})))

    return spoil


def is_behind(columns: int) -> np.ndarray:
    return abs(np.arange(columns) - (columns - 1) / 2) > columns / 4


def rear_turned(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {
        name: np.where(is_behind(pixels.shape[1]), np.roll(pixels, 3, axis=1), pixels)
        for name, pixels in channels.items()
    }


def other_cars_behind(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    ids = channels["instance"]
    is_car = (numbers_of("car", ids) >= 0) & is_behind(ids.shape[1])
    return {**channels, "instance": np.where(is_car, ids + 1, ids).astype(ids.dtype)}


SWEEPS = {
    "rear half turned by three columns": Done(of_sweep(rear_turned), "lidar range: "),
    "ids of cars behind": Done(of_sweep(other_cars_behind), "lidar instance: "),
    "ranges 2 cm too long": Done(
        of_sweep(lambda c: {**c, "range_m": c["range_m"] + np.float32(0.02) * (c["range_m"] < 190)}),
        r"lidar range: .*0\.02 m in the median",
    ),
}

# -- labels


def of_labels(change: Callable[[dict[str, Any]], object]) -> Change:
    def spoil(members: Members) -> None:
        document = json.loads(members[LABELS])
        change(document)
        members[LABELS] = json.dumps(document, separators=(",", ":")).encode()

    return spoil


def shifted(document: dict[str, Any]) -> None:
    for lane in document["lanes"]:
        lane["object_visible"] = lane["object_visible"][:1] + lane["object_visible"][:-1]


def aside(document: dict[str, Any]) -> None:
    for point in document["lanes"][0]["xyz_cam"]:
        point[0] = round(point[0] + 0.05, 4)


def of_cars(document: dict[str, Any]) -> None:
    with_shares(lambda shares: [min(1.0, round(share + 0.08, 4)) for share in shares])(document)


def moved_symbols(document: dict[str, Any]) -> None:
    for symbol in document.get("symbols", ()):
        symbol["xyz_cam"] = [[x, round(y + 0.1, 4), z] for x, y, z in symbol["xyz_cam"]]


DOCUMENTS = {
    "direction removed": Done(
        of_labels(lambda d: [lane.pop("direction", None) for lane in d["lanes"]]),
        'lanes.0.direction: expected "(same|oncoming)", got null',
    ),
    "object_visible shifted by a point": Done(of_labels(shifted), "object_visible: expected other values"),
    "car_visible_fraction + 0.08": Done(of_labels(of_cars), "car_visible_fraction.0: expected"),
    "a line 5 cm aside": Done(of_labels(aside), "lanes.0.xyz_cam.0.0: expected"),
    "symbols 10 cm on": Done(of_labels(moved_symbols), "symbols.0.xyz_cam.0.1: expected"),
    "symbols removed": Done(of_labels(lambda d: d.update(symbols=[])), "masks: expected|symbols: expected"),
    "yellow as white": Done(
        of_labels(lambda d: [lane.update(color="white") for lane in d["lanes"] if lane.get("color") == "yellow"]),
        'color: expected "yellow", got "white"',
    ),
}

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


ALL = {name: Done(change, "image: ") for name, change in PICTURES.items()} | LAYERS | SWEEPS | DOCUMENTS
