"""The image-only variant (paper, 4.4): tuSimple's labels as lanes on a fixed plane, and its accuracy.

A fixed pose stands for the hand-picked homography: 9 deg and 1.6 m make straight lanes parallel in the top view. The
pictures lose their top 80 rows (public settings; notes/model.md, 1.12).
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image, UnidentifiedImageError

from synth3dlanes.errors import FormatError
from synth3dlanes.frames import project, transform
from synth3dlanes.labels import CameraLabel, Labels, Lane, LaneGraph

from .foreign import MALFORMED, ForeignSample
from .lanes import Detection, Prediction
from .poses import Pose, road_from_cam

SIZE_PX = (1280, 640)
CROP_TOP_PX = 80
IMG_FROM_CAM = np.array([[1000.0, 640.0, 0.0], [0.0, 320.0, -1000.0], [0.0, 1.0, 0.0]])
POSE = Pose(float(np.radians(9.0)), 1.6)
FAR_M = 110.0
ABSENT = -2
Lines = Sequence[Sequence[int | float]]
POINT_PX, LINE_SHARE, MAX_EXTRA, MAX_LINES = 20.0, 0.85, 2, 4


@dataclass(frozen=True, eq=False)
class TusimpleSplit:
    """A `label_data_*.json`; the clips lie beside it."""

    path: Path

    @cached_property
    def lines(self) -> list[str]:
        """One document per line."""
        return [line for line in self.path.read_text(encoding="utf-8").splitlines() if line.strip()]

    def __len__(self) -> int:
        return len(self.lines)

    def __getitem__(self, index: int, /) -> ForeignSample:
        key = self.key(index)
        try:
            with Image.open(self.path.parent / key) as image:
                pixels = np.array(image.convert("RGB"))[CROP_TOP_PX:]
        except (OSError, UnidentifiedImageError) as error:
            raise FormatError(f"{self.path}:{index + 1}: expected an image {key}, got {error}") from None
        return ForeignSample(key, pixels, self.labels(index))

    def key(self, index: int) -> str:
        """`raw_file`."""
        return str(self.document(index)["raw_file"])

    def document(self, index: int) -> dict[str, Any]:
        """`raw_file`, `lanes`, `h_samples`."""
        try:
            document: dict[str, Any] = json.loads(self.lines[index])
            if not {"raw_file", "lanes", "h_samples"} <= document.keys():
                raise KeyError("raw_file, lanes and h_samples are needed")
        except (*MALFORMED, AttributeError) as error:
            raise FormatError(f"{self.path}:{index + 1}: not a tuSimple frame: {error}") from None
        return document

    def labels(self, index: int) -> Labels:
        """Image lines put onto the plane."""
        document = self.document(index)
        rows = np.array(document["h_samples"], dtype=float)
        lanes = []
        for number, columns in enumerate(document["lanes"]):
            x_px = np.array(columns, dtype=float)
            seen = x_px >= 0
            xyz_cam = onto_plane_cam(np.stack([x_px[seen], rows[seen] - CROP_TOP_PX], axis=1))
            if len(xyz_cam) >= 2:
                everywhere = np.ones(len(xyz_cam), dtype=bool)
                lanes.append(
                    Lane(f"d{number}", "delimiter", "main", "none", None, None, xyz_cam, everywhere, everywhere, None)
                )
        to_road = road_from_cam(POSE)
        camera = CameraLabel(*SIZE_PX, IMG_FROM_CAM, POSE.height_m, POSE.pitch_rad, to_road, to_road)
        return Labels(camera, tuple(lanes), LaneGraph((), {}, None))


def is_tusimple(path: Path) -> bool:
    """Whether the first line of the file is a tuSimple frame."""
    with path.open(encoding="utf-8") as file:
        return '"h_samples"' in file.readline()


def onto_plane_cam(points_img: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 3"]:
    """Pixels of the cropped image to camera points on the plane, near to far; none above the horizon or too far."""
    right, down = ((points_img - IMG_FROM_CAM[:2, 1]) / 1000.0).T
    rays_cam = np.stack([right, np.ones_like(right), -down], axis=1)
    to_road = road_from_cam(POSE)
    fall = rays_cam @ to_road[2, :3]
    rays_cam, fall = rays_cam[fall < -1e-6], fall[fall < -1e-6]
    xyz_cam = rays_cam * (POSE.height_m / -fall)[:, None]
    y_m = transform(to_road, xyz_cam)[:, 1]
    order = np.argsort(y_m)
    return xyz_cam[order[y_m[order] <= FAR_M]]


def image_line(lane: Detection, rows_px: Float[np.ndarray, " r"]) -> list[int]:
    """The lane's x at each row of the uncropped image; -2 above its last point and outside the image."""
    uv = project(IMG_FROM_CAM, lane.xyz_cam)
    uv = uv[np.isfinite(uv).all(1)]
    uv = uv[np.argsort(uv[:, 1])]
    if len(uv) < 2:
        return [ABSENT] * len(rows_px)
    wanted = rows_px - CROP_TOP_PX
    x_px = np.interp(wanted, uv[:, 1], uv[:, 0], left=np.nan, right=np.nan)
    inside = np.isfinite(x_px) & (x_px >= 0) & (x_px < SIZE_PX[0])
    return [round(float(x)) if good else ABSENT for x, good in zip(x_px, inside, strict=True)]


