"""Areas on the ground from above, as polygons: what junctions, islands and walkways cover. World frame, metres."""

import numpy as np
import shapely
from jaxtyping import Bool
from shapely.geometry.base import BaseGeometry

from synth3dlanes.arrays import AnyPoints2, AnyScalars, Points2

# Smaller holes are filled.
LEAST_HOLE_M2 = 150.0
# Smaller parts of an area, and smaller polygons, are slivers and left out.
SLIVER_M2, LEAST_AREA_M2 = 0.01, 0.02


def signed_distance(area: BaseGeometry, xy_world: AnyPoints2) -> AnyScalars:
    """Distance of points from an area, negative in it."""
    flat = shapely.points(xy_world.reshape(-1, 2))
    inside = shapely.contains_properly(area, flat)
    distance = np.where(inside, -shapely.distance(shapely.boundary(area), flat), shapely.distance(area, flat))
    return np.asarray(distance.reshape(xy_world.shape[:-1]))


def contains(area: BaseGeometry, xy_world: Points2) -> Bool[np.ndarray, " n"]:
    """Which points an area contains; those out of its bounds are left out before GEOS is asked."""
    (x, y), (x0, y0, x1, y1) = xy_world.T, shapely.bounds(area)
    found = np.asarray((x > x0) & (x < x1) & (y > y0) & (y < y1))
    found[found] = shapely.contains_xy(area, x[found], y[found])
    return found


def solid(area: BaseGeometry) -> BaseGeometry:
    """The polygons of an area, without slivers."""
    parts = shapely.get_parts(shapely.make_valid(area))
    polygons = [part for part in parts if shapely.get_dimensions(part) == 2 and shapely.area(part) > LEAST_AREA_M2]
    return shapely.MultiPolygon([at for part in polygons for at in shapely.get_parts(part)])


def polygon_between(left: Points2, right: Points2) -> BaseGeometry:
    """The polygon between two lines; of a road that folds, what it covers."""
    ring = np.concatenate([left, right[::-1]])
    polygon = shapely.Polygon(ring)
    if polygon.is_valid:
        return polygon
    quads = shapely.polygons(np.stack([left[:-1], right[:-1], right[1:], left[1:]], axis=1))
    return shapely.union_all(shapely.make_valid(quads))


def clipped(area: BaseGeometry, box: tuple[float, float, float, float]) -> BaseGeometry:
    """What of an area is within (x0, y0, x1, y1)."""
    try:
        return shapely.clip_by_rect(area, *box)
    except shapely.errors.GEOSException:
        # The fast way refuses parts that only touch the box.
        return shapely.intersection(area, shapely.box(*box))


def polygons_of(area: BaseGeometry) -> list[shapely.Polygon]:
    """The polygons that an area consists of, without slivers."""
    return [part for part in shapely.get_parts(area) if isinstance(part, shapely.Polygon) and part.area > SLIVER_M2]


def filled(area: BaseGeometry) -> BaseGeometry:
    """An area without its small holes."""
    parts = [
        shapely.Polygon(part.exterior, [hole for hole in part.interiors if shapely.Polygon(hole).area > LEAST_HOLE_M2])
        for part in shapely.get_parts(area)
        if isinstance(part, shapely.Polygon)
    ]
    return shapely.union_all(parts)
