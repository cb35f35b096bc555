"""Areas cut by the lines of grids, against areas and overlays of shapely; what a camera sees from above."""

import numpy as np
import pytest
import shapely

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.world.areas import intersection
from synth3dlanes.world.cells import beside, cut_cells, merged
from tests.maps.files import opendrive, plan, road

AXIS = np.arange(-20.0, 21.0, 1.25)
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
    xs, ys = (beside(AXIS, at) for at in corners.T)
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
    xs, ys = (beside(AXIS, at) for at in shapely.get_coordinates(RING).T)
    cells = cut_cells(xs, ys, [RING])
    inside, outside = (
        {tuple(at) for at in np.round(q.reshape(-1, 2), 6)} for q in (cells.inside.quads, cells.outside.quads)
    )
    border = {tuple(at) for at in np.round(shapely.get_coordinates(RING), 6)}
    assert border <= inside & outside


def test_a_scene_on_a_map_does_not_depend_on_those_that_were_made_before() -> None:
    given = read_opendrive(opendrive(road(plan(("<line/>", 400.0), ('<arc curvature="0.01"/>', 150.0)))), "x", "map x")
    scenes = Scenes(load_params("tiny", ("cars.n=2", "trees.n=1")), 5, map=MapPlace(given))
    first = sample_world(scenes, 3)
    for index in (0, 1, 2):
        sample_world(scenes, index)
    again = sample_world(scenes, 3)
    assert again.scene == first.scene
    for one, other in zip(first.site.surfaces.pavement, again.site.surfaces.pavement, strict=True):
        np.testing.assert_array_equal(one.vertices_world, other.vertices_world)
    terrains = [world.site.surfaces.terrain for world in (first, again)]
    np.testing.assert_array_equal(terrains[0].vertices_world, terrains[1].vertices_world)
    np.testing.assert_array_equal(terrains[0].faces, terrains[1].faces)


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
