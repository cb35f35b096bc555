"""The roads of a network as OpenDRIVE files tell them: on planes rolled about their climbing lines, with shapes over
these.

A point of such a road lies at (s, t, h): s is the length of the reference line seen from above, t the distance to its
left and h the height, both measured on the rolled plane. World frame, metres and radians.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.roads.cross_section import Profile
from synth3dlanes.roads.line_forms import Chain, plan_line
from synth3dlanes.roads.maps.cubics import steepened, times, value
from synth3dlanes.roads.maps.profiles import cubics, knots
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.road_map import LaneName, MapRoad, MapShape
from synth3dlanes.system.arrays import Numbers, Points2, Points3, Scalars

# Tolerances of written heights and rolls, and the step between places where they are compared.
HEIGHT_M, ROLL_RAD, PROFILE_STEP_M = 1e-3, 1e-4, 0.25
# A road gets lateral shapes where its surface is farther than this from the rolled plane; the number of places across
# the road at which it is measured.
SHAPE_M, SHAPE_PLACES = 0.005, 9
# Products of widths are this exact.
WIDTH_M = 1e-4
# The step between places of a road's line at which it is looked for; its climb is measured over CLIMB_M to both sides.
COARSE_STEP_M, CLIMB_M = 2.0, 0.01
# Steps to a point's station: in bends each leaves a share of the way. What is left of the last one.
FOOT_STEPS, SETTLED_M = 20, 1e-6
# What is farther ahead of a place than this is not beside it; how many of the nearest roads are asked.
BESIDE_M, NEAREST = 0.005, 6


@dataclass(frozen=True, eq=False)
class WrittenRoad:
    """A road as its file tells it, and the segments of our lane graph by the names of its lanes. It runs along a road
    of the network, the `source`, between two stations of that, and along its edges if it `has_edges`."""

    told: MapRoad
    segments: Mapping[LaneName, str]
    source: str
    span_m: tuple[float, float]
    has_edges: bool = True

    @cached_property
    def _line(self) -> Chain:
        return plan_line(self.told.plan)

    @cached_property
    def _profiles(self) -> tuple[Profile, Profile]:
        return Profile(self.told.heights), Profile(self.told.banks)

    @cached_property
    def line_world(self) -> Points2:
        """Places of its reference line from above."""
        return self._line.frames(
            np.linspace(0.0, self.told.length_m, 2 + int(self.told.length_m / COARSE_STEP_M))
        ).points_world

    @cached_property
    def tree(self) -> "scipy.spatial.cKDTree":
        """These, to ask how near they are."""
        return scipy.spatial.cKDTree(self.line_world)

    def frames(self, s: Scalars) -> tuple[Points3, Float[np.ndarray, "n 3 3"]]:
        """Its reference line, and the unit vectors of s, t and h there as rows: heading, then climb, then roll."""
        xy, normals, _, _ = self._line.frames(s)
        heights, rolls = self._profiles
        climb = (heights(s + CLIMB_M) - heights(s - CLIMB_M)) / (2 * CLIMB_M)
        along = np.column_stack([-normals[:, 1], normals[:, 0], climb]) / np.hypot(1.0, climb)[:, None]
        left = np.column_stack([-normals, np.zeros(len(s))])
        up, sin, cos = np.cross(along, left), np.sin(rolls(s))[:, None], np.cos(rolls(s))[:, None]
        return np.column_stack([xy, heights(s)]), np.stack([along, cos * left + sin * up, cos * up - sin * left], 1)

    def places(self, points_world: Points3) -> Points3:
        """(s, t, h) of world points; of those before and behind the road, of its ends."""
        return self.feet(points_world)[0]

    def feet(self, points_world: Points3) -> tuple[Points3, Scalars]:
        """These, and how far ahead of them the points are: before and behind the road, and inside its sharp bends."""
        s = np.clip(self._line.project(points_world[:, :2])[0], 0.0, self.told.length_m)
        for _ in range(FOOT_STEPS):
            line, axes = self.frames(s)
            to = np.einsum("nij,nj->ni", axes, points_world - line)
            before, ahead = s, to[:, 0] * np.hypot(axes[:, 0, 0], axes[:, 0, 1])
            s = np.clip(s + ahead, 0.0, self.told.length_m)
            if np.abs(s - before).max(initial=0.0) < SETTLED_M:
                break
        return np.column_stack([s, to[:, 1:]]), to[:, 0]


class RoadPlace(NamedTuple):
    """A road, and (s, t, h) of a point there."""

    road: WrittenRoad
    sth: Float[np.ndarray, "3"]

    @property
    def heading_rad(self) -> float:
        """The road's heading there."""
        _, axes = self.road.frames(self.sth[:1])
        return math.atan2(axes[0, 0, 1], axes[0, 0, 0])


