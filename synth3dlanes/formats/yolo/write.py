"""Write YOLO segmentation: a text file a frame with the outlines of its objects."""

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import find_objects, label

from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.formats.segments import STUFF, file_name, image_path
from synth3dlanes.formats.writing import PARTS, FrameAnnotation
from synth3dlanes.scene.settings import SEMANTIC_IDS

NAMES = tuple(name for name in SEMANTIC_IDS if name not in STUFF)
SETTINGS_FILE = "data.yaml"
LEAST_PX = 10
SMALL = f"a piece of less than {LEAST_PX} pixels"
# Clockwise in the image, from the right on: x and y.
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))

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


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The frame's outlines."""
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
                    dropped[SMALL] += 1
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
            (f"./{image}", tuple(f"{part}.txt" for part in PARTS if frame.serves_as(part))),
            *((part, (SETTINGS_FILE,)) for part in PARTS if frame.serves_as(part)),
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
