"""Schemas say what the readers read, by a schema library; scenes and labels that cannot be are refused in a line."""

import copy
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.geometry.lens import COEFFICIENTS, PINHOLE, Lens
from synth3dlanes.labels import labels as label_file
from synth3dlanes.labels.labels import Labels, SymbolLabel
from synth3dlanes.labels.object_labels import as_seen
from synth3dlanes.params.camera_files import load_camera
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params, preset_names
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import SINGLE, Shots, clips
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.scene.assets.catalogue import CARS, Assets
from synth3dlanes.scene.roadside import Crossing
from synth3dlanes.scene.scene import Car, Scene, Symbol, Thing
from synth3dlanes.scene.traffic_elements import LaneSignal
from synth3dlanes.system.errors import FormatError
from synth3dlanes.truth.ground_truth import ground_truth
from tests.lenses import LENSES
from tests.map_scenes import FOUR_WAY, map_scene
from tests.scenes import FLAT, changed
from tests.signals import sign, signals_scene
from tests.test_works import CLOSED, NARROWED, SHIFTED, SHOULDER
from tests.thorough import presets

DOCS, OLD = Path(__file__).parents[1] / "docs", Path(__file__).parent / "golden"
WRONG = (None, True, -1, 1.5, "x y", [], {})
# What only the reader can know: how long a mask must be, how many coefficients a lens has, what a category has.
BY_COUNT = ("a value for each of", "coefficients: expected", "category: expected a")


def schema(name: str) -> Draft202012Validator:
    document = json.loads((DOCS / name).read_text())
    Draft202012Validator.check_schema(document)
    return Draft202012Validator(document)


LABELS, SCENE = schema("labels.schema.json"), schema("scene.schema.json")


def check(scene: Scene) -> dict[str, Any]:
    """Validate a scene and its labels; returns the labels."""
    SCENE.validate(json.loads(scene_file.to_json(scene)))
    document: dict[str, Any] = json.loads(label_file.to_json(ground_truth(scene)))
    LABELS.validate(document)
    return document


def drawn(preset: str, index: int = 0, shots: Shots = SINGLE, assets: Assets | None = None) -> Scene:
    own = assets or Assets()
    return sample_scene(Scenes(load_params(preset, [], own), assets=own, shots=shots), index)


@pytest.mark.parametrize("preset", presets("diverse", "streets", "tusimple_camera"))
def test_scenes_and_labels_of_every_preset(preset: str) -> None:
    documents = [check(drawn(preset, index)) for index in range(4 if preset == "streets" else 2)]
    if preset == "streets":
        assert any("symbols" in document for document in documents)
        assert any(lane.get("direction") == "oncoming" for document in documents for lane in document["lanes"])


@pytest.mark.parametrize("name", preset_names("cameras"))
def test_every_ready_camera_has_labels_and_the_place_of_the_parameters(name: str) -> None:
    spec, plain = load_camera(name), drawn("tiny", 3)
    scene = drawn("tiny", 3, Shots(cameras=(spec,)))
    check(scene)
    assert scene.model_copy(update={"camera": plain.camera}) == plain
    assert (scene.camera.lane, scene.camera.y_m) == (plain.camera.lane, plain.camera.y_m)
    assert CameraSpec.model_validate(spec.model_dump(mode="json")) == spec


@pytest.mark.parametrize("lens", [PINHOLE, *(lens for _, lens in LENSES.values())], ids=lambda lens: lens.model)
def test_labels_of_every_lens(lens: Lens) -> None:
    document = check(changed(camera={"lens": lens}))
    assert document["camera"]["lens"]["model"] == lens.model


def test_every_model_of_a_lens_is_tried() -> None:
    assert {"pinhole", *(lens.model for _, lens in LENSES.values())} == set(COEFFICIENTS)


@pytest.mark.parametrize("name", preset_names("rigs"))
def test_labels_of_clips_of_every_rig(name: str) -> None:
    shots = clips(2, 10, load_rig(name))
    documents = [check(drawn("tiny", index, shots)) for index in (0, 1, shots.per_scene - 1)]
    assert {document["time_s"] for document in documents} == {0, 0.1}
    assert all(document["camera"]["name"] for document in documents)
    assert any("yaw_rad" in document["camera"] for document in documents)


@pytest.mark.parametrize("name", preset_names("lidars"))
def test_labels_with_a_lidar(name: str) -> None:
    assert check(drawn("tiny", shots=Shots(lidar=load_lidar(name))))["lidar"]["name"] == name


def test_scenes_with_cars_of_a_user() -> None:
    own = (replace(CARS[0], name="mine", sha256="0" * 64),)
    assert drawn("appendix_i", assets=Assets(cars=own)).assets.cars == own
    check(drawn("appendix_i", assets=Assets(cars=own)))


