"""Where a road of a map passes below another. World frame, metres."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from synth3dlanes.geometry.areas import intersection
from synth3dlanes.geometry.section_road import SectionRoad

# A road so far above another passes over it, on a deck of this thickness; roads are looked at in such steps first.
PASSAGE_M, DECK_M, STEP_M = 3.0, 0.5, 20.0
LEAST_M2 = 0.02


class Passage(NamedTuple):
    """The area from above where a road passes below another, and that road."""

    area: BaseGeometry
    lower: SectionRoad


def passages(roads: Sequence[SectionRoad], strip: Callable[[SectionRoad], BaseGeometry]) -> list[Passage]:
    """The passages of roads with heights, whose pavements from above `strip` tells."""
    outlines, low, high = [], [], []
    for road in roads:
        s = np.linspace(0.0, road.end_m, 2 + int(road.end_m / STEP_M))
        z = road.base_points(s, np.zeros(len(s)))[:, 2]
        low.append(z.min())
        high.append(z.max())
        ring = np.concatenate([road.xy(s, road.left(s)), road.xy(s, road.right(s))[::-1]])
        outlines.append(shapely.convex_hull(shapely.Polygon(ring)))
    found = list[Passage]()
    pairs = shapely.STRtree(outlines).query(outlines, predicate="intersects").T.tolist() if outlines else []
    for i, j in pairs:
        if i == j or high[j] - low[i] < PASSAGE_M:
            continue
        area = intersection(strip(roads[i]), strip(roads[j]))
        if area.area < LEAST_M2:
            continue
        middle = shapely.get_coordinates(shapely.point_on_surface(area))
        below, above = (road.base_points(*road.line.project(middle))[0, 2] for road in (roads[i], roads[j]))
        if above - below > PASSAGE_M:
            shapely.prepare(area)
            found.append(Passage(area, roads[i]))
    return found
