"""What stands beside and over the road: its bodies, its lamps and its footprints. World frame, metres.

Structures are placed from the edges of the pavement, stand on the ground as built, and are cheap: a few quads across a
rail, fewer rows and posts far from the host.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from synth3dlanes.geometry.polylines import feet_on_steps
from synth3dlanes.scene.roadside import Building, Crossing, Rail, Roadside
from synth3dlanes.system.arrays import Points2, Points3, Scalars
from synth3dlanes.world.beside import beside
from synth3dlanes.world.buildings import building_bodies, building_frame
from synth3dlanes.world.crossings import DAM_M, DAM_SLOPE, crossing_body, crossing_frame, crossing_span
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.posts import lamp_heads_of, post_body, post_frames
from synth3dlanes.world.rails import WALKWAY_M, rail_body
from synth3dlanes.world.signals import foot_frames, pole_body
from synth3dlanes.world.solids import Body


def bodies(ground: Ground, roadside: Roadside) -> list[Body]:
    """All structures but the traffic elements that they hold, in the order of their instance ids."""
    frames = post_frames(ground, roadside.posts)
    poles = [item for item in roadside.free_elements if item.has_pole]
    return [
        *(rail_body(ground, rail) for rail in roadside.rails),
        *(post_body(post, frame) for post, frame in zip(roadside.posts, frames, strict=True)),
        *(crossing_body(ground, crossing) for crossing in roadside.crossings),
        *building_bodies(ground, roadside.buildings),
        *map(pole_body, poles, foot_frames(ground, poles)),
    ]


def lamp_heads(ground: Ground, roadside: Roadside) -> Points3:
    """The middles of the lower sides of all lamps' heads."""
    lamps = [post for post in roadside.posts if post.kind == "lamp"]
    heads = [lamp_heads_of(frame, post) for frame, post in zip(post_frames(ground, lamps), lamps, strict=True)]
    return np.concatenate([*heads, np.zeros((0, 3))])


@dataclass(frozen=True, eq=False)
class Footprints:
    """Segments with a radius that cover what stands on the ground, and dams, seen from above."""

    starts: Points2
    ends: Points2
    radii_m: Scalars

    def clear(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are at least `room_m` from all of them."""
        apart_m, _ = feet_on_steps(xy_world, self.starts, self.ends - self.starts)
        return np.asarray((apart_m > self.radii_m + room_m).all(axis=1))


def footprints(ground: Ground, roadside: Roadside) -> Footprints:
    """The footprints of all structures."""
    parts = [
        *(_rail_footprint(ground, rail) for rail in roadside.rails),
        *((frame.origin[None, :2],) * 2 + (1.0,) for frame in post_frames(ground, roadside.posts)),
        *(_crossing_footprint(ground, crossing) for crossing in roadside.crossings),
        *(_building_footprint(building) for building in roadside.buildings),
        *((np.array([[item.x_m, item.y_m]]),) * 2 + (1.0,) for item in roadside.free_elements),
    ]
    nothing = np.zeros((0, 2))
    return Footprints(
        np.concatenate([starts for starts, _, _ in parts] + [nothing]),
        np.concatenate([ends for _, ends, _ in parts] + [nothing]),
        np.concatenate([np.full(len(starts), radius_m) for starts, _, radius_m in parts] + [np.zeros(0)]),
    )


def _rail_footprint(ground: Ground, rail: Rail) -> tuple[Points2, Points2, float]:
    s = np.linspace(rail.from_m, rail.to_m, 2 + int(abs(rail.to_m - rail.from_m) / 8))
    line = beside(ground, rail.road, rail.side, s, rail.aside_m)
    return line[:-1], line[1:], WALKWAY_M if rail.kind == "walkway" else 0.6


def _crossing_footprint(ground: Ground, crossing: Crossing) -> tuple[Points2, Points2, float]:
    frame, span = crossing_frame(ground, crossing), crossing_span(ground, crossing)
    (left, right), radius_m = span.legs_m, crossing.width_m / 2
    if crossing.kind == "bridge":
        left, right = span.abutments_m[0] - DAM_M, span.abutments_m[1] + DAM_M
        radius_m += DAM_SLOPE * (span.top_m - float(frame.origin[2]))
    ends = frame.world(np.array([[left, 0, 0], [right, 0, 0.0]]))[:, :2]
    return ends[:1], ends[1:], radius_m


def _building_footprint(building: Building) -> tuple[Points2, Points2, float]:
    half, frame = np.sort([building.width_m, building.length_m]) / 2, building_frame(building)
    reach = np.array([0.0, half[1] - half[0], 0.0])
    reach = reach if building.length_m > building.width_m else reach[[1, 0, 2]]
    return frame.world(-reach)[None, :2], frame.world(reach)[None, :2], 1.42 * float(half[0])
