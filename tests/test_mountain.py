"""Mountain roads: radii, grades and widths as declared, and labels against an evaluation of the map of our own."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world
from synth3dlanes.formats.comparing import Rule, SourceSample
from synth3dlanes.formats.comparing_maps import compare_map
from synth3dlanes.formats.lane_map import lane_segments
from synth3dlanes.formats.lanelet2 import lanelets_of
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.road_map import MapRoad
from synth3dlanes.scene.scene import Scene
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.world import resolve
from tests.thorough import first
from tests.town_checks import MapReader, values

FEW = ("cars.n=0", "trees.n=0")
STEP_M = 0.01


@cache
def mountain(index: int, *overrides: str) -> Scene:
    return sample_scene(Scenes(load_params("mountain", [*FEW, *overrides]), 7), index)


def road_of(scene: Scene) -> MapRoad:
    assert scene.map is not None
    return scene.map.roads[0]


def axis(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Stations a centimetre apart, and x, y and heading of the reference line there, by small steps."""
    assert scene.map is not None
    stations, xy, headings = MapReader(scene.map).lines[scene.map.roads[0].id]
    s = np.arange(0.0, stations[-1], STEP_M)
    x, y, heading = (np.interp(s, stations, of) for of in (*xy.T, headings))
    return s, x, y, heading


@pytest.mark.parametrize("index", first(3, range(12)))
def test_bends_and_grades_are_as_declared(index: int) -> None:
    scene = mountain(index)
    road = road_of(scene)
    arcs = [piece for piece in road.plan if piece.curvature and piece.curvature == piece.curvature_end]
    assert 3 <= len(arcs) <= 5
    assert all(12 <= abs(1 / arc.curvature) <= 20 for arc in arcs)
    signs = np.sign([arc.curvature for arc in arcs])
    assert (signs[1:] == -signs[:-1]).all(), "bends alternate"
    s, _, _, heading = axis(scene)
    _, grades = values(road.heights, s)
    assert 0.06 - 1e-6 < grades.min() < grades.max() < 0.10 + 1e-6, "the road climbs everywhere"
    assert np.abs(np.diff(grades)).max() < 1e-4, "no kinks"
    turned = np.abs(np.diff(heading[np.searchsorted(s, ends(road))]))
    assert ((turned > 1e-3) == legs(road)).all(), "the middle line is solid in bends alone"
    assert legs(road) == [i % 2 == 1 for i in range(len(turned))]
    assert (np.degrees(turned[np.array(legs(road))]) > 140).all()
    assert (np.degrees(turned[np.array(legs(road))]) < 168).all()


def test_the_host_stands_anywhere_from_where_it_sees_the_road_behind_to_where_it_sees_the_road_ahead() -> None:
    scenes = [mountain(1, f"mountain.host_place={share}") for share in (0, 0.5, 1)]
    first_m, middle_m, last_m = (scene.camera.y_m for scene in scenes)
    length_m = sum(piece.length_m for piece in road_of(scenes[0]).plan)
    assert (first_m, length_m - last_m) == pytest.approx((30, 150), abs=1e-3)
    assert middle_m == pytest.approx((first_m + last_m) / 2, abs=1e-3)


def ends(road: MapRoad) -> list[float]:
    """Where sections begin, and the end of the last one."""
    return [*(section.s_m for section in road.sections), road.length_m - 0.02]


def legs(road: MapRoad) -> list[bool]:
    """Which sections are bends, by their dividing line."""
    divider = [next(lane.marks[0].kind for lane in section.lanes if lane.number == 0) for section in road.sections]
    return [kind == "solid" for kind in divider]


@pytest.mark.parametrize("descent", ["false", "true"])
def test_labels_are_the_lanes_of_the_map(descent: str) -> None:
    """The centre line of the host's lane lies on the middle of the lane, to a millimetre in all three coordinates."""
    scene = mountain(1, f"mountain.descent={descent}", "mountain.lay_by=true", "terrain.n_gaussians=3")
    road = road_of(scene)
    s, x, y, heading = axis(scene)
    widths = np.zeros(len(s))
    sign = 1 if descent == "true" else -1
    for section, (from_m, to_m) in zip(road.sections, zip(ends(road), ends(road)[1:], strict=False), strict=True):
        here = (s >= from_m) & (s <= to_m)
        own = next(lane for lane in section.lanes if lane.number == sign)
        widths[here] = values(own.widths, s[here] - from_m)[0]
    t = sign * widths / 2
    middle = np.column_stack([x - t * np.sin(heading), y + t * np.cos(heading), values(road.heights, s)[0]])
    world = resolve(scene)
    labels = label(world, world.view)
    lines = [lane for lane in labels.lanes if lane.kind == "centerline" and lane.direction == "same"]
    assert lines
    for lane in lines:
        points = transform(labels.camera.world_from_cam, lane.xyz_cam)
        nearest = cKDTree(middle).query(points)[0]
        assert nearest.max() < STEP_M, "no farther than the steps of the evaluation"
        assert np.median(nearest) < 0.006
    (own_line,) = [lane for lane in lines if len(lane.xyz_cam) == max(len(each.xyz_cam) for each in lines)]
    points = transform(labels.camera.world_from_cam, own_line.xyz_cam)
    assert np.sign(points[-1, 2] - points[0, 2]) == -sign, "up on the right of growing s, down on its left"


