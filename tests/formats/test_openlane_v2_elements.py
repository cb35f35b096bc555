"""Traffic elements in OpenLane-V2: attributes, links to lanes, ids through a clip, faults that verify finds."""

import json
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.format import ReadFrame, SampleFrame
from synth3dlanes.formats.openlane_v2 import parse, verify
from synth3dlanes.formats.openlane_v2 import write as annotate
from synth3dlanes.truth.ground_truth import ground_truth
from tests.signals import signals_scene


def frame_at(frame: int = 0) -> SampleFrame:
    """A frame of a clip, with the elements as a picture would show them."""
    scene = signals_scene()
    shot = scene.shot.model_copy(update={"frame": frame, "n_frames": 4, "fps": 2.0, "speed_m_s": 1.0})
    scene = scene.model_copy(update={"shot": shot})
    labels = ground_truth(scene)
    seen = tuple(replace(item, visible_fraction=float(item.box_px is not None)) for item in labels.traffic_elements)
    labels = replace(labels, traffic_elements=seen)
    return SampleFrame(
        split="train", key="00000007", number=7 + frame, part="train", parts=frozenset({"train"}), scene=scene,
        labels=labels, passes={}, image_format="jpg", cameras={"00000007": labels.camera},
    )  # fmt: skip


def documents(frame):
    return [json.loads(text) for text in annotate(frame).files.values()]


def problems(frame, document):
    read = ReadFrame("a", "a.json", "a.jpg", (parse(json.dumps(document), "a.json"), ()))
    source = SourceSample.__new__(SourceSample)
    vars(source).update(labels=frame.labels, scene=frame.scene, moment=[source])
    return verify(read, source).problems


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


def drop(annotation):
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
    drop: "expected it, because 100% of it are seen, got none",
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
    assert problems(frame, document) == ()
    fault(document["annotation"])
    found = problems(frame, document)
    assert any(FAULTS[fault] in problem for problem in found), found
