"""Places beside a road: at stations and distances from an edge of its pavement. World frame, metres."""

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene.roadside import RoadSide
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.solids import GroundFrame


def beside(ground: Ground, road: str, side: RoadSide, s: Scalars, aside_m: Scalars | float) -> Points2:
    """World (x, y) at stations, `aside_m` outside an edge of the pavement; of the side `median`, at this offset."""
    on = ground.network.road(road)
    t = np.asarray(aside_m) if side == "median" else on.edge(side, s, aside_m)
    return on.xy(s, np.broadcast_to(t, s.shape))


def frames_beside(ground: Ground, road: str, side: RoadSide, s: Scalars, aside_m: Scalars | float) -> list[GroundFrame]:
    """Frames on the ground beside a road: y along the road as the host drives."""
    behind, middle, ahead, out = (
        beside(ground, road, side, s + ds, aside_m + da) for ds, da in ((-0.5, 0.0), (0.0, 0.0), (0.5, 0.0), (0.0, 1.0))
    )
    forward = (ahead - behind) * ground.network.onwards
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    out = out - middle
    outward = np.sign(out[:, 0] * forward[:, 1] - out[:, 1] * forward[:, 0])
    origins = np.column_stack([middle, ground.height_along(road, middle)])
    return [GroundFrame(*place) for place in zip(origins, forward, outward.tolist(), strict=True)]


def on_ground(ground: Ground, xy_world: Points2) -> Float[np.ndarray, "n 3"]:
    """World points on the ground as built."""
    return np.column_stack([xy_world, ground.height(xy_world)])


def ground_over(ground: Ground, frame: GroundFrame, places: Float[np.ndarray, "n 2"]) -> Scalars:
    """Heights of the ground at (x, y) of a frame, in this frame."""
    flat = frame.world(np.column_stack([places, np.zeros(len(places))]))
    return ground.height(flat[:, :2]) - frame.origin[2]
