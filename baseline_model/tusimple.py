"""The image-only variant (paper, 4.4): convert tuSimple's image lines to lanes on a fixed plane, and back.

A fixed pose replaces the paper's hand-picked homography: 9 deg and 1.6 m make straight lanes parallel in the top view.
The top 80 rows of images are cropped, as in public implementations.
"""

from collections.abc import Iterable
from dataclasses import astuple, dataclass

import numpy as np
from jaxtyping import Float, Int

from synth3dlanes.formats.reading import ForeignSample
from synth3dlanes.formats.tusimple.convention import ABSENT
from synth3dlanes.formats.tusimple.read import TusimpleSplit
from synth3dlanes.formats.tusimple.score import mean_score, score_frame
from synth3dlanes.frames import project, transform
from synth3dlanes.labels import CameraLabel, Labels, Lane, LaneGraph

from .lanes import Detection, Prediction
from .poses import Pose, onto_plane, road_from_cam

SIZE_PX = (1280, 640)
CROP_TOP_PX = 80
IMG_FROM_CAM = np.array([[1000.0, 640.0, 0.0], [0.0, 320.0, -1000.0], [0.0, 1.0, 0.0]])
POSE = Pose(float(np.radians(9.0)), 1.6)
FAR_M = 110.0


@dataclass(frozen=True, eq=False)
class TusimpleOnPlane:
    """A tuSimple label file as labelled images: lines projected onto the plane, images without their top rows."""

    split: TusimpleSplit

    def __len__(self) -> int:
        return len(self.split)

    def __getitem__(self, index: int, /) -> ForeignSample:
        return ForeignSample(self.key(index), self.split.image(index)[CROP_TOP_PX:], self.labels(index))

    def key(self, index: int) -> str:
        """The frame's `raw_file`."""
        return self.split.frame(index).raw_file

    def labels(self, index: int) -> Labels:
        """The image lines projected onto the plane."""
        frame = self.split.frame(index)
        lanes = []
        for number, u_px in enumerate(frame.lanes_u_px):
            seen = u_px >= 0
            xyz_cam = _lane_points(np.stack([u_px[seen], frame.rows_px[seen] - CROP_TOP_PX], axis=1))
            if len(xyz_cam) >= 2:
                everywhere = np.ones(len(xyz_cam), dtype=bool)
                lanes.append(
                    Lane(f"d{number}", "delimiter", "main", "none", None, None, xyz_cam, everywhere, everywhere, None)
                )
        to_road = road_from_cam(POSE)
        camera = CameraLabel(*SIZE_PX, IMG_FROM_CAM, POSE.height_m, POSE.pitch_rad, to_road, to_road)
        return Labels(camera, tuple(lanes), LaneGraph((), {}, None))


def _lane_points(points_img: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 3"]:
    """Project pixels of the cropped image onto the plane, as camera points from near to far; pixels above the horizon
    and points beyond FAR_M are dropped."""
    right, down = ((points_img - IMG_FROM_CAM[:2, 1]) / 1000.0).T
    xyz_cam = onto_plane(np.stack([right, np.ones_like(right), -down], axis=1), POSE)
    y_m = transform(road_from_cam(POSE), xyz_cam)[:, 1]
    order = np.argsort(y_m)
    return xyz_cam[order[y_m[order] <= FAR_M]]


def image_line(lane: Detection, rows_px: Float[np.ndarray, " r"]) -> Int[np.ndarray, " r"]:
    """The lane's x at each row of the uncropped image; -2 above its last point and outside the image."""
    uv = project(IMG_FROM_CAM, lane.xyz_cam)
    uv = uv[np.isfinite(uv).all(1)]
    uv = uv[np.argsort(uv[:, 1])]
    if len(uv) < 2:
        return np.full(len(rows_px), ABSENT)
    u_px = np.interp(rows_px - CROP_TOP_PX, uv[:, 1], uv[:, 0], left=ABSENT, right=ABSENT)
    return np.where((u_px >= 0) & (u_px < SIZE_PX[0]), np.rint(u_px).astype(int), ABSENT)


def mean_accuracy(
    predictions: Iterable[Prediction], samples: TusimpleOnPlane, threshold: float = 0.5
) -> tuple[float, float, float]:
    """Means of accuracy, false positive and false negative rate over the split."""
    scores = []
    for index, prediction in enumerate(predictions):
        frame = samples.split.frame(index)
        rows_px = frame.rows_px.astype(float)
        kept = [lane for lane in prediction.lanes if lane.kind == "delimiter" and lane.score >= threshold]
        found = np.array([image_line(lane, rows_px) for lane in kept], dtype=float).reshape(-1, len(rows_px))
        scores.append(score_frame(frame.lanes_u_px, found, rows_px))
    return astuple(mean_score(scores))
