"""Where the host stands in drawn scenes: at its offset from the middle of its lane, by the labels' own points, which
`geometry.camera` does not use, and clear of every car."""

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import invert, transform, turned
from synth3dlanes.params.params import load_params
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.placement import HOST_SIZE_M, footprint, overlaps_any
from synth3dlanes.world.world import World, resolve
from tests.scenes import changed
from tests.thorough import presets

# Distance of a chord's middle from a sharp bend, and the end of a lane without points: those of maps are 1 m apart.
LAW_M, CHORD_M, REST_M = 0.001, 0.03, 2.0


def off_its_lane_m(world: World) -> float:
    """How far the host is from the scene's offset, to the right."""
    labels, camera = label(world, world.view), world.view.camera
    on_host = turned(0.0, camera.right_m, camera.forward_m)
    host = labels.camera.world_from_cam @ invert(labels.camera.road_from_cam) @ invert(on_host)
    ends = [world.network.host_lane(camera.lane, camera.y_m + ahead_m).id for ahead_m in (0.0, REST_M)]
    paths = {path for part in labels.graph.segments if part.id in ends for path in part.centerlines}
    points = {lane.id: transform(labels.camera.world_from_cam, lane.xyz_cam)[:, :2] for lane in labels.lanes}
    off_m = [aside - camera.offset_m for path in paths & points.keys() for aside in asides_m(points[path], host[:2, 3])]
    return min(off_m, key=abs)


def asides_m(points: np.ndarray, foot: np.ndarray) -> tuple[float, ...]:
    """Estimates of how far right of a lane a place beside it is: the distance to the line through the lane's point
    nearest to it and the next one, the signed distance to that point (for a lane that opens, which is not parallel to
    the road), and the distance to the parabola through three points there (for a bend that begins there)."""
    nearest = min(int(np.hypot(*(points - foot).T).argmin()), len(points) - 2)
    first, second = points[nearest : nearest + 2]
    (dx, dy), (x, y) = (second - first) / np.linalg.norm(second - first), foot - first
    across_m = float(x * dy - y * dx)
    three = points[max(min(nearest - 1, len(points) - 3), 0) :][:3] - first
    along, aside = three @ [dx, dy], three @ [dy, -dx]
    bent_m = float(np.polyval(np.polyfit(along, aside, len(three) - 1), x * dx + y * dy))
    return across_m, float(np.copysign(np.hypot(x, y), across_m)), across_m - bent_m


def cars_in_the_host(world: World) -> list[int]:
    pose = world.view.world_from_host
    body = footprint(pose[:2, 3], pose[:2, 1] / np.linalg.norm(pose[:2, 1]), *HOST_SIZE_M)
    found = []
    for i, item in enumerate(item for item in world.view.objects if not item.kind):
        along = item.world_from_object[:2, 1]
        place = item.world_from_object[:2, 3]
        width_m, length_m, _ = item.size_m
        outline = footprint(place, along / np.linalg.norm(along), length_m, width_m)
        found += [i] if overlaps_any(body, outline[None]) else []
    return found


@pytest.mark.parametrize("preset", presets("appendix_i", "streets"))
def test_every_drawn_host_is_in_its_lane_and_clear_of_cars(preset: str) -> None:
    for index in range(3):
        world = sample_world(Scenes(load_params(preset)), index)
        law_m = CHORD_M if world.network.host_way(world.view.camera).is_measured else LAW_M
        assert abs(off_its_lane_m(world)) < law_m
        assert cars_in_the_host(world) == []


def test_so_it_is_where_a_lane_through_a_junction_ends() -> None:
    """Where its own lane has less than two points left, the next one is a host's."""
    params = load_params("town", ["town.host_place=in", "town.host_m=59.9", "town.junction=crossing", "town.traffic=0"])
    assert abs(off_its_lane_m(sample_world(Scenes(params), 1))) < CHORD_M


@pytest.mark.parametrize("flipped", [False, True])
def test_an_offset_is_to_the_right_whatever_the_cameras_angles(flipped: bool) -> None:
    camera = {"offset_m": 0.3, "pitch_rad": 0.1, "roll_rad": 0.2}
    world = resolve(changed(road={"flip_longitudinal": flipped}, camera=camera))
    assert abs(off_its_lane_m(world)) < LAW_M
    middle = resolve(changed(world.scene, camera={"offset_m": 0.0}))
    right = middle.view.world_from_host[:2, 0]
    assert (world.view.eye_world - middle.view.eye_world)[:2] @ right == pytest.approx(0.3, abs=0.02)
