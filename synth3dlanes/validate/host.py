"""Check that the host is in its scene's lane, at the scene's offset from the lane's middle, and clear of all cars.

Computed from the labels' points and independent of `geometry.camera`, which places the camera.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import Matrix4, invert, transform, turned
from synth3dlanes.geometry.placement import HOST_SIZE_M, footprint, overlaps_any
from synth3dlanes.labels import CameraLabel, Labels, Lane
from synth3dlanes.scene import Scene
from synth3dlanes.validate.findings import Finding
from synth3dlanes.world import World

LAW_M = 0.001


def check_host(world: World, labels: Labels) -> Iterator[Finding]:
    """Findings about the host's position."""
    camera = world.view.camera
    segment = world.scene.road.segments_at(camera.y_m)[camera.lane - 1]
    paths = next((found.centerlines for found in labels.graph.segments if found.id == segment), ())
    lanes = [lane for lane in labels.lanes if lane.id in paths]
    world_from_host = host_of(world.scene, labels.camera)
    foot, ahead = world_from_host[:2, 3], world_from_host[:2, 1]
    asides_m = [aside_m for lane in lanes for aside_m in _asides(labels, lane, foot)]
    if not asides_m:
        yield Finding("", f"host: expected a centre line of its lane {segment}, got none")
    elif min(abs(aside_m - camera.offset_m) for aside_m in asides_m) > LAW_M:
        found = min(asides_m, key=lambda aside_m: abs(aside_m - camera.offset_m))
        yield Finding(
            lanes[0].id, f"host: expected {camera.offset_m:+.3f} m from its lane's middle, got {found:+.3f} m"
        )
    body = footprint(foot, ahead / np.linalg.norm(ahead), *HOST_SIZE_M)
    for i, (car, pose) in enumerate(zip(world.scene.cars, world.view.world_from_cars, strict=True)):
        model, along = world.scene.assets.car_models[car.model - 1], pose[:2, 1] / np.linalg.norm(pose[:2, 1])
        place = footprint(pose[:2, 3], along, model.length_m * car.scale, model.width_m * car.scale)
        if overlaps_any(body, place[None]):
            yield Finding("", f"cars.{i}: overlaps the host's body")


def host_of(scene: Scene, camera: CameraLabel) -> Matrix4:
    """The host's road frame, from the labels' camera and its place on the host."""
    place = turned(0.0, scene.camera.right_m, scene.camera.forward_m)
    return np.asarray(camera.world_from_cam @ invert(camera.road_from_cam) @ invert(place))


def _asides(labels: Labels, lane: Lane, foot: Float[np.ndarray, "2"]) -> tuple[float, float]:
    """Two estimates of how far right of a lane a point beside it is: the distance to the line through the lane's point
    nearest to it and the next one, and the signed distance to that point (for a lane that opens, which is not parallel
    to the road)."""
    points = transform(labels.camera.world_from_cam, lane.xyz_cam)[:, :2]
    nearest = min(int(np.hypot(*(points - foot).T).argmin()), len(points) - 2)
    first, second = points[nearest : nearest + 2]
    (dx, dy), (x, y) = (second - first) / np.linalg.norm(second - first), foot - first
    across_m = float(x * dy - y * dx)
    return across_m, float(np.copysign(np.hypot(x, y), across_m))
