"""Traffic both ways: oncoming lanes by a second reading of the rules from the JSON files; how their cars drive and
others park; what labels and files say of it."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.labels import labels as label_file
from synth3dlanes.params.params import load_params
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.scene.assets.catalogue import CARS
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.placement import car_place
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT
from tests.thorough import first

Y = np.arange(-100, 100.0001, 0.02)
TWO_WAY = ["trees.n=0", "road.n_oncoming=[1, 3]", "road.median_m={0: 1, 2: 1, 6: 1}", "road.n_lanes=[1, 3]"]


def drawn(index, *changes, split="train"):
    return sample_scene(Scenes(load_params("realistic", [*TWO_WAY, *changes]), 4711, split), index)


def both(scene):
    return json.loads(scene_file.to_json(scene)), json.loads(label_file.to_json(ground_truth(scene)))


def plan_line(scene, offset_m):
    """World polyline at an offset to the right of the main road's middle in the plan, which the flips mirror."""
    r = scene["road"]
    knots = [r["offset_m50_m"] + r["offset_m100_m"], r["offset_m50_m"], 0, r["offset_p50_m"],
             r["offset_p50_m"] + r["offset_p100_m"]]  # fmt: skip
    main = np.column_stack([np.polyval(np.polyfit([-1, -0.5, 0, 0.5, 1], knots, 4), Y / 100), Y])
    step = np.gradient(main, axis=0)
    right = np.column_stack([step[:, 1], -step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]
    flips = [-1 if r["flip_longitudinal"] else 1, -1 if r["flip_lateral"] else 1]
    return (main + offset_m * right) * flips


def off(lane, labels, line):
    """Largest distance of a lane's points from a polyline, seen from above."""
    world_from_cam = np.array(labels["camera"]["world_from_cam"])
    points = np.array(lane["xyz_cam"]) @ world_from_cam[:3, :3].T + world_from_cam[:3, 3]
    inside = np.abs(points[:, 1]) < 90
    return cKDTree(line).query(points[inside, :2])[0].max(initial=0)


@pytest.mark.parametrize("index", first(4, range(30)))
def test_oncoming_lanes_lie_beyond_the_median_on_the_side_opposite_the_exit(index):
    scene, labels = both(drawn(index, "cars.n=0"))
    r = scene["road"]
    n, w, count, median = r["n_lanes"], r["lane_width_m"], r["n_oncoming"], r.get("median_m", 0)
    lanes = {lane["id"]: lane for lane in labels["lanes"]}
    for k in range(1, count + 1):
        name = f"oncoming_{k if r['flip_longitudinal'] else count + 1 - k}"
        inwards = n / 2 * w + median  # from the middle of the host's lanes to the first oncoming one
        assert off(lanes[name], labels, plan_line(scene, -(inwards + (k - 0.5) * w))) < 0.02, (name, k)
        assert lanes[name]["direction"] == "oncoming"
    lines = sorted(lane["id"] for lane in labels["lanes"] if lane["id"].startswith("oncoming_line"))
    assert len(lines) == (count + 1 if median else count), "without a median one line divides both directions"
    same = [lane for lane in labels["lanes"] if not lane["id"].startswith("oncoming")]
    assert {lane["direction"] for lane in same} == {"same"}


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("median_m", [0.0, 4.0])
def test_neighbours_are_as_the_host_sees_them(flip, median_m):
    road = FLAT.road.model_copy(update={"n_lanes": 2, "n_oncoming": 2, "median_m": median_m, "flip_longitudinal": flip})
    camera = FLAT.camera.model_copy(update={"lane": 1})
    labels = ground_truth(FLAT.model_copy(update={"road": road, "camera": camera}))
    lanes = {lane.id: lane for lane in labels.lanes}
    x = {name: float(lane.xyz_cam[20, 0]) for name, lane in lanes.items()}
    for lane in lanes.values():
        for side, sign in ((lane.left, -1), (lane.right, 1)):
            if side is not None:
                assert sign * (x[side] - x[lane.id]) == pytest.approx(1.75, abs=1e-3), (lane.id, side)
    for segment in labels.graph.segments:
        for side, sign in ((segment.left, -1), (segment.right, 1)):
            if side is not None:
                assert sign * (x[side] - x[segment.id]) == pytest.approx(3.5, abs=1e-3)
        is_oncoming = segment.id.startswith("oncoming")
        assert (segment.s_end_m < segment.s_start_m) == is_oncoming, "segments run in their own driving direction"
    is_left = x["oncoming_1"] < x["main_1"]
    assert is_left != flip, "right-hand traffic, or left-hand traffic in the mirrored world"


def test_the_divider_bounds_both_directions_and_is_painted_as_the_scene_says():
    def divider(**changes):
        road = FLAT.road.model_copy(update={"n_oncoming": 1, **changes})
        marks = FLAT.markings.model_copy(update={"left_yellow": True, "left_double": True})
        labels = ground_truth(FLAT.model_copy(update={"road": road, "markings": marks}))
        return {lane.id: lane for lane in labels.lanes if lane.kind == "delimiter"}

    solid = divider()["main_line_0"]
    assert (solid.left, solid.right) == ("oncoming_1", "main_1")
    assert (solid.marking, solid.color, solid.double) == ("solid", "yellow", True)
    dashed = divider(divider_dashed=True)["main_line_0"]
    assert (dashed.marking, dashed.color, dashed.double) == ("dashed", "yellow", False)
    lines = divider(median_m=4.0)
    yellow = {name for name, line in lines.items() if line.color == "yellow"}
    assert yellow == {"main_line_0", "oncoming_line_1"}, "the lines at the median, as in the US"
    assert lines["oncoming_line_1"].right is None


@pytest.mark.parametrize("index", first(3, range(20)))
def test_cars_drive_as_their_lanes_do_and_park_on_shoulders(index):
    scene = drawn(index, "cars.n=[4, 12]", "cars.parked=0.5", "road.shoulder_factor=[0.3, 0.9]", split="cars")
    world = resolve(scene)
    labels = ground_truth(scene)
    for car, pose in zip(scene.cars, world.view.world_from_cars, strict=True):
        middle, heading = car_place(world.network, car.lane, car.s_m)
        assert (pose[1, 1] < 0) == car.lane.startswith("oncoming"), "the host drives towards +y"
        assert pose[:2, 1] @ heading > 0.9
        if car.offset_m == 0:
            continue
        model, width_m = CARS[car.model - 1], scene.road.lane_width_m
        aside = pose[:2, :2] / np.linalg.norm(pose[:2, :2], axis=0)
        assert (pose[:2, 3] - middle) @ aside[:, 0] == pytest.approx(car.offset_m, abs=0.05), "to its driver's right"
        half_m = model.width_m * car.scale / 2
        xy = pose[:2, 3] + np.array([[s * half_m, a * model.length_m / 2] for s in (-1, 1) for a in (-1, 1)]) @ aside.T
        edge = world.ground.clearance(xy)
        assert edge.max() < 0, "on the pavement"
        for lane in labels.lanes:
            if lane.kind == "centerline" and not lane.id.startswith("exit"):
                line = (lane.xyz_cam @ labels.camera.world_from_cam[:3, :3].T + labels.camera.world_from_cam[:3, 3])[
                    :, :2
                ]
                near = np.abs(line[:, 1] - pose[1, 3]).min() < 1
                assert not near or cKDTree(line).query(pose[:2, 3])[0] > width_m / 2 + half_m, "in no lane"


def test_a_bend_too_sharp_for_the_oncoming_lanes_leaves_them_out():
    sharp = ["road.offset_p50_m=30", "road.offset_m50_m=-30", "road.n_oncoming=4", "road.median_m=20"]
    assert {drawn(i, "cars.n=0", *sharp).road.n_oncoming for i in range(5)} == {0}
