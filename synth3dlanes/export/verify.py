"""The self-check of an export: its own ground truth must score perfectly, and the same moved aside close to nothing.

Ground truth as prediction is the ground truth after the benchmark's own pruning, copied. The negative control takes
every line for itself and moves it 2 m aside: in a whole frame it would land near its neighbour and match that.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, astuple, dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from synth3dlanes.export import apollo, once, openlane, tusimple
from synth3dlanes.export.lines import View
from synth3dlanes.export.score_3d import (
    HALF_WIDTH_M,
    NEAR,
    Frames,
    Line3d,
    prune,
    samples_seen,
    score_apollo,
    score_openlane,
)
from synth3dlanes.export.score_other import TusimpleScore, score_once, score_tusimple

SHIFT_M = 2.0
TOLERANCE_M = 1e-3


@dataclass(frozen=True)
class Verified:
    """One list of frames, scored; `problems` is empty where the export is right."""

    name: str
    n_frames: int
    n_lines: int
    perfect: dict[str, float]
    shifted: dict[str, float]
    problems: tuple[str, ...]


def verify(out: Path, format_name: str, most_frames: int) -> tuple[Verified, ...]:
    """Score at most the first `most_frames` frames of every list of an export."""
    check = {"apollo": _apollo, "openlane": _openlane, "once": _once, "tusimple": _tusimple}[format_name]
    return tuple(check(out, most_frames))


def _apollo(out: Path, most_frames: int) -> Iterator[Verified]:
    for path in sorted((out / "data_splits").glob("*/*.json")):
        name = str(path.relative_to(out))
        with path.open() as file:
            frames = [apollo.read(line, name) for line in islice(file, most_frames)]
        problems = _image_problems([out / apollo.ROOT / frame.raw_file for frame in frames], apollo.VIEW)
        for kind in ("lane", "center"):
            true = [_apollo_lines(frame, is_center=kind == "center") for frame in frames]
            yield _verified_3d(f"{name} {kind} lines", true, problems, is_openlane=False)


def _apollo_lines(frame: apollo.ApolloFrame, is_center: bool) -> list[Line3d]:
    lines = (frame.lane_lines_apollo, frame.lane_lines_visible)
    centers = (frame.center_lines_apollo, frame.center_lines_visible)
    return [Line3d(points, visible) for points, visible in zip(*(centers if is_center else lines), strict=True)]


def _openlane(out: Path, most_frames: int) -> Iterator[Verified]:
    for path in sorted([*(out / "lists").glob("*.txt"), *(out / "lane3d_1000/test").glob("*.txt")]):
        case = path.stem.removeprefix("1000_")
        images = path.read_text().splitlines()[:most_frames]
        labels = [image.replace("jpg", "json") for image in images]
        if path.parent.name == "test":
            labels = [f"test/{case}/{label.partition('/')[2]}" for label in labels]
        frames = [openlane.read((out / "lane3d_1000" / label).read_text(), label) for label in labels]
        problems = _image_problems([out / "images" / image for image in images], openlane.VIEW)
        problems += [
            f"{image}: file_path is {frame.file_path}"
            for image, frame in zip(images, frames, strict=True)
            if frame.file_path != image
        ]
        true = [_openlane_lines(frame) for frame in frames]
        yield _verified_3d(str(path.relative_to(out)), true, problems, is_openlane=True)


def _openlane_lines(frame: openlane.OpenLaneFrame) -> list[Line3d]:
    vehicle_from_cam = frame.vehicle_from_cam_waymo
    return [
        Line3d(openlane.ground_from_waymo(line.xyz_waymo, vehicle_from_cam), line.visible, line.category)
        for line in frame.lines
    ]


def _verified_3d(name: str, true: list[list[Line3d]], problems: list[str], is_openlane: bool) -> Verified:
    score = score_openlane if is_openlane else score_apollo
    half_width_m = HALF_WIDTH_M if is_openlane else 30.0
    predicted = [[pruned for line in lines if (pruned := prune(line, half_width_m))] for lines in true]
    alone: Frames = [([line], [_moved(line)]) for lines in predicted for line in lines]
    perfect, shifted = score(list(zip(true, predicted, strict=True))), score(alone)
    n_lines = sum(map(len, predicted))
    found = list(problems)
    if n_lines:
        if min(perfect.recall, perfect.precision) < 1 or perfect.f_score < 0.99999:
            found.append(f"{name}: expected ground truth to score F = 1, got {perfect}")
        found += _error_problems(name, predicted, (perfect.x_near_m, perfect.x_far_m), is_openlane)
        if shifted.f_score > 0.01:
            found.append(f"{name}: expected lines moved {SHIFT_M} m aside to score F = 0, got {shifted.f_score:.3f}")
    return Verified(name, len(true), n_lines, asdict(perfect), asdict(shifted), tuple(found))


def _error_problems(
    name: str, predicted: list[list[Line3d]], errors_m: tuple[float, float], is_openlane: bool
) -> list[str]:
    # Gen-LaneNet's evaluator charges 1.5 m for a near or far part that a line does not have.
    problems = []
    for part, error_m, where in ((NEAR, errors_m[0], "near"), (~NEAR, errors_m[1], "far")):
        missing = [not (samples_seen(line) & part).any() for lines in predicted for line in lines]
        expected_m = 0.0 if is_openlane else 1.5 * float(np.mean(missing))
        if abs(error_m - expected_m) > TOLERANCE_M:
            problems.append(f"{name}: expected a {where} x error of {expected_m:.4f} m, got {error_m:.4f}")
    return problems


def _moved(line: Line3d) -> Line3d:
    return replace(line, points_ground=line.points_ground + np.array([SHIFT_M, 0, 0]))


def _once(out: Path, most_frames: int) -> Iterator[Verified]:
    root = out / once.ROOT
    for path in sorted((root / "list").glob("*.txt")):
        part, names = path.stem, path.read_text().splitlines()[:most_frames]
        true = [once.read((root / part / f"{name}.json").read_text(), name).lanes_cv for name in names]
        copies = [[points_cv.copy() for points_cv in lanes] for lanes in true]
        alone = [([points_cv], [points_cv + np.array([SHIFT_M, 0, 0])]) for lanes in true for points_cv in lanes]
        perfect, shifted = score_once(list(zip(true, copies, strict=True))), score_once(alone)
        problems = _image_problems([root / "data" / f"{name}.jpg" for name in names], once.VIEW)
        if alone and (perfect.f_score < 1 or perfect.distance_m > TOLERANCE_M):
            problems.append(f"{part}: expected ground truth to score F = 1 at distance 0, got {perfect}")
        if shifted.f_score > 0.01:
            problems.append(f"{part}: expected lines moved {SHIFT_M} m aside to score F = 0, got {shifted}")
        yield Verified(part, len(names), len(alone), asdict(perfect), asdict(shifted), tuple(problems))


def _tusimple(out: Path, most_frames: int) -> Iterator[Verified]:
    sidecars = {}
    with (out / "sidecar.jsonl").open() as file:
        for line in file:
            sidecar = json.loads(line)
            sidecars[sidecar["raw_file"]] = sidecar
    for path in sorted(out.glob("*label*.json")):
        with path.open() as file:
            frames = [tusimple.read(line, path.name) for line in islice(file, most_frames)]
        true = [frame.lanes_u_px for frame in frames]
        rows_px = tusimple.ROWS_PX.astype(float)
        perfect = score_tusimple([(lanes, lanes.copy()) for lanes in true], rows_px)
        shifted = _shifted_rows(frames, sidecars)
        problems = _image_problems([out / frame.raw_file for frame in frames], tusimple.VIEW)
        if (perfect.accuracy, perfect.false_positive, perfect.false_negative) != (1.0, 0.0, 0.0):
            problems.append(f"{path.name}: expected ground truth to score 1, 0, 0, got {perfect}")
        if shifted.false_negative < 0.95:
            problems.append(f"{path.name}: expected lines moved {SHIFT_M} m aside to be missed, got {shifted}")
        yield Verified(path.name, len(frames), sum(map(len, true)), asdict(perfect), asdict(shifted), tuple(problems))


def _shifted_rows(frames: list[tusimple.TusimpleFrame], sidecars: dict[str, dict[str, Any]]) -> TusimpleScore:
    """Every line alone and moved, scored on its own rows, by which it counts.

    The official score takes rows where both lines are absent for right, so over all rows nobody can miss a short line.
    """
    scores, weights = [], []
    for frame in frames:
        moved_u_px = _moved_rows(frame.lanes_u_px, sidecars[frame.raw_file])
        for true, moved in zip(frame.lanes_u_px, moved_u_px, strict=True):
            own = true >= 0
            scores.append(
                astuple(score_tusimple([(true[None, own], moved[None, own])], frame.rows_px[own].astype(float)))
            )
            weights.append(np.count_nonzero(own))
    return TusimpleScore(*np.average(scores, axis=0, weights=weights))


def _moved_rows(lanes_u_px: Float[np.ndarray, "l r"], sidecar: dict[str, Any]) -> Float[np.ndarray, "l r"]:
    # On the road plane one metre aside is |v - horizon| cos(pitch) / height pixels in row v.
    pitch_rad = sidecar["camera_pitch_rad"]
    horizon_px = tusimple.VIEW.height_px / 2 - tusimple.VIEW.f_px * np.tan(pitch_rad)
    px_per_m = np.abs(tusimple.ROWS_PX - horizon_px) * np.cos(pitch_rad) / sidecar["camera_height_m"]
    return np.where(lanes_u_px >= 0, lanes_u_px + SHIFT_M * px_per_m, lanes_u_px)


def _image_problems(paths: list[Path], view: View) -> list[str]:
    problems = []
    for path in paths:
        if not path.is_file():
            problems.append(f"{path}: expected an image, found no file")
            continue
        with Image.open(path) as image:
            if image.size != (view.width_px, view.height_px) or image.format != "JPEG":
                problems.append(
                    f"{path}: expected a JPEG of {view.width_px}x{view.height_px}, got {image.format} {image.size}"
                )
    return problems
