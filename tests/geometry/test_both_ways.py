"""For cameras that look back a world is as good behind the host as ahead of it, and for a clip wherever it drives."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.horizon import DAM_FROM_M
from synth3dlanes.world.meshes import Mesh
from synth3dlanes.world.world import World, resolve
from tests.scenes import changed, hill

HILLS = (hill(30, 60, 9, 40), hill(30, -60, 9, 40), hill(-20, 0, -6, 35))
BENDS = {"offset_m50_m": 4.0, "offset_p50_m": 4.0, "offset_m100_m": 5.0, "offset_p100_m": 5.0}


def same_both_ways(**parts) -> World:
    """A host at the middle of a scene that a mirror of y leaves unchanged."""
    parts = {"terrain": {"gaussians": HILLS}, "road": BENDS, "shot": {"behind_m": 110.0}} | parts
    return resolve(changed(**parts | {"camera": {"y_m": 0.0, "pitch_rad": 0.02} | parts.get("camera", {})}))


def near_places(mesh: Mesh) -> np.ndarray:
    """The middles of a mesh's faces nearer than the background beyond every label, which is not the same both ways."""
    middles = mesh.vertices_world[mesh.faces].mean(axis=1)
    return middles[np.hypot(*middles[:, :2].T) < DAM_FROM_M - 10]


def test_every_surface_is_its_own_mirror():
    world = same_both_ways(markings={"dash_fraction": 1.0})
    paint = list(world.paint(world.view).values())
    for mesh in [world.site.surfaces.terrain, *world.site.surfaces.verges, *world.site.surfaces.pavement, *paint]:
        middles = near_places(mesh)
        assert len(middles) > 400
        assert cKDTree(middles).query(middles * [1, -1, 1])[0].max() < 2e-3
    assert min(np.ptp(mesh.vertices_world[:, 1]) for mesh in [*world.site.surfaces.pavement, *paint]) > 7900


def test_labels_go_on_behind_the_host_without_a_step():
    road = {"topology": 2, "offset_m50_m": 5.0, "offset_p50_m": -3.0}
    ahead, both = (
        label(world, world.view)
        for world in (resolve(changed(road=road, shot={"behind_m": behind_m})) for behind_m in (0.0, 110.0))
    )
    for one, other in zip(ahead.lanes, both.lanes, strict=True):
        n_behind = len(other.xyz_cam) - len(one.xyz_cam)
        assert n_behind == (110 if other.xyz_cam[0, 1] < -100 else 0)
        np.testing.assert_array_equal(other.xyz_cam[n_behind:], one.xyz_cam)
        np.testing.assert_array_equal(other.in_image[n_behind:], one.in_image)
    through = next(lane for lane in both.lanes if lane.id == "main_2")
    steps_m = np.linalg.norm(np.diff(through.xyz_cam, axis=0), axis=1)
    assert np.abs(steps_m - 1).max() < 0.05


def test_a_clip_is_as_good_from_its_first_place_to_its_last():
    driven_m, parts = 40.0, {"road": {"topology": 1} | BENDS, "terrain": {"gaussians": HILLS}}
    clip = resolve(changed(**parts, shot={"n_frames": 21, "fps": 10.0, "speed_m_s": driven_m / 2}))
    ground, way = clip.ground, clip.ground.way
    assert way.driven_m == pytest.approx(driven_m, abs=1.0)
    for y_m in (way.near_m, way.near_m + way.driven_m / 2, way.near_m + way.driven_m):
        alone = resolve(changed(**parts, camera={"y_m": y_m})).ground
        outside = np.array(ground.paved.grid.area) - alone.paved.grid.area
        assert outside[:2].max() < 0.1
        assert outside[2:].min() > -0.1
        xy = clip.network.main.xy(y_m + np.linspace(-30, 400, 500), 0.0)
        assert (way.away_at(xy) <= alone.way.away_at(xy) + 1e-9).all()


def test_lanes_behind_on_the_inside_of_a_bend_go_on_to_their_end():
    road = {"topology": 2, "flip_lateral": True, "offset_m50_m": -0.2, "offset_p50_m": -1.4, "offset_m100_m": 3.4}
    road |= {"offset_p100_m": 2.2, "exit_angle_rad": 0.0867, "exit_offset_m": 1.7, "lane_width_m": 3.73}
    world = resolve(changed(road=road, camera={"y_m": -79.3, "lane": 3}, shot={"behind_m": 110.0}))
    stations = world.network.lines.stations_along(world.network.road("exit"), -79.3, np.arange(-110.0, 111.0))
    assert np.diff(stations).min() > 0.5
    for lane in label(world, world.view).lanes:
        assert np.linalg.norm(np.diff(lane.xyz_cam, axis=0), axis=1).min() > 0.01
