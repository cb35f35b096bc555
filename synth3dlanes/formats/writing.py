"""What every foreign format's writer takes and returns. Paths are relative to the exported folder."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import from_axes, invert, project, turned
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.things import ObjectCategory
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import InputError

if TYPE_CHECKING:
    # Who reads a format needs none.
    import synth3dlanes.scene.scene

CV_FROM_CAM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""OpenCV's camera axes (frame `_cv`: x right, y down, z forward) from ours."""
POINT_DECIMALS = 6

Part = Literal["train", "val", "test"]
PARTS: tuple[Part, ...] = ("train", "val", "test")


@dataclass(frozen=True)
class Pinhole:
    """A camera without distortion, its principal point `below_px` under the middle of the image."""

    width_px: int
    height_px: int
    f_px: float
    below_px: float = 0.0

    @property
    def img_from_cv(self) -> Float[np.ndarray, "3 3"]:
        """The usual intrinsic matrix K."""
        cy_px = self.height_px / 2 + self.below_px
        return np.array([[self.f_px, 0, self.width_px / 2], [0, self.f_px, cy_px], [0, 0, 1.0]])

    @property
    def size_px(self) -> tuple[int, int]:
        return self.width_px, self.height_px

    def resized(self, width_px: int, height_px: int) -> "Pinhole":
        """The camera of another image size with the same horizontal field of view."""
        scale = width_px / self.width_px
        return Pinhole(width_px, height_px, self.f_px * scale, self.below_px * scale)

    def project(self, points_cv: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Pixels of points in front of the camera."""
        return project(self.img_from_cv, points_cv)


@dataclass(frozen=True, eq=False, kw_only=True)
class ExportFrame:
    """One of our images, its labels, and what decides how a format files it: `key` counts within `split`, `number`
    within the export. It is used for `part`; `parts` are all that the data set has."""

    labels: Labels
    split: str
    key: str
    number: int
    part: Part
    parts: frozenset[Part]

    @property
    def where(self) -> str:
        """What messages about it begin with."""
        return f"{self.split}:{self.key}"

    @property
    def is_train(self) -> bool:
        """Whether networks train on it."""
        return self.part == "train"

    def serves_as(self, part: Part) -> bool:
        """Whether tools that open this part find the frame: where a data set has val frames only or test frames only,
        they serve as both."""
        return part == self.part or (not self.is_train and part != "train" and part not in self.parts)

    @property
    def served(self) -> list[Part]:
        """All parts that it serves as."""
        return [part for part in PARTS if self.serves_as(part)]


@dataclass(frozen=True, eq=False, kw_only=True)
class PinholeFrame(ExportFrame):
    """A frame whose image is resampled, with labels without roll: `pinhole` is its camera there; `tags` are the kinds
    of scene; `illumination` is 0 (dark) to 2 (bright); `clip` is the number of the first picture of its clip by this
    camera, None for single pictures. `kerbs` are those of formats that have them."""

    pinhole: Pinhole
    tags: frozenset[str]
    illumination: int
    clip: int | None = None
    kerbs: tuple[Lane, ...] = ()


@dataclass(frozen=True)
class FrameAnnotation:
    """A frame in a foreign format: where its image goes, label files of its own, and lines of shared files, each with
    the files that it belongs to. `dropped` counts lanes by reason. Without `image`, none is written."""

    image: str | None
    n_lines: int
    dropped: Counter[str] = field(default_factory=Counter)
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    shared: tuple[tuple[str, tuple[str, ...]], ...] = ()


def objects_of(labels: Labels, classes: Mapping[ObjectCategory, str]) -> list[ObjectLabel]:
    """The objects of the labels that are of a format's classes."""
    return [item for item in labels.objects or () if item.category in classes]


def expect_objects(frame: ExportFrame) -> tuple[ObjectLabel, ...]:
    """The objects of its labels. Raises InputError for labels without them."""
    if frame.labels.objects is None:
        raise InputError(f"{frame.where}: expected labels with objects, got older ones; generate the data set again")
    return frame.labels.objects


def expect_pinhole(camera: CameraLabel, where: str) -> None:
    """Raise InputError, which begins with `where`, for a camera with distortion."""
    if not camera.lens.is_pinhole:
        raise InputError(f"{where}: expected a camera without distortion, got {camera.lens}")


def world_from_vehicle(camera: CameraLabel, scene: "synth3dlanes.scene.scene.Scene", host_from_ego: Matrix4) -> Matrix4:
    """World from a vehicle frame that lies so in the host's own road frame: sensors keep their places in it through a
    clip."""
    world_from_road = camera.world_from_cam @ invert(camera.road_from_cam)
    host_from_road = turned(0.0, scene.camera.right_m, scene.camera.forward_m)
    return np.asarray(world_from_road @ invert(host_from_road) @ host_from_ego)


def host_from_flu(behind_m: float, above_m: float) -> Matrix4:
    """The host's road frame from a vehicle frame (x forward, y left, z up) that far behind its middle and over the
    road."""
    return np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, -behind_m], [0.0, 0.0, 1.0, above_m], [0.0, 0.0, 0.0, 1.0]])


def with_cv_axes(b_from_cam: Matrix4) -> Matrix4:
    """The pose of a camera with OpenCV's axes in place of ours."""
    b_from_cv = b_from_cam.copy()
    b_from_cv[:3, :3] = b_from_cam[:3, :3] @ CV_FROM_CAM.T
    return b_from_cv


def with_flu_axes(b_from_box: Matrix4) -> Matrix4:
    """The pose of a box with the axes forward, left, up in place of right, forward, up."""
    x, y, z = b_from_box[:3, :3].T
    return from_axes(y, -x, z, b_from_box[:3, 3])


def img_from_cv_centred(camera: CameraLabel) -> Float[np.ndarray, "3 3"]:
    """The matrix K of formats whose pixels count from the middle of the first one, not from its corner."""
    img_from_cv = camera.img_from_cam @ CV_FROM_CAM.T
    img_from_cv[:2, 2] -= 0.5
    return np.asarray(img_from_cv)
