"""Areas cut by the lines of a grid into faces that share their corners with those beside them. World frame, metres."""

from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry.base import BaseGeometry

from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.areas import GRIDS_M, clipped, contains, difference

# Columns of cells are cut out a little wider; lines of grids keep off corners of areas by hairs.
ASIDE_M, HAIR_M = 0.01, 1e-5

CellIndices = Int[np.ndarray, " _"]
PlanPlaces = Float[np.ndarray, "_ 2"]
# The corners of faces from above; a triangle has its last one twice.
PlanQuads = Float[np.ndarray, "_ 4 2"]


class CutCells(NamedTuple):
    """What an area covers of a grid: the columns and rows of the cells that are wholly in it, those of the cells that
    its border cuts, and the faces in these that are in the area, and outside, if they were asked for."""

    whole: Int[np.ndarray, "2 _"]
    cut: Int[np.ndarray, "2 _"]
    inside: PlanQuads
    outside: PlanQuads


def cut_cells(xs: Scalars, ys: Float[np.ndarray, " m"], area: BaseGeometry, outside: bool = True) -> CutCells:
    """The cells of a grid that an area covers, no corner of which is on a line of the grid (`beside`)."""
    n_columns, n_rows = len(xs) - 1, len(ys) - 1
    runs = _runs(xs, ys, area)
    column, row = runs.cell.T
    is_there = (column >= 0) & (column < n_columns) & (row >= 0) & (row < n_rows)
    number = np.where(is_there, row * n_columns + column, -1)
    cut, which, counts = np.unique(number, return_index=True, return_counts=True)
    cut, which, counts = (values[cut >= 0] for values in (cut, which, counts))
    is_one = (counts == 1) & runs.divides[which]
    plain, odd = which[is_one], cut[~is_one]
    cells, parts = _odd_parts(xs, ys, area, odd % n_columns, odd // n_columns)
    rest = [_faces(runs, plain, is_in=False), triangles_of(_differences(cells, parts))] if outside else []
    return CutCells(
        _whole(xs, ys, area, cut),
        np.stack([cut % n_columns, cut // n_columns]),
        np.concatenate([_faces(runs, plain, is_in=True), triangles_of(parts)]),
        np.concatenate([np.zeros((0, 4, 2)), *rest]),
    )


class _Runs(NamedTuple):
    """The border of an area, ring after ring with the area on the left: its corners and where it crosses lines of a
    grid. Between two crossings a run is in one cell, all points from `first` to `last`; `sides` are those of the cell
    where it begins and ends, 0 below, then on to the right of that. `n_left` is how many corners of the cell are on the
    left of the run, in the area. `divides` says that the run has a cell in two parts."""

    xy: PlanPlaces
    first: CellIndices
    last: CellIndices
    cell: Int[np.ndarray, "_ 2"]
    sides: Int[np.ndarray, "2 _"]
    n_left: CellIndices
    divides: Bool[np.ndarray, " _"]
    corners: Float[np.ndarray, "_ 4 2"]


def _runs(xs: Scalars, ys: Float[np.ndarray, " m"], area: BaseGeometry) -> _Runs:
    """The runs of the border of an area. A ring that crosses no line is a run that does not divide its cell."""
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(area)))
    places, ring = shapely.get_coordinates(rings, return_index=True)
    at = np.flatnonzero(ring[1:] == ring[:-1]) if len(ring) else np.zeros(0, dtype=int)
    start, end, ring = places[at], places[at + 1], ring[at]
    # Of each point: the line between corners that it is on, how far along that, where, and the line of the grid.
    found = [(np.arange(len(at)), np.full(len(at), -1.0), start, np.full((len(at), 2), -1))]
    for axis, lines in enumerate((xs, ys)):
        low, high = (
            np.searchsorted(lines, end_of([start[:, axis], end[:, axis]], axis=0)) for end_of in (np.min, np.max)
        )
        on = np.repeat(np.arange(len(at)), high - low)
        number = np.arange(len(on)) - np.repeat(np.cumsum(high - low) - high, high - low)
        share = (lines[number] - start[on, axis]) / (end[on, axis] - start[on, axis])
        xy = start[on] + share[:, None] * (end[on] - start[on])
        xy[:, axis] = lines[number]
        of = np.full((len(on), 2), -1)
        of[:, axis] = number
        found.append((on, share, xy, of))
    on, share, xy, line = (np.concatenate(values) for values in zip(*found, strict=True))
    order = np.lexsort((share, on))
    on, xy, line = on[order], xy[order], line[order]
    # Each ring begins with its first crossing, if it has any, and ends with that again.
    crosses, of_ring = line.max(axis=1) >= 0, ring[on]
    begin = np.flatnonzero(np.diff(of_ring, prepend=-1))
    counts = np.diff(np.append(begin, len(on)))
    places_in = np.arange(len(on)) - np.repeat(begin, counts)
    head = np.minimum.reduceat(np.where(crosses, places_in, len(on)), begin) if len(on) else begin
    head = np.where(head < len(on), head, 0)
    lengths = counts + 1
    step = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    taken = np.repeat(begin, lengths) + (np.repeat(head, lengths) + step) % np.repeat(counts, lengths)
    xy, line, is_end = xy[taken], line[taken], step == np.repeat(counts, lengths)
    crosses = (line.max(axis=1) >= 0) | (step == 0) | is_end
    first = np.flatnonzero(crosses & ~is_end)
    last = np.append(np.flatnonzero(crosses)[1:], 0)[np.searchsorted(np.flatnonzero(crosses), first)]
    middle = (xy[first] + xy[first + 1]) / 2
    cell = np.stack([np.searchsorted(lines, middle[:, i]) - 1 for i, lines in enumerate((xs, ys))], axis=1)
    # Left of a cell is the line with its number, below it too.
    low, high = (np.stack([line[ends] - cell - beyond for ends in (first, last)]) == 0 for beyond in (0, 1))
    is_on = np.stack([low[..., 1], high[..., 0], high[..., 1], low[..., 0]])
    sides = is_on.argmax(axis=0)
    corner = np.clip(cell[:, None] + [(0, 0), (1, 0), (1, 1), (0, 1)], 0, [len(xs) - 1, len(ys) - 1])
    corners = np.stack([xs[corner[..., 0]], ys[corner[..., 1]]], axis=-1)
    # One that returns to its side goes around all corners, or around none.
    along = [np.choose(side, [x, y, -x, -y]) for side, (x, y) in zip(sides, (xy[first].T, xy[last].T), strict=True)]
    n_left = np.where(sides[0] != sides[1], (sides[0] - sides[1]) % 4, np.where(along[0] > along[1], 0, 4))
    divides = is_on.any(axis=0).all(axis=0) & ((sides[0] != sides[1]) | (last - first > 1))
    return _Runs(xy, first, last, cell, sides, n_left, divides, corners)


def _faces(runs: _Runs, which: CellIndices, is_in: bool) -> PlanQuads:
    """The faces on the left of runs, in the area, or on their right, outside."""
    end, n_left, n_points = runs.sides[int(is_in)][which], runs.n_left[which], runs.last[which] - runs.first[which] + 1
    n_corners = n_left if is_in else 4 - n_left
    counts = n_points + n_corners
    number = np.repeat(np.arange(len(which)), counts)
    place = np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)
    # Along the run, or back, and around the corners of the cell.
    along = np.minimum(place, n_points[number] - 1)
    point = (runs.first[which][number] + along) if is_in else (runs.last[which][number] - along)
    corner = (end[number] + 1 + place - n_points[number]) % 4
    is_point = place < n_points[number]
    ring = np.where(is_point[:, None], runs.xy[point], runs.corners[which[number], corner])
    # A straight run leaves what is convex.
    is_straight = n_points == 2
    fans = np.flatnonzero(is_straight[number] & (place > 1))
    origin = fans - place[fans]
    triangles = np.stack([ring[origin], ring[fans - 1], ring[fans], ring[fans]], axis=1)
    bent = ~is_straight[number]
    renumbered = (np.cumsum(~is_straight) - 1)[number[bent]]
    polygons = shapely.polygons(shapely.linearrings(ring[bent], indices=renumbered)) if bent.any() else np.zeros(0)
    return np.concatenate([triangles, triangles_of(polygons)])


