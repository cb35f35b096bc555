"""The ground is closed: no sky below it in any column of a picture, and no terrain seen through its pavement."""

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.params import load_params
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.world.world import World
from tests.thorough import first

pytestmark = pytest.mark.render

GROUND = [SEMANTIC_IDS[name] for name in ("terrain", "road", "shoulder", "marking", "symbol")]


def sky_below_ground(world: World) -> int:
    """How many pixels of sky lie below a pixel of ground in their columns."""
    semantic = take_picture(world, RenderSettings(samples=1, passes=("semantic",))).passes["semantic"]
    below = np.maximum.accumulate(np.isin(semantic, GROUND), axis=0)
    return int((below & (semantic == SEMANTIC_IDS["sky"])).sum())


@pytest.mark.parametrize("index", first(0, [39, 6]))
def test_a_town_has_no_holes(index: int) -> None:
    assert sky_below_ground(sample_world(Scenes(load_params("town"), 7001), index)) == 0


@pytest.mark.thorough
def test_the_terrain_is_not_seen_through_the_pavement_of_a_town() -> None:
    """Strips of roads and areas of junctions meet: a gap between them shows the terrain under both. Single pixels at
    their borders may."""
    world = sample_world(Scenes(load_params("town"), 2611), 0)
    picture = take_picture(world, RenderSettings(samples=1, passes=("semantic", "depth")))
    is_terrain = picture.passes["semantic"] == SEMANTIC_IDS["terrain"]
    v, u = np.nonzero(is_terrain & (picture.passes["depth"] < 60))
    points_cam = picture.labels.camera.points(np.column_stack([u, v]) + 0.5, picture.passes["depth"][v, u])
    xy = transform(world.view.world_from_cam, points_cam)[:, :2]
    assert len(xy) > 1000
    assert (-world.ground.clearance(xy) > 0.2).sum() <= 1
