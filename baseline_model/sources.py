"""Open labelled images by path: a split of our dataset, or of Apollo Sim-3D, OpenLane or tuSimple."""

import hashlib
import json
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from synth3dlanes.dataset.address import SAMPLE
from synth3dlanes.dataset.description import clip_of, pictures_per_scene
from synth3dlanes.dataset.format import Sample
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rectify import rectified_image, rectified_labels
from synth3dlanes.dataset.splits import has_split, one_reader, only_split
from synth3dlanes.formats.apollo import ApolloSplit
from synth3dlanes.formats.openlane import OpenLaneSplit, is_openlane
from synth3dlanes.formats.reading import ForeignSample
from synth3dlanes.formats.tusimple import TusimpleSplit, find_labels
from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.words import counted

from .data import FocalLengths, LabelledImage, Samples, intrinsics_of, scale
from .tusimple import TusimpleOnPlane

ROLL = "camera_roll_rad"
MEASURED = 200


@dataclass(frozen=True, eq=False)
class Subset:
    """Some samples of a source, by index, read on access."""

    source: Samples
    index: Sequence[int]

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, at: int) -> LabelledImage:
        return self.source[self.index[at]]

    def digest(self) -> str | None:
        """What the samples are, as far as the source can tell."""
        whole = digest_of(self.source)
        return None if whole is None else _hash(whole.encode(), str(self.index).encode())


@dataclass(frozen=True, eq=False)
class Together:
    """The samples of several sources, one source after the other; their keys begin with the name of the source."""

    sources: Sequence[Samples]
    names: Sequence[str]

    @cached_property
    def ends(self) -> list[int]:
        """The number of samples up to the end of each source."""
        return list(accumulate(map(len, self.sources)))

    def __len__(self) -> int:
        return self.ends[-1]

    def __getitem__(self, at: int) -> ForeignSample:
        number, index = self.place(at)
        sample = self.sources[number][index]
        return ForeignSample(f"{self.names[number]}:{sample.key}", sample.image, sample.labels)

    def place(self, at: int) -> tuple[int, int]:
        """The number of the source that has a sample, and the sample's index there."""
        number = bisect_right(self.ends, at)
        return number, at - (self.ends[number - 1] if number else 0)

    def digest(self) -> str | None:
        """What the samples are, as far as the sources can tell."""
        known = [whole for whole in map(digest_of, self.sources) if whole is not None]
        return _hash(*map(str.encode, known)) if len(known) == len(self.sources) else None


@dataclass(frozen=True, eq=False)
class UprightSamples:
    """A split of our dataset as pinholes without roll have it: the pose that a network learns has no roll, and its view
    from above no lens. Of a rig's cameras it has those that look ahead."""

    reader: Reader

    @cached_property
    def places(self) -> Int[np.ndarray, " n"]:
        """Where its samples are in the reader."""
        return self.reader.taken_by()

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> Sample:
        sample = self.reader[int(self.places[index])]
        image = rectified_image(sample.image, sample.labels.camera)
        return replace(sample, image=image, labels=rectified_labels(sample.labels))

    def key(self, index: int) -> str:
        """The sample's key, from the index alone."""
        return self.reader.key(int(self.places[index]))

    def labels(self, index: int) -> Labels:
        """The labels, without decoding the image."""
        return rectified_labels(self.reader.labels(int(self.places[index])))

    def image(self, index: int) -> RgbImage:
        """The image; labels are read only where the camera is rolled or has a lens."""
        place = int(self.places[index])
        image = self.reader.image(place)
        return image if self._is_level[place] else rectified_image(image, self.reader.labels(place).camera)

    def digest(self) -> str:
        """What the samples are: equal recipes give equal samples, and `dataset.json` has the recipe."""
        recipe = json.dumps({**self.reader.description, "splits": None}, sort_keys=True)
        places = (column.to_numpy().tobytes() for column in self.reader.index.drop_columns(["key"]).columns)
        return _hash(self.reader.url.encode(), recipe.encode(), *places)

    @cached_property
    def _is_level(self) -> Bool[np.ndarray, " n"]:
        has_lens = any(camera.model != "pinhole" for camera in self.reader.cameras)
        return np.asarray((self.reader.index[ROLL].to_numpy() == 0) & (not has_lens))


def open_split(path: str | Path) -> Samples:
    """Random access to labelled images. A split of ours is `DIR/SPLIT`, or DIR if it is the only one;
    `DIR/SPLIT:17` is one of its samples. A split of Apollo or tuSimple is its JSON-lines file (Apollo's images are in a
    folder above it); one of OpenLane is `.../lane3d_1000/SPLIT`, beside `.../images`."""
    samples = _opened(str(path))
    if not len(samples):
        raise FormatError(f"{path}: expected labelled images, got none")
    return samples


def _opened(text: str) -> Samples:
    if "://" not in text:
        path = Path(text)
        labels = find_labels(path)
        if labels is not None:
            return TusimpleOnPlane(TusimpleSplit(labels))
        if text.endswith(".json"):
            return ApolloSplit(path)
        if is_openlane(path):
            return OpenLaneSplit(path)
    samples = UprightSamples(one_reader(split_of(text), columns=(ROLL,)))
    if not SAMPLE.fullmatch(text):
        return samples
    place = samples.reader.position(text.rpartition(":")[2])
    chosen = np.flatnonzero(samples.places == place).tolist()
    if not chosen:
        raise InputError(f"{text}: expected a sample of a camera that looks ahead, got another")
    return Subset(samples, chosen)


