"""How exact a drive is said to be: what its calibration, its poses and its 2D lanes are off by."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from synth3dlanes.system.arrays import Scalars
from synth3dlanes.system.errors import InputError

MAX_VALUE = 1000.0


@dataclass(frozen=True)
class Precision:
    """Standard deviations: of lines in pixels, of poses in metres and degrees, of the mounting of lidar and camera on
    the host (the same in all frames), of marks in the top view in metres. Where the lines of many frames agree better
    or worse, their own deviation replaces them, within a factor of three."""

    lanes_px: float = 2.0
    pose_m: float = 0.02
    pose_deg: float = 0.05
    calibration_m: float = 0.01
    calibration_deg: float = 0.05
    marked_m: float = 0.05

    @staticmethod
    def of(values: Mapping[str, float]) -> "Precision":
        """The usual precision but for these values. Raises InputError for a name or a number that cannot be."""
        names = [item.name for item in fields(Precision)]
        for name, value in values.items():
            if name not in names or not 0 <= value <= MAX_VALUE:
                expected = f"numbers from 0 to {MAX_VALUE:g} for {', '.join(names)}"
                raise InputError(f"precision: expected {expected}, got {name}={value}")
        return Precision(**values)

    def pose_at(self, far_m: Scalars) -> Scalars:
        """The shift of points at distances from the host by an error of the pose."""
        return np.hypot(self.pose_m, far_m * np.radians(self.pose_deg))

    def calibration_at(self, far_m: Scalars) -> Scalars:
        """The shift of points at distances from the sensor by an error of the calibration."""
        return np.hypot(self.calibration_m, far_m * np.radians(self.calibration_deg))


# The precision of a drive without errors but those of rounding.
NO_ERROR = Precision(0.1, 0.001, 0.001, 0.0, 0.0, 0.005)
