"""Faults planted in a picture of a town: what junctions have, too, is checked against the pixels."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synth3dlanes.dataset.format import LABELS
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.evidence import Evidence
from tests.validate import planted
from tests.validate.examining import findings, reasons, seen
from tests.validate.faults import FAULTS, OF_STREETS, Fault, of_json, of_pass, swapped

pytestmark = [pytest.mark.render, pytest.mark.thorough, pytest.mark.timeout(900)]

# A crossing with signals 15 m ahead, by day.
PLACE = ["town.junction=crossing", "town.control=signals", "town.host_place=before", "town.host_m=15", "town.n_more=0"]
PLACE += ["people.per_100_m=16", "riders.cyclists=2"]
CLEAR = ["weather.kind=clear", "weather.daytime=day", "markings.grayscale=0.9", "markings.wear=0", "markings.missing=0"]
SMALL = ["camera.width_px=320", "camera.height_px=240", "camera.horizontal_fov_deg=60", "trees.n=5"]
KINDS = (
    *("normals negated", "instance ids off by one", "image 3 px to the right", "image BGR", "depth 1 cm too long"),
    *("height map 3 cm up", "car_visible_fraction + 0.08", "object_visible moved by a point"),
)
TURNED = {"red": "green", "red_amber": "green", "amber": "red", "green": "red"}


def moved_connectors(document: dict[str, Any]) -> None:
    """The ways through the junction 10 cm aside."""
    for lane in document["lanes"]:
        if lane["connector"]:
            lane["xyz_cam"] = [[x + 0.1, y, z] for x, y, z in lane["xyz_cam"]]


def turned_signals(document: dict[str, Any]) -> None:
    """Every signal with another state."""
    for item in document["traffic_elements"]:
        if item["state"] is not None:
            item["state"] = TURNED[item["state"]]


def bent(normals: np.ndarray, labels: Labels) -> np.ndarray:
    """Normals that smooth shading over the edge of a kerb has turned aside, in a part of the picture."""
    aside = normals + 0.5 * labels.camera.world_from_cam[0, :3].astype(np.float32)
    aside[:, normals.shape[1] // 4 :] = normals[:, normals.shape[1] // 4 :]
    length = np.linalg.norm(aside, axis=-1, keepdims=True)
    return np.where(np.linalg.norm(normals, axis=-1, keepdims=True) > 0, aside / np.maximum(length, 1e-6), normals)


def of_other_lanes(document: dict[str, Any]) -> None:
    """Every signal for the lanes of another one."""
    items = [item for item in document["traffic_elements"] if item["state"] is not None]
    for item, lanes in zip(items, [each["lanes"] for each in items[1:] + items[:1]], strict=True):
        item["lanes"] = lanes


OF_TOWNS = (
    Fault("connectors 10 cm aside", of_json(LABELS, moved_connectors), "points as the scene has them|xyz_cam"),
    Fault("signals with other states", of_json(LABELS, turned_signals), "state"),
    Fault("signals for other lanes", of_json(LABELS, of_other_lanes), "lanes"),
    Fault("normals bent at kerbs", of_pass("normal", bent), "normal: expected the road's as its faces are turned"),
    Fault(
        "people and cyclists swapped", of_pass("semantic", swapped("pedestrian", "cyclist")), "things of their kinds"
    ),
)


def test_faults_of_towns_are_found(tmp_path: Path) -> None:
    recipe = Recipe(Scenes(load_params("town", [*PLACE, *CLEAR, *SMALL]), 7), planted.SETTINGS, planted.IMAGE)
    assert generate(Plan(tmp_path / "clean", 1, recipe, 1), lambda event: None).exit_code == 0
    chosen = [fault for fault in (*FAULTS, *OF_STREETS) if fault.name in KINDS]
    assert len(chosen) == len(KINDS)
    results = planted.table(tmp_path / "clean", [*chosen, *OF_TOWNS], tmp_path)
    assert [result.row() for result in results if not result.is_found] == []


def test_lines_that_the_host_has_passed_are_no_fault_of_a_clip() -> None:
    place = ["town.junction=crossing", "town.control=priority", "town.host_place=in", "town.n_more=0", "trees.n=0"]
    scenes = Scenes(load_params("town", place), 7, shots=clips(3, 0.5))
    frames = [Evidence(world, seen(label(world, world.view))) for world in (sample_world(scenes, i) for i in range(3))]
    lines = [{lane.id for lane in evidence.labels.lanes} for evidence in frames]
    assert lines[0] - lines[-1]
    assert [findings(evidence, "labels") for evidence in frames] == [[], [], []]
    graph = frames[-1].labels.graph
    unknown = replace(graph.segments[0], centerlines=("nowhere",), left="no segment")
    wrong = replace(frames[-1].labels, graph=replace(graph, segments=(unknown, *graph.segments[1:])))
    assert "graph" in reasons(replace(frames[-1], labels=wrong), "labels")
