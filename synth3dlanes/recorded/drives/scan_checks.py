"""What the scans of a drive tell of its units, axes and poses: where the ground is, and whether scans fit together."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.recorded.drives.axes import OURS_FROM
from synth3dlanes.recorded.drives.drive import Drive, Scan
from synth3dlanes.system.arrays import Matrix4, Points3

# Median ranges of lidars on roads; beyond them points are in another unit than metres.
LEAST_RANGE_M, MOST_RANGE_M = 1.0, 150.0
UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "kilometres": 1e3}
# Where the ground is looked for, and how far from a plane it may be.
GROUND_REACH_M, GROUND_OFF_M, TRIES = 15.0, 0.12, 200
# Points on one line are no plane: the least width of those on a plane, relative to their length.
LEAST_WIDE = 1e-3
# Lidars of cars and trucks over the ground, and how far a road and a mount may lean.
LOWEST_M, HIGHEST_M, MOST_TILT_DEG = 0.3, 4.5, 12.0
# Pairs of scans, how far apart they are, and what of them is compared: what stands on the ground.
PAIRS, LEAST_APART_M, MOST_APART_M = 6, 1.5, 8.0
REACH_M, STANDING_M, HIGHEST_STANDING_M, MOST_POINTS, LEAST_STANDING = 35.0, 0.3, 5.0, 3000, 40
# Least height within a square of what stands upright.
UPRIGHT_M = 0.6
# Scans that fit together are a few centimetres apart, sparse ones some decimetres; distances count up to CAP_M. Another
# reading is named where its distance is below the share BETTER_RATIO of the first one's.
CAP_M, FITS_M, BETTER_RATIO = 1.0, 0.2, 0.65


class GroundPlane(NamedTuple):
    """The plane that most points near a lidar are on, in the lidar's frame: its unit normal, which points to the lidar,
    and how far from it the lidar is."""

    normal: np.ndarray
    height_m: float


def unit_of(drive: Drive, scans: Sequence[Scan]) -> tuple[float, list[str]]:
    """The factor that makes metres of the points, and a line where it is not 1."""
    ranges = [np.linalg.norm(scan.xyz_lidar, axis=1) for scan in scans]
    median = float(np.median(np.concatenate(ranges))) if sum(map(len, ranges)) else 0.0
    if not median:
        return 1.0, [f"{drive.name}: scans: expected points, got none"]
    if LEAST_RANGE_M <= median <= MOST_RANGE_M:
        return 1.0, []
    named = [(name, factor) for name, factor in UNITS.items() if 2 <= median * factor <= 60]
    told = (
        f"half of the points are within {median:.4g} m of the lidar, expected {LEAST_RANGE_M:g} to {MOST_RANGE_M:g} m"
    )
    if not named:
        return 1.0, [f"{drive.name}: scans: {told}: check their unit"]
    name, factor = named[0]
    return factor, [f"{drive.name}: scans: {told}: points are in {name}: multiply them by {factor:g}"]


def ground_plane(xyz_lidar: Points3) -> GroundPlane | None:
    """The plane that most points within 15 m are on; None for too few, or if they are all on one line."""
    near = xyz_lidar[np.linalg.norm(xyz_lidar, axis=1) < GROUND_REACH_M]
    if len(near) < 50:
        return None
    rng = np.random.default_rng(0)
    near = near[rng.choice(len(near), min(len(near), 2000), replace=False)]
    corners = near[rng.integers(0, len(near), (TRIES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals, corners = normals[lengths > 1e-6] / lengths[lengths > 1e-6, None], corners[lengths > 1e-6]
    if not len(normals):
        return None
    off = np.abs(near @ normals.T - np.einsum("ij,ij->i", normals, corners[:, 0])) < GROUND_OFF_M
    inside = near[off[:, off.sum(axis=0).argmax()]]
    middle = inside.mean(axis=0)
    _, (longest, wide, _), axes = np.linalg.svd(inside - middle, full_matrices=False)
    if wide < LEAST_WIDE * longest:
        return None
    normal = axes[2]
    height_m = float(-normal @ middle)
    return GroundPlane(normal * np.sign(height_m or 1.0), abs(height_m))


def ground_findings(drive: Drive, planes: Sequence[GroundPlane]) -> list[str]:
    """Whether the ground is level below the lidar, by the axes of the host."""
    if not planes:
        told = (
            f"expected the ground within {GROUND_REACH_M:g} m of the lidar, got too few points, or points on one line"
        )
        return [f"{drive.name}: scans: {told}"]
    normals = np.array([plane.normal for plane in planes]) @ drive.host_from_lidar[:3, :3].T
    height_m = float(np.median([plane.height_m for plane in planes]))
    normal = np.median(normals, axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-9)
    axis = int(np.abs(normal).argmax())
    where = f"{drive.name}: scans"
    if axis != 2:
        told = f"the ground stands upright, across the host's {'xy'[axis]} axis, {height_m:.3g} m beside the lidar"
        return [f"{where}: {told}: the points are in other axes (a camera's are rdf, a lidar's most often flu)"]
    if normal[2] < 0:
        return [
            f"{where}: the ground is {height_m:.3g} m above the lidar: z of the points, or of its place, points down"
        ]
    tilt_deg = float(np.degrees(np.arccos(min(1.0, normal[2]))))
    if tilt_deg > MOST_TILT_DEG:
        told = f"the ground leans by {tilt_deg:.0f} degrees, expected {MOST_TILT_DEG:g} at most"
        return [f"{where}: {told}: check how the lidar is turned on the host"]
    if not LOWEST_M <= height_m <= HIGHEST_M:
        told = f"the ground is {height_m:.3g} m below the lidar, expected {LOWEST_M:g} to {HIGHEST_M:g} m"
        return [f"{where}: {told}: check the unit of the points"]
    return []


class Reading(NamedTuple):
    """Another way to read a drive: what is done to its points, and whether the lidar's place or the poses are
    inverted."""

    words: str
    points: Matrix4 = np.eye(4)
    is_place_inverse: bool = False
    is_pose_inverse: bool = False


_LEFT = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
AS_IS = Reading("as they are")
READINGS = (
    Reading("left and right of the points are swapped", np.diag([-1.0, 1, 1, 1])),
    Reading("front and back of the points are swapped", np.diag([1.0, -1, 1, 1])),
    Reading("the lidar looks backwards", np.diag([-1.0, -1, 1, 1])),
    Reading("the points are turned left by 90 degrees", _LEFT),
    Reading("the points are turned right by 90 degrees", _LEFT.T),
    Reading("the lidar's place is the inverse of what was given", is_place_inverse=True),
    Reading("the poses are the inverse of what was given", is_pose_inverse=True),
)


class ScanPair(NamedTuple):
    """What stands on the ground in two scans, and the host's poses then."""

    points_a: Float[np.ndarray, "_ 3"]
    points_b: Float[np.ndarray, "_ 3"]
    pose_a: Matrix4
    pose_b: Matrix4


