"""From what a user types to what is there: a scene.json, `DIR/train:00000017`, or some samples of a data set.

Reads files; no Blender.
"""

import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from synth3dlanes.dataset.folder import read_description
from synth3dlanes.dataset.format import Sample, decode_image
from synth3dlanes.dataset.read import Reader, find
from synth3dlanes.errors import FormatError
from synth3dlanes.ground_truth import ground_truth
from synth3dlanes.labels import Labels
from synth3dlanes.scene import Scene, from_json


@dataclass(frozen=True, eq=False)
class Found:
    """A scene with its labels, and its image where there is one."""

    name: str
    scene: Scene
    labels: Labels
    image: UInt8[np.ndarray, "h w 3"] | None


def scene_name(path: Path) -> str:
    """What the files made from a scene are called: 00000017 for 00000017.scene.json, scene for scene.json."""
    return path.name.removesuffix(".json").removesuffix(".scene")


def load_scene(path: Path) -> Scene:
    """Read a scene.json; raise FormatError with one line per problem."""
    return from_json(path.read_bytes(), str(path))


def load_any(where: str, image_path: Path | None) -> Found:
    """Find a sample by `DIR/SPLIT:KEY`, or a scene by its file, with labels drawn from the scene alone."""
    if re.fullmatch(r".+:\d+", where):
        sample = find(where)
        return Found(sample.key, from_json(sample.scene_json, where), sample.labels, sample.image)
    scene = load_scene(Path(where))
    image = None if image_path is None else decode_image(image_path.read_bytes(), str(image_path))
    return Found(scene_name(Path(where)), scene, ground_truth(scene), image)


def some_samples(folder: str, n: int, shuffle: int | None) -> list[Sample]:
    """The first `n` samples of a split, or `n` at random by a seed; of a data set's first split where none is named."""
    if (Path(folder) / "dataset.json").exists():
        folder = f"{folder}/{next(iter(read_description(Path(folder))['splits']))}"
    elif "://" not in folder and not Path(folder).is_dir():
        raise FormatError(f"{folder}: expected a data set or one of its splits, got no folder")
    reader = Reader(folder)
    samples = iter(reader) if shuffle is None else reader.shuffled(shuffle)
    return list(islice(samples, n))
