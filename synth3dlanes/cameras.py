"""A user's own camera: its image and its place on the host, each a value or a range.

Pixels, metres and degrees. The place is relative to the host's own on the road: x right, y forward, z up.
"""

from typing import Annotated

from synth3dlanes.distributions import Choice, Integer, Real, Uniform, integers, reals
from synth3dlanes.params import Group
from synth3dlanes.schema import AHEAD_DEG, MAX_PX, Name

Angle = Annotated[Real, reals(-180, 180)]
Mount = Annotated[Real, reals(-10, 10)]
Focal = Annotated[Real, reals(0, 1e5, above=True)]
ZERO = Choice((0.0,), (1.0,))


class CameraSpec(Group):
    """A camera on the host. Names are as in `scene.json`, with degrees instead of radians."""

    name: Name = ""
    width_px: Annotated[Integer, integers(16, MAX_PX)]
    height_px: Annotated[Integer, integers(16, MAX_PX)]
    fx_px: Focal
    fy_px: Focal
    cx_px: Annotated[Real, reals(-1e5, 1e5)]
    cy_px: Annotated[Real, reals(-1e5, 1e5)]
    height_m: Annotated[Real, reals(0.3, 10)]
    right_m: Mount = ZERO
    forward_m: Mount = ZERO
    yaw_deg: Angle = ZERO
    pitch_deg: Angle = ZERO
    roll_deg: Angle = ZERO

    @property
    def looks_ahead(self) -> bool:
        """Whether it looks where the host drives at every yaw that it may have."""
        yaw = self.yaw_deg
        yaws_deg = (yaw.low, yaw.high) if isinstance(yaw, Uniform) else yaw.values
        return all(abs(yaw_deg) <= AHEAD_DEG for yaw_deg in yaws_deg)
