"""Lanelets as roads: those beside each other are the lanes of one road, whose reference line is a bound between them.

Map frame, metres. Reference lines are arcs with equal directions where they meet, at most ARCS_M from the bound's
points; the other bounds are widths beside them, and all heights are those of the bounds.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.polylines import feet_of, lengths_along
from synth3dlanes.labels.labels import MIRRORED
from synth3dlanes.roads.line_forms import plan_line, plan_points
from synth3dlanes.roads.maps.lanelets import Lanelet, LaneletBound
from synth3dlanes.roads.maps.profiles import cubics, knots
from synth3dlanes.scene.road_map import (
    MAX_LANES,
    MapLane,
    MapLaneKind,
    MapMark,
    MapMarkKind,
    MapRoad,
    MapSection,
    MapShape,
    PlanPiece,
    Polynomial,
)
from synth3dlanes.system.arrays import Points2, Polyline2, Polyline3, Scalars
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import Name

# How far reference lines may be from the points of their bounds, and widths and heights from those of the bounds.
ARCS_M, WIDTH_M, HEIGHT_M = 0.002, 0.002, 0.003
# Limits for a reference line that ends square to its lanes: distance from its bound, turn, and curvature (1/m).
MOST_OFF_BOUND_M, MOST_TURNED_RAD, MOST_BENT = 0.1, 0.3, 0.03
# Step of the stations at which widths and heights are measured; least distance between points of a line.
STATION_STEP_M, LEAST_M = 0.5, 0.1
# Greatest ratio of neighbouring steps of a polyline, so that a bend does not reach into a long one.
GRADE = 2.0
# Strips of pavement beyond the outermost lanes of traffic, where no kerb is there.
BORDER_M = 0.3
DRIVING = ("road", "highway", "play_street", "bus_lane", "exit", "")
KINDS: dict[str, MapLaneKind] = {
    **dict.fromkeys(DRIVING, "driving"),
    "bicycle_lane": "cycle",
    "walkway": "walkway",
    "shared_walkway": "walkway",
    "pedestrian_lane": "walkway",
    "road_shoulder": "shoulder",
    "emergency_lane": "shoulder",
}
MARKS: dict[str, MapMarkKind] = {
    "solid": "solid",
    "dashed": "dashed",
    "solid_solid": "solid_solid",
    "solid_dashed": "solid_dashed",
    "dashed_solid": "dashed_solid",
    "dashed_dashed": "dashed_dashed",
}
PAINTED = {"line_thin": 0.12, "line_thick": 0.25}
WIDEST_M = 2.0
Vector = Float[np.ndarray, "2"]


class LaneletBeside(NamedTuple):
    """A lanelet of a road, and whether its traffic goes as the road's stations grow."""

    lanelet: Lanelet
    is_along: bool

    def edge(self, is_right: bool) -> tuple[LaneletBound, bool]:
        """Its bound on a side as the road goes, and whether the road goes against the order of that's points."""
        bound = self.lanelet.right if is_right == self.is_along else self.lanelet.left
        return bound, not self.is_along

    @property
    def kind(self) -> MapLaneKind:
        """The kind of its lane."""
        return KINDS[self.lanelet.tags.get("subtype", "")]


@dataclass(frozen=True)
class RoadOfLanelets:
    """A road, with the numbers of its lanes by the ids of lanelets."""

    road: MapRoad
    numbers: Mapping[str, int]

    def station(self, xy: Points2) -> Scalars:
        """The stations of places."""
        s, _ = plan_line(self.road.plan).project(xy)
        return np.asarray(np.clip(s, 0.0, self.road.length_m))


