"""KITTI's folders, types, and a line of its labels.

Pixels count from the middle of the first one. A box stands upright in the camera's frame: it has a place, the middle of
its lower side, and a turn about the y axis, 0 where its front looks along x.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene.assets.catalogue import VehicleClass
from synth3dlanes.system.errors import FormatError

TRAINING, LISTS = "training", "ImageSets"
"""All frames are in one folder, as KITTI's own training and validation frames are."""
FOLDERS = {"image": "image_2", "label": "label_2", "calib": "calib", "points": "velodyne"}
ENDINGS = {"image": "png", "label": "txt", "calib": "txt", "points": "bin"}
TYPES: dict[VehicleClass, str] = {"car": "Car", "van": "Van", "truck": "Truck", "bus": "Misc", "trailer": "Truck"}
"""KITTI has no buses; a tractor with its semitrailer is a truck."""
DONT_CARE = "DontCare"
HALF_PX = 0.5
VELO_FROM_LIDAR = np.array([[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""KITTI's lidar looks along x, y is to its left; ours looks along y, x is to its right."""
SEEN_BY_LEVEL = (0.9, 0.5)
"""Levels of occlusion 0, 1 and 2: seen to so much at least, or less."""
LEAST_SEEN = 0.05
"""Objects of which less is seen are regions that detectors need not care about."""
N_FIELDS = 15


def path_of(what: str, name: str) -> str:
    """The place of a frame's file in an export."""
    return f"{TRAINING}/{FOLDERS[what]}/{name}.{ENDINGS[what]}"


@dataclass(frozen=True, eq=False)
class KittiObject:
    """A line of `label_2`: pixels (left, top, right, bottom), metres and radians; -1, -10 and -1000 for what a region
    `DontCare` does not have."""

    type: str
    truncated: float
    occluded: int
    alpha_rad: float
    box_px: Float[np.ndarray, "4"]
    height_width_length_m: Float[np.ndarray, "3"]
    location_cv: Float[np.ndarray, "3"]
    rotation_y_rad: float

    def line(self) -> str:
        """Its text."""
        box, size, place = (" ".join(f"{value:.{decimals}f}" for value in values) for values, decimals in self._arrays)
        angle = f"{self.alpha_rad:.4f}"
        return (
            f"{self.type} {self.truncated:.2f} {self.occluded} {angle} {box} {size} {place} {self.rotation_y_rad:.4f}"
        )

    @property
    def _arrays(self) -> tuple[tuple[Float[np.ndarray, " _"], int], ...]:
        return (self.box_px, 2), (self.height_width_length_m, 4), (self.location_cv, 4)


def dont_care(box_px: Float[np.ndarray, "4"]) -> KittiObject:
    """A region in which there is something that detectors need not find."""
    return KittiObject(DONT_CARE, -1, -1, -10, box_px, np.full(3, -1.0), np.full(3, -1000.0), -10)


NOTHING = dont_care(np.zeros(4))
"""What the label file of a frame without objects has: all files of the original have lines, and OpenPCDet fails on one
that has none. A region without a size hides no detection."""


def parse_line(text: str, where: str) -> KittiObject:
    """A line of `label_2`; raise FormatError for another."""
    words = text.split()
    try:
        values = [float(word) for word in words[1:]]
    except ValueError:
        values = []
    if len(words) != N_FIELDS or len(values) != N_FIELDS - 1 or not np.isfinite(values).all():
        raise FormatError(f"{where}: expected a type and {N_FIELDS - 1} numbers, got {text[:60]!r}")
    box, size, place = np.array(values[3:7]), np.array(values[7:10]), np.array(values[10:13])
    return KittiObject(words[0], values[0], int(values[1]), values[2], box, size, place, values[13])


def wrapped(angle_rad: float) -> float:
    """The same angle between -pi and pi."""
    return float((angle_rad + np.pi) % (2 * np.pi) - np.pi)


def occlusion(visible_fraction: float) -> int:
    """The level of occlusion: 0 seen, 1 partly hidden, 2 largely hidden."""
    return next((level for level, least in enumerate(SEEN_BY_LEVEL) if visible_fraction >= least), len(SEEN_BY_LEVEL))
