"""Traffic both ways and road works: lanes and lines by a second reading of the rules; what stands, drives and parks."""

import json
from typing import Any

import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree

from synth3dlanes.dataset.columns import numbers_of
from synth3dlanes.draw.sample import Scenes, draw_world, world_in_shot
from synth3dlanes.formats.lanelet2 import lanelets_of
from synth3dlanes.labels import labels as label_file
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import SINGLE, Shots
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.assets.catalogue import CARS, THINGS
from synth3dlanes.scene.scene import PaperRoad, Scene, to_json
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.works import RoadWorks
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.placement import car_place
from synth3dlanes.world.world import World, resolve
from tests.scenes import FLAT
from tests.test_ground_truth import drawn_both_ways, plan_middle, right_of
from tests.thorough import first
from tests.town_checks import bodies, thing_bodies

WORKS = ("works.present=true", "road.topology=1", "trees.n=0")
CLOSED = RoadWorks(
    start_m=-30, end_m=40, taper_m=30, end_taper_m=10, inner=False, closes_lane=True, taken_m=3.5, shift_m=0.0,
    lines="yellow", line_width_m=0.12, removed=0.5,
)  # fmt: skip
NARROWED = CLOSED.model_copy(update={"closes_lane": False, "taken_m": 1.2})
SHIFTED = CLOSED.model_copy(update={"closes_lane": False, "taken_m": 0.9, "shift_m": 0.9})
CONED = CLOSED.model_copy(update={"taken_m": 0.0, "lines": "as_before"})
SHOULDER = CONED.model_copy(update={"closes_lane": False})
FLIPS = [(False, False), (True, False), (False, True), (True, True)]


def drawn(index: int, *changes: str, preset: str = "streets", shots: Shots = SINGLE) -> World:
    return draw_world(Scenes(load_params(preset, (*WORKS, *changes)), 11, shots=shots), index)


def flat(works: RoadWorks, flips: tuple[bool, bool] = (False, False), lane: int = 2, **road: Any) -> Scene:
    numbers = {**FLAT.road.model_dump(), "works": works.model_dump(), **road}  # type: ignore[union-attr]
    numbers |= {"flip_longitudinal": flips[0], "flip_lateral": flips[1]}
    camera = FLAT.camera.model_copy(update={"lane": lane})
    return FLAT.model_copy(update={"road": PaperRoad.model_validate(numbers), "camera": camera})


def lines_of(scene: Scene) -> dict[str, tuple[dict[str, Any], np.ndarray]]:
    """The lanes of the labels, and their points in the world."""
    labels = json.loads(label_file.to_json(ground_truth(scene)))
    pose = np.array(labels["camera"]["world_from_cam"])
    return {lane["id"]: (lane, np.array(lane["xyz_cam"]) @ pose[:3, :3].T + pose[:3, 3]) for lane in labels["lanes"]}


def between_tapers(works: RoadWorks, points: np.ndarray) -> np.ndarray:
    """Those of some points of a straight road that are between the tapers."""
    y = points[:, 1]
    return points[(y > works.start_m + works.taper_m) & (y < works.end_m - works.end_taper_m)]


@pytest.mark.parametrize("flips", FLIPS)
@pytest.mark.parametrize("inner", [False, True])
@pytest.mark.parametrize(
    ("works", "edges_m"),
    [
        # Of three lanes of 3.5 m, seen with the works on the right: where the lines are between the tapers.
        (CLOSED, (-5.25, -1.75, 1.75)),
        (CONED, (-5.25, -1.75, 1.75)),
        (NARROWED, (-5.25, -2.15, 0.95, 4.05)),
        (SHIFTED, (-6.15, -2.65, 0.85, 4.35)),
        (SHOULDER, (-5.25, -1.75, 1.75, 5.25)),
    ],
)
def test_lanes_are_where_the_works_leave_room(
    works: RoadWorks, edges_m: tuple[float, ...], inner: bool, flips: tuple[bool, bool]
) -> None:
    """Outer works are on the right, in the mirrored world on the left; between tapers, lanes are in the middle of the
    lines, and there are no others."""
    works = works.model_copy(update={"inner": inner})
    x = np.sort(np.array(edges_m) * (-1 if flips[0] != inner else 1))
    lanes = lines_of(flat(works, flips))
    kinds: dict[str, list[float]] = {"centerline": [], "delimiter": []}
    for lane, points in lanes.values():
        there = between_tapers(works, points)
        if len(there):
            assert np.ptp(there[:, 0]) < 1e-3, lane["id"]
            kinds[lane["kind"]].append(float(there[0, 0]))
    painted = sorted(kinds["delimiter"])
    if works == CONED.model_copy(update={"inner": inner}):
        # The line beyond the closed lane is still there.
        beyond = 5.25 * (-1 if flips[0] != inner else 1)
        painted.remove(min(painted, key=lambda at: abs(at - beyond)))
    assert painted == pytest.approx(x, abs=2e-3)
    assert sorted(kinds["centerline"]) == pytest.approx((x[1:] + x[:-1]) / 2, abs=2e-3)


