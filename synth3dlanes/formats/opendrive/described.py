"""What a file describes: roads as it tells them, with values along these as cubics, and what is on and beside them."""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from synth3dlanes.formats.opendrive.xml import Element
from synth3dlanes.roads.maps.profiles import knots
from synth3dlanes.scene.road_map import LaneName, MapMark, MapRoad, MapShape, RoadMap
from synth3dlanes.system.arrays import Numbers, Points2, Scalars

# A road gets lateral shapes where its surface is farther than this from the banked plane; the number of places across
# the road at which it is measured.
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
