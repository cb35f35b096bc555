"""CULane's camera, rows and lists. Lines are 2D: one column (x) per row, from the bottom up."""

import numpy as np

from synth3dlanes.formats.band_score import Canvas
from synth3dlanes.formats.writing import Pinhole

CAMERA = Pinhole(1640, 590, 1420.3, below_px=69.0)
"""Ours: the original has no intrinsics. 60 degrees wide, the horizon in row 240 or below for a pitch of 5 degrees."""
ROWS_PX = np.arange(590, 240, -10)
"""Rows of labels; UFLD v2's cache has these alone, and anchors of UFLD and CLRNet begin at rows 248 and 270."""
MAX_LINES = 4
EVALUATED = Canvas(1640, 590, 30, 0.5)
MASK_WIDTH_PX = 16
MASKS = "laneseg_label_w16"
SCENES = ("normal", "crowd", "hlight", "shadow", "noline", "arrow", "curve", "cross", "night")
"""The original's kinds of test scenes, in the order of their lists."""


KINDS = ("night", "noline", "hlight", "cross", "crowd", "arrow", "shadow", "curve")
"""Every test frame is in one list: that of the first kind that holds, else `normal`."""
TAGS = {"cross": "intersection"}
"""What we call kinds of another name."""


def scene_of(tags: frozenset[str]) -> str:
    """The kind of test scene that a frame with these tags is."""
    return next((kind for kind in KINDS if TAGS.get(kind, kind) in tags), "normal")


def scene_list(scene: str) -> str:
    """The list of the test frames of a kind of scene."""
    return f"list/test_split/test{SCENES.index(scene)}_{scene}.txt"
