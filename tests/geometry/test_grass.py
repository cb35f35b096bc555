"""Grass beside the road: where it stands, and that it hides no labelled point."""

import numpy as np
import pytest
from jaxtyping import Bool

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.params import load_params
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world import grass
from synth3dlanes.world.world import World

HIGH = ["vegetation.grass_m=0.6", "trees.n=0", "cars.n=0"]


def worlds(n: int, *overrides: str) -> list[World]:
    params = load_params("appendix_i", [*HIGH, *overrides])
    return [sample_world(Scenes(params, 2, "train"), index) for index in range(n)]


def hidden(world: World, blades: grass.Blades) -> Bool[np.ndarray, " p"]:
    """Which labelled points a blade hides, by Blender's rays against every blade."""
    pytest.importorskip("bpy")
    from mathutils import Vector
    from mathutils.bvhtree import BVHTree

    corners = blades.corners_world.reshape(-1, 3)
    tree = BVHTree.FromPolygons(corners.tolist(), np.arange(len(corners)).reshape(-1, 3).tolist())
    points_cam = np.concatenate([lane.xyz_cam for lane in label(world, world.view).lanes])
    eye = world.view.eye_world
    to = transform(world.view.world_from_cam, points_cam) - eye
    hits = [tree.ray_cast(Vector(eye), Vector(ray), float(np.linalg.norm(ray)))[0] for ray in to]
    return np.array([hit is not None for hit in hits])


def test_no_blade_hides_a_labelled_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the rule, blades do hide points in the bends of these scenes."""
    some = worlds(4, "road.offset_p100_m=10", "road.offset_p50_m=-10", "road.shoulder_factor=0.2")
    for world in some:
        blades = world.grass(world.view)
        assert blades is not None
        assert len(blades.shade) > 5000
        assert not hidden(world, blades).any()
    monkeypatch.setattr(grass, "_in_sight", lambda feet, *_: np.zeros(len(feet), dtype=bool))
    free = [world.grass(world.view) for world in some]
    assert sum(hidden(world, blades).sum() for world, blades in zip(some, free, strict=True) if blades) > 10


@pytest.mark.parametrize("topology", [1, 2, 4])
def test_grass_stands_on_the_verge(topology: int) -> None:
    """Feet lie within a tuft's radius of the verge, a little below the ground; blades are no higher than asked for."""
    for world in worlds(3, f"road.topology={topology}"):
        blades = world.grass(world.view)
        assert blades is not None
        feet, tips = blades.corners_world[:, :2].mean(axis=1), blades.corners_world[:, 2]
        from_edge_m = world.ground.clearance(feet[:, :2])
        assert from_edge_m.min() > grass.BESIDE_M[0] - grass.RADIUS_M
        assert from_edge_m.max() < grass.BESIDE_M[1] + grass.RADIUS_M
        assert np.abs(feet[:, 2] - world.ground.height(feet[:, :2])).mean() < 0.1
        rise_m = tips[:, 2] - feet[:, 2] - grass.SINK_M
        assert 0 < rise_m.min() < 0.1 < rise_m.max() <= 0.6
        ahead_m = (feet[:, 1] - world.view.eye_world[1]) * np.sign(world.view.world_from_road[1, 1])
        assert np.quantile(ahead_m, 0.999) < 60
        assert np.median(ahead_m) < 20, "dense near the host"
