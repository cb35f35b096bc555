"""Plain masks: semantic classes, instances and lines as PNG, the lines also as text.

| theirs | ours | unit |
|---|---|---|
| `semantic/`, `instance/` | the passes | ids |
| `lines/*.png` | 1 + i at the visible paint of delimiter i | |
| `lines/*.lines.txt`: x and y in turn | delimiters on ground that is seen, near to far | px |
| `lines/*.json` | number, id, marking and colour of each of these | |
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, RootModel

from synth3dlanes.formats.comparing import Comparison, Gap, OurLine, Rule, SourceSample, compare
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame
from synth3dlanes.formats.reading import image_size, listed_files, numbers, read_mask, read_text
from synth3dlanes.formats.segments import (
    PASSES,
    compare_masks,
    delimiter_numbers,
    file_name,
    image_path,
    line_pixels,
    png,
)
from synth3dlanes.formats.writing import FrameAnnotation
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.labels.labels import CameraLabel, Lane
from synth3dlanes.scene.instance_ids import END, numbers_of
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import Excerpt, parse

CLASSES_FILE = "classes.json"
LEAST_POINTS = 2
# Points have two decimals and lie on straight pieces of a decimetre, which a lens bends.
RULE = Rule("px", 0.05, spacing=12.0)
MODES = {"semantic": ("L",), "instance": ("I;16",), "lines": ("L", "I;16")}
LINE_STEP_M, NEAREST_M, BORDER_PX = 0.05, 1.0, 2.0

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


def write(frame: SampleFrame) -> FrameAnnotation:
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
                tuple(f"lists/{part}.txt" for part in frame.served),
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


class _Line(Excerpt):
    number: Annotated[int, Field(ge=1, le=END)]
    id: str
    marking: str
    color: str | None


class _Lines(RootModel[list[_Line]]):
    """The lines of a frame, in the order of their texts."""


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    for path in sorted((out / "lists").glob("*.txt")):
        yield FrameList(path.stem, _frames(out, path, most_frames))


def _frames(out: Path, path: Path, most_frames: int) -> Iterator[ReadFrame]:
    for image in listed_files(path, most_frames):
        name, size_px = image.rpartition(".")[0], image_size(out / "images" / image)
        masks = {folder: read_mask(out / f"{folder}/{name}.png", size_px, *modes) for folder, modes in MODES.items()}
        where = out / f"lines/{name}.lines.txt"
        yield ReadFrame(f"images/{image}", str(where), f"images/{image}", (masks, *_lines(where)))


def _lines(path: Path) -> tuple[list[_Line], list[np.ndarray]]:
    """What is told of the lines of a frame, and their points."""
    told = path.with_name(path.name.replace(".lines.txt", ".json"))
    lines = [numbers(text, str(path)) for text in read_text(path).splitlines()]
    about = parse(_Lines, read_text(told), str(told), "the lines of a mask").root
    if len(about) != len(lines):
        raise FormatError(f"{told}: expected {len(lines)} lines as in {path.name}, got {len(about)}")
    if any(len(points) < LEAST_POINTS for points in lines):
        raise FormatError(f"{path}: expected lines of {LEAST_POINTS} points or more, got fewer")
    return about, lines


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in pixels; every mask pixel by pixel."""
    masks, about, lines = frame.content
    delimiters = [lane for lane in truth.labels.lanes if lane.kind == "delimiter"]
    ours = [_in_image(lane, truth.labels.camera) for lane in delimiters]
    compared, _ = compare(lines, ours, RULE, [line.id for line in about])
    expected = {i: (lane.id, lane.marking, lane.color) for i, lane in enumerate(delimiters, start=1)}
    compared = compared.because(
        f"line {i}: expected {line.number} to be {expected.get(line.number)}, got {(line.id, line.marking, line.color)}"
        for i, line in enumerate(about)
        if expected.get(line.number) != (line.id, line.marking, line.color)
    )
    numbered = {**truth.passes, "lines": numbers_of("delimiter", truth.passes["instance"]) + 1}
    for name, found in masks.items():
        off = Comparison()
        if not np.array_equal(found, numbered[name]):
            called = {i: lane for i, (lane, *_) in expected.items()} if name == "lines" else {}
            of_file, of_passes = (
                {called.get(i, f"{name} {i}"): np.flatnonzero(pixels == i) for i in np.unique(pixels).tolist()}
                for pixels in (found, numbered[name])
            )
            off = compare_masks(of_file, of_passes, found.shape)
        worst = np.array([0.0, *(gap.worst for gap in off.gaps)])
        compared += Comparison((Gap.of(name, "px", worst, "mask"),), off.problems)
    return compared


def _in_image(lane: Lane, camera: CameraLabel) -> OurLine:
    """The line as the camera sees it, a point every few centimetres."""
    lengths = lengths_along(lane.xyz_cam)
    fine = np.union1d(lengths, np.arange(0, lengths[-1], LINE_STEP_M))
    points = np.column_stack([np.interp(fine, lengths, column) for column in lane.xyz_cam.T])
    uv = camera.project(points[points[:, 1] > NEAREST_M / 4])
    uv = uv[~np.isnan(uv).any(axis=1)]
    own = camera.project(lane.xyz_cam)
    with np.errstate(invalid="ignore"):
        sure = ((own > BORDER_PX) & (own < np.array([camera.width_px, camera.height_px]) - BORDER_PX)).all(axis=1)
    return OurLine(lane.id, uv, own[sure & lane.terrain_visible & (lane.xyz_cam[:, 1] > NEAREST_M)])


FORMAT = SampleFormat(
    title="PNG masks of classes, instances and lines",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit},
    document=document,
    passes=PASSES,
)
