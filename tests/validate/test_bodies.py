"""The bodies that checks know, against the meshes that are rendered."""

import numpy as np
import pytest

from synth3dlanes.scene.assets.catalogue import CARS
from synth3dlanes.validate.bodies import CORE_HEIGHT, CORE_SIDES

pytest.importorskip("bpy")
pytestmark = pytest.mark.render


def test_nobody_sees_through_the_core_of_a_car() -> None:
    """From either side, straight and aslant."""
    from synth3dlanes.blender.load_assets import load_assets
    from synth3dlanes.blender.occlusion import search_tree

    for car, mesh in zip(CARS, load_assets().cars, strict=True):
        half = np.array([car.width_m, car.length_m]) / 2
        y = np.linspace(CORE_SIDES[0][1], CORE_SIDES[1][1], 12) * half[1]
        z = np.linspace(*CORE_HEIGHT, 5) * car.height_m
        targets = np.stack([np.zeros(60), *(axis.ravel() for axis in np.meshgrid(y, z))], -1)
        for direction in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.95, 0.3, 0.0), (-0.95, -0.3, 0.0)):
            towards = np.array(direction) / np.linalg.norm(direction)
            hits = [search_tree(mesh.name).ray_cast(at - 20 * towards, towards, 20.0)[0] for at in targets]
            assert all(hit is not None for hit in hits), (car.name, direction)
