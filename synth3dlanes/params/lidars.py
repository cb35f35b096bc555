"""A user's own lidar: its beams, each at its elevation, and its place on the host, as of a camera (docs/lidar.md).

Metres and degrees. The place is relative to the host's own on the road: x right, y forward, z up.
"""

from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, field_validator

from synth3dlanes.params.cameras import ZERO, Angle, Mount
from synth3dlanes.params.distributions import Real, reals
from synth3dlanes.params.groups import Group
from synth3dlanes.scene.host import MAX_BEAMS
from synth3dlanes.system.schema import MAX_PX, Name

# The largest elevation in degrees: no beam points straight up or down.
MAX_DEG = 85.0


def _spread(form: Any) -> Any:
    """`{beams: 32, top: 10.67, bottom: -30.67}` as the elevations of evenly spaced beams."""
    if not isinstance(form, dict):
        return form
    try:
        n, top, bottom = int(form["beams"]), float(form["top"]), float(form["bottom"])
    except (KeyError, TypeError, ValueError, OverflowError):
        n = top = bottom = 0
    if len(form) != 3 or not 1 < n <= MAX_BEAMS or not -MAX_DEG <= bottom < top <= MAX_DEG:
        raise ValueError(f"expected a list of degrees, or beams (2 to {MAX_BEAMS}), top and bottom")
    return np.round(np.linspace(top, bottom, n), 9).tolist()


Elevation = Annotated[float, Field(ge=-MAX_DEG, le=MAX_DEG)]


class LidarSpec(Group):
    """A lidar on the host. Names are as in `scene.json`, with degrees instead of radians."""

    name: Name = ""
    elevations_deg: Annotated[
        tuple[Elevation, ...], Field(min_length=1, max_length=MAX_BEAMS), BeforeValidator(_spread)
    ]
    azimuths: Annotated[int, Field(ge=16, le=MAX_PX)]
    min_range_m: Annotated[float, Field(ge=0, le=1000)] = 1.0
    max_range_m: Annotated[float, Field(gt=0, le=1000)]
    height_m: Annotated[Real, reals(0.3, 10)]
    right_m: Mount = ZERO
    forward_m: Mount = ZERO
    yaw_deg: Angle = ZERO
    pitch_deg: Angle = ZERO
    roll_deg: Angle = ZERO

    @field_validator("elevations_deg")
    @classmethod
    def _from_the_top(cls, elevations_deg: tuple[float, ...]) -> tuple[float, ...]:
        """Sort the beams; raise ValueError if two are at one elevation."""
        if len(set(elevations_deg)) < len(elevations_deg):
            raise ValueError("expected each elevation once")
        return tuple(sorted(elevations_deg, reverse=True))
