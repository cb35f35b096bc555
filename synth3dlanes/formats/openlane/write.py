"""Write OpenLane v1: one JSON a frame, points in the camera frame with Waymo's axes (`_waymo`), image 1920x1280."""

import json
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from synth3dlanes.formats.lines import LaneAhead, ego_places, keep_lines, lines_ahead
from synth3dlanes.formats.openlane.convention import (
    CASES,
    KERB_LEFT,
    KERB_RIGHT,
    PAINTS,
    WAYMO_FROM_CAM,
    vehicle_from_cam_waymo,
)
from synth3dlanes.formats.writing import CV_FROM_CAM, DECIMALS, FrameAnnotation, PinholeFrame
from synth3dlanes.labels.labels import Lane

MAX_LINES = 20
MIN_LENGTH_M = 5.0
STEP_M = 0.5
FRAMES_PER_SEGMENT = 100
UV_DECIMALS = 4
README = """OpenLane v1 layout.

- `images/{training,validation}/segment-*_with_camera_labels/`. Loaders assume 1920x1280 unless they are told another
  size. Intrinsics per frame: c in the middle of the image (pixel corners at whole numbers); f = 2015 for a width of
  1920, or longer where the frame's own field of view is narrower than that.
- `lane3d_1000/{training,validation}/segment-*/`: one JSON a frame, on one line. Test frames are in `validation`, or in
  `test` beside the cases where the data set has val frames too.
- Lists: `lists/*.txt`, and `data_lists/*.txt` for Anchor3DLane; `lane3d_1000/test/1000_*.txt` with copies of the labels
  in `lane3d_1000/test/*_case/`. docs/exports.md has the rules by which a frame is in them.
- `xyz`: 3 x n, metres, camera frame with Waymo axes (x forward, y left, z up), every 0.5 m or closer, near to far
  from the image border. `extrinsic`: vehicle_from_camera in the same axes, the vehicle's origin at the camera's foot
  on the road plane. `uv`: exact projections of the visible points, in their order.
- `visibility` is a prefix: terrain hides lanes, cars do not. `category`: 1 white dashed, 2 white solid, 3 and 4 the
  same doubled, 5 and 6 double with the left or the right stripe dashed and the other solid, 7 to 12 the same six in
  yellow, 20 and 21 kerbs on the left and right. `attribute`: 1 to 4 = the lines left-left, left, right, right-right of
  the camera, 0 all others.
- A clip of one camera is a segment, in which a line keeps its `track_id`. Single pictures are scenes of their own, 100
  of them in a segment: no id occurs in two of them.
- Centre lines are not part of the format. PersFormer caches `.cache/*.pkl` by name: delete it after exporting again.
"""


def annotate(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's label file, copies for the test cases that it belongs to, and its list entries."""
    labels, dropped = frame.labels, Counter[str]()
    folder = "training" if frame.is_train else "validation" if frame.serves_as("val") else "test"
    segment, track_ids = _segment(frame)
    # Loaders look for "/segment-(.*)_with_camera_labels"; they cut at the first dot and replace every "jpg".
    name = f"segment-{segment}_with_camera_labels/{frame.split}-{frame.key}"
    file_path = f"{folder}/{name}.jpg"
    ahead = lines_ahead(labels, frame.pinhole, "delimiter", STEP_M)
    kerbs = lines_ahead(replace(labels, lanes=frame.kerbs), frame.pinhole, "delimiter", STEP_M)
    lines = _kept((*ahead, *kerbs), dropped)
    attributes = ego_places(ahead, labels.camera)
    document = {
        "extrinsic": np.round(vehicle_from_cam_waymo(labels.camera.height_m, labels.camera.pitch_rad), 12).tolist(),
        "intrinsic": frame.pinhole.img_from_cv.tolist(),
        "lane_lines": [
            _line_document(line, frame, attributes.get(line.id, 0), track_ids(i, line.id))
            for i, line in enumerate(lines)
        ],
        "file_path": file_path,
    }
    text = json.dumps(document)
    files, listed = {f"lane3d_1000/{folder}/{name}.json": text}, [f"lists/{folder}.txt"]
    for case in [case for case in CASES if case in frame.tags and not frame.is_train]:
        files[f"lane3d_1000/test/{case}_case/{name}.json"] = text
        listed.append(f"lane3d_1000/test/{CASES[case]}")
    # Anchor3DLane has no cache of training frames without lanes.
    cached = (f"data_lists/{folder}.txt",) if lines or not frame.is_train else ()
    shared = ((file_path, tuple(sorted(listed))), (f"{folder}/{name}", cached))
    return FrameAnnotation(f"images/{file_path}", len(lines), dropped, files, shared)


def _segment(frame: PinholeFrame) -> tuple[str, Callable[[int, str], int]]:
    """The name of the frame's segment, and the track of line i, of this id, in it."""
    if frame.clip is not None:
        return f"{frame.clip:08d}", lambda _, line_id: zlib.crc32(line_id.encode()) >> 1
    segment, place = divmod(frame.number, FRAMES_PER_SEGMENT)
    return f"{segment:06d}", lambda i, _: place * (MAX_LINES + 1) + i + 1


def category(lane: Lane) -> int:
    """The number of the line's paint, 0 if unknown. Older labels have no colour: their lines count as single and
    white."""
    paint = (lane.marking, lane.color or "white", bool(lane.double), lane.pair)
    return next((number for number, other in PAINTS.items() if other == paint), 0)


def _kept(ahead: tuple[LaneAhead, ...], dropped: Counter[str]) -> tuple[LaneAhead, ...]:
    kept = []
    for line in ahead:
        entered = np.flatnonzero(line.in_view & line.visible)
        line = line.part(slice(int(entered[0]), None)) if len(entered) else line
        length_m = np.linalg.norm(np.diff(line.points_cv[line.visible], axis=0), axis=1).sum()
        if len(entered) and length_m < MIN_LENGTH_M:
            dropped[f"its visible part is shorter than {MIN_LENGTH_M:g} m (Anchor3DLane drops those)"] += 1
        else:
            kept.append(line)
    return keep_lines(kept, dropped, MAX_LINES, f"beyond the {MAX_LINES} nearest (Anchor3DLane drops such frames)")


def _line_document(line: LaneAhead, frame: PinholeFrame, attribute: int, track_id: int) -> dict[str, Any]:
    points_cv = np.round(line.points_cv, DECIMALS)
    kerb = KERB_LEFT if line.points_cv[0, 0] < 0 else KERB_RIGHT
    return {
        "category": kerb if line.lane in frame.kerbs else category(line.lane),
        "visibility": line.visible.astype(float).tolist(),
        "uv": np.round(frame.pinhole.project(points_cv[line.visible]), UV_DECIMALS).T.tolist(),
        "xyz": (points_cv @ CV_FROM_CAM @ WAYMO_FROM_CAM.T + 0.0).T.tolist(),
        "attribute": attribute,
        "track_id": track_id,
    }
