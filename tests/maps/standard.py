"""Where the lanes of an OpenDRIVE file are, as the standard states it, from the file's own text; nothing of the package
is used.

- A value along a road (laneOffset, width, elevation, superelevation) is the cubic of the last entry at or before a
  station, measured from that entry; at the end of a section it is what held up to there.
- The reference line is that of the geometry at a station: line, arc, spiral, poly3, paramPoly3. Stations are lengths.
- The road's axes there are turned by heading, pitch (the slope of the elevation) and roll (superelevation, left side
  up). t is measured on that plane to the left, shapes are heights over it, linear between their stations.
- Lanes lie beside each other from lane 0, which laneOffset moves. A border is the t of an outer edge. A lane that is
  level is horizontal across, at the height of its inner edge; its width is horizontal.
"""

import gzip
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from scipy.special import fresnel

# Entries this near to a station begin there; files round them.
SAME_M = 1e-3
STEP_M = 0.1
RAISED, KERB_M = ("sidewalk", "walking", "curb"), 0.12


def number(element: Element, key: str, default: float = 0.0) -> float:
    """An attribute; the default if it is none or no number."""
    try:
        return float(element.get(key, ""))
    except ValueError:
        return default


class Cubics:
    """A value by entries with a, b, c and d; 0 without any."""

    def __init__(self, elements: list[Element], key: str = "s") -> None:
        rows = {number(at, key): [number(at, name) for name in "abcd"] for at in elements}
        self.starts = np.array(sorted(rows))
        self.abcd = np.array([rows[start] for start in sorted(rows)]).reshape(-1, 4)

    def at(self, s: np.ndarray, before_m: float = math.inf) -> np.ndarray:
        """Values at stations; entries that begin at `before_m` do not count."""
        return self._terms(s, before_m, lambda x, a, b, c, d: a + b * x + c * x**2 + d * x**3)

    def slope(self, s: np.ndarray, before_m: float = math.inf) -> np.ndarray:
        """Slopes at stations."""
        return self._terms(s, before_m, lambda x, a, b, c, d: b + 2 * c * x + 3 * d * x**2 + 0 * a)

    def _terms(self, s, before_m, term) -> np.ndarray:
        if not len(self.starts):
            return np.zeros(s.shape)
        counted = max(int((self.starts < before_m - SAME_M).sum()), 1)
        i = np.clip(np.searchsorted(self.starts[:counted], s + SAME_M, side="right") - 1, 0, None)
        return term(s - self.starts[i], *self.abcd[i].T)


def along(geometry: Element, s: np.ndarray) -> np.ndarray:
    """x, y and heading of a piece of geometry at lengths from its start."""
    length = number(geometry, "length")
    form = next(at for at in geometry if at.tag in ("line", "arc", "spiral", "poly3", "paramPoly3"))
    if form.tag in ("line", "arc", "spiral"):
        first, last = (number(form, key, number(form, "curvature")) for key in ("curvStart", "curvEnd"))
        u, v, turn = _clothoid(first, (last - first) / length if length else 0.0, s)
    else:
        x, y, p, lengths = _curve(form, length)
        # A graph ends where its length does; a curve whose stated length is not its own is stretched.
        at = np.interp(s if form.tag == "poly3" else s * lengths[-1] / length, lengths, p)
        u, v = (np.polynomial.polynomial.polyval(at, c) for c in (x, y))
        du, dv = (np.polynomial.polynomial.polyval(at, np.polynomial.polynomial.polyder(c)) for c in (x, y))
        turn = np.arctan2(dv, du)
    heading = number(geometry, "hdg")
    cos, sin = math.cos(heading), math.sin(heading)
    places = number(geometry, "x") + cos * u - sin * v, number(geometry, "y") + sin * u + cos * v, heading + turn
    return np.stack(places, axis=-1)


