"""Labels: what a network must predict from an image, and their JSON form (`labels.json`, docs/format.md).

Points are in camera coordinates (x right, y along the viewing direction, z up), metres. Pure data.
"""

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.errors import FormatError

LABELS_VERSION = 1

LaneKind = Literal["centerline", "delimiter"]
RoadName = Literal["main", "exit"]
Marking = Literal["none", "solid", "dashed"]
PaintColor = Literal["white", "yellow"]


@dataclass(frozen=True, eq=False)
class CameraLabel:
    """The camera whose frame the points are in; `img_from_cam` acts on (x, y, z) of that frame. `roll_rad` is about
    the viewing axis, positive clockwise as the driver sees it; older labels lack it."""

    width_px: int
    height_px: int
    img_from_cam: Float[np.ndarray, "3 3"]
    height_m: float
    pitch_rad: float
    road_from_cam: Float[np.ndarray, "4 4"]
    world_from_cam: Float[np.ndarray, "4 4"]
    roll_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class Lane:
    """One curve, near to far. `left` and `right` are ids: of the delimiters that bound a centre line on its own stretch
    (behind the split, before the merge), or of the centre lines that a delimiter bounds there; None outside the road.
    `color` and `double` (two stripes, the points in the middle between them) are None for centre lines and in older
    labels. `object_visible` is None until the scene has been rendered."""

    id: str
    kind: LaneKind
    road: RoadName
    marking: Marking
    left: str | None
    right: str | None
    xyz_cam: Float[np.ndarray, "n 3"]
    in_image: Bool[np.ndarray, " n"]
    terrain_visible: Bool[np.ndarray, " n"]
    object_visible: Bool[np.ndarray, " n"] | None
    color: PaintColor | None = None
    double: bool | None = None

    @property
    def visible(self) -> Bool[np.ndarray, " n"]:
        """Inside the image, not hidden by the ground and, if `object_visible` is known, not hidden by an object."""
        seen = self.in_image & self.terrain_visible
        return seen if self.object_visible is None else seen & self.object_visible


@dataclass(frozen=True)
class Segment:
    """A lane between two junctions: its number from the left as the host drives, the stations (world y on the main
    reference line) where it starts and ends in driving order, its neighbours, and the centre lines that follow it."""

    id: str
    road: RoadName
    lane: int
    s_start_m: float
    s_end_m: float
    left: str | None
    right: str | None
    centerlines: tuple[str, ...]


@dataclass(frozen=True)
class LaneGraph:
    """Segments and their successors in driving direction. `ramp_start_s_m` is None if the scene has no ramp."""

    segments: tuple[Segment, ...]
    successors: dict[str, tuple[str, ...]]
    ramp_start_s_m: float | None


@dataclass(frozen=True)
class RoadPlane:
    """A plane through the camera's foot, given by the camera's pitch (positive = down) and height over it; no roll."""

    pitch_rad: float
    height_m: float


@dataclass(frozen=True, eq=False)
class Labels:
    """The exact labels of one image.

    `camera` holds pitch and height over the plane that touches the road at the host; `horizon` is the plane through the
    farthest visible point of the host lane (the paper's 'horizon' variant), None if no point is visible.
    `car_visible_fraction` is the visible share of each car's silhouette; None until rendered.
    """

    camera: CameraLabel
    lanes: tuple[Lane, ...]
    graph: LaneGraph
    horizon: RoadPlane | None = None
    car_visible_fraction: tuple[float, ...] | None = None


def to_json(labels: Labels) -> str:
    """The labels as one line of JSON: points rounded to 0.1 mm, matrices to 1e-9; equal labels give equal text."""
    camera = labels.camera
    document = {
        "format": "synth3dlanes.labels",
        "version": LABELS_VERSION,
        "camera": {
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "img_from_cam": _rounded(camera.img_from_cam, 9),
            "height_m": camera.height_m,
            "pitch_rad": camera.pitch_rad,
            "roll_rad": camera.roll_rad,
            "road_from_cam": _rounded(camera.road_from_cam, 9),
            "world_from_cam": _rounded(camera.world_from_cam, 9),
        },
        "lanes": [_lane_document(lane) for lane in labels.lanes],
        "graph": {
            "segments": [
                {**vars(segment), "centerlines": list(segment.centerlines)} for segment in labels.graph.segments
            ],
            "successors": {key: list(value) for key, value in labels.graph.successors.items()},
            "ramp_start_s_m": labels.graph.ramp_start_s_m,
        },
        "horizon": None if labels.horizon is None else vars(labels.horizon),
        "car_visible_fraction": labels.car_visible_fraction,
    }
    return json.dumps(document, separators=(",", ":"), allow_nan=False)


def from_json(text: str | bytes, where: str) -> Labels:
    """Parse `labels.json`; raise FormatError, its message beginning with `where`."""
    try:
        document = json.loads(text)
        found = (document["format"], document["version"])
        if found != ("synth3dlanes.labels", LABELS_VERSION):
            raise FormatError(f"{where}: expected synth3dlanes.labels version {LABELS_VERSION}, got {found}")
        camera = dict(document["camera"])
        for name in ("img_from_cam", "road_from_cam", "world_from_cam"):
            camera[name] = np.array(camera[name], dtype=float)
        graph = document["graph"]
        return Labels(
            camera=CameraLabel(**camera),
            lanes=tuple(_lane(lane) for lane in document["lanes"]),
            graph=LaneGraph(
                segments=tuple(
                    Segment(**{**segment, "centerlines": tuple(segment["centerlines"])})
                    for segment in graph["segments"]
                ),
                successors={key: tuple(value) for key, value in graph["successors"].items()},
                ramp_start_s_m=graph["ramp_start_s_m"],
            ),
            horizon=None if document["horizon"] is None else RoadPlane(**document["horizon"]),
            car_visible_fraction=_tuple(document["car_visible_fraction"]),
        )
    except FormatError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise FormatError(f"{where}: not a labels file: {type(error).__name__}: {error}") from None


def _tuple(values: list[float] | None) -> tuple[float, ...] | None:
    return None if values is None else tuple(values)


def _rounded(values: Float[np.ndarray, "..."], decimals: int) -> Any:
    # Adding 0.0 turns -0.0 into 0.0, so that equal numbers give equal text.
    return (np.round(values, decimals) + 0.0).tolist()


def _lane_document(lane: Lane) -> dict[str, Any]:
    document = dict(vars(lane))
    document["xyz_cam"] = _rounded(lane.xyz_cam, 4)
    for name in ("in_image", "terrain_visible", "object_visible"):
        mask = document[name]
        document[name] = None if mask is None else mask.astype(int).tolist()
    return document


def _lane(document: dict[str, Any]) -> Lane:
    fields = dict(document)
    fields["xyz_cam"] = np.array(fields["xyz_cam"], dtype=float).reshape(-1, 3)
    for name in ("in_image", "terrain_visible", "object_visible"):
        if fields[name] is not None:
            fields[name] = np.array(fields[name], dtype=bool)
    return Lane(**fields)
