"""What the ground hides, the height map, and labels on both sides of the host."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.params import load_params
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.world.height_map import cells_road, height_map
from synth3dlanes.world.horizon import HILLS_FROM_M
from synth3dlanes.world.visibility import TOLERANCE_M, _behind_crests, seen_over_ground
from synth3dlanes.world.world import resolve
from tests.scenes import changed, hill


def seen(scene, eye, points):
    return seen_over_ground(resolve(scene).ground, np.array(eye, dtype=float), np.array(points, dtype=float))


def test_a_crest_hides_the_road_behind_it_and_not_the_road_before_it():
    scene = changed(terrain={"gaussians": (hill(0, 0, 8, 25),)})
    heights = resolve(scene).ground.height(np.array([[0.0, -60], [0, -20], [0, 50]]))
    before, behind = seen(scene, [0, -60, heights[0] + 1.5], [[0, -20, heights[1]], [0, 50, heights[2]]])
    assert before
    assert not behind


@settings(max_examples=25)
@given(st.floats(2, 15), st.floats(0.1, 10), st.floats(20, 60))
def test_raising_the_terrain_between_a_fixed_eye_and_fixed_points_never_reveals(magnitude, more, sd):
    points = [[x, y, 1.0] for x in (-20, -3, 0, 3, 20) for y in (30, 60, 90)]
    low, high = (
        seen(changed(terrain={"gaussians": (hill(0, 0, height, sd),)}), [0, -60, 6.0], points)
        for height in (magnitude, magnitude + more)
    )
    assert not (high & ~low).any()


def test_a_raised_exit_hides_the_ground_behind_it():
    """From the main road, what lies beyond the exit's embankment at ground level is hidden; above it is not."""
    road = {"topology": 2, "exit_offset_m": 10, "ramp_height_m": 4, "ramp_slope": 2}
    raised = resolve(changed(road=road)).network.road("exit")
    s = np.array([raised.ramp.start_m + 15])
    beyond = raised.xy(s, 20.0)[0]
    eye = [0, s[0], 1.5]
    low, high = seen(changed(road=road), eye, [[*beyond, 0.0], [*beyond, 12.0]])
    assert high
    assert not low


def is_below(eye, to, crest):
    """Whether a line of sight passes below any step of a crest, each by a linear system of its own."""
    for start, end in pairwise(crest):
        share, place = np.linalg.solve(np.stack([to[:2], (start - end)[:2]], axis=1), (start - eye)[:2])
        top_m = (start + place * (end - start))[2] - TOLERANCE_M
        if 0 < share < 1 and 0 <= place <= 1 and (eye + share * to)[2] < top_m:
            return True
    return False


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(-3.2, 3.2), st.floats(0.3, 9))
def test_a_crest_hides_the_same_whatever_its_direction_even_all_around(seed, first_rad, turn_rad):
    """Kerbs to all sides of the eye and around it, past the direction where angles jump."""
    rng = np.random.default_rng(seed)
    angle = first_rad + np.linspace(0, turn_rad, 12)
    away_m = rng.uniform(5, 30, 12)
    eye = np.array([3.0, -7.0, 1.5])
    crest = np.column_stack([eye[0] + away_m * np.cos(angle), eye[1] + away_m * np.sin(angle), rng.uniform(0, 2, 12)])
    to = np.column_stack([rng.uniform(-60, 60, (80, 2)), rng.uniform(-1.5, 0, 80)])
    assert _behind_crests(eye, to, [crest]).tolist() == [is_below(eye, way, crest) for way in to]


def test_lane_points_lie_on_the_map():
    scene = changed(
        terrain={"gaussians": (hill(20, 0, 8, 50), hill(-40, -60, -9, 60))},
        road={"topology": 2, "offset_p50_m": 4, "ramp_slope": 4},
    )
    world = resolve(scene)
    heights = height_map(world.ground, world.view.world_from_road)
    read = RegularGridInterpolator(
        (0.2 + 0.4 * np.arange(200), -9.9 + 0.2 * np.arange(100)), heights[::-1], bounds_error=False
    )
    labels = ground_truth(scene)
    gaps = []
    for lane in labels.lanes:
        if lane.kind == "centerline" and lane.road == "main":
            points = transform(labels.camera.road_from_cam, lane.xyz_cam)
            gaps.append(read(points[:, [1, 0]]) - points[:, 2])
    gaps = np.abs(np.concatenate(gaps))
    assert np.isfinite(gaps).sum() > 100
    assert np.nanmax(gaps) < 0.01


@pytest.mark.parametrize(("seed", "index"), [(7, 2), (771105, 13), (88101, 6), (8300000, 6)])
def test_every_cell_of_a_steep_ramp_or_hill_is_on_it(seed, index):
    """Of a ramp that rises 1 in 2.4, of a hillside as steep as 1 in 0.1 to the tilted plane of its road, of one that
    hangs over it, and of a valley's side that climbs 115 m over it."""
    world = sample_world(Scenes(load_params("appendix_i"), seed, "train"), index)
    points_world = transform(
        world.view.world_from_road, cells_road(height_map(world.ground, world.view.world_from_road))
    )
    np.testing.assert_allclose(points_world[:, 2], world.ground.height(points_world[:, :2]), atol=1e-3)


HILLS = (hill(30, 60, 9, 40), hill(30, -60, 9, 40), hill(-20, 0, -6, 35))
BENDS = {"offset_m50_m": 4.0, "offset_p50_m": 4.0, "offset_m100_m": 5.0, "offset_p100_m": 5.0}


def test_every_surface_is_its_own_mirror():
    """Of a scene that a mirror of y leaves unchanged, with the host in the middle; nearer than the background beyond
    every label, which is not the same both ways."""
    parts = {"terrain": {"gaussians": HILLS}, "road": BENDS, "shot": {"behind_m": 110.0}}
    world = resolve(changed(**parts, camera={"y_m": 0.0, "pitch_rad": 0.02}, markings={"dash_fraction": 1.0}))
    paint, terrain = list(world.paint(world.view).values()), world.site.surfaces.terrain.vertices_world
    places = [mesh.vertices_world[mesh.faces].mean(axis=1) for mesh in [*world.site.surfaces.pavement, *paint]]
    # Below pavement the terrain is cut along simplified lines.
    for xyz in [terrain[world.ground.clearance(terrain[:, :2]) > 0.5], *places]:
        near = xyz[np.hypot(*xyz[:, :2].T) < HILLS_FROM_M - 110]
        assert len(near) > 400
        assert cKDTree(near).query(near * [1, -1, 1])[0].max() < 2e-3
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
