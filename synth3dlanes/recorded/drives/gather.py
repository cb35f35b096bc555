"""Gather what sensors recorded, each with its own times, into the frames of a drive.

A frame is a scan and the image nearest to it in time, at most 55 ms away, which no other scan is nearer to; where a
drive has no scans, an image. Frames whose pose is not known are left out.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.formats.reading import read_file
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.recorded.drives.clouds import MAX_CLOUD_BYTES, read_cloud
from synth3dlanes.recorded.drives.drive import Drive, DriveCamera, DriveFrame, MadeFrames, MarkedLane, Scan
from synth3dlanes.recorded.drives.lines import ImageLines
from synth3dlanes.recorded.drives.poses import PoseTrack
from synth3dlanes.system.arrays import Matrix4, Points3, Polyline2, Scalars
from synth3dlanes.system.errors import FormatError

MATCH_S = 0.055
# A world whose first pose is farther than this from its origin is moved there.
FAR_M = 1000.0
# The steps of a turn in which the car's motion is undone.
TURN_STEPS = 64


@dataclass(frozen=True, eq=False)
class TimedFiles:
    """Files and when each was recorded, in seconds, in the order of these."""

    paths: Sequence[Path] = ()
    times_s: Scalars = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.paths)


@dataclass(frozen=True, eq=False)
class Recording:
    """What a reader found of a drive: files of scans and images, the track of the host, the sensors' places, and how
    points are read: turned into our axes and metres by `ours_from_file`. `turns_s` are the instants at which the turn
    of each scan begins and ends, where the car's motion in it is still to be undone. `lanes_px` gives an image's
    lanes."""

    scans: TimedFiles
    images: TimedFiles
    track: PoseTrack
    host_from_lidar: Matrix4
    ours_from_file: Matrix4
    turns_s: tuple[Scalars, Scalars] | None = None
    lanes_px: Callable[[Path], tuple[Polyline2, ...]] | None = None


def timed(paths: Sequence[Path], times_s: Scalars, where: str, what: str) -> TimedFiles:
    """Files with their times, in order; raise FormatError where there are not as many, or where times do not
    increase."""
    if len(paths) != len(times_s):
        raise FormatError(f"{where}: expected a time for each of {len(paths)} {what}, got {len(times_s)}")
    late = np.flatnonzero(np.diff(times_s) <= 0)
    if len(late):
        at = int(late[0])
        told = f"got {times_s[at + 1]:.6f} s after {times_s[at]:.6f} s ({paths[at + 1].name})"
        raise FormatError(f"{where}: expected times of {what} that increase, {told}")
    return TimedFiles(paths, times_s)


def gather(name: str, recording: Recording, camera: DriveCamera, marked: Sequence[MarkedLane] = ()) -> Drive:
    """The drive. `marked` are in the frame of the track. Raises FormatError where no frame has a known pose."""
    scans, images, track = recording.scans, recording.images, recording.track
    if not len(scans) and not len(images):
        raise FormatError(f"{name}: expected files of scans or images, got none")
    scan_of, image_of = _pairs(scans.times_s, images.times_s)
    scan_times = scans.times_s[scan_of] if len(scans) else images.times_s[image_of]
    has_image = image_of >= 0
    times_s = np.where(has_image, images.times_s[image_of], scan_times) if len(images) else scan_times
    is_known = track.knows(times_s) & track.knows(scan_times)
    notes = _notes(recording, has_image, is_known)
    if not is_known.any():
        told = f"got poses from {track.times_s[0]:.3f} to {track.times_s[-1]:.3f} s"
        when = f"{times_s.min():.3f} to {times_s.max():.3f} s"
        raise FormatError(f"{track.path}: expected poses around the frames of {name}, {when}, {told}")
    chosen = np.flatnonzero(is_known)
    first = track.at(times_s[chosen[:1]])[0, :3, 3]
    origin = np.round(first) if np.abs(first).max() > FAR_M else np.zeros(3)
    moved = replace(recording, track=track.moved(origin))
    of_lidar = moved.track.of(recording.host_from_lidar) if recording.turns_s is not None else None

    def make(number: int) -> DriveFrame:
        at = int(chosen[number])
        pose = moved.track.at(times_s[at : at + 1])[0]
        scan = int(scan_of[at]) if len(scans) else -1
        image = images.paths[image_of[at]] if has_image[at] else None
        return DriveFrame(
            (image or scans.paths[scan]).stem,
            float(times_s[at]),
            pose,
            image,
            partial(_scan, moved, of_lidar, scan) if scan >= 0 else None,
            recording.lanes_px(image) if recording.lanes_px is not None and image is not None else (),
            partial(read_file, image, MAX_CLOUD_BYTES) if image is not None and os.path.lexists(image) else None,
        )

    x, y, z = origin.tolist()
    lanes = tuple(replace(lane, xy_world=lane.xy_world - origin[:2]) for lane in marked)
    return Drive(name, MadeFrames(len(chosen), make), camera, recording.host_from_lidar, lanes, (x, y, z), tuple(notes))


def with_lines(drive: Drive, lines: ImageLines) -> Drive:
    """The drive with other lanes in its images, found by the names of these. Raises FormatError where none has any."""
    lines.expect_some(frame.image for frame in drive.frames if frame.image is not None)

    def make(number: int) -> DriveFrame:
        frame = drive.frames[number]
        return replace(frame, lanes_px=lines.of(frame.image) if frame.image is not None else ())

    return replace(drive, frames=MadeFrames(len(drive.frames), make))


def _pairs(
    scans_s: Float[np.ndarray, " s"], images_s: Float[np.ndarray, " i"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """The scan and the image of each frame, -1 where it has none."""
    if not len(scans_s):
        return np.full(len(images_s), -1), np.arange(len(images_s))
    if not len(images_s):
        return np.arange(len(scans_s)), np.full(len(scans_s), -1)
    image = _nearest(images_s, scans_s)
    is_mutual = _nearest(scans_s, images_s)[image] == np.arange(len(scans_s))
    is_near = np.abs(images_s[image] - scans_s) <= MATCH_S
    return np.arange(len(scans_s)), np.where(is_mutual & is_near, image, -1)


def _nearest(times_s: Float[np.ndarray, " t"], wanted_s: Scalars) -> Int[np.ndarray, " n"]:
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, max(1, len(times_s) - 1))
    before = after - 1
    after = np.minimum(after, len(times_s) - 1)
    return np.where(np.abs(times_s[after] - wanted_s) < np.abs(times_s[before] - wanted_s), after, before)


def _notes(recording: Recording, has_image: Bool[np.ndarray, " n"], is_known: Bool[np.ndarray, " n"]) -> list[str]:
    """What was left out, one line each."""
    notes = []
    if not is_known.all():
        told = f"{recording.track.path}: no pose within a second of these"
        notes.append(f"{np.count_nonzero(~is_known)} of {len(is_known)} frames left out: {told}")
    if len(recording.images) and not has_image.all():
        told = f"none was taken within {1000 * MATCH_S:.0f} ms of these"
        notes.append(f"{np.count_nonzero(~has_image)} of {len(has_image)} scans have no image: {told}")
    return notes


def _scan(recording: Recording, of_lidar: PoseTrack | None, number: int) -> Scan:
    """A scan as its file has it, in our axes, with the car's motion undone where that is still to be done."""
    time_s = float(recording.scans.times_s[number])
    cloud = read_cloud(recording.scans.paths[number])
    # The matrix may have a scale, which makes metres of a file's unit.
    xyz_lidar = transform(recording.ours_from_file, cloud.xyz)
    if recording.turns_s is not None and of_lidar is not None:
        begins_s, ends_s = recording.turns_s
        xyz_lidar = untwisted(xyz_lidar, of_lidar, time_s, (float(begins_s[number]), float(ends_s[number])))
    return Scan(xyz_lidar, cloud.intensity, time_s, recording.track.at(np.array([time_s]))[0])


def untwisted(xyz_lidar: Points3, of_lidar: PoseTrack, time_s: float, turn_s: tuple[float, float]) -> Points3:
    """Points as seen from where the lidar was at `time_s`. It turned once, clockwise as seen from above, from straight
    back to straight back, between the instants `turn_s`, and saw each point when it looked there."""
    share = (np.arctan2(xyz_lidar[:, 0], xyz_lidar[:, 1]) + np.pi) / (2 * np.pi)
    step = np.clip((share * TURN_STEPS).astype(int), 0, TURN_STEPS - 1)
    times = turn_s[0] + (np.arange(TURN_STEPS) + 0.5) / TURN_STEPS * (turn_s[1] - turn_s[0])
    then = invert(of_lidar.at(np.array([time_s]))[0]) @ of_lidar.at(times)
    return np.einsum("nij,nj->ni", then[step, :3, :3], xyz_lidar) + then[step, :3, 3]
