"""Roads over roads of given maps: what is seen below a bridge, and the heights there."""

import numpy as np
import pytest

from synth3dlanes.geometry.height_map import height_map
from synth3dlanes.ground_truth import ground_truth
from synth3dlanes.labels import Labels
from synth3dlanes.maps.given_map import read_opendrive
from synth3dlanes.maps.places import read_place
from synth3dlanes.params import load_params
from synth3dlanes.sample import Scenes, sample_world
from synth3dlanes.sampling.on_map import MapPlace
from synth3dlanes.world import World
from tests.maps.files import TWO, opendrive, plan, road

EAST, NORTH = plan(("<line/>", 400.0)), plan(("<line/>", 400.0), start=(200.0, -200.0, np.pi / 2))
# Up to 6 m over the other road, 40 m long, and down again.
OVER = ((0, 0, 0), (40, 0, 0.05), (160, 6, 0), (240, 6, -0.05), (360, 0, 0))
PROFILE = "".join(f'<elevation s="{s}" a="{a}" b="{b}" c="0" d="0"/>' for s, a, b in OVER)


def at(place: str) -> tuple[World, Labels]:
    """A scene at a place of a file in which road 2 passes over road 1, on level ground."""
    over = road(NORTH, TWO, "2", profile=f"<elevationProfile>{PROFILE}</elevationProfile>")
    given = read_opendrive(opendrive(road(EAST, TWO, "1"), over), "t", "map t")
    params = load_params("streets", ("cars.n=0", "trees.n=0", "terrain.n_gaussians=1", "terrain.magnitude_m=0"))
    world = sample_world(Scenes(params, 1, map=MapPlace(given, read_place(given, place))), 0)
    return world, ground_truth(world.scene)


def test_the_lower_road_is_seen_through_below_the_deck_which_hides_the_upper_one() -> None:
    _, labels = at("1:160:-1")
    lanes = {lane.id: lane for lane in labels.lanes}
    assert lanes["1.0.-1"].xyz_cam[-1, 1] > 100
    assert lanes["1.0.-1"].terrain_visible[:-2].all()
    # Over the lower road; beside it the embankment hides the upper one.
    upper = lanes["2.0.-1"]
    above = np.abs(upper.xyz_cam[:, 0]) < 3
    assert above.any()
    assert not upper.terrain_visible[above].any()


def test_from_the_bridge_the_lower_road_is_hidden_below_it() -> None:
    world, labels = at("2:150:-1")
    lower = next(lane for lane in labels.lanes if lane.id == "1.0.-1")
    beneath = np.abs(lower.xyz_cam[:, 0]) < 2
    assert beneath.any()
    assert not lower.terrain_visible[beneath].any()
    assert world.view.world_from_road[2, 3] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("place", ["1:180:-1", "2:180:-1"])
def test_the_height_map_is_that_of_the_hosts_road(place: str) -> None:
    world, _ = at(place)
    heights_m = height_map(world.ground, world.view.world_from_road)
    # In the middle columns, from the host to 40 m ahead, past the place where the roads cross.
    assert np.abs(heights_m[100:, 48:52]).max() < 0.05
