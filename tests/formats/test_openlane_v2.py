"""OpenLane-V2: the devkit's rules, the map behind the labels; traffic elements by hand; faults that verify finds."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.format import ReadFrame, SampleFrame
from synth3dlanes.formats.openlane_v2 import category_and_attribute, frames, parse
from synth3dlanes.formats.openlane_v2 import verify as verify_frame
from synth3dlanes.formats.openlane_v2 import write as annotate
from synth3dlanes.formats.verify import verify
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.roads.maps.part import MapStation
from synth3dlanes.truth.ground_truth import ground_truth
from tests.maps.files import opendrive, plan, road
from tests.signals import signals_scene

FLIPS = [(a, b) for a in ("true", "false") for b in ("true", "false")]
CHANGES = ["camera.roll_deg={-2: 1, 2: 1}", "camera.principal_offset_px=[-8, 8]", "road.n_oncoming={0: 1, 2: 1}"]


def frame_of(seed, *changes):
    scene = sample_scene(Scenes(load_params("appendix_i", [*CHANGES, *changes]), seed, "train"), 0)
    labels = ground_truth(scene)
    return sample_frame(scene, labels)


def sample_frame(scene, labels, number=7):
    """A training frame as its writer takes it."""
    return SampleFrame(
        split="train", key="00000007", number=number, part="train", parts=frozenset({"train"}), scene=scene,
        labels=labels, passes={}, image_format="jpg", cameras={"00000007": labels.camera},
    )  # fmt: skip


def documents(frame):
    """The files of centre lines and of lane segments."""
    return [json.loads(text) for text in annotate(frame).files.values()]


def pixels(document, points_ego):
    """As the devkit draws: camera points are pinv(rotation) (points - translation), then K and the division by z."""
    sensor = document["sensor"]["ring_front_center"]
    rotation, translation = (np.array(sensor["extrinsic"][key]) for key in ("rotation", "translation"))
    points_cv = np.linalg.pinv(rotation) @ (points_ego.T - translation[:, None])
    points_cv = points_cv[:, points_cv[2] > 1]
    u, v, depth = np.array(sensor["intrinsic"]["K"]) @ points_cv
    return np.column_stack([u / depth, v / depth])


def gaps(points, line):
    """Distance of each point from a polyline."""
    a, step = line[:-1], np.diff(line, axis=0)
    to = points[:, None] - a
    share = np.clip((to * step).sum(-1) / np.maximum((step**2).sum(-1), 1e-12), 0, 1)
    return np.linalg.norm(to - share[..., None] * step, axis=-1).min(axis=1)


def ego_of(labels, points_cam):
    x_m, y_m, z_m = transform(labels.camera.road_from_cam, points_cam).T
    return np.column_stack([y_m, -x_m, z_m])


@pytest.mark.parametrize("topology", [1, 2, 3, 4])
@pytest.mark.parametrize(("longitudinal", "lateral"), FLIPS)
def test_lanes_are_those_of_the_labels_in_3d_and_in_the_image(topology, longitudinal, lateral):
    frame = frame_of(
        topology, f"road.topology={topology}", f"road.flip_longitudinal={longitudinal}", f"road.flip_lateral={lateral}"
    )
    labels, (centers, segments) = frame.labels, documents(frame)
    lines = {lane.id: ego_of(labels, lane.xyz_cam) for lane in labels.lanes}
    assert len(centers["annotation"]["lane_centerline"]) > 0
    for lane, whole in zip(
        segments["annotation"]["lane_segment"], centers["annotation"]["lane_centerline"], strict=True
    ):
        segment = labels.graph.segments[lane["id"]]
        middle = np.array(whole["points"])
        assert middle.shape == (201, 3), "the devkit keeps every 20th point of 201"
        np.testing.assert_allclose(np.array(lane["centerline"]), middle[::4], atol=2e-3)
        # Every point is on a path of the labels that runs through the segment. A sampled curve is off by some mm.
        paths = [lines[name] for name in segment.centerlines if name in lines]
        # Paths begin at the camera's station.
        ahead = middle[np.all([(middle - path[0]) @ (path[1] - path[0]) > 0 for path in paths], axis=0)]
        if paths and len(ahead):
            assert np.min([gaps(ahead, path) for path in paths], axis=0).max() < 0.03
            path = next(lane for lane in labels.lanes if lane.id == segment.centerlines[0])
            u_v = pixels(centers, ahead[ahead[:, 0] > 6])
            theirs = path.xyz_cam[path.xyz_cam[:, 1] > 1] @ labels.camera.img_from_cam.T
            if len(segment.centerlines) == 1 and len(u_v):
                assert np.median(gaps(u_v, theirs[:, :2] / theirs[:, 2:])) < 0.3
        # Driving direction, and left is left of it.
        is_oncoming = segment.id.startswith("oncoming")
        onwards = middle[-1] - middle[0]
        assert (onwards[0] < 0) == is_oncoming
        for side, sign in (("left", 1), ("right", -1)):
            aside = (np.array(lane[f"{side}_laneline"]) - middle[::4])[10:-10]
            along = np.gradient(middle[::4], axis=0)[10:-10]
            across = along[:, 0] * aside[:, 1] - along[:, 1] * aside[:, 0]
            assert (np.sign(across) == sign).mean() > 0.95


@pytest.mark.parametrize("seed", range(4))
def test_boundaries_and_their_types_are_the_delimiters_of_the_labels(seed):
    frame = frame_of(seed, "road.topology=1", "markings.left_yellow=true", "markings.left_double=true")
    labels, (_, document) = frame.labels, documents(frame)
    lanes = {lane.id: lane for lane in labels.lanes}
    for made in document["annotation"]["lane_segment"]:
        lane = lanes[labels.graph.segments[made["id"]].id]
        turned = lane.direction == "oncoming"
        for side, theirs in (
            ("left", lane.right if turned else lane.left),
            ("right", lane.left if turned else lane.right),
        ):
            delimiter = lanes[theirs]
            assert made[f"{side}_laneline_type"] == {"none": 0, "solid": 1, "dashed": 2}[delimiter.marking]
            assert made[f"{side}_laneline_color"] == delimiter.color
            assert made[f"{side}_laneline_double"] == delimiter.double
            points = np.array(made[f"{side}_laneline"])
            assert gaps(points[points[:, 0] > 1.5], ego_of(labels, delimiter.xyz_cam)).max() < 0.05
    assert found_in(frame, document).problems == ()
    for made in document["annotation"]["lane_segment"]:
        side = f"{'left' if seed % 2 else 'right'}_laneline_type"
        made[side] = 3 - made[side]
    told = found_in(frame, document).problems
    assert told
    assert all(re.search(r"lane \w+: expected [12] on its \w+, as \w+ is painted, got [12]$", one) for one in told)


@pytest.mark.parametrize("topology", [2, 3, 4])
@pytest.mark.parametrize(("longitudinal", "lateral"), FLIPS)
def test_what_follows_begins_where_the_lane_ends(topology, longitudinal, lateral):
    frame = frame_of(
        9, f"road.topology={topology}", f"road.flip_longitudinal={longitudinal}", f"road.flip_lateral={lateral}",
        "camera.y_m=-25",
    )  # fmt: skip
    graph, (centers, segments) = frame.labels.graph, documents(frame)
    follows = np.array(centers["annotation"]["topology_lclc"])
    np.testing.assert_array_equal(follows, segments["annotation"]["topology_lsls"])
    assert np.array(centers["annotation"]["topology_lcte"]).shape == (len(follows), 0)
    lanes = centers["annotation"]["lane_centerline"]
    ids = [graph.segments[lane["id"]].id for lane in lanes]
    found = {(ids[i], ids[j]) for i, j in np.argwhere(follows)}
    assert found == {(a, b) for a, following in graph.successors.items() for b in following if {a, b} <= set(ids)}
    assert len(found) >= 2
    for i, j in np.argwhere(follows):
        np.testing.assert_allclose(lanes[i]["points"][-1], lanes[j]["points"][0], atol=1e-3)


def test_pavement_ends_outside_every_lane_and_crosswalks_are_closed_quads():
    frame = frame_of(3, "road.topology=1", "road.n_oncoming=0", "symbols.crosswalks=1", "camera.y_m=-30")
    _, document = documents(frame)
    areas = document["annotation"]["area"]
    lanes = [np.array(lane["centerline"]) for lane in document["annotation"]["lane_segment"]]
    edges = [np.array(area["points"]) for area in areas if area["category"] == 2]
    assert len(edges) == 2
    for edge in edges:
        assert min(gaps(edge, lane).min() for lane in lanes) > frame.scene.road.lane_width_m / 2
    assert {np.sign(edge[:, 1].mean() - np.mean([lane[:, 1].mean() for lane in lanes])) for edge in edges} == {-1, 1}
    for area in areas:
        if area["category"] == 1:
            # LaneSegNet asserts five points and takes 0-1 and 3-2 for the long sides.
            points = np.array(area["points"])
            assert points.shape == (5, 3)
            np.testing.assert_array_equal(points[0], points[-1])
            assert np.linalg.norm(points[1] - points[0]) > np.linalg.norm(points[2] - points[1])


def test_the_pictures_of_a_rig_are_one_frame_with_lanes_all_around():
    frame = frame_of(5, "road.topology=1", "camera.roll_deg=0", "camera.y_m=-20")
    ahead = frame.labels.camera
    # A camera that looks back from the same place.
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    back_from_road = turn @ ahead.road_from_cam
    back = replace(
        ahead,
        name="CAM_BACK",
        road_from_cam=back_from_road,
        world_from_cam=ahead.world_from_cam @ invert(ahead.road_from_cam) @ back_from_road,
    )
    ahead = replace(ahead, name="CAM_FRONT")
    shot = frame.scene.shot.model_copy(update={"frame": 2, "n_frames": 3, "fps": 10.0, "camera": 0, "n_cameras": 2})
    first = replace(
        frame,
        number=104,
        scene=frame.scene.model_copy(update={"shot": shot}),
        labels=replace(frame.labels, camera=ahead),
        cameras={"4": ahead, "5": back},
    )
    annotation = annotate(first)
    # Frame 2 of 3 by 2 cameras: the clip began four pictures before, 0.2 s ago.
    assert annotation.image == "OpenLane-V2/train/00000100/image/CAM_FRONT/200000000.jpg"
    (centers, segments) = (json.loads(text) for text in annotation.files.values())
    assert list(centers["sensor"]) == ["CAM_FRONT", "CAM_BACK"]
    assert annotation.shared[0][1] == ("OpenLane-V2/data_dict_subset_B.json",)
    rotation = np.array(centers["sensor"]["CAM_BACK"]["extrinsic"]["rotation"])
    assert rotation[0, 2] < -0.9, "its viewing axis (z) points backwards (x)"
    x_m = np.concatenate([lane["points"] for lane in centers["annotation"]["lane_centerline"]])[:, 0]
    assert -51 < x_m.min() < -45
    assert 45 < x_m.max() < 51
    assert segments["sensor"] == centers["sensor"]
    by_back = first.scene.model_copy(update={"shot": shot.model_copy(update={"camera": 1})})
    alone = annotate(replace(first, number=105, scene=by_back, labels=replace(first.labels, camera=back), cameras={}))
    assert alone.image == "OpenLane-V2/train/00000100/image/CAM_BACK/200000000.jpg"
    assert (alone.files, alone.shared) == ({}, ())
    assert alone.image.removeprefix("OpenLane-V2/") == centers["sensor"]["CAM_BACK"]["image_path"]


def test_an_export_verifies_and_names_what_is_wrong(few, tmp_path):
    out = tmp_path / "out"
    job = Export(str(few), out, "openlane_v2")
    summary = job.write()
    assert summary.n_frames == {"train": 3, "test": 1}
    assert [result.problems for result in verify(job, 9)] == [()] * 6
    # The devkit's preprocess.py takes every JSON in this folder for a collection {part: {segment: [names]}}.
    (listed,) = (out / "OpenLane-V2").glob("*.json")
    parts = json.loads(listed.read_text())
    assert {part: sum(map(len, segments.values())) for part, segments in parts.items()} == {
        "train": 3,
        "val": 1,
        "test": 1,
    }
    path = frames(out)["train"][0]
    frame = parse(path.read_text(), str(path))
    assert list(frame.cameras) == ["ring_front_center"], "loaders expect it first"
    text = path.read_text()
    document = json.loads(text)
    # TopoNet makes the key of a frame of its document.
    assert (document["segment_id"], str(document["timestamp"])) == (path.parts[-3], path.stem)
    document["annotation"]["lane_centerline"][0]["points"] = [[0, 0, 0]] * 201
    path.write_text(json.dumps(document))
    (out / "OpenLane-V2" / frame.cameras["ring_front_center"].image).unlink()
    problems = [problem for result in verify(job, 9) for problem in result.problems]
    assert any("expected the image" in problem for problem in problems)


def hairpin():
    """A frame before a road that leaves the area to the left and comes back through it, and its labels."""
    up, down = '<arc curvature="0.125"/>', '<arc curvature="-0.125"/>'
    quarter_m = 8 * np.pi / 2
    pieces = plan(("<line/>", 60.0), (up, quarter_m), ("<line/>", 22.0), (down, 2 * quarter_m), ("<line/>", 80.0))
    given = read_opendrive(opendrive(road(pieces)), "bends.xodr", "map bends.xodr")
    place = MapPlace(given, MapStation("1.0.-1", 45.0))
    scene = sample_scene(replace(Scenes(load_params("streets", ["trees.n=0"]), 1, "train"), map=place), 0)
    labels = ground_truth(scene)
    return sample_frame(scene, labels)


def found_in(frame, document):
    source = SourceSample.__new__(SourceSample)
    vars(source).update(labels=frame.labels, scene=frame.scene, moment=[source])
    return verify_frame(ReadFrame("a", "a.json", "a.jpg", (parse(json.dumps(document), "a.json"), ())), source)


def test_a_lane_that_leaves_the_area_and_comes_back_has_all_its_parts():
    frame = hairpin()
    for document, key in zip(documents(frame), ("lane_centerline", "lane_segment"), strict=True):
        lanes = document["annotation"][key]
        own = [lane for lane in lanes if lane["id"] % 1_000_000 == lanes[0]["id"] % 1_000_000]
        assert [lane["id"] // 1_000_000 for lane in own] == [0, 1]
        nearest = [min(np.hypot(x, y) for x, y, _ in lane.get("points", lane.get("centerline"))) for lane in own]
        assert max(nearest) < 50
        assert not np.any(document["annotation"]["topology_lclc" if key == "lane_centerline" else "topology_lsls"])
        compared = found_in(frame, document)
        assert compared.problems == ()
    document = documents(frame)[0]
    annotation = document["annotation"]
    for part in range(2):
        kept = [i for i, lane in enumerate(annotation["lane_centerline"]) if lane["id"] // 1_000_000 != part]
        without = {
            **annotation,
            "lane_centerline": [annotation["lane_centerline"][i] for i in kept],
            "topology_lclc": [[annotation["topology_lclc"][i][j] for j in kept] for i in kept],
            "topology_lcte": [annotation["topology_lcte"][i] for i in kept],
        }
        problems = found_in(frame, {**document, "annotation": without}).problems
        assert any("expected one, got none nearer" in problem for problem in problems)


def frame_at(frame: int = 0) -> SampleFrame:
    """A frame of a clip, with the elements as a picture would show them."""
    scene = signals_scene()
    shot = scene.shot.model_copy(update={"frame": frame, "n_frames": 4, "fps": 2.0, "speed_m_s": 1.0})
    scene = scene.model_copy(update={"shot": shot})
    labels = ground_truth(scene)
    seen = tuple(replace(item, visible_fraction=float(item.box_px is not None)) for item in labels.traffic_elements)
    labels = replace(labels, traffic_elements=seen)
    return sample_frame(scene, labels, 7 + frame)


def test_attributes_and_links_by_hand():
    """Of the benchmark's list: 1 red, 2 green, 3 yellow, 12 slight right; a stop sign and a limit have none."""
    frame = frame_at()
    centers, segments = documents(frame)
    names = {item.id: item for item in frame.labels.traffic_elements}
    lanes = [frame.labels.graph.segments[lane["id"]].id for lane in centers["annotation"]["lane_centerline"]]
    links = np.array(centers["annotation"]["topology_lcte"])
    found = {}
    for j, element in enumerate(centers["annotation"]["traffic_element"]):
        item = names[element["id"]]
        governed = tuple(lane for i, lane in enumerate(lanes) if links[i, j])
        found[item.kind, item.state, governed] = element["category"], element["attribute"]
        np.testing.assert_allclose(np.ravel(element["points"]), item.box_px, atol=0.051)
    assert found == {
        ("information", None, ("main_1", "main_2", "main_3")): (2, 0),
        ("lane", "red_cross", ("main_1",)): (1, 1),
        ("lane", "green_arrow", ("main_2",)): (1, 2),
        ("lane", "amber_right", ("main_3",)): (1, 3),
        ("ball", "red", ("main_1",)): (1, 1),
        ("ball", "green", ("main_1",)): (1, 2),
        ("stop", None, ("main_3",)): (2, 0),
        ("speed_50", None, ("main_3",)): (2, 0),
        ("exit_right", None, ("main_3",)): (2, 12),
    }
    assert segments["annotation"]["topology_lste"] == centers["annotation"]["topology_lcte"]
    assert segments["annotation"]["traffic_element"] == centers["annotation"]["traffic_element"]
    sign = next(item for item in names.values() if item.kind == "stop")
    kinds = ("ahead_only", "left_only", "right_only", "no_left_turn", "no_right_turn", "no_u_turn", "exit_left")
    codes = [category_and_attribute(replace(sign, kind=kind)) for kind in kinds]
    assert codes == [(2, number) for number in (4, 5, 6, 7, 8, 10, 11)]


