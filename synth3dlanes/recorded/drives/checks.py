"""Whether a drive can be what it seems: its times, its speed, where it heads, where the ground is, where its lanes are.

Each finding is one line: what was found, what was expected, and what may be the cause.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import transform
from synth3dlanes.recorded.drives.drive import Drive, DriveFrame
from synth3dlanes.recorded.drives.scan_checks import (
    GroundPlane,
    fit_findings,
    ground_findings,
    ground_plane,
    inverses_of,
    unit_of,
)
from synth3dlanes.system.arrays import Points3, Scalars

MOST_FRAMES, SCANS = 500, 6
# Seconds between frames; how much longer than the others a gap is.
LEAST_STEP_S, MOST_STEP_S, GAP = 0.004, 5.0, 4.0
MOST_SPEED_M_S, LEAST_WAY_M = 70.0, 1.0
SPEED_UNITS = {"centimetres": 1e-2, "millimetres": 1e-3}
# Steps whose direction is taken, how far it may be from the heading, and turns that tell left from right.
LEAST_MOVE_M, MOST_OFF_DEG, BACKWARDS_DEG, TURNED_DEG = 0.3, 20.0, 150.0, 8.0
# Lanes on the ground, near the host.
NEAREST_M, FARTHEST_M, LEAST_ON_GROUND, MOST_ACROSS_DEG = 3.0, 40.0, 0.5, 25.0
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
    return findings + _lanes(drive, [drive.frames[number] for number in spaced], planes)


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


def _lanes(drive: Drive, frames: Sequence[DriveFrame], planes: Sequence[GroundPlane]) -> list[str]:
    """Whether the lanes marked in images are on the ground ahead and lead along it."""
    lines = [line for frame in frames for line in frame.lanes_px]
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
    angles_deg = [angle for ground in grounds if (angle := _across_deg(ground)) is not None]
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


def _across_deg(ground: Points3) -> float | None:
    """The angle between a line's near part and straight ahead; None where too little of it is near."""
    with np.errstate(invalid="ignore"):
        near = ground[(ground[:, 1] > NEAREST_M) & (np.linalg.norm(ground, axis=1) < FARTHEST_M)]
    if len(near) < 2 or np.ptp(near[:, :2], axis=0).max() < 2:
        return None
    along = np.linalg.svd(near[:, :2] - near[:, :2].mean(axis=0), full_matrices=False)[2][0]
    return float(np.degrees(np.arctan2(abs(along[0]), abs(along[1]))))
