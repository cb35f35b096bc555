"""Lift a drive stretch by stretch: its labels, frame by frame. Memory does not grow with the length of the drive."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from synth3dlanes.labels.labels import Labels
from synth3dlanes.recorded.drives.drive import Drive, DriveFrame, RejectedLane
from synth3dlanes.recorded.lift.labelling import label_frame
from synth3dlanes.recorded.lift.precision import Precision
from synth3dlanes.recorded.lift.tracks import LINE, Stretch, Track, lift_stretch, with_centres
from synth3dlanes.system.errors import InputError

# Frames before and after each whose scans and lanes are used.
AROUND = 50


@dataclass(frozen=True, eq=False)
class LiftedFrame:
    """A frame of a drive, its labels, the stretch of road that they are from, and the ids of the rejected lanes that
    were found in it."""

    frame: DriveFrame
    labels: Labels
    stretch: Stretch
    rejected: frozenset[str]


def lifted_frames(drive: Drive, precision: Precision | None = None, around: int = AROUND) -> Iterator[LiftedFrame]:
    """The labels of every frame of a drive that nobody rejected, in order.

    Each is made from the scans and 2D lanes of at least `around` frames before and after it. A lane keeps its id
    through the drive. A marked lane replaces the lane that pictures show there, and the lane with its id. Lanes at a
    place where a person rejected a lane are left out. Raises InputError, which names the drive, if its points and poses
    do not fit.
    """
    precision = precision or Precision()
    kept = drive.kept()
    n, before = len(kept), None
    if not n:
        raise InputError(f"{drive.name}: expected frames, got none")
    lines = 0
    for start in range(0, n, 2 * around):
        end = min(n, start + 2 * around)
        if n - end < around:
            end = n
        first = max(0, start - around)
        frames = [kept[i] for i in range(first, min(n, end + around))]
        try:
            found, lines = _renamed(lift_stretch(drive, frames, precision), before, lines)
            stretch, rejected = _judged(found, drive.rejected)
            for frame in frames[start - first : end - first]:
                labels = label_frame(drive, frame, stretch, precision)
                yield LiftedFrame(frame, labels, stretch, rejected)
        except InputError as error:
            where = f"{drive.name}: frames {frames[0].name} to {frames[-1].name}"
            raise InputError(f"{where}: {error}") from None
        before = found
        if end == n:
            return


def _renamed(stretch: Stretch, before: Stretch | None, lines: int) -> tuple[Stretch, int]:
    """The stretch with the ids of the one before for the same lanes, new ones for others; and how many there are.
    Marked lanes have the ids that they were given."""
    tracks: list[Track] = []
    for track in stretch.tracks:
        if track.is_marked:
            tracks.append(track)
            continue
        same = None if before is None else _same(track, before, stretch, {other.id for other in tracks})
        if same is None:
            same, lines = f"{LINE}{lines}", lines + 1
        tracks.append(replace(track, id=same))
    return replace(stretch, tracks=tuple(tracks)), lines


def _same(track: Track, before: Stretch, now: Stretch, taken: set[str]) -> str | None:
    """The id of the track of the stretch before that lies where this one does."""
    found = [
        (track.lies_at(now.path.to_plan(other.xyz_world[:, :2])), other.id)
        for other in before.tracks
        if not other.is_marked and other.id not in taken
    ]
    return min(found)[1] if found and np.isfinite(min(found)[0]) else None


def _judged(stretch: Stretch, rejected: Sequence[RejectedLane]) -> tuple[Stretch, frozenset[str]]:
    """The stretch with its centre lines, without rejected lanes and without lanes that marked lanes replace; and which
    rejected lanes were found."""
    lanes = _without_replaced(stretch.tracks)
    found: set[str] = set()
    for lane in rejected:
        plan = stretch.path.to_plan(lane.xy_world) if len(lane.xy_world) else np.zeros((0, 2))
        apart_m, i = min(((track.lies_at(plan), i) for i, track in enumerate(lanes)), default=(np.inf, -1))
        if np.isfinite(apart_m):
            del lanes[i]
            found.add(lane.id)
    tracks = with_centres(lanes, stretch.ground, stretch.path)
    return replace(stretch, tracks=tuple(tracks)), frozenset(found)


def _without_replaced(tracks: Sequence[Track]) -> list[Track]:
    """The tracks, without tracks of pictures that marked tracks replace."""
    marked = [track for track in tracks if track.is_marked and track.kind == "delimiter"]
    plans = [np.column_stack([track.s, track.d]) for track in marked]
    ids = {track.id for track in tracks if track.is_marked}
    return [
        track
        for track in tracks
        if track.is_marked or not (track.id in ids or any(np.isfinite(track.lies_at(plan)) for plan in plans))
    ]
