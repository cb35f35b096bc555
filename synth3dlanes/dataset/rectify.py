"""Images and labels of any camera, converted to a pinhole camera without roll, for networks and formats that know no
other camera.

Both cameras have the same optical centre, so the place of every pixel in the other image is exact, whatever its depth.
"""

from dataclasses import replace
from typing import TypeVar

import numpy as np
import scipy
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.geometry.frames import turned
from synth3dlanes.geometry.lens import PINHOLE
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, SymbolLabel
from synth3dlanes.system.arrays import RgbImage

# Pixels that the warp's bicubic filter may need beyond the border.
FILTER_PX = 3

LaneOrSymbol = TypeVar("LaneOrSymbol", Lane, SymbolLabel)


def level_from_cam(camera: CameraLabel) -> Float[np.ndarray, "3 3"]:
    """The rotation about the viewing axis that removes the roll."""
    c, s = np.cos(camera.roll_rad), np.sin(camera.roll_rad)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rectified_labels(labels: Labels) -> Labels:
    """The labels of a pinhole camera without roll, with the same place, viewing axis and matrix. The y axis of its road
    frame is the viewing direction, also if the camera does not look along its lane. Points that are in only one of the
    two images count as outside."""
    camera = labels.camera
    if camera.roll_rad == 0 and camera.yaw_rad == 0 and camera.lens.is_pinhole:
        return labels
    turn = np.eye(4)
    turn[:3, :3] = level_from_cam(camera)
    road_from_cam = camera.road_from_cam @ turn.T
    level = replace(
        camera,
        roll_rad=0.0,
        yaw_rad=0.0,
        road_from_cam=turned(-camera.yaw_rad) @ road_from_cam if camera.yaw_rad else road_from_cam,
        world_from_cam=camera.world_from_cam @ turn.T,
        lens=PINHOLE,
    )

    def seen_level(line: LaneOrSymbol) -> LaneOrSymbol:
        xyz_cam = line.xyz_cam @ turn[:3, :3].T
        return replace(line, xyz_cam=xyz_cam, in_image=line.in_image & level.shows(xyz_cam))

    lanes, symbols = tuple(map(seen_level, labels.lanes)), tuple(map(seen_level, labels.symbols))
    return replace(labels, camera=level, lanes=lanes, symbols=symbols)


def rectified_image(image: RgbImage, camera: CameraLabel) -> RgbImage:
    """The image for `rectified_labels`. What the camera did not see repeats its border, and is black outside the lens's
    field."""
    rows, columns = image.shape[:2]
    if not camera.lens.is_pinhole:
        grid = np.stack(np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5), axis=-1)
        return remap(image, bent_pixels(camera, camera.img_from_cam, grid))
    if camera.roll_rad == 0:
        return image
    reach = int(np.ceil(max(rows, columns) * abs(np.sin(camera.roll_rad)))) + FILTER_PX
    padded = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    shift = np.array([[1.0, 0, reach], [0, 1, reach], [0, 0, 1]])
    back = shift @ rolled_from_level(camera, camera.img_from_cam)
    return np.asarray(warp(padded, back, (columns, rows)))


def rolled_from_level(camera: CameraLabel, img_from_level: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The homography K R K'^-1 from pixels of a level pinhole with the matrix `img_from_level` to pixels of the rolled
    pinhole."""
    return np.asarray(camera.img_from_cam @ level_from_cam(camera).T @ np.linalg.inv(img_from_level))


def bent_pixels(
    camera: CameraLabel, img_from_level: Float[np.ndarray, "3 3"], uv: Float[np.ndarray, "*n 2"]
) -> Float[np.ndarray, "*n 2"]:
    """The pixels of the camera, with its lens, that show what these pixels of a level pinhole show; NaN outside the
    lens's field."""
    homogeneous = np.concatenate([uv, np.ones((*uv.shape[:-1], 1))], axis=-1)
    return camera.project(homogeneous @ (level_from_cam(camera).T @ np.linalg.inv(img_from_level)).T)


def warp(image: RgbImage, source_from_target: Float[np.ndarray, "3 3"], size: tuple[int, int]) -> Image.Image:
    """An image of `size` (width, height) whose pixels are taken from `image` at the places that the homography
    gives."""
    coefficients = (source_from_target / source_from_target[2, 2]).ravel()[:8]
    return Image.fromarray(image).transform(
        size, Image.Transform.PERSPECTIVE, coefficients.tolist(), Image.Resampling.BICUBIC
    )


def remap(image: RgbImage, uv: Float[np.ndarray, "h2 w2 2"]) -> UInt8[np.ndarray, "h2 w2 3"]:
    """An image whose pixels are taken from `image` at (u, v), by cubic splines; black for NaN."""
    columns, rows = np.moveaxis(np.nan_to_num(uv, nan=-1.0), -1, 0).astype(np.float32) - np.float32(0.5)
    found = np.stack(
        [
            scipy.ndimage.map_coordinates(channel, [rows, columns], np.float32, order=3, mode="nearest")
            for channel in np.moveaxis(image, -1, 0).astype(np.float32)
        ],
        axis=-1,
    )
    found[np.isnan(uv).any(axis=-1)] = 0
    return np.clip(np.rint(found), 0, 255).astype(np.uint8)
