"""Maps as networks: paths, directions, links, lines and what drives on them."""

import numpy as np
import pytest

from synth3dlanes.roads.line_forms import Chain, Cubic, Spiral
from synth3dlanes.scene.scene import Car
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.motion import car_at
from synth3dlanes.world.world import resolve
from tests.map_scenes import ARM_M, FOUR_WAY, HALF_M, HILLS, LEFT_TURN, T_JUNCTION, WIDTH_M, map_scene, sections_road

MAPS = {"four way": FOUR_WAY, "left turn": LEFT_TURN, "T": T_JUNCTION, "sections": sections_road()}


@pytest.mark.parametrize("name", MAPS)
def test_every_lane_meets_its_successors(name):
    network = resolve(map_scene(MAPS[name], 40.0, terrain=HILLS.model_dump())).network
    for a, b in network.links:
        ends = []
        for lane, which in ((network.lanes[a], 1), (network.lanes[b], 0)):
            s = np.linspace(*lane.driven, 1001)[[-2, -1] if which else [0, 1]]
            ends.append(network.road(lane.road).points(s, lane.middle(s)))
        if (a, b) == ("r.0.-1", "r.1.-2"):  # opens beside its predecessor
            continue
        assert np.linalg.norm(ends[0][1] - ends[1][0]) < 0.01, (a, b)
        ways = [np.diff(end, axis=0)[0] / np.linalg.norm(np.diff(end, axis=0)) for end in ends]
        assert np.degrees(np.arccos(np.clip(ways[0] @ ways[1], -1, 1))) < 0.4, (a, b)


def test_direction_is_relative_to_the_host_on_its_roads_and_crossing_elsewhere():
    labels = ground_truth(map_scene(FOUR_WAY, 60.0))
    lanes = {lane.id: lane for lane in labels.lanes}
    same = {"south.0.1", "south_north.0.-1", "north.0.-1"}
    oncoming = {"south.0.-1", "north_south.0.-1", "north.0.1"}
    for lane in labels.lanes:
        if lane.kind == "centerline":
            expected = "same" if lane.id in same else "oncoming" if lane.id in oncoming else "crossing"
            assert (lane.id, lane.direction) == (lane.id, expected)
        ahead = lane.xyz_cam[-1, 1] - lane.xyz_cam[0, 1]
        assert lane.direction == "crossing" or ahead > 0, f"{lane.id} goes ahead"
    assert lanes["south.0.0.line"].left == "south.0.-1"
    assert lanes["south.0.0.line"].right == "south.0.1"
    assert (lanes["west.0.1"].left, lanes["west.0.1"].right) == ("west.0.0.line", "west.0.1.line")
    assert (lanes["south.0.-1"].left, lanes["south.0.-1"].right) == ("south.0.-1.line", "south.0.0.line")


def test_a_mark_of_two_stripes_is_told_from_the_left_as_its_line_goes():
    lanes = {lane.id: lane for lane in ground_truth(map_scene(sections_road(), 9.0)).lanes}
    middle = lanes["r.0.0.line"]
    assert (middle.marking, middle.double, middle.pair, middle.color) == ("solid", True, "solid_dashed", "yellow")
    assert lanes["r.0.-1.line"].marking == "solid"
    assert (lanes["r.1.-1.line"].marking, lanes["r.1.-1.line"].color) == ("dashed", "white")
    assert len(lanes["r.0.-1.line"].xyz_cam) > 90, "an edge line goes on along the lane that opens"


def test_neighbours_and_numbers_count_from_the_left_of_the_traffic():
    graph = ground_truth(map_scene(sections_road(), 60.0)).graph
    at = {segment.id: segment for segment in graph.segments}
    assert (at["r.2.-1"].lane, at["r.2.-1"].left, at["r.2.-1"].right) == (1, None, "r.2.-2")
    assert (at["r.2.-2"].lane, at["r.2.-2"].left, at["r.2.-2"].right) == (2, "r.2.-1", None)
    assert (at["r.1.1"].s_start_m, at["r.1.1"].s_end_m) == (110.0, 50.0)


ARC = Spiral(60.0, (3.0, -2.0), 0.7, 0.02)
SPIRAL = Spiral(80.0, (1.0, 5.0), -0.4, 0.01, -0.0006)
CUBIC = Cubic(50.0, (1.0, 0.9, 0.01, -0.0001), (2.0, 0.5, -0.004, 0.0002))
CHAIN = Chain.of([Spiral(30.0, (0.0, 0.0), 0.2), Spiral(40.0, (30 * np.cos(0.2), 30 * np.sin(0.2)), 0.2, 0.0, 0.001)])
LINES = [Spiral(50.0, (0.0, 1.0), 1.1), ARC, SPIRAL, CUBIC, CHAIN]


