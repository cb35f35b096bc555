"""What closes the view behind the paper's terrain: far hills, and the roads that lead on into them. World frame.

All of it lies beyond every label, so that nothing but the picture knows of it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Hills begin here and are whole there, as distances from the world's origin.
BEGIN_M, WHOLE_M = 500.0, 1600.0
N_WAVES = 14
LENGTHS_M = np.geomspace(600.0, 3000.0, N_WAVES)
MAX_HEIGHT_M = 90.0
# Beyond this station a road lies on a dam that rises by this much a metre: the ground's faces are large there, and
# would come up through the road.
DAM_FROM_M, DAM_RISE = 400.0, 0.004


@dataclass(frozen=True, eq=False)
class FarHills:
    """Waves of many directions: `height_m` of the highest, their wave vectors in rad/m, and their phases in rad."""

    height_m: float
    waves: Float[np.ndarray, "2 k"]
    phases: Float[np.ndarray, " k"]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "FarHills":
        """The hills of one scene."""
        height_m = MAX_HEIGHT_M * rng.random() ** 1.5
        angles, phases = 2 * np.pi * rng.random((2, N_WAVES))
        return cls(height_m, 2 * np.pi / LENGTHS_M * np.stack([np.cos(angles), np.sin(angles)]), phases)

    def height(self, xy_world: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Metres to add to the terrain; 0 near the roads."""
        share = np.clip((np.hypot(xy_world[..., 0], xy_world[..., 1]) - BEGIN_M) / (WHOLE_M - BEGIN_M), 0, 1)
        far, heights_m = share > 0, np.zeros_like(share)
        rolling = 0.4 + 2.5 * (np.sin(xy_world[far] @ self.waves + self.phases) @ (LENGTHS_M / LENGTHS_M.sum()))
        heights_m[far] = self.height_m * share[far] ** 2 * (3 - 2 * share[far]) * np.maximum(rolling, 0)
        return heights_m


def far_dam(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Height of a road's far dam at stations; 0 wherever there are labels."""
    return DAM_RISE * np.clip(np.abs(s) - DAM_FROM_M, 0, None)
