"""The lanes of a world as a map: lane segments with both boundaries and their paint, and the edges of the pavement.

Segments are those of the lane graph. World frame, metres; lines go as their traffic does.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.arrays import Points3, Scalars
from synth3dlanes.geometry.lanes import LaneCurve, path_of_segment
from synth3dlanes.geometry.meshes import median_grass_m
from synth3dlanes.geometry.paint import is_double, paint_color
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.labels import Marking, PaintColor, Segment
from synth3dlanes.world import World

STEP_M = 0.5
REACH_M = 75.0  # beyond the corner of the area that is labelled
ON_LINE_M = 0.4  # from a point of a delimiter, of which there is one every half metre
LEAST_PAINTED = 0.5
LEAST_GAP_M = 0.25


@dataclass(frozen=True, eq=False)
class Boundary:
    """One side of a lane segment, and the paint along most of it; `none` where there is none."""

    points_world: Points3
    marking: Marking
    color: PaintColor | None
    double: bool | None


@dataclass(frozen=True, eq=False)
class LaneSegment:
    """A lane between two junctions: segment `index` of the lane graph. Each boundary's point i is beside point i of the
    centre line."""

    index: int
    id: str
    points_world: Points3
    left: Boundary
    right: Boundary


def lane_segments(world: World, segments: tuple[Segment, ...], near_m: float) -> Iterator[LaneSegment]:
    """The segments of the lane graph within about REACH_M of the world station `near_m`."""
    plan = world.plan
    stations = plan.plan_station(near_m + np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M))
    delimiters = {
        line: _delimiter_xy(plan, line, np.sort(stations)) for line in world.site.lines if line.kind != "centerline"
    }
    for index, segment in enumerate(segments):
        path = path_of_segment(plan, segment.id)
        low_m, high_m = np.sort(plan.plan_station(np.array([segment.s_start_m, segment.s_end_m])))
        # The road goes on beyond the outer ends of the graph.
        low_m, high_m = low_m if low_m == 0 else -np.inf, high_m if high_m == 0 else np.inf
        s = np.unique(np.clip(stations, low_m, high_m))
        if len(s) < 2:
            continue
        # Offsets grow to the plan's right; the traffic's left is that side after flips and direction.
        onwards = plan.flips[1] if path.direction == "same" else -plan.flips[1]
        side_m = float(plan.width_m / 2 * plan.flips[0] * plan.flips[1] * onwards)
        lines = _lines(plan, path, s, (0.0, -side_m, side_m), is_stem=bool(high_m == 0))
        middle, left, right = (line[:: 1 if onwards > 0 else -1] for line in lines)
        yield LaneSegment(index, segment.id, middle, *(_painted(world, side, delimiters) for side in (left, right)))


def pavement_edges(world: World, near_m: float) -> Iterator[Points3]:
    """The edges of the pavement, shoulders included, and of a median's grass, within about REACH_M of `near_m`."""
    ground, plan = world.ground, world.plan
    s = np.sort(plan.plan_station(near_m + np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M)))
    offsets = [np.full(len(s), ground.left_edge_m), ground.main_right_edge(s)]
    offsets += [np.full(len(s), t) for t in median_grass_m(ground) or ()]
    for t in offsets:
        xy = plan.main_xy(s, t)
        yield from runs(plan.lift(xy), ground.edge_distances(xy)[1] > 0)
    if plan.has_exit:
        s = s[s >= 0]
        for edge_m in (-ground.exit_edge_m, ground.exit_edge_m):
            xy = plan.exit_xy(s, edge_m)
            yield from runs(plan.lift(xy, plan.ramp(s)), ground.edge_distances(xy)[0] > 0)


def runs(points: Float[np.ndarray, "n 3"], keep: Bool[np.ndarray, " n"]) -> list[Float[np.ndarray, "_ 3"]]:
    """The stretches of a line that are kept, of two points or more."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(int), [0]])))
    return [points[a:b] for a, b in ends.reshape(-1, 2) if b - a >= 2]


def _lines(
    plan: RoadPlan, path: LaneCurve, s: Scalars, asides_m: tuple[float, ...], is_stem: bool
) -> list[Float[np.ndarray, "_ 3"]]:
    """A path's segment and lines beside it, at plan stations in ascending order."""
    beside = [_aside(path, aside_m) for aside_m in asides_m]
    if is_stem or path.fork_road == "main":
        offsets = [np.full(len(s), line.stem_m) if is_stem else line.main_offset(plan, s) for line in beside]
        return [plan.lift(plan.main_xy(s, t)) for t in offsets]
    # An exit begins where its stem ends, on the main road; its own first points may lie behind that.
    exits = [plan.exit_xy(s, line.fork_m) for line in beside]
    ahead = np.all([plan.project_main(xy)[0] > s[0] + LEAST_GAP_M for xy in exits], axis=0) | (s[0] > 0)
    starts = [plan.lift(plan.main_xy(s[:1], _stem_m(line))) for line in beside]
    lines = [plan.lift(xy, plan.ramp(s))[ahead] for xy in exits]
    return lines if s[0] > 0 else [np.concatenate(pair) for pair in zip(starts, lines, strict=True)]


def _aside(path: LaneCurve, aside_m: float) -> LaneCurve:
    return replace(path, stem_m=_stem_m(path) + aside_m, fork_m=path.fork_m + aside_m)


def _stem_m(path: LaneCurve) -> float:
    assert path.stem_m is not None, "every centre line has a stem"
    return path.stem_m


def _delimiter_xy(plan: RoadPlan, line: LaneCurve, s: Scalars) -> Float[np.ndarray, "_ 2"]:
    return line.xy_world(plan, s[(s >= line.start_m) & (s <= line.end_m)])


def _painted(world: World, points_world: Points3, delimiters: dict[LaneCurve, Float[np.ndarray, "_ 2"]]) -> Boundary:
    best, best_share = None, LEAST_PAINTED
    for line, xy in delimiters.items():
        if len(xy):
            gaps_m = np.linalg.norm(points_world[:, None, :2] - xy, axis=2).min(axis=1)
            share = float(np.mean(gaps_m < ON_LINE_M))
            if share > best_share:
                best, best_share = line, share
    if best is None:
        return Boundary(points_world, "none", None, None)
    markings = world.scene.markings
    return Boundary(points_world, best.marking, paint_color(best, markings), is_double(best, markings))
