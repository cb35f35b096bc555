"""Tar, removed lines and joints: on the road, below the paint, and along it far from every line."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synth3dlanes.world.paint import PAINT_LIFT_M
from synth3dlanes.world.seams import CLEAR_M, OLD_ASPHALT, WANDER_M, clear_lanes, joint
from synth3dlanes.world.world import resolve
from tests.map_scenes import FOUR_WAY, LEFT_TURN, map_scene, sections_road
from tests.scenes import changed, seen_on_flat_ground

ROADS = [
    {"topology": topology, "flip_longitudinal": across, "flip_lateral": along}
    for topology in (1, 2, 3, 4)
    for across, along in ((False, False), (True, True))
]
SEAMS = {"tar": 1.0, "ghost_lines": 1.0, "joint": 1.0}


def worlds(road, seeds=range(6)):
    scene = changed(road=road, surface=SEAMS, camera={"lane": 1})
    return [resolve(scene.model_copy(update={"seed": seed})) for seed in seeds]


def distance_from_lines(world, xy_world):
    """Of points to the nearest delimiter."""
    s = world.network.stations(np.arange(-150, 150, 0.1))
    lines = [line.xy_world(s[(s > line.start_m) & (s < line.end_m)]) for line in world.site.lines
             if line.kind == "delimiter"]  # fmt: skip
    return np.min([np.hypot(*(xy_world[:, None] - line).T).min(axis=0) for line in lines], axis=0)


@pytest.mark.parametrize("road", ROADS)
def test_what_runs_along_the_road_keeps_clear_of_every_line(road):
    for world in worlds(road, range(2)):
        half_m = world.scene.markings.width_m / 2
        ghost, tar = world.ghost_lines(world.view), world.tar(world.view)
        seen = seen_on_flat_ground(world, ghost.vertices_world[::8])
        assert distance_from_lines(world, seen[:, :2]).min() > CLEAR_M - half_m - 0.01
        faces = seen_on_flat_ground(world, tar.vertices_world)[tar.faces]
        along = np.ptp(faces[:, :, 1], axis=1) > 0.3
        middles = faces[along].mean(axis=1)[:, :2]
        assert distance_from_lines(world, middles[::4]).min() > CLEAR_M - WANDER_M - 0.05


@pytest.mark.parametrize("road", ROADS)
def test_seams_lie_on_the_main_road_below_the_paint(road):
    for world in worlds(road):
        for mesh in (world.ghost_lines(world.view), world.tar(world.view)):
            z = mesh.vertices_world[:, 2]
            near = np.abs(mesh.vertices_world[:, 1] - world.ground.way.near_m) < 40
            assert z.min() > 0
            assert z[near].max() < 0.7 * PAINT_LIFT_M[1]
            s, t = world.network.main.line.project(seen_on_flat_ground(world, mesh.vertices_world)[:, :2])
            drawn = world.scene.road
            half_m = drawn.n_lanes * drawn.lane_width_m / 2
            right = np.where(s < 0, half_m, drawn.n_main_after * drawn.lane_width_m - half_m)
            assert ((t > -half_m - 0.3) & (t < right + 0.3)).all()


def test_tar_and_ghost_lines_are_off_by_default_and_differ_by_scene():
    world = resolve(changed())
    assert world.tar(world.view) is None
    assert world.ghost_lines(world.view) is None
    sizes = {len(world.tar(world.view).faces) for world in worlds({}, range(10))}
    assert len(sizes) == 10
    assert resolve(changed(surface={"tar": 0.05})).tar(world.view) is None or min(sizes) > 100


@pytest.mark.parametrize("flip", [False, True])
def test_a_joint_lies_inside_a_lane_and_either_side_may_be_older(flip):
    found = [joint(world.network, 1.0, world.scene.stream) for world in worlds({"flip_longitudinal": flip}, range(40))]
    aside, darker = np.array(found).T
    assert (np.abs(aside[:, None] - [-5.25, -1.75, 1.75, 5.25]).min(axis=1) > CLEAR_M - 1e-6).all()
    assert np.unique(np.round(darker, 6)).tolist() == pytest.approx([1 - 1 / OLD_ASPHALT, 1 - OLD_ASPHALT])


MAPS = {"crossing": FOUR_WAY, "left turn": LEFT_TURN, "a lane that opens": sections_road()}


@pytest.mark.parametrize("name", MAPS)
def test_on_a_map_seams_lie_on_the_hosts_lanes_below_the_paint_and_clear_of_lines(name):
    scene = map_scene(MAPS[name], surface=SEAMS)
    world = resolve(scene)
    network, found = world.network, dict.fromkeys(("tar", "ghost"), 0)
    lanes = [lane for lane in network.lanes.values() if lane.direction == "same" and lane.junction is None]
    lines = np.concatenate([line.xy_world(np.arange(0.0, line.end_m, 0.1)) for line in network.delimiters])
    for kind, mesh in (("tar", world.tar(world.view)), ("ghost", world.ghost_lines(world.view))):
        seen = seen_on_flat_ground(world, mesh.vertices_world)[:, :2]
        near = world.ground.way.away_at(seen) < 40
        assert mesh.vertices_world[:, 2].min() > 0
        assert mesh.vertices_world[near, 2].max() < 0.7 * PAINT_LIFT_M[1]
        in_lane = np.zeros(len(seen), dtype=bool)
        for lane in lanes:
            road = network.road(lane.road)
            s, t = road.line.project(seen)
            left, right = lane.edges
            inside = (s > lane.start_m - 0.3) & (s < lane.end_m + 0.3)
            in_lane |= inside & (t > left(s) - 0.3) & (t < right(s) + 0.3)
        assert in_lane.all()
        # Cracks across the lanes cross lines; what runs along them keeps clear of these.
        middles = seen[mesh.faces].mean(axis=1)
        gaps_m, _ = cKDTree(lines).query(middles)
        is_along = gaps_m > CLEAR_M - WANDER_M - 0.05 - scene.markings.width_m / 2
        found[kind] = int(is_along.sum())
        assert is_along.all() or kind == "tar"
    assert min(found.values()) > 50


def test_a_lane_too_narrow_to_keep_clear_of_its_lines_has_no_removed_line():
    roads = sections_road()
    world = resolve(map_scene(roads, surface=SEAMS))
    names = {lane.id for at in world.network.host_stretches for lane in clear_lanes(world.network, at)}
    assert names == {"r.0.-1", "r.1.-1", "r.2.-1", "r.2.-2"}, "r.1.-2 opens from nothing"


def test_no_joint_runs_through_the_lanes_of_a_map():
    """Its texture begins anew on every road, so one joint would be in other places of these."""
    world = resolve(map_scene(FOUR_WAY, surface=SEAMS))
    assert joint(world.network, 1.0, world.scene.stream) == (0.0, 0.0)
