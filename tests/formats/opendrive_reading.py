"""Read OpenDRIVE as ASAM OpenDRIVE 1.7 states it, on a file's own numbers: where the lanes of its roads are.

- 7.3.4 / 7.3.5 paramPoly3: u, v are cubics of p in the frame at (x, y) turned by hdg; p runs evenly from 0 to 1
  (normalized) or to the length (arcLength).
- 8.4 elevation and 8.5 superelevation: cubics of ds from the last entry at or before s; superelevation is the roll of
  the plane about the reference line, positive with the left side higher. s is measured on the xy plane, t on the rolled
  plane, to the left.
- 8.5.2 shape: heights over this plane, cubics of dt from the last entry at or left of t, linear between stations s.
- 9.3, 9.5 lanes: widths add up from lane 0, which laneOffset moves; left lanes have positive numbers.
"""

from collections.abc import Iterable
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.opendrive.described import USER_DATA, Element
from synth3dlanes.formats.reading import MAX_NUMBER
from synth3dlanes.system.arrays import AnyScalars
from synth3dlanes.system.errors import FormatError

PROFILES = ("elevation", "superelevation", "laneOffset")
AT_M = 1e-9


class FileRoad:
    """A road of a file, and the places on it. Raises ValueError, KeyError or IndexError where it is none."""

    def __init__(self, element: Element) -> None:
        self.element, self.id, self.length = element, element.get("id"), number(element, "length")
        self.lanes = {int(lane.attrib["id"]): lane for lane in element.iter("lane")}
        self.profiles = {tag: _Cubics(element.iter(tag), "s", "abcd") for tag in PROFILES}
        self.widths = {n: _Cubics(lane.iter("width"), "sOffset", "abcd") for n, lane in self.lanes.items()}
        geometries = list(element.iter("geometry"))
        self.geometries = np.array([[number(e, key) for key in ("s", "x", "y", "hdg")] for e in geometries])
        polys = [next(e.iter("paramPoly3")) for e in geometries]
        ranges = {"normalized": 0.0, "arcLength": 1.0}
        lengths = [
            number(e, "length") ** ranges[poly.attrib["pRange"]] for e, poly in zip(geometries, polys, strict=True)
        ]
        self.rates = np.array(lengths) / [number(e, "length") for e in geometries]
        self.polys = np.array([[[number(e, f"{a}{axis}") for a in "abcd"] for axis in "UV"] for e in polys])
        self.shapes: dict[float, list[Element]] = {}
        for shape in element.iter("shape"):
            self.shapes.setdefault(number(shape, "s"), []).append(shape)

    def segment(self, lane: int) -> str | None:
        """The segment of our lane graph that a lane is."""
        return next((d.get("value") for d in self.lanes[lane].iter("userData") if d.get("code") == USER_DATA), None)

    def line(self, s: AnyScalars | float) -> tuple[AnyScalars, AnyScalars, AnyScalars]:
        """x, y and heading of the reference line."""
        i = np.clip(np.searchsorted(self.geometries[:, 0], np.asarray(s) + AT_M, side="right") - 1, 0, None)
        start, x, y, heading = np.moveaxis(self.geometries[i], -1, 0)
        p = ((np.asarray(s) - start) * self.rates[i])[..., None]
        powers = np.concatenate([np.ones_like(p), p, p**2, p**3], axis=-1)
        slopes = np.concatenate([np.zeros_like(p), np.ones_like(p), 2 * p, 3 * p**2], axis=-1)
        u, v = np.moveaxis((self.polys[i] * powers[..., None, :]).sum(axis=-1), -1, 0)
        du, dv = np.moveaxis((self.polys[i] * slopes[..., None, :]).sum(axis=-1), -1, 0)
        cos, sin = np.cos(heading), np.sin(heading)
        x, y = x + cos * u - sin * v, y + sin * u + cos * v
        return np.asarray(x), np.asarray(y), np.asarray(heading + np.arctan2(dv, du))

    def cubic(self, tag: str, s: AnyScalars | float, slope: bool = False) -> AnyScalars:
        """A profile along the road."""
        return self.profiles[tag].at(s, slope)

    def shape(self, s: AnyScalars | float, t: AnyScalars | float) -> AnyScalars:
        """Height over the banked plane."""
        s, t = np.broadcast_arrays(np.asarray(s, dtype=float), np.asarray(t, dtype=float))
        heights = np.zeros(s.shape)
        if not self.shapes:
            return heights
        stations = np.array(sorted(self.shapes))
        after = np.clip(np.searchsorted(stations, s + AT_M, side="right"), 0, len(stations) - 1)
        before = np.where(stations[after] > s + AT_M, np.maximum(after - 1, 0), after)
        for a, b in {*zip(before.ravel().tolist(), after.ravel().tolist(), strict=True)}:
            here = (before == a) & (after == b)
            low, high = (_Cubics(self.shapes[stations[i]], "t", "abcd").at(t[here]) for i in (a, b))
            share = 0.0 if a == b else (s[here] - stations[a]) / (stations[b] - stations[a])
            heights[here] = low + np.clip(share, 0, 1) * (high - low)
        return heights

    def missing(self, lane: int) -> list[int]:
        """Lanes that should lie between a lane and the reference line, and do not."""
        step = 1 if lane > 0 else -1
        return [other for other in range(step, lane, step) if other not in self.widths]

    def edges(self, lane: int, s: AnyScalars | float) -> tuple[AnyScalars, AnyScalars]:
        """t of the inner and outer edge of a lane."""
        inner = outer = self.cubic("laneOffset", s)
        step = int(np.sign(lane))
        for other in range(step, lane + step, step):
            inner, outer = outer, np.asarray(outer + step * self.widths[other].at(s))
        return inner, outer

    def center(self, lane: int, s: AnyScalars | float) -> Float[np.ndarray, "*n 3"]:
        """The middle of a lane."""
        return self.point(s, np.mean(self.edges(lane, s), axis=0))

    def point(self, s: AnyScalars | float, t: AnyScalars | float) -> Float[np.ndarray, "*n 3"]:
        """The place of the road's surface at (s, t)."""
        return self.on_plane(s, t, self.shape(s, t))

    def on_plane(
        self, s: AnyScalars | float, t: AnyScalars | float, h: AnyScalars | float
    ) -> Float[np.ndarray, "*n 3"]:
        """The place at a height over the banked plane. Its axes are those of the road after heading, pitch (up along
        the road) and roll (about the pitched s axis)."""
        x, y, heading = self.line(s)
        pitch, roll = np.arctan(self.cubic("elevation", s, slope=True)), self.cubic("superelevation", s)
        left, up = t * np.cos(roll) - h * np.sin(roll), t * np.sin(roll) + h * np.cos(roll)
        along = -np.sin(pitch) * up
        cos, sin = np.cos(heading), np.sin(heading)
        z = self.cubic("elevation", s) + np.cos(pitch) * up
        return np.stack(np.broadcast_arrays(x + cos * along - sin * left, y + sin * along + cos * left, z), axis=-1)


