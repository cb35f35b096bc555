"""Where the lanes of a road of a given map jump aside or in height: its sections are divided there."""

import math
from collections.abc import Iterator, Sequence
from itertools import accumulate, pairwise

import numpy as np

from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import SAME_M, value
from synth3dlanes.roads.maps.furniture import edges_at
from synth3dlanes.roads.maps.lanes import Section
from synth3dlanes.scene.road_map import JUMP_M, MapRoad, Polynomial

# Values that differ by less move nothing by JUMP_M: metres, and radians of banks.
STILL = 1e-4


def divided(road: MapRoad, sections: Sequence[Section]) -> tuple[Section, ...]:
    """The sections of a road, as whole as the lanes are."""
    aside, found = _plan_jumps(road), list[Section]()
    for i, section in enumerate(sections):
        start_m, end_m = road.span_m(i)
        inside = (s_m for s_m in sorted({*aside, *_steps(road, i)}) if start_m + SAME_M < s_m < end_m - SAME_M)
        jumps = [s_m for s_m in inside if _jump_m(road, i, s_m, aside.get(s_m, 0.0)) > JUMP_M]
        found += section.divided(jumps, end_m) if jumps else [section]
    return tuple(found)


def _plan_jumps(road: MapRoad) -> dict[float, float]:
    """How far the reference line steps to its left, by stations."""
    starts = accumulate(piece.length_m for piece in road.plan)
    found = {}
    for s_m, (one, other) in zip(starts, pairwise(road.plan), strict=False):
        x, y, _ = plan_points([one], np.array([one.length_m]))[0].tolist()
        left = math.cos(other.heading_rad) * (other.y_m - y) - math.sin(other.heading_rad) * (other.x_m - x)
        if abs(left) > STILL:
            found[s_m] = left
    return found


def _steps(road: MapRoad, section: int) -> Iterator[float]:
    """The stations at which what moves or lifts the lanes of a section does not go on as before."""
    at = road.sections[section]
    for cubics, from_m in (
        *((cubics, 0.0) for cubics in (road.lane_offsets, road.heights, road.banks)),
        *((lane.widths, at.s_m) for lane in at.lanes),
    ):
        for one, other in pairwise(cubics):
            if abs(_from_below(one, other.s_m) - other.a) > STILL:
                yield from_m + other.s_m


def _from_below(piece: Polynomial, s_m: float) -> float:
    return value([piece], s_m)


def _jump_m(road: MapRoad, section: int, s_m: float, left_m: float) -> float:
    """How far the edges of a section's lanes jump at a station, with a reference line that steps to its left."""
    below, above = _edges(road, section, s_m, s_m), _edges(road, section, s_m, math.inf)
    return max(math.hypot(left_m + b[0] - a[0], b[1] - a[1]) for a, b in zip(below, above, strict=True))


def _edges(road: MapRoad, section: int, s_m: float, end_m: float) -> list[tuple[float, float]]:
    """t and height of the edges of a section's lanes at a station, where what begins at `end_m` does not hold."""
    z, fall = value(road.heights, s_m, end_m), math.tan(value(road.banks, s_m, end_m))
    places = [value(road.lane_offsets, s_m, end_m), *(outer for _, _, outer in edges_at(road, section, s_m, end_m))]
    return [(t, z + fall * t) for t in places]
