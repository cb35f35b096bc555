"""A drive: the frames of a real car's camera, the points of its lidar, its poses, and lanes marked in images or in the
top view. Every frame of reference is x right, y forward, z up, metres; pixels as everywhere. Nothing here opens a file.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import overload

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.lens import PINHOLE, Lens
from synth3dlanes.labels.labels import Direction, LaneKind, Marking, PaintColor
from synth3dlanes.system.arrays import Matrix4, Points3, Polyline2, Scalars


@dataclass(frozen=True, eq=False)
class Scan:
    """The points of one turn of a real lidar, all as seen from `world_from_host`, the host's pose at `time_s`: their
    places in the lidar's frame, and how strongly they reflect, from 0 to 1 (all 0 where that is not known). Points
    without a return are left out."""

    xyz_lidar: Points3
    intensity: Scalars
    time_s: float
    world_from_host: Matrix4


@dataclass(frozen=True, eq=False)
class DriveCamera:
    """The camera of a drive and its place on the host. `img_from_cam` maps (x, y, z) of the camera frame to pixels;
    `lens` is the distortion that it lacks."""

    width_px: int
    height_px: int
    img_from_cam: Float[np.ndarray, "3 3"]
    host_from_cam: Matrix4
    lens: Lens = PINHOLE
    name: str = ""


@dataclass(frozen=True, eq=False)
class DriveFrame:
    """One instant of a drive: the host's pose then, the lanes marked in its image as lines of pixels, and its image and
    scan, which `load_image` and `load_scan` read when they are asked for (None where there is none). The image is read
    as the bytes of its file, JPEG or PNG; `image` is the path by which files of lanes name it."""

    name: str
    time_s: float
    world_from_host: Matrix4
    image: Path | None = None
    load_scan: Callable[[], Scan] | None = None
    lanes_px: tuple[Polyline2, ...] = ()
    load_image: Callable[[], bytes] | None = None

    def scan(self) -> Scan | None:
        """The scan of this instant, read anew each time."""
        return None if self.load_scan is None else self.load_scan()


@dataclass(frozen=True, eq=False)
class MarkedLane:
    """A lane marked once in the top view of a drive: its line in world x and y, in the direction of travel."""

    id: str
    xy_world: Polyline2
    kind: LaneKind = "delimiter"
    marking: Marking = "solid"
    color: PaintColor | None = None
    direction: Direction = "same"


@dataclass(frozen=True, eq=False)
class RejectedLane:
    """A lane that a person rejected: its id then, and where it was in world x and y."""

    id: str
    xy_world: Polyline2


@dataclass(frozen=True, eq=False)
class Drive:
    """What one drive recorded. `frames` are in the order of their times; a sequence may make each when it is asked for,
    so that a drive of any length fits. The world's origin is near the drive: points keep their millimetres. It is at
    `origin_m` of the frame that the drive's own poses, maps and markings are in, which has the same axes. `notes` are
    what a reader left out, one line each. `rejected` and `rejected_s` are the lanes, and the times in labels of the
    frames, that a person rejected in what was lifted of the drive before."""

    name: str
    frames: Sequence[DriveFrame]
    camera: DriveCamera
    host_from_lidar: Matrix4
    marked: tuple[MarkedLane, ...] = ()
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    notes: tuple[str, ...] = ()
    rejected: tuple[RejectedLane, ...] = ()
    rejected_s: frozenset[float] = frozenset()

    @cached_property
    def start_s(self) -> float:
        return self.frames[0].time_s

    def label_time(self, frame: DriveFrame) -> float:
        """A frame's time as its labels have it: seconds after the first frame, to the nanosecond."""
        return round(frame.time_s - self.start_s, 9)

    def kept(self) -> Sequence[DriveFrame]:
        if not self.rejected_s:
            return self.frames
        numbers = self._kept_numbers
        return MadeFrames(len(numbers), lambda number: self.frames[numbers[number]])

    @cached_property
    def _kept_numbers(self) -> list[int]:
        return [i for i, frame in enumerate(self.frames) if self.label_time(frame) not in self.rejected_s]


@dataclass(frozen=True)
class MadeFrames(Sequence[DriveFrame]):
    """`n` frames. `make` makes a frame from its number, each time anew."""

    n: int
    make: Callable[[int], DriveFrame]

    def __len__(self) -> int:
        return self.n

    @overload
    def __getitem__(self, index: int) -> DriveFrame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[DriveFrame]: ...
    def __getitem__(self, index: int | slice) -> DriveFrame | Sequence[DriveFrame]:
        if isinstance(index, slice):
            numbers = range(self.n)[index]
            return MadeFrames(len(numbers), lambda number: self.make(numbers[number]))
        if not -self.n <= index < self.n:
            raise IndexError(f"expected a frame in 0..{self.n - 1}, got {index}")
        return self.make(index % self.n)
