"""The self-check of an OpenDRIVE export: roads without gaps, and links to lanes that are there."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.reading import MOST, read_text
from synth3dlanes.formats.self_check import Verification

Element = ElementTree.Element

# The cubics of lines, heights and widths are within a millimetre of the same functions.
GAP_M = 0.005
CUBICS = {"elevation": "s", "superelevation": "s", "laneOffset": "s", "width": "sOffset"}


def verify(out: Path, most_frames: int) -> Iterator[Verification]:
    """The maps of every split."""
    for folder in sorted({path.parent for path in out.glob("*/*.xodr")}):
        paths = sorted(folder.glob("*.xodr"))[:most_frames]
        n_lanes, problems, gap_m = 0, [], 0.0
        for path in paths:
            root, where = _read(path), f"{folder.name}/{path.name}"
            n_lanes += sum(lane.get("type") == "driving" for lane in root.iter("lane"))
            try:
                found = float(np.max([_largest_gap(road) for road in root.iter("road")]))
            except (KeyError, ValueError, IndexError, OverflowError):
                raise FormatError(f"{path}: expected roads with a reference line of numbers, got others") from None
            if not found <= GAP_M:
                problems.append(f"{where}: expected roads without gaps, got one of {found:.3f} m")
            problems += [f"{where}: {problem}" for problem in _link_problems(root)]
            gap_m = max(gap_m, found)
        yield Verification(folder.name, len(paths), n_lanes, {"largest_gap_m": gap_m}, {}, tuple(problems))


def _read(path: Path) -> Element:
    text = read_text(path)
    if "<!" in text:  # document types define entities, which may be huge
        raise FormatError(f"{path}: expected a map without a document type or comments, got one")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise FormatError(f"{path}: expected a map, got {error}") from None


def _largest_gap(road: Element) -> float:
    """The largest jump of a road's reference line, its heights or its widths."""
    geometries = list(road.iter("geometry"))
    ends = [_end(geometry) for geometry in geometries]
    starts = [[_value(geometry, key) for key in ("s", "x", "y")] for geometry in geometries[1:]]
    gaps = [abs(ends[-1][0] - _value(road, "length"))]
    gaps += [float(np.abs(np.subtract(a, b)).max()) for a, b in zip(ends, starts, strict=False)]
    for tag, key in CUBICS.items():
        for parent in road.iter():
            for one, other in pairwise(parent.findall(tag)):
                u = _value(other, key) - _value(one, key)
                gaps.append(abs(_cubic(one, "{}", u) - _value(other, "a")))
    return float(np.max(gaps))


def _end(geometry: Element) -> list[float]:
    """s, x and y at the end of a piece of a reference line."""
    length, heading = _value(geometry, "length"), _value(geometry, "hdg")
    poly = geometry[0]
    u, v = _cubic(poly, "{}U", length), _cubic(poly, "{}V", length)
    x = _value(geometry, "x") + np.cos(heading) * u - np.sin(heading) * v
    y = _value(geometry, "y") + np.sin(heading) * u + np.cos(heading) * v
    return [_value(geometry, "s") + length, x, y]


def _cubic(element: Element, key: str, at: float) -> float:
    return sum(_value(element, key.format(letter)) * at**power for power, letter in enumerate("abcd"))


def _value(element: Element, key: str) -> float:
    value = float(element.attrib[key])
    if not abs(value) <= MOST:
        raise ValueError(f"{key}: expected a number up to {MOST:g}, got {value}")
    return value


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
