"""COCO's categories and the ids of panoptic segments."""

import numpy as np
from jaxtyping import Shaped, UInt8

from synth3dlanes.formats.segments import STUFF
from synth3dlanes.scene.settings import SEMANTIC_IDS

CLASSES_AT_MOST = 32  # segment ids are instance * 32 + category


def category_id(semantic: int) -> int:
    """The category of a semantic id; 0 would be none."""
    return semantic + 1


CATEGORIES = [
    {"id": category_id(number), "name": name, "supercategory": name, "isthing": int(name not in STUFF)}
    for name, number in SEMANTIC_IDS.items()
]
STUFF_IDS = {category_id(SEMANTIC_IDS[name]) for name in STUFF}


def segment_id(semantic: Shaped[np.ndarray, "h w"], instance: Shaped[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    """The segment of every pixel: pixels of one class and one instance."""
    is_thing = ~np.isin(semantic + 1, list(STUFF_IDS))
    return np.where(is_thing, instance.astype(np.int64), 0) * CLASSES_AT_MOST + semantic + 1


def rgb_of(segments: Shaped[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """Segment ids as the colours of a panoptic PNG: R + 256 G + 65536 B."""
    return np.stack([segments >> shift & 255 for shift in (0, 8, 16)], axis=-1).astype(np.uint8)
