"""An image as another camera at the same place, without roll, would have taken it. Pixel corners at whole numbers."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.dataset.remove_roll import rolled_from_level, warp
from synth3dlanes.errors import InputError
from synth3dlanes.formats.writing import CV_FROM_CAM, Pinhole
from synth3dlanes.labels import CameraLabel

TOLERANCE_PX = 0.01  # scenes round their angles, so a native camera's focal length is off by parts in a million


def fitting_pinhole(camera: CameraLabel, widest: Pinhole) -> Pinhole:
    """The camera of this image size with the shortest focal length, from that of `widest` on, that our image covers."""
    corners = source_pixels(camera, widest, _corners(widest))
    middle = camera.img_from_cam[:2, 1]
    room = np.where(corners > middle, [camera.width_px - middle[0], camera.height_px - middle[1]], middle)
    # What lies aside of the principal point moves towards it by the focal length's ratio.
    ratio = float(np.max((np.abs(corners - middle) - TOLERANCE_PX) / room))
    return widest if ratio <= 1 else replace(widest, f_px=float(np.ceil(widest.f_px * ratio * 1e4) / 1e4))


def resample(image: UInt8[np.ndarray, "h w 3"], camera: CameraLabel, pinhole: Pinhole, where: str) -> Image.Image:
    """The image through the foreign intrinsics, whose view it must cover.

    Without roll a change of K is a scaling and a crop, which Pillow does exactly: `box` are the foreign image's borders
    in our pixels, corners at whole numbers, and it filters when it shrinks. With roll it is a homography, drawn larger
    and averaged where it shrinks.
    """
    corners = source_pixels(camera, pinhole, _corners(pinhole))
    box = (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
    width_px, height_px = camera.width_px, camera.height_px
    if image.shape[:2] != (height_px, width_px):
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"{where}: expected an image of {width_px}x{height_px} as in its labels, got {got}")
    if camera.roll_rad:
        shrink = max(1, round(camera.img_from_cam[0, 0] / pinhole.f_px))
        finer = np.diag([1 / shrink, 1 / shrink, 1.0])
        size_px = (pinhole.width_px * shrink, pinhole.height_px * shrink)
        return warp(image, _ours_from_theirs(camera, pinhole) @ finer, size_px).reduce(shrink)
    source = Image.fromarray(image)
    if source.size == (pinhole.width_px, pinhole.height_px) and np.allclose(
        box, (0, 0, *source.size), rtol=0, atol=TOLERANCE_PX
    ):
        return source
    inside = np.clip(box, 0, (width_px, height_px, width_px, height_px)).tolist()
    return source.resize((pinhole.width_px, pinhole.height_px), Image.Resampling.BICUBIC, box=tuple(inside))


def source_pixels(
    camera: CameraLabel, pinhole: Pinhole, points_img: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Where points of the foreign image lie in ours."""
    homogeneous = np.column_stack([points_img, np.ones(len(points_img))]) @ _ours_from_theirs(camera, pinhole).T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def _ours_from_theirs(camera: CameraLabel, pinhole: Pinhole) -> Float[np.ndarray, "3 3"]:
    return rolled_from_level(camera, pinhole.img_from_cv @ CV_FROM_CAM)


def _corners(pinhole: Pinhole) -> Float[np.ndarray, "4 2"]:
    width_px, height_px = pinhole.width_px, pinhole.height_px
    return np.array([[0.0, 0.0], [width_px, 0.0], [width_px, height_px], [0.0, height_px]])
