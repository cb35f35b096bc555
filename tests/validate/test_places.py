"""Where points lie on the roads, against the very meshes that Blender is given, in random scenes of two presets."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.assets.catalogue import BUILT_IN
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.evidence import Seen
from synth3dlanes.validate.paint import WorldPaint
from synth3dlanes.validate.seen import MAX_BEYOND_M, RANGE_M
from synth3dlanes.world import meshes
from synth3dlanes.world.visibility import seen_over_ground
from synth3dlanes.world.world import World
from tests.thorough import first

N_SCENES, N_POINTS = 9, 600
# Faces are flat between their rows.
MAX_GAP_M, MAX_ASIDE_M = 0.015, 0.01


def worlds(preset: str) -> Iterator[World]:
    params = load_params(preset)
    return (sample_world(Scenes(params, 3, "test", assets=BUILT_IN.assets), index) for index in range(N_SCENES))


def ahead(world: World, mesh: meshes.Mesh, reach_m: float) -> meshes.Mesh:
    """The faces from the camera to so far ahead of it, without those that stand upright at edges."""
    corners = mesh.vertices_world[mesh.faces]
    y_m = corners[..., 1] - world.scene.camera.y_m
    (ax, ay), (bx, by) = (corners[:, 2, :2] - corners[:, 0, :2]).T, (corners[:, 3, :2] - corners[:, 1, :2]).T
    kept = (y_m.min(axis=1) > 0) & (y_m.max(axis=1) < reach_m) & (np.abs(ax * by - ay * bx) > 1e-6)
    return replace(mesh, faces=mesh.faces[kept], material=mesh.material[kept])


def on_faces(mesh: meshes.Mesh, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points spread over the triangles of faces, and the face of each."""
    face = rng.integers(len(mesh.faces), size=N_POINTS)
    a, b, c = np.moveaxis(mesh.vertices_world[mesh.faces[face]][:, [0, 1, 2]], 1, 0)
    u, v = rng.random((2, N_POINTS, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a + u * (b - a) + v * (c - a), face


def is_shown_of_exit(world: World, xy: np.ndarray) -> np.ndarray:
    """Points of the exit that are not on its seam, which goes on below the main road or the exit's own verge."""
    main, branch = world.network.roads
    (main_s, main_t), (s, t) = (road.line.project(xy) for road in (main, branch))
    return (main_t > main.right(main_s)) & (t > branch.left(s))


@pytest.mark.parametrize("preset", first(1, ["diverse", "appendix_i"]))
def test_the_meshes_of_the_pavement_lie_where_the_formulas_have_it(preset):
    """Pixels are compared with these meshes, labels are computed by the formulas."""
    rng, n_lanes, n_beside, n_exit, n_raised = np.random.default_rng(0), 0, 0, 0, 0
    for world in worlds(preset):
        main, ground = world.network.main, world.ground
        for number, whole in enumerate(world.site.surfaces.pavement):
            mesh = ahead(world, whole, RANGE_M)
            if not len(mesh.faces):
                continue
            points, face = on_faces(mesh, rng)
            if number == 1:
                shown = is_shown_of_exit(world, points[:, :2])
                points, face = points[shown], face[shown]
            assert ground.clearance(points[:, :2]).max(initial=-1) < MAX_ASIDE_M
            assert np.abs(points[:, 2] - ground.height(points[:, :2])).max(initial=0) < MAX_GAP_M
            n_exit, n_raised = n_exit + (number == 1), n_raised + (ground.above_terrain(points[:, :2]) > 0.5).sum()
            if number == 0:
                s, t = main.line.project(points[:, :2])
                left_m, right_m = main.carriageways[0].left_m, main.right(s) - main.shoulder_m
                in_lanes = (t > left_m + MAX_ASIDE_M) & (t < right_m - MAX_ASIDE_M)
                for low_m, high_m in main.medians:
                    in_lanes &= (t < low_m - MAX_ASIDE_M) | (t > high_m + MAX_ASIDE_M)
                # On the right an exit's lanes may cover the shoulder.
                beside = t < left_m - ground.paved.under_paint_m(main) - MAX_ASIDE_M
                assert (mesh.material[face[in_lanes]] == meshes.ROAD).all()
                assert (mesh.material[face[beside]] != meshes.ROAD).all()
                n_lanes, n_beside = n_lanes + in_lanes.sum(), n_beside + beside.sum()
    assert n_lanes > 0.2 * N_SCENES * N_POINTS
    assert n_beside > 0.05 * N_SCENES * N_POINTS
    assert n_exit > 3
    assert n_raised > 20


@pytest.mark.parametrize("preset", first(1, ["appendix_i", "diverse"]))
def test_paint_is_seen_within_its_own_line_and_outside_all_others(preset):
    rng, n = np.random.default_rng(0), 0
    for world in worlds(preset):
        camera, paint = label(world, world.view).camera, WorldPaint(world)
        for id_, whole in world.paint(world.view).items():
            mesh = ahead(world, whole, 40.0)
            if not len(mesh.faces):
                continue
            points, _ = on_faces(mesh, rng)
            points = points[seen_over_ground(world.ground, camera.world_from_cam[:3, 3], points)]
            on = Seen(world, camera.world_from_cam[:3, 3], points, np.zeros(len(points)), {}).on_road
            assert paint.beyond_m(id_, on.xy_world).max(initial=-1) < MAX_BEYOND_M
            others = [other for other in paint.ids if other.startswith("main") and other != id_]
            if id_.startswith("main") and len(on):
                assert min(paint.beyond_m(other, on.xy_world).min() for other in others) > 1
            n += len(on)
    assert n > 2000
