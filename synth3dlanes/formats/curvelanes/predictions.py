"""Score predictions for CurveLanes."""

from collections.abc import Iterator
from pathlib import Path, PurePath

import numpy as np

from synth3dlanes.formats.band_score import score as score_bands
from synth3dlanes.formats.curvelanes.convention import EVALUATED
from synth3dlanes.formats.curvelanes.read import labels_path, parse
from synth3dlanes.formats.curvelanes.verify import read
from synth3dlanes.formats.format import Rates, ReadFrame
from synth3dlanes.formats.reading import drawable, image_size, read_text
from synth3dlanes.formats.scoring import EVERY, predicted, rates
from synth3dlanes.system.arrays import Polyline2


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A folder with the files `*.lines.json` of all images, of their size: in the folders of the export, or in none."""

    def find(frame: ReadFrame) -> tuple[Polyline2, ...] | None:
        own = labels_path(frame.file)
        for path in (predictions / own, predictions / PurePath(own).name):
            if path.exists():
                return drawable(parse(read_text(path), str(path)), str(path))
        return None

    for name, frames in predicted(read(out, EVERY), find, predictions):
        pairs = []
        for frame, lines in frames:
            scale = np.array([EVALUATED.width_px, EVALUATED.height_px]) / image_size(out / frame.file)
            pairs.append(([line * scale for line in frame.content[0]], [line * scale for line in lines]))
        yield rates(name, frames, score_bands(pairs, EVALUATED))