def fit_findings(drive: Drive, scale: float, plane: GroundPlane) -> list[str]:
    """Whether scans from places some metres apart fit together, and which other reading of the points or the poses
    would make them fit. Of a drive straight ahead, a mirror of left and right fits as well."""
    pairs = _pairs(drive, scale, plane)
    as_is = _misfit(drive, pairs, AS_IS) if pairs else 0.0
    if as_is < FITS_M:
        return []
    misfits = [_misfit(drive, pairs, reading) for reading in READINGS]
    best = int(np.argmin(misfits))
    if misfits[best] > BETTER_RATIO * as_is:
        return []
    told = f"scans some metres apart are {as_is:.2f} m off each other, but {misfits[best]:.2f} m"
    return [f"{drive.name}: {told} if {READINGS[best].words}"]


def _pairs(drive: Drive, scale: float, plane: GroundPlane) -> list[ScanPair]:
    """Up to PAIRS pairs of scans that are some metres apart by their poses, with enough that stands."""
    n, found = len(drive.frames), list[ScanPair]()
    for start in np.unique(np.linspace(0, max(0, n - 2), 2 * PAIRS).astype(int)).tolist():
        first = drive.frames[start]
        for end in range(start + 1, min(start + 20, n)):
            last = drive.frames[end]
            apart_m = float(np.linalg.norm(last.world_from_host[:3, 3] - first.world_from_host[:3, 3]))
            if apart_m >= LEAST_APART_M:
                break
        else:
            continue
        scan_a, scan_b = (frame.scan() for frame in (first, last))
        if apart_m <= MOST_APART_M and scan_a is not None and scan_b is not None and len(found) < PAIRS:
            a, b = (_standing(scan.xyz_lidar * scale, plane) for scan in (scan_a, scan_b))
            if min(len(a), len(b)) >= LEAST_STANDING:
                found.append(ScanPair(a, b, scan_a.world_from_host, scan_b.world_from_host))
    return found


def _standing(xyz_lidar: Points3, plane: GroundPlane) -> Float[np.ndarray, "_ 3"]:
    """Points within reach of what stands upright: seen at several heights over one place."""
    over = xyz_lidar @ plane.normal + plane.height_m
    reached = np.linalg.norm(xyz_lidar, axis=1) < REACH_M
    chosen = (over > STANDING_M) & (over < HIGHEST_STANDING_M) & reached
    points, over = xyz_lidar[chosen], over[chosen]
    _, cell = np.unique(np.floor(points[:, :2] / UPRIGHT_M).astype(int), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    low, high = np.full((2, cell.max(initial=0) + 1), np.inf)
    np.minimum.at(low, cell, over)
    np.minimum.at(high, cell, -over)
    kept = points[(-high - low)[cell] > UPRIGHT_M]
    return kept[np.random.default_rng(0).permutation(len(kept))[:MOST_POINTS]]


def _misfit(drive: Drive, pairs: Sequence[ScanPair], reading: Reading) -> float:
    """How far, in the median of pairs, the points of a scan are from those of the other, up to 1 m each."""
    place = drive.host_from_lidar if not reading.is_place_inverse else invert(drive.host_from_lidar)
    off = []
    for pair in pairs:
        given = [np.array(pose) for pose in (pair.pose_a, pair.pose_b)]
        for pose in given:
            pose[:3, 3] += drive.origin_m
        poses = zip(*map(inverses_of, given), strict=True) if reading.is_pose_inverse else [given]
        off.append(
            min(_apart(pair, reading.points.T @ invert(a @ place) @ b @ place @ reading.points) for a, b in poses)
        )
    return float(np.median(off))


def _apart(pair: ScanPair, a_from_b: Matrix4) -> float:
    # From above: beams meet a pole at other heights.
    plan_a, plan_b = pair.points_a[:, :2], transform(a_from_b, pair.points_b)[:, :2]
    distance, _ = scipy.spatial.cKDTree(plan_a).query(plan_b, distance_upper_bound=CAP_M)
    return float(np.minimum(distance, CAP_M).mean())


def inverses_of(world_from_host: Matrix4) -> tuple[Matrix4, Matrix4]:
    """What a pose is if its file has the inverse: of a body in our axes or a camera's, and of one in a vehicle's, whose
    axes were turned into ours on the wrong side."""
    inverse = invert(world_from_host)
    return inverse, inverse @ invert(OURS_FROM["flu"])
