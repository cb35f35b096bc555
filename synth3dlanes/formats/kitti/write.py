"""Write KITTI's object detection: for each frame an image, its objects, its calibration and the lidar's points."""

from collections import Counter

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.formats.kitti.convention import (
    HALF_PX,
    LEAST_SEEN,
    LISTS,
    NOTHING,
    TYPES,
    VELO_FROM_LIDAR,
    KittiObject,
    dont_care,
    occlusion,
    path_of,
    wrapped,
)
from synth3dlanes.formats.one_frame import FRAMES_PER_SPLIT
from synth3dlanes.formats.writing import CV_FROM_CAM, PARTS, FrameAnnotation
from synth3dlanes.geometry.frames import invert
from synth3dlanes.labels.labels import CameraLabel, Labels
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.system.errors import InputError

NOT_SEEN, OUT = "hidden", "out of the image"
# Names of six digits, as KITTI's tools take them, in data sets of up to ten splits of 100,000 samples.
SHORT = 100_000

README = f"""KITTI's object detection layout.

- `training/image_2/*.png`, `label_2/*.txt`, `calib/*.txt`, and `velodyne/*.bin` of data sets with a lidar. All frames
  are in `training`, as KITTI's testing frames have no labels; `ImageSets/{{train,val,trainval,test}}.txt` divide them.
- Types are Car (with pickups), Van, Truck (with tractors and their semitrailers) and Misc (buses). A car of which less
  than {100 * LEAST_SEEN:.0f} % is seen is a region DontCare; one that is not seen at all is left out. A frame without
  objects has one region DontCare without a size, as no label file of the original is empty and OpenPCDet fails on one.
- Occlusion is 0 if {100 * 0.9:.0f} % or more of the object's pixels are seen, 1 from 50 %, else 2. Truncation is the
  share of the 3D box that is outside the image.
- The 2D box is that of the 3D box in the image. Pixels count from the middle of the first one, so the principal point
  is half a pixel less than in the data set.
- Boxes stand upright in the camera's frame, as KITTI's format has them: place (the middle of the lower side), size and
  heading are exact, the slope of a car against the camera's plane is lost. It is the camera's pitch on a level road.
- There is one camera: P0 to P3 are alike. R0_rect is the identity, reflectance is 0. Without a lidar, Tr_velo_to_cam is
  from the camera's foot on the road.
"""


def annotate(frame: SampleFrame) -> FrameAnnotation:
    """The frame's files."""
    where, labels = f"{frame.split}:{frame.key}", frame.labels
    if labels.objects is None:
        raise InputError(f"{where}: expected labels with objects, got older ones; generate the data set again")
    if not labels.camera.lens.is_pinhole:
        raise InputError(f"{where}: expected a camera without distortion, got {labels.camera.lens}")
    name, dropped, lines = _name(frame), Counter[str](), list[str]()
    for item in labels.objects:
        reason = OUT if item.box_px is None else NOT_SEEN if item.seen_box_px is None else ""
        if reason:
            dropped[reason] += 1
        else:
            lines.append(kitti_object(labels.camera, item).line())
    files: dict[str, str | bytes] = {
        path_of("label", name): "\n".join(lines or [NOTHING.line()]),
        path_of("calib", name): _calib(labels),
    }
    if frame.sweep is not None:
        xyz_velo = frame.sweep.points().xyz_lidar @ VELO_FROM_LIDAR[:3, :3].T
        files[path_of("points", name)] = np.column_stack([xyz_velo, np.zeros(len(xyz_velo))]).astype("<f4").tobytes()
    lists: list[str] = [part for part in PARTS if frame.serves_as(part)]
    if {"train", "val"} & {*lists}:
        lists.append("trainval")
    shared = ((name, tuple(f"{LISTS}/{part}.txt" for part in lists)),)
    return FrameAnnotation(path_of("image", name), len(lines), dropped, files, shared)


def kitti_object(camera: CameraLabel, item: ObjectLabel) -> KittiObject:
    """An object of which something is in the image and seen."""
    assert item.box_px is not None
    size_px = np.array([camera.width_px, camera.height_px])
    box_px = np.clip(item.box_px - HALF_PX, 0, np.tile(size_px - 1, 2))
    seen = item.visible_fraction or 0.0
    if seen < LEAST_SEEN:
        return dont_care(box_px)
    width_m, length_m, height_m = item.size_m
    pose = item.cam_from_object
    location_cv = CV_FROM_CAM @ (pose[:3, 3] - pose[:3, 2] * height_m / 2)
    ahead_x, _, ahead_z = CV_FROM_CAM @ pose[:3, 1]
    rotation_y_rad = float(np.arctan2(-ahead_z, ahead_x))
    alpha_rad = wrapped(rotation_y_rad - float(np.arctan2(location_cv[0], location_cv[2])))
    size_m = np.array([height_m, width_m, length_m])
    return KittiObject(
        TYPES[item.category], item.truncation, occlusion(seen), alpha_rad, box_px, size_m, location_cv, rotation_y_rad
    )


def _name(frame: SampleFrame) -> str:
    split, key = divmod(frame.number, FRAMES_PER_SPLIT)
    return f"{split * SHORT + key:06d}" if key < SHORT and split < 10 else f"{frame.number:09d}"


def _calib(labels: Labels) -> str:
    """The text of a calibration: matrices row by row."""
    camera = labels.camera
    img_from_cv = camera.img_from_cam @ CV_FROM_CAM.T
    img_from_cv[:2, 2] -= HALF_PX
    cam_from_velo = (invert(camera.road_from_cam) if labels.lidar is None else labels.lidar.cam_from_lidar) @ invert(
        VELO_FROM_LIDAR
    )
    cv_from_velo = CV_FROM_CAM @ cam_from_velo[:3]
    projection = np.column_stack([img_from_cv, np.zeros(3)])
    matrices = {**{f"P{i}": projection for i in range(4)}, "R0_rect": np.eye(3)}
    matrices |= {"Tr_velo_to_cam": cv_from_velo, "Tr_imu_to_velo": np.eye(4)[:3]}
    return "\n".join(f"{name}: {_row(matrix)}" for name, matrix in matrices.items())


def _row(matrix: Float[np.ndarray, "..."]) -> str:
    return " ".join(f"{value:.12e}" for value in (matrix + 0.0).ravel())
