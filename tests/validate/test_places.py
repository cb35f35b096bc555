"""Where points lie on the roads, against the very meshes that Blender is given, in random scenes of two presets."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.assets.catalogue import BUILT_IN
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.evidence import Seen
from synth3dlanes.validate.paint import WorldPaint
from synth3dlanes.validate.places import RoadPlaces, places
from synth3dlanes.validate.seen import MAX_ASIDE_M, MAX_BEYOND_M, MAX_GAP_M, RANGE_M
from synth3dlanes.world import meshes
from synth3dlanes.world.visibility import seen_over_ground
from synth3dlanes.world.world import World
from tests.thorough import first

N_SCENES, N_POINTS = 9, 600


def worlds(preset: str) -> Iterator[World]:
    params = load_params(preset)
    return (sample_world(Scenes(params, 3, "test", assets=BUILT_IN.assets), index) for index in range(N_SCENES))


def ahead(world: World, mesh: meshes.Mesh, reach_m: float) -> meshes.Mesh:
    """The faces from the camera to so far ahead of it."""
    y_m = mesh.vertices_world[mesh.faces][..., 1] - world.scene.camera.y_m
    kept = (y_m.min(axis=1) > 0) & (y_m.max(axis=1) < reach_m)
    return replace(mesh, faces=mesh.faces[kept], material=mesh.material[kept])


def on_faces(mesh: meshes.Mesh, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points spread over the triangles of faces, and the face of each."""
    face = rng.integers(len(mesh.faces), size=N_POINTS)
    a, b, c = np.moveaxis(mesh.vertices_world[mesh.faces[face]][:, [0, 1, 2]], 1, 0)
    u, v = rng.random((2, N_POINTS, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a + u * (b - a) + v * (c - a), face


def is_shown_of_exit(place: RoadPlaces) -> np.ndarray:
    """Points of the exit that are not on its seam, which goes on below the main road or the exit's own verge."""
    main, branch = place.paved.network.roads
    s, t = place.on[branch.id]
    return (place.t > main.right(place.s)) & (t > branch.left(s))


@pytest.mark.parametrize("preset", first(1, ["diverse", "appendix_i"]))
def test_road_and_shoulder_lie_where_the_formulas_have_them(preset):
    rng, n_known, n_exit, n_raised = np.random.default_rng(0), 0, 0, 0
    for world in worlds(preset):
        for number, whole in enumerate(world.site.surfaces.pavement):
            mesh = ahead(world, whole, RANGE_M)
            if not len(mesh.faces):
                continue
            points, face = on_faces(mesh, rng)
            place = places(world.ground, points[:, :2])
            if number == 1:
                shown = is_shown_of_exit(place)
                points, face, place = points[shown], face[shown], place.at(shown)
            assert place.outside().max() < MAX_ASIDE_M
            gap_m = points[:, 2] - height_at(world.scene.terrain, points[:, :2]) - place.raised()
            assert np.abs(gap_m).max() < MAX_GAP_M
            expected = place.surface(MAX_ASIDE_M)
            found = np.where(mesh.material[face] == meshes.ROAD, SEMANTIC_IDS["road"], SEMANTIC_IDS["shoulder"])
            np.testing.assert_array_equal(expected[expected > 0], found[expected > 0])
            n_known += (expected > 0).sum()
            n_exit, n_raised = n_exit + (number == 1), n_raised + (place.raised() > 0.5).sum()
    assert n_known > 0.5 * N_SCENES * N_POINTS
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
            place = on.places
            assert paint.beyond_m(id_, place).max(initial=-1) < MAX_BEYOND_M
            others = [other for other in paint.ids if other.startswith("main") and other != id_]
            if id_.startswith("main") and len(on):
                assert min(paint.beyond_m(other, place).min() for other in others) > 1
            n += len(on)
    assert n > 2000