@pytest.mark.parametrize("flips", FLIPS)
def test_a_closed_lane_ends_where_the_works_begin_and_the_others_go_on(flips: tuple[bool, bool]) -> None:
    scene = flat(CLOSED, flips)
    labels, lanes = ground_truth(scene), lines_of(scene)
    through = {path for name in ("works_1", "works_2") for path in _segment(labels, name).centerlines}
    ends = {name: points[[0, -1], 1] for name, (lane, points) in lanes.items() if lane["kind"] == "centerline"}
    assert {name for name, (low, high) in ends.items() if low < -40 and high > 50} == through
    (before,) = (at for name, at in ends.items() if name not in through and at[0] < -40)
    (after,) = (at for name, at in ends.items() if name not in through and at[0] > -40)
    assert before[1] == pytest.approx(CLOSED.start_m, abs=1e-3)
    assert after[0] == pytest.approx(CLOSED.end_m, abs=1e-3)
    last = [name for name in ("main_1", "main_2", "main_3") if name not in labels.graph.successors]
    assert last == ["main_1" if flips[0] else "main_3"], "the outermost lane, which leads nowhere"
    assert len(labels.graph.successors) == 4


def _segment(labels: label_file.Labels, name: str) -> label_file.Segment:
    return next(at for at in labels.graph.segments if at.id == name)


def test_temporary_lines_have_their_colour_and_kind_and_name_their_lanes() -> None:
    for lines in ("yellow", "white"):
        found = lines_of(flat(NARROWED.model_copy(update={"lines": lines})))
        temporary = {name: lane for name, (lane, _) in found.items() if name.startswith("works_line")}
        looks = {name: (lane["marking"], lane["color"], lane["double"]) for name, lane in temporary.items()}
        assert looks == {
            "works_line_1": ("dashed", lines, False),
            "works_line_2": ("dashed", lines, False),
            "works_line_3": ("solid", lines, False),
        }
        assert temporary["works_line_2"]["left"] == found["after_2"][0]["id"]
        assert temporary["works_line_3"]["right"] is None
        # The host's way is beside the line before the works first.
        assert found["after_2"][0]["right"] == "main_line_2"
    along = lines_of(flat(NARROWED).model_copy(update={"camera": FLAT.camera.model_copy(update={"y_m": 5.0})}))
    assert along["after_2"][0]["right"] == "works_line_2"
    assert along["main_line_0"][0]["color"] == "white", "a line that does not move is not painted anew"


