"""Signals and signs of towns as OpenDRIVE's, read again as those of a given map."""

from xml.etree import ElementTree

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, draw_world
from synth3dlanes.formats.opendrive.format import opendrive
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.scene.traffic_elements import TrafficSign, TrafficSignal


def where(item: TrafficSignal | TrafficSign) -> np.ndarray:
    """The middle of its head from above, its lower edge, and the direction of its traffic."""
    along = np.array([np.cos(item.yaw_rad), np.sin(item.yaw_rad)])
    return np.array([*np.array([item.x_m, item.y_m]) + item.reach_m * along, item.height_m, *along])


@pytest.mark.parametrize(
    "overrides", [("town.junction=crossing", "town.control=signals"), ("town.junction=roundabout",)]
)
def test_they_come_back_at_their_places_with_their_lanes(overrides: tuple[str, ...]) -> None:
    plain = ("trees.n=0", "town.fronts=0", "town.traffic=0", "town.turn_lanes=both", "town.n_lanes=2")
    world = draw_world(Scenes(load_params("town", (*overrides, *plain)), 5), 1)
    written = [item for item in world.scene.roadside.free_elements if item.lanes]
    text = opendrive(world, "town")
    given = read_opendrive(text.encode(), "t", "map t")
    ours = {road.get("id"): road.get("name") for road in ElementTree.fromstring(text).iter("road")}
    assert len(given.elements) == len(written) > 3
    assert given.left_out == {}
    for item in written:
        apart = [np.abs(where(item) - where(read.element)).max() for read in given.elements]
        read = given.elements[int(np.argmin(apart))].element
        assert min(apart) < 0.02
        lanes = (lane.split(".", 1) for lane in read.lanes)
        assert {f"{ours[road]}.{number}" for road, number in lanes} == set(item.lanes)
        assert type(read) is type(item)
        name = "form" if isinstance(item, TrafficSignal) else "kind"
        assert getattr(read, name) == getattr(item, name)
