"""An image as another camera at the same place, without roll, would have taken it. Pixel corners at whole numbers."""

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.dataset.upright import ours_from_upright, warp
from synth3dlanes.errors import InputError
from synth3dlanes.formats.writing import CV_FROM_CAM, Pinhole
from synth3dlanes.labels import CameraLabel

TOLERANCE_PX = 0.01  # scenes round their angles, so a native camera's focal length is off by parts in a million


def resample(image: UInt8[np.ndarray, "h w 3"], camera: CameraLabel, pinhole: Pinhole, where: str) -> Image.Image:
    """The image through the foreign intrinsics; raise InputError where it does not cover the foreign pinhole.

    Without roll a change of K is a scaling and a crop, which Pillow does exactly: `box` are the foreign image's borders
    in our pixels, corners at whole numbers, and it filters when it shrinks. With roll it is a homography, drawn larger
    and averaged where it shrinks.
    """
    corners_img = np.array(
        [[0.0, 0.0], [pinhole.width_px, 0.0], [pinhole.width_px, pinhole.height_px], [0.0, pinhole.height_px]]
    )
    corners = source_pixels(camera, pinhole, corners_img)
    left, top, right, bottom = box = (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
    width_px, height_px = camera.width_px, camera.height_px
    slack_px = min(left, top, width_px - right, height_px - bottom)
    if image.shape[:2] != (height_px, width_px):
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"{where}: expected an image of {width_px}x{height_px} as in its labels, got {got}")
    if slack_px < -TOLERANCE_PX:
        size = f"{pinhole.width_px}x{pinhole.height_px}"
        degrees = (_degrees(length_px / 2, pinhole.f_px) for length_px in (pinhole.width_px, pinhole.height_px))
        raise InputError(
            f"{where}: expected an image that covers {size} px at f = {pinhole.f_px:g} px ({' x '.join(degrees)} deg), "
            f"got one that ends {-slack_px:.1f} px short of it: render with a wider field of view"
        )
    if camera.roll_rad:
        shrink = max(1, round(camera.img_from_cam[0, 0] / pinhole.f_px))
        finer = np.diag([1 / shrink, 1 / shrink, 1.0])
        size = pinhole.width_px * shrink, pinhole.height_px * shrink
        return warp(image, _ours_from_theirs(camera, pinhole) @ finer, size).reduce(shrink)
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
    return ours_from_upright(camera, pinhole.img_from_cv @ CV_FROM_CAM)


def _degrees(half_px: float, f_px: float) -> str:
    return f"{2 * np.degrees(np.arctan(half_px / f_px)):.1f}"