def accuracy(
    found: Lines, truth: Lines, rows_px: Sequence[int | float], run_time_ms: float
) -> tuple[float, float, float]:
    """Accuracy, false positive and false negative rate of one image, as the benchmark defines them.

    A point is right within 20 px across its line; absent on both sides is right as well. Of more than four true
    lines the worst is left out."""
    if run_time_ms > 200 or len(found) > len(truth) + MAX_EXTRA:
        return 0.0, 0.0, 1.0
    rows = np.asarray(rows_px, dtype=float)
    best = []
    for line in truth:
        x_px = np.asarray(line, dtype=float)
        limit_px = POINT_PX / np.cos(_lean_rad(x_px, rows))
        shares = [float((np.abs(_filled(np.asarray(f, dtype=float)) - _filled(x_px)) < limit_px).mean()) for f in found]
        best.append(max(shares, default=0.0))
    n_matched = sum(share >= LINE_SHARE for share in best)
    n_missed = len(best) - n_matched
    total = sum(best)
    if len(best) > MAX_LINES:
        total -= min(best)
        n_missed -= n_missed > 0
    n_counted = max(1, min(MAX_LINES, len(best)))
    false_positive = (len(found) - n_matched) / len(found) if found else 0.0
    return total / n_counted, false_positive, n_missed / n_counted


def mean_accuracy(
    predictions: Iterable[Prediction], split: TusimpleSplit, threshold: float = 0.5
) -> tuple[float, float, float]:
    """Means of accuracy, false positive and false negative rate over the split. Run time counts as zero."""
    rates = []
    for index, prediction in enumerate(predictions):
        document = split.document(index)
        rows = np.array(document["h_samples"], dtype=float)
        kept = [lane for lane in prediction.lanes if lane.kind == "delimiter" and lane.score >= threshold]
        rates.append(accuracy([image_line(lane, rows) for lane in kept], document["lanes"], rows.tolist(), 0.0))
    means = np.mean(rates, axis=0) if rates else np.full(3, np.nan)
    return float(means[0]), float(means[1]), float(means[2])


def _filled(x_px: Float[np.ndarray, " r"]) -> Float[np.ndarray, " r"]:
    return np.where(x_px >= 0, x_px, -100.0)


def _lean_rad(x_px: Float[np.ndarray, " r"], rows_px: Float[np.ndarray, " r"]) -> float:
    seen = x_px >= 0
    if seen.sum() < 2:
        return 0.0
    slope, _ = np.polyfit(rows_px[seen], x_px[seen], 1)
    return float(np.arctan(slope))
