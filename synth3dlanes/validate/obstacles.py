"""`object_visible` against the sizes of cars and trees alone: works without passes and without Blender.

A point can only be hidden by an object whose bounding box its line of sight meets, and is hidden for certain where
that goes through the core of a car.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.ground import Ground
from synth3dlanes.geometry.placement import tree_positions, world_from_car
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.geometry.transforms import Matrix4, invert, transform
from synth3dlanes.labels import Labels
from synth3dlanes.scene import Scene
from synth3dlanes.validate.findings import Finding

# Meshes may stand out of their nominal boxes by mirrors and twigs.
ROOM = 1.15
# Every body is solid within this part of its box: between wheels and windows, well inside its outline.
CORE_WIDTH, CORE_LENGTH, CORE_HEIGHT = 0.7, 0.7, (0.3, 0.5)
# A sight line may graze the core's edges.
MAX_WRONG = 1


def check_objects(scene: Scene, labels: Labels) -> Iterator[Finding]:
    """Lanes with points that are called hidden with nothing there to hide them, or seen through a car."""
    points_world = transform(labels.camera.world_from_cam, np.concatenate([lane.xyz_cam for lane in labels.lanes]))
    may_hide, must_hide = _hidden(scene, labels.camera.world_from_cam[:3, 3], points_world)
    ends = np.cumsum([len(lane.xyz_cam) for lane in labels.lanes])[:-1]
    for lane, may, must in zip(labels.lanes, np.split(may_hide, ends), np.split(must_hide, ends), strict=True):
        assert lane.object_visible is not None
        through, unhidden = int((lane.object_visible & must).sum()), int((~lane.object_visible & ~may).sum())
        if through > MAX_WRONG:
            yield Finding(lane.id, f"object_visible: expected points behind cars as hidden, got {through} as seen")
        if unhidden:
            yield Finding(
                lane.id, f"object_visible: got {unhidden} points as hidden where no car or tree is in the way"
            )


def _hidden(
    scene: Scene, eye_world: Float[np.ndarray, "3"], points_world: Float[np.ndarray, "n 3"]
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Which points an object may hide, and which one must."""
    plan = RoadPlan(scene)
    may, must = (np.zeros(len(points_world), dtype=bool) for _ in range(2))
    for car in scene.cars:
        model, pose = scene.assets.car_models[car.model - 1], world_from_car(plan, car)
        half = np.array([model.width_m, model.length_m, 0.0]) / 2
        up = np.array([0, 0, model.height_m])
        low, high = CORE_HEIGHT
        shrunk = half * [CORE_WIDTH, CORE_LENGTH, 0]
        may |= _meets(pose, car.scale, (-half * ROOM, half * ROOM + up * ROOM), eye_world, points_world)
        must |= _meets(pose, car.scale, (-shrunk + low * up, shrunk + high * up), eye_world, points_world)
    for tree, foot in zip(scene.trees, tree_positions(Ground(plan), scene.trees), strict=True):
        shape, pose = scene.assets.tree_models[tree.model - 1], np.eye(4)
        pose[:3, 3] = foot
        crown = np.array([shape.crown_radius_m, shape.crown_radius_m, 0.0])
        box = (-crown * ROOM, crown * ROOM + [0, 0, shape.height_m * ROOM])
        may |= _meets(pose, tree.scale, box, eye_world, points_world)
    return may, must


def _meets(
    world_from_object: Matrix4,
    scale: float,
    box: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]],
    eye_world: Float[np.ndarray, "3"],
    points_world: Float[np.ndarray, "n 3"],
) -> Bool[np.ndarray, " n"]:
    """Which straight lines from the eye to the points meet a box, given in the object's own frame at scale 1."""
    object_from_world = invert(world_from_object)
    eye = transform(object_from_world, eye_world) / scale
    to = transform(object_from_world, points_world) / scale - eye
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = ((side - eye) / to for side in box)
    enters = np.nanmax(np.minimum(first, second), axis=1)
    leaves = np.nanmin(np.maximum(first, second), axis=1)
    return np.asarray((enters <= leaves) & (leaves > 0) & (enters < 1))
