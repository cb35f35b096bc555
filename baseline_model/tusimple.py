"""tuSimple: its image lines as lanes on a fixed plane (paper, 4.4), detected lanes as its lines, and its score of them.

A fixed pose replaces the paper's hand-picked homography: 9 deg and 1.6 m make straight lanes parallel in the top view.
The top 80 rows of images are cropped, as in public implementations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from synth3dlanes.formats.reading import ForeignSample
from synth3dlanes.formats.tusimple import ABSENT, CAMERA, TusimpleScore, TusimpleSplit, mean_score, score_frame
from synth3dlanes.geometry.frames import project, transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneGraph
from synth3dlanes.system.errors import InputError

from .curves import Pose, onto_plane, road_from_cam
from .lanes import Detection, Prediction

SIZE_PX = (1280, 640)
CROP_TOP_PX = 80
IMG_FROM_CAM = np.array([[1000.0, 640.0, 0.0], [0.0, 320.0, -1000.0], [0.0, 1.0, 0.0]])
WHOLE_IMG_FROM_CAM = np.array([[1000.0, 640.0, 0.0], [0.0, 320.0 + CROP_TOP_PX, -1000.0], [0.0, 1.0, 0.0]])
POSE = Pose(float(np.radians(9.0)), 1.6)
FAR_M = 110.0
BESIDE_M = 10.0
"""Distance at which the lines to the left and right of the host are chosen."""
MOST_LINES = 4
"""tuSimple asks for at most four lines, those of the host's lane and of the lanes beside it."""
NEAREST_M = 0.5
VISIBLE = 0.5


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


def check_plane(prediction: Prediction, labels: str | Path) -> None:
    """Raise InputError where lanes were not found with the fixed pose: without the camera, nobody can tell where in the
    image they are."""
    if prediction.lanes and (prediction.pose is None or not np.allclose(prediction.pose, POSE, atol=1e-3)):
        raise InputError(
            f"{labels}: expected --intrinsics FX,FY,CX,CY of its camera, which tuSimple does not publish "
            "(docs/real_images.md has an estimate); only the model `tusimple` needs none"
        )


def delimiters(prediction: Prediction, threshold: float) -> list[Detection]:
    """The delimiters of at least this confidence, the most confident first."""
    kept = [lane for lane in prediction.lanes if lane.kind == "delimiter" and lane.score >= threshold]
    return sorted(kept, key=lambda lane: -lane.score)


def right_of_host_m(lane: Detection) -> float:
    """How far right of the camera the lane is, BESIDE_M ahead."""
    return float(np.interp(BESIDE_M, lane.xyz_cam[:, 1], lane.xyz_cam[:, 0]))


def asked_for(prediction: Prediction, threshold: float) -> list[Detection]:
    """The delimiters that tuSimple asks for: the MOST_LINES nearest the host."""
    lanes = delimiters(prediction, threshold)
    return sorted(lanes, key=lambda lane: abs(right_of_host_m(lane)))[:MOST_LINES]


def columns_of(
    lane: Detection, img_from_cam: Float[np.ndarray, "3 3"], rows_px: Float[np.ndarray, " r"]
) -> Float[np.ndarray, " r"]:
    """The lane's column at each row, where it is visible and does not turn back in the image; NaN elsewhere."""
    xyz_cam = lane.xyz_cam
    if lane.visibility is not None:
        seen = np.flatnonzero(lane.visibility >= VISIBLE)
        xyz_cam = xyz_cam[: seen[-1] + 1 if len(seen) else 0]
    u_px, v_px = project(img_from_cam, xyz_cam[xyz_cam[:, 1] > NEAREST_M]).T
    v_px = v_px.round(6)  # a line that ends at a row reaches it
    turns = np.flatnonzero(np.diff(v_px) >= 0)
    n = int(turns[0]) + 1 if len(turns) else len(v_px)
    if n < 2:
        return np.full(len(rows_px), np.nan)
    return np.interp(rows_px, v_px[:n][::-1], u_px[:n][::-1], left=np.nan, right=np.nan)


def tusimple_line(
    lane: Detection, img_from_cam: Float[np.ndarray, "3 3"], rows_px: Float[np.ndarray, " r"]
) -> Int[np.ndarray, " r"]:
    """The lane as in tuSimple's files: the column at each row in whole pixels, ABSENT outside the image."""
    columns_px = np.rint(columns_of(lane, img_from_cam, rows_px))
    is_inside = (columns_px >= 0) & (columns_px < CAMERA.width_px)
    return np.where(is_inside, columns_px, ABSENT).astype(int)


def tusimple_score(
    found: Sequence[Prediction], split: TusimpleSplit, img_from_cam: Float[np.ndarray, "3 3"], threshold: float
) -> TusimpleScore:
    """The official score of a prediction for each frame: of its lines that tuSimple asks for, projected with the matrix
    of the images at the rows of the labels."""
    scores = []
    for index, prediction in enumerate(found):
        frame = split.frame(index)
        rows_px = frame.rows_px.astype(float)
        lines = [tusimple_line(lane, img_from_cam, rows_px) for lane in asked_for(prediction, threshold)]
        predicted = np.array(lines, dtype=float).reshape(-1, len(rows_px))
        score = score_frame(frame.lanes_u_px, predicted, rows_px)
        # Where two labelled lines lie together, one line finds both, and less than none is in excess.
        scores.append(replace(score, false_positive=max(0.0, score.false_positive)))
    return mean_score(scores)
