"""A clip of a data set of ours, which has a lidar, as a drive; with noise if asked, so that its error is known."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from synth3dlanes.arrays import Matrix4, Polyline2
from synth3dlanes.dataset.read import Reader
from synth3dlanes.drives.drive import Drive, DriveCamera, DriveFrame, Scan
from synth3dlanes.errors import InputError
from synth3dlanes.frames import invert, transform
from synth3dlanes.labels import CameraLabel, Labels
from synth3dlanes.settings import SEMANTIC_IDS

# What a clip's points reflect: its sweeps have no intensity of their own.
REFLECTS = {"marking": 0.8, "symbol": 0.8, "road": 0.15, "shoulder": 0.2, "terrain": 0.35, "car": 0.5}


@dataclass(frozen=True)
class Noise:
    """What is wrong with a clip's drive. Standard deviations: of each pose (metres, degrees), of the camera's and the
    lidar's place on the host (the same in every frame), of the pixels of 2D lanes (each line is moved as a whole in a
    frame). Every `beam_step`-th beam is kept. Rain: `drop` is the share of points that are lost at 50 m (less nearer),
    `spray` that of points which drops before their goal return, `range_m` the noise of ranges."""

    pose_m: float = 0.0
    pose_deg: float = 0.0
    calibration_m: float = 0.0
    calibration_deg: float = 0.0
    lanes_px: float = 0.0
    beam_step: int = 1
    drop: float = 0.0
    spray: float = 0.0
    range_m: float = 0.0


EXACT = Noise()


@dataclass(frozen=True, eq=False)
class ClipDrive:
    """A clip as a drive, and its true labels, frame by frame. `scale` is how many times larger than the clip's the
    drive's pictures are."""

    drive: Drive
    truth: tuple[Labels, ...]
    scale: float = field(default=1.0)


def clip_drive(reader: Reader, scene: int, noise: Noise = EXACT, *, width_px: int = 0, seed: int = 0) -> ClipDrive:
    """The clip of a scene of a split as a drive whose 2D lanes are the visible parts of its delimiters. Its pictures
    are scaled to `width_px`, if that is not 0: lines in pixels then are as fine as those of a camera of that width.

    Raises InputError for a split without a lidar.
    """
    if not reader.has_lidar:
        raise InputError(f"{reader.url}: expected a data set with a lidar (generate --lidar), got one without")
    rng = np.random.default_rng([seed, scene])
    positions = reader.clip(scene, 0)
    truth = tuple(reader.labels(i) for i in positions)
    camera, lidar = truth[0].camera, truth[0].lidar
    assert lidar is not None
    scale = width_px / camera.width_px if width_px else 1.0
    zoom = np.diag([scale, scale, 1.0])
    true_camera = DriveCamera(
        round(camera.width_px * scale), round(camera.height_px * scale), zoom @ camera.img_from_cam,
        camera.road_from_cam, camera.lens, camera.name,
    )  # fmt: skip
    host_from_lidar = camera.road_from_cam @ lidar.cam_from_lidar
    frames = []
    for number, (i, labels) in enumerate(zip(positions, truth, strict=True)):
        exact = labels.camera.world_from_cam @ invert(labels.camera.road_from_cam)
        pose = exact @ _shaken(rng, noise.pose_m, noise.pose_deg)
        lanes = _lines(labels, labels.camera, scale, noise.lanes_px, rng)
        load = partial(_scan, reader, i, pose, float(labels.time_s or 0.0), noise)
        frames.append(DriveFrame(f"{number:06d}", float(labels.time_s or 0.0), pose, None, load, lanes))
    off = _shaken(rng, noise.calibration_m, noise.calibration_deg)
    moved = DriveCamera(**{**vars(true_camera), "host_from_cam": true_camera.host_from_cam @ off})
    lidar_off = _shaken(rng, noise.calibration_m, noise.calibration_deg)
    return ClipDrive(Drive(f"clip {scene}", frames, moved, host_from_lidar @ lidar_off), truth, scale)


def _shaken(rng: np.random.Generator, move_m: float, turn_deg: float) -> Matrix4:
    """A small random motion: the same numbers are drawn whatever their size."""
    x, y, z = np.radians(turn_deg) * rng.standard_normal(3)
    pose = np.eye(4)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    pose[:3, :3] = np.linalg.qr(np.eye(3) + skew)[0]
    pose[:3, :3] *= np.sign(np.diag(pose[:3, :3]))
    pose[:3, 3] = move_m * rng.standard_normal(3)
    return pose


def _lines(
    labels: Labels, camera: CameraLabel, scale: float, off_px: float, rng: np.random.Generator
) -> tuple[Polyline2, ...]:
    lines: list[Polyline2] = []
    for lane in labels.lanes:
        if lane.kind != "delimiter":
            continue
        for part in lane.visible_parts():
            shift = off_px * rng.standard_normal(2)
            if len(part) > 1:
                lines.append(camera.project(part) * scale + shift)
    return tuple(lines)


def _scan(reader: Reader, i: int, pose: Matrix4, time_s: float, noise: Noise) -> Scan:
    sweep = reader.lidar(i)
    points = sweep.points()
    rng = np.random.default_rng([i, 7])
    range_m = points.range_m.astype(float)
    kept = points.beam % noise.beam_step == 0
    xyz = points.xyz_lidar
    if noise.drop or noise.spray or noise.range_m:
        kept &= rng.random(len(kept)) > noise.drop * np.minimum(range_m / 50.0, 1.0) ** 2
        factor = 1 + noise.range_m * rng.standard_normal(len(kept)) / range_m
        is_spray = rng.random(len(kept)) < noise.spray
        factor = np.where(is_spray, rng.uniform(0.1, 1.0, len(kept)), factor)
        xyz = xyz * factor[:, None]
    reflects = np.zeros(256)
    for name, value in REFLECTS.items():
        reflects[SEMANTIC_IDS[name]] = value
    return Scan(xyz[kept], reflects[points.semantic[kept]], time_s, pose)


def true_lanes_world(truth: Sequence[Labels]) -> dict[str, np.ndarray]:
    """Every delimiter of a clip in the world, from all its frames, in the order of its points: (n, 3)."""
    found: dict[str, list[np.ndarray]] = {}
    for labels in truth:
        for lane in labels.lanes:
            if lane.kind == "delimiter":
                found.setdefault(lane.id, []).append(transform(labels.camera.world_from_cam, lane.xyz_cam))
    return {name: np.concatenate(parts) for name, parts in found.items()}