def _odd_parts(
    xs: Scalars, ys: Float[np.ndarray, " m"], area: BaseGeometry, column: CellIndices, row: CellIndices
) -> tuple[np.ndarray, np.ndarray]:
    """CutCells that the border crosses in more than one run, or lies in, and the parts of an area in them."""
    cells, parts = shapely.box(xs[column], ys[row], xs[column + 1], ys[row + 1]), list[BaseGeometry]()
    order = np.argsort(column, kind="stable")
    for some in np.split(order, np.flatnonzero(np.diff(column[order])) + 1):
        if len(some):
            # A little wider, so that cells do not touch its sides: these are slow to ask about.
            i, j = int(column[some[0]]), row[some]
            low, high = float(ys[j.min()]) - ASIDE_M, float(ys[j.max() + 1]) + ASIDE_M
            strip = clipped(area, (float(xs[i]) - ASIDE_M, low, float(xs[i + 1]) + ASIDE_M, high))
            parts += [clipped(strip, (xs[i], ys[k], xs[i + 1], ys[k + 1])) for k in j.tolist()]
    return cells[order], np.array(parts)


def _whole(xs: Scalars, ys: Float[np.ndarray, " m"], area: BaseGeometry, cut: CellIndices) -> Int[np.ndarray, "2 _"]:
    """The cells that are wholly in an area, by their middles: its border passes through the cells `cut` alone."""
    if area.is_empty:
        return np.zeros((2, 0), dtype=int)
    x0, y0, x1, y1 = shapely.bounds(area)
    ranges = [
        np.arange(max(int(np.searchsorted(lines, low)) - 1, 0), min(int(np.searchsorted(lines, high)), len(lines) - 1))
        for lines, low, high in ((xs, x0, x1), (ys, y0, y1))
    ]
    row, column = (at.ravel() for at in np.meshgrid(ranges[1], ranges[0], indexing="ij"))
    rest = ~np.isin(row * (len(xs) - 1) + column, cut, assume_unique=True)
    row, column = row[rest], column[rest]
    middles = np.stack([(xs[column] + xs[column + 1]) / 2, (ys[row] + ys[row + 1]) / 2], axis=1)
    inside = contains(area, middles)
    return np.stack([column[inside], row[inside]])