def beside(roads: Sequence[WrittenRoad], points_world: Points3) -> list[RoadPlace]:
    """Where each point is beside a road: the nearest of those that it is neither before nor behind, or else the end of
    the nearest of all."""
    away_m = np.array([road.tree.query(points_world[:, :2])[0] for road in roads])
    found, left = dict[int, RoadPlace](), np.arange(len(points_world))
    for nearest in np.argsort(away_m, axis=0)[:NEAREST]:
        beyond = list[int]()
        for k in np.unique(nearest[left]):
            numbers = left[nearest[left] == k]
            for i, sth, ahead_m in zip(numbers.tolist(), *roads[k].feet(points_world[numbers]), strict=True):
                if abs(ahead_m) < BESIDE_M:
                    found[i] = RoadPlace(roads[k], sth)
                else:
                    found.setdefault(i, RoadPlace(roads[k], sth))
                    beyond.append(i)
        left = np.array(beyond, dtype=int)
    return [found[i] for i in range(len(points_world))]


def lane_ascends(road: MapRoad, section: int, number: int) -> bool:
    """Whether the traffic of a lane goes with growing s."""
    lane = next(lane for lane in road.sections[section].lanes if lane.number == number)
    return lane.ascends(road.keeps_left)


def on_planes(flat: MapRoad, own: Road, raised: Callable[[Scalars], Scalars]) -> MapRoad:
    """A road from above as its file tells it: with the heights of the ground where it has none, rolls about its
    climbing line, and widths on the rolled plane. `own` are its places, which are `raised` over its surface."""
    told = flat.model_copy(update=_given(flat) if flat.heights else _fitted(own, raised))
    if not told.banks:
        return told

    def wider(from_m: float, x_m: float, end_m: float) -> float:
        return 1 / math.cos(value(told.banks, from_m + x_m, from_m + end_m))

    sections = []
    for i, section in enumerate(flat.sections):
        from_m, to_m = flat.span_m(i)
        widths = partial(times, factor=partial(wider, from_m), to_m=to_m - from_m, exact=WIDTH_M)
        lanes = (
            lane if lane.level or not lane.widths else lane.model_copy(update={"widths": widths(lane.widths)})
            for lane in section.lanes
        )
        sections.append(section.model_copy(update={"lanes": tuple(lanes)}))
    offsets = times(flat.lane_offsets, partial(wider, 0.0), flat.length_m, exact=WIDTH_M)
    return told.model_copy(update={"sections": tuple(sections), "lane_offsets": offsets})


def _given(road: MapRoad) -> dict[str, object]:
    """The rolls of a road with heights of its own."""
    return {"banks": steepened(road.banks, road.heights, road.length_m, -1)}


def _fitted(own: Road, raised: Callable[[Scalars], Scalars]) -> dict[str, object]:
    """Heights, rolls and shapes of a road on the ground: the plane nearest to it at each station, and what is left."""
    s = np.linspace(0, own.end_m, max(4, 1 + int(own.end_m / PROFILE_STEP_M)))
    low = own.left(s)
    high = np.maximum(own.right(s), low + 0.5)
    t = low + (high - low) * np.linspace(0, 1, SHAPE_PLACES)[:, None]

    def surface_m(s: Numbers) -> Numbers:
        return np.array([own.base_points(*at)[:, 2] + raised(at[0]) for at in zip(s, t, strict=True)])

    z = surface_m(np.broadcast_to(s, t.shape))
    mean_t, mean_z = t.mean(axis=0), z.mean(axis=0)
    fall = ((t - mean_t) * (z - mean_z)).sum(axis=0) / ((t - mean_t) ** 2).sum(axis=0)
    line_m = mean_z - fall * mean_t
    climb = np.gradient(line_m, s)
    # A roll turns a plane that climbs already: it is steeper across than it looks from above, and moves along.
    level = 1 / np.hypot(1.0, climb)
    # Here t grows to the right, in OpenDRIVE to the left; rolls are positive with the left side higher.
    roll = -np.arctan(fall * level)
    flat = np.cos(roll)
    ahead = t * np.tan(roll) * climb * level
    over = (surface_m(s + ahead) - line_m + t * np.tan(roll) * level) * flat * level
    return {
        "heights": tuple(cubics(s, line_m, HEIGHT_M)),
        "banks": tuple(cubics(s, roll, ROLL_RAD)),
        "shapes": tuple(_shapes(s, over.T[:, ::-1], -high / flat, (high - low) / flat)),
    }


def _shapes(s: Scalars, over_m: Numbers, left: Scalars, width_m: Scalars) -> Iterator[MapShape]:
    """Lateral shapes of a road whose surface is at its stations `over_m` over its rolled plane, at SHAPE_PLACES places
    from `left` on across `width_m`; none where that is little everywhere."""
    if np.abs(over_m).max() <= SHAPE_M:
        return
    share = np.linspace(0, 1, SHAPE_PLACES)
    for i in knots(s, over_m, SHAPE_M):
        rows = np.vander(width_m[i] * share, 4, increasing=True)
        a, b, c, d = np.linalg.lstsq(rows, over_m[i], rcond=None)[0].tolist()
        yield MapShape(s_m=float(s[i]), t_m=float(left[i]), a=a, b=b, c=c, d=d)
