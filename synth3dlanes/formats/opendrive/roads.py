"""The roads of a world as OpenDRIVE describes them: lanes beside reference lines, on banked planes along these.

A point of a road lies at (s, t, h): s is the length of the reference line seen from above, t the distance to its left
and h the height, both measured on the banked plane. With the direction of travel `e_s` of the reference line, which
climbs, `e_t` is the horizontal left normal rolled about `e_s`. World frame, metres and radians.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.arrays import Points2, Points3, Scalars
from synth3dlanes.geometry.lanes import CORNER_M, LaneCurve, connections, curves, seen_from_left
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.geometry.terrain import height_at

# Stations of the main road that a file reaches, at least, and the distance of the places that are fitted.
REACH_M = 250.0
STEP_M = 0.1
MIN_END_M = 10.0
# Steps to a point's station; in bends, each leaves a share of the way.
FOOT_STEPS = 20
JUNCTION = "junction"
# Steps to the banked plane that is nearest to the lanes; the third changes it by less than a millimetre.
PLANE_STEPS = 4


@dataclass(frozen=True, eq=False)
class OdrLane:
    """A strip of a road: its OpenDRIVE number (positive to the left of lane 0), its type, the id of the lane segment
    that it is (None for a shoulder or median), and its edges as t, the inner one first."""

    number: int
    kind: str
    segment: str | None
    inner_m: Scalars
    outer_m: Scalars


@dataclass(frozen=True, eq=False)
class OdrRoad:
    """A road with everything at equal steps along it: stations `s_m`, the plan's stations there, the reference line
    from above, its height and the roll of the plane (positive: the left side is higher), the t of lane 0 and the lanes
    from the left. It runs as the host drives or, if it `is_oncoming`, the other way. `before` and `after` name the
    roads or the junction at its ends."""

    name: str
    in_junction: bool
    before: str | None
    after: str | None
    is_oncoming: bool
    is_left_hand: bool
    plan_s: Scalars
    s_m: Scalars
    xy_world: Points2
    elevation_m: Scalars
    roll_rad: Scalars
    center_m: Scalars
    lanes: tuple[OdrLane, ...]
    surface_m: Callable[[Points2, Scalars], Scalars]

    @cached_property
    def line_world(self) -> Points3:
        """The reference line."""
        return np.column_stack([self.xy_world, self.elevation_m])

    @cached_property
    def axes(self) -> Float[np.ndarray, "m 3 3"]:
        """The unit vectors e_s, e_t and e_h in the world as rows: heading, then the climb, then the roll about e_s."""
        along = np.gradient(self.line_world, self.s_m, axis=0, edge_order=2)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        left = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))])
        left /= np.linalg.norm(left, axis=1, keepdims=True)
        up = np.cross(along, left)
        sin, cos = np.sin(self.roll_rad)[:, None], np.cos(self.roll_rad)[:, None]
        return np.stack([along, cos * left + sin * up, cos * up - sin * left], axis=1)

    def plane_points(self, t_m: Scalars) -> Points3:
        """World points of the banked plane at all stations and these t."""
        return np.asarray(self.line_world + t_m[:, None] * self.axes[:, 1])

    def over_plane(self, t_m: Scalars) -> Scalars:
        """Height (z) of the road's surface over the banked plane at all stations and these t."""
        points = self.plane_points(t_m)
        # Where the road climbs, its roll moves these points along it.
        forward = self.axes[:, 0, :2] / np.linalg.norm(self.axes[:, 0, :2], axis=1, keepdims=True)
        ahead = ((points[:, :2] - self.xy_world) * forward).sum(axis=1)
        plan_s = np.interp(self.s_m + ahead, self.s_m, self.plan_s)
        return self.surface_m(points[:, :2], plan_s) - points[:, 2]

    def places(self, points_world: Points3) -> Points3:
        """(s, t, h) of world points; of those before and behind the road, of its ends."""
        s = self.s_m[np.linalg.norm(points_world[:, None, :2] - self.xy_world, axis=2).argmin(axis=1)]
        for _ in range(FOOT_STEPS):
            i = np.clip(np.searchsorted(self.s_m, s), 0, len(self.s_m) - 1)
            to = np.einsum("nij,nj->ni", self.axes[i], points_world - self.line_world[i])
            ahead = to[:, 0] * np.linalg.norm(self.axes[i, 0, :2], axis=1)
            s = np.clip(self.s_m[i] + ahead, 0, self.s_m[-1])
        return np.column_stack([s, to[:, 1:]])

    @property
    def driving(self) -> tuple[OdrLane, ...]:
        """The lanes of traffic."""
        return tuple(lane for lane in self.lanes if lane.kind == "driving")


