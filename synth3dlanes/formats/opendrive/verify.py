"""Read an export of maps back: its lanes are those of the labels, roads have no gaps, links lead somewhere."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.comparing import Comparison, Rule, SourceSample, compare_map
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.opendrive.read import FileRoad, number, read_roads, read_xml
from synth3dlanes.formats.opendrive.xml import Element
from synth3dlanes.formats.reading import read_text

# Shapes are heights square to the banked plane, so where the ground bends they move points aside.
RULE = Rule("m", 0.15, name="lane", slack=0.3)
# The cubics of lines, heights and widths are within a millimetre of the same functions.
GAP_M = 0.005
CUBICS = {"elevation": "s", "superelevation": "s", "laneOffset": "s", "width": "sOffset"}
STEP_M = 1.0


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The maps of every split."""
    for folder in sorted({path.parent for path in out.glob("*/*.xodr")}):
        yield FrameList(folder.name, _frames(out, sorted(folder.glob("*.xodr"))[:most_frames]))


def _frames(out: Path, paths: list[Path]) -> Iterator[ReadFrame]:
    for path in paths:
        text, name = read_text(path), str(path.relative_to(out))
        yield ReadFrame(name, str(path), None, (read_xml(text, str(path)), read_roads(text, str(path))))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lane centres in metres, in the world frame."""
    root, roads = frame.content
    try:
        largest_m = float(np.max([_largest_gap(road) for road in root.iter("road")]))
        lanes = [lane for road in roads.values() for lane in _lanes(road)]
    except (KeyError, ValueError, IndexError, OverflowError):
        raise FormatError(f"{frame.where}: expected roads with a reference line of numbers, got others") from None
    problems = [] if largest_m <= GAP_M else [f"expected roads without gaps, got one of {largest_m:.3f} m"]
    for road in roads.values():
        gone = {other for lane in road.lanes for other in road.missing(lane)}
        problems += [f"road {road.id}: expected lane {lane} between others, got none" for lane in sorted(gone)]
    return compare_map(lanes, truth, RULE).because([*problems, *_link_problems(root)])


def _lanes(road: FileRoad) -> Iterator[tuple[str, np.ndarray]]:
    """The segments that lanes of traffic are, and points of their middle in the direction of that traffic."""
    stations = np.linspace(0, road.length, 2 + int(road.length / STEP_M))
    is_right = road.element.get("rule") == "RHT"
    for lane, element in road.lanes.items():
        segment = road.segment(lane)
        if element.get("type") == "driving" and segment is not None and not road.missing(lane):
            yield segment, road.center(lane, stations)[:: 1 if (lane < 0) == is_right else -1]


def _largest_gap(road: Element) -> float:
    """The largest jump of a road's reference line, its heights or its widths."""
    geometries = list(road.iter("geometry"))
    ends = [_end(geometry) for geometry in geometries]
    starts = [[number(geometry, key) for key in ("s", "x", "y")] for geometry in geometries[1:]]
    gaps = [abs(ends[-1][0] - number(road, "length"))]
    gaps += [float(np.abs(np.subtract(a, b)).max()) for a, b in zip(ends, starts, strict=False)]
    for tag, key in CUBICS.items():
        for parent in road.iter():
            for one, other in pairwise(parent.findall(tag)):
                u = number(other, key) - number(one, key)
                gaps.append(abs(_cubic(one, "{}", u) - number(other, "a")))
    return float(np.max(gaps))


def _end(geometry: Element) -> list[float]:
    """s, x and y at the end of a piece of a reference line."""
    length, heading = number(geometry, "length"), number(geometry, "hdg")
    poly = geometry[0]
    u, v = _cubic(poly, "{}U", length), _cubic(poly, "{}V", length)
    x = number(geometry, "x") + np.cos(heading) * u - np.sin(heading) * v
    y = number(geometry, "y") + np.sin(heading) * u + np.cos(heading) * v
    return [number(geometry, "s") + length, x, y]


def _cubic(element: Element, key: str, at: float) -> float:
    return sum(number(element, key.format(letter)) * at**power for power, letter in enumerate("abcd"))


def _link_problems(root: Element) -> Iterator[str]:
    """Findings where a link leads to a road, junction or lane that is not there."""
    lanes = {road.get("id"): {lane.get("id") for lane in road.iter("lane")} for road in root.iter("road")}
    ids = {"road": set(lanes), "junction": {junction.get("id") for junction in root.iter("junction")}}
    for road in root.iter("road"):
        for link in road.findall("link/*"):
            if link.get("elementId") not in ids.get(str(link.get("elementType")), ()):
                yield f"road {road.get('id')}: expected a {link.get('elementType')} to be there, got {link.attrib}"
        for lane in road.iter("lane"):
            for link in lane.findall("link/*"):
                there = road.find(f"link/{link.tag}")
                if there is None or link.get("id") not in lanes.get(there.get("elementId"), ()):
                    yield f"road {road.get('id')}, lane {lane.get('id')}: expected its {link.tag} to be there"
    for connection in root.iter("connection"):
        for link in connection.iter("laneLink"):
            for road_key, lane_key in (("incomingRoad", "from"), ("connectingRoad", "to")):
                if link.get(lane_key) not in lanes.get(connection.get(road_key), ()):
                    yield f"connection {connection.get('id')}: expected the lane {link.get(lane_key)} to be there"
