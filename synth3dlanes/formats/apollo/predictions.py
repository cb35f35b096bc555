"""Score predictions for Apollo Sim-3D."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from synth3dlanes.formats.apollo.read import FlagLists, PointLists
from synth3dlanes.formats.apollo.score import score as score_lines
from synth3dlanes.formats.apollo.verify import read
from synth3dlanes.formats.format import Rates, ReadFrame
from synth3dlanes.formats.line_score import Line3d
from synth3dlanes.formats.scoring import EVERY, lines_by, predicted, rates
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import JsonPoints
from synth3dlanes.system.schema import Excerpt, Unit


class _Prediction(Excerpt):
    raw_file: str
    laneLines: tuple[JsonPoints, ...]
    laneLines_prob: tuple[Unit, ...]
    centerLines: tuple[JsonPoints, ...] = ()
    centerLines_prob: tuple[Unit, ...] = ()


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A file of JSON lines with `raw_file`, `laneLines`, `laneLines_prob`, and the same of centre lines."""
    by_image = lines_by(predictions, _Prediction, "raw_file")

    def find(frame: ReadFrame) -> _Prediction | None:
        return by_image.get(frame.content[0].raw_file)

    for name, frames in predicted(read(out, EVERY), find, predictions):
        lanes, centers = [], []
        for frame, found in frames:
            true, where = frame.content[0], f"{predictions}: {found.raw_file}"
            lanes.append(
                (
                    _true(true.lane_lines_apollo, true.lane_lines_visible),
                    _found(found.laneLines, found.laneLines_prob, where),
                )
            )
            centers.append(
                (
                    _true(true.center_lines_apollo, true.center_lines_visible),
                    _found(found.centerLines, found.centerLines_prob, where),
                )
            )
        yield rates(f"{name}, lane lines", frames, score_lines(lanes))
        if any(lines for _, lines in centers):
            yield rates(f"{name}, center lines", frames, score_lines(centers))


def _true(lines: PointLists, visible: FlagLists) -> list[Line3d]:
    return [Line3d(points, seen) for points, seen in zip(lines, visible, strict=True)]


def _found(lines: PointLists, shares: tuple[float, ...], where: str) -> list[Line3d]:
    if len(lines) != len(shares) or any(len(points) < 2 for points in lines):
        raise FormatError(f"{where}: expected lines of two points or more with a probability each, got others")
    every = (np.ones(len(points), dtype=bool) for points in lines)
    return [Line3d(points, all_, 0, share) for points, all_, share in zip(lines, every, shares, strict=True)]
