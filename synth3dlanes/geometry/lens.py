"""Lenses: from camera frame to pixels and back, through the distortion models of OpenCV. numpy alone.

A model bends the point (x/y, z/y) at which a pinhole sees a point into the one where the lens has it; the matrix
`img_from_cam` makes pixels of that. docs/frames.md has the formulas.
"""

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from synth3dlanes.geometry.frames import project
from synth3dlanes.system.arrays import AnyPoints2, AnyPoints3, Numbers
from synth3dlanes.system.schema import DocumentPart

LensModel = Literal["pinhole", "opencv", "fisheye", "omni"]
# The names of the coefficients of each model, in order.
COEFFICIENTS: dict[LensModel, tuple[str, ...]] = {
    "pinhole": (),
    "opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
    "omni": ("xi", "k1", "k2", "p1", "p2"),
}
# Models without a plane: their radius, which grows with the angle itself, is finite beyond 90 degrees.
ANGULAR: tuple[LensModel, ...] = ("fisheye",)
# What OpenCV's model may have beside these: a thin prism, and a sensor tilted about its axes.
PRISM_AND_TILT = ("s1", "s2", "s3", "s4", "tau_x", "tau_y")
MAX_COEFFICIENT = 1e4
MAX_TILT_RAD = 0.5
# Widest angle from the viewing direction, less than 90 degrees for models that are defined in x/y and z/y.
WIDEST_RAD: dict[str, float] = {"pinhole": np.pi / 2, "opencv": np.radians(89.0), "fisheye": np.pi}
# The widest angle of `omni` follows from xi, and is this much less than where its plane ends.
EDGE_RAD = np.radians(1.0)
# Newton's steps, the knots that they start from, and the largest error of an inverse, in units of x/y.
STEPS, KNOTS, TOLERANCE = 20, 512, 1e-10
# The last Newton step is smaller.
LAST_STEP = 1e-9
# Coefficients of polynomials below this count as 0.
NEGLIGIBLE = 1e-15


class Lens(DocumentPart):
    """A distortion model and its coefficients, which are those of COEFFICIENTS in order; those of PRISM_AND_TILT may
    follow in OpenCV's model. `fisheye` is Kannala and Brandt's model, `omni` Mei's of omnidirectional cameras."""

    model: LensModel = "pinhole"
    coefficients: tuple[Annotated[float, Field(ge=-MAX_COEFFICIENT, le=MAX_COEFFICIENT)], ...] = ()

    @model_validator(mode="after")
    def _has_its_coefficients(self) -> "Lens":
        """Check that there is one coefficient for each of the model."""
        wanted = [COEFFICIENTS[self.model]]
        if self.model == "opencv":
            wanted.append(wanted[0] + PRISM_AND_TILT)
        if len(self.coefficients) not in {len(names) for names in wanted}:
            told = " or ".join(" ".join(names) or "none" for names in wanted)
            raise ValueError(f"coefficients: expected {told} for {self.model}, got {len(self.coefficients)} values")
        if any(abs(tilt_rad) > MAX_TILT_RAD for tilt_rad in self.prism_and_tilt[4:]):
            raise ValueError(f"coefficients: expected tau_x and tau_y of at most {MAX_TILT_RAD:g}, in radians")
        if self.xi < 0:
            raise ValueError(f"coefficients: expected xi of at least 0, got {self.xi:g}")
        return self

    @property
    def named(self) -> dict[str, float]:
        """The coefficients by name."""
        return dict(zip(COEFFICIENTS[self.model] + PRISM_AND_TILT, self.coefficients, strict=False))

    @property
    def prism_and_tilt(self) -> tuple[float, ...]:
        """s1 s2 s3 s4 tau_x tau_y."""
        return (self.coefficients[8:] if self.model == "opencv" else ()) or (0.0,) * len(PRISM_AND_TILT)

    @property
    def xi(self) -> float:
        """How far behind the centre of its unit sphere an omnidirectional camera looks at what is projected onto the
        sphere; 0 for other models."""
        return self.coefficients[0] if self.model == "omni" else 0.0

    @property
    def tangential(self) -> tuple[float, ...]:
        """p1 p2."""
        return {"opencv": self.coefficients[2:4], "omni": self.coefficients[3:5]}.get(self.model, (0.0, 0.0))

    @property
    def is_pinhole(self) -> bool:
        """Whether straight lines stay straight."""
        return not any(self.coefficients) and self.model not in ANGULAR

    def project(self, img_from_cam: Float[np.ndarray, "3 3"], points_cam: AnyPoints3) -> AnyPoints2:
        """Pixels (u, v) of points; NaN for points that are not in the lens's field."""
        if self.is_pinhole:
            return project(img_from_cam, points_cam)
        bent = _bent(self, points_cam.reshape(-1, 3)).reshape(*points_cam.shape[:-1], 2)
        return project(img_from_cam, np.stack([bent[..., 0], np.ones(bent.shape[:-1]), bent[..., 1]], axis=-1))

    def rays(self, img_from_cam: Float[np.ndarray, "3 3"], uv: AnyPoints2) -> AnyPoints3:
        """Unit vectors (camera frame) along which pixels look; NaN where the lens has no picture."""
        homogeneous = np.concatenate([uv, np.ones((*uv.shape[:-1], 1))], axis=-1) @ np.linalg.inv(img_from_cam).T
        if self.is_pinhole:
            return np.asarray(homogeneous / np.linalg.norm(homogeneous, axis=-1, keepdims=True))
        bent = homogeneous[..., [0, 2]] / homogeneous[..., 1:2]
        return _straight(self, bent.reshape(-1, 2)).reshape(*uv.shape[:-1], 3)

    @property
    def field_rad(self) -> float:
        """The angle from the viewing direction at which the lens's field ends: where its radial function turns back,
        or at its widest."""
        return _field_rad(self)

    def radius(self, angle_rad: float) -> float:
        """How far from the principal point, in focal lengths, the lens without p1 and p2 has what is seen at an angle
        from the viewing direction."""
        return float(_radius(self, np.array([angle_rad]))[0][0])

    def angle_rad(self, radius: float) -> float:
        """The angle from the viewing direction, in radians, of a ray that meets the image at `radius`; the inverse of
        `radius`. Beyond the lens's field it is the angle at which the field ends."""
        angle = float(_angle(self, np.array([radius]))[0])
        return self.field_rad if np.isnan(angle) else angle