def rows_of(lanelets: Sequence[Lanelet]) -> list[list[LaneletBeside]]:
    """The lanelets of every road from its left to its right: those that share bounds. One of traffic is in each; where
    traffic would change sides twice, or more than two share a bound, another row begins."""
    by_bound: dict[tuple[str, bool, bool], list[Lanelet]] = {}
    for lanelet in lanelets:
        for is_right, bound in ((False, lanelet.left), (True, lanelet.right)):
            by_bound.setdefault((bound.way, bound.is_against, is_right), []).append(lanelet)
    taken, found = set[str](), []

    def after(at: LaneletBeside, is_right: bool) -> LaneletBeside | None:
        """What is beside a lanelet on a side of the road."""
        bound, _ = at.edge(is_right)
        # The same bound is on the other side of one that goes the same way, on the same side of an oncoming one.
        side = is_right == at.is_along
        same = by_bound.get((bound.way, bound.is_against, not side), [])
        oncoming = by_bound.get((bound.way, not bound.is_against, side), [])
        if len(same) + len(oncoming) != 1:
            return None
        return LaneletBeside(same[0], at.is_along) if same else LaneletBeside(oncoming[0], not at.is_along)

    for lanelet in (at for at in lanelets if KINDS[at.tags.get("subtype", "")] == "driving"):
        if lanelet.id in taken:
            continue
        row = [LaneletBeside(lanelet, True)]
        taken.add(lanelet.id)
        for is_right in (False, True):
            while len(row) < MAX_LANES:
                other = after(row[-1 if is_right else 0], is_right)
                if other is None or other.lanelet.id in taken:
                    break
                longer = [*row, other] if is_right else [other, *row]
                if len(_turns(longer)) > 1:
                    break
                row = longer
                taken.add(other.lanelet.id)
        found.append(row)
    return found


def _turns(row: Sequence[LaneletBeside]) -> list[int]:
    """The numbers of the lanelets of traffic from which on, from the left, traffic goes the other way."""
    driving = [i for i, at in enumerate(row) if at.kind == "driving"]
    return [b for a, b in pairwise(driving) if row[a].is_along != row[b].is_along]


def keeps_left(rows: Sequence[Sequence[LaneletBeside]]) -> bool:
    """Whether traffic keeps left on most roads with lanelets of both directions."""
    one_way = (row for row in rows if all(at.lanelet.tags.get("one_way") != "no" for at in row))
    rights = [row[at].is_along for row in one_way for at in _turns(row)]
    return 2 * sum(rights) < len(rights)