def read_roads(text: str, where: str) -> dict[str, FileRoad]:
    """The roads of a file by their names; FormatErrors begin with `where`."""
    root = read_xml(text, where)
    try:
        return {str(road.get("name")): FileRoad(road) for road in root.iter("road")}
    except (KeyError, ValueError, IndexError, OverflowError, StopIteration):
        raise FormatError(f"{where}: expected roads with a reference line of numbers, got others") from None


def read_xml(text: str, where: str) -> Element:
    """The document of a file; FormatErrors begin with `where`."""
    if "<!" in text:  # document types define entities, which may be huge
        raise FormatError(f"{where}: expected a map without a document type or comments, got one")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise FormatError(f"{where}: expected a map, got {error}") from None


def number(element: Element, key: str) -> float:
    """An attribute that is a number; raises KeyError or ValueError."""
    value = float(element.attrib[key])
    if not abs(value) <= MAX_NUMBER:
        raise ValueError(f"{key}: expected a number up to {MAX_NUMBER:g}, got {value}")
    return value


class _Cubics:
    """Cubic pieces: that of the last entry at or before a place holds, the first one's before that; 0 without any."""

    def __init__(self, elements: Iterable[Element], key: str, letters: str) -> None:
        rows = [[number(e, name) for name in (key, *letters)] for e in elements]
        self.rows = np.array(rows).reshape(-1, 1 + len(letters))

    def at(self, places: AnyScalars | float, slope: bool = False) -> AnyScalars:
        """Values, or slopes."""
        places = np.asarray(places, dtype=float)
        if not len(self.rows):
            return np.zeros(places.shape)
        i = np.clip(np.searchsorted(self.rows[:, 0], places + AT_M, side="right") - 1, 0, None)
        start, a, b, c, d = np.moveaxis(self.rows[i], -1, 0)
        u = places - start
        return np.asarray(b + 2 * c * u + 3 * d * u * u if slope else a + u * (b + u * (c + u * d)))