@cache
def _curve(form: Element, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The coefficients of a cubic curve, and its lengths at many values of its parameter."""
    if form.tag == "poly3":
        x, y, end = np.array([0.0, 1, 0, 0]), np.array([number(form, key) for key in "abcd"]), length
    else:
        x, y = (np.array([number(form, letter + axis) for letter in "abcd"]) for axis in "UV")
        end = length if form.get("pRange") == "arcLength" else 1.0
    p = np.linspace(0, end, 20_001)
    u, v = (np.polynomial.polynomial.polyval(p, c) for c in (x, y))
    return x, y, p, np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(u), np.diff(v)))])


def _clothoid(first: float, bend: float, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """u, v and heading of a curve whose curvature begins with `first` and grows by `bend` a metre: Fresnel's integrals
    of the curve from where its curvature is 0."""
    turn = first * s + bend * s**2 / 2
    if abs(bend) < 1e-12:
        x = first * s
        flat = abs(first) < 1e-12
        return (s, 0 * s, turn) if flat else (np.sin(x) / first, (1 - np.cos(x)) / first, turn)
    scale, from_zero = math.sqrt(math.pi / abs(bend)), first / bend
    (v1, u1), (v0, u0) = (fresnel((from_zero + x) / scale) for x in (s, 0.0))
    # The curve from its inflection on, turned to where it has the heading 0.
    du, dv = scale * (u1 - u0), math.copysign(1.0, bend) * scale * (v1 - v0)
    back = -bend * from_zero**2 / 2
    return math.cos(back) * du - math.sin(back) * dv, math.sin(back) * du + math.cos(back) * dv, turn


@dataclass
class Edge:
    """The outer edge of a lane (of lane 0: of both sides) and the middle of the lane: points along a section."""

    number: int
    kind: str
    edge: np.ndarray
    middle: np.ndarray
    is_raised: bool


class Road:
    """A road of a file."""

    def __init__(self, element: Element) -> None:
        self.element = element
        found = [at for at in element.iterfind("planView/geometry") if number(at, "length") > 1e-6]
        self.geometries = sorted(found, key=lambda at: number(at, "s"))
        self.starts = np.cumsum([0.0, *(number(at, "length") for at in self.geometries)])
        self.length_m = float(self.starts[-1])
        self.offset = Cubics(element.findall("lanes/laneOffset"))
        self.elevation = Cubics(element.findall("elevationProfile/elevation"))
        self.roll = Cubics(element.findall("lateralProfile/superelevation"))
        self.sections = sorted(element.findall("lanes/laneSection"), key=lambda at: number(at, "s"))

    @cached_property
    def shapes(self) -> dict[float, Cubics]:
        """Heights over the plane by t, by stations."""
        by_station: dict[float, list[Element]] = {}
        for at in self.element.iterfind("lateralProfile/shape"):
            by_station.setdefault(number(at, "s"), []).append(at)
        return {s: Cubics(found, "t") for s, found in sorted(by_station.items())}

    def shape(self, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Heights over the plane at places."""
        if not self.shapes:
            return np.zeros(s.shape)
        stations = list(self.shapes)
        rows = np.array([self.shapes[at].at(t) for at in stations])
        return np.array([np.interp(here, stations, rows[:, i]) for i, here in enumerate(s.tolist())])

    def line(self, s: np.ndarray, before_m: float) -> np.ndarray:
        """x, y and heading of the reference line; geometry that begins at `before_m` does not count."""
        counted = max(int((self.starts[:-1] < before_m - SAME_M).sum()), 1)
        which = np.clip(np.searchsorted(self.starts[:counted], s + SAME_M, side="right") - 1, 0, None)
        found = np.zeros((len(s), 3))
        for i in np.unique(which):
            found[which == i] = along(self.geometries[i], s[which == i] - self.starts[i])
        return found

    def points(
        self, s: np.ndarray, t: np.ndarray, level_m: np.ndarray, before_m: float, h: np.ndarray | None = None
    ) -> np.ndarray:
        """Places of the surface, or `h` over the road's plane: t on the plane, then `level_m` to the left, level."""
        x, y, heading = self.line(s, before_m).T
        pitch, roll = np.arctan(self.elevation.slope(s, before_m)), self.roll.at(s, before_m)
        h = self.shape(s, t) if h is None else h
        left, up = t * np.cos(roll) - h * np.sin(roll) + level_m, t * np.sin(roll) + h * np.cos(roll)
        ahead = -np.sin(pitch) * up
        cos, sin = np.cos(heading), np.sin(heading)
        z = self.elevation.at(s, before_m) + np.cos(pitch) * up
        return np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left, z], axis=-1)

    def section_at(self, s_m: float) -> int:
        """The number of the section at a station."""
        return max(sum(number(at, "s") <= s_m for at in self.sections) - 1, 0)

    def lanes(self, section: int, side: str) -> list[Element]:
        """The lanes of a section on a side, from inside. A section for one side leaves the other as it was."""
        found = self.sections[section].findall(f"{side}/lane")
        if not found and section and self.sections[section].get("singleSide") == "true":
            return self.lanes(section - 1, side)
        return sorted(found, key=lambda at: abs(number(at, "id")))

    def begins(self, section: int, side: str) -> float:
        """Where the section begins whose lanes are those of a side."""
        found = self.sections[section].findall(f"{side}/lane")
        if not found and section and self.sections[section].get("singleSide") == "true":
            return self.begins(section - 1, side)
        return number(self.sections[section], "s") if section else 0.0

    def edges(self, start_m: float, end_m: float) -> Iterator[Edge]:
        """The lanes between two stations that are in one section, as lines from one to the other."""
        steps = np.linspace(start_m, end_m, 2 + int((end_m - start_m) / STEP_M))
        turns = self.starts[(self.starts > start_m + 2 * SAME_M) & (self.starts < end_m)]
        s = np.unique(np.concatenate([steps, turns, turns - 1.5 * SAME_M]))
        section = self.section_at((start_m + end_m) / 2)
        offset, none = self.offset.at(s, end_m), np.zeros(len(s))
        middle = self.points(s, offset, none, end_m)
        yield Edge(0, "none", middle, middle, False)
        for side, sign in (("left", 1), ("right", -1)):
            t, level_m, kind = offset, none, ""
            lanes = self.lanes(section, side)
            begin_m = self.begins(section, side)
            is_tilted = bool(np.abs(self.roll.abcd).any() or self.shapes)
            for lane, beyond in pairwise([*lanes, None]):
                widths, borders = lane.findall("width"), lane.findall("border")
                cubics = Cubics(widths or borders, "sOffset")
                width = np.maximum(cubics.at(s - begin_m, end_m - begin_m), 0.0) if widths else none
                if borders and not widths:
                    edge = sign * (cubics.at(s - begin_m, end_m - begin_m) + offset) - sign * t
                    width = np.maximum(edge, 0.0)
                step = sign * width
                is_level = is_tilted and lane.get("level") in ("true", "1")
                half = (none, step / 2) if is_level else (step / 2, none)
                middle = self.points(s, t + half[0], level_m + half[1], end_m)
                t, level_m = t + 2 * half[0], level_m + 2 * half[1]
                kind = lane.get("type", "none")
                is_raised = kind in RAISED and beyond is not None and beyond.get("type") in RAISED
                edge = self.points(s, t, level_m, end_m)
                yield Edge(int(number(lane, "id")), kind, edge, middle, is_raised)


def read(data: bytes) -> dict[str, Road]:
    """The roads of a file by their ids."""
    if data[:2] == b"\x1f\x8b":
        data = gzip.decompress(data)
    root = ElementTree.fromstring(data)
    for at in root.iter():
        at.tag = at.tag.rpartition("}")[2]
    return {road.get("id", ""): Road(road) for road in root.iter("road")}
