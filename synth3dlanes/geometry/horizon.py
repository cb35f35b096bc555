"""Far hills: what closes the view behind the paper's terrain. World frame.

They rise beyond every road and label, so that nothing but the picture knows of them.
"""

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene import Scene
from synth3dlanes.streams import stream

# Hills begin here and are whole there, as distances from the world's origin; roads end at 420 m.
BEGIN_M, WHOLE_M = 500.0, 1600.0
N_WAVES = 14
WAVELENGTHS_M = (600.0, 3000.0)
MAX_HEIGHT_M = 90.0


def far_hills(scene: Scene, xy_world: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Height to add to the terrain: waves of many directions, drawn from seed, split and index; 0 near the roads."""
    rng = stream(scene.seed, scene.split, scene.index, "far_hills")
    height_m = MAX_HEIGHT_M * rng.random() ** 1.5
    lengths_m = np.geomspace(*WAVELENGTHS_M, N_WAVES)
    angles, phases = 2 * np.pi * rng.random((2, N_WAVES))
    weights = lengths_m / lengths_m.sum()
    waves = 2 * np.pi / lengths_m * np.stack([np.cos(angles), np.sin(angles)])
    share = np.clip((np.hypot(xy_world[..., 0], xy_world[..., 1]) - BEGIN_M) / (WHOLE_M - BEGIN_M), 0, 1)
    far, heights_m = share > 0, np.zeros_like(share)
    rolling = 0.4 + 2.5 * (np.sin(xy_world[far] @ waves + phases) @ weights)
    heights_m[far] = height_m * share[far] ** 2 * (3 - 2 * share[far]) * np.maximum(rolling, 0)
    return heights_m
