"""The self-check of an export of masks: the lines, which come from the labels, must run through their paint, which
comes from the rendered passes."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field, RootModel
from scipy.spatial import cKDTree

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.masks.write import LEAST_POINTS
from synth3dlanes.formats.reading import image_size, listed_files, numbers, read_mask, read_text
from synth3dlanes.formats.self_check import Verification
from synth3dlanes.schema import Excerpt, parse
from synth3dlanes.settings import SEMANTIC_IDS

# Shares of the image's width: paint is at most this far from its line, and the control moves lines by the other.
NEAR, MOVED = 1 / 12, 1 / 8
LEAST_ON_LINE = 0.97
MODES = {"semantic": "L", "instance": "I;16", "lines": "L"}


class _Line(Excerpt):
    number: Annotated[int, Field(ge=1, le=255)]


class _Lines(RootModel[list[_Line]]):
    """The lines of a frame, in the order of their texts."""


def verify(out: Path, most_frames: int) -> Iterator[Verification]:
    """The frames of every part."""
    for path in sorted((out / "lists").glob("*.txt")):
        images = listed_files(path, most_frames)
        problems, n_lines, n_paint, n_own, n_moved = list[str](), 0, 0, 0, 0
        for image in images:
            name = image.rpartition(".")[0]
            problems += _problems(out, image, name)
            if problems:
                continue
            marks = read_mask(out / f"lines/{name}.png", image_size(out / "images" / image), "L")
            lines, most_px = _lines(out, name), NEAR * marks.shape[1]
            n_lines += len(lines)
            for number in lines:
                paint = np.argwhere(marks == number)[:, ::-1] + 0.5
                aside = {**lines, number: lines[number] + np.array([MOVED * marks.shape[1], 0.0])}
                n_paint += len(paint)
                n_own += _nearest_to(paint, lines, number, most_px)
                n_moved += _nearest_to(paint, aside, number, most_px)
        perfect, shifted = n_own / max(1, n_paint), n_moved / max(1, n_paint)
        if n_paint and perfect < LEAST_ON_LINE:
            problems.append(
                f"{path.stem}: expected {LEAST_ON_LINE:.0%} of the paint nearest to its own line, got {perfect:.1%}"
            )
        yield Verification(
            path.stem, len(images), n_lines, {"own_line": perfect}, {"own_line": shifted}, tuple(problems)
        )


def _problems(out: Path, image: str, name: str) -> Iterator[str]:
    size_px = image_size(out / "images" / image)
    semantic, _, lines = (read_mask(out / folder / f"{name}.png", size_px, mode) for folder, mode in MODES.items())
    if semantic.max() >= len(SEMANTIC_IDS):
        yield f"{out}/semantic/{name}.png: expected classes up to {len(SEMANTIC_IDS) - 1}, got {semantic.max()}"
    if (semantic[lines > 0] != SEMANTIC_IDS["marking"]).any():
        yield f"{out}/lines/{name}.png: expected lines on marking only, got others"


def _lines(out: Path, name: str) -> dict[int, Float[np.ndarray, "_ 2"]]:
    """The lines of a frame by their numbers in its mask."""
    path, told = out / f"lines/{name}.lines.txt", out / f"lines/{name}.json"
    texts = read_text(path).splitlines()
    about = parse(_Lines, read_text(told), str(told), "the lines of a mask").root
    if len(about) != len(texts):
        raise FormatError(f"{told}: expected {len(texts)} lines as in {path.name}, got {len(about)}")
    lines = {line.number: numbers(text, str(path)) for line, text in zip(about, texts, strict=True)}
    if any(len(points) < LEAST_POINTS for points in lines.values()):
        raise FormatError(f"{path}: expected lines of {LEAST_POINTS} points or more, got fewer")
    return lines


def _nearest_to(
    paint: Float[np.ndarray, "n 2"], lines: dict[int, Float[np.ndarray, "_ 2"]], number: int, most_px: float
) -> int:
    """How many pixels are near this line and nearer than to any other; lines have a point every few pixels."""
    fine = {k: np.concatenate([np.linspace(a, b, 9) for a, b in pairwise(line)]) for k, line in lines.items()}
    gaps_px = {k: np.asarray(cKDTree(points).query(paint)[0]) for k, points in fine.items()}
    nearest_px = np.stack(list(gaps_px.values())).min(axis=0)
    return int(np.count_nonzero(gaps_px[number] <= np.minimum(nearest_px, most_px)))
