"""The image-only variant (paper, 4.4): convert tuSimple's image lines to lanes on a fixed plane.

A fixed pose replaces the paper's hand-picked homography: 9 deg and 1.6 m make straight lanes parallel in the top view.
The top 80 rows of images are cropped, as in public implementations.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.reading import ForeignSample
from synth3dlanes.formats.tusimple import TusimpleSplit
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneGraph
from synth3dlanes.system.errors import InputError

from .lanes import Prediction
from .poses import Pose, onto_plane, road_from_cam

SIZE_PX = (1280, 640)
CROP_TOP_PX = 80
IMG_FROM_CAM = np.array([[1000.0, 640.0, 0.0], [0.0, 320.0, -1000.0], [0.0, 1.0, 0.0]])
WHOLE_IMG_FROM_CAM = np.array([[1000.0, 640.0, 0.0], [0.0, 320.0 + CROP_TOP_PX, -1000.0], [0.0, 1.0, 0.0]])
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


def check_plane(prediction: Prediction, labels: str | Path) -> None:
    """Raise InputError where lanes were not found with the fixed pose: without the camera, nobody can tell where in the
    image they are."""
    if prediction.lanes and (prediction.pose is None or not np.allclose(prediction.pose, POSE, atol=1e-3)):
        raise InputError(
            f"{labels}: expected --intrinsics FX,FY,CX,CY of its camera, which tuSimple does not publish "
            "(docs/real_images.md has an estimate); only the model `tusimple` needs none"
        )
