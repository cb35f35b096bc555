"""Car bodies as lofts: a lower body with wheel arches cut into its sections, and a glazed cabin on top.

Origin between the wheels on the ground, +y forward, metres. Sections run from the middle of the underside over the
right flank to the middle of the top; the left side mirrors them.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from shapes import Shape, grid_faces

from synth3dlanes.scene.assets.catalogue import CarModel

PAINT, GLASS, TYRE, RIM, TRIM, HEAD, TAIL, PLATE, LIVERY = range(9)

Knots = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Style:
    """Outline of one model: knots are (y in metres, value); y falls from the nose to the tail.

    `windows` are the side windows and `screens` the windscreen and the rear window, as y ranges.
    """

    plan: Knots  # half width as a share of the model's
    sill: Knots  # underside height
    belt: Knots  # height of the flank's upper edge
    deck: Knots  # height of bonnet and boot
    roof: Knots  # height of the cabin's top; ends where it sinks into the body
    windows: tuple[tuple[float, float], ...]
    screens: tuple[tuple[float, float], ...]
    tumblehome_m: float = 0.13
    bed: tuple[float, float, float] | None = None  # y range and floor height of an open load bed
    dark_sill_m: float = 0.06
    end_radius_m: float = 0.09


def curve(knots: Knots, y: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """A monotone smooth curve through the knots."""
    points = np.array(sorted(knots))
    return PchipInterpolator(points[:, 0], points[:, 1])(np.clip(y, points[0, 0], points[-1, 0]))


def stations(model: CarModel, style: Style) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Where sections are taken, and the underside height there with the wheel arches cut in."""
    tail, nose = style.plan[-1][0], style.plan[0][0]
    ends = style.end_radius_m * (1 - np.cos(np.linspace(0, np.pi / 2, 5)))
    y = np.concatenate([tail + ends, np.linspace(tail, nose, 30)[2:-2], nose - ends])
    if style.bed is not None:
        y = np.concatenate([y, [style.bed[0] - 0.004, style.bed[0], style.bed[1], style.bed[1] + 0.004]])
    underside = curve(style.sill, y)
    radius = model.wheel_radius_m + 0.07
    for axle in (-model.wheelbase_m / 2, model.wheelbase_m / 2):
        if not tail < axle < nose:
            continue
        outside = np.abs(y - axle) > radius + 0.004
        angle = np.linspace(0, np.pi, 15)
        arch_y = axle + np.concatenate([[radius + 0.002], radius * np.cos(angle), [-radius - 0.002]])
        low = curve(style.sill, arch_y[[0, -1]])
        arch_z = np.concatenate([low[:1], model.wheel_radius_m + radius * np.sin(angle), low[1:]])
        y, underside = np.concatenate([y[outside], arch_y]), np.concatenate([underside[outside], arch_z])
    order = np.argsort(y, kind="stable")
    return y[order], underside[order]


def rounding(y: Float[np.ndarray, " n"], tail: float, nose: float, radius: float) -> Float[np.ndarray, " n"]:
    """How far the section shrinks near either end, for a rounded edge."""
    to_end = np.clip(np.minimum(y - tail, nose - y) / radius, 0, 1)
    return radius * (1 - np.sqrt(1 - (1 - to_end) ** 2))


def loft(
    shape: Shape,
    y: Float[np.ndarray, " n"],
    x: Float[np.ndarray, "n k"],
    z: Float[np.ndarray, "n k"],
    material: Float[np.ndarray, "n-1 k-1"],
) -> None:
    """Skin right-hand sections and their mirror image; `material` is per quad."""
    n, k = x.shape
    right = np.stack([x, np.broadcast_to(y[:, None], x.shape), z], axis=-1).reshape(-1, 3)
    faces = grid_faces(n, k)
    shape.add(right, faces[:, ::-1], material.ravel().astype(int))
    shape.add(right * [-1, 1, 1], faces, material.ravel().astype(int))


def cap(shape: Shape, x: Float[np.ndarray, " k"], y: float, z: Float[np.ndarray, " k"], bulge_m: float) -> None:
    """Close an end with rings that shrink to the section's middle."""
    middle = (z.min() + z.max()) / 2
    rings = np.array([1.0, 0.8, 0.5, 0.0])
    rx = rings[:, None] * x
    rz = middle + rings[:, None] * (z - middle)
    ry = y + bulge_m * (1 - rings[:, None] ** 2) + 0 * rx
    faces = grid_faces(len(rings), len(x))
    points = np.stack([rx, ry, rz], axis=-1).reshape(-1, 3)
    out = bulge_m > 0
    shape.add(points, faces[:, ::-1] if out else faces, PAINT)
    shape.add(points * [-1, 1, 1], faces if out else faces[:, ::-1], PAINT)


FLANK_H = np.array([-0.2, 0.0, 0.22, 0.48, 0.66, 0.84, 1.0])
FLANK_X = np.array([0.93, 0.955, 0.985, 1.0, 1.0, 0.984, 0.958])


