"""The meshes against the geometry that labels are made from: two ways to the same surface."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.geometry import meshes, paint
from synth3dlanes.geometry.ground import Ground
from synth3dlanes.geometry.lanes import curves
from synth3dlanes.geometry.road import RoadPlan
from tests.scenes import changed, hill

HILLS = (hill(30, -20, 25, 50), hill(-60, 60, -30, 40), hill(10, 90, 15, 30))
CURVED = {"offset_m50_m": 6, "offset_p50_m": -7, "offset_p100_m": 9, "exit_offset_m": 6, "ramp_height_m": 5}


def plan_of(topology, **road):
    return RoadPlan(changed(terrain={"gaussians": HILLS}, road={**CURVED, "topology": topology, **road}))


def heights_at(mesh, xy):
    """Heights of a mesh straight above or below points, by its triangles; NaN where it does not reach."""
    triangles = mesh.vertices_world[np.concatenate([mesh.faces[:, [0, 1, 2]], mesh.faces[:, [0, 2, 3]]])]
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    area = np.cross((b - a)[:, :2], (c - a)[:, :2])
    keep = np.abs(area) > 1e-9
    a, b, c, area = a[keep], b[keep], c[keep], area[keep]
    heights = np.full(len(xy), np.nan)
    for i, p in enumerate(xy):
        u = np.cross((p - a[:, :2]), (c - a)[:, :2]) / area
        v = np.cross((b - a)[:, :2], (p - a[:, :2])) / area
        inside = np.flatnonzero((u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9))
        if inside.size:
            j = inside[0]
            heights[i] = a[j, 2] + u[j] * (b[j, 2] - a[j, 2]) + v[j] * (c[j, 2] - a[j, 2])
    return heights


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("topology", [1, 2, 3, 4])
def test_every_label_point_lies_on_the_pavement(topology, flip):
    plan = plan_of(topology, flip_lateral=flip, flip_longitudinal=flip)
    pavement = meshes.road_meshes(Ground(plan))
    s = plan.plan_station(np.arange(-49.0, 45, 3.7))
    for curve in curves(plan):
        stations = s[(s > curve.start_m) & (s < curve.end_m)]
        points = curve.points_world(plan, stations)
        gaps = np.abs([heights_at(mesh, points[:, :2]) - points[:, 2] for mesh in pavement])
        gaps = np.nanmin(np.where(np.isnan(gaps), np.inf, gaps), axis=0)
        assert gaps.max() < 0.02, (curve.id, stations[gaps.argmax()], gaps.max())


@pytest.mark.parametrize("topology", [1, 2, 3, 4])
def test_no_terrain_comes_through_a_road(topology):
    plan = plan_of(topology)
    ground = Ground(plan)
    terrain = meshes.terrain_mesh(ground)
    x0, y0, x1, y1 = ground.fine
    near = ((terrain.vertices_world[:, :2] > [x0 - 3, y0]) & (terrain.vertices_world[:, :2] < [x1 + 3, y1])).all(axis=1)
    kept = near[terrain.faces].all(axis=1)
    terrain = replace(terrain, faces=terrain.faces[kept], material=terrain.material[kept])
    for mesh in meshes.road_meshes(ground):
        points = mesh.vertices_world[::17]
        points = points[(points[:, 1] > -50) & (points[:, 1] < 100)]
        above = points[:, 2] - heights_at(terrain, points[:, :2])
        assert np.nanmin(above) > 0.1


@pytest.mark.parametrize("topology", [2, 3, 4])
def test_faces_look_up_and_carry_their_material(topology):
    plan = plan_of(topology, flip_longitudinal=True)
    for mesh in [*meshes.road_meshes(Ground(plan)), meshes.terrain_mesh(Ground(plan))]:
        a, b, c, d = (mesh.vertices_world[mesh.faces[:, i]] for i in range(4))
        up = np.cross(c - a, d - b)[:, 2]
        assert (up > -1e-6).all()
        assert len(mesh.material) == len(mesh.faces)


def test_dashes_cover_their_share_and_do_not_move_with_the_camera():
    near, far = (paint.paint_meshes(RoadPlan(changed(camera={"y_m": y})))["main_line_1"] for y in (-50, -30.3))
    painted = [
        {(round(lo, 3), round(hi, 3)) for lo, hi in zip(*_spans(mesh), strict=True) if lo > -20 and hi < 20}
        for mesh in (near, far)
    ]
    edges = [sorted({e for span in spans for e in span}) for spans in painted]
    starts = [[e for e in spans if abs(e / 4 - round(e / 4)) < 1e-6] for spans in edges]
    assert starts[0] == starts[1] == [-16, -12, -8, -4, 0, 4, 8, 12, 16]
    lengths = [sum(hi - lo for lo, hi in spans) for spans in painted]
    np.testing.assert_allclose(lengths, 20, atol=2.01)


def _spans(mesh):
    y = mesh.vertices_world[mesh.faces][:, :, 1]
    return y.min(axis=1), y.max(axis=1)


def test_paint_is_as_wide_as_the_scene_says_and_centred_on_the_delimiter():
    plan = plan_of(2)
    mesh = paint.paint_meshes(plan)["main_line_0"]
    left, right = mesh.vertices_world[0::2], mesh.vertices_world[1::2]
    np.testing.assert_allclose(np.linalg.norm((right - left)[:, :2], axis=1), 0.12, atol=1e-6)
    _, t = plan.project_main(((left + right) / 2)[:200, :2])
    np.testing.assert_allclose(t, plan.boundary_m(0), atol=1e-6)


def test_there_is_no_inner_verge_while_the_exit_touches_the_main_road():
    """Just before a merge is over the roads touch all the way; Blender cannot take an empty mesh."""
    road = {"topology": 2, "flip_lateral": True, "exit_angle_rad": 0.0175, "exit_offset_m": 0}
    touching = meshes.verge_meshes(Ground(RoadPlan(changed(road=road, camera={"y_m": -5.0}))))
    apart = meshes.verge_meshes(Ground(plan_of(2)))
    assert [len(apart), len(touching)] == [4, 3]
    assert all(len(mesh.faces) for mesh in apart + touching)
