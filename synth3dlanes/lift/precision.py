"""How exact a drive is said to be: what its calibration, its poses and its 2D lanes are off by."""

from dataclasses import dataclass

import numpy as np

from synth3dlanes.arrays import Scalars


@dataclass(frozen=True)
class Precision:
    """Standard deviations: of lines in pixels, of poses in metres and degrees, of the places of lidar and camera on the
    host (the same in all frames), of marks in the top view in metres. Where the lines of many frames agree better or
    worse, up to three times, that counts instead."""

    lanes_px: float = 2.0
    pose_m: float = 0.02
    pose_deg: float = 0.05
    calibration_m: float = 0.01
    calibration_deg: float = 0.05
    marked_m: float = 0.05

    def pose_at(self, far_m: Scalars) -> Scalars:
        """What an error of the pose moves a point by that is so far from the host."""
        return np.hypot(self.pose_m, far_m * np.radians(self.pose_deg))

    def calibration_at(self, far_m: Scalars) -> Scalars:
        """What an error of the calibration moves a point by that is so far from the sensor."""
        return np.hypot(self.calibration_m, far_m * np.radians(self.calibration_deg))


# Of a drive without any error: what rounding leaves.
NO_ERROR = Precision(0.1, 0.001, 0.001, 0.0, 0.0, 0.005)
