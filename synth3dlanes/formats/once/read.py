"""Read ONCE-3DLanes: one label file as plain arrays."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.system import schema
from synth3dlanes.system.json_arrays import JsonPoints, Row4
from synth3dlanes.system.schema import Excerpt, Number


@dataclass(frozen=True, eq=False)
class OnceFrame:
    """One label file. The camera's height and pitch are in our exports alone."""

    lanes_cv: tuple[Float[np.ndarray, "_ 3"], ...]
    img_from_cv: Float[np.ndarray, "3 4"]
    camera_height_m: float | None
    camera_pitch_rad: float | None


class _Frame(Excerpt):
    lanes: list[JsonPoints]
    calibration: tuple[Row4, Row4, Row4]
    camera_height_m: Number | None = None
    camera_pitch_rad: Number | None = None


def parse(text: str, where: str) -> OnceFrame:
    """One label file; FormatErrors begin with `where`."""
    found = schema.parse(_Frame, text, where, "a frame of ONCE-3DLanes")
    calibration = np.array(found.calibration)
    return OnceFrame(tuple(found.lanes), calibration, found.camera_height_m, found.camera_pitch_rad)