def flank(
    model: CarModel, style: Style, y_m: float, share: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """x and z of points on the flank at `y_m`, at these shares of the way from sill to belt."""
    at = np.array([y_m])
    sill, belt = curve(style.sill, at), curve(style.belt, at)
    half = model.width_m / 2 * curve(style.plan, at)
    return half * PchipInterpolator(FLANK_H, FLANK_X)(share), sill + share * (belt - sill)


def lower_body(shape: Shape, model: CarModel, style: Style) -> None:
    """The body up to bonnet, boot and the foot of the windows."""
    y, underside = stations(model, style)
    tail, nose = y[0], y[-1]
    shrink = rounding(y, tail, nose, style.end_radius_m)
    half = model.width_m / 2 * curve(style.plan, y) - shrink
    belt, deck = curve(style.belt, y) - 0.5 * shrink, curve(style.deck, y) - 0.5 * shrink
    sill = curve(style.sill, y)
    bottom = underside + 0.5 * shrink
    outline = PchipInterpolator(FLANK_H, FLANK_X)
    levels = np.array([0.0, 0.06, 0.2, 0.35, 0.5, 0.62, 0.75, 0.88, 1.0])
    lowest = np.minimum(bottom + style.dark_sill_m, belt)
    side_z = np.concatenate([bottom[:, None], lowest[:, None] + levels * (belt - lowest)[:, None]], axis=1)
    side_x = half[:, None] * outline((side_z - sill[:, None]) / (belt - sill)[:, None])
    edge = side_x[:, -1:]
    lift = (deck - belt)[:, None]
    top_x = edge * np.array([0.985, 0.95, 0.88, 0.7, 0.4, 0.0])
    top_z = belt[:, None] + lift * np.array([0.28, 0.55, 0.78, 0.92, 0.98, 1.0])
    if style.bed is not None:
        inside = (y >= style.bed[0]) & (y <= style.bed[1])
        top_x[inside] = edge[inside] - np.array([0.02, 0.06, 0.07, 0.08, 0.4, 0.0]) * [1, 1, 1, 1, 1, 0]
        top_x[inside, -1] = 0
        top_z[inside] = belt[inside, None] * [1, 1, 0, 0, 0, 0] + style.bed[2] * np.array([0, 0, 1, 1, 1, 1])
    x = np.concatenate([np.zeros((len(y), 1)), edge * 0.7, side_x, top_x], axis=1)
    z = np.concatenate([bottom[:, None], bottom[:, None], side_z, top_z], axis=1)
    material = np.full((len(y) - 1, x.shape[1] - 1), PAINT)
    material[:, :3] = TRIM
    if style.bed is not None:
        material[inside[:-1] & inside[1:], -4:] = TRIM
    loft(shape, y, x, z, material)
    cap(shape, x[0], y[0], z[0], -0.005)
    cap(shape, x[-1], y[-1], z[-1], 0.005)


def cabin(shape: Shape, model: CarModel, style: Style) -> None:
    """Pillars, roof and glass."""
    tail, nose = style.roof[-1][0], style.roof[0][0]
    marks = [v for pair in style.windows + style.screens for v in pair] + [k[0] for k in style.roof]
    y = np.unique(np.round(np.concatenate([np.linspace(tail, nose, 24), marks]), 4))
    knots = np.array(sorted(style.roof))
    top = 0.5 * np.interp(y, knots[:, 0], knots[:, 1]) + 0.5 * curve(style.roof, y)
    belt = curve(style.belt, y)
    foot = model.width_m / 2 * curve(style.plan, y) * FLANK_X[-1] * 0.99
    radius = 0.075
    side_top = np.maximum(top - radius, belt - 0.05)
    full = knots[:, 1].max()
    levels = np.stack(
        [
            belt - 0.05,
            belt + 0.015,
            belt + 0.2 * (full - belt),
            belt + 0.4 * (full - belt),
            np.full_like(y, full - radius - 0.045),
            side_top,
        ],
        axis=1,
    )
    side_z = np.minimum(levels, side_top[:, None])
    rise = np.clip((side_z - belt[:, None]) / (full - belt)[:, None], 0, 1)
    side_x = foot[:, None] - style.tumblehome_m * (0.6 * rise + 0.4 * rise**2)
    angle = np.linspace(0, np.pi / 2, 4)[1:]
    height = (top - side_top)[:, None]
    corner_x = side_x[:, -1:] - radius * (1 - np.cos(angle))
    corner_z = side_top[:, None] + height * 0.93 * np.sin(angle)
    seam = corner_x[:, -1:] - 0.02
    across_x = seam * np.array([1.0, 0.8, 0.5, 0.0])
    across_z = side_top[:, None] + height * np.array([0.94, 0.965, 0.99, 1.0])
    x = np.concatenate([side_x, corner_x, across_x], axis=1)
    z = np.concatenate([side_z, corner_z, across_z], axis=1)
    middle = (y[:-1] + y[1:]) / 2
    material = np.full((len(y) - 1, x.shape[1] - 1), PAINT)
    for low, high in (sorted(pair) for pair in style.windows):
        material[(middle > low) & (middle < high), 1:4] = GLASS
    for low, high in (sorted(pair) for pair in style.screens):
        material[(middle > low) & (middle < high), -3:] = GLASS
    loft(shape, y, x, z, material)
