"""The tone curve: linear light to the 8-bit picture.

Each channel passes three increasing functions: an exponential film response 1 - exp(-1.1 x), which keeps middle gray
(0.18) and compresses highlights instead of clipping them (white at x = 5); the sRGB curve; and a gentle S-curve for the
contrast of camera pictures.
"""

from functools import cache

import numpy as np
from jaxtyping import Float, UInt8

MIDDLE_GRAY = 0.18
FILM_SPEED = 1.1
CONTRAST = 0.25


def response(linear: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The tone curve: radiance >= 0 to display values 0..1."""
    film = -np.expm1(-FILM_SPEED * linear)
    display = np.where(film <= 0.0031308, 12.92 * film, 1.055 * np.maximum(film, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(display + CONTRAST * (display**2 * (3 - 2 * display) - display))


def levels_per_radiance(linear: float) -> float:
    """The slope of the curve, in levels of 255."""
    step = 1e-4
    below, above = response(np.array([linear - step, linear + step]))
    return float(255 * (above - below) / (2 * step))


@cache
def _table() -> UInt8[np.ndarray, "65536"]:
    """The 8-bit value of every half float, indexed by its bits: a lookup is faster than powers and exponentials."""
    values = np.arange(65536, dtype=np.uint16).view(np.float16).astype(np.float64)
    values = np.where(np.isnan(values) | (values < 0), 0, values)
    return np.round(255 * response(values)).astype(np.uint8)


def tonemap(linear: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The 8-bit picture; negative values and NaN become black."""
    with np.errstate(over="ignore"):
        halves = linear.astype(np.float16)
    return _table()[halves.view(np.uint16)]
