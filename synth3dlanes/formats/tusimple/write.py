"""Write tuSimple: JSON lines, 2D points by image row (x per row, -2 = absent), image 1280x720. No 3D."""

import json
from collections import Counter

import numpy as np
from jaxtyping import Int

from synth3dlanes.formats.lines import LaneAhead, columns_of, keep_lines, lines_ahead
from synth3dlanes.formats.sidecar import sidecar
from synth3dlanes.formats.tusimple.convention import ABSENT, ROWS_PX
from synth3dlanes.formats.writing import FrameAnnotation, Pinhole, PinholeFrame

MAX_LINES = 5
TEST_LABELS, TEST_TASKS = "test_label.json", "test_tasks_0627.json"
LABEL_FILES = ("label_data_0313.json", "label_data_0531.json", "label_data_0601.json", TEST_LABELS, TEST_TASKS)

README = """tuSimple layout.

- `clips/<split>/<key>/20.jpg`, 1280x720. Label files are JSON lines with `raw_file`, `h_samples` (rows 160 to 710,
  every 10) and `lanes` (x per row in whole pixels, -2 = absent).
- `label_data_0313.json`, `label_data_0601.json`: training frames. `label_data_0531.json`: val frames where there are
  test frames beside them, else training frames (keys ending in 7; those ending in 2 are in 0601).
  `test_label.json`: test frames, or val frames where there are no test frames; `test_tasks_0627.json` names them.
- One to five lines a frame, the nearest to the camera (the official accuracy fails on none and exceeds 1 on more);
  a line ends where it would come back to a row that it has crossed. Frames without lines are left out.
- Terrain hides lines, cars do not. `sidecar.jsonl` holds the camera (f = 1343.3, c = (640, 360)), its height over
  the road and its pitch (radians, positive = down). f is longer where the frame's own field of view is narrower
  than that of the others.
"""


def annotate(frame: PinholeFrame) -> FrameAnnotation | None:
    """The frame's label line; None for a frame without lines, which the benchmark cannot score."""
    labels, dropped = frame.labels, Counter[str]()
    raw_file = f"clips/{frame.split}/{frame.key}/20.jpg"
    rows = [(line, rows_of(line, frame.pinhole)) for line in lines_ahead(labels, frame.pinhole, "delimiter")]
    crossing = [line for line, u_px in rows if np.count_nonzero(u_px != ABSENT) >= 2]
    if len(crossing) < len(rows):
        dropped["its visible part crosses fewer than two rows of the image"] += len(rows) - len(crossing)
    kept = keep_lines(crossing, dropped, MAX_LINES, f"beyond the {MAX_LINES} nearest (the score exceeds 1 with more)")
    if not kept:
        return None
    lanes = [rows_of(line, frame.pinhole).tolist() for line in kept]
    document = {"lanes": lanes, "h_samples": ROWS_PX.tolist(), "raw_file": raw_file}
    task = {"raw_file": raw_file, "h_samples": ROWS_PX.tolist(), "lanes": []}
    file = label_file(frame)
    shared = (
        (json.dumps(document), (file,)),
        sidecar(raw_file, frame, [line.id for line in kept]),
        (json.dumps(task), (TEST_TASKS,) if file == TEST_LABELS else ()),
    )
    return FrameAnnotation(raw_file, len(kept), dropped, shared=shared)


def label_file(frame: PinholeFrame) -> str:
    """Tools train on 0313 and 0601, and on 0531 or validate on it; training frames are dealt to the three as in the
    original, where 8 of 10 are in 0313. With splits val and test of its own a data set has val in 0531."""
    if frame.serves_as("test"):
        return TEST_LABELS
    if frame.part == "val":
        return "label_data_0531.json"
    dealt = {2: "0601"} if frame.parts >= {"val", "test"} else {2: "0601", 7: "0531"}
    return f"label_data_{dealt.get(int(frame.key) % 10, '0313')}.json"


def rows_of(line: LaneAhead, pinhole: Pinhole) -> Int[np.ndarray, " r"]:
    """The line's column at each row, ABSENT where it has none in the image."""
    columns_px = np.rint(columns_of(line, pinhole, ROWS_PX))
    return np.where((columns_px >= 0) & (columns_px < pinhole.width_px), columns_px, ABSENT).astype(int)
