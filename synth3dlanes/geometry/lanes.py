"""The lane graph and the lane curves of a road plan: lanes, painted lines and successors.

Curves are functions of the plan station (see road.py); their world points come from `LaneCurve.points_world`.
The four topologies are the paper's Table 'Road and lane topology'.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from synth3dlanes.arrays import Scalars
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.labels import Direction, LaneGraph, LaneKind, Marking, RoadName, Segment
from synth3dlanes.scene import Camera

# min(q, width) has a corner at the nose. It is rounded where q is this close to the width, so that the lane is smooth;
# this moves the lane by at most 1.5 cm.
CORNER_M = 0.06


@dataclass(frozen=True)
class LaneCurve:
    """One lane curve over the stations [start_m, end_m].

    At stations below 0 its offset is `stem_m` from the main reference line; with `stem_m` None it has no such part.
    Above 0 its offset is `fork_m` from the reference line of `fork_road`; with `opens` it moves from `stem_m` to
    `fork_m` as the exit opens. `direction` is as in the labels; `is_inner` says whether a delimiter faces the oncoming
    traffic, or is the left edge of a road without any.
    """

    id: str
    kind: LaneKind
    road: RoadName
    marking: Marking
    left: str | None
    right: str | None
    stem_m: float | None
    fork_road: RoadName
    fork_m: float
    start_m: float = -np.inf
    end_m: float = np.inf
    opens: bool = False
    direction: Direction = "same"
    is_inner: bool = False

    def xy_world(self, plan: RoadPlan, s: Scalars) -> Float[np.ndarray, "n 2"]:
        """World (x, y) at plan stations."""
        if self.fork_road == "main":
            return plan.main_xy(s, self.main_offset(plan, s))
        stem = np.minimum(s, self.joint_m(plan))
        return np.where(
            (s >= 0)[:, None],
            plan.exit_xy(np.maximum(s, 0), self.fork_m),
            plan.main_xy(stem, self.main_offset(plan, stem)),
        )

    def points_world(self, plan: RoadPlan, s: Scalars) -> Float[np.ndarray, "n 3"]:
        """Points on the road surface at plan stations."""
        return plan.lift(self.xy_world(plan, s), self.raised(plan, s))

    def raised(self, plan: RoadPlan, s: Scalars) -> Scalars:
        """Height of the road surface above the terrain at plan stations."""
        return np.where((s >= 0) & (self.fork_road == "exit"), plan.ramp(s), 0.0)

    def main_offset(self, plan: RoadPlan, s: Scalars) -> Scalars:
        """Offset from the main reference line at stations where the curve runs on the main road."""
        stem_m = self.fork_m if self.stem_m is None else self.stem_m
        if not self.opens:
            return np.full(s.shape, stem_m)
        return stem_m + np.sign(self.fork_m - stem_m) * smooth_min(plan.opening(np.maximum(s, 0)), plan.width_m)

    def joint_m(self, plan: RoadPlan) -> float:
        """Last station of the stem: the projection of the curve's first exit point onto the main road, at most 0."""
        return _joint_m(plan, self.fork_m)


@lru_cache(maxsize=32)
def _joint_m(plan: RoadPlan, fork_m: float) -> float:
    start = plan.exit_xy(np.zeros(1), fork_m)
    return min(0.0, float(plan.project_main(start)[0][0]))


def smooth_min(q: Scalars, width_m: float) -> Scalars:
    """min(q, width) with its corner rounded; equal to min(q, width) outside CORNER_M of it."""
    h = np.clip(CORNER_M - np.abs(q - width_m), 0, None)
    return np.minimum(q, width_m) - h * h / (4 * CORNER_M)


def curves(plan: RoadPlan) -> tuple[LaneCurve, ...]:
    """Centre lines, one per path through the graph, then delimiters, one per painted line, from the plan's left.

    They refer to each other by id; a flip of x swaps every left and right.
    """
    lines = [*_centerlines(plan), *_delimiters(plan), *_oncoming_delimiters(plan)]
    if plan.flips[0] < 0:
        lines = [replace(line, left=line.right, right=line.left) for line in lines]
    facing = {_line_id(plan, "main", 0), _oncoming_line_id(plan, plan.n_oncoming)} if plan.n_oncoming else set()
    return tuple(
        replace(line, is_inner=line.id in facing or (not facing and line.left is None))
        if line.kind == "delimiter"
        else line
        for line in lines
    )


def _oncoming_id(plan: RoadPlan, lane: int) -> str:
    return f"oncoming_{seen_from_left(plan, lane, plan.n_oncoming)}"


def _oncoming_line_id(plan: RoadPlan, j: int) -> str:
    """Delimiter j = 0..n of the n oncoming lanes, numbered as `_line_id` does."""
    return f"oncoming_line_{plan.n_oncoming - j if plan.flips[0] < 0 else j}"


