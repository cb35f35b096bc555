"""Areas cut by the lines of a grid into faces that share their corners with those beside them. World frame, metres."""

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry.base import BaseGeometry

from synth3dlanes.geometry.polylines import parted
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.areas import GRIDS_M, clipped, contains, difference

# Columns of cells are cut out a little wider; lines of grids keep off corners of areas by hairs.
COLUMN_MARGIN_M, HAIR_M = 0.01, 1e-5

CellIndices = Int[np.ndarray, " _"]
PlanPlaces = Float[np.ndarray, "_ 2"]
# The corners of faces from above; a triangle has its last one twice.
PlanQuads = Float[np.ndarray, "_ 4 2"]


class Faces(NamedTuple):
    """Faces from above, and the number of the area of each."""

    quads: PlanQuads
    area: CellIndices


class CutCells(NamedTuple):
    """What areas cover of a grid: the number of the area, the column and the row of the cells that are wholly in it,
    those of the cells that its border cuts, and the faces in these that are in the area, and outside, if they were
    asked for."""

    whole: Int[np.ndarray, "3 _"]
    cut: Int[np.ndarray, "3 _"]
    inside: Faces
    outside: Faces


def cut_cells(
    xs: Scalars, ys: Float[np.ndarray, " m"], areas: Sequence[BaseGeometry], outside: bool = True
) -> CutCells:
    """The cells of a grid that each of some areas covers, no corner of which is on a line of the grid (`beside`)."""
    n_columns, n_rows = len(xs) - 1, len(ys) - 1
    runs = _runs(xs, ys, areas)
    column, row = runs.cell.T
    is_there = (column >= 0) & (column < n_columns) & (row >= 0) & (row < n_rows)
    number = np.where(is_there, (runs.area * n_rows + row) * n_columns + column, -1)
    cut, which, counts = np.unique(number, return_index=True, return_counts=True)
    cut, which, counts = (values[cut >= 0] for values in (cut, which, counts))
    is_one = (counts == 1) & runs.divides[which]
    plain, odd = which[is_one], _of_areas(cut[~is_one], n_columns, n_rows)
    odd, cells, parts = _odd_parts(xs, ys, areas, odd)
    rest = [_faces(runs, plain, is_in=False), _triangles_in(_differences(cells, parts), odd[0])] if outside else []
    return CutCells(
        _whole(xs, ys, areas, cut),
        _of_areas(cut, n_columns, n_rows),
        _joined([_faces(runs, plain, is_in=True), _triangles_in(parts, odd[0])]),
        _joined(rest),
    )


