"""Control pictures of a frame: depth, segmentation and edges."""

import colorsys

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label, sobel

from synth3dlanes.formats.cosmos.convention import CLASS_COLORS, EDGE_HIGH, EDGE_LOW, Rgb
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import Passes, RgbImage

GOLDEN = 0.618034
# A fisheye also sees what is beside the plane of its camera, at depth 0, and behind it.
NEAREST_M = 1.0


def nearness(passes: Passes) -> Float[np.ndarray, "h w"]:
    """One over the depth, 0 where nothing is hit; at most that of NEAREST_M, which what is behind has, too."""
    return 1.0 / np.maximum(passes["depth"].astype(float), NEAREST_M)


def nearness_span(passes: Passes) -> tuple[float, float]:
    """The least and the greatest nearness of a picture, but for the host's own bonnet, which would darken all else."""
    found = nearness(passes)[passes["semantic"] != SEMANTIC_IDS["host"]]
    return (float(found.min()), float(found.max())) if found.size else (0.0, 0.0)


def depth_picture(passes: Passes, span: tuple[float, float]) -> RgbImage:
    """Nearness from the least (black) to the greatest (white) of a clip, which are its span."""
    low, high = span
    grey = np.rint(255 * (nearness(passes) - low) / max(high - low, 1e-9)).clip(0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def seg_picture(passes: Passes) -> RgbImage:
    """A colour for each class, and for each car one of its own, the same in all frames."""
    semantic, instance = passes["semantic"], passes["instance"]
    picture, is_car = CLASS_COLORS[semantic], semantic == SEMANTIC_IDS["car"]
    numbers, at = np.unique(instance[is_car], return_inverse=True)
    if len(numbers):
        picture[is_car] = np.array([car_color(int(number)) for number in numbers], np.uint8)[at]
    return picture


def car_color(number: int) -> Rgb:
    """The colour of a car by its instance id; those of successive ids are far apart."""
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(number * GOLDEN % 1, 0.8, 0.95))
    return red, green, blue


def edge_picture(image: RgbImage) -> RgbImage:
    """Canny's edges, white on black, with the thresholds of Cosmos and the operators of OpenCV: Sobel's, of the
    channel that changes most."""
    return np.repeat((edges(image) * np.uint8(255))[..., None], 3, axis=2)


def edges(image: RgbImage) -> Bool[np.ndarray, "h w"]:
    """Where the edges of an image are."""
    # SciPy's operator would also smooth over the axis of the channels.
    channels = np.moveaxis(image.astype(np.int32), 2, 0)
    along = [np.stack([sobel(one, axis, mode="nearest") for one in channels], axis=2) for axis in (1, 0)]
    size = np.abs(along[0]) + np.abs(along[1])
    channel = size.argmax(axis=2)[..., None]
    dx, dy, size = (np.take_along_axis(values, channel, axis=2)[..., 0] for values in (*along, size))
    strong = _ridges(dx, dy, size) & (size > EDGE_LOW)
    numbers, n_parts = label(strong, np.ones((3, 3)))
    kept = np.zeros(n_parts + 1, dtype=bool)
    kept[np.unique(numbers[strong & (size > EDGE_HIGH)])] = True
    kept[0] = False
    return kept[numbers]


def _ridges(dx: np.ndarray, dy: np.ndarray, size: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """Where the gradient is greater than on both sides along its direction, of which there are four."""
    padded = np.pad(size, 1)
    height, width = size.shape

    def beside(down: int, right: int) -> np.ndarray:
        return padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    tan_22 = np.sqrt(2) - 1
    level, steep = np.abs(dy) < tan_22 * np.abs(dx), np.abs(dy) > np.abs(dx) / tan_22
    falls = dx * dy >= 0
    found = np.zeros(size.shape, dtype=bool)
    for where, (down, right) in (
        (level, (0, 1)),
        (steep, (1, 0)),
        (~level & ~steep & falls, (1, 1)),
        (~level & ~steep & ~falls, (1, -1)),
    ):
        before, after = beside(-down, -right), beside(down, right)
        is_ridge = (size > before) & ((size >= after) if down == 0 or right == 0 else (size > after))
        found |= where & is_ridge
    return found
