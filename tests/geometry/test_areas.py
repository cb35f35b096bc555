"""Overlays of areas, which never fail, and areas cut by the lines of grids, against overlays of shapely."""

import ast
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry.base import BaseGeometry

import synth3dlanes
from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.world import areas
from synth3dlanes.world.areas import (
    NOTHING,
    clipped,
    difference,
    intersection,
    outlined,
    outset,
    polygon_between,
    ring_area,
    signed_distance,
    solid,
    union,
)
from synth3dlanes.world.cells import beside, cut_cells, merged
from tests.maps.files import opendrive, plan, road

# Corners on a few places, some a hair beside these: rings that cross, touch and run along themselves and each other.
AXIS = st.sampled_from([-1e-9, 0.0, 1e-12, 1.0, 1.0 + 1e-10, 2.0, 2.0 - 1e-7, 3.0, 1e3])
RINGS = st.lists(st.tuples(AXIS, AXIS), min_size=0, max_size=12).map(lambda ring: np.array(ring).reshape(-1, 2))
LINES = st.integers(2, 6).flatmap(
    lambda n: st.tuples(*[st.lists(st.tuples(AXIS, AXIS), min_size=n, max_size=n).map(np.array)] * 2)
)


def is_area(area: BaseGeometry) -> bool:
    """Whether something consists of polygons alone, which are valid up to the finest grid."""
    on_grid = shapely.set_precision(area, areas.GRIDS_M[0])
    return isinstance(area, shapely.Polygon | shapely.MultiPolygon) and bool(shapely.is_valid(on_grid))


@given(RINGS, RINGS, RINGS, LINES)
def test_no_overlay_fails(one: np.ndarray, other: np.ndarray, third: np.ndarray, lines: tuple) -> None:
    a, b, c = map(ring_area, (one, other, third))
    strip = polygon_between(*lines)
    whole, shared, left = union([a, b, c, strip]), intersection(a, b), difference(a, union([b, strip]))
    for area in (a, b, c, strip, whole, shared, left, solid(whole), outset(whole, 0.1), outset(a, -0.1)):
        assert is_area(area)
    both = union([a, b])
    slack_m2 = 0.01 * (1 + both.length)
    assert both.area == pytest.approx(a.area + b.area - shared.area, abs=slack_m2)
    assert left.area <= a.area + slack_m2


def test_a_road_that_folds_covers_all_between_its_rows() -> None:
    """Its inner edge is a hair beyond the middle of the bend, where rows cross each other."""
    rad = np.linspace(0.0, np.pi / 2, 30)
    for beyond_m in (0.005, 0.05, 0.3):
        x, y = (of(rad)[:, None] * [16.0, -beyond_m] + at for of, at in ((np.cos, 50.3), (np.sin, 20.7)))
        strip = polygon_between(*np.stack([x, y], axis=-1).swapaxes(0, 1))
        assert strip.area == pytest.approx(np.pi / 4 * 16.0**2, rel=0.01)


def test_what_has_no_area_is_nothing() -> None:
    line, point = shapely.LineString([(0, 0), (1, 1)]), shapely.Point(0, 0)
    square = shapely.box(0, 0, 1, 1)
    mixed = shapely.GeometryCollection([line, point, square, shapely.MultiPolygon([shapely.box(2, 0, 3, 1)])])
    for shape in (line, point, shapely.GeometryCollection(), shapely.Polygon()):
        assert areas.valid(shape).is_empty
    assert areas.valid(mixed).area == 2
    assert ring_area(np.array([[0, 0], [1, 0], [np.nan, 1]])).is_empty
    assert union([]).is_empty
    assert intersection(square, shapely.box(1, 0, 2, 1)).is_empty, "they share an edge alone"
    assert union([mixed, NOTHING, square]).area == 2


