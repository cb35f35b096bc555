"""OpenLane-V2: lanes as a map and which follows which, two JSONs a frame, in the vehicle frame.

| theirs | ours | unit, frame |
|---|---|---|
| `lane_centerline`, `lane_segment` | segments of the lane graph near the host, their paint (LINE_TYPES) | m, `_ego` |
| `id` | the segment's place in the lane graph; NEXT_PART more for each time that it comes back | |
| `topology_lclc`, `topology_lsls` | successors | 0 or 1 |
| `traffic_element`, `topology_lcte`, `topology_lste` | signals and signs that the first camera sees; their lanes | px |
| `area` | crosswalks; edges of the pavement | m, `_ego` |
| `sensor`, `pose` | cameras: vehicle from camera with OpenCV's axes, K; world from vehicle | m, px |

The vehicle frame (`_ego`) is x forward, y left, z up, its origin at the foot of the first camera, on the road.
"""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import AliasChoices, Field, RootModel

from synth3dlanes.formats.comparing import Comparison, SourceSample, compare_pinhole
from synth3dlanes.formats.comparing_maps import FoundLane, MapRule, compare_lanes
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame
from synth3dlanes.formats.lane_map import REACH_M, LaneSegment, lane_segments
from synth3dlanes.formats.reading import MOST_BYTES, image_size, read_file, read_text
from synth3dlanes.formats.writing import CV_FROM_CAM, FrameAnnotation, expect_pinhole
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.polylines import lengths_along, resampled, stretches
from synth3dlanes.labels.labels import CameraLabel, Marking
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.traffic_elements import ElementKind, ElementState
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import Matrix4, Points3
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import JsonMatrix3, JsonPoints, Row3
from synth3dlanes.system.schema import Excerpt, Number, PathBelow
from synth3dlanes.world.world import World, resolve

ROOT = "OpenLane-V2"
COLLECTIONS = ("data_dict_subset_A", "data_dict_subset_B")
FRONT_CAMERA = "ring_front_center"
"""Loaders expect it to be the first camera."""
ROAD_FROM_EGO = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Our ego frame has its origin at the foot of the first camera, on the road."""
AHEAD_M, ASIDE_M = 50.0, 25.0
"""Half the size of the area that is labelled and scored."""
CENTERLINE_POINTS, POINTS = 201, 51
"""Points of a centre line; the devkit keeps every 20th for validation. Points of a lane segment's lines."""
NEXT_PART = 1_000_000
"""A lane that leaves the area and comes back has a part of its own for each time, whose ids are this much apart."""
LINE_TYPES: dict[Marking, int] = {"none": 0, "solid": 1, "dashed": 2}
LEAST_PX, LEAST_SEEN = 3.0, 0.1
"""The shorter side of the rectangle of a traffic element, and the share of it that must be seen."""
PEDESTRIAN_CROSSING, ROAD_BOUNDARY = 1, 2
TRAFFIC_LIGHT, ROAD_SIGN = 1, 2
UNKNOWN = 0
"""The attribute of elements for which the benchmark has none."""
STATE_ATTRIBUTES: dict[ElementState, int] = {
    "red": 1, "red_cross": 1, "red_amber": 1, "green": 2, "green_arrow": 2,
    "amber": 3, "amber_left": 3, "amber_right": 3
}  # fmt: skip
"""The attribute of signals is their colour, whatever the form of their lenses; one that is off has none."""
SIGN_ATTRIBUTES: dict[ElementKind | None, int] = {
    "ahead_only": 4, "direction_ahead": 4, "left_only": 5, "right_only": 6, "no_left_turn": 7, "no_right_turn": 8,
    "no_u_turn": 10, "exit_left": 11, "direction_left": 11, "exit_right": 12, "direction_right": 12
}  # fmt: skip
"""The attribute of signs is the direction that they order, forbid or point to; none of ours has 9 (turn back)."""
POINT_DECIMALS = 4
LEAST_LENGTH_M = 2.0
SHORT = f"less than {LEAST_LENGTH_M:g} m of it in the area"
OUTSIDE = f"outside the area ({AHEAD_M:g} m ahead, {ASIDE_M:g} m to each side)"
LEAST_POINTS = 11  # what the benchmark compares
# A curve that is sampled every metre and one that is sampled every half are some millimetres apart.
RULE = MapRule("m", 0.05, slack=0.3, word=lambda marking, *_: str(LINE_TYPES[marking]), of_pieces=True, gap_m=1e-3)
LIMIT_PX = 0.02
# Tolerance at the border of the area.
BORDER_M = 2.0
# Error of rounded rectangles. A traffic element must be in an export if at least CLEAR_SHARE of it is seen, its
# rectangle's sides are at least CLEAR_PX long, and its face is seen at less than 84 degrees (its cosine is CLEAR_COS).
BOX_PX, CLEAR_SHARE, CLEAR_PX, CLEAR_COS = 0.2, 0.3, 4.0, 0.1

