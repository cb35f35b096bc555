"""Whether a drive can be what it seems: its times, its speed, where it heads, where the ground is, where its lanes are.

Each finding is one line: what was found, what was expected, and what may be the cause.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.recorded.drives.drive import Drive, DriveFrame, Scan
from synth3dlanes.recorded.drives.poses import OURS_FROM
from synth3dlanes.system.arrays import Matrix4, Points3, Scalars

# Median ranges of lidars on roads; beyond them points are in another unit than metres.
LEAST_RANGE_M, MOST_RANGE_M = 1.0, 150.0
UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "kilometres": 1e3}
# Where the ground is looked for, and how far from a plane it may be.
GROUND_REACH_M, GROUND_OFF_M, TRIES = 15.0, 0.12, 200
# Points on one line are no plane: the least width of those on a plane, relative to their length.
LEAST_WIDE = 1e-3
# Lidars of cars and trucks over the ground, and how far a road and a mount may lean.
LOWEST_M, HIGHEST_M, MOST_TILT_DEG = 0.3, 4.5, 12.0
# The number of compared pairs of scans, and the least and the greatest distance between the scans of a pair.
PAIRS, LEAST_APART_M, MOST_APART_M = 6, 1.5, 8.0
REACH_M, STANDING_M, HIGHEST_STANDING_M, MOST_POINTS, LEAST_STANDING = 35.0, 0.3, 5.0, 3000, 40
# Least height that points in one square of the ground span if something upright stands there.
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
    """Points within reach on upright things: several heights are seen over one place."""
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
    """The distance between the points of two scans, up to 1 m for a point: the median of the pairs."""
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


MOST_FRAMES, SCANS = 500, 6
# Seconds between frames; how much longer than the others a gap is.
LEAST_STEP_S, MOST_STEP_S, GAP = 0.004, 5.0, 4.0
MOST_SPEED_M_S, LEAST_WAY_M = 70.0, 1.0
SPEED_UNITS = {"centimetres": 1e-2, "millimetres": 1e-3}
# Between the host's z, on the whole, and the world's: no road is as steep.
MOST_LYING_DEG = 30.0
# Steps whose direction is taken, how far it may be from the heading, and turns that tell left from right.
LEAST_MOVE_M, MOST_OFF_DEG, BACKWARDS_DEG, TURNED_DEG = 0.3, 20.0, 150.0, 8.0
# Lanes on the ground, near the host.
NEAREST_M, FARTHEST_M, LEAST_ON_GROUND, MOST_ACROSS_DEG = 3.0, 40.0, 0.5, 25.0
# How far before and after a pose its bend is taken.
BEND_M = 5.0
# The share of a line's points, from the bottom of the image, that must be on the ground.
NEAR_SHARE = 0.25


def drive_findings(drive: Drive) -> list[str]:
    """What is wrong with a drive, one line each; none where nothing was found. Reads at most 500 frames' poses and some
    dozens of scans, whatever the drive's length."""
    step = -(-len(drive.frames) // MOST_FRAMES)
    frames = [drive.frames[number] for number in range(0, len(drive.frames), step)]
    times_s = np.array([frame.time_s for frame in frames])
    poses = np.stack([frame.world_from_host for frame in frames])
    findings = _times(drive, frames, times_s) + _way(drive, times_s, poses)
    findings += [] if findings else _heading(drive, poses)
    spaced = np.unique(np.linspace(0, len(drive.frames) - 1, SCANS).astype(int)).tolist()
    scans = [scan for number in spaced if (scan := drive.frames[number].scan()) is not None]
    planes: list[GroundPlane] = []
    if scans:
        scale, of_units = unit_of(drive, scans)
        found = (ground_plane(scan.xyz_lidar * scale) for scan in scans)
        planes = [plane for plane in found if plane is not None]
        of_ground = [] if of_units and not planes else ground_findings(drive, planes)
        findings += of_units + of_ground
        if planes and not of_ground:
            findings += fit_findings(drive, scale, planes[0])
    bends = _bends(poses)[np.asarray(spaced) // step]
    return findings + _lanes(drive, [drive.frames[number] for number in spaced], bends, planes)


def _times(drive: Drive, frames: Sequence[DriveFrame], times_s: Scalars) -> list[str]:
    steps = np.diff(times_s)
    if not len(steps):
        return [f"{drive.name}: frames: expected two or more, got {len(frames)}"]
    stride = max(1, round(len(drive.frames) / len(frames)))
    usual = float(np.median(steps))
    if not LEAST_STEP_S * stride <= usual <= MOST_STEP_S * stride:
        told = f"{usual / stride:.4g} s between frames, expected {LEAST_STEP_S} to {MOST_STEP_S:g} s"
        return [f"{drive.name}: times: {told}: are they in another unit, such as milliseconds?"]
    gaps = np.flatnonzero(steps > GAP * usual)
    if not len(gaps):
        return []
    at = int(gaps[0])
    told = f"{steps[at]:.2f} s pass after frame {frames[at].name}, {usual:.2f} s after most"
    return [f"{drive.name}: times: {told} ({len(gaps)} such gap{'s' * (len(gaps) > 1)}): frames or times are missing"]


def _way(drive: Drive, times_s: Scalars, poses: Float[np.ndarray, "n 4 4"]) -> list[str]:
    """How far the host drives, and how fast."""
    moves_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    steps_s = np.diff(times_s)
    where = f"{drive.name}: poses"
    speed = float(np.median(moves_m / np.maximum(steps_s, 1e-9))) if len(moves_m) else 0.0
    if speed > MOST_SPEED_M_S:
        told = f"the host drives at {speed:.4g} m/s, expected {MOST_SPEED_M_S:g} m/s at most"
        named = [name for name, factor in SPEED_UNITS.items() if 2 <= speed * factor <= 60]
        hint = f"are places in {named[0]}" if named else "are places or times in another unit"
        return [f"{where}: {told}: {hint}?"]
    jumps = np.flatnonzero((moves_m > 3) & (moves_m > MOST_SPEED_M_S * steps_s))
    if len(jumps):
        at = int(jumps[0])
        name = drive.frames[at].name
        told = f"{moves_m[at]:.1f} m in {steps_s[at]:.3f} s after frame {name}"
        return [f"{where}: the host jumps {told}: a pose is wrong there, or belongs to another time"]
    up = poses[:, :3, 2].mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-9)
    if (lies_deg := float(np.degrees(np.arccos(np.clip(up[2], -1, 1))))) > MOST_LYING_DEG:
        told = f"what is up for the host is {lies_deg:.0f} degrees off the z of the world, expected {MOST_LYING_DEG:g}"
        return [f"{where}: {told} at most: z of the world, or of the poses, points elsewhere"]
    way_m = float(moves_m.sum())
    if len(moves_m) and way_m < LEAST_WAY_M:
        return [f"{where}: the host moves {way_m:.3g} m in all: does it stand still, or are places in kilometres?"]
    return []


class _Course(NamedTuple):
    """How poses head where they go: the usual angle from the heading to the path, positive to the left, how far it
    strays, how far the heading turns in all, and how much the path turns for each radian of that."""

    off_deg: float
    strays_deg: float
    turns_deg: float
    slope: float

    @property
    def fits(self) -> bool:
        return abs(self.off_deg) <= MOST_OFF_DEG and self.strays_deg <= MOST_OFF_DEG


def _course(poses: Float[np.ndarray, "n 4 4"]) -> _Course | None:
    moves = np.diff(poses[:, :3, 3], axis=0)
    long = np.linalg.norm(moves[:, :2], axis=1) > LEAST_MOVE_M
    if long.sum() < 3:
        return None
    # Halfway between two poses the heading is along the chord.
    ahead = (poses[:-1, :2, 1] + poses[1:, :2, 1])[long]
    path = np.unwrap(np.arctan2(moves[long, 1], moves[long, 0]))
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    apart = np.exp(1j * (path - heading))
    mean = complex(apart.mean())
    off, strays = np.degrees(np.angle(mean)), np.degrees(np.abs(np.angle(apart / (mean or 1))))
    turned = heading - heading.mean()
    slope = float((turned * (path - path.mean())).sum() / max((turned**2).sum(), 1e-12))
    return _Course(float(off), float(np.quantile(strays, 0.9)), float(np.degrees(np.ptp(heading))), slope)


def _heading(drive: Drive, poses: Float[np.ndarray, "n 4 4"]) -> list[str]:
    """Whether the host looks where it drives, and turns where its path turns."""
    given = poses.copy()
    given[:, :3, 3] += drive.origin_m
    course = _course(given)
    if course is None:
        return []
    where = f"{drive.name}: poses"
    turns = course.turns_deg > TURNED_DEG
    if turns and course.slope < 0:
        told = "the path turns right where the host turns left"
        return [f"{where}: {told}: an axis of the places, or of the turns, is mirrored"]
    if course.fits:
        return []
    inverses = zip(*(inverses_of(pose) for pose in given), strict=True)
    if any(inverse.fits for poses in inverses if (inverse := _course(np.stack(poses))) is not None):
        told = f"the host moves {abs(course.off_deg):.0f} degrees off its heading, and along it if poses are inverted"
        return [f"{where}: {told}: host_from_world was given for world_from_host"]
    if course.strays_deg > MOST_OFF_DEG:
        told = "where the host moves has nothing to do with where it looks"
        return [f"{where}: {told}: check the axes of the poses, and the order of quaternions"]
    side = "left" if course.off_deg > 0 else "right"
    aside = f"{abs(course.off_deg):.0f} degrees to the {side} of where it looks"
    told = f"the host moves {'backwards' if abs(course.off_deg) > BACKWARDS_DEG else aside}"
    return [f"{where}: {told}: check the axes of the poses (rfu, flu or rdf)"]


def _bends(poses: Float[np.ndarray, "n 4 4"]) -> Scalars:
    """By how many radians the host turns left in a metre of its way, at each pose."""
    heading = np.unwrap(np.arctan2(-poses[:, 0, 1], poses[:, 1, 1]))
    way_m = np.cumsum([0.0, *np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1)])
    before, after = (np.interp(way_m + side * BEND_M, way_m, heading) for side in (-1, 1))
    apart_m = np.minimum(way_m + BEND_M, way_m[-1]) - np.maximum(way_m - BEND_M, 0)
    return np.asarray((after - before) / np.maximum(apart_m, BEND_M))


