"""Evidence: all that checks of a sample may ask for, each computed once."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.sweep import LidarPoints, Sweep
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane
from synth3dlanes.scene.instance_ids import numbers_of
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Ids, Passes, Points2, Points3, RgbImage, Scalars
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.validate.bodies import BODIES, Boxes
from synth3dlanes.validate.faces import NEAR_M, NearestFaces, pavement_of
from synth3dlanes.validate.findings import PROOF_M
from synth3dlanes.validate.integrity import Entry
from synth3dlanes.validate.paint import Painted, WorldPaint, is_single, painted_symbols
from synth3dlanes.world.world import World

# At most this many pixels of a kind are used, evenly spread over the image.
MAX_PIXELS = 10_000
# The weights of red, green and blue in the brightness of gamma-coded pixels (ITU-R BT.601).
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
# Cosine of the angle between the viewing direction and a pixel's ray, of a lens, from which on depth tells a place.
LEAST_AHEAD = 0.05
# Points this close to the image's border may be on either side of it after rounding.
BORDER_PX = 0.2
# Points are moved onto the road along the line of sight by at most this.
MAX_FLOAT_M = 0.05
# Upward part of the normals of what is no kerb.
LEVEL = 0.5


def luma(rgb: Shaped[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    """Brightness of gamma-coded pixels, in their own unit."""
    return np.asarray(rgb.astype(np.float32) @ _LUMA)


def some_pixels(
    of: Bool[np.ndarray, "h w"], most: int = MAX_PIXELS
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Rows and columns of at most about `most` of the selected pixels."""
    rows, columns = np.nonzero(of)
    step = 1 + len(rows) // most
    return rows[::step], columns[::step]


@dataclass(frozen=True, eq=False)
class Seen:
    """What pixels or beams of a lidar show: points in the world, their distances ahead of the camera or from the lidar,
    and their ids as far as there are; of pixels their rows and columns."""

    world: World
    eye_world: Float[np.ndarray, "3"]
    points_world: Points3
    range_m: Scalars
    ids: Mapping[str, Ids]
    pixels: Int[np.ndarray, "n 2"] | None = None

    def __len__(self) -> int:
        return len(self.points_world)

    @property
    def is_lidar(self) -> bool:
        """Whether beams show it."""
        return self.pixels is None

    def at(self, which: Bool[np.ndarray, " n"] | Int[np.ndarray, " m"]) -> "Seen":
        """Some of the points."""
        ids = {name: values[which] for name, values in self.ids.items()}
        pixels = None if self.pixels is None else self.pixels[which]
        points_world, range_m = self.points_world[which], self.range_m[which]
        return replace(self, points_world=points_world, range_m=range_m, ids=ids, pixels=pixels)

    @property
    def xy_world(self) -> Points2:
        """The points from above."""
        return self.points_world[:, :2]

    @cached_property
    def is_near(self) -> Bool[np.ndarray, " n"]:
        """Which points are where faces are asked for."""
        away_m = np.abs(self.points_world - self.world.view.eye_world)[:, :2]
        return np.asarray(away_m.max(axis=1, initial=0) < NEAR_M)

    @cached_property
    def pavement(self) -> NearestFaces:
        """The faces of the pavement that are nearest to the points."""
        return pavement_of(self.world).nearest(self.points_world)

    @cached_property
    def on_road(self) -> "Seen":
        """Points that float over the road, moved along the line of sight onto it, where this is reliable."""
        sight = self.points_world - self.eye_world
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            way_m = -self.pavement.above_m / (sight * self.pavement.up_world).sum(axis=1)
        on = (np.abs(way_m) < MAX_FLOAT_M) & (self.pavement.up_world[:, 2] > LEVEL)
        return replace(self.at(on), points_world=self.points_world[on] + way_m[on, None] * sight[on])

    def number(self, kind: str) -> Int[np.ndarray, " n"]:
        """The number of the thing of a kind that each point is of; -1 of none, and without instance ids."""
        if "instance" not in self.ids:
            return np.full(len(self), -1)
        return numbers_of(kind, self.ids["instance"].astype(int))