@dataclass(frozen=True)
class _Strip:
    """A strip in the plan: its type, its segment, its width, which may depend on the station."""

    kind: str
    segment: str | None
    width_m: float | Callable[[Scalars], Scalars]


@dataclass(frozen=True)
class _Layout:
    """A road in the plan: its stations, its reference line, its strips from the left, the number of those left of lane
    0, the offset of lane 0 from the line, and what lies before and behind it."""

    name: str
    span_m: tuple[float, float]
    line: LaneCurve
    strips: tuple[_Strip, ...]
    n_left: int
    lane_0_m: float
    before: str | None = None
    after: str | None = None
    is_oncoming: bool = False


def roads(plan: RoadPlan) -> list[OdrRoad]:
    """All roads of a plan. With an exit these are the stem, the connecting roads of the junction between the split and
    where the lanes have parted, and the two roads beyond; with a median, also a road for the oncoming traffic."""
    return [_road(plan, layout) for layout in _layouts(plan)]


def stems(plan: RoadPlan) -> dict[str, str]:
    """The lane of the stem that each lane of main road and exit is connected to."""
    return {fork: stem for stem, fork in connections(plan)}


def _layouts(plan: RoadPlan) -> list[_Layout]:
    def lanes(prefix: str, n: int) -> tuple[_Strip, ...]:
        names = (f"{prefix}_{seen_from_left(plan, lane, n)}" for lane in range(1, n + 1))
        return tuple(_Strip("driving", name, plan.width_m) for name in names)

    def straight(at_m: float) -> LaneCurve:
        return LaneCurve("", "centerline", "main", "none", None, None, at_m, "main", at_m)

    shoulder = _Strip("shoulder", None, plan.shoulder_m)
    oncoming, beside, found = lanes("oncoming", plan.n_oncoming), (shoulder,), []
    middle_m = (plan.left_m + plan.boundary_m(plan.n_lanes)) / 2
    parted_m = plan.station_where_open(plan.width_m + CORNER_M) if plan.has_exit else 0.0
    end_m = max(REACH_M, parted_m + MIN_END_M)
    if oncoming and plan.road.median_m > 0:
        median = _Strip("median", None, plan.road.median_m / 2)
        line, half_m = straight((plan.left_m + plan.oncoming_inner_m) / 2), plan.n_oncoming * plan.width_m / 2
        strips = (shoulder, *oncoming, median)
        found = [_Layout("oncoming", (-REACH_M, end_m), line, strips, len(strips) - 1, half_m, is_oncoming=True)]
        oncoming, beside, middle_m = (), (median,), 0.0
    left = (*beside, *oncoming)

    def on_main(
        name: str, span_m: tuple[float, float], left: tuple[_Strip, ...], right: tuple[_Strip, ...],
        before: str | None = None, after: str | None = None,
    ) -> _Layout:  # fmt: skip
        lane_0_m = plan.boundary_m(0) - middle_m
        return _Layout(name, span_m, straight(middle_m), (*left, *right), len(left), lane_0_m, before, after)

    if not plan.has_exit:
        return [*found, on_main("main", (-REACH_M, end_m), left, (*lanes("main", plan.n_lanes), shoulder))]
    main, exits = lanes("main", plan.n_main_after), lanes("exit", plan.n_exit_lanes)
    junction, apart = (0.0, parted_m), (parted_m, end_m)
    # The room between main road and exit is shared until both have their whole shoulders.
    inner = _Strip("shoulder", None, lambda s: np.clip((plan.opening(s) - plan.width_m) / 2, 0, plan.shoulder_m))
    exit_line, half_m = LaneCurve("", "centerline", "exit", "none", None, None, None, "exit", 0.0), plan.exit_half_m
    through = main
    if plan.road.topology == 3:
        # This lane begins on its neighbour's.
        line = next(curve for curve in curves(plan) if curve.id == main[-1].segment)
        through = main[:-1]
        found.append(_Layout("opening", junction, line, main[-1:], 0, -plan.width_m / 2, "stem", "main"))
    if oncoming:
        # Connecting roads are for one direction.
        found.append(replace(on_main("facing", junction, left, (), "stem", "main"), is_oncoming=True))
    return [
        *found,
        on_main("stem", (-REACH_M, 0.0), left, (*lanes("stem", plan.n_lanes), shoulder), None, JUNCTION),
        on_main("through", junction, () if oncoming else left, through, "stem", "main"),
        _Layout("leaving", junction, exit_line, (*exits, shoulder), 0, -half_m, "stem", "exit"),
        on_main("main", apart, left, (*main, inner), JUNCTION, None),
        _Layout("exit", apart, exit_line, (inner, *exits, shoulder), 1, -half_m, JUNCTION, None),
    ]