@pytest.mark.parametrize("name", ["split", "left_merge", "plain"])
def test_scenes_and_labels_of_older_versions(name: str) -> None:
    SCENE.validate(json.loads((OLD / f"{name}.scene.json").read_text()))
    document = json.loads((OLD / f"{name}.labels.json").read_text())
    LABELS.validate(document)
    for lane in document["lanes"]:
        del lane["color"], lane["double"], lane["pair"]
    del document["camera"]["roll_rad"]
    LABELS.validate(document)
    assert label_file.from_json(json.dumps(document), name).lanes[0].color is None


def small() -> Labels:
    """Labels that have every key and little else, with two lines of three points."""
    lidar = load_lidar(preset_names("lidars")[0])
    labels = ground_truth(drawn("tiny", shots=Shots(frames=2, lidar=lidar)))
    mask, xyz = np.array([True, False, True]), np.arange(9.0).reshape(3, 3)
    points: dict[str, Any] = {"xyz_cam": xyz, **dict.fromkeys(label_file.MASKS, mask)}
    kinds = {lane.kind: lane for lane in labels.lanes}
    fisheye = Lens(model="fisheye", coefficients=(0.1, 0, 0, 0))
    first, second = labels.graph.segments[:2]
    small = replace(
        labels,
        graph=replace(labels.graph, segments=(first, second), successors={first.id: (second.id,)}),
        lidar=replace(labels.lidar, elevations_rad=labels.lidar.elevations_rad[:2]),
        camera=replace(labels.camera, yaw_rad=0.1, name="left", lens=fisheye),
        lanes=tuple(replace(lane, **points, direction="oncoming") for lane in kinds.values()),
        horizon=label_file.RoadPlane(0.1, 1.5),
        objects=as_seen(labels.objects[:1], np.array([[0, 1], [0, 1]], np.uint16), np.array([1, 1], np.uint16)),
        traffic_elements=ground_truth(signals_scene()).traffic_elements[:1],
        symbols=(SymbolLabel("gore", **points),),
    )
    return small.with_seen_shares((0.5,))


def edits(document: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[str, tuple[Any, ...], Any]]:
    """What may be wrong with every kind of place in a document: a key that is missing or too many, another value."""
    if isinstance(document, dict):
        yield "add", path, None
        for key, value in document.items():
            yield "remove", (*path, key), None
            yield from edits(value, (*path, key))
    elif isinstance(document, list):
        # Places of a list are of one kind.
        yield from edits(document[0], (*path, 0)) if document else ()
    yield from (("replace", path, value) for value in WRONG)


def edited(document: Any, kind: str, path: tuple[Any, ...], value: Any) -> Any:
    changed = copy.deepcopy(document)
    at = changed
    for step in path[:-1]:
        at = at[step]
    if kind == "replace":
        at[path[-1]] = value
    elif kind == "remove":
        del at[path[-1]]
    else:
        (at[path[-1]] if path else changed)["new"] = 1
    return changed


def test_the_schema_of_labels_refuses_what_the_reader_refuses() -> None:
    """And nothing else, for whatever single place is wrong."""
    text = label_file.to_json(small())
    assert label_file.to_json(label_file.from_json(text, "x")) == text
    document = json.loads(text)
    LABELS.validate(document)
    refused = {"remove": 0, "add": 0, "replace": 0}
    for kind, path, value in edits(document):
        # pydantic takes true for the literal 1, which does no harm.
        if kind == "replace" and (not path or (value is True and ({*path} & {"version", *label_file.MASKS}))):
            continue
        wrong = edited(document, kind, path, value)
        is_valid, problem = LABELS.is_valid(wrong), ""
        try:
            label_file.from_json(json.dumps(wrong), "x")
        except FormatError as error:
            problem = str(error)
        assert is_valid == (not problem) or (is_valid and any(words in problem for words in BY_COUNT)), (
            kind, path, value, problem,
        )  # fmt: skip
        refused[kind] += not is_valid
    assert refused["remove"] > 40
    assert refused["add"] >= 10
    assert refused["replace"] > 500
    for path, other in ((("lanes", 0, "kind"), "line"), (("camera", "lens", "model"), "wide"), (("version",), 2)):
        assert not LABELS.is_valid(edited(document, "replace", path, other))


CAR = Car(model=2, scale=1.0, color=(1, 0, 0), gloss=0.5, lane="main_2", s_m=-20.0)
CONE = Thing(kind="cone", model=1, x_m=2.0, y_m=-30.0, yaw_rad=0.0)
AT_ONCE = [{"time_s": t, "x_m": 0, "y_m": 0, "yaw_rad": 0} for t in (1, 1)]
GANTRY = Crossing(kind="gantry", s_m=0, clearance_m=5, width_m=1, color=(0, 0, 0),
                  signals=(LaneSignal(lane="exit_1", state="off"),))  # fmt: skip
ON_MAP = map_scene(FOUR_WAY, 60.0)
PIECE = FOUR_WAY.roads[0].plan[0].model_dump()
FAR = {**PIECE, "x_m": 1e5}


def works(of: Any, **changes: Any) -> dict[str, Any]:
    return {**of.model_dump(mode="json"), **changes}