@pytest.mark.parametrize("index", first(1, range(24)))
def test_lines_go_on_into_each_other_on_curved_roads(index: int) -> None:
    """Ways of open lanes have no jump and no kink; a line that holds along the works begins where that before ends."""
    scene = drawn(index, "cars.n=0").scene
    works = scene.paper_road.works
    assert works is not None
    lanes = lines_of(scene)
    for lane, points in lanes.values():
        steps = np.diff(points[:, :2], axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        assert lengths.max() < 1.35
        along = steps[lengths > 0.2] / lengths[lengths > 0.2, None]
        turns = np.arcsin(np.clip(along[1:, 0] * along[:-1, 1] - along[1:, 1] * along[:-1, 0], -1, 1))
        assert np.abs(turns).max(initial=0.0) < np.radians(3), lane["id"]
    joints = [points[end] for name, (_, points) in lanes.items() if name.startswith("works_line") for end in (0, -1)]
    others = np.concatenate([points for name, (lane, points) in lanes.items()
                             if lane["kind"] == "delimiter" and not name.startswith("works_line")])  # fmt: skip
    host_y = scene.camera.y_m
    for joint in joints:
        is_end = min(abs(joint[1] - works.start_m), abs(joint[1] - works.end_m)) < 0.01
        if is_end and host_y + 5 < joint[1] < host_y + 80:
            assert np.linalg.norm(others - joint, axis=1).min() < 1e-3


def closed_edges(scene: Scene, inside_m: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Between the tapers, both edges of what the works close, by the plan's own numbers."""
    document = json.loads(to_json(scene))
    road, works = document["road"], document["road"]["works"]
    n, w = road["n_lanes"], road["lane_width_m"]
    closed_m = works["taken_m"] or w * works["closes_lane"]
    sign = -1 if works["inner"] else 1
    edge = n * w / 2
    low, high = (
        plan_line(document, sign * at) for at in (edge - closed_m + inside_m, edge + w * road["shoulder_factor"])
    )
    ends = works["start_m"] + works["taper_m"] + 1, works["end_m"] - works["end_taper_m"] - 1
    low, high = (at[(at[:, 1] > ends[0]) & (at[:, 1] < ends[1])] for at in (low, high))
    return low, high


def closed_area(scene: Scene) -> shapely.Polygon:
    """The area between these edges."""
    low, high = closed_edges(scene)
    return shapely.Polygon(np.concatenate([low, high[::-1]]))


@pytest.mark.parametrize("index", first(1, range(12)))
def test_nothing_drives_or_parks_in_the_closed_area_or_into_a_cone(index: int) -> None:
    shots = Shots(frames=13, fps=4.0)
    own = ("cars.n=14", "cars.parked=0.4", "riders.motorcyclists=3", "works.length_m=100", "works.ahead_m=[-10, 20]")
    world = drawn(index, *own, "motion.host_speed_m_s=[8, 20]", shots=shots)
    scenes = Scenes(load_params("streets", (*WORKS, *own)), 11, shots=shots)
    area = closed_area(world.scene)
    assert area.area > 20
    for frame in range(shots.frames):
        now = world_in_shot(scenes, world, shots.place(frame))
        vehicles, things = bodies(now), thing_bodies(now)
        riders = [at.kind == "motorcyclist" for at in now.scene.things]
        moving = [*vehicles, *(body for body, is_rider in zip(things, riders, strict=True) if is_rider)]
        devices = [body for body, is_rider in zip(things, riders, strict=True) if not is_rider]
        assert len(devices) > 8
        assert not any(body.intersects(area) for body in moving)
        assert not any(body.intersects(device) for body in moving for device in devices)


@pytest.mark.parametrize("index", first(1, range(12)))
def test_devices_are_as_far_apart_as_drawn_at_the_edge_of_the_closed_area(index: int) -> None:
    spacing_m, kind = (6.0, "barrel") if index % 2 else (4.0, "cone")
    # The second reading of the road ends 100 m from its middle.
    own = f"works.spacing_m={spacing_m}", f"works.devices={kind}", "works.length_m=[60, 90]", "works.ahead_m=[-15, 15]"
    scene = drawn(index, "cars.n=0", "riders.motorcyclists=0", *own).scene
    works, area = scene.paper_road.works, closed_area(scene)
    assert works is not None
    row = [at for at in scene.things if at.kind == kind]
    assert {at.kind for at in scene.things} <= {kind, "barricade"}
    places = np.array([(at.x_m, at.y_m) for at in row])
    gaps_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert (np.diff(places[:, 1]) > 0).all(), "from the front on"
    inside = (places[:, 1] > works.start_m + works.taper_m + 1) & (places[:, 1] < works.end_m - works.end_taper_m - 1)
    assert gaps_m[inside[:-1] & inside[1:]] == pytest.approx(spacing_m, abs=0.15)
    front = places[:, 1] < works.start_m + works.taper_m - 1
    assert gaps_m[front[:-1] & front[1:]] == pytest.approx(spacing_m / 2, abs=0.15)
    model, edge = THINGS[row[0].kind][row[0].model - 1], shapely.LineString(closed_edges(scene)[0])
    for place in places[inside]:
        # Its side is 25 cm inside the edge, 5 cm of which the area leaves out.
        assert area.contains(shapely.Point(place))
        away_m = edge.distance(shapely.Point(place))
        assert away_m == pytest.approx(0.20 + model.width_m / 2, abs=0.03)


def test_barricades_stand_across_the_closed_lane_and_face_the_traffic() -> None:
    found = 0
    for index in range(6):
        scene = drawn(index, "works.kind=lane_closed", "works.barricade=true", "cars.n=0", "road.n_lanes=3").scene
        area = closed_area(scene)
        for at in (at for at in scene.things if at.kind == "barricade"):
            assert area.contains(shapely.Point(at.x_m, at.y_m).buffer(0.5))
            assert np.cos(at.yaw_rad) < -0.9, "the host drives towards +y"
            found += 1
    assert found > 3


def test_the_index_says_them() -> None:
    scene = flat(CLOSED)
    row = numbers_of(scene, ground_truth(scene))
    assert (row["works"], row["works_lines"]) == ("lane_closed", "yellow")
    assert (numbers_of(FLAT, ground_truth(FLAT))["works"]) == "none"


def test_a_lanelet_beside_the_closed_lane_is_cut_where_the_temporary_line_meets_it() -> None:
    found, _ = lanelets_of(resolve(flat(CLOSED)))
    looks = [None if at.right.paint is None else at.right.paint.ascending for at in found.pieces["works_2"]]
    (line,) = (look for look in looks if look is not None)
    assert (line["subtype"], line["color"]) == ("solid", "yellow")
    assert looks == [None, line, None], "not in the tapers"


@pytest.mark.render
@pytest.mark.thorough
def test_rendered_paint_is_where_the_labels_have_the_temporary_lines() -> None:
    """By ids and colours of pixels: the yellow lines are under their labels, and nothing is painted where the old edge
    line was."""
    works = NARROWED.model_copy(update={"removed": 0.0, "start_m": -45.0, "taper_m": 12.0})
    picture = take_picture(resolve(flat(works, lane=2)), RenderSettings(samples=1, passes=("instance", "depth")))
    labels, ids = picture.labels, picture.passes["instance"]
    lanes = {lane.id: lane for lane in labels.lanes}
    for name in ("works_line_2", "works_line_3"):
        lane = lanes[name]
        near = lane.xyz_cam[(lane.xyz_cam[:, 1] > 6) & (lane.xyz_cam[:, 1] < 22) & lane.visible]
        columns, rows = np.floor(labels.camera.project(near)).astype(int).T
        seen = ids[rows, columns]
        painted = seen[seen > 0]
        assert len(painted) > (12 if lane.marking == "solid" else 5)
        assert len({*painted.tolist()}) == 1
        colors = picture.image[rows, columns][seen > 0].astype(float)
        assert (colors[:, 0] > colors[:, 2] + 25).all(), "yellow"
    y = np.linspace(15, 25, 20)
    # The flat road's edge line was at x = 5.25 m; the camera is in the middle of the road.
    road_points = np.column_stack([np.full(20, 5.25), y - 50, np.zeros(20)])
    pose = labels.camera.world_from_cam
    cam = (road_points - pose[:3, 3]) @ pose[:3, :3]
    columns, rows = np.floor(labels.camera.project(cam)).astype(int).T
    inside = (columns >= 0) & (columns < ids.shape[1]) & (rows < ids.shape[0])
    assert inside.sum() > 5
    assert not ids[rows[inside], columns[inside]].any()


def plan_line(scene, offset_m):
    """World polyline at an offset to the right of the main road's middle in the plan, which the flips mirror."""
    road, main = scene["road"], plan_middle(scene["road"])
    flips = [-1 if road["flip_longitudinal"] else 1, -1 if road["flip_lateral"] else 1]
    return (main + offset_m * right_of(main)) * flips


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
    scene = drawn_both_ways(index, "cars.n=[4, 12]", "cars.parked=0.5", "road.shoulder_factor=[0.3, 0.9]", split="cars")
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
    assert {drawn_both_ways(i, "cars.n=0", *sharp).road.n_oncoming for i in range(5)} == {0}
