"""Read a YOLO export back and compare it with the passes of our samples."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_fill_holes, find_objects, label

from synth3dlanes.formats.comparing import Comparison, SourceSample
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.reading import image_size, listed_files, numbers, read_text
from synth3dlanes.formats.segments import STUFF
from synth3dlanes.formats.things import PixelNumbers, Thing, compare_masks, most_shared, things
from synth3dlanes.formats.writing import PARTS
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.errors import FormatError

LEAST_PX = 10
NAMES = tuple(name for name in SEMANTIC_IDS if name not in STUFF)
# Shares have six decimals.
ROUNDING_PX = 0.01


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The frames of every part."""
    for part in PARTS:
        if (out / f"{part}.txt").exists():
            yield FrameList(part, _frames(out, out / f"{part}.txt", most_frames))


def _frames(out: Path, path: Path, most_frames: int) -> Iterator[ReadFrame]:
    for image in listed_files(path, most_frames):
        size_px, where = image_size(out / image), str(out / "labels" / f"{Path(image).stem}.txt")
        objects = []
        for text in read_text(Path(where)).splitlines():
            number, _, shares = text.partition(" ")
            corners = numbers(shares, where)
            is_known = number.isdecimal() and len(number) < 4 and int(number) < len(NAMES)
            if not is_known or not len(corners) or corners.min() < 0 or corners.max() > 1:
                expected = f"a class below {len(NAMES)} and shares of the image"
                raise FormatError(f"{where}: expected {expected}, got {text:.60}")
            objects.append((NAMES[int(number)], corners * size_px))
        yield ReadFrame(image.removeprefix("./"), where, image, (objects, size_px))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Each outline beside the piece of an object that it goes around."""
    objects, (width_px, height_px) = frame.content
    shape = (height_px, width_px)
    ours = dict(_pieces(truth, shape))
    found, problems = dict[str, PixelNumbers](), list[str]()
    for i, (of_class, corners) in enumerate(objects):
        if np.abs(corners - np.rint(corners)).max() > ROUNDING_PX:
            problems.append(f"object {i} ({of_class}): expected corners between pixels, got others")
        mask = _inside(np.rint(corners).astype(int), shape)
        alike = {name: piece.mask for name, piece in ours.items() if piece.of_class == of_class and name not in found}
        found[most_shared(mask, alike, shape) or f"object {i} ({of_class})"] = mask
    return compare_masks(found, {name: piece.mask for name, piece in ours.items()}, shape).because(problems)


def _pieces(truth: SourceSample, shape: tuple[int, int]) -> Iterator[tuple[str, Thing]]:
    """The connected pieces of all objects, with their holes filled, by names."""
    for name, thing in things(truth).items():
        whole = np.zeros(shape, dtype=bool)
        whole.ravel()[thing.mask] = True
        pieces, _ = label(whole)
        for k, (rows, columns) in enumerate(find_objects(pieces), start=1):
            piece = pieces[rows, columns] == k
            if np.count_nonzero(piece) >= LEAST_PX:
                row, column = np.nonzero(binary_fill_holes(piece, np.ones((3, 3), dtype=bool)))
                places = (row + rows.start) * shape[1] + column + columns.start
                yield f"{name}, piece {k}", Thing(thing.of_class, places)


def _inside(corners: np.ndarray, shape: tuple[int, int]) -> PixelNumbers:
    """The pixels inside an outline: each upright side switches all pixels to its right."""
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    switches = np.zeros((bottom - top, right - left + 1), dtype=int)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if x0 == x1:
            switches[min(y0, y1) - top : max(y0, y1) - top, x0 - left] ^= 1
    row, column = np.nonzero(np.cumsum(switches, axis=1)[:, :-1] % 2)
    return np.asarray((row + top) * shape[1] + column + left)
