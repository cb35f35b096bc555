"""Write OpenLane-V2: two JSONs a frame, centre lines and lane segments, in the vehicle frame (`_ego`)."""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.formats.format import SampleFrame
from synth3dlanes.formats.lane_map import REACH_M, Boundary, LaneSegment, lane_segments
from synth3dlanes.formats.openlane_v2.convention import (
    AHEAD_M,
    ASIDE_M,
    CENTERLINE_POINTS,
    COLLECTIONS,
    FRONT_CAMERA,
    LEAST_PX,
    LEAST_SEEN,
    LINE_TYPES,
    NEXT_PART,
    PEDESTRIAN_CROSSING,
    POINTS,
    ROAD_BOUNDARY,
    ROAD_FROM_EGO,
    ROOT,
    category_and_attribute,
    collection,
)
from synth3dlanes.formats.writing import CV_FROM_CAM, PARTS, FrameAnnotation
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.polylines import resampled, stretches
from synth3dlanes.labels.element_labels import ElementLabel
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.errors import InputError
from synth3dlanes.world.world import World, resolve

DECIMALS = 4
LEAST_LENGTH_M = 2.0
SHORT = f"less than {LEAST_LENGTH_M:g} m of it in the area"
OUTSIDE = f"outside the area ({AHEAD_M:g} m ahead, {ASIDE_M:g} m to each side)"

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


def annotate(frame: SampleFrame) -> FrameAnnotation | None:
    """The two label files of a moment, with its first picture; None without any lane in the area."""
    if not frame.labels.camera.lens.is_pinhole:
        raise InputError(
            f"{frame.split}:{frame.key}: expected a camera without distortion, got {frame.labels.camera.lens}"
        )
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
    topology = _topology(lanes, frame.labels.graph.successors)
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
        "pose": _pose(world_from_ego),
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
    parts = [part for part in PARTS if frame.serves_as(part)]
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


def _pose(world_from_ego: Matrix4) -> dict[str, Any]:
    return {"rotation": world_from_ego[:3, :3].tolist(), "translation": world_from_ego[:3, 3].tolist()}


def _lanes(
    frame: SampleFrame, world: World, world_from_ego: Matrix4, behind_m: float, dropped: Counter[str]
) -> list[_Lane]:
    ego_from_world, lanes = invert(world_from_ego), []
    for segment in lane_segments(world, frame.labels.graph.segments, world_from_ego[:3, 3]):
        middle_ego = transform(ego_from_world, segment.points_world)
        inside = list(stretches(_in_area(middle_ego, behind_m)))
        parts = [ends for ends in inside if _length_m(middle_ego[slice(*ends)]) >= LEAST_LENGTH_M]
        if not parts:
            dropped[SHORT if inside else OUTSIDE] += 1
        for number, (first, last) in enumerate(parts):
            left_ego, right_ego = (
                transform(ego_from_world, side.points_world[first:last]) for side in (segment.left, segment.right)
            )
            is_whole = first == 0, last == len(middle_ego)
            id_ = segment.index + number * NEXT_PART
            lanes.append(_Lane(id_, segment, middle_ego[first:last], left_ego, right_ego, *is_whole))
    return lanes


def _in_area(points_ego: Float[np.ndarray, "n 3"], behind_m: float) -> Bool[np.ndarray, " n"]:
    x_m, y_m, _ = points_ego.T
    return np.asarray((x_m >= -behind_m) & (x_m <= AHEAD_M) & (np.abs(y_m) <= ASIDE_M))


def _topology(lanes: Sequence[_Lane], successors: dict[str, tuple[str, ...]]) -> list[list[int]]:
    return [
        [int(b.segment.id in successors.get(a.segment.id, ()) and a.has_end and b.has_start) for b in lanes]
        for a in lanes
    ]


def _is_seen(item: ElementLabel) -> bool:
    """Whether the first camera sees the front of an element, and enough of it."""
    if item.box_px is None or item.normal_cam @ item.center_cam >= 0:
        return False
    is_large = min(item.box_px[2:] - item.box_px[:2]) >= LEAST_PX
    return bool(is_large) and (item.visible_fraction is None or item.visible_fraction >= LEAST_SEEN)


def _element_document(item: ElementLabel) -> dict[str, Any]:
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
        ("left", lane.left_ego, lane.segment.left),
        ("right", lane.right_ego, lane.segment.right),
    ):
        document |= _side_document(f"{name}_laneline", points_ego, side)
    return document


def _side_document(name: str, points_ego: Float[np.ndarray, "n 3"], side: Boundary) -> dict[str, Any]:
    return {
        name: _rounded(resampled(points_ego, POINTS)),
        f"{name}_type": LINE_TYPES[side.marking],
        f"{name}_color": side.color,
        f"{name}_double": side.double,
    }


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
    for edge_world in world.ground.pavement_edges(world_from_ego[:2, 3], REACH_M):
        edge_ego = transform(ego_from_world, edge_world)
        for first, end in stretches(_in_area(edge_ego, behind_m)):
            run = edge_ego[first:end]
            if _length_m(run) >= LEAST_LENGTH_M:
                yield {"id": index, "category": ROAD_BOUNDARY, "points": _rounded(resampled(run, POINTS))}
                index += 1


def _length_m(points: Float[np.ndarray, "n 3"]) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _rounded(points: Float[np.ndarray, "n 3"]) -> list[list[float]]:
    return np.asarray(np.round(points, DECIMALS) + 0.0).tolist()


def document(path: str, lines: Path) -> Iterator[str]:
    """The frames of each part by segment, as the devkit's `collect` takes them."""
    frames: dict[str, dict[str, list[str]]] = {}
    for line in lines.read_text().splitlines():
        part, segment, name = json.loads(line)
        frames.setdefault(part, {}).setdefault(segment, []).append(name)
    yield json.dumps(frames, indent=1) + "\n"
