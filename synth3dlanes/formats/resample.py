"""An image as another camera at the same place, without roll, would have taken it. Pixel corners at whole numbers."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.dataset.rectify import bent_pixels, remap, rolled_from_level, warp
from synth3dlanes.formats.writing import CV_FROM_CAM, Pinhole
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.system.errors import InputError

TOLERANCE_PX = 0.01  # scenes round their angles, so a native camera's focal length is off by parts in a million

# Points per side of an image's border, and the longest focal length that is tried, as a multiple of the format's.
BORDER_STEPS, MOST_ENLARGED = 65, 100.0


def fitting_pinhole(camera: CameraLabel, widest: Pinhole) -> Pinhole:
    """The camera of this image size with the shortest focal length, from that of `widest` on, that our image covers."""
    if not camera.lens.is_pinhole:
        return _fitting_lens(camera, widest)
    corners = source_pixels(camera, widest, _corners(widest))
    middle = camera.img_from_cam[:2, 1]
    room = np.where(corners > middle, [camera.width_px - middle[0], camera.height_px - middle[1]], middle)
    # What lies aside of the principal point moves towards it by the focal length's ratio.
    ratio = float(np.max((np.abs(corners - middle) - TOLERANCE_PX) / room))
    return widest if ratio <= 1 else replace(widest, f_px=float(np.ceil(widest.f_px * ratio * 1e4) / 1e4))


def _fitting_lens(camera: CameraLabel, widest: Pinhole) -> Pinhole:
    """As `fitting_pinhole`, by the border of the foreign image: a lens bends it."""
    share = np.linspace(0, 1, BORDER_STEPS)[:, None]
    corners = _corners(widest)
    border = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])

    def covers(f_px: float) -> bool:
        uv = source_pixels(camera, replace(widest, f_px=f_px), border)
        with np.errstate(invalid="ignore"):
            room = np.minimum(uv, [camera.width_px, camera.height_px] - uv)
            return bool((room > -TOLERANCE_PX).all())

    if covers(widest.f_px):
        return widest
    low, high = widest.f_px, MOST_ENLARGED * widest.f_px
    while high - low > TOLERANCE_PX:
        middle = (low + high) / 2
        low, high = (low, middle) if covers(middle) else (middle, high)
    return replace(widest, f_px=float(np.ceil(high * 1e4) / 1e4))


def resample(image: UInt8[np.ndarray, "h w 3"], camera: CameraLabel, pinhole: Pinhole, where: str) -> Image.Image:
    """The image through the foreign intrinsics, whose view it must cover.

    Without roll and lens a change of K is a scaling and a crop, which Pillow does exactly: `box` are the foreign
    image's borders in our pixels, corners at whole numbers, and it filters when it shrinks. With roll it is a
    homography, and through a lens every pixel has its place: drawn larger and averaged where it shrinks.
    """
    corners = source_pixels(camera, pinhole, _corners(pinhole))
    box = (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
    width_px, height_px = camera.width_px, camera.height_px
    if image.shape[:2] != (height_px, width_px):
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"{where}: expected an image of {width_px}x{height_px} as in its labels, got {got}")
    if not camera.lens.is_pinhole:
        shrink = max(1, round(camera.img_from_cam[0, 0] / pinhole.f_px))
        grid = np.meshgrid(*(np.arange(size * shrink) + 0.5 for size in (pinhole.width_px, pinhole.height_px)))
        uv = bent_pixels(camera, pinhole.img_from_cv @ CV_FROM_CAM, np.stack(grid, axis=-1) / shrink)
        return Image.fromarray(remap(image, uv)).reduce(shrink)
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
    if not camera.lens.is_pinhole:
        return bent_pixels(camera, pinhole.img_from_cv @ CV_FROM_CAM, points_img)
    homogeneous = np.column_stack([points_img, np.ones(len(points_img))]) @ _ours_from_theirs(camera, pinhole).T
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def _ours_from_theirs(camera: CameraLabel, pinhole: Pinhole) -> Float[np.ndarray, "3 3"]:
    return rolled_from_level(camera, pinhole.img_from_cv @ CV_FROM_CAM)


def _corners(pinhole: Pinhole) -> Float[np.ndarray, "4 2"]:
    width_px, height_px = pinhole.width_px, pinhole.height_px
    return np.array([[0.0, 0.0], [width_px, 0.0], [width_px, height_px], [0.0, height_px]])
