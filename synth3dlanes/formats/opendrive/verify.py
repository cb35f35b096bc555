"""Read an export of maps back: its lanes are those of the labels, roads have no gaps, links lead somewhere."""

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from synth3dlanes.formats.comparing import Comparison, Rule, SourceSample
from synth3dlanes.formats.comparing_maps import compare_map
from synth3dlanes.formats.format import FrameList, ReadFrame, maps_of
from synth3dlanes.formats.opendrive.elements import Element
from synth3dlanes.formats.reading import read_text
from synth3dlanes.roads.cross_section import CrossSection
from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import values
from synth3dlanes.roads.maps.document import parse_xml
from synth3dlanes.roads.maps.given_map import GivenMap, LanePlace, read_opendrive
from synth3dlanes.roads.maps.plan import places
from synth3dlanes.scene.road_map import MapRoad
from synth3dlanes.system.arrays import Points3

USER_DATA = "synth3dlanes.segment"
"""The code of the user data that names a lane's segment in our lane graph."""
# Shapes are heights square to the banked plane, so where the ground bends they move points aside.
RULE = Rule("m", 0.15, name="lane", slack=0.3)
# The cubics of lines, heights and widths are within a millimetre of the same functions.
GAP_M = 0.005
STATION_STEP_M = 1.0


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    return maps_of(out, "xodr", most_frames, _content)


def _content(path: Path) -> tuple[Element, GivenMap]:
    data = read_text(path).encode()
    given = read_opendrive(data, path.name, str(path))
    return parse_xml(data, str(path)), given


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lane centres in metres, in the world frame."""
    root, given = frame.content
    largest_m = max(gap_m for road in given.roads.values() for gap_m in _gaps(road))
    segments = _segments(root, given)
    beyond = _beyond_labels(truth)
    named = [(segments[name], place) for name, place in given.lanes.items() if name in segments]
    lanes = [(name, _middle(place)) for name, place in named if name not in beyond]
    outside = Comparison(outside=Counter({RULE.name: len(named) - len(lanes)}))
    problems = [] if largest_m <= GAP_M else [f"expected roads without gaps, got one of {largest_m:.3f} m"]
    compared = compare_map(lanes, truth, RULE) + outside
    return compared.because([*problems, *_link_problems(root)])


def _beyond_labels(truth: SourceSample) -> frozenset[str]:
    """The lanes of a scene that its labels do not reach."""
    return truth.scene.roads.driving_lanes - {segment.id for segment in truth.labels.graph.segments}


def _segments(root: Element, given: GivenMap) -> dict[str, str]:
    """The segments of our lane graph by the names of the file's lanes."""
    return {
        f"{given.names[road.get('id', '')]}.{i}.{lane.get('id')}": data.get("value", "")
        for road in root.iter("road")
        for i, section in enumerate(road.iter("laneSection"))
        for lane in section.iter("lane")
        for data in lane.iter("userData")
        if data.get("code") == USER_DATA
    }


def _middle(place: LanePlace) -> Points3:
    """Points of the middle of a lane in the direction of its traffic."""
    road, section = place.road, CrossSection.of(place.road, place.section)
    s = np.linspace(section.start_m, section.end_m, 2 + int((section.end_m - section.start_m) / STATION_STEP_M))
    t = section.middle_line(next(i for i, lane in enumerate(section.lanes) if lane is place.lane))(s)
    z = section.height(s, t) if road.heights else 0 * s
    return np.column_stack([places(road.plan, s, -t), z])[:: 1 if place.ascends else -1]


def _gaps(road: MapRoad) -> Iterator[float]:
    """The jumps of a road's reference line, its heights and its widths."""
    for one, other in pairwise(road.plan):
        x, y, _ = plan_points([one], np.array([one.length_m]))[0]
        yield float(np.hypot(other.x_m - x, other.y_m - y))
    widths = (lane.widths for section in road.sections for lane in section.lanes)
    for cubics in (road.heights, road.banks, road.lane_offsets, *widths):
        for k in range(1, len(cubics)):
            yield abs(float(values(cubics[:k], np.array([cubics[k].s_m]))[0]) - cubics[k].a)
    yield 0.0


def _link_problems(root: Element) -> Iterator[str]:
    """Findings where a link leads to a road, junction or lane that is not there."""
    lanes = {
        road.get("id"): [{lane.get("id") for lane in part.iter("lane")} for part in road.iter("laneSection")]
        for road in root.iter("road")
    }
    direct = {junction.get("id") for junction in root.iter("junction") if junction.get("type") == "direct"}
    ids = {"road": set(lanes), "junction": {junction.get("id") for junction in root.iter("junction")}}
    for road in root.iter("road"):
        for link in road.findall("link/*"):
            if link.get("elementId") not in ids.get(str(link.get("elementType")), ()):
                yield f"road {road.get('id')}: expected a {link.get('elementType')} to be there, got {link.attrib}"
        for i, lane, link in _lane_links(road):
            there = road.find(f"link/{link.tag}")
            at_direct = there is not None and there.get("elementId") in direct
            if not at_direct and link.get("id") not in _beyond(road, i, link.tag, lanes):
                yield f"road {road.get('id')}, lane {lane.get('id')}: expected its {link.tag} to be there"
    for connection in root.iter("connection"):
        for link in connection.iter("laneLink"):
            entered = connection.get("connectingRoad") or connection.get("linkedRoad")
            for name, lane_key in ((connection.get("incomingRoad"), "from"), (entered, "to")):
                if link.get(lane_key) not in set[str | None]().union(*lanes.get(name, ())):
                    yield f"connection {connection.get('id')}: expected the lane {link.get(lane_key)} to be there"


def _lane_links(road: Element) -> Iterator[tuple[int, Element, Element]]:
    """The links of a road's lanes, with the number of the section and the lane."""
    for i, section in enumerate(road.iter("laneSection")):
        for lane in section.iter("lane"):
            for link in lane.findall("link/*"):
                yield i, lane, link


def _beyond(road: Element, section: int, tag: str, lanes: dict[str | None, list[set[str | None]]]) -> set[str | None]:
    """The lanes to which those of a section lead at one end: of the section there or, at an end of the road, of the
    road that it is linked to."""
    own = lanes[road.get("id")]
    after = section + (1 if tag == "successor" else -1)
    if 0 <= after < len(own):
        return own[after]
    there = road.find(f"link/{tag}")
    other = [] if there is None else lanes.get(there.get("elementId"), [])
    is_start = there is not None and there.get("contactPoint") == "start"
    return (other[0] if is_start else other[-1]) if other else set()
