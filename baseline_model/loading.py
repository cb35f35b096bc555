"""The data loader: examples in the order of training, read and decoded by worker processes, and kept for later epochs.

Nothing is read before it is needed, so a split may have any size. Order depends on (seed, epoch) alone, not on the
number of processes or workers, and a resumed run begins in the middle of an epoch where it stopped.
"""

import os
import struct
import tempfile
import weakref
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor

from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.files import Folder

from .config import TrainConfig
from .curves import Pose
from .data import Batch, FocalLengths, NetworkLabels, Samples, annotation_of, fit, intrinsics_of, pack, resize
from .devices import Process, free_gpu_bytes, free_memory_bytes, spare_cores
from .sources import digest_of, image_at, key_at, labels_at
from .workers import made_ahead

MEMORY_SHARE = 0.5
"""Decoded images are kept if all of them take less than this share of the free memory."""
ANNOTATIONS = "annotations.cache"
HEADER = struct.Struct("<II")
SHAPE = struct.Struct("<HHH8f")
SLOT_BYTES = 36 * 1024
"""Room for 24 curves of 112 points, of which scenes of the paper have up to 15; larger annotations are not cached. The
file is sparse, so smaller ones take less."""
VERSION = b"synth3dlanes annotations 2\n"


class Slots:
    """Records in equal slots of an open file, which is closed with this object; any process that inherits the file may
    read and write."""

    def __init__(self, file: int, slot_bytes: int, start: int = 0) -> None:
        self._file, self._slot_bytes, self._start = file, slot_bytes, start
        weakref.finalize(self, os.close, file)

    def get(self, index: int) -> bytes | None:
        """The record of a slot, None where there is none."""
        slot = os.pread(self._file, self._slot_bytes, self._start + index * self._slot_bytes)
        if len(slot) < HEADER.size:
            return None
        size, checksum = HEADER.unpack_from(slot)
        record = slot[HEADER.size : HEADER.size + size]
        return record if size and len(record) == size and zlib.crc32(record) == checksum else None

    def put(self, index: int, record: bytes) -> None:
        """Store a record if it fits into a slot and onto the disk. Nothing depends on it being stored."""
        if HEADER.size + len(record) <= self._slot_bytes:
            slot = HEADER.pack(len(record), zlib.crc32(record)) + record
            with suppress(OSError):
                os.pwrite(self._file, slot, self._start + index * self._slot_bytes)


def annotation_file(path: Path, source: str) -> Slots:
    """The annotations cached at `path`. `source` says what they were made from; those of another one are dropped."""
    header = (VERSION + source.encode()).ljust(SLOT_BYTES, b"\0")[:SLOT_BYTES]
    folder = Folder(path.parent)
    if folder.exists(path.name):
        with folder.update(path.name) as file:
            if file.read(SLOT_BYTES) == header:
                return Slots(os.dup(file.fileno()), SLOT_BYTES, SLOT_BYTES)
    folder.write(path.name, header)
    with folder.update(path.name) as file:
        return Slots(os.dup(file.fileno()), SLOT_BYTES, SLOT_BYTES)


def pixel_memory(size_px: tuple[int, int]) -> Slots:
    """Slots for decoded images of (height, width) in memory that forked processes share without each being charged for
    it; only images that are stored take some."""
    return Slots(os.memfd_create("pixels"), HEADER.size + slot_bytes_of(size_px))


def slot_bytes_of(size_px: tuple[int, int]) -> int:
    """The bytes that a decoded image of (height, width) takes."""
    return 3 * size_px[0] * size_px[1]


def to_bytes(one: NetworkLabels) -> bytes:
    """An annotation as a record."""
    lanes, points = one.visible.shape
    key = one.key.encode()
    head = SHAPE.pack(len(key), lanes, points, *one.intrinsics, *one.plane, *one.target) + key
    parts = (one.kind.astype(np.uint8), np.packbits(one.visible, axis=1), one.xyz_cam.astype("<f4"))
    return head + b"".join(part.tobytes() for part in parts)


def from_bytes(record: bytes) -> NetworkLabels:
    """The annotation in a record."""
    key_bytes, lanes, points, *numbers = SHAPE.unpack_from(record)
    key_end = SHAPE.size + key_bytes
    kind_end = key_end + lanes
    packed = (points + 7) // 8
    visible_end = kind_end + lanes * packed
    bits = np.frombuffer(record, np.uint8, lanes * packed, kind_end).reshape(lanes, packed)
    return NetworkLabels(
        key=record[SHAPE.size : key_end].decode(),
        intrinsics=(numbers[0], numbers[1], numbers[2], numbers[3]),
        plane=Pose(*numbers[4:6]),
        target=Pose(*numbers[6:8]),
        xyz_cam=np.frombuffer(record, "<f4", lanes * points * 3, visible_end).reshape(lanes, points, 3),
        visible=np.unpackbits(bits, axis=1, count=points).astype(bool),
        kind=np.frombuffer(record, np.uint8, lanes, key_end).astype(np.int64),
    )


