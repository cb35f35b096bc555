"""What follows from a scene alone: computed once, when the first proof of its sample asks. World frame; no pixels."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import Matrix4
from synth3dlanes.geometry import meshes
from synth3dlanes.geometry.ground import Ground
from synth3dlanes.geometry.placement import tree_positions, world_from_car
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.ground_truth import labels_on
from synth3dlanes.labels import Labels
from synth3dlanes.scene import Scene
from synth3dlanes.validate.paint import Paint


@dataclass(frozen=True, eq=False)
class World:
    """One scene and what its geometry makes of it."""

    scene: Scene

    @cached_property
    def plan(self) -> RoadPlan:
        """Its roads."""
        return RoadPlan(self.scene)

    @cached_property
    def ground(self) -> Ground:
        """Its ground as built."""
        return Ground(self.plan)

    @cached_property
    def truth(self) -> Labels:
        """Its labels, but for what only a rendered scene can tell."""
        return labels_on(self.ground)

    @cached_property
    def paint(self) -> Paint:
        """Its paint."""
        return Paint(self.scene)

    @cached_property
    def pavement(self) -> list[meshes.Mesh]:
        """The surfaces that cars stand on, as Blender is given them."""
        return meshes.road_meshes(self.ground)

    @cached_property
    def verges(self) -> list[meshes.Mesh]:
        """Verges and embankments, as Blender is given them."""
        return meshes.verge_meshes(self.ground)

    @cached_property
    def world_from_cars(self) -> list[Matrix4]:
        """The pose of every car, without its scale."""
        return [world_from_car(self.plan, car) for car in self.scene.cars]

    @cached_property
    def trees_world(self) -> Float[np.ndarray, "n 3"]:
        """The feet of all trees."""
        return tree_positions(self.ground, self.scene.trees)
