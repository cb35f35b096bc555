"""What a file describes: roads as it tells them, with values along these as cubics, and what is on and beside
them. XML elements with words, numbers and ids as OpenDRIVE files have them."""

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from itertools import count
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.maps.profiles import knots
from synth3dlanes.scene.road_map import LaneName, MapMark, MapRoad, MapShape, RoadMap
from synth3dlanes.system.arrays import Numbers, Points2, Scalars

Element = ElementTree.Element
MAJOR, MINOR = "1", "7"
NO_NUMBER = "-1"
USER_DATA = "synth3dlanes.segment"
"""The code of the user data that names a lane's segment in our lane graph."""
# CARLA and others read ids as whole numbers of 32 bits.
NUMBER = re.compile(r"0|[1-9]\d{0,8}")


def add(parent: Element, tag: str, **attributes: str | float) -> Element:
    texts = {key: value if isinstance(value, str) else text(value) for key, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def numbered(names: Collection[str], taken: Collection[str] = ()) -> dict[str, str]:
    """A number for each name, which is none of those taken: the name itself if it is one, else the next that is
    free."""
    found = {name: name for name in names if NUMBER.fullmatch(name) and name not in taken}
    used = {*found, *taken}
    free = (str(n) for n in count(1) if str(n) not in used)
    return {name: found.get(name) or next(free) for name in names}


def add_crosswalk(
    parent: Element, number: int, corners: Float[np.ndarray, "4 3"], s: float, t: float, **attributes: str | float
) -> Element:
    """A crosswalk at (s, t) by its corners from there along the road, to its left and up. It is turned so that people
    walk along u. Its outline is where readers of version 1.4 look, as CARLA, and closed as they want it."""
    sides = np.diff(corners[:3], axis=0)
    along = sides[int(np.hypot(*sides[1, :2]) > np.hypot(*sides[0, :2]))]
    turn_rad = math.atan2(along[1], along[0])
    words = {"id": str(number), "type": "crosswalk", "orientation": "none", **attributes}
    element = add(parent, "object", **words, s=s, t=t, zOffset=0.0, hdg=turn_rad, pitch=0.0, roll=0.0)
    outline = add(element, "outline", id="0", closed="true")
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    for i, (ahead, left, up) in enumerate([*corners.tolist(), corners[0].tolist()]):
        local = {"u": cos * ahead + sin * left, "v": cos * left - sin * ahead, "z": up, "height": 0.0}
        add(outline, "cornerLocal", id=str(i), **local)
    return element


def text(value: float) -> str:
    """Ten digits: a micrometre in a kilometre. Smaller than a picometre is noise."""
    return f"{value:.10g}" if abs(value) > 1e-12 else "0"


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