@pytest.mark.parametrize("operation", ["union_all", "difference", "intersection"])
def test_an_overlay_that_geos_refuses_is_done_on_a_grid(monkeypatch: pytest.MonkeyPatch, operation: str) -> None:
    exact = getattr(shapely, operation)

    def refuses(*given: object, grid_size: float | None = None) -> BaseGeometry:
        if grid_size is None or grid_size < 1e-3:
            raise shapely.errors.GEOSException("TopologyException: side location conflict")
        return exact(*given, grid_size=grid_size)

    monkeypatch.setattr(shapely, operation, refuses)
    a, b = shapely.box(0, 0, 2, 2), shapely.box(1, 1, 3, 3)
    found = union([a, b]) if operation == "union_all" else getattr(areas, operation)(a, b)
    assert found.area == pytest.approx({"union_all": 7, "difference": 3, "intersection": 1}[operation], abs=0.01)


def test_scenes_overlay_areas_here_alone() -> None:
    """The one place: `areas.py`. Of arrays and lines other modules may ask, with what to do when it fails."""
    overlays = {"union", "union_all", "difference", "intersection", "buffer", "make_valid", "symmetric_difference"}
    allowed = {("cells.py", "difference"), ("paved_areas.py", "intersection"), ("lanelet_map.py", "make_valid")}
    package = Path(synth3dlanes.__file__).parent
    found = {
        (path.name, node.attr)
        for room in ("roads", "world", "draw", "truth", "blender")
        for path in (package / room).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "shapely"
        if node.attr in overlays and path.name != "areas.py"
    }
    assert found == allowed


@given(st.lists(st.tuples(st.floats(-30, 30), st.floats(-30, 30)), min_size=1, max_size=20))
def test_distances_are_those_of_shapely_itself(points: list[tuple[float, float]]) -> None:
    island = shapely.Polygon([(-5, -5), (5, -5), (5, 5), (-5, 5)])
    area = shapely.union_all([shapely.Point(0, 0).buffer(20).difference(island), shapely.box(22, 0, 25, 4)])
    xy, places = np.array(points), shapely.points(points)
    outside, inside = shapely.distance(area, places), shapely.distance(shapely.boundary(area), places)
    expected = np.where(shapely.contains_properly(area, places), -inside, outside)
    # On the outline 0 may have either sign.
    np.testing.assert_array_equal(np.abs(signed_distance(outlined(area), xy)), np.abs(expected))
    np.testing.assert_array_equal(signed_distance(outlined(area), xy) < 0, expected < 0)
    assert np.isinf(signed_distance(outlined(shapely.MultiPolygon()), xy)).all()


def test_what_is_clipped_of_parts_that_meet_in_a_hair_is_valid_and_whole() -> None:
    """GEOS' fast way joins them in some boxes; a ring of a roundabout had a slit of half a metre for it."""
    hair = np.nextafter(0.61, 1)
    left = shapely.Polygon([(-8.1, -7.2), (0.11, -7.2), (0.61, 7.3), (-8.1, 7.3)])
    right = shapely.Polygon([(0.11, -7.2), (8.2, -7.2), (8.2, 7.3), (hair, 7.3)])
    for low, high in combinations(np.arange(-20, 21, 1.25).tolist(), 2):
        box = (-0.01, low - 0.01, 1.26, high + 0.01)
        found = clipped(shapely.MultiPolygon([left, right]), box)
        assert found.is_valid
        assert found.area == pytest.approx(intersection(shapely.union(left, right), shapely.box(*box)).area, abs=1e-9)


LINES_OF_GRID = np.arange(-20.0, 21.0, 1.25)
RING = shapely.Point(0.3, -0.2).buffer(9.0).difference(shapely.Point(1.1, 0.4).buffer(4.0))
STRIPS = shapely.union_all([shapely.LineString([(-30, y), (30, y + 7.3)]).buffer(0.2) for y in (-9.1, -8.7, 3.3)])
AREAS = {
    "ring": RING,
    "a hole in one cell": shapely.box(-7.03, -6.11, 9.17, 8.4).difference(shapely.Point(0.6, 0.6).buffer(0.3)),
    "several runs in a cell": STRIPS,
    "within one cell": shapely.Point(0.6, 0.6).buffer(0.3),
    "beyond the grid": shapely.Point(19.0, 2.0).buffer(7.0),
    "nothing": shapely.MultiPolygon(),
}


