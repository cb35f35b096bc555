"""Images and labels of a rolled camera turned level, for networks and formats that know neither roll nor yaw.

Both cameras have the same optical centre, so the change is a homography, exact at every depth.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image

from synth3dlanes.frames import turned
from synth3dlanes.labels import CameraLabel, Labels

# Pixels that the warp's bicubic filter may need beyond the border.
FILTER_PX = 3


def level_from_cam(camera: CameraLabel) -> Float[np.ndarray, "3 3"]:
    """The rotation about the viewing axis that removes the roll."""
    c, s = np.cos(camera.roll_rad), np.sin(camera.roll_rad)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def labels_without_roll(labels: Labels) -> Labels:
    """The labels as the same camera without roll would have them: same place, viewing axis and intrinsics. Its road
    frame looks along the camera.

    What either picture does not show is not in the image.
    """
    labels = _along_camera(labels)
    camera = labels.camera
    if camera.roll_rad == 0:
        return labels
    turn = np.eye(4)
    turn[:3, :3] = level_from_cam(camera)
    level = replace(
        camera,
        roll_rad=0.0,
        road_from_cam=camera.road_from_cam @ turn.T,
        world_from_cam=camera.world_from_cam @ turn.T,
    )
    turned = ((lane, lane.xyz_cam @ turn[:3, :3].T) for lane in labels.lanes)
    lanes = tuple(
        replace(lane, xyz_cam=xyz_cam, in_image=lane.in_image & _inside(level, xyz_cam)) for lane, xyz_cam in turned
    )
    return replace(labels, camera=level, lanes=lanes)


def _along_camera(labels: Labels) -> Labels:
    """The labels with the road frame turned by the camera's yaw."""
    camera = labels.camera
    if camera.yaw_rad == 0:
        return labels
    road_from_cam = turned(-camera.yaw_rad) @ camera.road_from_cam
    return replace(labels, camera=replace(camera, yaw_rad=0.0, road_from_cam=road_from_cam))


def image_without_roll(image: UInt8[np.ndarray, "h w 3"], camera: CameraLabel) -> UInt8[np.ndarray, "h w 3"]:
    """The picture that belongs to `labels_without_roll`; corners that the rolled camera did not see
    repeat its border."""
    if camera.roll_rad == 0:
        return image
    rows, columns = image.shape[:2]
    reach = int(np.ceil(max(rows, columns) * abs(np.sin(camera.roll_rad)))) + FILTER_PX
    padded = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    shift = np.array([[1.0, 0, reach], [0, 1, reach], [0, 0, 1]])
    back = shift @ rolled_from_level(camera, camera.img_from_cam)
    return np.asarray(warp(padded, back, (columns, rows)))


def rolled_from_level(camera: CameraLabel, img_from_level: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The homography K R K'^-1 from pixels of a level camera with the matrix `img_from_level` to the rolled one's."""
    return np.asarray(camera.img_from_cam @ level_from_cam(camera).T @ np.linalg.inv(img_from_level))


def warp(
    image: UInt8[np.ndarray, "h w 3"], source_from_target: Float[np.ndarray, "3 3"], size: tuple[int, int]
) -> Image.Image:
    """The picture of `size` (width, height) whose pixels lie in the image where the homography says."""
    coefficients = (source_from_target / source_from_target[2, 2]).ravel()[:8]
    return Image.fromarray(image).transform(
        size, Image.Transform.PERSPECTIVE, coefficients.tolist(), Image.Resampling.BICUBIC
    )


def _inside(camera: CameraLabel, points_cam: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    u, v, depth = camera.img_from_cam @ points_cam.T
    inside = (u >= 0) & (u <= camera.width_px * depth) & (v >= 0) & (v <= camera.height_px * depth)
    return np.asarray(inside & (depth > 0))
