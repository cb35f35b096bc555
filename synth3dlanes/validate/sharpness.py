"""Check that the image has detail at its full resolution; an upscaled image of half the size has not."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from synth3dlanes.validate.findings import Finding

# At most this many pixels in the middle of the image are used; images with fewer than MIN_PX are not judged.
MAX_PX, MIN_PX = 200_000, 5_000
# Share of the brightness steps that count as the steepest, and upper limit of a pixel's contribution to fine detail.
STEEPEST, MOST = 0.01, 20.0
# In 1,260 rendered images, including PNG, evenness is at least 0.88 and coarseness at most 1.09. After halving and
# upscaling them, evenness is below 0.78 or coarseness above 1.4.
MIN_EVENNESS, MAX_COARSENESS = 0.8, 1.33


class Detail(NamedTuple):
    """Ratios that measure an image's resolution: `width`, steps beside the steepest ones over these; `fineness`, detail
    of one pixel over that of two; `evenness`, mean steps in odd and even pixel pairs, the smaller over the larger."""

    width: float
    fineness: float
    evenness: float

    @property
    def coarseness(self) -> float:
        """Small for an image with detail of single pixels."""
        return self.width / (self.fineness * self.evenness)


def check_sharpness(image: UInt8[np.ndarray, "h w 3"]) -> Iterator[Finding]:
    """Finding if the image has been upscaled or blurred."""
    detail = _detail(_middle(image))
    if detail is None:
        return
    if detail.evenness < MIN_EVENNESS or detail.coarseness > MAX_COARSENESS:
        yield Finding(
            "",
            f"image: expected detail of single pixels, got a blurred or blown-up picture (coarseness "
            f"{detail.coarseness:.2f} of at most {MAX_COARSENESS}, evenness {detail.evenness:.2f} of at least "
            f"{MIN_EVENNESS})",
        )


def _middle(image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "r c"]:
    """The brightness in the middle of the image, cut at even pixels."""
    height, width = image.shape[:2]
    part = min(1.0, np.sqrt(MAX_PX / (height * width)))
    rows, columns = 2 * int(height * part / 2), 2 * int(width * part / 2)
    top, left = (height - rows) // 4 * 2, (width - columns) // 4 * 2
    return image[top : top + rows, left : left + columns] @ np.array([0.3, 0.6, 0.1])


def _detail(luma: Float[np.ndarray, "r c"]) -> Detail | None:
    """The mean of the ratios along rows and columns; None for an image that is too small or uniform."""
    found = []
    for values in (luma, luma.T):
        steps = np.abs(np.diff(values, axis=1))
        inner = steps[:, 1:-1]
        n_steepest = int(STEEPEST * inner.size)
        steep = inner >= np.partition(inner, -n_steepest, axis=None)[-n_steepest] if n_steepest else inner < 0
        odd, even = steps[:, 0::2].mean(), steps[:, 1::2].mean()
        fine, coarse = (_curvature(values, reach) for reach in (1, 2))
        if luma.size < MIN_PX or not inner[steep].sum() or not min(fine, coarse, max(odd, even)):
            return None
        width = (steps[:, 2:] + steps[:, :-2])[steep].sum() / 2 / inner[steep].sum()
        found.append((width, fine / coarse, min(odd, even) / max(odd, even)))
    return Detail(*np.mean(found, axis=0))


def _curvature(values: Float[np.ndarray, "r c"], reach: int) -> float:
    """Mean difference between pixels and the mean of their neighbours at `reach`; limited for strong edges."""
    middle = values[:, 2:-2]
    before, after = values[:, 2 - reach : -2 - reach], values[:, 2 + reach : values.shape[1] - 2 + reach]
    return float(np.minimum(np.abs(middle - (before + after) / 2), MOST).mean())
