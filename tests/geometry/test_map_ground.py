"""The ground of maps: one surface without gaps or steps, terrain that meets it, kerbs, heights."""

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.road_map import MapIsland, Polynomial, RoadMap
from synth3dlanes.system.arrays import Points3
from synth3dlanes.validate.faces import MeshFaces
from synth3dlanes.world.meshes import Mesh
from synth3dlanes.world.world import World, resolve
from tests.map_scenes import (
    ARM_M,
    FOUR_WAY,
    HALF_M,
    HILLS,
    LEFT_TURN,
    T_JUNCTION,
    WIDTH_M,
    crossing,
    map_scene,
    sections_road,
)
from tests.thorough import first

ISLAND = MapIsland(outline=((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)), height_m=0.2, surface="grass")


@pytest.fixture(scope="module")
def world():
    roads = crossing(("south", "north", "east", "west"), ("south", "north"), islands=(ISLAND,))
    return resolve(map_scene(roads, 95.0, terrain=HILLS.model_dump()))


def lane_points(world, aside_m):
    """Places along all lanes of traffic, so far from their middles."""
    found = []
    for lane in world.network.lanes.values():
        s = np.arange(lane.start_m + 0.05, lane.end_m, 0.31)
        found.append(world.network.road(lane.road).xy(s, lane.middle(s) + aside_m))
    xy = np.concatenate(found)
    near = np.hypot(xy[:, 0], xy[:, 1] + HALF_M) < 60
    island = np.abs(xy).max(axis=1) < 1.1
    return xy[near & ~island]


@pytest.mark.parametrize("aside_m", [-1.7, -0.6, 0.0, 1.7])
def test_the_pavement_is_one_surface_on_the_terrain_without_steps(world, aside_m):
    xy = lane_points(world, aside_m)
    z = MeshFaces(world.site.surfaces.pavement).height(xy)
    assert np.isfinite(z).all(), "lanes are paved throughout"
    np.testing.assert_allclose(z, height_at(HILLS, xy), atol=0.01)
    np.testing.assert_allclose(world.ground.height(xy), height_at(HILLS, xy), atol=1e-9)


def test_walkways_and_islands_are_raised(world):
    arm, s = world.network.road("north"), np.linspace(2, 40, 20)
    middle = arm.xy(s, arm.right(s) - 1.0)
    np.testing.assert_allclose(world.ground.above_terrain(middle), 0.12)
    np.testing.assert_allclose(
        MeshFaces(world.site.surfaces.pavement).height(middle) - height_at(HILLS, middle), 0.12, atol=0.01
    )
    on = np.array([[0.0, 0.0], [0.7, -0.6]])
    np.testing.assert_allclose(world.ground.above_terrain(on), 0.2)
    np.testing.assert_allclose(
        MeshFaces(world.site.surfaces.pavement).height(on) - height_at(HILLS, on), 0.2, atol=0.01
    )


def test_clearance_is_the_distance_from_the_nearest_edge(world):
    half_m = WIDTH_M + 0.4 + 2.0
    xy = np.array([[half_m + 1.5, -60.0], [0.0, -60.0], [-60.0, half_m + 3.0], [1.0, HALF_M + ARM_M + 4.0]])
    assert world.ground.clearance(xy) == pytest.approx([1.5, -half_m, 3.0, 4.0], abs=0.01)


def test_roads_with_heights_leave_the_terrain_and_fall_to_it_beside_their_edges():
    values = sections_road().model_dump()
    values["roads"][0]["heights"] = (Polynomial(s_m=0.0, a=2.0, b=0.03).model_dump(),)
    values["roads"][0]["banks"] = (Polynomial(s_m=0.0, a=0.02).model_dump(),)
    world = resolve(map_scene(RoadMap.model_validate(values), 9.0))
    road, s = world.network.road("r"), np.linspace(2, 45, 30)
    for t in (-2.0, 0.0, 2.5):
        expected = 2 + 0.03 * s - np.tan(0.02) * t
        xy = road.xy(s, t)
        np.testing.assert_allclose(road.points(s, t)[:, 2], expected, atol=1e-9)
        np.testing.assert_allclose(world.ground.height(xy), expected, atol=1e-6)
        np.testing.assert_allclose(MeshFaces(world.site.surfaces.pavement).height(xy), expected, atol=0.01)
    edge = road.right(s)
    for away_m in (1.0, 3.0, 20.0):
        top = 2 + 0.03 * s - np.tan(0.02) * edge
        expected = np.maximum(top - max(away_m - 1.5, 0) / 1.5, 0)
        np.testing.assert_allclose(world.ground.height(road.xy(s, edge + away_m)), expected, atol=0.01)
    pose = world.view.world_from_host
    assert pose[2, 3] == pytest.approx(2 + 0.03 * 9 - np.tan(0.02) * 1.8, abs=0.01)
    assert pose[2, 1] == pytest.approx(0.03, abs=2e-3), "it climbs"
    assert pose[2, 0] == pytest.approx(-0.02, abs=2e-3), "and leans to the right"


def test_what_is_far_from_the_host_is_left_out():
    values = FOUR_WAY.model_dump()
    far = [dict(road, id=f"far_{road['id']}", junction=None) for road in values["roads"] if not road["junction"]]
    for road in far:
        road["plan"] = tuple(dict(piece, x_m=piece["x_m"] + 3000) for piece in road["plan"])
    both = RoadMap.model_validate(values | {"roads": (*values["roads"], *far)})
    near, more = (resolve(map_scene(roads, 95.0)) for roads in (FOUR_WAY, both))
    assert [road.id for road in more.network.roads] == [road.id for road in near.network.roads]
    xy = np.random.default_rng(0).uniform(-80, 80, (500, 2))
    np.testing.assert_array_equal(near.ground.height(xy), more.ground.height(xy))


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
