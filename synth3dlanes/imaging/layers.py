"""What Blender returns: radiance and geometry per pixel, before haze, sensor and tone curve."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16

from synth3dlanes.scene.settings import NO_HIT_DEPTH_M


@dataclass(frozen=True, eq=False)
class Layers:
    """The rendered layers of one view.

    `radiance` is linear and denoised, in the daylight's units. `haze` holds 1 - exp(-distance x extinction) and the
    share of the pixel that is not sky, antialiased as the radiance is. The others are sampled at the pixels' centres:
    depth along the viewing direction, infinite in the sky; ids as in `settings`; unit normals in the camera frame, zero
    in the sky, None unless requested.
    """

    radiance: Float[np.ndarray, "h w 3"]
    haze: Float[np.ndarray, "h w 2"]
    depth_m: Float[np.ndarray, "h w"]
    semantic: UInt8[np.ndarray, "h w"]
    instance: UInt16[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"] | None = None

    def only(self, is_seen: Bool[np.ndarray, "h w"]) -> "Layers":
        """The layers as a lens shows them whose field has these pixels alone: all others are black, without depth, ids
        and normals."""
        if is_seen.all():
            return self
        seen = is_seen[..., None]
        return replace(
            self,
            radiance=np.where(seen, self.radiance, np.float32(0)),
            haze=np.where(seen, self.haze, np.float32(0)),
            depth_m=np.where(is_seen, self.depth_m, np.float32(NO_HIT_DEPTH_M)),
            semantic=self.semantic * is_seen,
            instance=self.instance * is_seen,
            normal=None if self.normal is None else np.where(seen, self.normal, np.float32(0)),
        )
