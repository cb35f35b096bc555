"""Read an Apollo Sim-3D export back and compare it with our labels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.apollo.convention import ROOT
from synth3dlanes.formats.apollo.read import ApolloFrame, FlagLists, PointLists, parse
from synth3dlanes.formats.comparing import (
    Comparison,
    ExportView,
    OurLine,
    Rule,
    SourceSample,
    UprightLane,
    camera_problems,
    compare,
)
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.reading import first_lines
from synth3dlanes.formats.sidecar import Sidecars
from synth3dlanes.system.schema import Excerpt

# Coordinates have six decimals, those of the labels four.
LINES, CENTERS = (Rule("m", 0.001, most=most, name=name) for most, name in ((6, "lane line"), (np.inf, "center line")))
# The evaluator looks at lines in this band only, of which a line may have little.
ASIDE_M, NEAR_M, FAR_M = 9.0, 5.0, 95.0
VIEW = ExportView(np.array([[2015.0, 0, 960], [0, 2015, 540], [0, 0, 1]]), (1920, 1080))


class _Sidecar(Excerpt):
    raw_file: str
    laneLines_ids: list[str]
    centerLines_ids: list[str]


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every list."""
    ids = Sidecars(out, _Sidecar, "raw_file")
    for path in sorted((out / "data_splits").glob("*/*.json")):
        yield FrameList(str(path.relative_to(out)), _frames(path, most_frames, ids))


def _frames(path: Path, most_frames: int, ids: Sidecars[_Sidecar]) -> Iterator[ReadFrame]:
    for number, line in enumerate(first_lines(path, most_frames), start=1):
        where = f"{path}:{number}"
        frame = parse(line, where)
        image = f"{ROOT}/{frame.raw_file}"
        yield ReadFrame(image, where, image, (frame, ids[frame.raw_file]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lane lines and centre lines in metres."""
    found, sidecar = frame.content
    height_m = found.cam_height_m * np.cos(found.cam_pitch_rad)
    compared = Comparison(problems=tuple(camera_problems(truth, height_m, found.cam_pitch_rad)))
    lines = found.lane_lines_apollo, found.lane_lines_visible
    centers = found.center_lines_apollo, found.center_lines_visible
    compared += _compared(found, lines, truth.lanes("delimiter"), LINES, sidecar.laneLines_ids)
    return compared + _compared(found, centers, truth.lanes("centerline"), CENTERS, sidecar.centerLines_ids)


def _compared(
    found: ApolloFrame, lines: tuple[PointLists, FlagLists], lanes: list[UprightLane], rule: Rule, ids: list[str]
) -> Comparison:
    points, flags = lines
    compared, _ = compare([upright(found, line) for line in points], [_ours(lane) for lane in lanes], rule, ids)
    return compared.because(
        f"{rule.name} {i}: expected visible points first, got a hidden one before them"
        for i, visible in enumerate(flags)
        if (np.diff(visible.astype(int)) > 0).any()
    )


def upright(frame: ApolloFrame, points_apollo: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Their ground points before the camera, by their projection: the camera is h sin p ahead and h cos p above."""
    h, c, s = frame.cam_height_m, np.cos(frame.cam_pitch_rad), np.sin(frame.cam_pitch_rad)
    x, y, z = points_apollo.T
    down, ahead = h - s * y - c * z, c * y - s * z
    return np.column_stack([x, ahead, -down])


def _ours(lane: UprightLane) -> OurLine:
    line = lane.in_metres(VIEW)
    x, y, _ = line.wanted.T
    in_band = (np.abs(x) < ASIDE_M) & (y > NEAR_M) & (y < FAR_M)
    return line if in_band.sum() >= 3 else OurLine(line.id, line.points, line.wanted[:0])