class Example(NamedTuple):
    """One image of the network's size and what is to be learned from it."""

    image: RgbImage
    annotation: NetworkLabels


class Examples:
    """Samples as examples. What was decoded once comes from the caches. `is_on_device`: whoever trains with them keeps
    all their images in the memory of the device."""

    def __init__(
        self,
        samples: Samples,
        config: TrainConfig,
        annotations: Slots | None,
        pixels: Slots | None,
        *,
        is_on_device: bool = False,
    ) -> None:
        self._samples, self._annotations, self._pixels = samples, annotations, pixels
        self._config, self.is_on_device = config, is_on_device

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, index: int) -> Example:
        annotation, image = self._kept_annotation(index), self._kept_image(index)
        if annotation is None and image is None:
            sample = self._samples[index]  # both in one read
            return Example(self._keep_image(index, sample.image), self._annotate(index, sample.key, sample.labels))
        if image is None:
            image = self._keep_image(index, image_at(self._samples, index))
        return Example(image, annotation or self.annotation(index))

    def annotation(self, index: int) -> NetworkLabels:
        """What is to be learned from a sample, without its image."""
        found = self._kept_annotation(index)
        return found or self._annotate(index, key_at(self._samples, index), labels_at(self._samples, index))

    def _kept_annotation(self, index: int) -> NetworkLabels | None:
        record = None if self._annotations is None else self._annotations.get(index)
        return None if record is None else from_bytes(record)

    def _kept_image(self, index: int) -> RgbImage | None:
        record = None if self._pixels is None else self._pixels.get(index)
        return None if record is None else np.frombuffer(record, np.uint8).reshape(*self._config.model.size_px, 3)

    def _annotate(self, index: int, key: str, labels: Labels) -> NetworkLabels:
        pose_mode, in_image_only = self._config.model.pose_target, self._config.fov_mask
        annotation = annotation_of(key, labels, self._config.model.size_px, pose_mode, in_image_only=in_image_only)
        if self._annotations is not None:
            self._annotations.put(index, to_bytes(annotation))
        return annotation

    def _keep_image(self, index: int, image: RgbImage) -> UInt8[np.ndarray, "h2 w2 3"]:
        small = resize(image, self._config.model.size_px)
        if self._pixels is not None:
            self._pixels.put(index, small.tobytes())
        return small


@dataclass(frozen=True)
class Decoding:
    """Whether the images of a split are decoded once and kept in memory (`is_once`), in that of the GPU
    (`is_on_device`), and the figures behind that decision."""

    n_images: int
    n_bytes: int
    free_bytes: int
    is_once: bool
    is_on_device: bool

    def text(self) -> str:
        """The decision and its figures, as one line of text."""
        what = f"{self.n_images:,} images, {self.n_bytes / 1e9:,.1f} GB when decoded"
        if self.is_once:
            return f"{what}: kept in memory{' of the GPU' * self.is_on_device}"
        return f"{what}, with {self.free_bytes / 1e9:,.1f} GB of memory free: decoded again in every epoch"


def decoding_of(n_images: int, config: TrainConfig, process: Process) -> Decoding:
    """Decide where decoded images are kept: `keep_decoded`, or where every process here has room for them."""
    n_bytes = n_images * slot_bytes_of(config.model.size_px)
    free_bytes = free_memory_bytes()
    is_on_device = config.keep_decoded is not False and n_bytes < MEMORY_SHARE * free_gpu_bytes(process.device)
    fits = n_bytes * process.neighbours < MEMORY_SHARE * free_bytes
    is_kept = hasattr(os, "memfd_create") and (fits if config.keep_decoded is None else config.keep_decoded)
    return Decoding(n_images, n_bytes, free_bytes, is_on_device or is_kept, is_on_device)


def open_examples(
    samples: Samples, decoding: Decoding, config: TrainConfig, process: Process, out_dir: Path
) -> Examples:
    """Put the caches before a split: annotations in `out_dir`, decoded images in memory if they are kept."""
    pixels = pixel_memory(config.model.size_px) if decoding.is_once and not decoding.is_on_device else None
    annotations = _annotations(samples, config, process, out_dir)
    return Examples(samples, config, annotations, pixels, is_on_device=decoding.is_on_device)


