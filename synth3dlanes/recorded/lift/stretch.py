"""One stretch of a drive: its ground, and the tracks of the lanes on it. Memory is bounded by the number of scans."""

from collections.abc import Sequence
from dataclasses import dataclass

from synth3dlanes.recorded.drives.drive import Drive, DriveFrame
from synth3dlanes.recorded.lift.cloud import WorldPoints, cloud_of, together
from synth3dlanes.recorded.lift.ground import GroundMap, fit_ground
from synth3dlanes.recorded.lift.path import Path, path_of
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.recorded.lift.tracks import Track, curve_of, joined, marked_lines, seen_lines, without_strays
from synth3dlanes.system.errors import InputError

# Scans from places closer than this tell nothing new; more points than this, of all scans, are thinned.
APART_M, MOST_POINTS = 0.5, 4_000_000


@dataclass(frozen=True, eq=False)
class Stretch:
    """The ground along a path, and the lanes on it: those that pictures show, then those that are marked."""

    path: Path
    ground: GroundMap
    tracks: tuple[Track, ...]


def lift_stretch(drive: Drive, frames: Sequence[DriveFrame], precision: Precision) -> Stretch:
    """The ground and the delimiters of some frames of a drive, from all of their scans and 2D lanes."""
    path = path_of([frame.world_from_host for frame in frames])
    ground = fit_ground(scans_along(drive, frames, path), path, precision)
    groups = joined(seen_lines(drive, frames, ground, path, precision))
    seen = [curve_of(f"line_{i}", group, ground, path) for i, group in enumerate(groups)]
    tracks = without_strays([track for track in seen if track is not None])
    for lane, sight in marked_lines(drive.marked, path, precision):
        track = curve_of(lane.id, [sight], ground, path)
        if track is not None:
            tracks.append(track.marked_as(lane))
    return Stretch(path, ground, tuple(tracks))


def scans_along(drive: Drive, frames: Sequence[DriveFrame], path: Path) -> WorldPoints:
    """The points of the frames' scans near their path, thinned. Raises InputError where there are none."""
    clouds: list[WorldPoints] = []
    last, every = None, 1
    for number, frame in enumerate(frames):
        place = frame.world_from_host[:2, 3]
        if last is not None and ((place - last) ** 2).sum() < APART_M**2:
            continue
        scan = frame.scan()
        if scan is not None:
            clouds.append(cloud_of(scan, drive.host_from_lidar, path, number).thinned(every))
            last = place
            # Scan by scan: the points of all of them may not fit into memory.
            while sum(len(cloud.scan) for cloud in clouds) > MOST_POINTS:
                clouds, every = [cloud.thinned(2) for cloud in clouds], 2 * every
    if not sum(len(cloud.scan) for cloud in clouds):
        raise InputError(f"{drive.name}: expected scans with points near the host's path, got none")
    return together(clouds)
