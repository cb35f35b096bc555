"""Areas on the ground from above, as polygons: what junctions, islands and walkways cover. World frame, metres.

Every area consists of valid polygons alone, and no overlay of areas fails: what GEOS cannot do exactly is done on a
grid.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool
from shapely.geometry.base import BaseGeometry

from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Points2

# Grids for the corners of what cannot be done exactly, the finest first.
GRIDS_M = (1e-4, 1e-3, 1e-2)
# Smaller holes are filled.
LEAST_HOLE_M2 = 150.0
# Smaller parts of an area, and smaller polygons, are slivers and left out.
SLIVER_M2, LEAST_AREA_M2 = 0.01, 0.02
NOTHING = shapely.MultiPolygon()


def valid(area: BaseGeometry) -> BaseGeometry:
    """The polygons of what may cross itself."""
    if shapely.is_valid(area):
        return _polygons_alone(area)
    # Rounded to a grid as it is, a quad whose sides cross near a corner would vanish.
    return _on_grids(shapely.set_precision, [shapely.make_valid(area)], NOTHING)


def ring_area(ring: Points2) -> BaseGeometry:
    """The area within a ring of points; nothing of one whose numbers are not finite."""
    return valid(shapely.Polygon(ring)) if len(ring) > 2 and np.isfinite(ring).all() else NOTHING


def union(areas: Iterable[BaseGeometry]) -> BaseGeometry:
    """What any of some areas covers."""
    return _overlay(_union, list(areas), NOTHING)


def difference(area: BaseGeometry, other: BaseGeometry) -> BaseGeometry:
    """What of an area another leaves."""
    return _overlay(shapely.difference, [area, other], area)


def intersection(area: BaseGeometry, other: BaseGeometry) -> BaseGeometry:
    """What two areas share."""
    return _overlay(shapely.intersection, [area, other], NOTHING)


def intersections(areas: np.ndarray, others: np.ndarray) -> np.ndarray:
    """What areas share with as many others, each with its own."""
    try:
        return np.array([*map(_polygons_alone, shapely.intersection(areas, others))], dtype=object)
    except shapely.errors.GEOSException:
        return np.array([*map(intersection, areas, others)], dtype=object)


def outset(area: BaseGeometry, by_m: float) -> BaseGeometry:
    """An area extended by a distance, or shrunk by a negative one."""
    return valid(shapely.buffer(area, by_m, join_style="mitre"))


def _union(*areas: BaseGeometry, grid_size: float | None) -> BaseGeometry:
    if grid_size is None:
        # GEOS need not look at pairs of areas that do not touch, but at times it loses areas that way.
        found, inside = (
            shapely.disjoint_subset_union_all(areas),
            shapely.point_on_surface(np.array(areas, dtype=object)),
        )
        if shapely.intersects_xy(found, *shapely.get_coordinates(inside).T).all():
            return found
    return shapely.union_all(areas, grid_size=grid_size)


def _overlay(
    operation: Callable[..., BaseGeometry], areas: Sequence[BaseGeometry], otherwise: BaseGeometry
) -> BaseGeometry:
    """The polygons of an overlay: exact, or else on a grid."""
    try:
        return _polygons_alone(operation(*areas, grid_size=None))
    except shapely.errors.GEOSException:
        return _on_grids(operation, areas, otherwise)


def _on_grids(
    operation: Callable[..., BaseGeometry], areas: Sequence[BaseGeometry], otherwise: BaseGeometry
) -> BaseGeometry:
    """The polygons of an operation on the finest grid that it can be done on."""
    for grid_m in GRIDS_M:
        try:
            on_grid = [_polygons_alone(shapely.make_valid(shapely.set_precision(area, grid_m))) for area in areas]
            return _polygons_alone(shapely.make_valid(operation(*on_grid, grid_size=grid_m)))
        except shapely.errors.GEOSException:
            continue
    return otherwise


def _polygons_alone(area: BaseGeometry) -> BaseGeometry:
    """An area without the lines and points that overlays leave where areas touch."""
    if isinstance(area, shapely.Polygon | shapely.MultiPolygon):
        return area
    parts = shapely.get_parts(area)
    nested = shapely.get_parts(parts)
    return shapely.MultiPolygon([part for part in nested if isinstance(part, shapely.Polygon)])


class Outlined(NamedTuple):
    """An area and a tree of the sides of its outline."""

    area: BaseGeometry
    sides: shapely.STRtree


def outlined(area: BaseGeometry) -> Outlined:
    """An area, to be asked for distances."""
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_parts(shapely.boundary(area))]
    sides = [np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings]
    return Outlined(area, shapely.STRtree(shapely.linestrings(np.concatenate(sides)) if sides else []))


def signed_distance(of: Outlined, xy_world: AnyPoints2) -> AnyScalars:
    """Distance of points from an area, negative in it; infinite from an empty one."""
    places = xy_world.reshape(-1, 2)
    flat, distance = shapely.points(places), np.full(len(places), np.inf)
    (at, _), found = of.sides.query_nearest(flat, return_distance=True, all_matches=False)
    distance[at] = found
    distance[shapely.contains_properly(of.area, flat)] *= -1
    return distance.reshape(xy_world.shape[:-1])


def contains(area: BaseGeometry, xy_world: Points2) -> Bool[np.ndarray, " n"]:
    """Which points an area contains; those out of its bounds are left out before GEOS is asked."""
    (x, y), (x0, y0, x1, y1) = xy_world.T, shapely.bounds(area)
    found = np.asarray((x > x0) & (x < x1) & (y > y0) & (y < y1))
    found[found] = shapely.contains_xy(area, x[found], y[found])
    return found


def solid(area: BaseGeometry) -> BaseGeometry:
    """The polygons of an area, without slivers."""
    parts = shapely.get_parts(valid(area))
    return shapely.MultiPolygon([part for part in parts if shapely.area(part) > LEAST_AREA_M2])


def polygon_between(left: Points2, right: Points2) -> BaseGeometry:
    """The polygon between two lines; of a road that folds, what it covers."""
    return polygons_between([(left, right)])[0]


def polygons_between(pairs: Sequence[tuple[Points2, Points2]]) -> list[BaseGeometry]:
    """The polygon between the two lines of each pair; of a road that folds, what it covers."""
    if not pairs:
        return []
    rings = [np.concatenate([left, right[::-1]]) for left, right in pairs]
    numbers = np.repeat(np.arange(len(rings)), list(map(len, rings)))
    found = list(shapely.polygons(shapely.linearrings(np.concatenate(rings), indices=numbers)))
    for i in np.flatnonzero(~shapely.is_valid(found)):
        left, right = pairs[i]
        quads = shapely.polygons(np.stack([left[:-1], right[:-1], right[1:], left[1:]], axis=1))
        found[i] = union(map(valid, quads))
    return found


def clipped(area: BaseGeometry, box: tuple[float, float, float, float]) -> BaseGeometry:
    """What of an area is within (x0, y0, x1, y1)."""
    with suppress(shapely.errors.GEOSException):
        found = shapely.clip_by_rect(area, *box)
        if found.is_valid:
            return found
    # The fast way refuses parts that only touch the box, and joins polygons that touch each other along a line.
    return intersection(area, shapely.box(*box))


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
    # Others may lie in the holes of one.
    return parts[0] if len(parts) == 1 else union(parts)