def _of_areas(number: CellIndices, n_columns: int, n_rows: int) -> Int[np.ndarray, "3 _"]:
    """The areas, columns and rows of the cells of all areas by their numbers."""
    return np.stack([number // (n_columns * n_rows), number % n_columns, number // n_columns % n_rows])


def _joined(parts: Sequence[Faces]) -> Faces:
    """All of some faces."""
    found = [Faces(np.zeros((0, 4, 2)), np.zeros(0, dtype=int)), *parts]
    return Faces(*(np.concatenate(values) for values in zip(*found, strict=True)))


class _Runs(NamedTuple):
    """The borders of areas, ring after ring with the area on the left: their corners and where they cross lines of a
    grid. A run is of the area with a number. Between two crossings it is in one cell, all points from `first` to
    `last`; `sides` are those of the cell where it begins and ends, 0 below, then on to the right of that. `n_left` is
    how many corners of the cell are on the left of the run, in the area. `divides` says that the run has a cell in two
    parts."""

    xy: PlanPlaces
    area: CellIndices
    first: CellIndices
    last: CellIndices
    cell: Int[np.ndarray, "_ 2"]
    sides: Int[np.ndarray, "2 _"]
    n_left: CellIndices
    divides: Bool[np.ndarray, " _"]
    corners: Float[np.ndarray, "_ 4 2"]


def _runs(xs: Scalars, ys: Float[np.ndarray, " m"], areas: Sequence[BaseGeometry]) -> _Runs:
    """The runs of the borders of areas. A ring that crosses no line is a run that does not divide its cell."""
    polygons, area = shapely.get_parts(shapely.orient_polygons(areas), return_index=True)
    rings, of_polygon = shapely.get_rings(polygons, return_index=True)
    places, ring = shapely.get_coordinates(rings, return_index=True)
    at = np.flatnonzero(ring[1:] == ring[:-1]) if len(ring) else np.zeros(0, dtype=int)
    start, end, ring = places[at], places[at + 1], ring[at]
    # For each point: the line between corners that it is on, how far along that, where, and the line of the grid.
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
    area = area[of_polygon[of_ring[taken][first]]]
    return _Runs(xy, area, first, last, cell, sides, n_left, divides, corners)


def _faces(runs: _Runs, which: CellIndices, is_in: bool) -> Faces:
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
    own = runs.area[which]
    return _joined([Faces(triangles, own[number[fans]]), _triangles_in(polygons, own[~is_straight])])


def _odd_parts(
    xs: Scalars, ys: Float[np.ndarray, " m"], areas: Sequence[BaseGeometry], odd: Int[np.ndarray, "3 _"]
) -> tuple[Int[np.ndarray, "3 _"], np.ndarray, np.ndarray]:
    """The cells that a border crosses in more than one run, or lies in, in another order, as boxes, and the parts of
    their areas in them."""
    odd = odd[:, np.lexsort(odd[1::-1])]
    of, column, row = odd
    cells, parts = shapely.box(xs[column], ys[row], xs[column + 1], ys[row + 1]), list[BaseGeometry]()
    counts = np.diff(np.flatnonzero(np.diff(of) | np.diff(column)) + 1, prepend=0, append=len(of))
    for number, i, j in zip(*(parted(values, counts) for values in odd), strict=True):
        if len(j):
            # A little wider, so that cells do not touch its sides: these are slow to ask about.
            x0, x1 = xs[i[0]], xs[i[0] + 1]
            low, high = float(ys[j.min()]) - COLUMN_MARGIN_M, float(ys[j.max() + 1]) + COLUMN_MARGIN_M
            strip = clipped(areas[number[0]], (float(x0) - COLUMN_MARGIN_M, low, float(x1) + COLUMN_MARGIN_M, high))
            parts += [clipped(strip, (x0, ys[k], x1, ys[k + 1])) for k in j.tolist()]
    return odd, cells, np.array(parts)


def _whole(
    xs: Scalars, ys: Float[np.ndarray, " m"], areas: Sequence[BaseGeometry], cut: CellIndices
) -> Int[np.ndarray, "3 _"]:
    """The cells that are wholly in an area, by their middles: its border passes through the cells `cut` alone."""
    n_columns, n_rows, found = len(xs) - 1, len(ys) - 1, [np.zeros((3, 0), dtype=int)]
    starts = np.searchsorted(cut, np.arange(len(areas) + 1) * n_columns * n_rows)
    for i, area in enumerate(areas):
        if area.is_empty:
            continue
        x0, y0, x1, y1 = shapely.bounds(area)
        columns, rows = (
            np.arange(max(int(np.searchsorted(lines, low)) - 1, 0), min(int(np.searchsorted(lines, high)), n))
            for lines, low, high, n in ((xs, x0, x1, n_columns), (ys, y0, y1, n_rows))
        )
        if not len(columns) or not len(rows):
            continue
        is_rest = np.ones((len(rows), len(columns)), dtype=bool)
        row, column = np.divmod(cut[starts[i] : starts[i + 1]] - i * n_columns * n_rows, n_columns)
        is_rest[row - rows[0], column - columns[0]] = False
        # Between two cut cells of a column, all cells are in the area or none.
        is_first = is_rest.copy()
        is_first[1:] &= ~is_rest[:-1]
        column, row = (at + first[0] for at, first in zip(np.nonzero(is_first.T), (columns, rows), strict=True))
        middles = np.stack([(xs[column] + xs[column + 1]) / 2, (ys[row] + ys[row + 1]) / 2], axis=1)
        run = np.cumsum(is_first.T).reshape(is_rest.T.shape) - 1
        column, row = np.nonzero(is_rest.T & np.append(contains(area, middles), False)[run])
        found.append(np.stack([np.full(len(row), i), column + columns[0], row + rows[0]]))
    return np.concatenate(found, axis=1)


def corners_in(
    xs: Scalars, ys: Float[np.ndarray, " m"], area: BaseGeometry, cells: CutCells
) -> tuple[Bool[np.ndarray, "m n"], Bool[np.ndarray, "m n"]]:
    """Which corners of a grid are in an area by what it covers of the cells, and which ones are corners of cells that
    its border cuts."""
    found, near = np.zeros((2, len(ys), len(xs)), dtype=bool)
    for corners, (_, column, row) in ((found, cells.whole), (near, cells.cut)):
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            corners[row + i, column + j] = True
    row, column = np.nonzero(near & ~found)
    found[row, column] = contains(area, np.stack([xs[column], ys[row]], axis=1))
    return found, near


def _differences(cells: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """What of each cell its part leaves."""
    try:
        return np.asarray(shapely.difference(cells, parts))
    except shapely.errors.GEOSException:
        return np.array([difference(cell, part) for cell, part in zip(cells, parts, strict=True)])


def _triangles_in(parts: np.ndarray, area: CellIndices) -> Faces:
    """The triangles of parts of areas, as quads whose last corner is there twice. They have all corners of the parts,
    and no others: triangles of parts beside each other share these."""
    pieces, of_part = shapely.get_parts(parts, return_index=True)
    pieces, of_piece = shapely.get_parts(pieces, return_index=True)
    is_polygon = shapely.get_type_id(pieces) == shapely.GeometryType.POLYGON
    polygons, area = pieces[is_polygon], area[of_part[of_piece[is_polygon]]]
    if not len(polygons):
        return _joined([])
    triangles = _triangulated(polygons)
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)
    return Faces(corners[:, [0, 1, 2, 2]], np.repeat(area, shapely.get_num_geometries(triangles)))


def _triangulated(polygons: np.ndarray) -> np.ndarray:
    """The triangles of polygons; none of those that are too thin for any."""
    try:
        return np.asarray(shapely.constrained_delaunay_triangles(polygons))
    except shapely.errors.GEOSException:
        if len(polygons) > 1:
            # Few are so thin: all others are done together.
            return np.concatenate([_triangulated(half) for half in np.array_split(polygons, 2)])
    for grid_m in GRIDS_M:
        with suppress(shapely.errors.GEOSException):
            return np.asarray(shapely.constrained_delaunay_triangles(shapely.set_precision(polygons, grid_m)))
    return np.array([shapely.GeometryCollection()])


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
