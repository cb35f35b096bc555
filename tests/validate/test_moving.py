"""Velocities against the way from picture to picture: the check knows no world, so a fault of the code shows, too."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.labels.labels import Labels
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots, clips
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.report import ValidationReport
from tests.validate.examining import examine

Clip = list[Evidence]
HILLY = ("terrain.n_gaussians=6", "cars.n=8", "trees.n=0", "motion.car_speed_m_s=[8, 30]")
# The host drives up to a crossing, so cars brake and turn.
TOWN = ("town.junction=crossing", "town.n_more=0", "town.host_place=before", "town.host_m=40", "trees.n=0")


def clip(preset: str, overrides: Sequence[str], shots: Shots, index: int = 0) -> Clip:
    scenes, n = Scenes(load_params(preset, overrides), 900, shots=shots), shots.per_scene
    worlds = [sample_world(scenes, i) for i in range(index * n, index * n + n)]
    return [Evidence(world, label(world, world.view)) for world in worlds]


def problems(frames: Clip) -> list[str]:
    """What the report says of clips whose labels alone are there."""
    report = ValidationReport()
    for i, evidence in enumerate(frames):
        report.sample(f"train:{i:08d}", examine(evidence, "moving"))
    return [problem.line() for problem in report.problems]


def edited(frames: Clip, change: Callable[[int, ObjectLabel], ObjectLabel]) -> Clip:
    """The clip with other objects in its labels, by the frame's number."""

    def of_frame(i: int, labels: Labels) -> Labels:
        return replace(labels, objects=tuple(change(i, item) for item in labels.objects or ()))

    return [replace(evidence, labels=of_frame(i, evidence.labels)) for i, evidence in enumerate(frames)]


def velocity(item: ObjectLabel, change: Callable[[np.ndarray], np.ndarray]) -> ObjectLabel:
    return item if item.velocity_cam is None else replace(item, velocity_cam=change(item.velocity_cam))


@pytest.fixture(scope="module")
def on_hills() -> Clip:
    return clip("appendix_i", HILLY, clips(3, 5.0))


@pytest.mark.parametrize("fps", [2.0, 30.0])
def test_objects_of_clips_move_as_their_velocities_say(fps: float) -> None:
    frames = clip("appendix_i", HILLY, clips(2, fps)) + clip("appendix_i", HILLY, clips(2, fps), 1)
    assert all(evidence.labels.objects for evidence in frames)
    assert problems(frames) == []


FAULTS: dict[str, Callable[[ObjectLabel], ObjectLabel]] = {
    "5 % too fast": lambda item: velocity(item, lambda v: 1.05 * v),
    "in the frame of the object": lambda item: velocity(item, lambda v: np.linalg.norm(v) * np.array([0.0, 1.0, 0.0])),
    "backwards": lambda item: velocity(item, lambda v: -v),
    "relative to nothing": lambda item: velocity(item, lambda v: 0 * v),
}


@pytest.mark.parametrize("name", FAULTS)
def test_wrong_velocities_are_found(on_hills: Clip, name: str) -> None:
    found = problems(edited(on_hills, lambda i, item: FAULTS[name](item)))
    assert found
    assert all("objects." in line and "as its velocities say" in line for line in found), found


def test_an_object_that_jumps_and_numbers_that_are_swapped_are_found(on_hills: Clip) -> None:
    def jumps(i: int, item: ObjectLabel) -> ObjectLabel:
        return replace(item, center_cam=item.center_cam + np.array([0.5, 0, 0])) if (i, item.id) == (1, 3) else item

    def swapped(i: int, item: ObjectLabel) -> ObjectLabel:
        return replace(item, id={1: 2, 2: 1}.get(item.id, item.id)) if i == 1 else item

    first = (on_hills[0].labels.objects or ())[0].id
    assert first == 1
    assert {line.split(":")[2].split()[0] for line in problems(edited(on_hills, jumps))} == {"objects.3"}
    assert {line.split(":")[2].split()[0] for line in problems(edited(on_hills, swapped))} == {"objects.1", "objects.2"}


def test_a_line_that_is_elsewhere_in_one_picture_is_named(on_hills: Clip) -> None:
    def aside(evidence: Evidence) -> Evidence:
        first, *others = evidence.labels.lanes
        moved = replace(first, xyz_cam=first.xyz_cam + np.array([0.2, 0, 0]))
        return replace(evidence, labels=replace(evidence.labels, lanes=(moved, *others)))

    lane = on_hills[0].labels.lanes[0].id
    found = problems([on_hills[0], aside(on_hills[1]), on_hills[2]])
    assert [line.split(": ")[:2] for line in found] == [[f"train:{i:08d}", lane] for i in (1, 2)]
    assert all("expected it where the picture before has this line, got it up to 0.2" in line for line in found)


def test_cameras_of_a_rig_have_objects_in_one_place() -> None:
    frames = clip("appendix_i", HILLY, Shots(cameras=load_rig("nuscenes")[:3]))
    assert problems(frames) == []
    moved = edited(frames, lambda i, item: replace(item, center_cam=item.center_cam + np.array([0, 0.1 * (i == 2), 0])))
    assert len(problems(moved)) == len(frames[2].labels.objects or ()) > 1


@pytest.mark.thorough
def test_traffic_of_towns_moves_as_its_velocities_say_and_not_as_at_the_clips_beginning() -> None:
    frames = clip("town", TOWN, clips(4, 2.0))
    assert problems(frames) == []
    first = {item.id: np.linalg.norm(item.velocity_cam) for item in frames[0].labels.objects or ()}  # type: ignore[arg-type]

    def as_at_first(i: int, item: ObjectLabel) -> ObjectLabel:
        # A fault that there was: the speed that a car had when the clip began.
        return velocity(item, lambda v: first[item.id] * item.cam_from_object[:3, 1])

    assert problems(edited(frames, as_at_first))