@pytest.mark.parametrize("index", first(2, range(8)))
def test_rails_stand_on_the_valley_side_and_outside_bends(index: int) -> None:
    scene = mountain(index, "mountain.rail=guardrail")
    road, rails = road_of(scene), scene.roadside.rails
    s, *_ = axis(scene)
    z, bends = values(road.heights, s)[0], [i for i, is_bend in enumerate(legs(road)) if is_bend]
    assert len(rails) == len(bends) + 1
    stations = ends(road)
    for i in bends:
        bent_left = next(p.curvature for p in road.plan if p.curvature == p.curvature_end and p.curvature) > 0
        bent_left ^= i % 4 == 3
        at = np.searchsorted(s, (stations[i] + stations[i + 1]) / 2)
        (rail,) = [rail for rail in rails if rail.from_m <= s[at] <= rail.to_m]
        assert rail.side == ("right" if bent_left else "left"), "outside the bend"
        leg, after = (np.searchsorted(s, stations[k] + 1.0) for k in (i, i + 1))
        assert z[after] > z[leg], "the leg behind the bend is higher: the valley is on the other side"


def test_a_lay_by_lies_beside_the_right_lane_and_closes_again() -> None:
    kinds = [
        (lane, section)
        for section in road_of(mountain(2, "mountain.lay_by=true", "mountain.leg_m=90")).sections
        for lane in section.lanes
        if lane.kind == "parking"
    ]
    ((lane, _),) = kinds
    s = np.linspace(0, 90, 901)
    width = values(lane.widths, s)[0]
    assert lane.number == -2
    assert width[0] == width[-1] == 0
    assert width.min() > -1e-9
    assert width.max() == pytest.approx(2.75)
    assert np.abs(np.diff(width)).max() < 0.05, "tapers"


def test_the_ground_meets_the_road() -> None:
    scenes = Scenes(load_params("mountain", FEW), 7)
    for index in (0, 4, 8):
        world = sample_world(scenes, index)
        xyz = world.network.way.points_world(world.scene.camera.y_m + np.arange(0.0, 120.0, 0.5))  # type: ignore[attr-defined]
        assert np.abs(world.ground.height(xyz[:, :2]) - xyz[:, 2]).max() < 0.02


def test_every_lane_of_a_road_of_half_a_kilometre_is_a_lanelet() -> None:
    world = resolve(mountain(0))
    assert max(lane.end_m for lane in world.network.lanes.values()) > 400
    found, lost = lanelets_of(world)
    assert set(found.pieces) == set(world.network.lanes)
    assert lost == 0


class Truth(SourceSample):
    """Labels that no file has."""

    def __init__(self, labels: Labels) -> None:
        self.labels = labels


@pytest.mark.parametrize("aside_m", [0.0, 0.3])
def test_lanes_of_a_map_are_compared_where_the_labels_reach_and_not_with_the_next_leg(aside_m: float) -> None:
    world = resolve(mountain(1))
    labels = label(world, world.view)
    foot = labels.camera.world_from_cam[:3, 3]
    segments = lane_segments(world, labels.graph.segments, foot, 300.0)
    lanes = [(segment.id, np.add(segment.points_world, [aside_m, 0.0, 0.0])) for segment in segments]
    compared = compare_map(lanes, Truth(labels), Rule("m", 0.05, name="lane", slack=0.3))
    assert compared.outside["lane"] > 0, "the road goes on beyond the labels"
    assert bool(compared.problems) == (aside_m > 0), compared.problems[:3]


@pytest.mark.parametrize("aside_m", [-0.06, 0.0, 0.06])
def test_a_lane_of_a_sharp_bend_is_compared_with_the_arc_through_the_points_of_labels(aside_m: float) -> None:
    world = resolve(mountain(1))
    labels = label(world, world.view)
    segment = next(segment for segment in labels.graph.segments if segment.centerlines)
    lane = next(lane for lane in labels.lanes if lane.id == segment.centerlines[0])

    def bend(step_m: float, radius_m: float) -> np.ndarray:
        at = np.arange(0, 4, step_m / 2.4)
        return np.column_stack([radius_m * np.cos(at), radius_m * np.sin(at), np.zeros(len(at))])

    points = transform(np.linalg.inv(labels.camera.world_from_cam), bend(1.0, 2.4))
    flags = np.ones(len(points), dtype=bool)
    arc = replace(lane, xyz_cam=points, in_image=flags, terrain_visible=flags, direction="same")
    found = [(segment.id, bend(0.1, 2.4 + aside_m))]
    compared = compare_map(found, Truth(replace(labels, lanes=(arc,))), Rule("m", 0.05, name="lane", slack=0.3))
    assert bool(compared.problems) == (aside_m != 0), compared.problems
