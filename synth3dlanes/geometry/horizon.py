"""What closes the view behind the paper's terrain: far hills, and the roads that lead on into them. World frame.

All of it lies beyond every label, so that nothing but the picture knows of it.
"""

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene import Scene
from synth3dlanes.streams import stream

# Hills begin here and are whole there, as distances from the world's origin.
BEGIN_M, WHOLE_M = 500.0, 1600.0
N_WAVES = 14
WAVELENGTHS_M = (600.0, 3000.0)
MAX_HEIGHT_M = 90.0
# Beyond this station a road lies on a dam that rises by this much a metre: the ground's faces are large there, and
# would come up through the road.
DAM_FROM_M, DAM_RISE = 400.0, 0.004


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


def far_dam(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Height of a road's far dam at stations; 0 wherever there are labels."""
    return DAM_RISE * np.clip(np.abs(s) - DAM_FROM_M, 0, None)