def road_of(name: Name, row: Sequence[LaneletBeside], is_left_hand: bool, is_in_junction: bool) -> RoadOfLanelets:
    """The road of a row. Raises FormatError for bounds that go back or cross each other."""
    turns, driving = _turns(row), [i for i, at in enumerate(row) if at.kind == "driving"]
    if turns:
        is_left_hand = not row[turns[0]].is_along
    edges = [at.edge(False) for at in row] + [row[-1].edge(True)]
    lines = [bound.points[:: -1 if turned else 1] for bound, turned in edges]
    # The one that is most square to both ends: roads end square to it. Else that between both directions.
    usual = turns[0] if turns else driving[-1] + 1 if is_left_hand else driving[0]
    middle = min(range(len(edges)), key=lambda i: (_skew(lines[i], lines), _bends(lines[i]), i != usual))
    plan, is_bound = _reference(lines[middle], lines)
    length_m = sum(piece.length_m for piece in plan)
    s = np.linspace(0.0, length_m, 3 + int(length_m / STATION_STEP_M))
    line = plan_line(plan)
    offsets, heights = np.zeros((len(edges), len(s))), np.zeros((len(edges), len(s)))
    for i, points in enumerate(lines):
        fine = _fine(points)
        stations, t = line.project(fine[:, :2], _stations_near(fine[:, :2], line.xy(s, np.zeros(len(s))), s))
        if i == middle and is_bound:
            t = np.zeros(len(t))
        if not (np.diff(stations) > -STATION_STEP_M).all():
            raise FormatError(
                f"lanelet {row[min(i, len(row) - 1)].lanelet.id}: expected a bound that goes on, got it back"
            )
        order = np.argsort(stations, kind="stable")
        offsets[i], heights[i] = (_interpolated(s, stations[order], of[order]) for of in (-t, fine[:, 2]))
    widths = offsets[:-1] - offsets[1:]
    if not (widths > -WIDTH_M).mean() > 0.9 or not widths.max() > LEAST_M:
        raise FormatError(f"lanelet {row[0].lanelet.id}: expected bounds beside each other, got them across")
    lanes = [MapLane(number=0, kind="none", marks=_marks(*edges[middle], is_inner_left=True))]
    numbers = {}
    for i, at in enumerate(row):
        number = middle - i if i < middle else middle - i - 1
        outer = edges[i] if number > 0 else edges[i + 1]
        marks = _marks(*outer, is_inner_left=number < 0)
        own_widths = tuple(cubics(s, np.maximum(widths[i], 0.0), WIDTH_M))
        is_against = at.kind == "driving" and at.is_along == ((number > 0) != is_left_hand)
        lanes.append(MapLane(number=number, kind=at.kind, widths=own_widths, marks=marks, against=is_against))
        numbers[at.lanelet.id] = number
    for side, outer in ((1, edges[0]), (-1, edges[-1])):
        own = [lane for lane in lanes if lane.number * side > 0]
        last = max(own, key=lambda lane: abs(lane.number), default=None)
        is_kerb = outer[0].tags.get("type") == "curbstone"
        if not is_in_junction and not is_kerb and (last is None or last.kind == "driving") and len(own) < MAX_LANES:
            width = (Polynomial(s_m=0.0, a=BORDER_M),)
            lanes.append(MapLane(number=side * (len(own) + 1), kind="border", widths=width))
    across = zip(offsets[::-1].T, heights[::-1].T, strict=True)
    on_line = heights[middle] if is_bound else np.array([np.interp(0.0, t, z) for t, z in across])
    road = MapRoad(
        id=name,
        plan=plan,
        lane_offsets=() if is_bound else tuple(cubics(s, offsets[middle], WIDTH_M)),
        sections=(MapSection(s_m=0.0, lanes=tuple(sorted(lanes, key=lambda lane: -lane.number))),),
        heights=tuple(cubics(s, on_line, HEIGHT_M)),
        shapes=_shapes(s, offsets, heights - on_line),
        keeps_left=is_left_hand,
    )
    return RoadOfLanelets(road, numbers)


def _reference(points: Polyline3, lines: Sequence[Polyline3]) -> tuple[tuple[PlanPiece, ...], bool]:
    """A reference line along a bound, and whether it is that. Where several lanes do not end square to the bound, it
    leaves the bound by up to MOST_OFF_BOUND_M to end square to them, so that the next road begins there."""
    plan = arcs(points[:, :2])
    if len(lines) < 3 or not _skew(points, lines):
        return plan, True
    ends = []
    for end in (0, -1):
        right = (lines[-1][end] - lines[0][end])[:2]
        ends.append(np.array([-right[1], right[0]]) / max(float(np.hypot(*right)), 1e-9))
    headings = plan[0].heading_rad, plan[-1].heading_rad + plan[-1].curvature * plan[-1].length_m
    turned = [math.remainder(math.atan2(at[1], at[0]) - of, 2 * math.pi) for at, of in zip(ends, headings, strict=True)]
    length_m = sum(piece.length_m for piece in plan)
    # On a short road or at a slanted end it would bend too much.
    if max(map(abs, turned)) > MOST_TURNED_RAD or max(map(abs, turned)) / length_m > MOST_BENT:
        return plan, True
    return arcs(points[:, :2], (ends[0], ends[1]), MOST_OFF_BOUND_M), False


def _skew(points: Polyline3, lines: Sequence[Polyline3]) -> int:
    """How far a line is from square to where all lines begin and end, from above, in fiftieths of a radian."""
    found = 0.0
    for end, inner in ((0, 1), (-1, -2)):
        along, across = (points[inner] - points[end])[:2], (lines[-1][end] - lines[0][end])[:2]
        found += abs(float(along @ across)) / max(float(np.hypot(*along) * np.hypot(*across)), 1e-9)
    return round(50 * found)


def _bends(points: Polyline3) -> float:
    """How far a line turns in all, from above, in tenths of a radian."""
    headings = np.unwrap(np.arctan2(*np.diff(points[:, :2], axis=0).T[::-1]))
    return round(10 * float(np.abs(np.diff(headings)).sum()))