@pytest.mark.parametrize("line", LINES)
def test_normals_speed_and_turn_are_those_of_the_points(line):
    s, h = np.linspace(1, 49, 97), 1e-4
    s = s[np.abs(s - 30) > 1e-3] if line is CHAIN else s
    before, here, after = (line.frames(s + step) for step in (-h, 0, h))
    step = (after.points_world - before.points_world) / (2 * h)
    np.testing.assert_allclose(here.speed, np.linalg.norm(step, axis=1), rtol=1e-6)
    right = np.stack([step[:, 1], -step[:, 0]], -1) / here.speed[:, None]
    np.testing.assert_allclose(here.normals, right, atol=1e-6)
    heading = [np.unwrap(np.arctan2(at.normals[:, 1], at.normals[:, 0])) for at in (before, after)]
    np.testing.assert_allclose(here.turn, -(heading[1] - heading[0]) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("line", LINES)
def test_places_are_found_again_and_t_grows_to_the_right(line):
    s = np.linspace(1, line.length_m - 1, 60)
    for t in (-6.0, 0.0, 9.0):
        back_s, back_t = line.project(line.xy(s, t))
        np.testing.assert_allclose([back_s, back_t], [s, np.full(60, t)], atol=1e-6)
    ahead, aside = line.xy(s + 0.1, 0.0) - line.xy(s, 0.0), line.xy(s, 1.0) - line.xy(s, 0.0)
    assert (ahead[:, 0] * aside[:, 1] - ahead[:, 1] * aside[:, 0] < 0).all()


def test_a_polyline_runs_through_its_points_by_length():
    points = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 14.0], [11.0, 20.0]])
    line = Chain.through(points)
    np.testing.assert_allclose(line.frames(np.array([0.0, 5.0, 15.0, 25.0])).points_world, points, atol=1e-9)
    np.testing.assert_allclose(line.frames(np.array([10.0])).points_world, [[3.0, 9.0]], atol=1e-9)


TRACK = ((0.0, 0.0), (2.0, 18.0), (4.0, 28.5), (6.0, 28.5), (10.0, 70.0))
CAR = {
    "model": 1, "scale": 1.0, "color": (0.8, 0.1, 0.1), "gloss": 0.5, "lane": "east.0.1", "s_m": 30.0,
    "route": ("east_south.0.-1", "south.0.-1"), "track": TRACK,
}  # fmt: skip
RADIUS_M = HALF_M + WIDTH_M / 2


def frame(time_s: float, **parts):
    shot = {"frame": round(time_s * 10), "n_frames": 110, "fps": 10.0, "speed_m_s": 8.0}
    return resolve(map_scene(LEFT_TURN, 90.0, shot=shot, **parts))


def test_the_host_drives_its_route_and_looks_along_its_tangent():
    for time_s in np.arange(0, 10, 0.7):
        pose, driven_m = frame(float(time_s)).view.world_from_host, 90 + 8 * round(time_s * 10) / 10
        turning_m = driven_m - ARM_M
        if turning_m < 0:
            place, heading = [WIDTH_M / 2, -HALF_M + turning_m], [0, 1]
        elif turning_m < RADIUS_M * np.pi / 2:
            a = turning_m / RADIUS_M
            place = [WIDTH_M / 2 - RADIUS_M * (1 - np.cos(a)), -HALF_M + RADIUS_M * np.sin(a)]
            heading = [-np.sin(a), np.cos(a)]
        else:
            place, heading = [-HALF_M - turning_m + RADIUS_M * np.pi / 2, WIDTH_M / 2], [-1, 0]
        np.testing.assert_allclose(pose[:2, 3], place, atol=0.002)
        np.testing.assert_allclose(pose[:2, 1], heading, atol=2e-3)


def test_a_car_is_at_the_lengths_of_its_track_and_never_drives_back():
    network = frame(0.0, cars=(CAR,)).network
    car = frame(0.0, cars=(CAR,)).scene.cars[0]
    way, start_m = network.car_way(car)
    line = way.points_world(np.linspace(0, way.end_m, 40_000))
    lengths_m = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    places = []
    for time_s, length_m in TRACK:
        at = car_at(network, car, time_s)
        lane = network.lanes[at.lane]
        s = np.array([at.s_m])
        places.append(network.road(lane.road).points(s, lane.middle(s))[0])
        expected = [np.interp(start_m + length_m, lengths_m, line[:, k]) for k in (0, 1, 2)]
        np.testing.assert_allclose(places[-1], expected, atol=0.01)
    assert (places[2] == places[3]).all(), "it waits"

    def along_m(at: Car) -> float:
        return network.car_way(at)[1] + {"east.0.1": 0, "east_south.0.-1": 120, "south.0.-1": 142}[at.lane]

    driven = [car_at(network, car, float(t)) for t in np.arange(0, 10, 0.25)]
    assert (np.diff([along_m(at) for at in driven]) >= -1e-6).all()
    for time_s in (1.0, 3.0, 8.0):
        before_m, after_m = (along_m(car_at(network, car, time_s + step_s)) for step_s in (-0.01, 0.01))
        assert car_at(network, car, time_s).speed_m_s == pytest.approx((after_m - before_m) / 0.02, rel=0.01)
    assert [at.lane for at in driven][-1] == "south.0.-1"
    assert all(at.speed_m_s == 0 for at in driven[17:24]), "with no speed"
