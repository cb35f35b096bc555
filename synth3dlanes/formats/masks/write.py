"""Write plain masks: semantic classes, instances and lines as PNG, the lines also as text."""

import json
from collections.abc import Iterator
from pathlib import Path

from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.formats.segments import delimiter_numbers, file_name, image_path, line_pixels, png
from synth3dlanes.formats.writing import PARTS, FrameAnnotation
from synth3dlanes.scene.settings import SEMANTIC_IDS

LEAST_POINTS = 2
CLASSES_FILE = "classes.json"

README = """Masks as PNG files without palette, of the images' size.

- `images/*`: as in the data set. `lists/{train,val,test}.txt`: the names of the images of each part.
- `semantic/*.png` (8 bits): the classes of `classes.json`.
- `instance/*.png` (16 bits): the ids of the data set's instance pass (docs/format.md), 0 for what has none.
- `lines/*.png` (8 bits; 16 where a number is beyond 255): 1 + i at the visible paint of delimiter i of the labels,
  gaps between dashes not included. Numbers beyond the labels' are lines that begin more than 110 m ahead.
- `lines/*.lines.txt`, as in CULane: a line of text for each delimiter, x and y in turn, from near to far, about every
  8 pixels, also under cars. `lines/*.json`: the number of each of these lines in `lines/*.png`, its id, its marking and
  its colour. Pixel corners are at whole numbers.
"""


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The frame's masks and lines."""
    name, texts, about = file_name(frame), [], []
    delimiters = [lane for lane in frame.labels.lanes if lane.kind == "delimiter"]
    for index, lane in enumerate(delimiters):
        points = line_pixels(lane, frame.labels.camera)
        if len(points) >= LEAST_POINTS:
            texts.append(" ".join(f"{x:.2f} {y:.2f}" for x, y in points.tolist()))
            about.append({"number": index + 1, "id": lane.id, "marking": lane.marking, "color": lane.color})
    return FrameAnnotation(
        image_path(frame),
        len(texts),
        files={
            f"semantic/{name}.png": png(frame.passes["semantic"]),
            f"instance/{name}.png": png(frame.passes["instance"]),
            f"lines/{name}.png": png(delimiter_numbers(frame.passes["instance"])),
            f"lines/{name}.lines.txt": "\n".join(texts),
            f"lines/{name}.json": json.dumps(about),
        },
        shared=(
            (
                image_path(frame).removeprefix("images/"),
                tuple(f"lists/{part}.txt" for part in PARTS if frame.serves_as(part)),
            ),
            ("", (CLASSES_FILE,)),
        ),
    )


def document(path: str, lines: Path) -> Iterator[str]:
    """The lists as they are, and the classes."""
    if path == CLASSES_FILE:
        yield json.dumps(SEMANTIC_IDS, indent=1) + "\n"
    else:
        yield lines.read_text()
