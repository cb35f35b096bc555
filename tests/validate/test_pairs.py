"""Double lines of a solid and a dashed stripe, as rendered and as checked."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.labels.labels import Labels, Pair
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import resolve
from tests.scenes import changed, flat_road_places
from tests.validate.examining import findings, reasons

OTHER: dict[Pair, Pair] = {"solid_dashed": "dashed_solid", "dashed_solid": "solid_dashed"}
CHECKS = ("labels", "points", "ridges", "appearance", "alignment", "ids")


def relabelled(labels: Labels, pair: Pair) -> Labels:
    return replace(labels, lanes=tuple(replace(lane, pair=lane.pair and pair) for lane in labels.lanes))


def repainted(scene: Scene, pair: str) -> Scene:
    return changed(scene, markings={"left_pair": pair})


@pytest.mark.render
@pytest.mark.parametrize(
    ("pair", "road"),
    [("solid_dashed", {}), ("dashed_solid", {"flip_longitudinal": True, "n_oncoming": 1})],
)
def test_the_picture_has_each_stripe_on_its_side_and_a_swap_is_found(pair: Pair, road: dict[str, object]):
    markings = {"left_double": True, "width_m": 0.2, "dash_cycle_m": 6, "dash_fraction": 0.4}
    lane = 3 if road else 1
    scene = repainted(changed(road=road, markings=markings, camera={"lane": lane}), pair)
    made = take_picture(resolve(scene), RenderSettings(samples=1, passes=("depth", "semantic", "instance")))
    (line,) = (lane for lane in made.labels.lanes if lane.pair)
    assert (line.xyz_cam[0, 0] > 0) == bool(road), "left-hand traffic has the divider on its right"
    x_m, y_m = flat_road_places(scene)
    near = (y_m > 4) & (y_m < 22) & (np.abs(x_m) < 4)
    brightness = made.image.mean(axis=2)
    road_gray = np.median(brightness[near & (made.passes["semantic"] == 2)])
    painted = {}
    for side, name in zip((-0.2, 0.2), pair.split("_"), strict=True):
        stripe = near & (np.abs(x_m - line.xyz_cam[0, 0] - side) < 0.05)
        steps = np.floor(y_m[stripe] / 0.5).astype(int)
        bright = np.bincount(steps, brightness[stripe] > 1.5 * road_gray) / np.maximum(np.bincount(steps), 1)
        painted[name] = bright[8:44][np.bincount(steps)[8:44] > 0] > 0.5
    assert painted["solid"].all()
    assert 0.3 < painted["dashed"].mean() < 0.5
    picture = made.image, made.passes
    assert findings(Evidence(resolve(scene), made.labels, *picture), *CHECKS) == []
    swapped = relabelled(made.labels, OTHER[pair])
    assert f'pair: expected "{pair}", got "{OTHER[pair]}"' in reasons(
        Evidence(resolve(scene), swapped, *picture), "labels"
    )
    other = Evidence(resolve(repainted(scene, OTHER[pair])), swapped, *picture)
    assert "expected paint where the line is painted" in reasons(other, "ids")
    both = Evidence(resolve(repainted(scene, "same")), made.labels, *picture)
    assert "of the line in all of its paint" in reasons(both, "ids"), "a stripe that ought to be solid has gaps"
