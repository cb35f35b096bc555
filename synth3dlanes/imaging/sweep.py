"""One turn of a lidar: a range image, and its points. numpy alone.

Lidar frame: x right, y forward, z up, metres. Rows of the image are beams from the top one down, columns azimuths:
clockwise seen from above, the first just to the left of straight back, so that the middle looks forward.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8, UInt16

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import LidarLabel


class LidarPoints(NamedTuple):
    """What a sweep hit, beam by beam: places in the lidar's frame and the camera's, distances from the lidar, semantic
    and instance ids as in the passes, numbers of beam and azimuth."""

    xyz_lidar: Float[np.ndarray, "n 3"]
    xyz_cam: Float[np.ndarray, "n 3"]
    range_m: Float32[np.ndarray, " n"]
    semantic: UInt8[np.ndarray, " n"]
    instance: UInt16[np.ndarray, " n"]
    beam: Int[np.ndarray, " n"]
    azimuth: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Sweep:
    """A lidar's range image, and the ids at the hits. Without a return the range is infinite and the ids are 0."""

    lidar: LidarLabel
    range_m: Float32[np.ndarray, "beams azimuths"]
    semantic: UInt8[np.ndarray, "beams azimuths"]
    instance: UInt16[np.ndarray, "beams azimuths"]

    @property
    def returned(self) -> Bool[np.ndarray, "beams azimuths"]:
        """Which rays have a return."""
        return np.asarray(self.range_m != np.inf)

    def points(self) -> LidarPoints:
        """All returns as points."""
        at = self.returned
        rays = directions(np.array(self.lidar.elevations_rad), self.lidar.azimuths)[at]
        xyz_lidar = rays * self.range_m[at, None].astype(float)
        xyz_cam = transform(self.lidar.cam_from_lidar, xyz_lidar)
        return LidarPoints(xyz_lidar, xyz_cam, self.range_m[at], self.semantic[at], self.instance[at], *np.nonzero(at))


def directions(elevations_rad: Float[np.ndarray, " b"], azimuths: int) -> Float[np.ndarray, "b a 3"]:
    """Unit vectors of all rays of a turn in the lidar's frame."""
    azimuth = (2 * np.arange(azimuths) + 1) * np.pi / azimuths - np.pi  # clockwise from straight ahead
    flat = np.cos(elevations_rad)[:, None]
    up = np.broadcast_to(np.sin(elevations_rad)[:, None], (len(elevations_rad), azimuths))
    return np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), up], axis=-1)