def training_batches(
    examples: Examples, config: TrainConfig, process: Process, first_step: int, n_steps: int
) -> Iterator[Batch]:
    """The batches of the steps from `first_step` to before `n_steps`, with images in the memory of the CPU, or of the
    device if they are kept there."""
    n_batches, device = max(0, n_steps - first_step), process.device
    workers = spare_cores(process.neighbours) if config.workers is None else config.workers
    kept = _images_on(device, examples, config.batch, workers) if examples.is_on_device else None
    no_image = np.zeros((0, 0, 3), np.uint8)

    def indices(number: int) -> Int[Tensor, " b"]:
        return batch_index(len(examples), first_step + number, config, process)

    def make(number: int) -> Batch:
        if kept is None:
            return collate([examples[index] for index in indices(number).tolist()])
        return collate([Example(no_image, examples.annotation(index)) for index in indices(number).tolist()])

    for number, batch in enumerate(made_ahead(make, n_batches, min(workers, n_batches), device)):
        yield batch if kept is None else batch._replace(image=kept[indices(number)])


def _images_on(device: torch.device, examples: Examples, batch: int, workers: int) -> UInt8[Tensor, "n 3 h w"]:
    """The images of all examples, in the memory of the device."""
    parts = _ranges(len(examples), batch)

    def make(number: int) -> UInt8[Tensor, "b 3 h w"]:
        return _stacked([examples[index].image for index in parts[number]])

    made = made_ahead(make, len(parts), min(workers, len(parts)), device)
    first = next(made)
    shape = (len(examples), *first.shape[1:])
    images = torch.empty(shape, dtype=torch.uint8, device=device, memory_format=torch.channels_last)
    for part, of_part in zip(parts, chain([first], made), strict=True):
        images[part.start : part.stop] = of_part
    return images


@lru_cache(maxsize=1)
def sample_order(n: int, seed: int, epoch: int) -> Int[Tensor, " n"]:
    """The order of one epoch."""
    return torch.randperm(n, generator=torch.Generator().manual_seed(seed * 1_000_003 + epoch))


def batch_index(n: int, step: int, config: TrainConfig, process: Process) -> Int[Tensor, " b"]:
    """The samples of a step on this process; an epoch's last batch is filled up from the epoch's start."""
    steps_per_epoch = -(-n // config.batch)
    epoch, at = divmod(step, steps_per_epoch)
    places = (at * config.batch + torch.arange(config.batch)) % n
    return sample_order(n, config.seed, epoch)[places][process.rank :: process.world]


def collate(examples: Sequence[Example]) -> Batch:
    """Examples as a batch."""
    annotations = [example.annotation for example in examples]
    return Batch(
        image=_stacked([example.image for example in examples]),
        intrinsics=torch.tensor([one.intrinsics for one in annotations]),
        curves=pack(annotations),
        plane_pose=torch.tensor([one.plane for one in annotations]),
        target_pose=torch.tensor([one.target for one in annotations]),
        keys=tuple(one.key for one in annotations),
    )


class LabelledBatch(NamedTuple):
    """Images of the network's size with their intrinsics, and their labels."""

    keys: tuple[str, ...]
    image: UInt8[Tensor, "b 3 h w"]
    intrinsics: Float[Tensor, "b 4"]
    labels: tuple[Labels, ...]


def labelled_batches(
    samples: Samples,
    size_px: tuple[int, int],
    trained: FocalLengths | None,
    batch: int,
    workers: int | None,
    device: torch.device,
) -> Iterator[LabelledBatch]:
    """All samples in order, for evaluation, with images as `fit` makes them; the last batch may be smaller."""
    parts = _ranges(len(samples), batch)

    def make(number: int) -> LabelledBatch:
        found = [samples[index] for index in parts[number]]
        fitted = [fit(one.image, intrinsics_of(one.labels), size_px, trained) for one in found]
        return LabelledBatch(
            tuple(one.key for one in found),
            _stacked([image for image, _ in fitted]),
            torch.tensor([intrinsics for _, intrinsics in fitted]),
            tuple(one.labels for one in found),
        )

    n_workers = spare_cores() if workers is None else workers
    return made_ahead(make, len(parts), min(n_workers, len(parts)), device)


def _ranges(n: int, size: int) -> list[range]:
    return [range(start, min(start + size, n)) for start in range(0, n, size)]


def _stacked(images: Sequence[RgbImage]) -> UInt8[Tensor, "b 3 h w"]:
    return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2)


def _annotations(samples: Samples, config: TrainConfig, process: Process, out_dir: Path) -> Slots | None:
    """The annotations' file in `out_dir`, kept over resumed runs if the samples can tell whether they are the same."""
    digest = digest_of(samples)
    if digest is None:
        with tempfile.TemporaryFile(dir=out_dir) as file:
            return Slots(os.dup(file.fileno()), SLOT_BYTES)
    model = config.model
    source = f"{digest} {model.image_height_px}x{model.image_width_px} {model.pose_target} {config.fov_mask}"
    path = out_dir / ANNOTATIONS
    if process.rank % process.neighbours:
        torch.distributed.barrier()
    found = annotation_file(path, source)
    if process.world > 1 and process.rank % process.neighbours == 0:
        torch.distributed.barrier()
    return found
