"""The roads of our OpenDRIVE files, which have a section each, as tests/maps/standard.py reads them."""

import math
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from tests.maps.standard import Cubics, Road


class FileRoad(Road):
    """A road of one section; places on it by a station and t, or by many."""

    def __init__(self, element: Element) -> None:
        super().__init__(element)
        self.id = element.get("id")
        self.by_number = {int(lane.attrib["id"]): lane for lane in element.iter("lane")}
        self.widths = {n: Cubics(lane.findall("width"), "sOffset") for n, lane in self.by_number.items()}

    def sides(self, lane, s):
        """t of the inner and outer edge of a lane; lane 0 has none but the line that laneOffset moves."""
        s = np.asarray(s, dtype=float)
        inner = outer = self.offset.at(s)
        step = int(np.sign(lane))
        for other in range(step, lane + step, step) if lane else ():
            inner, outer = outer, outer + step * self.widths[other].at(s)
        return inner, outer

    def center(self, lane, s):
        """The middle of a lane."""
        return self.point(s, np.mean(self.sides(lane, s), axis=0))

    def point(self, s, t, h=None):
        """The place of the road's surface at (s, t), or at a height over its plane."""
        s, t = np.broadcast_arrays(np.asarray(s, dtype=float), np.asarray(t, dtype=float))
        h = None if h is None else np.full(s.size, h)
        return self.points(s.ravel(), t.ravel(), np.zeros(s.size), math.inf, h).reshape(*s.shape, 3)


def read_roads(text):
    """The roads of a file by their names."""
    return {str(road.get("name")): FileRoad(road) for road in ElementTree.fromstring(text).iter("road")}
