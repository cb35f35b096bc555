"""Score predictions for ONCE-3DLanes."""

from collections.abc import Iterator
from pathlib import Path

from synth3dlanes.formats.format import Rates, ReadFrame
from synth3dlanes.formats.once.convention import ROOT
from synth3dlanes.formats.once.score import score as score_lines
from synth3dlanes.formats.once.verify import read
from synth3dlanes.formats.reading import read_text
from synth3dlanes.formats.scoring import EVERY, predicted, rates
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import JsonPoints
from synth3dlanes.system.schema import Excerpt, Unit, parse

CONFIDENT = 0.5


class _Line(Excerpt):
    points: JsonPoints
    score: Unit


class _Prediction(Excerpt):
    lanes: list[_Line]


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A folder with a file `SEQUENCE/cam01/STAMP.json` for each image: `lanes`, each with `points` and `score`; those
    of 0.5 and more count."""

    def find(frame: ReadFrame) -> list[_Line] | None:
        name = frame.file.removeprefix(f"{ROOT}/").partition("/")[2]
        path = predictions / name
        if not path.exists():
            return None
        lanes = parse(_Prediction, read_text(path), str(path), "predictions of ONCE-3DLanes").lanes
        if any(len(lane.points) < 2 for lane in lanes):
            raise FormatError(f"{path}: expected lanes of two points or more, got fewer")
        return lanes

    for name, frames in predicted(read(out, EVERY), find, predictions):
        pairs = [
            (frame.content.lanes_cv, [lane.points for lane in lanes if lane.score >= CONFIDENT])
            for frame, lanes in frames
        ]
        yield rates(name, frames, score_lines(pairs))