README = f"""OpenLane-V2 layout: subset B with the rig of nuScenes, subset A otherwise.

- `{ROOT}/{{train,val,test}}/<segment>/info/<timestamp>.json` (centre lines) and `<timestamp>-ls.json` (lane segments,
  areas), images in `<segment>/image/<camera>/<timestamp>.jpg`, `{ROOT}/{COLLECTIONS[0]}.json` (or `B`: the frames
  of each part).
- Loaders read pickle files, which the devkit makes: run its `preprocess.py` and `preprocess-ls.py` (in its folder
  `data/OpenLane-V2`) in this folder. That makes `{COLLECTIONS[0]}_train.pkl`,
  `{COLLECTIONS[0]}_train_ls.pkl` and so on.
- Frame: x forward, y left, z up, metres; the origin is on the road below the (first) camera. Every scene is a segment,
  every frame of a clip a timestamp (ns). The one camera is `{FRONT_CAMERA}`, those of a rig have its names. Tell
  your training code their number, and do not let it crop the front image as that of the original (which is upright).
- A lane that leaves the area and comes back has a part for each time: {NEXT_PART} is added to the id of the next.
- Labels cover {AHEAD_M:g} m ahead (and behind, with a camera that looks back) and {ASIDE_M:g} m to each side, also
  what the ground or cars hide, as in the original. Lines have the extra keys `left_laneline_color`,
  `left_laneline_double` and the same of the right.
- Traffic elements are the signals and signs that the first camera sees from their front: rectangles in its image, and
  ids that are the same in all frames of a clip.
"""


def category_and_attribute(item: ObjectLabel) -> tuple[int, int]:
    """The codes of a traffic element."""
    if item.state is None:
        return ROAD_SIGN, SIGN_ATTRIBUTES.get(item.kind, UNKNOWN)
    return TRAFFIC_LIGHT, STATE_ATTRIBUTES.get(item.state, UNKNOWN)


def collection(first_camera: str) -> str:
    """The list of all frames: subset B has the cameras of nuScenes, CAM_FRONT first."""
    return COLLECTIONS[first_camera.startswith("CAM_")]


@dataclass(frozen=True, eq=False)
class _Lane:
    """A part of a lane segment in the area, and whether its first and its last point are still those of the lane."""

    id: int
    segment: LaneSegment
    middle_ego: Float[np.ndarray, "n 3"]
    left_ego: Float[np.ndarray, "n 3"]
    right_ego: Float[np.ndarray, "n 3"]
    has_start: bool
    has_end: bool


