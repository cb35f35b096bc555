"""Lift a drive stretch by stretch: its labels, frame by frame. Memory does not grow with the length of the drive."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from synth3dlanes.drives.drive import Drive, DriveFrame
from synth3dlanes.errors import InputError
from synth3dlanes.labels import Labels
from synth3dlanes.lift.labelling import label_frame
from synth3dlanes.lift.precision import Precision
from synth3dlanes.lift.stretch import Stretch, lift_stretch
from synth3dlanes.lift.tracks import Track

# Frames before and after each whose scans and lanes are used.
AROUND = 50
# Tracks of two stretches are one lane where they are this close in the middle of what they share.
SAME_M, SHARED = 0.8, 5


@dataclass(frozen=True, eq=False)
class LiftedFrame:
    """A frame of a drive, its labels, and the stretch of road that they are from."""

    frame: DriveFrame
    labels: Labels
    stretch: Stretch


def lifted_frames(drive: Drive, precision: Precision | None = None, around: int = AROUND) -> Iterator[LiftedFrame]:
    """The labels of every frame of a drive, in order.

    Each is made from the scans and 2D lanes of at least `around` frames before and after it. A lane keeps its id
    through the drive. Raises InputError, which names the drive, for one whose points and poses do not fit.
    """
    precision = precision or Precision()
    n, before = len(drive.frames), None
    if not n:
        raise InputError(f"{drive.name}: expected frames, got none")
    ids = 0
    for start in range(0, n, 2 * around):
        end = min(n, start + 2 * around)
        if n - end < around:
            end = n
        first = max(0, start - around)
        frames = [drive.frames[i] for i in range(first, min(n, end + around))]
        try:
            stretch = lift_stretch(drive, frames, precision)
            stretch, ids = _renamed(stretch, before, ids)
            for frame in frames[start - first : end - first]:
                labels = label_frame(drive, frame, stretch, precision)
                yield LiftedFrame(frame, labels, stretch)
        except InputError as error:
            where = f"{drive.name}: frames {frames[0].name} to {frames[-1].name}"
            raise InputError(f"{where}: {error}") from None
        before = stretch
        if end == n:
            return


def _renamed(stretch: Stretch, before: Stretch | None, ids: int) -> tuple[Stretch, int]:
    """The stretch with the ids of the one before for the same lanes, new ones for others; and how many there are."""
    names: dict[str, str] = {}
    for track in stretch.tracks:
        same = None if before is None else _same(track, before, stretch, set(names.values()))
        if same is None:
            same, ids = f"{'line' if track.kind == 'delimiter' else 'centre'}_{ids}", ids + 1
        names[track.id] = same
    tracks = tuple(
        replace(
            track,
            id=names[track.id],
            left=names.get(track.left) if track.left else None,
            right=names.get(track.right) if track.right else None,
        )
        for track in stretch.tracks
    )
    return replace(stretch, tracks=tracks), ids


def _same(track: Track, before: Stretch, now: Stretch, taken: set[str]) -> str | None:
    """The id of the track of the stretch before that lies where this one does."""
    found = []
    for other in before.tracks:
        if other.kind != track.kind or other.id in taken:
            continue
        s, d = now.path.to_plan(other.xyz_world[:, :2]).T
        order = np.argsort(s)
        inside = (track.s >= s.min()) & (track.s <= s.max())
        if inside.sum() >= SHARED:
            gap = np.abs(track.d[inside] - np.interp(track.s[inside], s[order], d[order]))
            found.append((float(np.median(gap)), other.id))
    return min(found)[1] if found and min(found)[0] < SAME_M else None
