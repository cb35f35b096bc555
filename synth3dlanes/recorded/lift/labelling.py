"""Tracks and a frame -> Labels: every lane ahead of the host in camera coordinates, with its masks and its standard
deviations."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneGraph
from synth3dlanes.recorded.drives.drive import Drive, DriveFrame, Scan
from synth3dlanes.recorded.lift.cast import seen_over
from synth3dlanes.recorded.lift.curves import STATION_STEP_M
from synth3dlanes.recorded.lift.ground import GroundMap
from synth3dlanes.recorded.lift.hidden import seen_past_things
from synth3dlanes.recorded.lift.host_camera import camera_label
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.recorded.lift.stretch import Stretch
from synth3dlanes.recorded.lift.tracks import Track
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.truth.ground_truth import RANGE_M, horizon_plane

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
