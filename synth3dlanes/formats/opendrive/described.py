"""What a file describes: roads as it tells them, with values along these as cubics, and what is on and beside them."""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive.xml import Element
from synth3dlanes.scene.road_map import LaneName, MapMark, MapRoad, MapShape, Polynomial, RoadMap
from synth3dlanes.system.arrays import Numbers, Points2, Scalars

# A road gets lateral shapes where its surface is farther than this from the banked plane, at so many places across.
SHAPE_M, SHAPE_PLACES = 0.005, 9


class Described(NamedTuple):
    """The links, junctions and paint of a map. Its roads by their ids as the file tells them: with rolls about their
    climbing lines, and widths on the rolled planes. Places on their lines, which the header's bounds enclose. The
    segments of our lane graph by the names of lanes, where these differ. What adds things to the roads' elements."""

    map: RoadMap
    roads: Mapping[str, MapRoad]
    xy_world: Points2
    segments: Mapping[LaneName, str]
    add_things: Callable[[Mapping[str, Element]], None]


class PaintedMark(MapMark):
    """A mark with its paint in place: of each stripe the t from the edge, the lengths of dashes and gaps, and where the
    first dash begins. A solid stripe is one dash."""

    stripes: tuple[tuple[float, float, float, float], ...]
    lane_change: str


class CubicPiece(NamedTuple):
    """A cubic in the distance from `s`: rows are constant, linear, quadratic and cubic coefficients, one column per
    function; it ends at `end`."""

    s: float
    end: float
    abcd: Float[np.ndarray, "4 k"]


def pieces(
    s: Scalars, values: Float[np.ndarray, "m k"], tolerance: float, unit_speed: bool = False
) -> list[CubicPiece]:
    """Cubics with equal slopes where they meet, none farther than `tolerance` from the values at the stations `s`: the
    fewest that halving gives. With `unit_speed` the values are points of a curve by its length."""
    slopes = np.gradient(values, s, axis=0, edge_order=2)
    if unit_speed:
        slopes /= np.linalg.norm(slopes, axis=1, keepdims=True)

    def cover(first: int, last: int) -> list[CubicPiece]:
        length, change = s[last] - s[first], values[last] - values[first]
        constant, linear, mean, end = values[first], slopes[first], change / length, slopes[last]
        abcd = np.stack(
            [constant, linear, (3 * mean - 2 * linear - end) / length, (linear + end - 2 * mean) / length**2]
        )
        u = s[first : last + 1] - s[first]
        error = np.linalg.norm(u[:, None] ** np.arange(4) @ abcd - values[first : last + 1], axis=1)
        if last == first + 1 or error.max() <= tolerance:
            return [CubicPiece(float(s[first]), float(s[last]), abcd)]
        middle = (first + last) // 2
        return cover(first, middle) + cover(middle, last)

    return cover(0, len(s) - 1)


def knots(s: Scalars, values: Float[np.ndarray, "m k"], tolerance: float) -> list[int]:
    """Indices of stations `s`, the first and last among them, between which straight lines are never farther than
    `tolerance` from the values: the fewest that halving gives."""

    def cover(first: int, last: int) -> list[int]:
        share = ((s[first : last + 1] - s[first]) / (s[last] - s[first]))[:, None]
        straight = values[first] + share * (values[last] - values[first])
        if last == first + 1 or np.abs(straight - values[first : last + 1]).max() <= tolerance:
            return [last]
        middle = (first + last) // 2
        return cover(first, middle) + cover(middle, last)

    return [0, *cover(0, len(s) - 1)]


def cubics(s: Scalars, values: Scalars, tolerance: float) -> Iterator[Polynomial]:
    """A value along a road as cubics, none farther than `tolerance` from it at its stations."""
    for piece in pieces(s, values[:, None], tolerance):
        a, b, c, d = piece.abcd[:, 0].tolist()
        yield Polynomial(s_m=piece.s, a=a, b=b, c=c, d=d)


def shapes(s: Scalars, over_m: Numbers, left: Scalars, width_m: Scalars) -> Iterator[MapShape]:
    """Lateral shapes of a road whose surface is at its stations `over_m` over its banked plane, at SHAPE_PLACES places
    from `left` on across `width_m`; none where that is little everywhere."""
    if np.abs(over_m).max() <= SHAPE_M:
        return
    share = np.linspace(0, 1, SHAPE_PLACES)
    for i in knots(s, over_m, SHAPE_M):
        rows = np.vander(width_m[i] * share, 4, increasing=True)
        a, b, c, d = np.linalg.lstsq(rows, over_m[i], rcond=None)[0].tolist()
        yield MapShape(s_m=float(s[i]), t_m=float(left[i]), a=a, b=b, c=c, d=d)


def lane_key(name: LaneName) -> tuple[str, int, int]:
    """The road, the section and the number of a lane."""
    road, section, number = name.rsplit(".", 2)
    return road, int(section), int(number)


def lane_ascends(road: MapRoad, section: int, number: int) -> bool:
    """Whether the traffic of a lane goes with growing s."""
    lane = next(lane for lane in road.sections[section].lanes if lane.number == number)
    return (number < 0) ^ road.keeps_left ^ lane.against
