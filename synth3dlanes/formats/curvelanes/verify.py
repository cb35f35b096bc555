"""The self-check of a CurveLanes export."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from synth3dlanes.formats.band_score import score
from synth3dlanes.formats.curvelanes.convention import EVALUATED, FINER
from synth3dlanes.formats.curvelanes.read import labels_path, parse
from synth3dlanes.formats.reading import listed_files, read_text
from synth3dlanes.formats.self_check import (
    Sidecars,
    Verification,
    band_problems,
    controls,
    drawable,
    image_problems,
    moved_aside,
)


def verify(out: Path, size_px: tuple[int, int], most_frames: int) -> Iterator[Verification]:
    """The lines of every list."""
    sidecars = Sidecars(out)
    scale, finer = (np.array([canvas.width_px, canvas.height_px]) / size_px for canvas in (EVALUATED, FINER))
    for path in sorted(out.glob("*/*.txt")):
        part = path.parent.name
        images = [f"{part}/{image}" for image in listed_files(path, most_frames)]
        if not images:
            continue
        true, pairs = [], []
        for image in images:
            where = out / labels_path(image)
            lines = drawable(parse(read_text(where), str(where)), str(where))
            moved = [moved_aside(line, sidecars[image]) for line in lines]
            true.append([line * scale for line in lines])
            pairs += [(line * finer, other * finer) for line, other in zip(lines, moved, strict=True)]
        perfect, shifted = score([(lines, lines) for lines in true], EVALUATED), score(controls(pairs, FINER), FINER)
        problems = image_problems([out / image for image in images], size_px)
        problems += band_problems(part, perfect, shifted) if pairs else ()
        yield Verification(part, len(images), len(pairs), asdict(perfect), asdict(shifted), tuple(problems))
