"""Outlines of a scene's roads, ground, objects, trees and structures, in the road frame at the host; of a sample
without a scene there are none."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.figures.colors import Rgb
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel, Labels
from synth3dlanes.roads.network import SEARCH_RATIO
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import KIND_OF_CATEGORY
from synth3dlanes.system.arrays import Matrix4, Points3
from synth3dlanes.world.placement import PlacedObject
from synth3dlanes.world.solids import Body
from synth3dlanes.world.world import World, resolve

BEHIND_M = 10.0
AHEAD_M = 120.0
# Greatest angle to the side at which a frustum is drawn.
WIDEST_RAD = 1.3


@dataclass(frozen=True)
class ObjectOutline:
    """The four corners on the ground, front right first, clockwise from above; height of the body."""

    corners_road: Float[np.ndarray, "4 3"]
    height_m: float
    color: Rgb


@dataclass(frozen=True)
class TreeOutline:
    """Base point, crown radius and height."""

    foot_road: Float[np.ndarray, "3"]
    radius_m: float
    height_m: float


@dataclass(frozen=True)
class SceneView:
    """A scene in the road frame of its camera, within the range of its labels."""

    scene: Scene | None
    labels: Labels

    @cached_property
    def world(self) -> World | None:
        return None if self.scene is None else resolve(self.scene)

    @property
    def behind_m(self) -> float:
        """How far behind the host it is shown."""
        return BEHIND_M + (0.0 if self.scene is None else self.scene.shot.behind_m)

    @cached_property
    def lanes_road(self) -> list[Points3]:
        """The points of every lane of the labels."""
        return [transform(self.labels.camera.road_from_cam, lane.xyz_cam) for lane in self.labels.lanes]

    @cached_property
    def road_from_world(self) -> Matrix4:
        return np.asarray(self.labels.camera.road_from_cam @ invert(self.labels.camera.world_from_cam))

    @cached_property
    def roads(self) -> list[tuple[Points3, Points3]]:
        """Both edges of each strip of pavement in range, shoulders included."""
        if self.world is None:
            return []
        strips = self.world.ground.paved.strips(self.world.view.world_from_host[:2, 3], AHEAD_M / SEARCH_RATIO)
        return [
            (transform(self.road_from_world, left), transform(self.road_from_world, right)) for left, right in strips
        ]

    @cached_property
    def ground_along_host(self) -> Points3:
        """The surface along the host's way."""
        if self.world is None:
            return np.zeros((0, 3))
        ahead_m = np.arange(-self.behind_m, AHEAD_M + 0.5)
        return transform(self.road_from_world, self.world.network.host_points(self.world.view.camera, ahead_m))

    @property
    def ramp_foot(self) -> Float[np.ndarray, "3"] | None:
        """The point where a road starts to rise from the terrain; None if the labels have no ramp."""
        roads = () if self.world is None else self.world.network.roads
        raised = next((road for road in roads if road.ramp), None)
        if self.labels.graph.ramp_start_s_m is None or raised is None or raised.ramp is None:
            return None
        foot_world = raised.points(np.array([raised.ramp.start_m]), 0.0)
        return np.asarray(transform(self.road_from_world, foot_world)[0])

    def ground_grid(self, half_width_m: float, step_m: float) -> Float[np.ndarray, "rows columns 3"] | None:
        """The ground as built on a grid from behind the host to AHEAD_M: rows go forward, columns to the right."""
        if self.world is None:
            return None
        y, x = np.meshgrid(
            np.arange(-self.behind_m, AHEAD_M + step_m / 2, step_m),
            np.arange(-half_width_m, half_width_m + step_m / 2, step_m),
            indexing="ij",
        )
        flat_world = transform(invert(self.road_from_world), np.stack([x, y, np.zeros_like(x)], -1))
        xy_world = flat_world[..., :2]
        built_world = np.concatenate([xy_world, self.world.ground.height(xy_world)[..., None]], -1)
        return transform(self.road_from_world, built_world)

    @cached_property
    def objects(self) -> list[ObjectOutline]:
        """Cars, people, riders and road works."""
        return [] if self.world is None else [self._outline(item) for item in self.world.view.objects]

    @cached_property
    def trees(self) -> list[TreeOutline]:
        if self.world is None:
            return []
        scene, feet_world = self.world.scene, self.world.site.trees_world
        models = scene.assets.tree_models
        return [
            TreeOutline(
                foot_road,
                models[tree.model - 1].crown_radius_m * tree.scale,
                models[tree.model - 1].height_m * tree.scale,
            )
            for tree, foot_road in zip(scene.trees, transform(self.road_from_world, feet_world), strict=True)
        ]

    @property
    def structures(self) -> Sequence[Body]:
        """What stands beside or over the road."""
        return () if self.world is None else self.world.site.structures

    def _outline(self, item: PlacedObject) -> ObjectOutline:
        corners_object = item.size_m * [(1, 1, 0), (1, -1, 0), (-1, -1, 0), (-1, 1, 0)] / 2
        corners_road = transform(self.road_from_world @ item.world_from_object, corners_object)
        color = KIND_OF_CATEGORY[item.category].color
        if item.colors:
            red, green, blue = (round(255 * channel) for channel in item.colors[0])
            color = red, green, blue
        return ObjectOutline(corners_road, float(item.size_m[2]), color)


def frustum(camera: CameraLabel, corners_img: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Rays of points of the image, scaled to y = 1. A point that the lens sees far aside or not at all is moved towards
    the middle of the image until its ray can be drawn."""
    middle = camera.img_from_cam[:2, 1]
    rays = np.full((len(corners_img), 3), [0.0, 1.0, 0.0])
    for share in np.linspace(0.05, 1, 20):
        found = camera.rays(middle + share * (corners_img - middle))
        drawn = found[:, 1] > np.cos(WIDEST_RAD) if not camera.lens.is_pinhole else np.full(len(found), True)
        rays[drawn] = found[drawn]
    return np.asarray(rays / rays[:, 1:2])
