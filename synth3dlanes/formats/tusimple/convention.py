"""tuSimple's camera and the rows at which it samples lines. Lines are 2D: one column (x) per row, no 3D."""

import numpy as np

from synth3dlanes.formats.writing import Pinhole

CAMERA = Pinhole(1280, 720, 2015.0 * 2 / 3)
ROWS_PX = np.arange(160, 720, 10)
ABSENT = -2
