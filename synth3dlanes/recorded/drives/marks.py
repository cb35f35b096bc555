"""Lanes that a person marked in the top view of a drive: GeoJSON, read and written (docs/drives.md).

A collection of lines in metres, in the frame of the drive's poses: x and y of its world, whose z points up.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from synth3dlanes.labels.labels import Direction, LaneKind, Marking, PaintColor
from synth3dlanes.recorded.drives.drive import MarkedLane
from synth3dlanes.recorded.drives.tables import read_bytes
from synth3dlanes.system.errors import FormatError
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
