"""A drive made worse on purpose, so that it is known what each error of its sensors does to lifted lanes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from synth3dlanes.recorded.drives.drive import Drive, DriveFrame, MadeFrames, Scan
from synth3dlanes.system.arrays import Matrix4

# The range at which rain loses its whole share of points; nearer, it loses less.
RAIN_M = 50.0


@dataclass(frozen=True)
class Noise:
    """What is wrong with a drive. Standard deviations: of each pose (metres, degrees), of the places of camera and
    lidar on the host (the same in every frame), of each 2D line, which is moved as a whole. Rain: `lost` is the share
    of points that do not return from 50 m or farther (less from nearer), `spray` that of points which return from drops
    before their goal, `range_m` the noise of ranges."""

    pose_m: float = 0.0
    pose_deg: float = 0.0
    calibration_m: float = 0.0
    calibration_deg: float = 0.0
    lanes_px: float = 0.0
    every_other_beam: bool = False
    lost: float = 0.0
    spray: float = 0.0
    range_m: float = 0.0


def worsened(drive: Drive, noise: Noise, seed: int = 0) -> Drive:
    """The drive with noise; equal seeds give equal noise."""
    rng = np.random.default_rng([seed, 1])
    camera_off = _shaken(rng, noise.calibration_m, noise.calibration_deg)
    lidar_off = _shaken(rng, noise.calibration_m, noise.calibration_deg)
    frames = drive.frames

    def make(number: int) -> DriveFrame:
        frame, own = frames[number], np.random.default_rng([seed, 2, number])
        off = _shaken(own, noise.pose_m, noise.pose_deg)
        lines = tuple(line + noise.lanes_px * own.standard_normal(2) for line in frame.lanes_px)
        load = frame.load_scan and partial(_scan, frame.load_scan, off, noise, (seed, 3, number))
        return replace(frame, world_from_host=frame.world_from_host @ off, lanes_px=lines, load_scan=load)

    camera = replace(drive.camera, host_from_cam=drive.camera.host_from_cam @ camera_off)
    made = MadeFrames(len(frames), make)
    return replace(drive, frames=made, camera=camera, host_from_lidar=drive.host_from_lidar @ lidar_off)


def enlarged(drive: Drive, width_px: int) -> Drive:
    """The drive as a camera of `width_px` pixels across would have recorded its 2D lines."""
    scale = width_px / drive.camera.width_px
    frames = drive.frames

    def make(number: int) -> DriveFrame:
        frame = frames[number]
        return replace(frame, lanes_px=tuple(line * scale for line in frame.lanes_px), load_image=None)

    camera = replace(
        drive.camera,
        width_px=width_px,
        height_px=round(drive.camera.height_px * scale),
        img_from_cam=np.diag([scale, scale, 1.0]) @ drive.camera.img_from_cam,
    )
    return replace(drive, frames=MadeFrames(len(frames), make), camera=camera)


def _shaken(rng: np.random.Generator, move_m: float, turn_deg: float) -> Matrix4:
    """A small random motion: the same numbers are drawn whatever their size."""
    x, y, z = np.radians(turn_deg) * rng.standard_normal(3)
    turned, upper = np.linalg.qr(np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    pose = np.eye(4)
    pose[:3, :3] = turned * np.sign(np.diag(upper))
    pose[:3, 3] = move_m * rng.standard_normal(3)
    return pose


def _scan(load: Callable[[], Scan], off: Matrix4, noise: Noise, seed: tuple[int, ...]) -> Scan:
    scan = load()
    rng = np.random.default_rng(seed)
    range_m = np.linalg.norm(scan.xyz_lidar, axis=1)
    n = len(range_m)
    lost = rng.random(n) < noise.lost * np.minimum(range_m / RAIN_M, 1.0) ** 2
    is_spray = rng.random(n) < noise.spray
    factor = np.where(is_spray, rng.uniform(0.1, 1.0, n), 1 + noise.range_m * rng.standard_normal(n) / range_m)
    kept = ~lost
    if noise.every_other_beam:
        beams = np.unique(np.round(np.arcsin(scan.xyz_lidar[:, 2] / range_m), 4), return_inverse=True)[1].ravel()
        kept &= beams % 2 == 0
    return replace(
        scan,
        xyz_lidar=(scan.xyz_lidar * factor[:, None])[kept],
        intensity=scan.intensity[kept],
        world_from_host=scan.world_from_host @ off,
    )