def write(frame: SampleFrame) -> FrameAnnotation | None:
    """The two label files of a moment, with its first picture; None without any lane in the area."""
    expect_pinhole(frame.labels.camera, frame.where)
    shot = frame.scene.shot
    segment, timestamp = f"{frame.number - shot.frame * shot.n_cameras - shot.camera:08d}", round(shot.time_s * 1e9)
    image = f"{frame.part}/{segment}/image/{_name(frame.labels.camera)}/{timestamp}.jpg"
    if not frame.cameras:
        return FrameAnnotation(f"{ROOT}/{image}", 0)
    world, world_from_ego = resolve(frame.scene), ego_frame(frame.labels.camera)
    behind_m = AHEAD_M if any(_looks_back(camera, world_from_ego) for camera in frame.cameras.values()) else 0.0
    dropped = Counter[str]()
    lanes = _lanes(frame, world, world_from_ego, behind_m, dropped)
    if not lanes:
        return None
    topology = [
        [
            int(b.segment.id in frame.labels.graph.successors.get(a.segment.id, ()) and a.has_end and b.has_start)
            for b in lanes
        ]
        for a in lanes
    ]
    common = {
        "version": "2.1",
        "segment_id": segment,
        "meta_data": {"source": "synth3dlanes", "source_id": f"{frame.split}/{frame.key}"},
        "timestamp": timestamp,
        "sensor": {
            _name(camera): _sensor(
                camera, world_from_ego, f"{frame.part}/{segment}/image/{_name(camera)}/{timestamp}.jpg"
            )
            for camera in frame.cameras.values()
        },
        "pose": {"rotation": world_from_ego[:3, :3].tolist(), "translation": world_from_ego[:3, 3].tolist()},
    }
    elements = [item for item in frame.labels.traffic_elements or () if _is_seen(item)]
    governed = [[int(lane.segment.id in item.lanes) for item in elements] for lane in lanes]
    traffic_elements = [_element_document(item) for item in elements]
    centerlines = {
        "lane_centerline": [
            {"id": lane.id, "points": _rounded(resampled(lane.middle_ego, CENTERLINE_POINTS))} for lane in lanes
        ],
        "traffic_element": traffic_elements,
        "topology_lclc": topology,
        "topology_lcte": governed,
    }
    segments = {
        "lane_segment": [_segment_document(lane) for lane in lanes],
        "traffic_element": traffic_elements,
        "area": list(_areas(world, frame, world_from_ego, behind_m)),
        "topology_lsls": topology,
        "topology_lste": governed,
    }
    parts = frame.served
    return FrameAnnotation(
        f"{ROOT}/{image}",
        len(lanes),
        dropped,
        {
            f"{ROOT}/{part}/{segment}/info/{timestamp}{suffix}.json": json.dumps({**common, "annotation": annotation})
            for part in parts
            for suffix, annotation in (("", centerlines), ("-ls", segments))
        },
        tuple(
            (
                json.dumps([part, segment, f"{timestamp}.json"]),
                (f"{ROOT}/{collection(_name(frame.labels.camera))}.json",),
            )
            for part in parts
        ),
    )


def ego_frame(camera: CameraLabel) -> Matrix4:
    """World from the vehicle frame, given the first camera."""
    return np.asarray(camera.world_from_cam @ invert(camera.road_from_cam) @ ROAD_FROM_EGO)


def _name(camera: CameraLabel) -> str:
    return camera.name or FRONT_CAMERA


def _looks_back(camera: CameraLabel, world_from_ego: Matrix4) -> bool:
    return bool((invert(world_from_ego) @ camera.world_from_cam)[0, 1] < 0)


def _sensor(camera: CameraLabel, world_from_ego: Matrix4, image: str) -> dict[str, Any]:
    """A camera: `extrinsic` is the vehicle frame from OpenCV's camera frame."""
    ego_from_cam = invert(world_from_ego) @ camera.world_from_cam
    return {
        "image_path": image,
        "extrinsic": {
            "rotation": (ego_from_cam[:3, :3] @ CV_FROM_CAM.T).tolist(),
            "translation": ego_from_cam[:3, 3].tolist(),
        },
        "intrinsic": {"K": (camera.img_from_cam @ CV_FROM_CAM.T).tolist(), "distortion": [0.0, 0.0, 0.0]},
    }


def _lanes(
    frame: SampleFrame, world: World, world_from_ego: Matrix4, behind_m: float, dropped: Counter[str]
) -> list[_Lane]:
    ego_from_world, lanes = invert(world_from_ego), []
    for segment in lane_segments(world, frame.labels.graph.segments, world_from_ego[:3, 3]):
        middle_ego = transform(ego_from_world, segment.points_world)
        inside = list(stretches(_in_area(middle_ego, behind_m)))
        parts = [ends for ends in inside if lengths_along(middle_ego[slice(*ends)])[-1] >= LEAST_LENGTH_M]
        if not parts:
            dropped[SHORT if inside else OUTSIDE] += 1
        for number, (first, last) in enumerate(parts):
            part, is_whole = segment.part(first, last), (first == 0, last == len(middle_ego))
            left_ego, right_ego = (transform(ego_from_world, side.points_world) for side in (part.left, part.right))
            id_ = segment.index + number * NEXT_PART
            lanes.append(_Lane(id_, part, middle_ego[first:last], left_ego, right_ego, *is_whole))
    return lanes


def _in_area(points_ego: Float[np.ndarray, "n 3"], behind_m: float) -> Bool[np.ndarray, " n"]:
    x_m, y_m, _ = points_ego.T
    return np.asarray((x_m >= -behind_m) & (x_m <= AHEAD_M) & (np.abs(y_m) <= ASIDE_M))


