"""Tracks and a frame -> Labels: every lane ahead of the host in camera coordinates, with its masks and its standard
deviations."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from synth3dlanes.geometry.frames import invert, road_from_cam, transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneGraph
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera, DriveFrame, Scan
from synth3dlanes.recorded.lift.cast import seen_over, seen_past_things
from synth3dlanes.recorded.lift.curves import STATION_STEP_M
from synth3dlanes.recorded.lift.ground import GroundMap
from synth3dlanes.recorded.lift.path import Path
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.recorded.lift.tracks import Stretch, Track
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import RANGE_M, horizon_plane

# Size of the ground along and across the path that gives the road plane. Where that ground is not known, WIDER times
# the size is used.
ALONG_M, ASIDE_M, WIDER = 4.0, 1.5, 4.0
MIN_PLACES = 12


def camera_label(camera: DriveCamera, world_from_cam: Matrix4, ground: GroundMap, path: Path) -> CameraLabel:
    """The camera's label: its place over the plane that touches the ground below it. Raises InputError where no ground
    is near it."""
    eye = world_from_cam[:3, 3]
    normal, height_m = _plane_below(eye, ground, path)
    forward = path.curve(path.to_plan(eye[None, :2])[:, 0], 1)[0]
    forward = forward - (forward @ normal) * normal
    forward /= np.linalg.norm(forward)
    road_from_world = np.stack([np.cross(forward, normal), forward, normal])
    x, y, _ = (road_from_world @ world_from_cam[:3, :3]).T
    pitch, yaw = float(np.arcsin(-y[2])), float(np.arctan2(-y[0], y[1]))
    level = road_from_cam(0.0, pitch, 0.0, yaw)[:3, :3].T @ x
    roll = float(np.arctan2(-level[2], level[0]))
    return CameraLabel(
        width_px=camera.width_px,
        height_px=camera.height_px,
        img_from_cam=camera.img_from_cam,
        height_m=height_m,
        pitch_rad=pitch,
        road_from_cam=road_from_cam(height_m, pitch, roll, yaw),
        world_from_cam=world_from_cam,
        roll_rad=roll,
        yaw_rad=yaw,
        name=camera.name,
        lens=camera.lens,
    )


def _plane_below(eye: np.ndarray, ground: GroundMap, path: Path) -> tuple[np.ndarray, float]:
    """The unit normal of the plane below a place, and the place's height over it."""
    s = float(path.to_plan(eye[None, :2])[0, 0])
    for wide in (1.0, WIDER, WIDER**2):
        along, aside = np.meshgrid(np.linspace(-wide, wide, 9) * ALONG_M, np.linspace(-1, 1, 7) * ASIDE_M * wide**0.5)
        xy = path.to_world(s + along.ravel(), aside.ravel())
        z = ground.at(xy)[0]
        has = np.isfinite(z)
        if has.sum() < MIN_PLACES:
            continue
        columns = np.column_stack([xy[has] - eye[:2], np.ones(has.sum())])
        (a, b, c), *_ = np.linalg.lstsq(columns, z[has], rcond=None)
        normal = np.array([-a, -b, 1.0]) / np.sqrt(a * a + b * b + 1)
        height_m = float((eye[2] - c) * normal[2])
        if height_m <= 0:
            raise InputError(
                f"camera: expected it above the ground, got it {-height_m:.2f} m below: is the drive's z up, and the "
                "camera's place on the host right?"
            )
        return normal, height_m
    raise InputError(f"scans: expected points on the ground near the host at {np.round(eye, 1).tolist()}, got none")


# A stretch of fewer points is no lane.
MIN_POINTS = 3
# Far away, errors that the lines of many pictures share make deviations across larger than the curve knows of: by this,
# measured (docs/lift.md), between these distances.
ENLARGED_FROM_TO_M, ENLARGED = (20.0, 50.0), 1.7


def label_frame(drive: Drive, frame: DriveFrame, stretch: Stretch, precision: Precision) -> Labels:
    """The labels of a frame of a drive from the tracks of its stretch of road."""
    ground, path, tracks = stretch.ground, stretch.path, stretch.tracks
    world_from_cam = frame.world_from_host @ drive.camera.host_from_cam
    label = camera_label(drive.camera, world_from_cam, ground, path)
    host = float(path.to_plan(world_from_cam[None, :2, 3])[0, 0])
    lanes = [lane for track in tracks for lane in _lanes(track, host, label, ground, precision)]
    scan = frame.scan()
    if scan is not None and lanes:
        lanes = _past_things(lanes, label, scan, drive.host_from_lidar, ground)
    own = _host_lane(tracks, host)
    centre = next((lane for lane in lanes if lane.id == own), None)
    horizon = None if centre is None else horizon_plane(label, [centre])
    return Labels(label, tuple(lanes), LaneGraph((), {}, None), horizon, time_s=drive.label_time(frame), objects=None)


def _past_things(
    lanes: list[Lane], camera: CameraLabel, scan: Scan, host_from_lidar: Matrix4, ground: GroundMap
) -> list[Lane]:
    """The lanes with what things hide of them."""
    points = np.concatenate([lane.xyz_cam for lane in lanes])
    world_from_lidar = scan.world_from_host @ host_from_lidar
    seen = seen_past_things(scan, world_from_lidar, camera.world_from_cam, ground, points)
    ends = np.cumsum([len(lane.xyz_cam) for lane in lanes])[:-1]
    return [replace(lane, object_visible=own) for lane, own in zip(lanes, np.split(seen, ends), strict=True)]


def _lanes(track: Track, host: float, camera: CameraLabel, ground: GroundMap, precision: Precision) -> list[Lane]:
    """A track ahead of the host: a lane for each stretch without a gap. The first has the track's id."""
    ahead = np.flatnonzero((track.s >= host) & (track.s <= host + RANGE_M))
    stretches = np.split(ahead, np.flatnonzero(np.diff(track.s[ahead]) > 1.5 * STATION_STEP_M) + 1)
    found: list[Lane] = []
    for at in stretches:
        if len(at) < MIN_POINTS:
            continue
        xyz_world = track.xyz_world[at]
        xyz_cam = transform(invert(camera.world_from_cam), xyz_world)
        # The lane is known in the world; this frame's pose and the camera's place bring it into the camera's frame.
        far_m = np.linalg.norm(xyz_cam, axis=1)
        off = np.hypot(precision.pose_at(far_m), precision.calibration_at(far_m))
        std_m = np.hypot(track.std_m[at], off[:, None])
        std_m[:, 0] *= np.interp(far_m, ENLARGED_FROM_TO_M, (1.0, ENLARGED))
        found.append(
            Lane(
                id=track.id if not found else f"{track.id}.{len(found) + 1}",
                kind=track.kind,
                road="main",
                marking=track.marking,
                left=track.left,
                right=track.right,
                xyz_cam=xyz_cam,
                in_image=camera.shows(xyz_cam),
                terrain_visible=seen_over(ground, camera.world_from_cam[:3, 3], xyz_world),
                object_visible=None,
                color=track.color,
                direction=track.direction,
                std_m=std_m,
            )
        )
    return found


def _host_lane(tracks: Sequence[Track], host: float) -> str | None:
    """The centre line nearest to the host just ahead of it."""
    centres = [track for track in tracks if track.kind == "centerline"]
    aside = [
        (float(np.abs(np.interp(host + 5, track.s, track.d))), track.id) for track in centres if track.has(host + 5)
    ]
    return min(aside)[1] if aside else None