def _differences(cells: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """What of each cell its part leaves."""
    try:
        return np.asarray(shapely.difference(cells, parts))
    except shapely.errors.GEOSException:
        return np.array([difference(cell, part) for cell, part in zip(cells, parts, strict=True)])


def triangles_of(parts: np.ndarray) -> PlanQuads:
    """The triangles of areas, as quads whose last corner is there twice. They have all corners of the areas, and no
    others: triangles of areas beside each other share these."""
    pieces = shapely.get_parts(shapely.get_parts(parts))
    polygons = pieces[shapely.get_type_id(pieces) == shapely.GeometryType.POLYGON]
    if not len(polygons):
        return np.zeros((0, 4, 2))
    return shapely.get_coordinates(_triangulated(polygons)).reshape(-1, 4, 2)[:, [0, 1, 2, 2]]


def _triangulated(polygons: np.ndarray) -> np.ndarray:
    """The triangles of polygons; those that are too thin for any are left out."""
    try:
        return np.asarray(shapely.constrained_delaunay_triangles(polygons))
    except shapely.errors.GEOSException:
        pass
    found = []
    for polygon in polygons:
        for grid_m in (0.0, *GRIDS_M):
            try:
                found.append(shapely.constrained_delaunay_triangles(shapely.set_precision(polygon, grid_m)))
                break
            except shapely.errors.GEOSException:
                continue
    return np.array(found)


def beside(axis: Scalars, places: Float[np.ndarray, " m"]) -> Scalars:
    """The lines of a grid, moved by hairs so that none goes through a place: cells on both sides of a line would differ
    in whether that is on their edge."""
    places = np.sort(np.concatenate([places, [-np.inf, np.inf]]))
    while True:
        after = np.searchsorted(places, axis)
        is_near = np.minimum(axis - places[after - 1], places[after] - axis) < HAIR_M
        if not is_near.any():
            return axis
        axis = axis + 2.1 * HAIR_M * is_near


class Merged(NamedTuple):
    """PlanQuads from above that share their corners, facing up."""

    xy: Float[np.ndarray, "_ 2"]
    faces: Int[np.ndarray, "_ 4"]


def merged(quads: PlanQuads) -> Merged:
    """PlanQuads with each corner once."""
    corners = quads.reshape(-1, 2)
    x, y = np.rint(corners * 1e6).astype(int).T
    # As one number each: sorted by rows, they take longer.
    numbers = (x - x.min()) * (np.ptp(y) + 1) + y if len(y) else y
    _, first, which = np.unique(numbers, return_index=True, return_inverse=True)
    faces = which.reshape(-1, 4)
    has_area = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[has_area]
    a, b, c, d = (corners[first][faces[:, i]] for i in range(4))
    is_down = (c - a)[:, 0] * (d - b)[:, 1] < (c - a)[:, 1] * (d - b)[:, 0]
    faces[is_down] = faces[is_down][:, [0, 3, 2, 1]]
    return Merged(corners[first], faces)
