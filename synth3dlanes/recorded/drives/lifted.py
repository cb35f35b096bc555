"""The lanes of a lifted data set as marked lanes, to be corrected on the marking page."""

import numpy as np
import shapely

from synth3dlanes.dataset.read import Reader
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Lane
from synth3dlanes.recorded.drives.drive import Drive, MarkedLane
from synth3dlanes.system.arrays import Polyline2
from synth3dlanes.system.errors import InputError

# Gap in a lane from which it goes on as another line.
GAP_M = 5.0
# Tolerance with which lines are simplified; shorter ones are left out.
OFF_M, LEAST_M = 0.03, 5.0


def lifted_marks(reader: Reader, drive: Drive) -> tuple[MarkedLane, ...]:
    """The delimiters of a split that was lifted from this drive, each once, in the drive's world. They keep their ids,
    by which they take the place of what pictures show when the drive is lifted again. Raises InputError for a split of
    another drive."""
    derived = reader.description.get("derived") or {}
    if derived.get("lifted") != drive.name:
        told = derived.get("lifted", "one that was not lifted")
        raise InputError(f"{reader.url}: expected a split that was lifted from {drive.name}, got {told}")
    moved = np.array(derived.get("origin_m", (0.0, 0.0, 0.0))) - drive.origin_m
    lines: dict[str, list[np.ndarray]] = {}
    said: dict[str, Lane] = {}
    for i in range(len(reader)):
        labels = reader.labels(i)
        for lane in labels.lanes:
            if lane.kind == "delimiter":
                name = lane.id.partition(".")[0]
                said.setdefault(name, lane)
                xy = transform(labels.camera.world_from_cam, lane.xyz_cam)[:, :2] + moved[:2]
                _extend(lines.setdefault(name, []), xy)
    found = []
    for name, parts in lines.items():
        lane = said[name]
        for number, xy in enumerate(map(_simple, parts)):
            if np.linalg.norm(np.diff(xy, axis=0), axis=1).sum() >= LEAST_M:
                id_ = name if not number else f"{name}.{number + 1}"
                found.append(MarkedLane(id_, xy, "delimiter", lane.marking, lane.color, lane.direction or "same"))
    return tuple(found)


def _extend(parts: list[Polyline2], xy: Polyline2) -> None:
    """Add to the last line what leads beyond its end, or begin another after a gap."""
    if parts:
        apart_m = np.linalg.norm(xy - parts[-1][-1], axis=1)
        at = int(apart_m.argmin())
        if apart_m[at] < GAP_M:
            parts[-1] = np.concatenate([parts[-1], xy[at + 1 :]])
            return
        if np.linalg.norm(parts[-1] - xy[-1], axis=1).min() < GAP_M:
            return
    parts.append(xy)


def _simple(xy: Polyline2) -> Polyline2:
    return np.asarray(shapely.get_coordinates(shapely.LineString(xy).simplify(OFF_M)), float)
