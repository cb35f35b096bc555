"""Caches of the data loader for later epochs: annotations in a file beside the run, decoded images in memory.

Both have slots of equal size, one for each sample, which the first process that needs a sample fills. Every slot has a
checksum, so a slot that is empty, or half written when a run was killed, is filled again.
"""

import os
import struct
import weakref
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.files import Folder

from .data import NetworkLabels
from .poses import Pose

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


def has_pixel_memory() -> bool:
    """Whether the system has memory that forked processes share without each being charged for it, as Linux has."""
    return hasattr(os, "memfd_create")


def pixel_memory(size_px: tuple[int, int]) -> Slots:
    """Slots in memory for decoded images of (height, width); only images that are stored take memory."""
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


def pixels_from_bytes(record: bytes, size_px: tuple[int, int]) -> RgbImage:
    """The image in a record."""
    image: UInt8[np.ndarray, ...] = np.frombuffer(record, np.uint8).reshape(*size_px, 3)
    return image
