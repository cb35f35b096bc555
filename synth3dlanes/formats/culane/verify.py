"""The self-check of a CULane export."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from synth3dlanes.arrays import Polyline2
from synth3dlanes.formats.band_score import score
from synth3dlanes.formats.culane.convention import EVALUATED
from synth3dlanes.formats.culane.read import CulaneEntry, lines_path, parse_entry, parse_lines
from synth3dlanes.formats.reading import first_lines, read_mask, read_text
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
    """The lines of every list, and the masks of those that have them."""
    sidecars = Sidecars(out)
    for path in sorted((out / "list").rglob("*.txt")):
        name = str(path.relative_to(out))
        found = enumerate(first_lines(path, most_frames), start=1)
        entries = [parse_entry(line, f"{path}:{number}") for number, line in found]
        if not entries:
            continue
        true = [_read(out, entry) for entry in entries]
        pairs = [
            (line, moved_aside(line, sidecars[entry.image]))
            for lines, entry in zip(true, entries, strict=True)
            for line in lines
        ]
        perfect = score([(lines, lines) for lines in true], EVALUATED)
        shifted = score(controls(pairs, EVALUATED), EVALUATED)
        problems = image_problems([out / entry.image for entry in entries], size_px)
        for entry, lines in zip(entries, true, strict=True):
            problems += _mask_problems(out, entry, lines, size_px)
        problems += band_problems(name, perfect, shifted) if pairs else ()
        yield Verification(name, len(entries), len(pairs), asdict(perfect), asdict(shifted), tuple(problems))


def _read(out: Path, entry: CulaneEntry) -> tuple[Polyline2, ...]:
    path = out / lines_path(entry.image)
    return drawable(parse_lines(read_text(path), str(path)), str(path))


def _mask_problems(
    out: Path, entry: CulaneEntry, lines: tuple[Polyline2, ...], size_px: tuple[int, int]
) -> Iterator[str]:
    """Findings unless the mask has every line, under its number."""
    if entry.mask is None:
        return
    mask = read_mask(out / entry.mask, size_px, "L")
    numbers = [number for number, exists in enumerate(entry.exists, 1) if exists]
    found = sorted(set(np.unique(mask).tolist()) - {0})
    if found != numbers or len(lines) != len(numbers):
        yield f"{entry.mask}: expected lines {numbers} as its list says, got {found} and {len(lines)} in the text"
