"""Score predictions for tuSimple."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from synth3dlanes.formats.format import Rates, ReadFrame
from synth3dlanes.formats.scoring import EVERY, lines_by, predicted, rates
from synth3dlanes.formats.tusimple.convention import ROWS_PX
from synth3dlanes.formats.tusimple.score import TusimpleScore, mean_score, score_frame
from synth3dlanes.formats.tusimple.verify import read
from synth3dlanes.system.arrays import Numbers
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import Excerpt, Number

MOST_MS = 200.0


class _Prediction(Excerpt):
    raw_file: str
    lanes: list[list[Number]]
    run_time: Number = 0.0


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A file of JSON lines with `raw_file`, `lanes` (a column for each row of the labels) and `run_time` (ms)."""
    by_image = lines_by(predictions, _Prediction, "raw_file")

    def find(frame: ReadFrame) -> tuple[Numbers, float] | None:
        found = by_image.get(frame.file)
        if found is None:
            return None
        if any(len(lane) != len(ROWS_PX) for lane in found.lanes):
            raise FormatError(f"{predictions}: {frame.file}: lanes: expected {len(ROWS_PX)} columns each, got others")
        return np.array(found.lanes, dtype=float).reshape(-1, len(ROWS_PX)), found.run_time

    for name, frames in predicted(read(out, EVERY), find, predictions):
        scores = [
            TusimpleScore(0.0, 0.0, 1.0)
            if run_time > MOST_MS
            else score_frame(frame.content[0].lanes_u_px, lanes, ROWS_PX.astype(float))
            for frame, (lanes, run_time) in frames
        ]
        yield rates(name, frames, mean_score(scores))
