"""The lanes of a world as a map: lane segments with both boundaries and their paint.

Segments are those of the lane graph. World frame, metres; lines go as their traffic does.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from synth3dlanes.labels.labels import MIRRORED, Marking, PaintColor, Pair, Segment
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.system.arrays import Points3
from synth3dlanes.world.paint import is_double, paint_color, pair_of
from synth3dlanes.world.world import World

REACH_M = 75.0  # beyond the corner of the area that is labelled
ON_LINE_M = 0.4  # from a point of a delimiter, of which there is one every half metre
LEAST_PAINTED = 0.5


@dataclass(frozen=True, eq=False)
class Boundary:
    """One side of a lane segment, and the paint along most of it; `none` where there is none. `pair` names stripes that
    differ, from the left as the lane's traffic drives."""

    points_world: Points3
    marking: Marking
    color: PaintColor | None
    double: bool | None
    pair: Pair | None = None


@dataclass(frozen=True, eq=False)
class LaneSegment:
    """A lane between two junctions: segment `index` of the lane graph. Each boundary's point i is beside point i of the
    centre line."""

    index: int
    id: str
    points_world: Points3
    left: Boundary
    right: Boundary
    is_connector: bool
    painted: Callable[[Points3], Boundary]

    def part(self, first: int, last: int) -> "LaneSegment":
        """Its points from the first to the one before the last, its boundaries with the paint along most of these."""
        if (first, last) == (0, len(self.points_world)):
            return self
        left, right = (self.painted(side.points_world[first:last]) for side in (self.left, self.right))
        return replace(self, points_world=self.points_world[first:last], left=left, right=right)


def lane_segments(
    world: World, segments: tuple[Segment, ...], at_world: Float[np.ndarray, "3"], reach_m: float = REACH_M
) -> Iterator[LaneSegment]:
    """The segments of the lane graph within about `reach_m` of a place of the host."""
    network = world.network
    near = network.delimiters_near(at_world[:2], reach_m)
    delimiters = [_Painted(line, line.xy_world(s)) for line, s in near.items() if len(s)]
    for index, segment in enumerate(segments):
        lane = network.lanes[segment.id]
        lines = network.lane_lines(lane, at_world[:2], reach_m)
        if lines is not None:
            middle, *sides = lines
            painted = partial(_painted, world, delimiters)
            left, right = map(painted, sides)
            yield LaneSegment(index, segment.id, middle, left, right, lane.junction is not None, painted)


@dataclass(frozen=True, eq=False)
class _Painted:
    """A painted line and its points from above."""

    line: LaneCurve
    xy: Float[np.ndarray, "_ 2"]

    @cached_property
    def tree(self) -> cKDTree:
        """Its points, to look for near ones."""
        return cKDTree(self.xy)


def _painted(world: World, delimiters: Sequence[_Painted], points_world: Points3) -> Boundary:
    best, best_share = None, LEAST_PAINTED
    for painted in delimiters:
        gaps_m, _ = painted.tree.query(points_world[:, :2], distance_upper_bound=ON_LINE_M)
        share = float(np.mean(gaps_m < ON_LINE_M))
        if share > best_share:
            best, best_share = painted, share
    if best is None:
        return Boundary(points_world, "none", None, None)
    line, markings = best.line, world.scene.markings
    pair = pair_of(line, markings)
    if pair is not None and _is_against(best.xy[:: int(world.network.onwards)], points_world):
        pair = MIRRORED[pair]
    return Boundary(points_world, line.marking, paint_color(line, markings), is_double(line, markings), pair)


def _is_against(xy: Float[np.ndarray, "_ 2"], points_world: Points3) -> bool:
    """Whether a line goes the other way than the points of a lane beside it."""
    middle = max(len(points_world) // 2, 1)
    ahead = points_world[middle, :2] - points_world[middle - 1, :2]
    at = min(int(np.linalg.norm(xy - points_world[middle, :2], axis=1).argmin()), len(xy) - 2)
    return bool((xy[at + 1] - xy[at]) @ ahead < 0)
