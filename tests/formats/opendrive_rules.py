"""OpenDRIVE's rules as ASAM OpenDRIVE 1.7 states them, on a file's own numbers: where the lanes of its roads are.

- 7.3.4 / 7.3.5 paramPoly3: u, v are cubics of p in the frame at (x, y) turned by hdg; p runs from 0 to length.
- 8.4 elevation and 8.5 superelevation: cubics of ds from the last entry at or before s; superelevation is the roll of
  the plane about the reference line, positive with the left side higher. s is measured on the xy plane, t on the rolled
  plane, to the left.
- 8.5.2 shape: heights over this plane, cubics of dt from the last entry at or left of t, linear between stations s.
- 9.3, 9.5 lanes: widths add up from lane 0, which laneOffset moves; left lanes have positive numbers.
"""

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np


@dataclass
class FileRoad:
    """A road of a file and the places on it."""

    element: ElementTree.Element

    @property
    def id(self):
        return self.element.get("id")

    @property
    def length(self):
        return float(self.element.get("length"))

    def line(self, s):
        """x, y and heading of the reference line."""
        geometry = [e for e in self.element.iter("geometry") if float(e.get("s")) <= s + 1e-9][-1]
        x, y, heading = (float(geometry.get(key)) for key in ("x", "y", "hdg"))
        poly = geometry.find("paramPoly3")
        assert poly.get("pRange") == "arcLength"
        p = s - float(geometry.get("s"))
        assert p <= float(geometry.get("length")) + 1e-6
        u, v, du, dv = 0.0, 0.0, 0.0, 0.0
        for power, letter in enumerate("abcd"):
            u += float(poly.get(f"{letter}U")) * p**power
            v += float(poly.get(f"{letter}V")) * p**power
            if power:
                du += power * float(poly.get(f"{letter}U")) * p ** (power - 1)
                dv += power * float(poly.get(f"{letter}V")) * p ** (power - 1)
        cos, sin = np.cos(heading), np.sin(heading)
        return x + cos * u - sin * v, y + sin * u + cos * v, heading + np.arctan2(dv, du)

    def cubic(self, tag, s, slope=False):
        return last_cubic(list(self.element.iter(tag)), "s", s, slope)

    def shape(self, s, t):
        stations = sorted({float(e.get("s")) for e in self.element.iter("shape")})
        if not stations:
            return 0.0
        before = max([at for at in stations if at <= s + 1e-9], default=stations[0])
        after = min([at for at in stations if at > s + 1e-9], default=before)
        heights = []
        for at in (before, after):
            entries = sorted(
                (e for e in self.element.iter("shape") if float(e.get("s")) == at), key=lambda e: float(e.get("t"))
            )
            heights.append(last_cubic(entries, "t", t))
        share = 0.0 if after == before else (s - before) / (after - before)
        return heights[0] + share * (heights[1] - heights[0])

    @property
    def lanes(self):
        return {int(lane.get("id")): lane for lane in self.element.iter("lane")}

    def edges(self, number, s):
        """t of the inner and outer edge of a lane."""
        inner = outer = self.cubic("laneOffset", s)
        step = int(np.sign(number))
        for other in range(step, number + step, step):
            width = last_cubic(self.lanes[other].findall("width"), "sOffset", s)
            assert width > -1e-3
            inner, outer = outer, outer + step * width
        return inner, outer

    def point(self, s, t):
        x, y, heading = self.line(s)
        pitch, roll = np.arctan(self.cubic("elevation", s, slope=True)), self.cubic("superelevation", s)
        # Axes of the road after heading, pitch (up along the road) and roll (about the pitched s axis).
        turn = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
        climb = np.array([[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]])
        bank = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        return np.array([x, y, self.cubic("elevation", s)]) + turn @ climb @ bank @ [0, t, self.shape(s, t)]

    def center(self, number, s):
        return self.point(s, float(np.mean(self.edges(number, s))))


def last_cubic(entries, key, at, slope=False):
    """The cubic of the last entry at or before a place."""
    if not entries:
        return 0.0
    entry = [e for e in entries if float(e.get(key)) <= at + 1e-9][-1]
    a, b, c, d = (float(entry.get(letter)) for letter in "abcd")
    u = at - float(entry.get(key))
    return b + 2 * c * u + 3 * d * u * u if slope else a + u * (b + u * (c + u * d))


def read_roads(text):
    return {road.get("name"): FileRoad(road) for road in ElementTree.fromstring(text).iter("road")}
