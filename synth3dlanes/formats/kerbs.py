"""The kerbs of a scene as lanes of the labels, for formats that have them: the foot of their front, on the road."""

import numpy as np

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel, Lane
from synth3dlanes.scene.scene import Scene
from synth3dlanes.truth.ground_truth import POINTS_STEP_M, RANGE_M
from synth3dlanes.world.rails import KERBS, foot_of_front
from synth3dlanes.world.visibility import seen_over_ground
from synth3dlanes.world.world import resolve

LEAST_POINTS = 2


def kerb_lanes(scene: Scene, camera: CameraLabel) -> tuple[Lane, ...]:
    """Kerbs up to as far ahead as lanes are labelled, a point every metre, as this camera sees them; `kerb_0` and so on
    by their numbers among the scene's rails. They have no paint."""
    kerbs = {i: rail for i, rail in enumerate(scene.roadside.rails) if rail.kind in KERBS}
    if not kerbs:
        return ()
    world, lanes = resolve(scene), []
    host_m = float(camera.world_from_cam[1, 3])
    for i, rail in kerbs.items():
        s = np.arange(min(rail.from_m, rail.to_m), max(rail.from_m, rail.to_m), POINTS_STEP_M)
        ahead_m = world.network.stations(s) - host_m
        s = s[(ahead_m > 0) & (ahead_m < RANGE_M)][:: int(world.network.onwards)]
        if len(s) < LEAST_POINTS:
            continue
        points_world = foot_of_front(world.ground, rail, s)
        xyz_cam = transform(invert(camera.world_from_cam), points_world)
        seen = seen_over_ground(world.ground, camera.world_from_cam[:3, 3], points_world)
        masks = camera.shows(xyz_cam), seen, None
        lanes.append(Lane(f"kerb_{i}", "delimiter", rail.road, "none", None, None, xyz_cam, *masks))
    return tuple(lanes)
