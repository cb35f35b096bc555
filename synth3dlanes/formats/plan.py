"""Which frames an export holds, in which part of the foreign format, and in which chunks they are written."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Int

from synth3dlanes.dataset.address import SAMPLE
from synth3dlanes.dataset.description import clip_of
from synth3dlanes.dataset.read import Reader, find
from synth3dlanes.dataset.splits import readers, split_name
from synth3dlanes.formats.writing import PARTS, Part
from synth3dlanes.system.errors import InputError

FRAMES_PER_CHUNK = 50
DEALT_EVERY = 5


@dataclass(frozen=True)
class ExportSplit:
    """A split of the data set and the part that it becomes. Where the data set has training frames only, `is_dealt`:
    those of every fifth scene are test frames."""

    name: str
    number: int
    part: Part
    is_dealt: bool

    def part_of(self, scene: int) -> Part:
        """What the frames of a scene are used for."""
        return "test" if self.is_dealt and is_test_scene(scene) else self.part


def is_test_scene(scene: int | Int[np.ndarray, " n"]) -> Any:
    """Whether a scene of this number is one of every fifth."""
    return scene % DEALT_EVERY == DEALT_EVERY - 1


@dataclass(frozen=True)
class Chunk:
    """Some frames of one split, by their places in it. `mark` names the file that says that the chunk is done; it
    depends on the frames' bytes, so a chunk of other frames is a new one. `parts` are all that the data set has;
    `cameras` are those that were asked for. `firsts` are the places of the first exported pictures of scenes."""

    source: str
    split: ExportSplit
    parts: frozenset[Part]
    places: tuple[int, ...]
    mark: str
    cameras: tuple[str, ...]
    firsts: frozenset[int]

    @property
    def url(self) -> str:
        return f"{self.source}/{self.split.name}"


def plan(source: str, cameras: Sequence[str] = (), is_per_scene: bool = False, takes_rigs: bool = False) -> list[Chunk]:
    """The chunks of every split under `source`, or of the one split or sample that it names; of a rig's cameras those
    that are named, or those that look ahead, or all if it `takes_rigs`. If it `is_per_scene`, only the first frame of
    each scene."""
    open_reader.cache_clear()  # what lies there may have changed since an earlier plan
    if SAMPLE.fullmatch(source):
        reader, named = find(source)
        found, moment = [reader], reader.rig(named) if takes_rigs else [named]
    else:
        found, moment = readers(source), None
    folder = found[0].url.rpartition("/")[0]
    splits = assign([split_name(reader) for reader in found])
    parts = parts_of(splits, has_test=any(is_test_scene(reader.scene_of).any() for reader in found))
    chunks = []
    for split, reader in zip(splits, found, strict=True):
        names = tuple(cameras) or (tuple(camera.name for camera in reader.cameras) if takes_rigs else ())
        taken = reader.taken_by(names) if moment is None else _of_moment(reader, moment, names)
        firsts = taken[np.unique(reader.scene_of[taken], return_index=True)[1]]
        starts = taken[_starts(reader, taken)]
        step, every = FRAMES_PER_CHUNK, taken
        if is_per_scene:
            step, taken = max(1, step * len(firsts) // max(len(taken), 1)), firsts
        for start in range(0, len(taken), step):
            places = taken[start : start + step]
            made_of = every[np.isin(reader.scene_of[every], reader.scene_of[places])] if is_per_scene else places
            mark = f"{split.name}-{reader.key(int(places[0]))}-{_digest(reader, made_of)}.jsonl"
            here = frozenset(np.intersect1d(places, starts).tolist())
            chunks.append(Chunk(folder, split, parts, tuple(places.tolist()), mark, names, here))
    return chunks


def assign(names: Sequence[str]) -> tuple[ExportSplit, ...]:
    """Splits called val... and test... keep their part; all others are training frames."""
    found: list[Part] = [next((part for part in PARTS if name.startswith(part)), "train") for name in names]
    is_dealt = set(found) == {"train"}
    return tuple(
        ExportSplit(name, number, part, is_dealt) for number, (name, part) in enumerate(zip(names, found, strict=True))
    )


def parts_of(splits: Sequence[ExportSplit], has_test: bool) -> frozenset[Part]:
    """The parts that have frames, those of dealt splits if any scene `has_test` frames."""
    dealt: set[Part] = {"test"} if has_test and any(split.is_dealt for split in splits) else set()
    return frozenset({split.part for split in splits} | dealt)


@lru_cache(maxsize=8)
def open_reader(url: str) -> Reader:
    """The reader of a split, kept open until the next plan."""
    return Reader(url)


def _starts(reader: Reader, taken: Int[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
    """Which samples come first of their clip, or, where there are no clips, of their moment: each view of a world is
    one."""
    of_clip = reader.scene_of[taken]
    frames = np.zeros(len(taken), int) if clip_of(reader.description)[0] > 1 else reader.frame_of[taken]
    return np.asarray(np.unique(np.stack([of_clip, frames]), axis=1, return_index=True)[1])


def _of_moment(reader: Reader, moment: list[int], names: Sequence[str]) -> Int[np.ndarray, " n"]:
    """The pictures of a moment that the named cameras took; all of them if no camera is named."""
    taken = np.intersect1d(moment, reader.taken_by(names)) if names else np.array(moment)
    if not len(taken):
        got = f"{reader.key(moment[0])} by {reader.camera_name(moment[0])}"
        raise InputError(f"cameras: expected that of the sample, got {', '.join(names)} for {got}")
    return taken


def _digest(reader: Reader, places: Int[np.ndarray, " n"]) -> str:
    rows = reader.index.take(places).to_pydict()
    return hashlib.sha256(repr(rows).encode()).hexdigest()[:16]