@dataclass(frozen=True, eq=False)
class Evidence:
    """The world of a sample's scene, its labels, image, passes and sweep, and its place in the index; what may be
    missing is None or empty. A sample of a real drive has no scene, and `numbers` of its own (`numbers_of_lifted`)."""

    known_world: World | None
    labels: Labels
    image: RgbImage | None = None
    passes: Passes = field(default_factory=dict)
    sweep: Sweep | None = None
    entry: Entry | None = None
    numbers: tuple[int, int, int] | None = None

    @property
    def world(self) -> World:
        """The world of the sample's scene, of evidence that has one."""
        assert self.known_world is not None
        return self.known_world

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
            "scene": self.known_world is not None,
            "image": self.image is not None,
            "row": self.entry is not None,
            "lidar": self.sweep is not None,
            "aim": all((inside_px(self.camera, lane)[lane.in_image] > -BORDER_PX).all() for lane in self.labels.lanes),
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
    def painted(self) -> dict[str, list[Painted]]:
        """What is painted, by kinds of instance ids: lines in the order of the labels, then those that these lack."""
        ids = dict.fromkeys([*(lane.id for lane in self.labels.lanes if lane.kind == "delimiter"), *self.paint.ids])
        lines = [Painted("the line", id_, partial(self.paint.beyond_m, id_)) for id_ in ids]
        return {"delimiter": lines, "symbol": painted_symbols(self.world)}

    @cached_property
    def is_single(self) -> dict[str, Bool[np.ndarray, " n"]]:
        """Which points of each lane are not where roads lie over each other."""
        lanes = self.labels.lanes
        points = transform(self.camera.world_from_cam, np.concatenate([lane.xyz_cam for lane in lanes]))
        single = is_single(self.world.ground, points[:, :2])
        ends = np.cumsum([len(lane.xyz_cam) for lane in lanes])[:-1]
        return {lane.id: of for lane, of in zip(lanes, np.split(single, ends), strict=True)}

    def near(self, lane: Lane) -> Bool[np.ndarray, " n"]:
        """The visible points of a lane near the camera where no road lies over another."""
        return lane.visible & self.is_single[lane.id] & (lane.xyz_cam[:, 1] < PROOF_M)

    @cached_property
    def bodies(self) -> dict[str, Boxes]:
        """The boxes of all things that have bodies, by their kinds."""
        return {kind: boxes(self.world) for kind, boxes in BODIES.items()}

    @property
    def picture(self) -> RgbImage:
        """The image, of evidence that has one."""
        assert self.image is not None
        return self.image

    @cached_property
    def returns(self) -> LidarPoints | None:
        """The points of the sweep, if there is one."""
        return None if self.sweep is None else self.sweep.points()

    def seen(self, which: Bool[np.ndarray, "h w"], most: int = MAX_PIXELS) -> Seen:
        """At most about `most` of these pixels of a sample with depth, by the points that they show."""
        rows, columns = some_pixels(which & self.has_points, most)
        points_cam, eye = self.points_cam(rows, columns), self.camera.world_from_cam[:3, 3]
        points = transform(self.camera.world_from_cam, points_cam)
        ids = {name: self.passes[name][rows, columns] for name in ("semantic", "instance") if name in self.passes}
        return Seen(self.world, eye, points, points_cam[:, 1], ids, np.column_stack([rows, columns]))

    @cached_property
    def swept(self) -> Seen:
        """The points of a sample's sweep."""
        points, world_from_lidar = self.returns, self.world.view.world_from_lidar
        assert points is not None
        ids = {"semantic": points.semantic, "instance": points.instance}
        points_world = transform(world_from_lidar, points.xyz_lidar)
        return Seen(self.world, world_from_lidar[:3, 3], points_world, points.range_m.astype(float), ids)

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

    def rays_world(self, rows: Int[np.ndarray, " n"], columns: Int[np.ndarray, " n"]) -> Points3:
        """The directions in which the centres of pixels look."""
        return self.camera.rays(np.column_stack([columns, rows]) + 0.5) @ self.camera.world_from_cam[:3, :3].T

    def points_cam(self, rows: Int[np.ndarray, " n"], columns: Int[np.ndarray, " n"]) -> Points3:
        """The points that the depth pass has at the centres of pixels. Camera frame."""
        depth_m = self.passes["depth"][rows, columns].astype(float)
        return self.camera.points(np.column_stack([columns, rows]) + 0.5, depth_m)

    def points_world(self, rows: Int[np.ndarray, " n"], columns: Int[np.ndarray, " n"]) -> Points3:
        """The same in the world frame."""
        return transform(self.camera.world_from_cam, self.points_cam(rows, columns))


def inside_px(camera: CameraLabel, lane: Lane) -> Float[np.ndarray, " n"]:
    """Distance of a lane's projected points from the nearest border of the image, negative outside; NaN behind the
    camera."""
    uv = camera.project(lane.xyz_cam)
    return np.asarray(np.minimum(uv, [camera.width_px, camera.height_px] - uv).min(axis=1))
