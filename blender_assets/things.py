"""People, riders and road works: their materials, and all of their meshes by kind."""

import numpy as np
from people import people
from riders import riders
from shapes import Shape
from works import works

from synth3dlanes.scene.things import ThingKind

Coat = tuple[tuple[float, float, float], float, float, float]
# In the order of the numbers in `bodies`, `riders` and `works`: the paint of the object that it has, or else its linear
# reflectance, roughness, and the share and index of a coat.
MATERIALS: tuple[tuple[str, int | Coat], ...] = (
    ("upper", 0),
    ("lower", 1),
    ("skin", 2),
    ("hair", 3),
    ("trim", ((0.02, 0.02, 0.021), 0.5, 0.5, 1.4)),
    ("own", 4),
    ("tyre", ((0.022, 0.022, 0.023), 0.6, 0.5, 1.3)),
    ("metal", ((0.28, 0.28, 0.29), 0.3, 1.0, 2.2)),
    ("glass", ((0.012, 0.014, 0.015), 0.03, 1.0, 1.55)),
    ("lamp", ((0.62, 0.60, 0.52), 0.1, 1.0, 1.6)),
    ("tail", ((0.36, 0.008, 0.010), 0.1, 1.0, 1.5)),
    ("orange", ((0.70, 0.13, 0.012), 0.5, 0.5, 1.4)),
    ("white", ((0.72, 0.72, 0.70), 0.45, 0.5, 1.4)),
    ("red", ((0.48, 0.016, 0.018), 0.45, 0.5, 1.4)),
)


def build_things() -> dict[ThingKind, list[tuple[str, Shape]]]:
    """All meshes of the catalogue, a pose each, the middle of all poses of a model over the origin."""
    found: dict[ThingKind, list[tuple[str, Shape]]] = {"pedestrian": people(), **riders(), **works()}
    for shapes in found.values():
        poses: dict[str, list[Shape]] = {}
        for name, shape in shapes:
            poses.setdefault(name.rsplit(".", 1)[0], []).append(shape)
        for own in poses.values():
            points = np.concatenate([part for shape in own for part in shape.vertices])
            middle = (points.min(axis=0) + points.max(axis=0)) / 2 * [1, 1, 0]
            for shape in own:
                shape.vertices = [part - middle for part in shape.vertices]
    return found
