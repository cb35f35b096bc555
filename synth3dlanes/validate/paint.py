"""Where paint lies by the scene: under which points of a delimiter, how wide and which way. Camera frame.

Points are taken to their station on the road, so a line that is labelled aside of its paint is judged at the paint's
dashes all the same.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.camera import project
from synth3dlanes.geometry.lanes import Curve, curves
from synth3dlanes.geometry.meshes import paint_meshes
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.geometry.terrain import gradient_at
from synth3dlanes.geometry.transforms import transform
from synth3dlanes.labels import CameraLabel, Lane
from synth3dlanes.scene import Scene

# Paint thinner than this on the image may fall between the pixels' single samples.
RESOLVED_PX = 1.0

Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class Strip:
    """Points along a line, the unit vector across it in the surface, the surface's normal, whether there is paint at
    their stations, and how wide it looks across the line on the image."""

    points_cam: Points
    across_cam: Points
    normal_cam: Points
    painted: Bool[np.ndarray, " n"]
    width_px: Float[np.ndarray, " n"]

    @property
    def resolved(self) -> Bool[np.ndarray, " n"]:
        """Where there is paint that pixels can show."""
        return self.painted & (self.width_px >= RESOLVED_PX)


class Paint:
    """The paint of one scene: stretches of stations that are painted, by the delimiter's id."""

    def __init__(self, scene: Scene) -> None:
        self.width_m = scene.markings.width_m
        self._scene = scene
        self._plan = RoadPlan(scene)
        self._curves = {curve.id: curve for curve in curves(self._plan)}
        self._stretches = {}
        for id_, mesh in paint_meshes(self._plan).items():
            ends = np.sort(mesh.uv_m[mesh.faces, 1], axis=1)[:, [0, -1]]
            self._stretches[id_] = ends[np.argsort(ends[:, 0])]

    def strip(self, camera: CameraLabel, lane: Lane, points_cam: Points) -> Strip:
        """What is known about points along a lane; they must be two or more, in order."""
        points_world = transform(camera.world_from_cam, points_cam)
        steps = np.gradient(points_cam, axis=0)
        along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        slope = gradient_at(self._scene.terrain, points_world[:, :2])
        up = np.column_stack([-slope, np.ones(len(slope))]) @ camera.world_from_cam[:3, :3]
        across = np.cross(along, up)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        half_m = self.width_m / 2
        left, right, behind, ahead = (
            project(camera.img_from_cam, points_cam + step)
            for step in (-half_m * across, half_m * across, -0.01 * along, 0.01 * along)
        )
        side, course = right - left, ahead - behind
        width_px = np.abs(side[:, 0] * course[:, 1] - side[:, 1] * course[:, 0]) / np.hypot(*course.T)
        return Strip(points_cam, across, np.cross(across, along), self._painted(lane.id, points_world), width_px)

    def _painted(self, id_: str, points_world: Points) -> Bool[np.ndarray, " n"]:
        stretches = self._stretches.get(id_, np.zeros((0, 2)))
        if not len(stretches):
            return np.zeros(len(points_world), dtype=bool)
        s = self._stations(self._curves[id_], points_world[:, :2])
        last_begun = np.clip(np.searchsorted(stretches[:, 0], s, side="right") - 1, 0, None)
        return np.asarray((s >= stretches[last_begun, 0]) & (s <= stretches[last_begun, 1]))

    def _stations(self, curve: Curve, xy_world: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Plan stations of points beside a curve."""
        s, _ = self._plan.project_main(xy_world)
        if curve.fork_road == "exit":
            on_exit, _ = self._plan.project_exit(xy_world, np.maximum(s, 0))
            s = np.where((s >= 0) & (on_exit >= 0), on_exit, s)
        return s