def _is_seen(item: ObjectLabel) -> bool:
    """Whether the first camera sees the front of an element, and enough of it."""
    if item.box_px is None or item.normal_cam @ item.center_cam >= 0:
        return False
    is_large = min(item.box_px[2:] - item.box_px[:2]) >= LEAST_PX
    return bool(is_large) and (item.visible_fraction is None or item.visible_fraction >= LEAST_SEEN)


def _element_document(item: ObjectLabel) -> dict[str, Any]:
    assert item.box_px is not None, "only those that are seen"
    category, attribute = category_and_attribute(item)
    corners_px = np.round(item.box_px.reshape(2, 2), 1).tolist()
    return {"id": item.id, "category": category, "attribute": attribute, "points": corners_px}


def _segment_document(lane: _Lane) -> dict[str, Any]:
    document = {
        "id": lane.id,
        "centerline": _rounded(resampled(lane.middle_ego, POINTS)),
        "is_intersection_or_connector": lane.segment.is_connector,
    }
    for name, points_ego, side in (
        ("left_laneline", lane.left_ego, lane.segment.left),
        ("right_laneline", lane.right_ego, lane.segment.right),
    ):
        document |= {
            name: _rounded(resampled(points_ego, POINTS)),
            f"{name}_type": LINE_TYPES[side.marking],
            f"{name}_color": side.color,
            f"{name}_double": side.double,
        }
    return document


def _areas(world: World, frame: SampleFrame, world_from_ego: Matrix4, behind_m: float) -> Iterator[dict[str, Any]]:
    """Crosswalks as closed quads, one of whose long sides comes first; edges of the pavement in the area."""
    ego_from_world, index = invert(world_from_ego), len(frame.labels.graph.segments)
    for form in world.symbol_shapes:
        if form.kind == "crosswalk":
            (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
            corners = form.points_world(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]))
            quad_ego = transform(ego_from_world, corners)
            if _in_area(quad_ego, behind_m).all():
                yield {"id": index, "category": PEDESTRIAN_CROSSING, "points": _rounded(quad_ego)}
                index += 1
    for edge_world in world.ground.paved.edges(world_from_ego[:2, 3], REACH_M):
        edge_ego = transform(ego_from_world, edge_world)
        for first, end in stretches(_in_area(edge_ego, behind_m)):
            run = edge_ego[first:end]
            if lengths_along(run)[-1] >= LEAST_LENGTH_M:
                yield {"id": index, "category": ROAD_BOUNDARY, "points": _rounded(resampled(run, POINTS))}
                index += 1


def _rounded(points: Float[np.ndarray, "n 3"]) -> list[list[float]]:
    return np.asarray(np.round(points, POINT_DECIMALS) + 0.0).tolist()


def document(path: str, lines: Path) -> Iterator[str]:
    """The frames of each part by segment, as the devkit's `collect` takes them."""
    frames: dict[str, dict[str, list[str]]] = {}
    for line in lines.read_text().splitlines():
        part, segment, name = json.loads(line)
        frames.setdefault(part, {}).setdefault(segment, []).append(name)
    yield json.dumps(frames, indent=1) + "\n"


class _Collection(RootModel[dict[PathBelow, dict[PathBelow, list[PathBelow]]]]):
    """Names of label files by part and segment."""


Row2 = tuple[Number, Number]


class _Element(Excerpt):
    """A traffic element: its codes, and its rectangle in the first image by two corners."""

    id: int
    category: Literal[1, 2]
    attribute: Annotated[int, Field(ge=0, le=12)]
    points: tuple[Row2, Row2]


class _Centerline(Excerpt):
    id: int
    points: JsonPoints

    @property
    def lines(self) -> tuple[Points3, ...]:
        return (self.points,)

    @property
    def paint(self) -> dict[str, str]:
        return {}


class _Segment(Excerpt):
    id: int
    centerline: JsonPoints
    left_laneline: JsonPoints
    right_laneline: JsonPoints
    left_laneline_type: int
    right_laneline_type: int

    @property
    def lines(self) -> tuple[Points3, ...]:
        return self.centerline, self.left_laneline, self.right_laneline

    @property
    def paint(self) -> dict[str, str]:
        return {"left": str(self.left_laneline_type), "right": str(self.right_laneline_type)}


Topology = list[list[Literal[0, 1]]]