def split_of(source: str) -> str:
    """`DIR/SPLIT` for a sample, or a data set of ours with one split; other sources as they are."""
    return only_split(source.rpartition(":")[0] if SAMPLE.fullmatch(source) else source)


def training_and_validation(
    data_dirs: str | Sequence[str], train_split: str, val_split: str, max_images: int | None
) -> tuple[Samples, Samples]:
    """Training and validation splits of one data set or several (folders or URLs), of each at most `max_images`
    training images. Where a data set has no `val_split`, every tenth scene of its training split is held out; below ten
    scenes, validation uses all of them."""
    dirs = [data_dir.rstrip("/") for data_dir in ([data_dirs] if isinstance(data_dirs, str) else data_dirs)]
    if len(set(dirs)) < len(dirs):
        raise InputError(f"data sets: expected each once, got {', '.join(dirs)}")
    pairs = [_training_and_validation(data_dir, train_split, val_split, max_images) for data_dir in dirs]
    if len(pairs) == 1:
        return pairs[0]
    train, val = zip(*pairs, strict=True)
    return (
        Together(train, [f"{data_dir}/{train_split}" for data_dir in dirs]),
        Together(val, [f"{data_dir}/{val_split}" for data_dir in dirs]),
    )


def _training_and_validation(
    data_dir: str, train_split: str, val_split: str, max_images: int | None
) -> tuple[Samples, Samples]:
    train = open_split(f"{data_dir}/{train_split}")
    n = len(train) if max_images is None else min(max_images, len(train))
    if has_split(data_dir, val_split):
        return Subset(train, range(n)), open_split(f"{data_dir}/{val_split}")
    _, number = np.unique(_scenes(train)[:n], return_inverse=True)
    if number[-1] < 9:
        return Subset(train, range(n)), Subset(train, range(n))
    is_held_out = number % 10 == 9
    return Subset(train, np.flatnonzero(~is_held_out).tolist()), Subset(train, np.flatnonzero(is_held_out).tolist())


def _scenes(samples: Samples) -> Int[np.ndarray, " n"]:
    """The number of the scene that each sample shows; a clip has several."""
    return samples.reader.scene_of[samples.places] if isinstance(samples, UprightSamples) else np.arange(len(samples))


def describe(validation: Samples) -> str:
    """What `training_and_validation` chose for validation."""
    if isinstance(validation, Together):
        parts = zip(validation.names, validation.sources, strict=True)
        return "; ".join(f"{name}: {describe(source)}" for name, source in parts)
    what = counted(len(validation), "image")
    if not isinstance(validation, Subset):
        return what
    return f"{what} of the training split, as there is no validation split"


def focal_lengths(samples: Samples, size_px: tuple[int, int]) -> FocalLengths:
    """The focal lengths of at most MEASURED samples, evenly chosen, in images of `size_px` (height, width)."""
    focal_px = []
    for index in np.linspace(0, len(samples) - 1, min(MEASURED, len(samples))).astype(int).tolist():
        labels = labels_at(samples, index)
        fx, fy, _, _ = scale(intrinsics_of(labels), (labels.camera.height_px, labels.camera.width_px), size_px)
        focal_px.append((fx, fy))
    fx_px, fy_px = np.array(focal_px).T
    return FocalLengths(float(fx_px.min()), float(fx_px.max()), float(np.median(fy_px / fx_px)))


def clip_rate_hz(samples: Samples) -> float | None:
    """Frames a second of a split of clips by one camera; None for other samples."""
    if not isinstance(samples, UprightSamples):
        return None
    description = samples.reader.description
    n_frames, fps = clip_of(description)
    return fps if pictures_per_scene(description) == n_frames > 1 else None


def key_at(samples: Samples, index: int) -> str:
    """The key of a sample, without reading it if the source allows that."""
    return str(_alone(samples, "key", index))


def labels_at(samples: Samples, index: int) -> Labels:
    """The labels of a sample, without reading its image if the source allows that."""
    labels: Labels = _alone(samples, "labels", index)
    return labels


def image_at(samples: Samples, index: int) -> RgbImage:
    """The image of a sample, without reading its labels if the source allows that."""
    image: RgbImage = _alone(samples, "image", index)
    return image


def digest_of(samples: Samples) -> str | None:
    """What the samples are, by their recipe and places; None where the source cannot tell."""
    digest = getattr(samples, "digest", None)
    return None if digest is None else digest()


def _alone(samples: Samples, part: str, index: int) -> Any:
    if isinstance(samples, Subset):
        return _alone(samples.source, part, samples.index[index])
    if isinstance(samples, Together):
        number, index = samples.place(index)
        found = _alone(samples.sources[number], part, index)
        return f"{samples.names[number]}:{found}" if part == "key" else found
    read = getattr(samples, part, None)
    return getattr(samples[index], part) if read is None else read(index)


def _hash(*parts: bytes) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(hashlib.sha256(part).digest())
    return found.hexdigest()
