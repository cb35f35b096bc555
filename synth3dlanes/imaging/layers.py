"""What Blender returns: radiance and geometry per pixel, before haze, sensor and tone curve."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8, UInt16


@dataclass(frozen=True, eq=False)
class Layers:
    """The rendered layers of one view.

    `radiance` is linear and denoised, in the daylight's units. `haze` holds 1 - exp(-distance x extinction) and the
    share of the pixel that is not sky, antialiased as the radiance is. The others are sampled at the pixels' centres:
    depth along the viewing direction, infinite in the sky; ids as in `settings`; unit normals in the camera frame, zero
    in the sky. Layers that were not requested are None.
    """

    radiance: Float[np.ndarray, "h w 3"]
    haze: Float[np.ndarray, "h w 2"]
    depth_m: Float[np.ndarray, "h w"]
    semantic: UInt8[np.ndarray, "h w"]
    instance: UInt16[np.ndarray, "h w"] | None = None
    normal: Float[np.ndarray, "h w 3"] | None = None
