"""Read a tuSimple export back and compare it with our labels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from synth3dlanes.formats.comparing import Comparison, ExportView, Rule, SourceSample, camera_problems, compare
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.reading import first_lines
from synth3dlanes.formats.sidecar import Sidecar, Sidecars
from synth3dlanes.formats.tusimple.convention import ROWS_PX
from synth3dlanes.formats.tusimple.read import parse
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import shown

# Columns are whole pixels.
RULE = Rule("px", 0.51, most=5)
SIZE_PX = (1280, 720)


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every label file."""
    sidecars = Sidecars(out, Sidecar)
    for path in sorted(out.glob("*label*.json")):
        yield FrameList(path.name, _frames(path, most_frames, sidecars))


def _frames(path: Path, most_frames: int, sidecars: Sidecars[Sidecar]) -> Iterator[ReadFrame]:
    for number, line in enumerate(first_lines(path, most_frames), start=1):
        where = f"{path}:{number}"
        frame = parse(line, where)
        if not np.array_equal(frame.rows_px, ROWS_PX):
            got = shown(frame.rows_px.tolist())
            raise FormatError(f"{where}: h_samples: expected the rows of the benchmark, got {got}")
        yield ReadFrame(frame.raw_file, where, frame.raw_file, (frame, sidecars[frame.raw_file]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in pixels."""
    (found, sidecar) = frame.content
    rows_px = found.rows_px[::-1]
    lines = [np.column_stack([u_px[::-1], rows_px])[u_px[::-1] >= 0] for u_px in found.lanes_u_px]
    view = ExportView(sidecar.img_from_cv, SIZE_PX)
    ours = [lane.at_rows(view, rows_px) for lane in truth.lanes("delimiter")]
    compared, _ = compare(lines, ours, RULE, sidecar.lines_ids)
    return compared.because(camera_problems(truth, sidecar.camera_height_m, sidecar.camera_pitch_rad))
