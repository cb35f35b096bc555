"""The centre lines between neighbouring delimiters, and the neighbours of all lanes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from synth3dlanes.recorded.lift.curves import STATION_STEP_M
from synth3dlanes.recorded.lift.ground import GroundMap
from synth3dlanes.recorded.lift.path import Path
from synth3dlanes.recorded.lift.tracks import Track, on_ground, unplaced
from synth3dlanes.system.arrays import Scalars

# Widths between delimiters that bound a lane, along at least MIN_LENGTH_M without a gap: where lines meet or part they
# pass through these widths.
WIDTHS_M = (2.2, 5.0)
MIN_LENGTH_M = 10.0
# How the ids of delimiters begin that pictures show.
LINE = "line_"


def with_centres(tracks: Sequence[Track], ground: GroundMap, path: Path) -> list[Track]:
    """The tracks, and a centre line between each two delimiters that bound a lane and have none yet."""
    lines = [track for track in tracks if track.kind == "delimiter"]
    centres = []
    for left in lines:
        for right in lines:
            centre = _between(left, right, tracks)
            placed = None if centre is None else on_ground(centre, ground, path)
            if placed is not None:
                centres.append(placed)
    left_of = {centre.right: centre.id for centre in centres}
    right_of = {centre.left: centre.id for centre in centres}
    bounded = [replace(line, left=left_of.get(line.id), right=right_of.get(line.id)) for line in lines]
    others = [track for track in tracks if track.kind != "delimiter"]
    return [*bounded, *others, *centres]


def _between(left: Track, right: Track, tracks: Sequence[Track]) -> Track | None:
    """The centre line between two delimiters, where they bound a lane and no other track is between them."""
    shared, i, j = np.intersect1d(left.s, right.s, return_indices=True)
    width = right.d[j] - left.d[i]
    is_lane = (width > WIDTHS_M[0]) & (width < WIDTHS_M[1])
    if is_lane.sum() * STATION_STEP_M < MIN_LENGTH_M:
        return None
    middle = (left.d[i] + right.d[j]) / 2
    for other in tracks:
        if other.id not in (left.id, right.id):
            _, mine, theirs = np.intersect1d(shared, other.s, return_indices=True)
            inside = (other.d[theirs] > left.d[i][mine]) & (other.d[theirs] < right.d[j][mine])
            is_lane[mine[inside]] = False
    is_lane &= _in_long_runs(is_lane, shared)
    if not is_lane.any():
        return None
    std = np.hypot(left.std_m[i, 0], right.std_m[j, 0]) / 2
    return Track(
        id=f"centre_{left.id.removeprefix(LINE)}_{right.id.removeprefix(LINE)}",
        s=shared[is_lane],
        d=middle[is_lane],
        xyz_world=unplaced(int(is_lane.sum())),
        std_m=std[is_lane, None],
        kind="centerline",
        marking="none",
        color=None,
        direction=left.direction if left.direction == right.direction else "same",
        left=left.id,
        right=right.id,
    )


def _in_long_runs(is_lane: Bool[np.ndarray, " n"], stations: Scalars) -> Bool[np.ndarray, " n"]:
    """Which stations are in runs without a gap of at least MIN_LENGTH_M."""
    at = np.flatnonzero(is_lane)
    runs = np.split(at, np.flatnonzero(np.diff(stations[at]) > 1.5 * STATION_STEP_M) + 1)
    found = np.zeros(len(is_lane), dtype=bool)
    for run in runs:
        found[run] = len(run) * STATION_STEP_M >= MIN_LENGTH_M
    return found
