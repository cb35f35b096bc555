"""Score predictions for CULane."""

from collections.abc import Iterator
from pathlib import Path

from synth3dlanes.formats.band_score import score as score_bands
from synth3dlanes.formats.culane.convention import EVALUATED
from synth3dlanes.formats.culane.read import lines_path, parse_lines
from synth3dlanes.formats.culane.verify import read
from synth3dlanes.formats.format import Rates, ReadFrame
from synth3dlanes.formats.reading import drawable, read_text
from synth3dlanes.formats.scoring import EVERY, predicted, rates
from synth3dlanes.system.arrays import Polyline2


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A folder with the files `*.lines.txt` of all images, in the folders of the export."""

    def find(frame: ReadFrame) -> tuple[Polyline2, ...] | None:
        path = predictions / lines_path(frame.file)
        return drawable(parse_lines(read_text(path), str(path)), str(path)) if path.exists() else None

    for name, frames in predicted(read(out, EVERY), find, predictions):
        pairs = [(frame.content[0], lines) for frame, lines in frames]
        yield rates(name, frames, score_bands(pairs, EVALUATED))
