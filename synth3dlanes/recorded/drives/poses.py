"""Other people's axes as ours (x right, y forward, z up), and poses along a drive: KITTI's and TUM's text, feather of
Argoverse 2, our JSON; and the pose at any instant between."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import scipy
from jaxtyping import Float
from pydantic import Field

from synth3dlanes.formats.reading import read_file
from synth3dlanes.geometry.frames import invert
from synth3dlanes.recorded.drives.tables import MAX_TEXT_BYTES, numeric, read_feather, read_rows
from synth3dlanes.system.arrays import Matrix4, Points3, Scalars
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import DocumentPart, parse

AxesName = Literal["rfu", "flu", "rdf"]
# Our axes; vehicles' and lidars' (x forward, y left, z up); cameras' (x right, y down, z forward).
OURS_FROM: dict[AxesName, Matrix4] = {
    "rfu": np.eye(4),
    "flu": np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
    "rdf": np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
}
# Files write matrices with 6 to 12 decimals.
ORTHONORMAL = 2e-3


def rigid(rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"], where: str) -> Matrix4:
    """The transform of a rotation and a translation. Raises FormatError, whose message begins with `where`, for a
    matrix that is no rotation: it mirrors an axis, or has a scale."""
    product = rotation @ rotation.T
    if not np.abs(product - np.eye(3)).max() <= ORTHONORMAL:
        scale = float(np.cbrt(np.abs(np.linalg.det(rotation))))
        raise FormatError(f"{where}: expected a rotation, got a matrix that is none (its scale is {scale:.4g})")
    if np.linalg.det(rotation) < 0:
        raise FormatError(f"{where}: expected a rotation, got a mirror: one axis points the other way")
    found = np.eye(4)
    # The nearest rotation: rounded numbers of a file would make lengths grow along a drive.
    u, _, vt = np.linalg.svd(rotation)
    found[:3, :3], found[:3, 3] = u @ vt, translation
    return found


def matrix34(values: Float[np.ndarray, "12"], where: str) -> Matrix4:
    """The transform of three rows of a rotation and a translation."""
    rows = values.reshape(3, 4)
    return rigid(rows[:, :3], rows[:, 3], where)


def in_ours(b_from_a: Matrix4, b_axes: AxesName, a_axes: AxesName) -> Matrix4:
    """A transform between two frames in their own axes as one between the same frames in ours."""
    return np.asarray(OURS_FROM[b_axes] @ b_from_a @ invert(OURS_FROM[a_axes]))


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Float[np.ndarray, "3 3"]:
    """`img_from_cam` of a pinhole: pixels from camera coordinates in our axes."""
    return np.array([[fx, cx, 0.0], [0.0, cy, -fy], [0.0, 1.0, 0.0]])


POSES_FORMAT, POSES_VERSION = "synth3dlanes.poses", 1
# Longest time between poses, and beyond the last one, in which a car's pose is known to a centimetre.
MAX_GAP_S, MAX_BEYOND_S = 1.0, 0.02
UNIT = 0.02
NANO = 1e-9


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Where something was in the world, at instants that increase: seconds, metres, and unit quaternions x, y, z, w.
    Axes are ours; `path` names where they come from."""

    path: Path
    times_s: Scalars
    places: Points3
    xyzw: Float[np.ndarray, "n 4"]

    @property
    def matrices(self) -> Float[np.ndarray, "n 4 4"]:
        """All poses as `world_from_...`."""
        found = np.tile(np.eye(4), (len(self.times_s), 1, 1))
        rotations = scipy.spatial.transform.Rotation.from_quat(self.xyzw)
        found[:, :3, :3], found[:, :3, 3] = rotations.as_matrix(), self.places
        return found

    def knows(self, times_s: Scalars) -> np.ndarray:
        """Whether the pose at each instant is known: there is one before and one after it, a second apart at most."""
        after = np.clip(np.searchsorted(self.times_s, times_s), 1, max(1, len(self.times_s) - 1))
        first, last = self.times_s[0] - MAX_BEYOND_S, self.times_s[-1] + MAX_BEYOND_S
        inside = (times_s >= first) & (times_s <= last)
        if len(self.times_s) == 1:
            return inside
        nearest = np.minimum(np.abs(self.times_s[after] - times_s), np.abs(self.times_s[after - 1] - times_s))
        return inside & ((self.times_s[after] - self.times_s[after - 1] <= MAX_GAP_S) | (nearest <= MAX_BEYOND_S))

    def at(self, times_s: Scalars) -> Float[np.ndarray, "n 4 4"]:
        """The poses at instants that it `knows`: places on straight lines between, turns along the shortest way."""
        times = np.clip(times_s, self.times_s[0], self.times_s[-1])
        found = np.tile(np.eye(4), (len(times), 1, 1))
        found[:, :3, 3] = np.stack([np.interp(times, self.times_s, axis) for axis in self.places.T], axis=-1)
        if len(self.times_s) == 1:
            found[:, :3, :3] = scipy.spatial.transform.Rotation.from_quat(self.xyzw[0]).as_matrix()
        else:
            # Only the poses around these times are converted: a drive may have millions.
            low, high = np.searchsorted(self.times_s, [times.min(initial=np.inf), times.max(initial=-np.inf)])
            chosen = slice(max(0, int(low) - 1), int(high) + 2)
            rotations = scipy.spatial.transform.Rotation.from_quat(self.xyzw[chosen])
            turns = scipy.spatial.transform.Slerp(self.times_s[chosen], rotations)
            found[:, :3, :3] = turns(times).as_matrix()
        return found

    def of(self, body_from_other: Matrix4) -> "PoseTrack":
        """The track of another frame that is fixed to the same body."""
        matrices = self.matrices @ body_from_other
        xyzw = scipy.spatial.transform.Rotation.from_matrix(matrices[:, :3, :3]).as_quat()
        return PoseTrack(self.path, self.times_s, matrices[:, :3, 3], xyzw)

    def moved(self, origin: Float[np.ndarray, "3"]) -> "PoseTrack":
        """The track in a world whose origin is at a place of this one."""
        return PoseTrack(self.path, self.times_s, self.places - origin, self.xyzw)


