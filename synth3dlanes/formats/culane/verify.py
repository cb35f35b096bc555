"""Read a CULane export back and compare it with our labels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from synth3dlanes.formats.comparing import (
    NEAR_START_M,
    Comparison,
    ExportView,
    Gap,
    OurLine,
    Rule,
    SourceSample,
    camera_problems,
    compare,
    distances,
    places_beside,
)
from synth3dlanes.formats.culane.convention import CAMERA, MASK_WIDTH_PX, MAX_LINES, ROWS_PX
from synth3dlanes.formats.culane.read import lines_path, parse_entry, parse_lines
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.reading import drawable, first_lines, read_mask, read_text
from synth3dlanes.formats.sidecar import Sidecar, Sidecars

# Columns have three decimals.
RULE = Rule("px", 0.002, most=MAX_LINES)
# Lines of the masks are drawn 16 pixels wide, with corners.
MASK_PX = MASK_WIDTH_PX / 2 + 3.0


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every list, with the masks of those that have them."""
    sidecars = Sidecars(out, Sidecar)
    for path in sorted((out / "list").rglob("*.txt")):
        yield FrameList(str(path.relative_to(out)), _frames(out, path, most_frames, sidecars))


def _frames(out: Path, path: Path, most_frames: int, sidecars: Sidecars[Sidecar]) -> Iterator[ReadFrame]:
    for number, text in enumerate(first_lines(path, most_frames), start=1):
        entry = parse_entry(text, f"{path}:{number}")
        where = str(out / lines_path(entry.image))
        lines = drawable(parse_lines(read_text(Path(where)), where), where)
        mask = entry.mask and read_mask(out / entry.mask, (CAMERA.width_px, CAMERA.height_px), "L")
        yield ReadFrame(entry.image, where, entry.image, (lines, entry, mask, sidecars[entry.image]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in pixels, from left to right; the flags and the mask, where a line has its place as number."""
    lines, entry, mask, sidecar = frame.content
    view, lanes = ExportView(sidecar.img_from_cv, (CAMERA.width_px, CAMERA.height_px)), truth.lanes("delimiter")
    places = places_beside(lanes, NEAR_START_M)
    ours = [lane.at_rows(view, ROWS_PX) for lane in lanes if lane.id in places]
    compared, ids = compare(lines, ours, RULE, sidecar.lines_ids)
    problems = list(camera_problems(truth, sidecar.camera_height_m, sidecar.camera_pitch_rad))
    numbers = [places[name] for name in ids]
    if numbers != sorted(numbers):
        problems.append(f"expected lines from left to right, got the places {numbers} of {', '.join(ids)}")
    if mask is None:
        return compared.because(problems)
    flags = [number for number, exists in enumerate(entry.exists, start=1) if exists]
    if flags != sorted(numbers):
        problems.append(f"{entry.mask}: expected the flags of the lines {sorted(numbers)}, got those of {flags}")
    by_place = {places[line.id]: line for line in ours if line.id in ids}
    gaps = tuple(_mask_gaps(mask, by_place))
    problems += (
        f"{entry.mask}: expected the line {gap.name} within {MASK_PX:g} px, got pixels {gap.worst:.3g} px away"
        for gap in gaps
        if not gap.worst <= MASK_PX
    )
    problems += _mask_problems(entry.mask, mask, by_place)
    return compared.because(problems)


def _mask_gaps(mask: Shaped[np.ndarray, "h w"], by_place: dict[int, OurLine]) -> Iterator[Gap]:
    for number, line in by_place.items():
        drawn = np.argwhere(mask == number)[:, ::-1] + 0.5
        if len(drawn):
            apart = distances(drawn[:: max(1, len(drawn) // 500)], line.points)
            yield Gap.of(line.id, "px", apart)


def _mask_problems(where: str, mask: Shaped[np.ndarray, "h w"], by_place: dict[int, OurLine]) -> Iterator[str]:
    others = sorted(set(np.unique(mask).tolist()) - {0, *by_place})
    if others:
        yield f"{where}: expected the numbers {sorted(by_place)} of its lines, got {others} too"
    for number, line in by_place.items():
        columns, rows = np.clip(np.floor(line.wanted[1:-1]).astype(int), 0, np.array(mask.shape)[::-1] - 1).T
        bare = np.count_nonzero(mask[rows, columns] == 0)
        if bare:
            yield f"{where}: expected the line {line.id} as {number}, got {bare} of its {len(rows)} points without it"
