"""The background beyond the paper's terrain: far hills, and the roads that continue into them. World frame.

All of it lies beyond every label, so it affects the picture alone.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# Distances from the world's origin, on a map from the host, at which the hills begin and reach their full height.
BEGIN_M, WHOLE_M = 500.0, 1600.0
N_WAVES = 14
LENGTHS_M = np.geomspace(600.0, 3000.0, N_WAVES)
MAX_HEIGHT_M = 90.0
# Beyond DAM_FROM_M a road lies on the faces of the ground, which are large there, on a dam that rises by DAM_RISE per
# metre: the road's own faces would otherwise cut through edges of the ground's. It gets there within DAM_FADE_M.
DAM_FROM_M, DAM_RISE, DAM_FADE_M = 400.0, 0.0006, 60.0


@dataclass(frozen=True, eq=False)
class FarHills:
    """A sum of plane waves: `height_m` scales it, `waves` are wave vectors in rad/m, `phases` are in rad."""

    height_m: float
    waves: Float[np.ndarray, "2 k"]
    phases: Float[np.ndarray, " k"]
    center_world: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "FarHills":
        """Draw the hills of one scene."""
        height_m = MAX_HEIGHT_M * rng.random() ** 1.5
        angles, phases = 2 * np.pi * rng.random((2, N_WAVES))
        return cls(height_m, 2 * np.pi / LENGTHS_M * np.stack([np.cos(angles), np.sin(angles)]), phases)

    def height(self, xy_world: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Metres to add to the terrain; 0 near the roads."""
        x, y = self.center_world
        share = np.clip((np.hypot(xy_world[..., 0] - x, xy_world[..., 1] - y) - BEGIN_M) / (WHOLE_M - BEGIN_M), 0, 1)
        far, heights_m = share > 0, np.zeros_like(share)
        rolling = 0.4 + 2.5 * (np.sin(xy_world[far] @ self.waves + self.phases) @ (LENGTHS_M / LENGTHS_M.sum()))
        heights_m[far] = self.height_m * share[far] ** 2 * (3 - 2 * share[far]) * np.maximum(rolling, 0)
        return heights_m


def far_dam(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Height of a road's far dam at stations; 0 in the range of the labels."""
    return DAM_RISE * np.clip(np.abs(s) - DAM_FROM_M, 0, None)


def on_faces(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """How far a road follows the faces of the ground (1) and not the terrain itself (0), at stations."""
    return np.clip((np.abs(s) - DAM_FROM_M) / DAM_FADE_M, 0, 1)