class _Lanes(Excerpt):
    """Lane segments or centre lines; which lane (column) follows which (row); traffic elements, and which of them
    (column) governs which lane (row)."""

    lanes: list[_Segment] | list[_Centerline] = Field(validation_alias=AliasChoices("lane_segment", "lane_centerline"))
    follows: Topology = Field(validation_alias=AliasChoices("topology_lsls", "topology_lclc"))
    elements: list[_Element] = Field(alias="traffic_element")
    governs: Topology = Field(validation_alias=AliasChoices("topology_lste", "topology_lcte"))


class _Pose(Excerpt):
    rotation: JsonMatrix3
    translation: Row3

    @property
    def matrix(self) -> Matrix4:
        return np.vstack([np.column_stack([self.rotation, self.translation]), [0, 0, 0, 1]])


class _Intrinsic(Excerpt):
    K: JsonMatrix3


class _Camera(Excerpt):
    """A camera: its image, its place in the vehicle frame with the axes of OpenCV, and its matrix K."""

    image: PathBelow = Field(alias="image_path")
    extrinsic: _Pose
    intrinsic: _Intrinsic


class TopologyFrame(Excerpt):
    """One label file: the vehicle's pose, the cameras by name, and the lanes, whose lines (the centre line, and in
    `-ls` files left and right boundary) are in the vehicle frame."""

    pose: _Pose
    cameras: dict[str, _Camera] = Field(alias="sensor")
    annotation: _Lanes


def parse(text: str, where: str) -> TopologyFrame:
    """One label file, of centre lines or of lane segments; FormatErrors begin with `where`."""
    found = schema.parse(TopologyFrame, text, where, "a frame of OpenLane-V2")
    lanes, follows, governs = found.annotation.lanes, found.annotation.follows, found.annotation.governs
    n_elements = len(found.annotation.elements)
    if {len(lanes)} != {len(follows), *map(len, follows)} and (lanes or follows):
        raise FormatError(f"{where}: topology: expected a row and a column for each of {len(lanes)} lanes, got others")
    if any(len(line) < LEAST_POINTS for lane in lanes for line in lane.lines):
        raise FormatError(f"{where}: expected lanes of {LEAST_POINTS} points or more, got fewer")
    if len(governs) != len(lanes) or any(len(row) != n_elements for row in governs):
        raise FormatError(f"{where}: topology: expected {len(lanes)} rows of {n_elements} traffic elements, got others")
    return found


def frames(out: Path) -> dict[str, list[Path]]:
    """The label files of centre lines of each part."""
    root = out / ROOT
    paths = [root / f"{name}.json" for name in COLLECTIONS]
    path = next((path for path in paths if path.exists()), paths[0])
    listed = schema.parse(_Collection, read_file(path), str(path), "a collection of OpenLane-V2", MOST_BYTES).root
    return {
        part: [root / part / segment / "info" / name for segment, names in segments.items() for name in names]
        for part, segments in listed.items()
    }


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The frames of every part: their centre lines, then their lane segments."""
    for part, paths in frames(out).items():
        for name, suffix in ((part, ""), (f"{part}, lane segments", "-ls")):
            files = (path.with_name(f"{path.stem}{suffix}.json") for path in paths[:most_frames])
            yield FrameList(name, _frames(out, files))


def _frames(out: Path, files: Iterator[Path]) -> Iterator[ReadFrame]:
    for path in files:
        frame = parse(read_text(path), str(path))
        image, *others = (f"{ROOT}/{camera.image}" for camera in frame.cameras.values())
        problems = tuple(_image_problems(out, others))
        yield ReadFrame(str(path.relative_to(out)), str(path), image, (frame, problems), tuple(others))


def _image_problems(out: Path, images: list[str]) -> Iterator[str]:
    for image in images:
        try:
            image_size(out / image)
        except FormatError as error:
            yield f"expected the image {image}: {error}"


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Cameras in pixels; lanes in metres, in the world frame; boundaries by their side and distance; what follows
    what."""
    found, problems = frame.content
    graph = truth.labels.graph
    found_lanes = found.annotation.lanes
    ids, world_from_ego = [lane.id for lane in found_lanes], found.pose.matrix
    numbers = [i % NEXT_PART for i in ids]
    if any(i >= len(graph.segments) for i in numbers) or len({*ids}) < len(ids):
        text = f"expected ids of their own, those of {len(graph.segments)} segments, got {ids}"
        return Comparison(problems=(*problems, text))
    names = [graph.segments[i].id for i in numbers]
    cameras = (picture.labels.camera for picture in truth.moment)
    by_name = {name: camera for camera in cameras if (name := _name(camera)) in found.cameras}
    behind_m = AHEAD_M if any(_looks_back(camera, world_from_ego) for camera in by_name.values()) else 0.0

    def is_in_area(points_world: Float[np.ndarray, "n 3"]) -> np.ndarray:
        x, y, _ = transform(invert(world_from_ego), points_world).T
        return np.asarray((x > BORDER_M - behind_m) & (x < AHEAD_M - BORDER_M) & (np.abs(y) < ASIDE_M - BORDER_M))

    lanes = []
    for i, (lane, name) in enumerate(zip(found_lanes, names, strict=True)):
        middle, *edges = (transform(world_from_ego, line) for line in lane.lines)
        after = [str(ids[j]) for j, follows in enumerate(found.annotation.follows[i]) if follows]
        sides = dict(zip(("left", "right"), edges, strict=False))
        lanes.append(FoundLane(str(lane.id), name, middle, sides, lane.paint, after))
    elements = _element_problems(found, names, truth.labels.traffic_elements or ())
    compared = compare_lanes(lanes, truth, RULE, is_in_area=is_in_area) + _compared_cameras(found, by_name)
    return compared.because([*problems, *elements])


