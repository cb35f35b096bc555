"""Where roads of a map leave the ground: on decks over it, in tunnels below it. World frame, metres.

A road is on a deck where a file says that it has a bridge, and over and beside another road, up to where a slope down
from it would no longer reach that road.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry.base import BaseGeometry

from synth3dlanes.geometry.polylines import parted, spaced
from synth3dlanes.roads.road_table import RoadTable
from synth3dlanes.roads.roads import Road
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world.areas import intersections, polygon_between

# Horizontal over vertical extent of embankments and cuts.
EMBANKMENT_SLOPE = 1.5
# Height above another road from which a road passes over it, the thickness of its deck, and the step of the first
# search along roads.
PASSAGE_M, DECK_M, COARSE_STEP_M = 3.0, 0.5, 20.0
LEAST_M2 = 0.02
# Level ground beside a road before its slopes begin.
BERM_M = 1.5
# Decks end at stations END_STEP_M apart. Ground between two decks, or between a deck and an end of the road, that is
# shorter than LEAST_GROUND_M becomes part of the deck.
END_STEP_M, LEAST_GROUND_M = 1.0, 12.0
# Most depth of the valley below the deck of a bridge of a file; height of the ceiling of tunnels and of the ground over
# that, and thickness of their walls.
VALLEY_M, CEILING_M, COVER_M, WALL_M = 4.0, 5.5, 1.0, 0.6
# The ground over a tunnel goes on beyond its ends by this.
TUNNEL_OVERLAP_M = 0.02


class Span(NamedTuple):
    """A part of a road that is off the ground: its stations, its area from above, and whether it is a tunnel, or a
    bridge of a file."""

    road: Road
    from_m: float
    to_m: float
    area: BaseGeometry
    is_tunnel: bool = False
    is_given: bool = False

    def rows(self, step_m: float) -> Scalars:
        """Stations from its beginning to its end."""
        return np.linspace(self.from_m, self.to_m, 2 + int((self.to_m - self.from_m) / step_m))

    def holds(self, s: Scalars) -> Bool[np.ndarray, " n"]:
        """Which stations of the road are inside."""
        return np.asarray((s > self.from_m) & (s < self.to_m))

    def height(self, xy_world: Points2) -> Scalars:
        """Height of the pavement at places in its area."""
        s, t = self.road.line.project(xy_world)
        s = np.clip(s, self.from_m, self.to_m)
        return np.asarray(self.road.base_points(s, np.clip(t, self.road.left(s), self.road.right(s)))[:, 2])


def spans(table: RoadTable, strips: Mapping[str, BaseGeometry]) -> list[Span]:
    """The decks and tunnels of roads with heights, by the pavements of all from above."""
    raised = np.array([i for i, road in enumerate(table.roads) if road.has_heights], dtype=int)
    passed = list(_passages(table, raised, strips))
    ways = _ways(table, raised if passed else raised[:0])
    found = []
    for number in raised.tolist():
        road = table.roads[number]
        tunnels = [(at.from_m, at.to_m) for at in road.tunnels]
        given = [(at.from_m, at.to_m) for at in road.bridges]
        below = (at for at in passed if at.lower is not road and ways[number][1][..., 2].max() - at.z > PASSAGE_M)
        over = [end for at in below for end in _over(*ways[number], at)]
        found += [_span(road, *ends, is_tunnel=True) for ends in tunnels]
        for low, high in _joined(given + over, road):
            is_given = any(a < high and b > low for a, b in given)
            if not any(a < high and b > low for a, b in tunnels):
                found.append(_span(road, low, high, is_given=is_given))
    return found


def _span(road: Road, from_m: float, to_m: float, is_tunnel: bool = False, is_given: bool = False) -> Span:
    s, aside_m = np.linspace(from_m, to_m, 2 + int(to_m - from_m)), WALL_M if is_tunnel else 0.0
    left, right = road.left(s), road.right(s)
    out_m = np.array([-TUNNEL_OVERLAP_M, TUNNEL_OVERLAP_M]) * is_tunnel
    ends = [road.xy(s[[0, -1]] + out_m, edge[[0, -1]])[:, None] for edge in (left, right)]
    # With the corners of the pavement, at which the ground is as high as that; not on a line with the others.
    sides = [
        np.concatenate([end[0], road.xy(s, edge), end[1]])
        for end, edge in zip(ends, (left - aside_m, right + aside_m), strict=True)
    ]
    area = polygon_between(*sides)
    shapely.prepare(area)
    return Span(road, from_m, to_m, area, is_tunnel, is_given)


class _Passage(NamedTuple):
    """The area from above where a road passes below another, that road, and its height there."""

    area: BaseGeometry
    lower: Road
    z: float


def _ways(
    table: RoadTable, numbers: Int[np.ndarray, " k"], step_m: float = END_STEP_M
) -> dict[int, tuple[Float[np.ndarray, " _"], Float[np.ndarray, "3 _ 3"]]]:
    """By the numbers of roads: stations from their beginning to their end, and the points there on their left edge,
    their line and their right edge."""
    if not numbers.size:
        return {}
    end_m = table.end_m[numbers]
    counts = 2 + (end_m / step_m).astype(int)
    road, s = np.repeat(numbers, counts), spaced(0.0 * end_m, end_m, counts)
    left, right = table.edges(road, s)
    points = np.stack([table.base_points(road, s, t) for t in (left, 0 * s, right)])
    each = (at.swapaxes(0, 1) for at in parted(points.swapaxes(0, 1), counts))
    return dict(zip(numbers.tolist(), zip(parted(s, counts), each, strict=True), strict=True))


def _passages(
    table: RoadTable, numbers: Int[np.ndarray, " k"], strips: Mapping[str, BaseGeometry]
) -> Iterator[_Passage]:
    roads, ways = [table.roads[i] for i in numbers], [rows for _, rows in _ways(table, numbers, COARSE_STEP_M).values()]
    if not ways:
        return
    low, high = (np.array([lead(rows[1, :, 2]) for rows in ways]) for lead in (np.min, np.max))
    numbers = np.repeat(np.arange(len(ways)), [2 * rows.shape[1] for rows in ways])
    sides = np.concatenate([rows[[0, 2], :, :2].reshape(-1, 2) for rows in ways])
    outlines = shapely.convex_hull(shapely.multipoints(sides, indices=numbers))
    pairs = shapely.STRtree(outlines).query(outlines, predicate="intersects")
    i, j = pairs[:, (pairs[0] != pairs[1]) & (high[pairs[1]] - low[pairs[0]] >= PASSAGE_M)]
    pavements = np.array([strips[road.id] for road in roads])
    areas, of = shapely.get_parts(intersections(pavements[i], pavements[j]), return_index=True)
    for k in np.flatnonzero(shapely.area(areas) >= LEAST_M2).tolist():
        area, lower, upper = areas[k], roads[i[of[k]]], roads[j[of[k]]]
        middle = shapely.get_coordinates(shapely.point_on_surface(area))
        below, above = (road.base_points(*road.line.project(middle))[0, 2] for road in (lower, upper))
        if above - below > PASSAGE_M:
            shapely.prepare(area)
            yield _Passage(area, lower, float(below))


def _over(s: Scalars, rows: Float[np.ndarray, "3 n 3"], at: _Passage) -> Iterator[tuple[float, float]]:
    """The stations of a road between which it passes over a passage, or a slope down from it would reach the road in
    that."""
    above_m = rows[..., 2] - at.z
    reach_m = BERM_M + 1.0 + EMBANKMENT_SLOPE * np.maximum(above_m, 0.0)
    x0, y0, x1, y1 = shapely.bounds(at.area)
    away_m = np.hypot(
        *(
            np.maximum(np.maximum(low - x, x - high), 0)
            for low, high, x in ((x0, x1, rows[..., 0]), (y0, y1, rows[..., 1]))
        )
    )
    is_near = (above_m > PASSAGE_M) & (away_m < reach_m)
    is_near[is_near] = shapely.distance(at.area, shapely.points(rows[is_near][:, :2])) < reach_m[is_near]
    inside = is_near.any(axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    for first, end in edges.reshape(-1, 2).tolist():
        yield float(s[max(first - 1, 0)]), float(s[min(end, len(s) - 1)])


def _joined(ends: Sequence[tuple[float, float]], road: Road) -> Iterator[tuple[float, float]]:
    """Spans without those between which there is hardly any ground, up to the ends of the road."""
    found: list[tuple[float, float]] = []
    for low, high in sorted(ends):
        if low < LEAST_GROUND_M:
            low = 0.0
        if high > road.end_m - LEAST_GROUND_M:
            high = road.end_m
        if found and low - found[-1][1] < LEAST_GROUND_M:
            low, high = found[-1][0], max(found[-1][1], high)
            found.pop()
        found.append((low, high))
    yield from (at for at in found if at[1] > at[0])
