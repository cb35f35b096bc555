"""The terrain of maps is one surface without gaps, which lies below the pavement and everywhere else is the ground."""

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.system.arrays import Points3
from synth3dlanes.validate.faces import MeshFaces
from synth3dlanes.world.meshes import Mesh
from synth3dlanes.world.world import World, resolve
from tests.map_scenes import FOUR_WAY, HILLS, LEFT_TURN, T_JUNCTION, map_scene, sections_road
from tests.thorough import first

MAPS = {"four_way": FOUR_WAY, "left_turn": LEFT_TURN, "t": T_JUNCTION, "sections": sections_road()}


def world_of(name: str | int) -> World:
    """A map made by hand, on hills, or a town."""
    if isinstance(name, int):
        return sample_world(Scenes(load_params("town"), 7001), name)
    return resolve(map_scene(MAPS[name], 9.0, terrain=HILLS.model_dump()))


def open_edges(mesh: Mesh) -> tuple[Points3, Points3]:
    """The ends of the edges that belong to one face alone. Vertices at one place are one."""
    rows = np.ascontiguousarray(np.round(mesh.vertices_world, 5) + 0.0).view("V24").reshape(-1)
    _, which = np.unique(rows, return_inverse=True)
    corners = which[mesh.faces]
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    vertices = np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    is_edge = edges[:, 0] != edges[:, 1]
    low, high = np.sort(edges[is_edge], axis=1).T
    _, at, count = np.unique(low * len(rows) + high, return_index=True, return_counts=True)
    alone = vertices[is_edge][at[count == 1]]
    return mesh.vertices_world[alone[:, 0]], mesh.vertices_world[alone[:, 1]]


def gaps(terrain: Mesh) -> Points3:
    """Where edges inside a terrain belong to one face alone."""
    start, end = open_edges(terrain)
    low, high = terrain.vertices_world[:, :2].min(axis=0), terrain.vertices_world[:, :2].max(axis=0)
    on_border = ((start[:, :2] == low) & (end[:, :2] == low)) | ((start[:, :2] == high) & (end[:, :2] == high))
    return start[~on_border.any(axis=1)]


@pytest.mark.parametrize("name", [*MAPS, *first(1, [6, 39, 1, 14, 21, 33])])
def test_the_terrain_is_one_surface_below_the_pavement(name: str | int) -> None:
    world = world_of(name)
    terrain = world.site.surfaces.terrain
    assert not len(gaps(terrain)), name
    rng, ground = np.random.default_rng(0), world.ground
    (x0, y0, x1, y1) = ground.way.box(120.0)
    xy = rng.uniform((x0, y0), (x1, y1), (3000, 2))
    z = MeshFaces([terrain]).height(xy)
    assert np.isfinite(z).all()
    inside_m = -ground.clearance(xy)
    over_m = MeshFaces(world.site.surfaces.pavement).height(xy) - z
    assert np.nanmin(over_m[inside_m > 0.2]) > 0, f"{name}: terrain over the pavement"
    near = (inside_m < -2.0) & (ground.way.away_at(xy) < 60)
    assert np.abs(ground.height(xy[near]) - z[near]).max() < 0.06