def _marks(bound: LaneletBound, is_turned: bool, is_inner_left: bool) -> tuple[MapMark, ...]:
    """The paint of a bound: a pair from the inner stripe outwards."""
    kind = MARKS.get(bound.tags.get("subtype", "")) if bound.tags.get("type") in PAINTED else None
    if kind is None:
        return ()
    # The way's own left is the road's left if it is drawn as the road goes.
    if (bound.is_against == is_turned) != is_inner_left:
        kind = MIRRORED.get(kind, kind)
    try:
        width_m = float(bound.tags.get("width", ""))
    except ValueError:
        width_m = math.nan
    standard_m = PAINTED[bound.tags["type"]]
    return (
        MapMark(
            kind=kind,
            yellow=bound.tags.get("color") == "yellow",
            width_m=width_m if 0 < width_m <= WIDEST_M else standard_m,
        ),
    )


def _fine(points: Polyline3) -> Polyline3:
    """The points of a line, and more between those that are far apart."""
    lengths = lengths_along(points)
    more = np.linspace(0.0, lengths[-1], 2 + int(lengths[-1] / STATION_STEP_M))
    at = np.union1d(lengths, more)
    return np.column_stack([np.interp(at, lengths, column) for column in points.T])


def _stations_near(xy: Polyline2, line: Polyline2, s: Float[np.ndarray, " m"]) -> Float[np.ndarray, " _"]:
    """The station of the line's nearest point for each of some points along it, none before that of an earlier one."""
    at, found = 0, np.zeros(len(xy))
    for i, point in enumerate(xy):
        ahead = line[at : at + 200]
        at += int(np.argmin(np.hypot(*(ahead - point).T)))
        found[i] = s[at]
    return found


def _interpolated(
    s: Float[np.ndarray, " m"], at: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " m"]:
    """Values at stations, which go on evenly before the first and behind the last known one."""
    found = np.interp(s, at, values)
    for end, inner, outside in ((0, min(4, len(at) - 1), s < at[0]), (-1, max(-5, -len(at)), s > at[-1])):
        if at[inner] != at[end]:
            slope = (values[inner] - values[end]) / (at[inner] - at[end])
            found[outside] = values[end] + slope * (s[outside] - at[end])
    return found


def _shapes(
    s: Float[np.ndarray, " m"], offsets: Float[np.ndarray, "k m"], over_m: Float[np.ndarray, "k m"]
) -> tuple[MapShape, ...]:
    """Heights of bounds over the reference line, even between bounds beside each other; none of a level road."""
    if np.abs(over_m).max() < HEIGHT_M:
        return ()
    found = []
    for row in knots(s, over_m.T, HEIGHT_M):
        # From the right, t grows.
        t, z = offsets[::-1, row], over_m[::-1, row]
        for i in range(len(t) - 1):
            step_m = t[i + 1] - t[i]
            slope = (z[i + 1] - z[i]) / step_m if step_m > LEAST_M else 0.0
            if i == 0 or step_m > LEAST_M:
                found.append(MapShape(s_m=s[row], t_m=t[i], a=z[i], b=slope))
    return tuple(found)


# -- reference lines


def arcs(points: Polyline2, ends: tuple[Vector, Vector] | None = None, near_m: float = ARCS_M) -> tuple[PlanPiece, ...]:
    """Arcs through points of a line that go on into each other, at most `near_m` from all of its points: the fewest
    that halving gives. `ends` are their directions there, if not the line's. Raises FormatError for a line that turns
    back."""
    points = _graded(points)
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    ways = steps / lengths[:, None]
    if (np.einsum("ni,ni->n", ways[:-1], ways[1:]) < -0.5).any():
        raise FormatError("expected a bound that goes on, got one that turns back")
    # The direction of the parabola through a point and its neighbours.
    inner = (ways[:-1] * lengths[1:, None] + ways[1:] * lengths[:-1, None]) / (lengths[:-1] + lengths[1:])[:, None]
    first, last = ways[0], ways[-1]
    if len(ways) > 1:
        first, last = 2 * ways[0] - inner[0], 2 * ways[-1] - inner[-1]
    first, last = ends or (first, last)
    tangents = np.concatenate([first[None], inner, last[None]])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)

    def cover(a: int, b: int) -> list[PlanPiece]:
        pair = _biarc(points[a], tangents[a], points[b], tangents[b])
        if b == a + 1 or _is_near(pair, points[a + 1 : b], near_m):
            return pair
        middle = (a + b) // 2
        return cover(a, middle) + cover(middle, b)

    return tuple(cover(0, len(points) - 1))


