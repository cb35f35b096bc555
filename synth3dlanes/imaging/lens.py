"""Viewing directions of a camera's pixels. Camera frame: x right, y ahead, z up; scaled to y = 1."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene import Camera


def tangents(camera: Camera) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, " h"]]:
    """x/y of each column and z/y of each row, at the pixels' centres."""
    x = (np.arange(camera.width_px) + 0.5 - camera.cx_px) / camera.fx_px
    z = (camera.cy_px - np.arange(camera.height_px) - 0.5) / camera.fy_px
    return x.astype(np.float32), z.astype(np.float32)


def rays(camera: Camera, uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """The viewing rays of pixels (u, v), scaled to y = 1."""
    return np.column_stack(
        [(uv[:, 0] - camera.cx_px) / camera.fx_px, np.ones(len(uv)), (camera.cy_px - uv[:, 1]) / camera.fy_px]
    )