def test_ids_stay_through_a_clip_and_states_change():
    elements = [documents(frame_at(number))[0]["annotation"]["traffic_element"] for number in range(4)]
    ids = [[element["id"] for element in one] for one in elements]
    assert ids == [ids[0], ids[0], ids[0], ids[0][1:]], "the last frame has passed one"
    red = [[element["attribute"] for element in one if element["id"] == ids[0][4]] for one in elements]
    assert red == [[1], [1], [2], [2]], "two frames a second, phases of a second"


def test_what_shows_its_back_or_is_hidden_is_left_out():
    frame = frame_at()
    first, second, *others = frame.labels.traffic_elements
    turned = replace(first, rotation_wxyz=np.array([0.0, 0.0, 0.0, 1.0]))
    labels = replace(frame.labels, traffic_elements=(turned, replace(second, visible_fraction=0.02), *others))
    found = documents(replace(frame, labels=labels))[0]["annotation"]
    assert {element["id"] for element in found["traffic_element"]} == {item.id for item in others}
    assert {len(row) for row in found["topology_lcte"]} == {len(others)}


def drop_element(annotation):
    del annotation["traffic_element"][0]
    for row in annotation["topology_lcte"]:
        del row[0]


def mislink(annotation):
    annotation["topology_lcte"] = annotation["topology_lcte"][1:] + annotation["topology_lcte"][:1]


