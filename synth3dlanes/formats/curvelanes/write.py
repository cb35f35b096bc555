"""Write CurveLanes: one JSON a frame with all lines in 2D, image 2560x1440."""

import json
from collections import Counter

import numpy as np

from synth3dlanes.formats.curvelanes.convention import ROW_STEP_PX
from synth3dlanes.formats.curvelanes.read import labels_path
from synth3dlanes.formats.lines import LaneAhead, columns_of, keep_lines, lines_ahead
from synth3dlanes.formats.sidecar import sidecar
from synth3dlanes.formats.writing import FrameAnnotation, Pinhole, PinholeFrame

MIN_POINTS = 2
DECIMALS = 2

README = """CurveLanes layout.

- `{train,valid,test}/images/*.jpg`, `{train,valid,test}/labels/*.lines.json` and the lists `train/train.txt`,
  `valid/valid.txt`, `test/test.txt`. Test frames are in `valid`, or in `test` where the data set has val frames too;
  those of the original have no labels. CondLaneNet takes images of 2560x1440, 1570x660 and 1280x720 alone.
- `Lines`: all delimiters, as points with `x` and `y` (text), from the bottom up, every 10 rows. A line ends where it
  would come back to a row that it has crossed. Terrain hides lines, cars do not.
- Pixel corners are at whole numbers. `sidecar.jsonl` holds the camera of each frame, its height over the road and its
  pitch (radians, positive = down). f is longer where the frame's own field of view is narrower than that of the others.
"""


def annotate(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's label file and its list entry."""
    labels, dropped = frame.labels, Counter[str]()
    part = "train" if frame.is_train else "valid" if frame.serves_as("val") else "test"
    image = f"{part}/images/{frame.split}_{frame.key}.jpg"
    ahead = lines_ahead(labels, frame.pinhole, "delimiter")
    points = {line.id: _points(line, frame.pinhole) for line in ahead}
    crossing = [line for line in ahead if len(points[line.id]) >= MIN_POINTS]
    if len(crossing) < len(ahead):
        dropped[f"its visible part crosses fewer than {MIN_POINTS} rows"] += len(ahead) - len(crossing)
    kept = keep_lines(crossing, dropped)
    text = json.dumps({"Lines": [points[line.id] for line in kept]})
    shared = (
        (image.partition("/")[2], (f"{part}/{part}.txt",)),
        sidecar(image, frame, [line.id for line in kept]),
    )
    return FrameAnnotation(image, len(kept), dropped, {labels_path(image): text}, shared)


def _points(line: LaneAhead, pinhole: Pinhole) -> list[dict[str, str]]:
    rows_px = np.arange(pinhole.height_px, -1, -ROW_STEP_PX)
    columns_px = columns_of(line, pinhole, rows_px)
    inside = (columns_px >= 0) & (columns_px < pinhole.width_px)
    pixels = zip(columns_px[inside].tolist(), rows_px[inside].tolist(), strict=True)
    return [{"y": f"{y:.{DECIMALS}f}", "x": f"{x:.{DECIMALS}f}"} for x, y in pixels]