def _center_id(plan: RoadPlan, road: RoadName, lane: int) -> str:
    n = plan.n_main_after if road == "main" else plan.n_exit_lanes
    return f"{road}_{seen_from_left(plan, lane, n)}"


def _line_id(plan: RoadPlan, road: RoadName, j: int) -> str:
    """Delimiter j = 0..n of a road of n lanes; numbered from 0 at the left edge as the host drives."""
    n = plan.n_main_after if road == "main" else plan.n_exit_lanes
    return f"{road}_line_{n - j if plan.flips[0] < 0 else j}"


def seen_from_left(plan: RoadPlan, lane: int, n: int) -> int:
    """Number from the host's left of the plan's lane 1..n, and vice versa."""
    return n + 1 - lane if plan.flips[0] < 0 else lane


@lru_cache(maxsize=8)
def _centerlines(plan: RoadPlan) -> tuple[LaneCurve, ...]:
    def center(road: RoadName, lane: int, stem_m: float, fork_m: float, opens: bool = False) -> LaneCurve:
        left, right = _line_id(plan, road, lane - 1), _line_id(plan, road, lane)
        return LaneCurve(
            _center_id(plan, road, lane), "centerline", road, "none", left, right, stem_m, road, fork_m, opens=opens
        )

    def middle_m(lane: int) -> float:
        return plan.boundary_m(lane) - plan.width_m / 2

    n, topology = plan.n_lanes, plan.road.topology
    main = [center("main", lane, middle_m(lane), middle_m(lane)) for lane in range(1, plan.n_main_after + 1)]
    if topology == 3:
        main[-1] = center("main", n, middle_m(n - 1), middle_m(n), opens=True)
    first_taken = n - plan.n_exit_lanes
    exits = [
        center("exit", lane, middle_m(first_taken + lane), middle_m(first_taken + lane) - plan.exit_base_m)
        for lane in range(1, plan.n_exit_lanes + 1)
    ]
    return (*main, *exits, *_oncoming_centerlines(plan))


def _oncoming_centerlines(plan: RoadPlan) -> list[LaneCurve]:
    n = plan.n_oncoming
    divider = _line_id(plan, "main", 0) if plan.road.median_m == 0 else _oncoming_line_id(plan, n)
    lines = [*(_oncoming_line_id(plan, j) for j in range(n)), divider]
    lanes = []
    for lane in range(1, n + 1):
        middle_m = plan.left_m + (lane - 0.5) * plan.width_m
        lanes.append(
            LaneCurve(
                _oncoming_id(plan, lane),
                "centerline",
                "main",
                "none",
                lines[lane - 1],
                lines[lane],
                middle_m,
                "main",
                middle_m,
                direction="oncoming",
            )
        )
    return lanes


def _oncoming_delimiters(plan: RoadPlan) -> list[LaneCurve]:
    """The lines of the oncoming lanes; without a median the innermost is the main road's own."""
    n = plan.n_oncoming
    lines = []
    for j in range(n + 1 if n and plan.road.median_m > 0 else n):
        marking: Marking = "dashed" if 0 < j < n else "solid"
        left = _oncoming_id(plan, j) if j > 0 else None
        right = _oncoming_id(plan, j + 1) if j < n else None
        at_m = plan.left_m + j * plan.width_m
        name = _oncoming_line_id(plan, j)
        lines.append(
            LaneCurve(name, "delimiter", "main", marking, left, right, at_m, "main", at_m, direction="oncoming")
        )
    return lines


def _delimiters(plan: RoadPlan) -> list[LaneCurve]:
    n, topology, half = plan.n_lanes, plan.road.topology, plan.exit_half_m
    divides = plan.n_oncoming > 0 and plan.road.median_m == 0

    def line(
        road: RoadName, j: int, marking: Marking, stem_m: float | None, fork_m: float, start_m: float = -np.inf
    ) -> LaneCurve:
        count = plan.n_main_after if road == "main" else plan.n_exit_lanes
        left = _center_id(plan, road, j) if j > 0 else None
        right = _center_id(plan, road, j + 1) if j < count else None
        name = _line_id(plan, road, j)
        return LaneCurve(name, "delimiter", road, marking, left, right, stem_m, road, fork_m, start_m=start_m)

    def through(j: int) -> LaneCurve:
        is_dashed = 0 < j < n or (j == 0 and divides and plan.road.divider_dashed)
        found = line("main", j, "dashed" if is_dashed else "solid", plan.boundary_m(j), plan.boundary_m(j))
        return replace(found, left=_oncoming_id(plan, plan.n_oncoming)) if j == 0 and divides else found

    if topology == 1:
        return [through(j) for j in range(n + 1)]
    kept = {2: n, 3: n - 1, 4: n - 1}[topology]
    lines = [through(j) for j in range(kept)]
    if topology == 3:
        # The dashed line between the last two lanes continues along the exit's left side to the nose.
        stem = LaneCurve(
            "stem_line", "delimiter", "main", "dashed", _center_id(plan, "main", n), _center_id(plan, "exit", 1),
            plan.boundary_m(n - 1), "exit", -half, end_m=plan.nose_m,
        )  # fmt: skip
        lines += [stem, line("main", n - 1, "dashed", None, plan.boundary_m(n - 1), plan.nose_m)]
    lines += [
        line("main", plan.n_main_after, "solid", None, plan.boundary_m(plan.n_main_after), plan.nose_m),
        line("exit", 0, "solid", None, -half, plan.nose_m),
    ]
    if topology == 4:
        lines.append(line("exit", 1, "dashed", plan.boundary_m(n - 1), 0.0))
    return [*lines, line("exit", plan.n_exit_lanes, "solid", plan.boundary_m(n), half)]


