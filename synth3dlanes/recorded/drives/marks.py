"""What a person says of a drive (docs/drives.md): lanes marked in its top view, as GeoJSON, read and written, or taken
from a lifted data set to be corrected; and verdicts on frames and lanes, the file that the review page saves.

Lines are in metres, in the frame of the drive's poses: x and y of its world, whose z points up.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import shapely
from pydantic import Field

from synth3dlanes.dataset.read import Reader
from synth3dlanes.formats.reading import read_file
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Direction, Lane, LaneKind, Marking, PaintColor
from synth3dlanes.recorded.drives.drive import Drive, MarkedLane, RejectedLane
from synth3dlanes.recorded.drives.tables import MAX_TEXT_BYTES
from synth3dlanes.system.arrays import Polyline2
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import DocumentPart, Excerpt, Name, parse
from synth3dlanes.system.words import counted

MARKS_FORMAT, MARKS_VERSION = "synth3dlanes.marks", 1
MAX_MARKS_BYTES = 64 << 20
MM_DECIMALS = 3

_Value = Annotated[float, Field(ge=-1e8, le=1e8)]
_Point = Annotated[list[_Value], Field(min_length=2, max_length=3)]


class _Line(Excerpt):
    type: Literal["LineString"]
    coordinates: Annotated[list[_Point], Field(min_length=2)]


class _Properties(Excerpt):
    id: Name | None = None
    kind: LaneKind = "delimiter"
    marking: Marking = "solid"
    color: PaintColor | None = None
    direction: Direction = "same"


class _Feature(Excerpt):
    type: Literal["Feature"]
    geometry: _Line
    properties: _Properties | None = None
    id: Name | int | None = None


class _Collection(Excerpt):
    type: Literal["FeatureCollection"]
    features: list[_Feature]


def read_marks(path: Path) -> tuple[MarkedLane, ...]:
    """The lanes of a file; those without an id are numbered. Raises FormatError with a line for each problem."""
    found = parse(_Collection, read_file(path, MAX_MARKS_BYTES), str(path), "a FeatureCollection", MAX_MARKS_BYTES)
    lanes = [_lane(feature, number, str(path)) for number, feature in enumerate(found.features, start=1)]
    ids = [lane.id for lane in lanes]
    twice = sorted({name for name in ids if ids.count(name) > 1})
    if twice:
        raise FormatError(f"{path}: expected every id once, got {twice[0]} twice")
    return tuple(lanes)


def marks_document(lanes: Sequence[MarkedLane], drive: str) -> dict[str, Any]:
    """The lanes as GeoJSON, as `read_marks` reads it."""
    return {
        "type": "FeatureCollection",
        "format": MARKS_FORMAT,
        "version": MARKS_VERSION,
        "drive": drive,
        "features": [
            {
                "type": "Feature",
                "properties": {name: getattr(lane, name) for name in ("id", "kind", "marking", "color", "direction")},
                "geometry": {"type": "LineString", "coordinates": np.round(lane.xy_world, MM_DECIMALS).tolist()},
            }
            for lane in lanes
        ],
    }


def _lane(feature: _Feature, number: int, where: str) -> MarkedLane:
    told = feature.properties or _Properties()
    xy = np.array([point[:2] for point in feature.geometry.coordinates])
    xy = xy[np.concatenate([[True], np.abs(np.diff(xy, axis=0)).max(axis=1) > 0])]
    name = told.id or (None if feature.id is None else str(feature.id)) or f"marked{number}"
    if len(xy) < 2:
        raise FormatError(f"{where}: features.{number - 1}: expected two different points or more, got one")
    return MarkedLane(name, xy, told.kind, told.marking, told.color, told.direction)


# Gap in a lane from which it goes on as another line.
GAP_M = 5.0
# Tolerance with which lines are simplified; shorter ones are left out.
OFF_M, LEAST_M = 0.03, 5.0


def lifted_marks(reader: Reader, drive: Drive) -> tuple[MarkedLane, ...]:
    """The delimiters of a split that was lifted from this drive, each once, in the drive's world. They keep their ids:
    when the drive is lifted again, a marked lane replaces the lane with its id. Raises InputError for a split of
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


REVIEW_FORMAT, REVIEW_VERSION = "synth3dlanes.review", 1

Verdict = Literal["accepted", "rejected"]
_Name = Annotated[str, Field(max_length=1000)]


class FrameVerdict(DocumentPart):
    """The verdict on a frame: its name, and the time by which it is known whatever its name (None for a picture that is
    of no clip)."""

    name: _Name
    time_s: Annotated[float, Field(ge=0, le=1e11)] | None = None
    verdict: Verdict


class LaneVerdict(DocumentPart):
    """The verdict on a lane: its id, and the places by which it is known whatever its id, as a drive's poses have
    them."""

    id: _Name
    xy: list[tuple[_Value, _Value]]
    verdict: Verdict


class Review(DocumentPart):
    """Verdicts; frames and lanes that nobody looked at have none. `source` is the split, `drive` the name of the drive
    that it was lifted from, empty where it is of scenes."""

    format: Literal["synth3dlanes.review"]
    version: Literal[1]
    source: _Name
    drive: _Name = ""
    frames: Annotated[list[FrameVerdict], Field(default_factory=list)]
    lanes: Annotated[list[LaneVerdict], Field(default_factory=list)]


def read_review(path: Path) -> Review:
    """Read such a file. Raises FormatError with a line for each problem."""
    what = f"{REVIEW_FORMAT} version {REVIEW_VERSION}"
    return parse(Review, read_file(path, MAX_TEXT_BYTES), str(path), what, MAX_TEXT_BYTES)


def with_review(drive: Drive, path: Path) -> Drive:
    """The drive without what a file of verdicts rejects. Verdicts on frames that the drive has not are noted. Raises
    FormatError as `read_review` does, InputError for verdicts on another drive."""
    review = read_review(path)
    if review.drive != drive.name:
        told = f"on {review.drive}" if review.drive else "on a data set that is of no drive"
        raise InputError(f"{path}: expected verdicts on the drive {drive.name}, got some {told}")
    known = {drive.label_time(frame) for frame in drive.frames}
    rejected_s = {frame.time_s for frame in review.frames if frame.verdict == "rejected" and frame.time_s is not None}
    lost = [frame.name for frame in review.frames if frame.time_s not in known]
    notes = [f"{path}: {counted(len(rejected_s & known), 'frame')} rejected: left out"] if rejected_s & known else []
    if lost:
        notes.append(f"{path}: {counted(len(lost), 'verdict')} on frames that the drive has not, such as {lost[0]}")
    if rejected_s >= known:
        raise InputError(f"{path}: expected a frame that is not rejected, got none")
    origin = np.array(drive.origin_m[:2])
    lanes = tuple(
        RejectedLane(lane.id, np.array(lane.xy).reshape(-1, 2) - origin)
        for lane in review.lanes
        if lane.verdict == "rejected"
    )
    return replace(drive, rejected=lanes, rejected_s=frozenset(rejected_s & known), notes=(*drive.notes, *notes))
