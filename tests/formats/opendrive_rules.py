"""OpenDRIVE's rules as ASAM OpenDRIVE 1.7 states them, on a file's own numbers: where the lanes of its roads are.

- 7.3.4 / 7.3.5 paramPoly3: u, v are cubics of p in the frame at (x, y) turned by hdg; p runs from 0 to length.
- 8.4 elevation and 8.5 superelevation: cubics of ds from the last entry at or before s; superelevation is the roll of
  the plane about the reference line, positive with the left side higher. s is measured on the xy plane, t on the rolled
  plane, to the left.
- 8.5.2 shape: heights over this plane, cubics of dt from the last entry at or left of t, linear between stations s.
- 9.3, 9.5 lanes: widths add up from lane 0, which laneOffset moves; left lanes have positive numbers.
"""

from xml.etree import ElementTree

import numpy as np


class FileRoad:
    """A road of a file and the places on it."""

    def __init__(self, element):
        self.element = element
        self.id, self.length = element.get("id"), float(element.get("length"))
        self.lanes = {int(lane.get("id")): lane for lane in element.iter("lane")}
        self.tables = {tag: table(element.iter(tag)) for tag in ("elevation", "superelevation", "laneOffset", "shape")}
        self.widths = {number: table(lane.iter("width")) for number, lane in self.lanes.items()}
        self.geometries = [(e, table([e]), table(e.iter("paramPoly3"))) for e in element.iter("geometry")]

    def line(self, s):
        """x, y and heading of the reference line."""
        element, (own,), (poly,) = [entry for entry in self.geometries if entry[1][0]["s"] <= s + 1e-9][-1]
        assert element[0].get("pRange") == "arcLength"
        p = s - own["s"]
        assert p <= own["length"] + 1e-6
        u, v = (sum(poly[letter + axis] * p**n for n, letter in enumerate("abcd")) for axis in "UV")
        du, dv = (sum(n * poly[letter + axis] * p ** (n - 1) for n, letter in enumerate("bcd", 1)) for axis in "UV")
        cos, sin = np.cos(own["hdg"]), np.sin(own["hdg"])
        return own["x"] + cos * u - sin * v, own["y"] + sin * u + cos * v, own["hdg"] + np.arctan2(dv, du)

    def cubic(self, tag, s, slope=False):
        return last_cubic(self.tables[tag], "s", s, slope)

    def shape(self, s, t):
        stations = sorted({entry["s"] for entry in self.tables["shape"]})
        if not stations:
            return 0.0
        before = max([at for at in stations if at <= s + 1e-9], default=stations[0])
        after = min([at for at in stations if at > s + 1e-9], default=before)
        heights = [
            last_cubic([entry for entry in self.tables["shape"] if entry["s"] == at], "t", t) for at in (before, after)
        ]
        share = 0.0 if after == before else (s - before) / (after - before)
        return heights[0] + share * (heights[1] - heights[0])

    def edges(self, number, s):
        """t of the inner and outer edge of a lane."""
        inner = outer = self.cubic("laneOffset", s)
        step = int(np.sign(number))
        for other in range(step, number + step, step):
            width = last_cubic(self.widths[other], "sOffset", s)
            assert width > -1e-3
            inner, outer = outer, outer + step * width
        return inner, outer

    def point(self, s, t):
        """The point of the road's surface at (s, t)."""
        return self.on_plane(s, t, self.shape(s, t))

    def on_plane(self, s, t, h):
        x, y, heading = self.line(s)
        pitch, roll = np.arctan(self.cubic("elevation", s, slope=True)), self.cubic("superelevation", s)
        # Axes of the road after heading, pitch (up along the road) and roll (about the pitched s axis).
        turn = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
        climb = np.array([[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]])
        bank = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        return np.array([x, y, self.cubic("elevation", s)]) + turn @ climb @ bank @ [0, t, h]

    def center(self, number, s):
        return self.point(s, float(np.mean(self.edges(number, s))))


def table(elements):
    """The numbers of elements."""
    return [{key: float(value) for key, value in e.items() if key != "pRange"} for e in elements]


def last_cubic(entries, key, at, slope=False):
    """The cubic of the last entry at or before a place, the first one's before that."""
    if not entries:
        return 0.0
    entry = ([e for e in entries if e[key] <= at + 1e-9] or entries)[-1 if entries[0][key] <= at + 1e-9 else 0]
    a, b, c, d = (entry[letter] for letter in "abcd")
    u = at - entry[key]
    return b + 2 * c * u + 3 * d * u * u if slope else a + u * (b + u * (c + u * d))


def read_roads(text):
    return {road.get("name"): FileRoad(road) for road in ElementTree.fromstring(text).iter("road")}