def _lanes(drive: Drive, frames: Sequence[DriveFrame], bends: Scalars, planes: Sequence[GroundPlane]) -> list[str]:
    """Whether the lanes marked in images are on the ground ahead and lead along it, where the host turns with it."""
    lines, bend_of = (
        [line for frame in frames for line in frame.lanes_px],
        [bend for frame, bend in zip(frames, bends.tolist(), strict=True) for _ in frame.lanes_px],
    )
    camera = drive.camera
    if not lines or not planes:
        return []
    pixels = np.concatenate(lines)
    outside = ~((pixels >= -1) & (pixels <= [camera.width_px + 1, camera.height_px + 1])).all(axis=1)
    where = f"{drive.name}: lanes in images"
    if outside.mean() > 0.2:
        told = f"{outside.mean():.0%} of their points are outside the image of {camera.width_px}x{camera.height_px} px"
        return [f"{where}: {told}: they belong to images of another size"]
    plane = planes[len(planes) // 2]
    grounds = [_on_ground(drive, line, plane) for line in lines]
    # Where the road climbs, the far part of a right line is over the horizon of the ground at the host, too.
    lowest = [line[:, 1] >= np.quantile(line[:, 1], 1 - NEAR_SHARE) for line in lines]
    on_ground = np.concatenate([ground[near, 1] > 0 for ground, near in zip(grounds, lowest, strict=True)])
    if on_ground.mean() < LEAST_ON_GROUND:
        told = f"{1 - on_ground.mean():.0%} of the lowest points of their lines look over the horizon"
        return [f"{where}: {told}: check the camera's place and axes, and that rows of pixels count from the top"]
    across_deg = (_across_deg(ground, bend) for ground, bend in zip(grounds, bend_of, strict=True))
    angles_deg = [angle for angle in across_deg if angle is not None]
    if angles_deg and (across := float(np.median(angles_deg))) > MOST_ACROSS_DEG:
        told = f"on the ground, half of them cross the path at {across:.0f} degrees or more"
        return [f"{where}: {told}: check the camera's place and axes"]
    return []


def _on_ground(drive: Drive, line: Float[np.ndarray, "n 2"], plane: GroundPlane) -> Points3:
    """Where the rays of pixels meet the ground, in the host's axes from the camera; NaN where they do not."""
    camera = drive.camera
    rays = camera.lens.rays(camera.img_from_cam, line) @ camera.host_from_cam[:3, :3].T
    eye = camera.host_from_cam[:3, 3]
    normal = drive.host_from_lidar[:3, :3] @ plane.normal
    on_plane = transform(drive.host_from_lidar, -plane.height_m * plane.normal[None])[0]
    falls = rays @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = ((on_plane - eye) @ normal) / falls
        return np.where(((falls < 0) & (reach > 0))[:, None], rays * reach[:, None], np.nan)


def _across_deg(ground: Points3, bend: float) -> float | None:
    """The angle between a line's near part and the host's way, which leads straight ahead or along its bend; None where
    too little of it is near."""
    with np.errstate(invalid="ignore"):
        near = ground[(ground[:, 1] > NEAREST_M) & (np.linalg.norm(ground, axis=1) < FARTHEST_M)]
    if len(near) < 2 or np.ptp(near[:, :2], axis=0).max() < 2:
        return None
    along = np.linalg.svd(near[:, :2] - near[:, :2].mean(axis=0), full_matrices=False)[2][0]
    left_rad, turned_rad = np.arctan2(-along[0] * np.copysign(1, along[1]), abs(along[1])), bend * near[:, 1].mean()
    return float(np.degrees(abs(left_rad - np.clip(left_rad, min(0.0, turned_rad), max(0.0, turned_rad)))))