def _graded(points: Polyline2) -> Polyline2:
    """The points of a line that differ, and more on steps that are long beside a short one."""
    kept = [0]
    kept += (i for i in range(1, len(points)) if math.dist(points[i], points[kept[-1]]) > LEAST_M / 10)
    # The end stays where it is.
    kept[1:] = [*kept[1:-1], len(points) - 1] if len(kept) > 1 else []
    points = points[kept]
    lengths = np.hypot(*np.diff(points, axis=0).T)
    if not len(lengths) or lengths.sum() < LEAST_M:
        raise FormatError("expected a bound of some length from above, got a point")
    found = [points[:1]]
    for i, length in enumerate(lengths.tolist()):
        before, after = (float(lengths[k]) if 0 <= k < len(lengths) else length for k in (i - 1, i + 1))
        ends = [_growing(at, length) for at in (before, after)]
        at = sorted({*ends[0], *(length - x for x in ends[1]), length})
        at = [b for a, b in pairwise([0.0, *at]) if b - a > LEAST_M / 10 or b == length]
        found.append(points[i] + np.array(at)[:, None] / length * (points[i + 1] - points[i]))
    return np.concatenate(found)


def _growing(step_m: float, length_m: float) -> list[float]:
    """Places on the first half of a length at steps that grow from GRADE times one on."""
    found, at, step_m = [], 0.0, GRADE * step_m
    while at + step_m < length_m / 2:
        at += step_m
        found.append(at)
        step_m *= GRADE
    return found


def _biarc(start: Vector, along: Vector, end: Vector, leaving: Vector) -> list[PlanPiece]:
    """Two arcs between places with directions; one where they are the same."""
    way = end - start
    a, b, c = 2 * (1 - along @ leaving), way @ (along + leaving), way @ way
    reach = c / (2 * b) if a < 1e-9 else (math.sqrt(b * b + a * c) - b) / a
    middle = (start + end + reach * (along - leaving)) / 2
    first = _arc(start, math.atan2(along[1], along[0]), middle)
    heading = first.heading_rad + first.curvature * first.length_m
    second = _arc(middle, heading, end)
    if abs(first.curvature - second.curvature) * first.length_m < 1e-9:
        return [_arc(start, first.heading_rad, end)]
    return [first, second]


def _arc(start: Vector, heading: float, end: Vector) -> PlanPiece:
    dx, dy = (end - start).tolist()
    half = math.remainder(math.atan2(dy, dx) - heading, 2 * math.pi)
    length_m = math.hypot(dx, dy) * (half / math.sin(half) if abs(half) > 1e-9 else 1.0)
    bend = 2 * half / length_m
    return PlanPiece(
        x_m=float(start[0]),
        y_m=float(start[1]),
        heading_rad=heading,
        length_m=length_m,
        curvature=bend,
        curvature_end=bend,
    )


def _is_near(plan: Sequence[PlanPiece], points: Polyline2, near_m: float) -> bool:
    """Whether points are all at most `near_m` from arcs."""
    length_m = sum(piece.length_m for piece in plan)
    # Steps along arcs whose heights are far below that.
    bend = max(abs(piece.curvature) for piece in plan)
    n = 2 + int(length_m * math.sqrt(max(bend, 1e-6) / (8 * ARCS_M / 20)))
    line = plan_points(plan, np.linspace(0.0, length_m, n))[:, :2]
    return bool(feet_of(points, line)[0].max() <= near_m)
