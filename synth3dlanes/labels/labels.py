"""Labels: what a network must predict from an image, and their JSON form (`labels.json`, docs/format.md).

Points are in camera coordinates (x right, y along the viewing direction, z up), metres. Pure data.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field, with_config

from synth3dlanes.geometry.frames import inside_image
from synth3dlanes.geometry.lens import PINHOLE, Lens
from synth3dlanes.geometry.polylines import stretches
from synth3dlanes.labels.object_labels import ObjectLabel, object_document
from synth3dlanes.scene.things import DRIVEN
from synth3dlanes.system.json_arrays import JsonMask, JsonMatrix3, JsonMatrix4, JsonPairs, JsonPoints, rounded
from synth3dlanes.system.schema import STRICT, DocumentPart, Name, Number, PixelCount, Positive, SymbolKind, Unit, parse

LABELS_FORMAT, LABELS_VERSION = "synth3dlanes.labels", 1

MASKS = ("in_image", "terrain_visible", "object_visible")
# Keys of lanes and segments that only labels of maps have.
OF_MAPS = ("connector", "junction")

LaneKind = Literal["centerline", "delimiter"]
Marking = Literal["none", "solid", "dashed"]
PaintColor = Literal["white", "yellow"]
Pair = Literal["solid_dashed", "dashed_solid"]
Direction = Literal["same", "oncoming", "crossing"]
MIRRORED: dict[str, Pair] = {"solid_dashed": "dashed_solid", "dashed_solid": "solid_dashed"}
"""A pair as seen by a driver who comes the other way."""


@with_config(STRICT)
@dataclass(frozen=True, eq=False)
class CameraLabel:
    """The camera that took the image. `img_from_cam` maps (x, y, z) of the camera frame to pixels. `roll_rad` is about
    the viewing axis, positive clockwise as the driver sees it. `yaw_rad` is the angle from the host's direction to that
    axis, positive to the left. `lens` is the distortion that `img_from_cam` lacks; `project` and `rays` apply it.
    Labels made before version 0.3.0 lack `yaw_rad`, `name` and `lens` if these are 0, "" and a pinhole; older ones also
    lack `roll_rad`."""

    width_px: PixelCount
    height_px: PixelCount
    img_from_cam: JsonMatrix3
    height_m: Positive
    pitch_rad: Number
    road_from_cam: JsonMatrix4
    world_from_cam: JsonMatrix4
    roll_rad: Number = 0.0
    yaw_rad: Number = 0.0
    name: Name = ""
    lens: Lens = PINHOLE

    def project(self, points_cam: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Pixels (u, v) of points; NaN for points behind the camera or outside the lens's field."""
        return self.lens.project(self.img_from_cam, points_cam)

    def shows(self, points_cam: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Whether each point is within the borders of the image."""
        return inside_image(self.project(points_cam), self.width_px, self.height_px)

    def rays(self, uv: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
        """Unit vectors along which pixels (u, v) look; NaN outside the lens's field."""
        return self.lens.rays(self.img_from_cam, uv)

    def points(self, uv: Float[np.ndarray, "*n 2"], depth_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n 3"]:
        """The points seen by pixels (u, v) at planar depths, as the pass `depth` has them."""
        rays = self.rays(uv)
        return np.asarray(rays * (depth_m / rays[..., 1])[..., None])


@with_config(STRICT)
@dataclass(frozen=True, eq=False)
class Lane:
    """One curve, in the host's driving direction.

    `left` and `right` are ids. For a centre line they name the delimiters that bound it on its own stretch (behind the
    split, before the merge); for a delimiter, the centre lines that it bounds there. They are None outside the road,
    and where the neighbour is out of range. In a clip they are the same in every frame, and may name lines that only
    other frames have.

    `color` and `double` (two stripes; the points are in the middle between them) are None for centre lines and in older
    labels. `pair` names the stripes of a double line, from the left, where they differ; its `marking` is `solid` then.
    `object_visible` is None until the scene has been rendered. `direction` is the direction of traffic in a centre
    line's lane; a delimiter is `oncoming` if all lanes that it bounds are. `std_m` has the standard deviations of each
    point: across the lane, level, and in height. Only measured labels (`lift`) have it; labels of scenes are exact.
    Older labels may lack `same` and `pair`.

    In labels of a map, points of a `crossing` line go in the direction of its traffic (docs/network.md). `junction` is
    the id of the line's junction, `connector` says whether the line is a lane's way through a junction. Both are None
    in labels of the paper's roads, whose document lacks them."""

    id: Name
    kind: LaneKind
    road: Name
    marking: Marking
    left: Name | None
    right: Name | None
    xyz_cam: JsonPoints
    in_image: JsonMask
    terrain_visible: JsonMask
    object_visible: JsonMask | None
    color: PaintColor | None = None
    double: bool | None = None
    direction: Direction = "same"
    pair: Pair | None = None
    std_m: JsonPairs | None = None
    connector: bool | None = None
    junction: Name | None = None

    def __post_init__(self) -> None:
        """Check that each mask has a value for every point; raise ValueError."""
        _check_masks(self)
        if self.std_m is not None and len(self.std_m) != len(self.xyz_cam):
            raise ValueError(f"std_m: expected a pair for each of {len(self.xyz_cam)} points, got {len(self.std_m)}")

    @property
    def visible(self) -> Bool[np.ndarray, " n"]:
        """Inside the image, not hidden by the ground and, if `object_visible` is known, not hidden by an object."""
        return _visible(self)

    def visible_parts(self) -> list[Float[np.ndarray, "_ 3"]]:
        """The visible points in the camera frame, in metres, as a polyline for each unbroken stretch of them.

        `xyz_cam[visible]` would join what lies before and behind a hidden stretch.
        """
        return [self.xyz_cam[first:end] for first, end in stretches(self.visible)]


@with_config(STRICT)
@dataclass(frozen=True, eq=False)
class SymbolLabel:
    """Paint on the road that bounds no lane: its outline as a closed polygon, whose last point is not the first one
    again. The outline of a crosswalk or a gore encloses its whole area. Masks are as for lanes."""

    kind: SymbolKind
    xyz_cam: JsonPoints
    in_image: JsonMask
    terrain_visible: JsonMask
    object_visible: JsonMask | None

    def __post_init__(self) -> None:
        """Check that each mask has a value for every point; raise ValueError."""
        _check_masks(self)

    @property
    def visible(self) -> Bool[np.ndarray, " n"]:
        """Inside the image, not hidden by the ground and, if `object_visible` is known, not hidden by an object."""
        return _visible(self)


def _check_masks(of: Lane | SymbolLabel) -> None:
    n = len(of.xyz_cam)
    for name in MASKS:
        mask = getattr(of, name)
        if mask is not None and len(mask) != n:
            raise ValueError(f"{name}: expected a value for each of {n} points, got {len(mask)}")


def _visible(of: Lane | SymbolLabel) -> Bool[np.ndarray, " n"]:
    seen = of.in_image & of.terrain_visible
    return seen if of.object_visible is None else seen & of.object_visible


@with_config(STRICT)
@dataclass(frozen=True)
class Segment:
    """A lane between two junctions: its number from the left as the host drives, the stations (world y on the main
    reference line) where it starts and ends in driving order, its neighbours, and the centre lines that follow it. Of a
    map: its number from the left as its traffic drives, stations of its own road, and the junction that it is in."""

    id: Name
    road: Name
    lane: Annotated[int, Field(ge=1, le=100)]
    s_start_m: Number
    s_end_m: Number
    left: Name | None
    right: Name | None
    centerlines: tuple[Name, ...]
    junction: Name | None = None


@with_config(STRICT)
@dataclass(frozen=True)
class LaneGraph:
    """Segments and their successors in driving direction. `ramp_start_s_m` is None if the scene has no ramp. Of a map,
    `yields` are pairs of segments, the first of which yields to the second; None without one."""

    segments: tuple[Segment, ...]
    successors: dict[Name, tuple[Name, ...]]
    ramp_start_s_m: Number | None
    yields: tuple[tuple[Name, Name], ...] | None = None


@with_config(STRICT)
@dataclass(frozen=True)
class RoadPlane:
    """A plane through the camera's foot, given by the camera's pitch (positive = down) and height over it; no roll."""

    pitch_rad: Number
    height_m: Number


@with_config(STRICT)
@dataclass(frozen=True, eq=False)
class LidarLabel:
    """The lidar beside the camera: the elevations of its beams from the top down, the azimuths of a turn, the ranges
    that it measures, and its place."""

    name: Name
    elevations_rad: Annotated[tuple[Number, ...], Field(min_length=1, max_length=256)]
    azimuths: PixelCount
    min_range_m: Number
    max_range_m: Positive
    cam_from_lidar: JsonMatrix4


@dataclass(frozen=True, eq=False)
class Labels:
    """The exact labels of one image.

    `camera` holds pitch and height over the plane that touches the road at the host; `horizon` is the plane through the
    farthest visible point of the host lane (the paper's 'horizon' variant), None if no point is visible or the camera
    does not look ahead.
    `symbols` are the scene's arrows, stop lines, crosswalks and gores, in its order; none of them is a lane. `lidar` is
    the scene's lidar, if it has one. `objects` are the scene's cars, then its people, riders and road works, each in
    the scene's order; None in older labels, which have the seen shares of cars in `older_shares`. `traffic_elements`
    are the heads of signals and faces of signs near the camera, in the order of their ids; None in older labels.
    """

    camera: CameraLabel
    lanes: tuple[Lane, ...]
    graph: LaneGraph
    horizon: RoadPlane | None = None
    symbols: tuple[SymbolLabel, ...] = ()
    time_s: float | None = None
    lidar: LidarLabel | None = None
    objects: tuple[ObjectLabel, ...] | None = None
    older_shares: tuple[float, ...] | None = None
    traffic_elements: tuple[ObjectLabel, ...] | None = None

    @property
    def car_visible_fraction(self) -> tuple[float, ...] | None:
        """For each car, the share of the pixels that it would fill, were it alone, in which it is seen; 0 without any
        such pixel, None until rendered."""
        if self.objects is None:
            return self.older_shares
        cars = [item for item in self.objects if item.category in DRIVEN]
        shares = tuple(item.visible_fraction for item in cars if item.visible_fraction is not None)
        return shares if len(shares) == len(cars) else None

    def with_seen_shares(self, shares: Sequence[float]) -> "Labels":
        """The labels with these seen shares of the objects, in their order."""
        items = zip(self.objects or (), shares, strict=True)
        return replace(self, objects=tuple(replace(item, visible_fraction=share) for item, share in items))


def to_json(labels: Labels) -> str:
    """The labels as one line of JSON: points rounded to 0.1 mm, matrices to 1e-9; equal labels give equal text.
    Every key is there, so that all labels have one schema; labels without a map lack the keys of maps."""
    camera, lidar, of_map = labels.camera, labels.lidar, labels.graph.yields is not None
    document: dict[str, Any] = {
        "format": LABELS_FORMAT,
        "version": LABELS_VERSION,
        "camera": {
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "img_from_cam": rounded(camera.img_from_cam, 9),
            "height_m": camera.height_m,
            "pitch_rad": camera.pitch_rad,
            "roll_rad": camera.roll_rad,
            "road_from_cam": rounded(camera.road_from_cam, 9),
            "world_from_cam": rounded(camera.world_from_cam, 9),
            "yaw_rad": camera.yaw_rad,
            "name": camera.name,
            "lens": camera.lens.model_dump(mode="json"),
        },
        "lanes": [_document(_points_document(lane), of_map) for lane in labels.lanes],
        "graph": {
            "segments": [
                _document({**vars(segment), "centerlines": list(segment.centerlines)}, of_map)
                for segment in labels.graph.segments
            ],
            "successors": {key: list(value) for key, value in labels.graph.successors.items()},
            "ramp_start_s_m": labels.graph.ramp_start_s_m,
            **({"yields": labels.graph.yields} if of_map else {}),
        },
        "horizon": None if labels.horizon is None else vars(labels.horizon),
        "car_visible_fraction": labels.car_visible_fraction,
        "symbols": [_points_document(symbol) for symbol in labels.symbols],
        "time_s": labels.time_s,
        "lidar": lidar and {**vars(lidar), "cam_from_lidar": rounded(lidar.cam_from_lidar, 9)},
        "objects": _documents(labels.objects),
        "traffic_elements": _documents(labels.traffic_elements),
    }
    return json.dumps(document, separators=(",", ":"), allow_nan=False)


class LabelsDocument(DocumentPart):
    """What a network must predict from one image: the whole of `labels.json`. Points in camera coordinates (x right, y
    along the viewing direction, z up), metres. Its JSON Schema is docs/labels.schema.json."""

    format: Literal["synth3dlanes.labels"]
    version: Literal[1]
    camera: CameraLabel
    lanes: tuple[Lane, ...]
    graph: LaneGraph
    horizon: RoadPlane | None
    car_visible_fraction: tuple[Unit, ...] | None
    symbols: tuple[SymbolLabel, ...] = ()
    time_s: Annotated[float, Field(ge=0, le=1e6)] | None = None
    lidar: LidarLabel | None = None
    objects: tuple[ObjectLabel, ...] | None = None
    traffic_elements: tuple[ObjectLabel, ...] | None = None


def from_json(text: str | bytes, where: str) -> Labels:
    """Parse `labels.json`; raise FormatError with one line per problem, each beginning with `where`."""
    read = parse(LabelsDocument, text, where, f"{LABELS_FORMAT} version {LABELS_VERSION}")
    return Labels(
        read.camera,
        read.lanes,
        read.graph,
        read.horizon,
        read.symbols,
        read.time_s,
        read.lidar,
        read.objects,
        None if read.objects is not None else read.car_visible_fraction,
        read.traffic_elements,
    )


def _documents(items: tuple[ObjectLabel, ...] | None) -> list[dict[str, Any]] | None:
    return None if items is None else [object_document(item) for item in items]


def _document(values: dict[str, Any], of_map: bool) -> dict[str, Any]:
    """The values of a document; without a map, the keys that only maps have are left out."""
    return {key: value for key, value in values.items() if of_map or key not in OF_MAPS}


def _points_document(of: Lane | SymbolLabel) -> dict[str, Any]:
    document = dict(vars(of))
    document["xyz_cam"] = rounded(of.xyz_cam, 4)
    for name in MASKS:
        mask = document[name]
        document[name] = None if mask is None else mask.astype(int).tolist()
    # Exact labels have no such key.
    if document.get("std_m", ()) is None:
        del document["std_m"]
    elif "std_m" in document:
        document["std_m"] = rounded(document["std_m"], 4)
    return document
