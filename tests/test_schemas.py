"""docs/*.schema.json say what the readers read: by a schema library, for every kind of scene and labels."""

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
from synth3dlanes.geometry.lens import Lens, LensModel
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
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.errors import FormatError
from synth3dlanes.truth.ground_truth import ground_truth
from tests.scenes import changed
from tests.signals import signals_scene
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


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("pinhole", ()),
        ("opencv", (-0.1, 0.02, 1e-3, 0, 0, 0, 0, 0)),
        ("fisheye", (0.1,) * 4),
        ("omni", (0.9, 0.1, 0, 0, 0)),
    ],
)
def test_labels_of_every_lens(model: LensModel, coefficients: tuple[float, ...]) -> None:
    document = check(changed(camera={"lens": Lens(model=model, coefficients=coefficients)}))
    assert document["camera"]["lens"]["model"] == model


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
