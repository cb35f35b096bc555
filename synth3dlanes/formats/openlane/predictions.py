"""Score predictions for OpenLane."""

from collections.abc import Iterator
from pathlib import Path, PurePath

import numpy as np

from synth3dlanes.formats.format import Rates, ReadFrame
from synth3dlanes.formats.line_score import Line3d
from synth3dlanes.formats.openlane.convention import ground_from_waymo
from synth3dlanes.formats.openlane.score import score as score_lines
from synth3dlanes.formats.openlane.verify import read
from synth3dlanes.formats.reading import read_text
from synth3dlanes.formats.scoring import EVERY, predicted, rates
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import JsonPoints
from synth3dlanes.system.schema import Excerpt, parse


class _Line(Excerpt):
    xyz: JsonPoints
    category: int


class _Prediction(Excerpt):
    lane_lines: list[_Line]


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A folder with a file for each image, as `validation/segment-*/*.json`: `lane_lines`, each with `category` and
    `xyz`, n points in the ground frame of the evaluator."""

    def find(frame: ReadFrame) -> list[Line3d] | None:
        path = predictions / PurePath(frame.content.file_path).with_suffix(".json")
        if not path.exists():
            return None
        lines = parse(_Prediction, read_text(path), str(path), "predictions of OpenLane").lane_lines
        if any(len(line.xyz) < 2 for line in lines):
            raise FormatError(f"{path}: expected lines of two points or more, got fewer")
        return [Line3d(line.xyz, np.ones(len(line.xyz), dtype=bool), line.category) for line in lines]

    for name, frames in predicted(read(out, EVERY), find, predictions):
        pairs = []
        for frame, found in frames:
            pose = frame.content.vehicle_from_cam_waymo
            true = [
                Line3d(ground_from_waymo(line.xyz_waymo, pose), line.visible, line.category)
                for line in frame.content.lines
            ]
            pairs.append((true, found))
        yield rates(name, frames, score_lines(pairs))
