"""Road works: cones, barrels and barricades. Origin on the ground in the middle, facing +y, metres."""

import numpy as np
from riders import LAMP, TRIM
from shapes import Shape, lathe_x, rounded_box

from synth3dlanes.scene.things import ThingKind

ORANGE, WHITE, RED = 11, 12, 13


def turned_up(shape: Shape, profile: list[tuple[float, float]], bands: list[int], sides: int) -> None:
    """Turn a profile of (height, radius) about the vertical; each step of it has a material."""
    vertices, faces = lathe_x(np.array(profile), sides, (0.0, 0.0, 0.0))
    # x becomes z, and y, z become x, y.
    shape.add(vertices[:, [1, 2, 0]], faces, np.repeat(bands, sides))


def cone(height_m: float) -> Shape:
    """A cone on a square foot, orange with two white bands."""
    shape = Shape()
    foot_m = 0.5 * height_m
    shape.add(*rounded_box((0, 0, 0.02), (foot_m, foot_m, 0.04), 0.015, 1), TRIM)

    def at(share: float) -> tuple[float, float]:
        return 0.04 + share * (height_m - 0.04), foot_m * (0.40 - 0.33 * share)

    profile = [at(share) for share in (0.0, 0.28, 0.48, 0.62, 0.80, 0.98)] + [(height_m, 0.02), (height_m, 0.0)]
    turned_up(shape, profile, [ORANGE, WHITE, ORANGE, WHITE, ORANGE, ORANGE, ORANGE], 20)
    return shape


def barrel() -> Shape:
    """A drum, orange and white, on a black foot."""
    shape = Shape()
    turned_up(shape, [(0.0, 0.0), (0.0, 0.36), (0.10, 0.36), (0.12, 0.29)], [TRIM, TRIM, TRIM], 20)
    heights, bands = (0.12, 0.30, 0.46, 0.62, 0.78, 0.94), [ORANGE, WHITE, ORANGE, WHITE, ORANGE]
    profile = [(z, 0.29 - 0.06 * (z - 0.12)) for z in heights]
    turned_up(shape, [*profile, (0.99, 0.16), (1.0, 0.05), (1.0, 0.0)], [*bands, ORANGE, ORANGE, ORANGE], 20)
    return shape


def barricade() -> Shape:
    """Two boards across, with red and white fields, on two stands, with a lamp."""
    shape = Shape()
    for x in (-0.62, 0.62):
        shape.add(*rounded_box((x, 0, 0.04), (0.09, 0.60, 0.08), 0.02, 1), TRIM)
        shape.add(*rounded_box((x, 0, 0.52), (0.05, 0.05, 0.96), 0.01, 1), WHITE)
    for z in (0.42, 0.85):
        for i in range(8):
            shape.add(*rounded_box((-0.7 + 0.2 * i, 0.04, z), (0.2, 0.03, 0.25), 0.004, 1), RED if i % 2 else WHITE)
    shape.add(*rounded_box((0.62, 0.0, 1.08), (0.16, 0.08, 0.17), 0.05), LAMP)
    return shape


def works() -> dict[ThingKind, list[tuple[str, Shape]]]:
    """All meshes of road works by kind and name."""
    return {
        "cone": [("cone.0", cone(0.75)), ("low_cone.0", cone(0.5))],
        "barrel": [("barrel.0", barrel())],
        "barricade": [("barricade.0", barricade())],
    }