def lane_graph(plan: RoadPlan, centerline_ids: Sequence[str]) -> LaneGraph:
    """Segments between junctions, numbered as the host sees them, and their successors in driving direction.

    Segments list only those of their centre lines that are in `centerline_ids`.
    """
    oncoming = _segments(plan, "oncoming", "main", plan.n_oncoming, 100.0, -100.0, centerline_ids)
    if not plan.has_exit:
        main = _segments(plan, "main", "main", plan.n_lanes, -100.0, 100.0, centerline_ids)
        return LaneGraph(main + oncoming, {}, None)
    merge = plan.flips[1] < 0
    stem_from, stem_to = (0.0, 100.0) if merge else (-100.0, 0.0)
    fork_from, fork_to = (-100.0, 0.0) if merge else (0.0, 100.0)
    segments = (
        _segments(plan, "stem", "main", plan.n_lanes, stem_from, stem_to, centerline_ids)
        + _segments(plan, "main", "main", plan.n_main_after, fork_from, fork_to, centerline_ids)
        + _segments(plan, "exit", "exit", plan.n_exit_lanes, fork_from, fork_to, centerline_ids)
        + oncoming
    )
    pairs = [(s, f) if not merge else (f, s) for s, f in connections(plan)]
    successors = {a: tuple(y for x, y in pairs if x == a) for a, _ in sorted(pairs)}
    start = plan.ramp_start_m
    return LaneGraph(segments, successors, None if start is None else round(float(start * plan.flips[1]), 4) + 0.0)


def connections(plan: RoadPlan) -> list[tuple[str, str]]:
    """(stem segment, fork segment) of every path; the fork segment's id is also the id of the path's centre line."""
    n = plan.n_lanes
    main: list[tuple[int, RoadName, int]] = [(lane, "main", lane) for lane in range(1, plan.n_main_after + 1)]
    if plan.road.topology == 3:
        main[-1] = (n - 1, "main", n)
    exits: list[tuple[int, RoadName, int]] = [
        (n - plan.n_exit_lanes + lane, "exit", lane) for lane in range(1, plan.n_exit_lanes + 1)
    ]
    return [
        (f"stem_{seen_from_left(plan, stem, n)}", _center_id(plan, road, lane)) for stem, road, lane in main + exits
    ]


def _segments(
    plan: RoadPlan, prefix: str, road: RoadName, n: int, s_start_m: float, s_end_m: float, known: Sequence[str]
) -> tuple[Segment, ...]:
    def used_by(name: str) -> tuple[str, ...]:
        paths = [fork for stem, fork in connections(plan) if stem == name] if prefix == "stem" else [name]
        return tuple(path for path in paths if path in known)

    names = [f"{prefix}_{lane}" for lane in range(1, n + 1)]
    return tuple(
        Segment(
            id=name,
            road=road,
            lane=lane,
            s_start_m=s_start_m,
            s_end_m=s_end_m,
            left=names[lane - 2] if lane > 1 else None,
            right=names[lane] if lane < n else None,
            centerlines=used_by(name),
        )
        for lane, name in enumerate(names, start=1)
    )


def path_of_segment(plan: RoadPlan, segment_id: str) -> LaneCurve:
    """A centre line that runs along a lane segment (for cars)."""
    path_id = segment_id
    if segment_id.startswith("stem_"):
        path_id = next(fork for stem, fork in connections(plan) if stem == segment_id)
    return next(line for line in _centerlines(plan) if line.id == path_id)


def host_segment(plan: RoadPlan, camera: Camera) -> str:
    """The segment of the host's lane, counted from the left among the main lanes at its station."""
    return plan.road.segments_at(camera.y_m)[camera.lane - 1]
