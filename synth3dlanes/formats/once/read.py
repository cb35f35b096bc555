"""Read ONCE-3DLanes: one label file as plain arrays."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.reading import MALFORMED, json_object


@dataclass(frozen=True, eq=False)
class OnceFrame:
    """One label file. The camera's height and pitch are in our exports alone."""

    lanes_cv: tuple[Float[np.ndarray, "_ 3"], ...]
    img_from_cv: Float[np.ndarray, "3 4"]
    camera_height_m: float | None
    camera_pitch_rad: float | None


def parse(text: str, where: str) -> OnceFrame:
    """One label file; FormatErrors begin with `where`."""
    document = json_object(text, where)
    try:
        return OnceFrame(
            tuple(np.array(points, dtype=float).reshape(-1, 3) for points in document["lanes"]),
            np.array(document["calibration"], dtype=float).reshape(3, 4),
            document.get("camera_height_m"),
            document.get("camera_pitch_rad"),
        )
    except MALFORMED as error:
        raise FormatError(f"{where}: not a ONCE frame: {type(error).__name__}: {error}") from None