# Of a scene: the place, its new value, and what is said.
SCENES: list[tuple[Scene, str, Any, str]] = [
    (FLAT, "things", [CONE.model_dump() | {"model": 3}], "things.0.model: expected at most 2, got 3"),
    (FLAT, "things", [CONE.model_dump() | {"colors": [(1, 1, 1)]}], "things.0.colors: expected 0 (none), got 1"),
    (FLAT, "things", [CONE.model_dump() | {"kind": "barrier"}], "things.0.kind: expected 'pedestrian', 'cyclist'"),
    (FLAT, "things", [CONE.model_dump() | {"track": AT_ONCE}], "in order, got 1 s"),
    (FLAT, "roadside.signs", [sign("stop", 9.0, lanes=("main_4",)).model_dump()], "expected lanes such as main_1, "),
    (FLAT, "roadside.crossings", [GANTRY.model_dump()], "roadside.crossings.0.signals: expected lanes such as"),
    (FLAT, "symbols", [Symbol(kind="arrow_left", lane="main_7", s_m=-20).model_dump()],
     "symbols.0.lane: expected one of main_1, main_2, main_3, got main_7"),
    (FLAT, "symbols", [Symbol(kind="gore", lane=None, s_m=20).model_dump()], "expected a road with an exit"),
    (FLAT, "road", {"n_lanes": 1, "topology": 3}, "at least 2 with topology 3"),
    (FLAT, "road", {"median_m": 0.4}, "expected 0 or at least 1"),
    (ON_MAP, "map.route", ["south.0.1", "north.0.-1"], "route: expected linked lanes, got south.0.1 and north.0.-1"),
    (ON_MAP, "cars", [{**CAR.model_dump(), "lane": "south.0.-3"}], "expected driving lanes of the map, got south.0.-3"),
    (ON_MAP, "map.roads.0.plan", [PIECE, FAR], "plan: expected"),
    (ON_MAP, "map.roads.0.plan", [FAR], "links: expected"),
    (FLAT, "road", {"works": works(CLOSED), "topology": 2}, "works: expected none on a road with an exit"),
    (FLAT, "road", {"works": works(CLOSED), "n_lanes": 1}, "expected open lanes, each of 2.2 m or more, got 0"),
    (FLAT, "road", {"works": works(NARROWED, taken_m=4.2)}, "expected open lanes, each of 2.2 m or more, got 3"),
    (FLAT, "road", {"works": works(CLOSED, inner=True), "n_oncoming": 1}, "expected the line between both directions"),
    (FLAT, "road", {"works": works(SHIFTED), "n_oncoming": 1}, "expected the line between both directions"),
    (FLAT, "road", {"works": works(SHIFTED, shift_m=1.5)}, "expected at most the shoulder's 1.4 m, got 1.5"),
    (FLAT, "road", {"works": works(CLOSED, end_m=5.0)}, "end_m: expected room for both tapers behind -30 m, got 5"),
    (FLAT, "road", {"works": works(CLOSED, lines="as_before")}, "expected as_before where no line moves, and only"),
    (FLAT, "road", {"works": works(SHOULDER, lines="white")}, "expected as_before where no line moves, and only there"),
    (FLAT, "road", {"works": works(CLOSED, lines="red")}, "expected 'as_before', 'white' or 'yellow'"),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "path", "value", "words"), SCENES)
def test_a_scene_that_cannot_be(scene: Scene, path: str, value: Any, words: str) -> None:
    document = json.loads(scene_file.to_json(scene))
    document.setdefault("roadside", {})
    if isinstance(value, dict):
        value = document[path] | value
    steps = tuple(int(step) if step.isdigit() else step for step in path.split("."))
    with pytest.raises(FormatError) as told:
        scene_file.from_json(json.dumps(edited(document, "replace", steps, value)), "scene.json")
    assert words in str(told.value)
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("category", "truncation", "words"),
    [("road_sign", 0.5, "a kind and no truncation of a road_sign"), ("van", None, "a truncation and no kind of a van")],
)
def test_an_object_has_what_its_category_has(category: str, truncation: float | None, words: str) -> None:
    document = json.loads(label_file.to_json(ground_truth(FLAT.model_copy(update={"cars": (CAR,)}))))
    document["objects"][0] |= {"category": category, "truncation": truncation}
    with pytest.raises(FormatError, match=f"objects.0: category: expected {words}"):
        label_file.from_json(json.dumps(document), "labels.json")


def test_older_labels_are_read() -> None:
    """Those without objects keep their shares; those without traffic elements have none."""
    labels = ground_truth(FLAT.model_copy(update={"cars": (CAR,)})).with_seen_shares((0.25,))
    document = json.loads(label_file.to_json(labels))
    for name in ("objects", "traffic_elements"):
        document.pop(name, None)
    older = label_file.from_json(json.dumps(document), "")
    assert (older.objects, older.traffic_elements, older.car_visible_fraction) == (None, None, (0.25,))