def _compared_cameras(found: TopologyFrame, cameras: dict[str, CameraLabel]) -> Comparison:
    """How far places that cameras see are from their pixels."""
    compared = Comparison()
    for name, camera in cameras.items():
        theirs = found.cameras[name]
        cv_from_cam = invert(found.pose.matrix @ theirs.extrinsic.matrix) @ camera.world_from_cam
        compared += compare_pinhole(name, camera, theirs.intrinsic.K, cv_from_cam, LIMIT_PX)
    unknown = (f"camera {name}: expected one of the labels, got none" for name in found.cameras if name not in cameras)
    return compared.because(unknown)


def _element_problems(found: TopologyFrame, names: list[str], items: Sequence[ObjectLabel]) -> Iterator[str]:
    """Findings about traffic elements that are not those of the labels, or govern other lanes than these say."""
    elements, ids = found.annotation.elements, [lane.id for lane in found.annotation.lanes]
    ours, there = {item.id: item for item in items}, [element.id for element in elements]
    if len({*there, *ids}) < len(there) + len(ids):
        yield f"traffic elements: expected ids of their own, got {there}"
    for id_, item in ours.items():
        if is_clear(item) and id_ not in there:
            yield f"traffic element {id_}: expected it, because {item.visible_fraction:.0%} of it are seen, got none"
    for j, element in enumerate(elements):
        own = ours.get(element.id)
        if own is None or own.box_px is None:
            yield f"traffic element {element.id}: expected one of the labels in the image, got another"
            continue
        codes, expected = (element.category, element.attribute), category_and_attribute(own)
        if codes != expected:
            yield f"traffic element {element.id}: expected category and attribute {expected}, got {codes}"
        off_px = float(np.abs(np.ravel(element.points) - own.box_px).max())
        if not off_px <= BOX_PX:
            yield f"traffic element {element.id}: expected its rectangle within {BOX_PX} px, got it {off_px:.1f} px off"
        for i, lane in enumerate(names):
            if bool(found.annotation.governs[i][j]) != (lane in own.lanes):
                words = ("it to govern", "got it not to") if lane in own.lanes else ("it not to govern", "got it to")
                yield f"traffic element {element.id}: expected {words[0]} {lane}, {words[1]}"


def is_clear(item: ObjectLabel) -> bool:
    """Whether an element must be in an export: the first camera sees most of it, from its front, and not too small."""
    if item.box_px is None or item.visible_fraction is None or item.visible_fraction < CLEAR_SHARE:
        return False
    width_px, height_px = item.box_px[2:] - item.box_px[:2]
    away_m = float(np.linalg.norm(item.center_cam))
    return min(width_px, height_px) >= CLEAR_PX and bool(item.normal_cam @ item.center_cam < -CLEAR_COS * away_m)


FORMAT = SampleFormat(
    title="OpenLane-V2: lanes as a map, and which follows which",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    tolerances={RULE.unit: RULE.limit, "px": LIMIT_PX},
    document=document,
    counted="lane segments",
)
