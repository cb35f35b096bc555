"""A user's own camera: its image, its lens and its place on the host, each a value or a range.

Pixels, metres and degrees. The place is relative to the host's own on the road: x right, y forward, z up.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from typing import Annotated, Any

import numpy as np
from pydantic import model_validator

from synth3dlanes.geometry.lens import COEFFICIENTS, MAX_COEFFICIENT, MAX_TILT_RAD, PRISM_AND_TILT, Lens, LensModel
from synth3dlanes.params.distributions import Choice, Distribution, Integer, Real, Uniform, integers, reals
from synth3dlanes.params.groups import Group, left_out_at
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import AHEAD_DEG, MAX_PX, Name

Angle = Annotated[Real, reals(-180, 180)]
Mount = Annotated[Real, reals(-10, 10)]
Focal = Annotated[Real, reals(1, 1e5)]
Center = Annotated[Real, reals(-1e5, 1e5)]
Fov = Annotated[Real, reals(1, 359)]
Coefficient = Annotated[Real, reals(-MAX_COEFFICIENT, MAX_COEFFICIENT)]
Tilt = Annotated[Real, reals(-MAX_TILT_RAD, MAX_TILT_RAD)]
ZERO = Choice((0.0,), (1.0,))
# Without a calibration of the place: in the middle of the host, level.
HEIGHT_M = Choice((1.5,), (1.0,))
NAMES = COEFFICIENTS["opencv"] + PRISM_AND_TILT
EVERY_NAME = tuple(dict.fromkeys(chain(NAMES, *COEFFICIENTS.values())))
# From this half field of view on, a picture shows what is beside the camera.
ASIDE_DEG = 85.0
VALUE_DECIMALS, COEFFICIENT_DECIMALS = 6, 9
# The last place of a range; places along each side of an image where its lens is asked; a share that is told.
LAST, GRID, LEAST_BLACK = 1 - 1e-9, 64, 0.005


class CameraSpec(Group):
    """A camera on the host. Names are as in `scene.json`, with degrees instead of radians.

    Without `fx_px`, `horizontal_fov_deg` gives it: a ray half of that aside meets the image half its width beside the
    principal point. Without `fy_px` it is `fx_px`, without a principal point that is the image's middle.
    """

    name: Name = ""
    width_px: Annotated[Integer, integers(16, MAX_PX)]
    height_px: Annotated[Integer, integers(16, MAX_PX)]
    fx_px: Focal | None = left_out_at(None)
    fy_px: Focal | None = left_out_at(None)
    cx_px: Center | None = left_out_at(None)
    cy_px: Center | None = left_out_at(None)
    horizontal_fov_deg: Fov | None = left_out_at(None)
    height_m: Annotated[Real, reals(0.3, 10)] = HEIGHT_M
    right_m: Mount = ZERO
    forward_m: Mount = ZERO
    yaw_deg: Angle = ZERO
    pitch_deg: Angle = ZERO
    roll_deg: Angle = ZERO
    model: LensModel = left_out_at("pinhole")
    k1: Coefficient = left_out_at(ZERO)
    k2: Coefficient = left_out_at(ZERO)
    p1: Coefficient = left_out_at(ZERO)
    p2: Coefficient = left_out_at(ZERO)
    k3: Coefficient = left_out_at(ZERO)
    k4: Coefficient = left_out_at(ZERO)
    k5: Coefficient = left_out_at(ZERO)
    k6: Coefficient = left_out_at(ZERO)
    s1: Coefficient = left_out_at(ZERO)
    s2: Coefficient = left_out_at(ZERO)
    s3: Coefficient = left_out_at(ZERO)
    s4: Coefficient = left_out_at(ZERO)
    tau_x: Tilt = left_out_at(ZERO)
    tau_y: Tilt = left_out_at(ZERO)
    xi: Annotated[Real, reals(0, MAX_COEFFICIENT)] = left_out_at(ZERO)

    @model_validator(mode="after")
    def _has_one_focal_length(self) -> "CameraSpec":
        """Check that the focal length is given once, and no coefficient that the model does not have."""
        if (self.fx_px is None) == (self.horizontal_fov_deg is None):
            raise ValueError("expected either fx (or K) or horizontal_fov_deg")
        names = NAMES if self.model == "opencv" else COEFFICIENTS[self.model]
        foreign = [name for name in EVERY_NAME if getattr(self, name) != ZERO and name not in names]
        if foreign:
            wanted = " ".join(names) or "no coefficients"
            raise ValueError(f"expected {wanted} for the model {self.model}, got {' '.join(foreign)}")
        return self

    @property
    def looks_ahead(self) -> bool:
        """Whether it is turned ahead, and does not see what is beside the host."""
        return self.is_turned_ahead and not self._sees_aside

    @property
    def is_turned_ahead(self) -> bool:
        """Whether its viewing direction is where the host drives at every yaw that it may have."""
        yaw = self.yaw_deg
        yaws_deg = (yaw.low, yaw.high) if isinstance(yaw, Uniform) else yaw.values
        return all(abs(yaw_deg) <= AHEAD_DEG for yaw_deg in yaws_deg)

    @property
    def _sees_aside(self) -> bool:
        middle = self.drawn(partial(float, 0.5))
        radius = max(middle["cx_px"], middle["width_px"] - middle["cx_px"]) / middle["fx_px"]
        return bool(middle["lens"].angle_rad(radius) > math.radians(ASIDE_DEG))

    def black_share(self) -> float:
        """The share of the picture that is beyond the lens's field, and black: the largest of three, with all ranges at
        their lower end, middle and upper end."""
        return max(_black_share(self.drawn(partial(float, u))) for u in (0.0, 0.5, LAST))

    def drawn(self, u: Callable[[], float]) -> dict[str, Any]:
        """The fields of a scene's camera; `u` gives a number in [0, 1) for each field that is drawn.

        Raises InputError where the field of view is wider than the lens's.
        """
        values = {name: self._draw(name, u) for name in type(self).model_fields if name not in ("name", "model")}
        by_name = {name: round(values.pop(name), COEFFICIENT_DECIMALS) for name in EVERY_NAME}
        names = NAMES if any(by_name[name] for name in PRISM_AND_TILT) else COEFFICIENTS[self.model]
        lens = Lens(model=self.model, coefficients=tuple(by_name[name] for name in names))
        fov_deg = values.pop("horizontal_fov_deg")
        if fov_deg is not None:
            values["fx_px"] = values["width_px"] / 2 / _radius(lens, fov_deg)
        if values["fy_px"] is None:
            values["fy_px"] = values["fx_px"]
        for center, size in (("cx_px", "width_px"), ("cy_px", "height_px")):
            if values[center] is None:
                values[center] = values[size] / 2
        for name in ("yaw_deg", "pitch_deg", "roll_deg"):
            values[name.replace("_deg", "_rad")] = math.radians(values.pop(name))
        rounded = {
            key: round(value, VALUE_DECIMALS) if isinstance(value, float) else value for key, value in values.items()
        }
        return {**rounded, "name": self.name, "lens": lens}

    def _draw(self, name: str, u: Callable[[], float]) -> Any:
        distribution: Distribution | None = getattr(self, name)
        return None if distribution is None else distribution.draw(u())


def black_pictures(cameras: Sequence[CameraSpec]) -> list[str]:
    """A line for each camera whose picture is black in more than rounded corners."""
    shares = {camera.name: camera.black_share() for camera in cameras}
    return [
        f"{share:.0%} of the picture{f' of {name}' * bool(name)} is black, beyond the lens's field: it ends inside the "
        f"image"
        for name, share in shares.items()
        if share > LEAST_BLACK
    ]


def _black_share(drawn: dict[str, Any]) -> float:
    columns, rows = ((np.arange(GRID) + 0.5) / GRID * drawn[size] for size in ("width_px", "height_px"))
    img_from_cam = np.array(
        [[drawn["fx_px"], drawn["cx_px"], 0], [0, drawn["cy_px"], -drawn["fy_px"]], [0, 1, 0]], dtype=float
    )
    rays = drawn["lens"].rays(img_from_cam, np.stack(np.meshgrid(columns, rows), axis=-1))
    return float(np.isnan(rays).any(axis=-1).mean())


def _radius(lens: Lens, fov_deg: float) -> float:
    """How far from the principal point the lens shows what is half the field of view aside, in focal lengths."""
    if not math.radians(fov_deg / 2) < lens.field_rad:
        widest = 2 * math.degrees(lens.field_rad)
        raise InputError(f"camera: horizontal_fov_deg: expected less than the lens's {widest:.4g}, got {fov_deg:g}")
    return lens.radius(math.radians(fov_deg / 2))
