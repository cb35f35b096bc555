"""The self-check of an export: its own ground truth must score perfectly, and the same moved aside close to nothing."""

from collections.abc import Callable, Iterator
from pathlib import Path

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.apollo import verify as apollo
from synth3dlanes.formats.coco import verify as coco
from synth3dlanes.formats.culane import verify as culane
from synth3dlanes.formats.curvelanes import verify as curvelanes
from synth3dlanes.formats.export import shared_files
from synth3dlanes.formats.masks import verify as masks
from synth3dlanes.formats.once import verify as once
from synth3dlanes.formats.opendrive import verify as opendrive
from synth3dlanes.formats.openlane import verify as openlane
from synth3dlanes.formats.openlane_v2 import verify as openlane_v2
from synth3dlanes.formats.reading import read_text
from synth3dlanes.formats.self_check import Verification
from synth3dlanes.formats.tusimple import verify as tusimple
from synth3dlanes.formats.yolo import verify as yolo
from synth3dlanes.schema import Excerpt, PixelCount, parse

CHECKS = {
    "apollo": apollo.verify,
    "openlane": openlane.verify,
    "once": once.verify,
    "tusimple": tusimple.verify,
    "culane": culane.verify,
    "curvelanes": curvelanes.verify,
}

SAMPLE_CHECKS: dict[str, Callable[[Path, int], Iterator[Verification]]] = {
    "openlane_v2": openlane_v2.verify,
    "opendrive": opendrive.verify,
    "coco": coco.verify,
    "masks": masks.verify,
    "yolo": yolo.verify,
}
"""The checks of formats whose images keep their own cameras."""


class _Export(Excerpt):
    size_px: tuple[PixelCount, PixelCount] | None


def verify(out: Path, format_name: str, most_frames: int) -> tuple[Verification, ...]:
    """Score at most the first `most_frames` frames of every list of an export."""
    about = out / "export.json"
    size_px = parse(_Export, read_text(about), str(about), "an export").size_px
    if format_name in SAMPLE_CHECKS:
        verified = tuple(SAMPLE_CHECKS[format_name](out, most_frames))
    elif size_px is None:
        raise FormatError(f"{about}: size_px: expected a width and a height, got null")
    else:
        verified = tuple(CHECKS[format_name](out, size_px, most_frames))
    shared = shared_files(out, format_name)
    gone = [f"{out / path}: expected a list, got no file" for path in shared if not (out / path).is_file()]
    if gone:
        verified = (*verified, Verification("lists", 0, 0, {}, {}, tuple(gone)))
    if not any(result.n_lines for result in verified):
        problem = f"{out}: expected lane lines to score, found none"
        return (*verified, Verification("all lists", 0, 0, {}, {}, (problem,)))
    return verified
