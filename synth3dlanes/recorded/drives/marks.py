"""Lanes that a person marked in the top view of a drive: GeoJSON, read and written (docs/drives.md); and those of a
lifted data set as such lanes, to be corrected on the marking page.

A collection of lines in metres, in the frame of the drive's poses: x and y of its world, whose z points up.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import shapely
from pydantic import Field

from synth3dlanes.dataset.read import Reader
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Direction, Lane, LaneKind, Marking, PaintColor
from synth3dlanes.recorded.drives.drive import Drive, MarkedLane
from synth3dlanes.recorded.drives.tables import read_bytes
from synth3dlanes.system.arrays import Polyline2
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import Excerpt, Name, parse

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
    found = parse(_Collection, read_bytes(path, MAX_MARKS_BYTES), str(path), "a FeatureCollection", MAX_MARKS_BYTES)
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


def marks_text(lanes: Sequence[MarkedLane], drive: str) -> str:
    """The text of such a file."""
    return json.dumps(marks_document(lanes, drive), indent=1) + "\n"


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
