"""The host's law, judged by the labels' own points: every drawn scene keeps it, and what breaks it is named."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.labels.labels import Labels
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.scene import Car, Scene
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed
from tests.thorough import presets
from tests.validate.examining import findings

# Before a split, and before a merge: beside lanes that open, too.
EVERYWHERE = ["camera.y_m=[-100, 0]", "camera.offset_m=[-1, 1]", "road.exit_angle_deg=[1, 15]", "cars.n=0", "trees.n=0"]


def faults(scene: Scene, labels: Labels) -> list[tuple[str, str]]:
    return [(found.lane, found.reason) for found in findings(Evidence(resolve(scene), labels), "host")]


@pytest.mark.parametrize("preset", presets("appendix_i", "streets"))
def test_every_drawn_scene_keeps_it(preset: str) -> None:
    for index in range(3):
        scene = sample_scene(Scenes(load_params(preset)), index)
        assert faults(scene, ground_truth(scene)) == []


def test_it_is_kept_where_a_lane_through_a_junction_ends() -> None:
    """Where its own lane has less than two points left, the next one is a host's."""
    params = load_params("town", ["town.host_place=in", "town.host_m=59.9", "town.junction=crossing", "town.traffic=0"])
    scene = sample_scene(Scenes(params), 1)
    labels = ground_truth(scene)
    assert faults(scene, labels) == []
    aside = changed(scene, camera={"offset_m": scene.camera.offset_m + 0.1})
    assert len(faults(aside, labels)) == 1


@pytest.mark.thorough
def test_it_is_kept_everywhere_on_every_road() -> None:
    params, seen = load_params("tiny", EVERYWHERE), set()
    for index in range(60):
        scene = sample_scene(Scenes(params), index)
        seen.add((scene.road.topology, scene.road.flip_lateral, scene.camera.y_m > -40))
        assert faults(scene, ground_truth(scene)) == []
    assert len(seen) == 16


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("aside_m", [0.002, -0.002, 3.0])
def test_a_host_aside_of_its_place_is_named_with_its_lane(flipped: bool, aside_m: float) -> None:
    scene = changed(road={"flip_longitudinal": flipped}, camera={"offset_m": 0.3})
    moved = changed(scene, camera={"offset_m": 0.3 + aside_m})
    ((lane, reason),) = faults(scene, ground_truth(moved))
    assert lane == "main_2"
    assert reason == f"host: expected +0.300 m from its lane's middle, got {0.3 + aside_m:+.3f} m"


def test_a_host_in_another_lane_is_named_with_the_lane_that_it_should_be_in() -> None:
    for topology in (1, 2, 3, 4):
        scene = changed(road={"topology": topology}, camera={"lane": 1})
        other = changed(scene, camera={"lane": 2})
        ((lane, reason),) = faults(other, ground_truth(scene))
        assert lane == "main_2"
        assert reason.endswith("got -3.500 m")


def test_a_host_lane_without_centre_lines_is_a_fault() -> None:
    labels = ground_truth(FLAT)
    without = replace(labels, lanes=tuple(lane for lane in labels.lanes if lane.id != "main_2"))
    assert faults(FLAT, without) == [("", "host: expected a centre line of its lane main_2, got none")]


@pytest.mark.parametrize(
    ("lane", "behind_m", "is_clear"), [("main_2", 4.0, False), ("main_2", 6.0, True), ("main_1", 0, True)]
)
def test_a_car_in_the_hosts_body_is_named(lane: str, behind_m: float, is_clear: bool) -> None:
    car = Car(model=1, scale=1.0, color=(1, 1, 1), gloss=0.5, lane=lane, s_m=FLAT.camera.y_m - behind_m)
    scene = FLAT.model_copy(update={"cars": (car.model_copy(update={"s_m": 50.0}), car)})
    found = faults(scene, ground_truth(scene))
    assert found == ([] if is_clear else [("", "cars.1: overlaps the host's body")])


def test_a_turned_camera_is_not_what_the_law_is_about() -> None:
    scene = changed(camera={"pitch_rad": 0.1, "roll_rad": 0.2, "offset_m": -0.25})
    assert faults(scene, ground_truth(scene)) == []
    turned = ground_truth(scene)
    assert not np.allclose(turned.camera.road_from_cam[:3, :3], np.eye(3))
