"""YOLO segmentation: a text file a frame with the outlines of its objects, and the settings that ultralytics takes.

| theirs | ours | unit |
|---|---|---|
| a line: class, then x and y in turn | a connected piece of an instance, its holes filled | shares of the image |
"""

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import binary_fill_holes, find_objects, label

from synth3dlanes.formats.comparing import Comparison, SourceSample
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame
from synth3dlanes.formats.reading import image_size, listed_files, numbers, read_text
from synth3dlanes.formats.segments import (
    LIMIT_PX,
    PASSES,
    MaskedObject,
    PixelNumbers,
    compare_masks,
    file_name,
    image_path,
    masked_objects,
    most_shared,
)
from synth3dlanes.formats.writing import PARTS, FrameAnnotation
from synth3dlanes.scene.things import SEMANTIC_IDS, STUFF
from synth3dlanes.system.errors import FormatError

NAMES = tuple(name for name in SEMANTIC_IDS if name not in STUFF)
SETTINGS_FILE = "data.yaml"
LEAST_PX = 10
SMALL_PIECE = f"a piece of less than {LEAST_PX} pixels"
# Clockwise in the image, from the right on: x and y.
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
# Shares have six decimals.
ROUNDING_PX = 0.01

README = f"""YOLO segmentation layout.

- `images/*`: as in the data set. `labels/*.txt`: a line of text for each object: its class, then x and y of its outline
  in turn, as shares of the width and height. `{SETTINGS_FILE}` is what `yolo segment train data=...` takes; it names
  the classes. `train.txt`, `val.txt` and `test.txt` list the images of each part.
- Where a data set has no val frames (training frames of fewer than five scenes), or no training frames,
  `{SETTINGS_FILE}` names those of the other part in their place, because ultralytics wants both. Scores are then those
  of training frames.
- An object is a connected piece of a thing: a polygon has one part. So each dash of a lane line is an object, and so
  are the two halves of a car behind a tree. Holes are filled. Pieces of less than {LEAST_PX} pixels are left out.
"""


def write(frame: SampleFrame) -> FrameAnnotation:
    semantic, instance = frame.passes["semantic"], frame.passes["instance"]
    height_px, width_px = semantic.shape
    lines, dropped = [], Counter[str]()
    for number, name in enumerate(NAMES):
        is_class = semantic == SEMANTIC_IDS[name]
        for thing in np.unique(instance[is_class]).tolist():
            pieces, _ = label(is_class & (instance == thing))
            for index, (rows, columns) in enumerate(find_objects(pieces), start=1):
                piece = pieces[rows, columns] == index
                if np.count_nonzero(piece) < LEAST_PX:
                    dropped[SMALL_PIECE] += 1
                    continue
                corners = (outline(piece) + np.array([columns.start, rows.start])) / [width_px, height_px]
                lines.append(f"{number} " + " ".join(f"{share:.6f}" for share in corners.ravel().tolist()))
    image = image_path(frame)
    return FrameAnnotation(
        image,
        len(lines),
        dropped,
        files={f"labels/{file_name(frame)}.txt": "\n".join(lines)},
        shared=(
            (f"./{image}", tuple(f"{part}.txt" for part in frame.served)),
            *((part, (SETTINGS_FILE,)) for part in frame.served),
        ),
    )


def outline(piece: Bool[np.ndarray, "h w"]) -> np.ndarray:
    """The corners (x, y) of the outer border of connected pixels, clockwise, along the pixels' edges."""
    inside = np.pad(piece, 1)
    x, y = int(np.argmax(inside[1])), 1
    start, heading, corners = (x, y), 0, list[tuple[int, int]]()
    while True:
        (ahead_x, ahead_y), (right_x, right_y) = STEPS[heading], STEPS[(heading + 1) % 4]
        # The pixels that meet at a corner: its own coordinates are those of the pixel right below it.
        to_right = inside[y + min(0, ahead_y + right_y), x + min(0, ahead_x + right_x)]
        to_left = inside[y + min(0, ahead_y - right_y), x + min(0, ahead_x - right_x)]
        turn = 1 if not to_right else -1 if to_left else 0
        if turn or not corners:
            corners.append((x - 1, y - 1))
        heading = (heading + turn) % 4
        x, y = x + STEPS[heading][0], y + STEPS[heading][1]
        if (x, y) == start:
            return np.array(corners)


def document(path: str, lines: Path) -> Iterator[str]:
    """The lists as they are, and the settings."""
    found = lines.read_text()
    if path != SETTINGS_FILE:
        yield found
        return
    parts = [part for part in PARTS if part in found.splitlines()]
    # Without `path`, ultralytics looks beside the file; with one, from the working directory.
    yield "".join(f"{part}: {part}.txt\n" for part in parts)
    for lacking, other in (("train", "val"), ("val", "train")):
        if lacking not in parts:
            yield f"{lacking}: {other}.txt  # there are no {lacking} frames, and ultralytics wants some\n"
    yield "names:\n" + "".join(f"  {number}: {json.dumps(name)}\n" for number, name in enumerate(NAMES))


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
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


def _pieces(truth: SourceSample, shape: tuple[int, int]) -> Iterator[tuple[str, MaskedObject]]:
    """The connected pieces of all objects, with their holes filled, by names."""
    for name, thing in masked_objects(truth).items():
        whole = np.zeros(shape, dtype=bool)
        whole.ravel()[thing.mask] = True
        pieces, _ = label(whole)
        for k, (rows, columns) in enumerate(find_objects(pieces), start=1):
            piece = pieces[rows, columns] == k
            if np.count_nonzero(piece) >= LEAST_PX:
                row, column = np.nonzero(binary_fill_holes(piece, np.ones((3, 3), dtype=bool)))
                places = (row + rows.start) * shape[1] + column + columns.start
                yield f"{name}, piece {k}", MaskedObject(thing.of_class, places)


def _inside(corners: np.ndarray, shape: tuple[int, int]) -> PixelNumbers:
    """The pixels inside an outline: each upright side switches all pixels to its right."""
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    switches = np.zeros((bottom - top, right - left + 1), dtype=int)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if x0 == x1:
            switches[min(y0, y1) - top : max(y0, y1) - top, x0 - left] ^= 1
    row, column = np.nonzero(np.cumsum(switches, axis=1)[:, :-1] % 2)
    return np.asarray((row + top) * shape[1] + column + left)


FORMAT = SampleFormat(
    title="YOLO segmentation: outlines of objects",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    tolerances={"px": LIMIT_PX},
    document=document,
    passes=PASSES,
    counted="objects",
)