def track(path: Path, times_s: Scalars, matrices: Float[np.ndarray, "n 4 4"]) -> PoseTrack:
    """Poses in our axes as a track; raise FormatError where their times do not increase. Of poses at one instant the
    first counts."""
    steps = np.diff(times_s)
    if not (steps >= 0).all():
        at = int(np.argmin(steps >= 0))
        told = f"got {times_s[at + 1]:.6f} s after {times_s[at]:.6f} s (pose {at + 2})"
        raise FormatError(f"{path}: expected poses in the order of their times, {told}")
    kept = np.concatenate([[True], steps > 0])
    if not len(times_s):
        raise FormatError(f"{path}: expected poses, got none")
    rotations = scipy.spatial.transform.Rotation.from_matrix(matrices[kept, :3, :3])
    return PoseTrack(path, times_s[kept], matrices[kept, :3, 3], rotations.as_quat())


def read_kitti_poses(path: Path, times_s: Scalars, axes: AxesName) -> PoseTrack:
    """A line of 12 numbers for each frame, three rows of a rotation and a translation: the pose in the world of a body
    with these axes."""
    rows = read_rows(path, 12, "three rows of a pose")
    if len(rows) != len(times_s):
        raise FormatError(f"{path}: expected a pose for each of {len(times_s)} times, got {len(rows)}")
    matrices = np.stack([matrix34(row, f"{path}:{number}") for number, row in enumerate(rows, start=1)])
    return track(path, times_s, _upright(matrices, axes))


def read_tum(path: Path, axes: AxesName) -> PoseTrack:
    """A line for each pose: seconds, place x y z, quaternion x y z w."""
    rows = read_rows(path, 8, "time, x, y, z, qx, qy, qz, qw")
    return _of_quaternions(path, rows[:, 0], rows[:, 1:4], rows[:, 4:], axes)


def read_pose_feather(path: Path, axes: AxesName = "flu") -> PoseTrack:
    """Argoverse 2's `city_SE3_egovehicle.feather`: timestamp_ns, qw, qx, qy, qz, tx_m, ty_m, tz_m."""
    names = ("timestamp_ns", "qx", "qy", "qz", "qw", "tx_m", "ty_m", "tz_m")
    columns = {name: numeric(values, f"{path}: {name}") for name, values in read_feather(path, names).items()}
    rows = np.stack([columns[name] for name in names], axis=-1)
    if not len(rows) or not np.isfinite(rows).all():
        raise FormatError(f"{path}: expected poses of finite numbers, got {'others' if len(rows) else 'none'}")
    return _of_quaternions(path, rows[:, 0] * NANO, rows[:, 5:], rows[:, 1:5], axes)


def read_pose_json(path: Path) -> PoseTrack:
    """Our own: docs/drives.md."""
    data = read_file(path, MAX_TEXT_BYTES)
    what = f"{POSES_FORMAT} version {POSES_VERSION}"
    found = parse(_PosesDocument, data, str(path), what, MAX_TEXT_BYTES)
    matrices = [
        matrix34(np.array(pose.world_from_host)[:3].ravel(), f"{path}: poses.{number}")
        for number, pose in enumerate(found.poses)
    ]
    return track(path, np.array([pose.time_s for pose in found.poses]), np.stack(matrices))


# Coordinates of a map's zone are up to 10,000 km.
_Value = Annotated[float, Field(ge=-1e8, le=1e8)]
_Row = tuple[_Value, _Value, _Value, _Value]


class _Pose(DocumentPart):
    time_s: Annotated[float, Field(ge=0, le=1e11)]
    world_from_host: tuple[_Row, _Row, _Row, _Row]


class _PosesDocument(DocumentPart):
    format: Literal["synth3dlanes.poses"]
    version: Literal[1]
    poses: Annotated[list[_Pose], Field(min_length=1)]


def _of_quaternions(
    path: Path, times_s: Scalars, places: Points3, xyzw: Float[np.ndarray, "n 4"], axes: AxesName
) -> PoseTrack:
    lengths = np.linalg.norm(xyzw, axis=1)
    if not (np.abs(lengths - 1) <= UNIT).all():
        at = int(np.argmax(np.abs(lengths - 1)))
        raise FormatError(f"{path}: expected unit quaternions, got one of length {lengths[at]:.4g} (pose {at + 1})")
    matrices = np.tile(np.eye(4), (len(times_s), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = scipy.spatial.transform.Rotation.from_quat(xyzw).as_matrix(), places
    return track(path, times_s, _upright(matrices, axes))


def _upright(matrices: Float[np.ndarray, "n 4 4"], axes: AxesName) -> Float[np.ndarray, "n 4 4"]:
    """Poses of a body with these axes as ours, in a world whose z points up. The world of a file has z up, or y down as
    a camera's frame: what is up for the body on the whole says which."""
    bodies = matrices @ invert(OURS_FROM[axes])
    _, y, z = bodies[:, :3, 2].mean(axis=0)
    return np.asarray(OURS_FROM["rdf"] @ bodies if -y > z else bodies)
