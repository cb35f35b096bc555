"""Read an export of masks back and compare it with the passes and the labels of our samples."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, RootModel

from synth3dlanes.formats.comparing import Comparison, Gap, OurLine, Rule, SourceSample, compare
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.masks.write import LEAST_POINTS
from synth3dlanes.formats.reading import image_size, listed_files, numbers, read_mask, read_text
from synth3dlanes.formats.things import compare_masks
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.labels.labels import CameraLabel, Lane
from synth3dlanes.scene.instance_ids import END, numbers_of
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import Excerpt, parse

# Points have two decimals and lie on straight pieces of a decimetre, which a lens bends.
RULE = Rule("px", 0.05, spacing=12.0)
MODES = {"semantic": ("L",), "instance": ("I;16",), "lines": ("L", "I;16")}
STEP_M, NEAREST_M, BORDER_PX = 0.05, 1.0, 2.0


class _Line(Excerpt):
    number: Annotated[int, Field(ge=1, le=END)]
    id: str
    marking: str
    color: str | None


class _Lines(RootModel[list[_Line]]):
    """The lines of a frame, in the order of their texts."""


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The frames of every part."""
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
    fine = np.union1d(lengths, np.arange(0, lengths[-1], STEP_M))
    points = np.column_stack([np.interp(fine, lengths, column) for column in lane.xyz_cam.T])
    uv = camera.project(points[points[:, 1] > NEAREST_M / 4])
    uv = uv[~np.isnan(uv).any(axis=1)]
    own = camera.project(lane.xyz_cam)
    with np.errstate(invalid="ignore"):
        sure = ((own > BORDER_PX) & (own < np.array([camera.width_px, camera.height_px]) - BORDER_PX)).all(axis=1)
    return OurLine(lane.id, uv, own[sure & lane.terrain_visible & (lane.xyz_cam[:, 1] > NEAREST_M)])
