"""Light and colours of paint: what glares or lies in the shade of a kerb is no fault."""

import numpy as np
import pytest

from synth3dlanes.scene.change import change_scene
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.picture import BRIGHTER, _may_glare, brighter
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT

AHEAD_RAD = np.pi / 2


@pytest.mark.parametrize(
    ("zenith_rad", "azimuth_rad", "glares"),
    [(0.96, AHEAD_RAD, True), (0.96, -AHEAD_RAD, False), (0.2, AHEAD_RAD, False), (0.96, AHEAD_RAD + 1.2, False)],
)
def test_a_road_glares_towards_a_sun_ahead_alone(zenith_rad: float, azimuth_rad: float, glares: bool) -> None:
    sun = [f"light.sun_zenith_rad={zenith_rad}", f"light.sun_azimuth_rad={azimuth_rad}"]
    scene = change_scene(FLAT, sun)
    at = np.zeros((scene.camera.height_px, scene.camera.width_px), dtype=bool)
    at[-60, scene.camera.width_px // 2] = True
    assert _may_glare(Evidence(resolve(scene), ground_truth(scene)), at).tolist() == [glares]


def test_paint_is_told_from_the_road_by_how_much_brighter_it_is() -> None:
    road, contrast = np.full(100, 0.2), 3.0
    assert brighter(contrast * road, road, contrast) == pytest.approx(contrast)
    assert brighter(road[:70], road, contrast) < BRIGHTER
    assert np.isinf(brighter(road, np.full(100, 0.9), contrast)), "in glare"
    assert np.isinf(brighter(road, np.repeat([0.05, 0.2], 50), contrast)), "in the edge of a shadow"
