"""Check that cars, trees and structures stand on the rendered ground, and structures beside the pavement.

Compares with the meshes that Blender renders, which are flat between their rows, instead of the formulas.
"""

from collections.abc import Iterator

import numpy as np

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.scene.roadside import Building, Crossing
from synth3dlanes.system.arrays import Matrix4, Points2, Points3
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.faces import ground_of, pavement_of
from synth3dlanes.validate.findings import Result, counted
from synth3dlanes.world.placement import TREE_SINK_M
from synth3dlanes.world.solids import Body
from synth3dlanes.world.spans import PASSAGE_M
from synth3dlanes.world.world import World

# Limits of visible gaps: a rigid car on the sharpest crests has a wheel up to 0.21 m off (1,350 scenes; mostly below
# 5 cm), and beyond RANGE_M of the host the ground's faces are metres long. A tree's base is 0.1 m below the ground
# and its root reaches 0.3 m deeper.
MAX_WHEEL_M, MAX_TREE_M, RANGE_M = 0.25, 0.4, 100.0
# Every eighth foot of a structure is checked; structures reach as deep into the ground as trees do.
FEET_STEP = 8
# Kerbs stand at the very edge. Edges of buildings this near to their lowest point are on the ground.
ROOM_M, LOW_M = 0.05, 0.5


def check_standing(evidence: Evidence) -> Iterator[Result]:
    """Findings about gaps between what stands and the meshes of the ground."""
    world, camera = evidence.world, evidence.camera
    trunks = world.site.trees_world + np.array([0, 0, TREE_SINK_M])
    feet = np.concatenate([np.zeros((0, 3)), *(body.feet_world[::FEET_STEP] for body in world.site.structures)])
    for name, points, faces, limit_m in (
        ("wheel_gap_m", wheels(world), pavement_of(world), MAX_WHEEL_M),
        ("tree_gap_m", trunks, ground_of(world), MAX_TREE_M),
        ("structure_gap_m", feet, ground_of(world), MAX_TREE_M),
    ):
        is_near = np.hypot(*_in(world.view.world_from_host, points)[:, :2].T) < RANGE_M
        points = points[is_near & (_in(camera.world_from_cam, points)[:, 1] > 0)]
        gap_m = np.abs(points[:, 2] - faces.height(points[:, :2], points[:, 2] + PASSAGE_M))
        near_m = gap_m[np.isfinite(gap_m)]
        reason = f"{name}: expected at most {limit_m} m, got {{wrong}} of {{n}} beyond, up to"
        reason += f" {near_m.max(initial=0):.2f} m"
        yield from counted(f"standing.{name}", near_m > limit_m, reason, single=0)


def wheels(world: World) -> Points3:
    """The contact points of all cars' tyres."""
    wheels = [np.zeros((0, 3))]
    for car, world_from_car in zip(world.scene.cars, world.view.world_from_cars, strict=True):
        model = world.scene.assets.car_models[car.model - 1]
        x, y = model.track_m / 2 * car.scale, model.wheelbase_m / 2 * car.scale
        wheels.append(transform(world_from_car, np.array([[-x, y, 0], [x, y, 0], [-x, -y, 0], [x, -y, 0]])))
    return np.concatenate(wheels)


def _in(world_from_frame: Matrix4, points_world: Points3) -> Points3:
    """The points in another frame."""
    return transform(invert(world_from_frame), points_world)


def check_roadside(evidence: Evidence) -> Iterator[Result]:
    """Findings about structures on a pavement; poles may stand on the walkways of a map, and below its decks. What
    stands on a median is left to the road's own checks, and what has no pole hangs."""
    world, roadside = evidence.world, evidence.scene.roadside
    poles = [item for item in roadside.free_elements if item.has_pole]
    items = (*roadside.rails, *roadside.posts, *roadside.crossings, *roadside.buildings, *poles)
    # Bodies of decks, heads and faces follow.
    asked = [
        (number, _outline(body) if isinstance(item, Building) else body.feet_world[:, :2], isinstance(item, Building))
        for number, (item, body) in enumerate(zip(items, world.site.structures, strict=False))
        if not isinstance(item, Crossing) and getattr(item, "side", "") != "median"
    ]
    if not asked:
        return
    n_places = [len(places_xy) for _, places_xy, _ in asked]
    feet = np.concatenate([places_xy for _, places_xy, _ in asked])
    numbers, is_building = (np.repeat([row[i] for row in asked], n_places) for i in (0, 2))
    inside_m = -np.where(is_building, world.ground.clearance(feet), world.ground.paved.off_carriageways(feet))
    inside_m[world.ground.is_stacked(feet)] = -np.inf
    for number in np.unique(numbers[inside_m > ROOM_M]).tolist():
        own_m = inside_m[numbers == number]
        whose = f"structure {number} ({world.site.structures[number].kind})"
        reason = (
            f"{whose}: expected it beside the pavement, got {{wrong}} of {{n}} places up to {own_m.max():.2f} m on it"
        )
        yield from counted("roadside", own_m > ROOM_M, reason, single=0)


def _outline(body: Body) -> Points2:
    """Places along the lower edges of a body's faces."""
    corners = body.corners_world
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    low = ends[(ends[..., 2] < corners[..., 2].min() + LOW_M).all(axis=1)]
    share = np.linspace(0, 1, 9)[:, None, None]
    return np.asarray(((1 - share) * low[:, 0, :2] + share * low[:, 1, :2]).reshape(-1, 2))
