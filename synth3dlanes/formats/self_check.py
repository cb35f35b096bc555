"""What the self-checks of all formats share: a file's own ground truth must score perfectly, and the same moved aside
close to nothing.

Ground truth as prediction is the ground truth after the benchmark's own pruning, copied. The negative control takes
every line for itself and moves it 2 m aside: in a whole frame it would land near its neighbour and match that.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from synth3dlanes.arrays import Polyline2
from synth3dlanes.errors import FormatError
from synth3dlanes.formats.band_score import BandScore, Canvas
from synth3dlanes.formats.line_score import NEAR, Frames, Line3d, Score3d, sample_line
from synth3dlanes.formats.reading import image_header, read_file
from synth3dlanes.formats.writing import SIDECAR
from synth3dlanes.json_arrays import JsonMatrix3
from synth3dlanes.schema import Excerpt, Positive, parse, shown

SHIFT_M = 2.0
TOLERANCE_M = 1e-3


@dataclass(frozen=True)
class Verification:
    """One list of frames, scored; `problems` is empty where the export is right."""

    name: str
    n_frames: int
    n_lines: int
    perfect: dict[str, float]
    shifted: dict[str, float]
    problems: tuple[str, ...]


@dataclass(frozen=True)
class Benchmark3d:
    """A 3D benchmark's score, its pruning of a line, and what it charges for a near or far part that a line lacks."""

    score: Callable[[Frames], Score3d]
    prune: Callable[[Line3d], Line3d | None]
    missing_m: float


def verify_3d(
    name: str, true: Sequence[Sequence[Line3d]], problems: Sequence[str], benchmark: Benchmark3d
) -> Verification:
    """Score the lines of each frame against themselves; `problems` are those that were found before."""
    predicted = [[pruned for line in lines if (pruned := benchmark.prune(line))] for lines in true]
    alone: Frames = [([line], [_moved(line)]) for lines in predicted for line in lines]
    perfect, shifted = benchmark.score(list(zip(true, predicted, strict=True))), benchmark.score(alone)
    found, n_lines = list(problems), sum(map(len, predicted))
    if n_lines:
        if min(perfect.recall, perfect.precision) < 1 or perfect.f_score < 0.99999:
            found.append(f"{name}: expected ground truth to score F = 1, got {perfect}")
        for part, error_m, where in ((NEAR, perfect.x_near_m, "near"), (~NEAR, perfect.x_far_m, "far")):
            lacking = [not (sample_line(line).seen & part).any() for lines in predicted for line in lines]
            expected_m = benchmark.missing_m * float(np.mean(lacking))
            if abs(error_m - expected_m) > TOLERANCE_M:
                found.append(f"{name}: expected a {where} x error of {expected_m:.4f} m, got {error_m:.4f}")
        if shifted.f_score > 0.01:
            found.append(f"{name}: expected lines moved {SHIFT_M} m aside to score F = 0, got {shifted.f_score:.3f}")
    return Verification(name, len(true), n_lines, asdict(perfect), asdict(shifted), tuple(found))


def moved_aside(points_img: Float[np.ndarray, "*n 2"], sidecar: "Sidecar") -> Float[np.ndarray, "*n 2"]:
    """Points of the road plane in the image after a move of SHIFT_M to the right; the sidecar has the camera."""
    _, (_, f_px, cy_px), _ = sidecar.img_from_cv.tolist()
    pitch_rad = sidecar.camera_pitch_rad
    # On the road plane one metre aside is |v - horizon| cos(pitch) / height pixels in row v.
    horizon_px = cy_px - f_px * np.tan(pitch_rad)
    px_per_m = np.abs(points_img[..., 1] - horizon_px) * np.cos(pitch_rad) / sidecar.camera_height_m
    return points_img + SHIFT_M * px_per_m[..., None] * [1.0, 0.0]


class Sidecar(Excerpt):
    """A frame's line of `sidecar.jsonl`."""

    image: str
    img_from_cv: JsonMatrix3
    camera_height_m: Positive
    camera_pitch_rad: Annotated[float, Field(gt=-1.5, lt=1.5)]


class Sidecars(dict[str, Sidecar]):
    """The lines of `sidecar.jsonl` of an export by their images; raise FormatError for an image without one."""

    def __init__(self, out: Path) -> None:
        self.path = out / SIDECAR
        for number, line in enumerate(read_file(self.path).splitlines(), start=1):
            found = parse(Sidecar, line, f"{self.path}:{number}", "a frame of an export")
            self[found.image] = found

    def __missing__(self, image: str) -> Sidecar:
        raise FormatError(f"{self.path}: expected a line of the image {image}, got none")


def drawable(lines: Sequence[Polyline2], where: str) -> tuple[Polyline2, ...]:
    """Lines that can be drawn as bands; raise FormatError where one has fewer than two points, or the same twice."""
    for line in lines:
        if len(line) < 2 or not np.abs(np.diff(line, axis=0)).max(axis=1).all():
            raise FormatError(f"{where}: expected lines of two different points or more, got {shown(line.tolist())}")
    return tuple(lines)


def controls(
    pairs: Iterable[tuple[Polyline2, Polyline2]], canvas: Canvas
) -> list[tuple[list[Polyline2], list[Polyline2]]]:
    """Frames of one line and the same line moved aside. Lines that move by less than a band, as those far ahead, are
    left out: they would match."""
    return [([line], [moved]) for line, moved in pairs if np.abs(moved - line)[:, 0].mean() >= canvas.band_px]


def band_problems(name: str, perfect: BandScore, shifted: BandScore) -> Iterator[str]:
    """Findings unless lines as bands score as they must."""
    if perfect != BandScore(1.0, 1.0, 1.0):
        yield f"{name}: expected ground truth to score F = 1, got {perfect}"
    if shifted.f_score > 0.01:
        yield f"{name}: expected lines moved {SHIFT_M} m aside to score F = 0, got {shifted}"


def image_problems(paths: Sequence[Path], size_px: tuple[int, int]) -> list[str]:
    """Images that are missing, of another width or height, or no JPEG."""
    problems = []
    for path in paths:
        if not path.is_file():
            problems.append(f"{path}: expected an image, found no file")
            continue
        width_px, height_px, kind = image_header(path)
        if (width_px, height_px, kind) != (*size_px, "JPEG"):
            expected, got = f"{size_px[0]}x{size_px[1]}", f"{width_px}x{height_px}"
            problems.append(f"{path}: expected a JPEG of {expected}, got {kind} of {got}")
    return problems


def _moved(line: Line3d) -> Line3d:
    return replace(line, points_ground=line.points_ground + np.array([SHIFT_M, 0, 0]))
