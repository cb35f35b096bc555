"""Read a CurveLanes export back and compare it with our labels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from synth3dlanes.formats.comparing import Comparison, ExportView, Rule, SourceSample, camera_problems, compare
from synth3dlanes.formats.curvelanes.convention import CAMERA, ROW_STEP_PX
from synth3dlanes.formats.curvelanes.read import labels_path, parse
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.reading import drawable, listed_files, read_text
from synth3dlanes.formats.sidecar import Sidecar, Sidecars

# Columns have two decimals.
RULE = Rule("px", 0.02)
"""Coordinates have two decimals."""


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every list."""
    sidecars = Sidecars(out, Sidecar)
    for path in sorted(out.glob("*/*.txt")):
        yield FrameList(path.parent.name, _frames(out, path, most_frames, sidecars))


def _frames(out: Path, path: Path, most_frames: int, sidecars: Sidecars[Sidecar]) -> Iterator[ReadFrame]:
    for name in listed_files(path, most_frames):
        image = f"{path.parent.name}/{name}"
        where = str(out / labels_path(image))
        lines = drawable(parse(read_text(Path(where)), where), where)
        yield ReadFrame(image, where, image, (lines, sidecars[image]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in pixels."""
    lines, sidecar = frame.content
    width_px = round(2 * sidecar.img_from_cv[0, 2])
    height_px = round(width_px * CAMERA.height_px / CAMERA.width_px)
    view = ExportView(sidecar.img_from_cv, (width_px, height_px))
    ours = [lane.at_rows(view, np.arange(height_px, -1, -ROW_STEP_PX)) for lane in truth.lanes("delimiter")]
    compared, _ = compare(lines, ours, RULE, sidecar.lines_ids)
    return compared.because(camera_problems(truth, sidecar.camera_height_m, sidecar.camera_pitch_rad))
