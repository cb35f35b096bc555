"""CurveLanes' camera and parts. Lines are 2D points from the bottom up, pixels."""

from synth3dlanes.formats.band_score import Canvas
from synth3dlanes.formats.writing import Pinhole

CAMERA = Pinhole(2560, 1440, 2217.0, below_px=114.0)
"""Ours: the original has no intrinsics. 60 degrees wide, the horizon in row 640 or below for a pitch of 5 degrees:
CondLaneNet cuts off what is above."""
ROW_STEP_PX = 10
EVALUATED = Canvas(224, 224, 5, 0.5)
"""Lines are scaled to this size to be scored."""
FINER = Canvas(CAMERA.width_px, CAMERA.height_px, 30, 0.5)
"""Shows a move of 2 m far ahead, too, where it is less than a band in the small image."""