PINHOLE = Lens()


def _radial(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of the radial factor as polynomials of the squared radius (or angle), its highest power
    first."""
    if lens.model == "opencv":
        k1, k2, _, _, k3, k4, k5, k6 = lens.coefficients[:8]
        return np.array([k3, k2, k1, 1.0]), np.array([k6, k5, k4, 1.0])
    powers = {"fisheye": lens.coefficients, "omni": lens.coefficients[1:3]}.get(lens.model, ())
    return np.array([*powers[::-1], 1.0]), np.ones(1)


@lru_cache(maxsize=256)
def _field_rad(lens: Lens) -> float:
    """The least angle at which the distorted radius stops growing, or at which its factor ends or changes its sign."""
    above, below = _radial(lens)
    # d/dr of r above/below, times below**2, in s = r**2.
    grown = np.polyadd(above, np.polymul([2.0, 0.0], np.polyder(above)))
    slope: np.ndarray = np.polysub(
        np.polymul(grown, below), np.polymul(np.polymul([2.0, 0.0], above), np.polyder(below))
    )
    parts = (np.where(np.abs(part) < NEGLIGIBLE, 0.0, part) for part in (slope, above, below))
    roots = np.concatenate([np.roots(part) for part in parts])
    real = roots.real[(np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots.real))) & (roots.real > 0)]
    end = float(np.sqrt(real.min())) if real.size else np.inf
    if lens.model in ANGULAR:
        return min(end, _widest_rad(lens))
    aside, ahead, _ = _lifted(lens, np.array([end, 0.0]))
    return float(np.fmin(np.arctan2(aside, ahead), _widest_rad(lens)))


def _widest_rad(lens: Lens) -> float:
    """The widest angle that a model may have. The plane of an omnidirectional camera ends where it is infinitely far
    away, or, from outside its sphere, where the sphere turns away."""
    if lens.model == "omni":
        return float(np.arccos(-min(lens.xi, 1 / max(lens.xi, 1.0)))) - EDGE_RAD
    return WIDEST_RAD[lens.model]


def _radius(lens: Lens, angle_rad: Numbers) -> tuple[Numbers, Numbers]:
    """The distorted radius at an angle, and its derivative by the angle."""
    r, stretch = _flat(lens, angle_rad)
    factor, slope = _factor(lens, r * r)
    return r * factor, (factor + 2 * r * r * slope) * stretch


def _flat(lens: Lens, angle_rad: Numbers) -> tuple[Numbers, Numbers]:
    """The radius before distortion at an angle, and its derivative by the angle."""
    if lens.model == "fisheye":
        return angle_rad, np.ones_like(angle_rad)
    depth = np.cos(angle_rad) + lens.xi
    return np.sin(angle_rad) / depth, (1 + lens.xi * np.cos(angle_rad)) / depth**2


def _lifted(lens: Lens, plane: AnyPoints2) -> AnyPoints3:
    """Unit vectors to points of the plane of a model, before distortion; NaN where there is none."""
    s = plane[..., :1] ** 2 + plane[..., 1:] ** 2
    with np.errstate(invalid="ignore"):
        scale = (lens.xi + np.sqrt(1 + (1 - lens.xi**2) * s)) / (1 + s)
    return np.concatenate([plane[..., :1] * scale, scale - lens.xi, plane[..., 1:] * scale], axis=-1)


def _factor(lens: Lens, s: Numbers) -> tuple[Numbers, Numbers]:
    """The radial factor at squared radii, and its derivative by them."""
    above, below = _radial(lens)
    n, d = np.polyval(above, s), np.polyval(below, s)
    slope = (np.polyval(np.polyder(above), s) * d - n * np.polyval(np.polyder(below), s)) / d**2
    return n / d, slope


def _bent(lens: Lens, points_cam: AnyPoints3) -> AnyPoints2:
    """Where the lens has points, right and up in focal lengths; NaN out of its field."""
    x, y, z = np.moveaxis(np.asarray(points_cam, float), -1, 0)
    aside = np.hypot(x, z)
    angle = np.arctan2(aside, y)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.where((angle < lens.field_rad) & ((aside > 0) | (y > 0)), angle, np.nan)
        if lens.model in ANGULAR:
            scale = np.where(aside > 0, _radius(lens, angle)[0] / np.where(aside > 0, aside, 1), 0.0) + 0 * angle
            return np.stack([x * scale, z * scale], axis=-1)
        y = np.where(np.isnan(angle), np.nan, y) + lens.xi * np.hypot(aside, y)
        return _tilted(_tilt(lens), _tangential(lens, np.stack([x / y, z / y], axis=-1))[0])


def _tilt(lens: Lens) -> Float[np.ndarray, "3 3"] | None:
    """The homography onto a tilted sensor, of points right and up; None where it is not tilted."""
    x_rad, y_rad = lens.prism_and_tilt[4:]
    if not (x_rad or y_rad):
        return None
    about_x = np.array([[1, 0, 0], [0, np.cos(x_rad), np.sin(x_rad)], [0, -np.sin(x_rad), np.cos(x_rad)]])
    about_y = np.array([[np.cos(y_rad), 0, -np.sin(y_rad)], [0, 1, 0], [np.sin(y_rad), 0, np.cos(y_rad)]])
    turn = about_y @ about_x
    onto = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]])
    # OpenCV's second axis points down.
    down = np.diag([1.0, -1.0, 1.0])
    return np.asarray(down @ onto @ turn @ down)


def _tilted(tilt: Float[np.ndarray, "3 3"] | None, points: AnyPoints2) -> AnyPoints2:
    """Points through a homography; NaN for those behind the sensor."""
    if tilt is None:
        return points
    found = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ tilt.T
    return np.asarray(found[..., :2] / np.where(found[..., 2:] > 0, found[..., 2:], np.nan))


def _tangential(lens: Lens, straight: AnyPoints2) -> tuple[AnyPoints2, Float[np.ndarray, "*n 2 2"]]:
    """OpenCV's model without tilt on (x/y, z/y), or on what an omnidirectional camera has there, and its Jacobian. Its
    own second axis points down: -z/y."""
    p1, p2 = lens.tangential
    s1, s2, s3, s4, _, _ = lens.prism_and_tilt
    a, b = straight[..., 0], -straight[..., 1]
    s = a * a + b * b
    factor, slope = _factor(lens, s)
    across = a * factor + 2 * p1 * a * b + p2 * (s + 2 * a * a) + s * (s1 + s2 * s)
    down = b * factor + p1 * (s + 2 * b * b) + 2 * p2 * a * b + s * (s3 + s4 * s)
    # Derivatives of the thin-prism terms with respect to s.
    across_by_s, down_by_s = s1 + 2 * s2 * s, s3 + 2 * s4 * s
    aa = factor + 2 * slope * a * a + 2 * p1 * b + 6 * p2 * a + 2 * a * across_by_s
    bb = factor + 2 * slope * b * b + 6 * p1 * b + 2 * p2 * a + 2 * b * down_by_s
    ab = 2 * slope * a * b + 2 * p1 * a + 2 * p2 * b
    jacobian = np.stack(
        [
            np.stack([aa, -(ab + 2 * b * across_by_s)], axis=-1),
            np.stack([-(ab + 2 * a * down_by_s), bb], axis=-1),
        ],
        axis=-2,
    )
    return np.stack([across, -down], axis=-1), jacobian


def _straight(lens: Lens, bent: AnyPoints2) -> AnyPoints3:
    """Unit vectors to what the lens has at these points; NaN where that is nothing."""
    tilt = _tilt(lens)
    bent = _tilted(None if tilt is None else np.linalg.inv(tilt), bent)
    radius = np.hypot(bent[..., 0], bent[..., 1])
    angle = _angle(lens, radius)
    with np.errstate(invalid="ignore"):
        outward = bent / np.where(radius > 0, radius, 1)[..., None]
    if not any(lens.tangential + lens.prism_and_tilt[:4]):
        return np.concatenate(
            [
                outward[..., :1] * np.sin(angle)[..., None],
                np.cos(angle)[..., None],
                outward[..., 1:] * np.sin(angle)[..., None],
            ],
            axis=-1,
        )
    # p1, p2 and a prism may move a point into the field whose radius is just out of it.
    start = np.where(np.isnan(angle), 0.98 * lens.field_rad, angle)
    straight = outward * _flat(lens, start)[0][..., None]
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            found, jacobian = _tangential(lens, straight)
            (a, b), (c, d) = np.moveaxis(jacobian, (-2, -1), (0, 1))
            e, f = np.moveaxis(found - bent, -1, 0)
            determinant = a * d - b * c
            step = np.stack([d * e - b * f, a * f - c * e], axis=-1) / determinant[..., None]
            straight = straight - step
            if not (np.abs(step) > LAST_STEP).any():
                break
        off = np.abs(_tangential(lens, straight)[0] - bent).max(axis=-1)
        rays = _lifted(lens, straight)
        inside = (off < TOLERANCE) & (np.arccos(np.clip(rays[..., 1], -1, 1)) < lens.field_rad)
    return np.where(inside[..., None], rays, np.nan)


def _angle(lens: Lens, radius: Numbers) -> Numbers:
    """The angle from the viewing direction at which the lens has a distorted radius; NaN beyond its field."""
    knots = np.linspace(0, lens.field_rad, KNOTS)
    # Just inside: at its end the field's radius may be infinite.
    knots[-1] -= 1e-9 * lens.field_rad
    radii = _radius(lens, knots)[0]
    low, high = knots[:-1], knots[1:]
    cell = np.clip(np.searchsorted(radii, radius, side="right") - 1, 0, KNOTS - 2)
    angle = np.interp(radius, radii, knots)
    for _ in range(STEPS):
        found, slope = _radius(lens, angle)
        with np.errstate(all="ignore"):
            step = np.where(slope > 0, (found - radius) / slope, 0.0)
        angle = np.clip(angle - step, low[cell], high[cell])
        if not (np.abs(step) > LAST_STEP).any():
            break
    with np.errstate(invalid="ignore"):
        return np.where(radius <= radii[-1], angle, np.nan)


def width_rad(img_from_cam: Float[np.ndarray, "3 3"], lens: Lens, width_px: int) -> float:
    """The angle that an image is wide, in the row of its principal point; for a pinhole, as if that were in the
    middle."""
    if lens.is_pinhole:
        return float(2 * np.arctan(width_px / 2 / img_from_cam[0, 0]))
    row_px = img_from_cam[1, 1]
    right, ahead, _ = lens.rays(img_from_cam, np.array([[0.0, row_px], [width_px, row_px]])).T
    angles = np.arctan2(np.abs(right), ahead)
    return float(np.where(np.isnan(angles), lens.field_rad, angles).sum())
