"""An image as another camera at the same place would have taken it. Pixel corners at whole numbers."""

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.errors import ParamsError
from synth3dlanes.export.lines import View
from synth3dlanes.labels import CameraLabel

TOLERANCE_PX = 0.01  # scenes round their angles, so a native camera's focal length is off by parts in a million


def resample(image: UInt8[np.ndarray, "h w 3"], camera: CameraLabel, view: View, where: str) -> Image.Image:
    """The image through the foreign intrinsics; raise ParamsError where it does not cover the foreign view.

    Without rotation a change of K is a scaling and a crop, which Pillow does exactly: `box` are the foreign image's
    borders in our pixels, corners at whole numbers, and it filters when it shrinks.
    """
    left, top, right, bottom = box = source_box(camera, view)
    width_px, height_px = camera.width_px, camera.height_px
    slack_px = min(left, top, width_px - right, height_px - bottom)
    if image.shape[:2] != (height_px, width_px):
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise ParamsError(f"{where}: expected an image of {width_px}x{height_px} as in its labels, got {got}")
    if slack_px < -TOLERANCE_PX:
        raise ParamsError(
            f"{where}: expected an image that covers {view.width_px}x{view.height_px} px at f = {view.f_px:g} px "
            f"({_degrees(view.width_px / 2, view.f_px)} x {_degrees(view.height_px / 2, view.f_px)} deg), got one "
            f"that ends {-slack_px:.1f} px short of it: render with a wider field of view"
        )
    source = Image.fromarray(image)
    if source.size == (view.width_px, view.height_px) and np.allclose(
        box, (0, 0, *source.size), rtol=0, atol=TOLERANCE_PX
    ):
        return source
    inside = np.clip(box, 0, (width_px, height_px, width_px, height_px)).tolist()
    return source.resize((view.width_px, view.height_px), Image.Resampling.BICUBIC, box=tuple(inside))


def source_box(camera: CameraLabel, view: View) -> tuple[float, float, float, float]:
    """Left, top, right and bottom border of the foreign image in our pixels."""
    (u0, v0), (u1, v1) = source_pixels(camera, view, np.array([[0.0, 0.0], [view.width_px, view.height_px]]))
    return float(u0), float(v0), float(u1), float(v1)


def source_pixels(camera: CameraLabel, view: View, points_img: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Where points of the foreign image lie in ours: K_ours K_theirs^-1."""
    (fx_px, cx_px, _), (_, cy_px, minus_fy_px), _ = camera.img_from_cam
    center_img = np.array([view.width_px / 2, view.height_px / 2])
    rays = (points_img - center_img) / view.f_px
    return np.asarray(rays * np.array([fx_px, -minus_fy_px]) + np.array([cx_px, cy_px]))


def _degrees(half_px: float, f_px: float) -> str:
    return f"{2 * np.degrees(np.arctan(half_px / f_px)):.1f}"
