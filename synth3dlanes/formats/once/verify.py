"""The self-check of a ONCE export."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.once.convention import ROOT
from synth3dlanes.formats.once.read import parse
from synth3dlanes.formats.once.score import score
from synth3dlanes.formats.reading import listed_files, read_text
from synth3dlanes.formats.self_check import SHIFT_M, TOLERANCE_M, Verification, image_problems


def verify(out: Path, size_px: tuple[int, int], most_frames: int) -> Iterator[Verification]:
    """The lanes of every list."""
    root = out / ROOT
    for path in sorted((root / "list").glob("*.txt")):
        part, names = path.stem, listed_files(path, most_frames)
        if not names:
            continue
        true = [_lanes_cv(root / part / f"{name}.json") for name in names]
        copies = [[points_cv.copy() for points_cv in lanes] for lanes in true]
        alone = [([points_cv], [points_cv + np.array([SHIFT_M, 0, 0])]) for lanes in true for points_cv in lanes]
        perfect, shifted = score(list(zip(true, copies, strict=True))), score(alone)
        problems = image_problems([root / "data" / f"{name}.jpg" for name in names], size_px)
        if alone and (perfect.f_score < 1 or perfect.distance_m > TOLERANCE_M):
            problems.append(f"{part}: expected ground truth to score F = 1 at distance 0, got {perfect}")
        if shifted.f_score > 0.01:
            problems.append(f"{part}: expected lines moved {SHIFT_M} m aside to score F = 0, got {shifted}")
        yield Verification(part, len(names), len(alone), asdict(perfect), asdict(shifted), tuple(problems))


def _lanes_cv(path: Path) -> tuple[Float[np.ndarray, "_ 3"], ...]:
    lanes_cv = parse(read_text(path), str(path)).lanes_cv
    if any(len(points_cv) < 2 for points_cv in lanes_cv):
        raise FormatError(f"{path}: lanes: expected two points or more each, got fewer")
    return lanes_cv