def faces_m2(quads: np.ndarray) -> np.ndarray:
    """The areas of faces, positive of those that face up."""
    xy, faces = merged(quads)
    a, b, c, d = (xy[faces[:, i]] for i in range(4))
    return ((c - a)[:, 0] * (d - b)[:, 1] - (c - a)[:, 1] * (d - b)[:, 0]) / 2


@pytest.mark.parametrize("area", AREAS.values(), ids=AREAS)
def test_faces_cover_an_area_and_the_rest_of_the_cells_that_it_cuts(area: shapely.Geometry) -> None:
    corners = shapely.get_coordinates(area)
    xs, ys = (beside(LINES_OF_GRID, at) for at in corners.T)
    cells = cut_cells(xs, ys, [area])
    (_, column, row), (_, cut_column, cut_row) = cells.whole, cells.cut
    boxes = shapely.box(xs[cut_column], ys[cut_row], xs[cut_column + 1], ys[cut_row + 1])
    inside, outside = faces_m2(cells.inside.quads), faces_m2(cells.outside.quads)
    assert (inside > 0).all()
    assert (outside > 0).all()
    part = intersection(area, shapely.box(xs[0], ys[0], xs[-1], ys[-1]))
    whole_m2 = ((xs[column + 1] - xs[column]) * (ys[row + 1] - ys[row])).sum()
    assert whole_m2 + inside.sum() == pytest.approx(part.area, abs=1e-5)
    assert inside.sum() + outside.sum() == pytest.approx(shapely.area(boxes).sum(), abs=1e-5)
    middles = [shapely.points(quads[:, :3].mean(axis=1)) for quads in (cells.inside.quads, cells.outside.quads)]
    assert shapely.covers(area, middles[0]).all()
    assert not shapely.covers(area, middles[1]).any()


def test_faces_on_both_sides_of_a_border_share_its_corners() -> None:
    xs, ys = (beside(LINES_OF_GRID, at) for at in shapely.get_coordinates(RING).T)
    cells = cut_cells(xs, ys, [RING])
    inside, outside = (
        {tuple(at) for at in np.round(q.reshape(-1, 2), 6)} for q in (cells.inside.quads, cells.outside.quads)
    )
    border = {tuple(at) for at in np.round(shapely.get_coordinates(RING), 6)}
    assert border <= inside & outside


def test_what_the_image_shows_of_lines_is_in_the_sector_and_its_paint_is_drawn() -> None:
    given = read_opendrive(opendrive(road(plan(("<line/>", 400.0), ('<arc curvature="0.01"/>', 150.0)))), "x", "map x")
    world = sample_world(Scenes(load_params("tiny", ("cars.n=0", "trees.n=0")), 5, map=MapPlace(given)), 1)
    view = world.view
    sector = view.sector
    assert sector is not None
    all_round, seen = world.paint(view), world.paint(view, all_round=False)
    assert list(all_round) == list(seen)
    cam_from_world = np.linalg.inv(view.world_from_cam)
    for name, mesh in all_round.items():
        points = mesh.vertices_world
        ahead = points @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
        uv = view.project(np.where(ahead[:, 1:2] > 0.1, ahead, np.nan))
        shown = ((uv >= 0) & (uv <= [view.camera.width_px, view.camera.height_px])).all(axis=1)
        assert sector.holds(points[shown, :2]).all()
        if shown.any():
            np.testing.assert_array_equal(seen[name].vertices_world, points)
    behind = view.eye_world[:2] - 60.0 * view.world_from_cam[:2, 1]
    assert not sector.holds(behind[None]).any()


def test_a_union_keeps_every_area() -> None:
    """GEOS' union of areas that touch in parts lost two walkways of this town, 285 m2."""
    paved = sample_world(Scenes(load_params("town"), 9200005, shots=clips(2, 2.0)), 0).ground.paved
    walkways = paved._raised_strips
    assert shapely.area(areas.union(walkways)) == pytest.approx(shapely.area(shapely.union_all(walkways)), abs=1e-3)
    lamp = np.array([[-8.65, -52.9]])
    assert paved.off_carriageways(lamp) == pytest.approx(0.66, abs=0.05)
