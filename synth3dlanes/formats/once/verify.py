"""Read a ONCE-3DLanes export back and compare it with our labels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from synth3dlanes.formats.comparing import Comparison, ExportView, Rule, SourceSample, camera_problems, compare
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.once.convention import ROOT
from synth3dlanes.formats.once.read import OnceFrame, parse
from synth3dlanes.formats.reading import listed_files, read_text
from synth3dlanes.system.errors import FormatError

RULE = Rule("m", 0.001, direction=-1, most=8)
RASTER_M = 10.0


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every list."""
    for path in sorted((out / ROOT / "list").glob("*.txt")):
        yield FrameList(path.stem, _frames(out, path, most_frames))


def _frames(out: Path, path: Path, most_frames: int) -> Iterator[ReadFrame]:
    for name in listed_files(path, most_frames):
        file = f"{ROOT}/{path.stem}/{name}.json"
        frame = parse(read_text(out / file), str(out / file))
        if any(len(points_cv) < 2 for points_cv in frame.lanes_cv):
            raise FormatError(f"{out / file}: lanes: expected two points or more each, got fewer")
        yield ReadFrame(file, str(out / file), f"{ROOT}/data/{name}.jpg", frame)


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in metres, and their order: those that the evaluator can pair by their place come first."""
    found: OnceFrame = frame.content
    k = found.img_from_cv
    view = ExportView(k, (round(2 * k[0, 2]), round(2 * k[1, 2])))
    # OpenCV's axes: x to the right, y down, z ahead.
    lines = [np.column_stack([x, z, -y]) for x, y, z in (points_cv.T for points_cv in found.lanes_cv)]
    compared, _ = compare(lines, [lane.in_metres(view) for lane in truth.lanes("delimiter")], RULE)
    is_near = [np.count_nonzero((line[:, 1] < RASTER_M) & (np.abs(line[:, 0]) < RASTER_M)) >= 2 for line in lines]
    problems = list(camera_problems(truth, found.camera_height_m, found.camera_pitch_rad))
    problems += (
        f"line {i}: expected lines within {RASTER_M:g} m first, got one behind line {i - 1}, which is farther ahead"
        for i in range(1, len(lines))
        if is_near[i] and not is_near[i - 1]
    )
    return compared.because(problems)