def _road(plan: RoadPlan, layout: _Layout) -> OdrRoad:
    ascends = (plan.flips[1] > 0) != layout.is_oncoming
    low_m, high_m = layout.span_m
    s = np.linspace(low_m, high_m, int(np.ceil((high_m - low_m) / STEP_M)) + 1)[:: 1 if ascends else -1]
    xy = layout.line.xy_world(plan, s)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    # To the left of the reference line, seen in its direction.
    leftward = -plan.flips[0] * (-1 if layout.is_oncoming else 1)
    widths = [np.broadcast_to(w(s) if callable(w := strip.width_m) else w, s.shape) for strip in layout.strips]
    edges = np.cumsum([np.zeros(len(s)), *widths], axis=0)
    edges = leftward * (edges - edges[layout.n_left] + layout.lane_0_m)
    lanes = []
    for i, strip in enumerate(layout.strips):
        outward = -1 if i < layout.n_left else 1
        number = i - layout.n_left if i < layout.n_left else i - layout.n_left + 1
        inner, outer = (edges[i + 1], edges[i]) if outward < 0 else (edges[i], edges[i + 1])
        lanes.append(OdrLane(int(leftward * number), strip.kind, strip.segment, inner, outer))

    def surface_m(xy_world: Points2, plan_s: Scalars) -> Scalars:
        return height_at(plan.terrain, xy_world) + layout.line.raised(plan, plan_s)

    flat = OdrRoad(
        name=layout.name,
        in_junction=layout.after == "main" or layout.after == "exit",
        before=layout.before if ascends else layout.after,
        after=layout.after if ascends else layout.before,
        is_oncoming=layout.is_oncoming,
        is_left_hand=bool(plan.flips[0] < 0),
        plan_s=s,
        s_m=lengths,
        xy_world=xy,
        elevation_m=surface_m(xy, s),
        roll_rad=np.zeros(len(s)),
        center_m=edges[layout.n_left],
        lanes=tuple(sorted(lanes, key=lambda lane: -lane.number)),
        surface_m=surface_m,
    )
    return _banked(flat)


def _banked(road: OdrRoad) -> OdrRoad:
    """The road on the plane nearest to its lanes; their edges are still at the same distances from above."""
    lines = [t for lane in road.driving for t in (lane.inner_m, (lane.inner_m + lane.outer_m) / 2, lane.outer_m)]
    aside = np.array(lines)
    banked = road
    for _ in range(PLANE_STEPS):
        t = aside / np.cos(banked.roll_rad)
        over = np.array([banked.over_plane(at) for at in t])
        t_mean, over_mean = t.mean(axis=0), over.mean(axis=0)
        slope = ((t - t_mean) * (over - over_mean)).sum(axis=0) / ((t - t_mean) ** 2).sum(axis=0)
        elevation = banked.elevation_m + over_mean - slope * t_mean
        banked = replace(banked, elevation_m=elevation, roll_rad=banked.roll_rad + slope * np.cos(banked.roll_rad))
    wider = 1 / np.cos(banked.roll_rad)
    return replace(
        banked,
        center_m=road.center_m * wider,
        lanes=tuple(replace(lane, inner_m=lane.inner_m * wider, outer_m=lane.outer_m * wider) for lane in road.lanes),
    )