def other_attribute(annotation):
    annotation["traffic_element"][1]["attribute"] = 2


def other_category(annotation):
    annotation["traffic_element"][1]["category"] = 2


def shift(annotation):
    annotation["traffic_element"][1]["points"][0][0] += 1.0


def other_id(annotation):
    annotation["traffic_element"][1]["id"] += 400


def same_id(annotation):
    annotation["traffic_element"][1]["id"] = annotation["traffic_element"][0]["id"]


def swap(annotation):
    one, other = annotation["traffic_element"][1:3]
    one["id"], other["id"] = other["id"], one["id"]


FAULTS = {
    drop_element: "expected it, because 100% of it are seen, got none",
    mislink: "expected it to govern main_1, got it not to",
    other_attribute: "expected category and attribute (1, 1), got (1, 2)",
    other_category: "expected category and attribute (1, 1), got (2, 1)",
    shift: "expected its rectangle within 0.2 px, got it 1.0 px off",
    other_id: "expected one of the labels in the image, got another",
    same_id: "expected ids of their own",
    swap: "px off",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_verify_finds_planted_faults(fault):
    frame = frame_at()
    document, _ = documents(frame)
    assert found_in(frame, document).problems == ()
    fault(document["annotation"])
    found = found_in(frame, document).problems
    assert any(FAULTS[fault] in problem for problem in found), found
