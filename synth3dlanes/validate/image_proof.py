"""The image against the labels: across every delimiter that is seen, the brightness has its ridge where the paint is.

Works without passes. Profiles across the line are cut from the image at even steps of metres on the road, so that
perspective does not matter, and their median along the line is what is judged: shadows, cracks and worn paint move
some profiles, not the median. A line without contrast says nothing; a whole image without any says that it is not the
labels' image. Images are not asked whose paint may not show (`Paint.shows`).
"""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import map_coordinates

from synth3dlanes.geometry.camera import project
from synth3dlanes.labels import CameraLabel, Labels, Lane
from synth3dlanes.validate.findings import PROOF_M, Finding, Measure
from synth3dlanes.validate.paint import Paint, Strip

# Profiles reach this far to either side, in steps that resolve the narrowest paint (0.1 m).
REACH_M, STEP_M = 1.0, 0.025
# Lines are looked for this far aside; beyond, the next line's paint may come into the profile.
SEARCH_M = 0.75
# A ridge this close to its place counts as in place: half of the narrowest paint.
IN_PLACE_M = 0.06
# Fewer profiles than this can all lie in one shadow, tar seam or worn stretch.
MIN_PROFILES = 15
# Gray levels of 255 in the median of a line: chance leaves 1 to 4 where no paint is, paint of the road's own gray 5.
CONTRAST, FAINT = 12.0, 4.0
# A ridge elsewhere must be this much stronger than what is in place: the edge of a shadow reaches 2.7 times.
STRONGER = 3.0
# With fewer profiles in all, no image is judged as a whole; one with a smaller share of them in place is not the
# labels' image. Measured on 200 scenes: no clean one fails, and 88 % of images taken from another scene do.
MIN_IMAGE_PROFILES, MIN_SHARE = 60, 0.4

OFFSETS_M = np.arange(-REACH_M, REACH_M + STEP_M / 2, STEP_M)


class Contrast(NamedTuple):
    """One line in the image: how many profiles, where its ridge is, how strong that is, and how strong in place."""

    lane: str
    n: int
    y_m: float
    ridge_m: float
    ridge: float
    in_place: float

    @property
    def verdict(self) -> Literal["in place", "elsewhere", "unclear"]:
        """What the image says of the line."""
        if self.ridge >= CONTRAST and self.in_place * STRONGER < self.ridge:
            return "elsewhere"
        return "in place" if self.in_place >= FAINT and 2 * self.in_place >= self.ridge else "unclear"


def prove_image(paint: Paint, labels: Labels, image: UInt8[np.ndarray, "h w 3"]) -> tuple[list[Finding], list[Measure]]:
    """Faults of lines and of the image as a whole; measure `image_ridge_m` is the ridge's distance from its place."""
    if not paint.shows:
        return [], []
    luma = image @ np.array([0.3, 0.6, 0.1])
    lines = [line for lane in labels.lanes if lane.kind == "delimiter" for line in _contrast(paint, labels, lane, luma)]
    findings = [
        Finding(
            line.lane,
            f"image: expected the line's paint within {IN_PLACE_M} m, got it {line.ridge_m:+.2f} m aside "
            f"(contrast {line.ridge:.0f} there, {line.in_place:.0f} in place, {line.n} profiles)",
        )
        for line in lines
        if line.verdict == "elsewhere"
    ]
    n, in_place = sum(line.n for line in lines), sum(line.n for line in lines if line.verdict == "in place")
    if n >= MIN_IMAGE_PROFILES and in_place < MIN_SHARE * n:
        findings.append(
            Finding("", f"image: expected paint under its delimiters, got it under {in_place} of {n} profiles")
        )
    clear = [line for line in lines if line.verdict != "unclear" and line.ridge >= CONTRAST]
    y_m, ridges_m = np.array([[line.y_m, abs(line.ridge_m)] for line in clear]).reshape(-1, 2).T
    return findings, [Measure("image_ridge_m", y_m, ridges_m)]


def _contrast(paint: Paint, labels: Labels, lane: Lane, luma: Float[np.ndarray, "h w"]) -> Iterator[Contrast]:
    points_cam = _every_pixel(labels.camera, lane)
    if len(points_cam) < MIN_PROFILES:
        return
    strip = paint.strip(labels.camera, lane, points_cam)
    profiles = _profiles(labels.camera, strip, luma)
    whole = np.isfinite(profiles).all(axis=1)
    if whole.sum() < MIN_PROFILES:
        return
    places_m, ridges = _ridges(np.asarray(profiles[whole]), paint.width_m, paint.stripes_m(lane.id))
    strength = np.abs(np.median(ridges, axis=0))
    best = int(strength.argmax())
    in_place = float(strength[np.abs(places_m) <= IN_PLACE_M].max())
    y_m = float(points_cam[strip.resolved][whole, 1].mean())
    yield Contrast(lane.id, int(whole.sum()), y_m, float(places_m[best]), float(strength[best]), in_place)


def _every_pixel(camera: CameraLabel, lane: Lane) -> Float[np.ndarray, "n 3"]:
    """Points about a pixel apart on the image along the seen part of a line; perspective is linear in 1/y."""
    seen = lane.visible & (lane.xyz_cam[:, 1] < PROOF_M)
    uv = project(camera.img_from_cam, lane.xyz_cam)
    pieces = [np.zeros((0, 3))]
    for i in np.flatnonzero(seen[:-1] & seen[1:]):
        a, b = lane.xyz_cam[i : i + 2]
        n = max(1, int(np.hypot(*(uv[i + 1] - uv[i]))))
        share = (np.arange(n) + 0.5) / n
        share = share * a[1] / (b[1] + share * (a[1] - b[1]))
        pieces.append(a + share[:, None] * (b - a))
    return np.concatenate(pieces)


def _profiles(camera: CameraLabel, strip: Strip, luma: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "n k"]:
    """Brightness across the line at its resolved points; NaN outside the image."""
    at = strip.resolved
    points = strip.points_cam[at, None] + OFFSETS_M[:, None] * strip.across_cam[at, None]
    u, v = project(camera.img_from_cam, points.reshape(-1, 3)).T
    height_px, width_px = luma.shape
    with np.errstate(invalid="ignore"):
        inside = (u >= 0) & (u <= width_px) & (v >= 0) & (v <= height_px)
    values = np.full(len(u), np.nan)
    values[inside] = map_coordinates(luma, [v[inside] - 0.5, u[inside] - 0.5], order=1, mode="nearest")
    return values.reshape(points.shape[:2])


def _ridges(
    profiles: Float[np.ndarray, "n k"], width_m: float, stripes_m: tuple[float, ...]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "n m"]]:
    """How much brighter stripes as wide as the paint are than both their sides, for lines at places across the line."""
    places_m = OFFSETS_M[np.abs(OFFSETS_M) <= SEARCH_M + STEP_M / 2]
    ridges = np.zeros((len(profiles), len(places_m)))
    for j, place_m in enumerate(places_m):
        away = np.abs(OFFSETS_M - place_m - np.array(stripes_m)[:, None]).min(axis=0) / width_m
        beside = (away > 0.75) & (away < 1.75)
        ridges[:, j] = profiles[:, away < 0.5].mean(axis=1) - profiles[:, beside].mean(axis=1)
    return places_m, ridges
