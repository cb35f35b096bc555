"""Evidence: all that checks of a sample may ask for, each computed once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.sweep import LidarPoints, Sweep
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane
from synth3dlanes.params.distributions import Distribution
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Passes, Points3, RgbImage
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.boxes import StructureBoxes, structure_boxes
from synth3dlanes.validate.integrity import Entry
from synth3dlanes.validate.paint import WorldPaint
from synth3dlanes.validate.pixels import luma
from synth3dlanes.validate.places import places
from synth3dlanes.world.world import World

# Cosine of the angle between the viewing direction and a pixel's ray, of a lens, from which on depth tells a place.
LEAST_AHEAD = 0.05
# Points this close to the image's border may be on either side of it after rounding.
BORDER_PX = 0.2


@dataclass(frozen=True, eq=False)
class Evidence:
    """A sample's labels, image, passes and sweep, the world of its scene, its place in the index, and what
    follows from its weather and time of day (`Origin.follows`); what may be missing is None or empty."""

    world: World
    labels: Labels
    image: RgbImage | None = None
    passes: Passes = field(default_factory=dict)
    sweep: Sweep | None = None
    entry: Entry | None = None
    follows: Mapping[str, Distribution] | None = None

    @property
    def scene(self) -> Scene:
        """The sample's scene."""
        return self.world.scene

    @property
    def camera(self) -> CameraLabel:
        """The labels' camera."""
        return self.labels.camera

    @cached_property
    def has(self) -> frozenset[str]:
        """What is there to be checked, in the words of `Check.needs`."""
        parts = {
            "image": self.image is not None,
            "row": self.entry is not None,
            "lidar": self.sweep is not None,
            "origin": self.follows is not None,
            "aim": all((self.inside_px(lane)[lane.in_image] > -BORDER_PX).all() for lane in self.labels.lanes),
        }
        return frozenset(self.passes) | {name for name, is_there in parts.items() if is_there}

    @cached_property
    def truth(self) -> Labels:
        """The labels of the scene, without what needs a rendered one."""
        return label(self.world, self.world.view)

    @cached_property
    def paint(self) -> WorldPaint:
        """The paint of the scene's lines."""
        return WorldPaint(self.world)

    @cached_property
    def is_single(self) -> dict[str, Bool[np.ndarray, " n"]]:
        """Which points of each lane are not where roads lie over each other."""
        lanes = self.labels.lanes
        points = transform(self.camera.world_from_cam, np.concatenate([lane.xyz_cam for lane in lanes]))
        single = places(self.world.ground, points[:, :2]).is_single()
        ends = np.cumsum([len(lane.xyz_cam) for lane in lanes])[:-1]
        return {lane.id: of for lane, of in zip(lanes, np.split(single, ends), strict=True)}

    @cached_property
    def structures(self) -> StructureBoxes:
        """The boxes of all structures."""
        return structure_boxes(self.world)

    @property
    def picture(self) -> RgbImage:
        """The image, of evidence that has one."""
        assert self.image is not None
        return self.image

    @cached_property
    def returns(self) -> LidarPoints | None:
        """The points of the sweep, if there is one."""
        return None if self.sweep is None else self.sweep.points()

    @cached_property
    def luma(self) -> Float[np.ndarray, "h w"]:
        """The image's brightness."""
        return luma(self.picture)

    @cached_property
    def has_points(self) -> Bool[np.ndarray, "h w"]:
        """Which pixels' depths say where a point is: where something is hit, and not at a right angle to the viewing
        direction, where a fisheye may see and depth is 0 at any distance."""
        hit = np.isfinite(self.passes["depth"])
        if self.camera.lens.is_pinhole:
            return hit
        rows, columns = np.indices(hit.shape)
        rays = self.camera.rays(np.stack([columns, rows], axis=-1) + 0.5)
        return np.asarray(hit & (np.abs(rays[..., 1]) > LEAST_AHEAD))

    def points_cam(self, rows: Int[np.ndarray, " n"], columns: Int[np.ndarray, " n"]) -> Points3:
        """The points that the depth pass has at the centres of pixels. Camera frame."""
        depth_m = self.passes["depth"][rows, columns].astype(float)
        return self.camera.points(np.column_stack([columns, rows]) + 0.5, depth_m)

    def points_world(self, rows: Int[np.ndarray, " n"], columns: Int[np.ndarray, " n"]) -> Points3:
        """The same in the world frame."""
        return transform(self.camera.world_from_cam, self.points_cam(rows, columns))

    def inside_px(self, lane: Lane) -> Float[np.ndarray, " n"]:
        """As the function `inside_px`, in the sample's camera."""
        return inside_px(self.camera, lane)


def inside_px(camera: CameraLabel, lane: Lane) -> Float[np.ndarray, " n"]:
    """Distance of a lane's projected points from the nearest border of the image, negative outside; NaN behind the
    camera."""
    uv = camera.project(lane.xyz_cam)
    return np.asarray(np.minimum(uv, [camera.width_px, camera.height_px] - uv).min(axis=1))
