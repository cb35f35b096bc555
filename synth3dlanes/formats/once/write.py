"""Write ONCE-3DLanes: one JSON a frame, points in the OpenCV camera frame (`_cv`), far to near, image 1920x1020."""

import json
from collections import Counter

import numpy as np

from synth3dlanes.formats.lines import LaneAhead, keep_lines, lines_ahead
from synth3dlanes.formats.once.convention import ROOT
from synth3dlanes.formats.writing import DECIMALS, PARTS, FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.labels.labels import Labels

MAX_LINES = 8
RASTER_DEPTH_M = 10.0
RASTER_HALF_WIDTH_M = 10.0
FRAMES_PER_SEQUENCE = 1000

README = f"""ONCE-3DLanes layout.

- `{ROOT}/{{train,val,test}}/<seq>/cam01/*.json`, images in `{ROOT}/data/<seq>/cam01/*.jpg`. Loaders assume 1920x1020
  unless they are told another size. Where the data set has only one of val and test, its frames are in both folders:
  some tools open the one, some the other.
- Tools replace "train", "val" or "test" by "data" in the WHOLE path: keep these words out of the folders above.
- `lanes`: points in the camera frame x right, y down, z forward, metres, far to near. `calibration`: 3x4, one for each
  frame: c in the middle of the image (pixel corners at whole numbers); f = 958 for a width of 1920 as in the original,
  or longer where the frame's own field of view is narrower than that.
- The format has no extrinsics; loaders assume 1.5 m and 0.5 or 0.3 degrees. The true values are in the extra keys
  `camera_height_m` and `camera_pitch_rad` (positive = down).
- The official evaluator assigns lines by what lies within 10 m ahead and 10 m to the side. So lines keep their
  stretch below the image. Lines without a part there come last: it pairs those in the order of the list.
- `annotations`, `raw_data` (links) and `data_lists` are for Anchor3DLane.
"""


def annotate(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's label file."""
    labels, dropped = frame.labels, Counter[str]()
    parts = [part for part in PARTS if frame.serves_as(part)]
    name = f"{frame.number // FRAMES_PER_SEQUENCE:06d}/cam01/{frame.number:08d}"
    lines = _kept(labels, frame.pinhole, dropped)
    document = {
        "lane_num": len(lines),
        "lanes": [np.round(line.points_cv[line.visible][::-1], DECIMALS).tolist() for line in lines],
        "calibration": np.column_stack([frame.pinhole.img_from_cv, np.zeros(3)]).tolist(),
        "camera_height_m": labels.camera.height_m,
        "camera_pitch_rad": labels.camera.pitch_rad,
        "source": f"{frame.split}/{frame.key}",
    }
    text = json.dumps(document)
    files = {f"{ROOT}/{part}/{name}.json": text for part in parts}
    # Anchor3DLane has no cache of training frames without lanes.
    shared = (
        (name, tuple(f"{ROOT}/list/{part}.txt" for part in parts)),
        (f"{name}.jpg", tuple(f"data_lists/{part}.txt" for part in parts) if lines or not frame.is_train else ()),
    )
    return FrameAnnotation(f"{ROOT}/data/{name}.jpg", len(lines), dropped, files, shared)


def _kept(labels: Labels, pinhole: Pinhole, dropped: Counter[str]) -> tuple[LaneAhead, ...]:
    lines = sorted(lines_ahead(labels, pinhole, "delimiter"), key=lambda line: not _is_rastered(line))
    return keep_lines(lines, dropped, MAX_LINES, f"beyond the {MAX_LINES} nearest (cap of Anchor3DLane)")


def _is_rastered(line: LaneAhead) -> bool:
    x_m, _, z_m = line.points_cv[line.visible].T
    return np.count_nonzero((z_m < RASTER_DEPTH_M) & (np.abs(x_m) < RASTER_HALF_WIDTH_M)) >= 2
