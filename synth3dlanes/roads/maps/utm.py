"""UTM coordinates of places on the ellipsoid WGS84 and back, by Krueger's series: to less than a micrometre in a zone.

Easting and northing in metres, of the northern half also south of the equator; latitude and longitude in degrees.
"""

import numpy as np
from jaxtyping import Float

from synth3dlanes.system.arrays import Points2

RADIUS_M, FLATTENING = 6378137.0, 1 / 298.257223563
SCALE, FALSE_EASTING_M = 0.9996, 500_000.0
ECCENTRICITY = np.sqrt(FLATTENING * (2 - FLATTENING))
# The third flattening, the radius of the rectifying sphere, and the series up to the fourth power of the former.
N = FLATTENING / (2 - FLATTENING)
RECTIFYING_M = SCALE * RADIUS_M / (1 + N) * (1 + N**2 / 4 + N**4 / 64)
FORWARD = np.array(
    [
        N / 2 - 2 / 3 * N**2 + 5 / 16 * N**3 + 41 / 180 * N**4,
        13 / 48 * N**2 - 3 / 5 * N**3 + 557 / 1440 * N**4,
        61 / 240 * N**3 - 103 / 140 * N**4,
        49561 / 161280 * N**4,
    ]
)
BACK = np.array(
    [
        N / 2 - 2 / 3 * N**2 + 37 / 96 * N**3 - 1 / 360 * N**4,
        1 / 48 * N**2 + 1 / 15 * N**3 - 437 / 1440 * N**4,
        17 / 480 * N**3 - 37 / 840 * N**4,
        4397 / 161280 * N**4,
    ]
)
EVEN = 2.0 * np.arange(1, 5)
# Each step leaves a 150th of the error.
LATITUDE_STEPS = 8


def zone_of(longitude_deg: float) -> int:
    """The number of the zone of a longitude."""
    return int((longitude_deg + 180) // 6) % 60 + 1


def utm_from_degrees(degrees: Float[np.ndarray, "n 2"], zone: int) -> Points2:
    """Easting and northing of latitudes and longitudes, in a zone."""
    latitude, longitude = np.radians(degrees - [0, _middle_deg(zone)]).T
    sin = np.sin(latitude)
    t = np.sinh(np.arctanh(sin) - ECCENTRICITY * np.arctanh(ECCENTRICITY * sin))
    xi = np.arctan2(t, np.cos(longitude))
    eta = np.arctanh(np.sin(longitude) / np.hypot(1, t))
    return _plane(xi, eta, FORWARD) * RECTIFYING_M + [FALSE_EASTING_M, 0]


def degrees_from_utm(utm: Points2, zone: int) -> Float[np.ndarray, "n 2"]:
    """Latitude and longitude of eastings and northings of a zone."""
    eta, xi = ((utm - [FALSE_EASTING_M, 0]) / RECTIFYING_M).T
    eta, xi = _plane(xi, eta, -BACK).T
    conformal = np.sin(xi) / np.cosh(eta)
    sin = conformal
    for _ in range(LATITUDE_STEPS):
        sin = np.tanh(np.arctanh(conformal) + ECCENTRICITY * np.arctanh(ECCENTRICITY * sin))
    longitude = np.degrees(np.arctan2(np.sinh(eta), np.cos(xi))) + _middle_deg(zone)
    return np.column_stack([np.degrees(np.arcsin(sin)), longitude])


def _middle_deg(zone: int) -> float:
    return 6.0 * zone - 183


def _plane(xi: Float[np.ndarray, " n"], eta: Float[np.ndarray, " n"], series: Float[np.ndarray, "4"]) -> Points2:
    """A place of the sphere's plane, east and north, moved by a series."""
    at = (series * np.sin(EVEN * (xi + 1j * eta)[:, None])).sum(axis=1)
    return np.column_stack([eta + at.imag, xi + at.real])
