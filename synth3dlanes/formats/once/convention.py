"""ONCE-3DLanes' camera and folder. Points are in the OpenCV camera frame (`_cv`), metres, far to near."""

from synth3dlanes.formats.writing import Pinhole

CAMERA = Pinhole(1920, 1020, 958.0)
"""About the cameras of the original; every label file carries its own intrinsics."""
ROOT = "ONCE_3DLanes"
