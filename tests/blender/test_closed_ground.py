"""No sky below the ground: in no column of a picture of a town or of roads over each other."""

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
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
