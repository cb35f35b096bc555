"""Ids in OpenDRIVE files are whole numbers, as CARLA takes them, and name one thing each."""

from collections import Counter
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from synth3dlanes.draw.on_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.formats.opendrive.described import numbered
from synth3dlanes.formats.opendrive.format import opendrive
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.world.world import World
from tests.formats.test_on_maps import TOWN
from tests.maps import files
from tests.maps.test_round_trip import forks
from tests.thorough import first

# What an id names, and which of its names are one kind: by the number alone CARLA tells a road from a junction.
KINDS = {"road": "road", "junction": "road", "signal": "signal", "object": "object", "controller": "controller"}
REFERENCES = ("elementId", "incomingRoad", "connectingRoad", "linkedRoad", "high", "low")
CROSSING = ("town.junction=crossing", "town.control=signals", "town.crosswalks=true", "town.walkway_m=2.6", *TOWN[1:])


def on_forks() -> World:
    given = read_opendrive(files.opendrive(*forks()), "forks.xodr", "map forks.xodr")
    return sample_world(replace(Scenes(load_params("streets"), 5, "round"), map=MapPlace(given)), 0)


def of_preset(preset: str, *changes: str) -> World:
    return sample_world(Scenes(load_params(preset, changes), 5, "round"), 0)


WORLDS = {
    "crossing": lambda: of_preset("town", *CROSSING),
    "direct junction of a given map": on_forks,
    "paper": lambda: of_preset("appendix_i", "road.topology=2"),
    "roundabout": lambda: of_preset(
        "town", "town.junction=roundabout", "town.crosswalks=true", "town.walkway_m=2.6", *TOWN[1:]
    ),
    "streets": lambda: of_preset("streets", "road.topology=3", "symbols.crosswalks=1"),
}


@pytest.mark.parametrize("name", first(3, WORLDS))
def test_ids_are_whole_numbers_of_one_thing_and_references_lead_there(name: str) -> None:
    root = ElementTree.fromstring(opendrive(WORLDS[name](), "test"))
    ids = Counter((KINDS[at.tag], at.get("id", "")) for at in root.iter() if at.tag in KINDS)
    assert all(number == str(int(number)) and 0 <= int(number) < 2**31 for _, number in ids)
    assert set(ids.values()) == {1}
    of_roads = {number for kind, number in ids if kind == "road"}
    named = {value for at in root.iter() for key, value in at.items() if key in REFERENCES}
    named |= {at.get("junction", "") for at in root.iter("road")} - {"-1"}
    assert named <= of_roads
    assert {at.get("id") for at in root.iter("signalReference")} <= {number for kind, number in ids if kind == "signal"}


def test_numbers_are_kept_and_others_get_those_that_are_free() -> None:
    assert numbered(["7", "s0", "2", "s1", "007", "-1"]) == {
        "7": "7",
        "s0": "1",
        "2": "2",
        "s1": "3",
        "007": "4",
        "-1": "5",
    }
    assert numbered(["7", "j0"], ["7", "1"]) == {"7": "2", "j0": "3"}


@pytest.mark.parametrize("name", first(1, ("crossing", "roundabout")))
def test_crosswalks_come_back_where_they_are(name: str) -> None:
    world = WORLDS[name]()
    text = opendrive(world, "test")
    given = read_opendrive(text.encode(), "test.xodr", "map test.xodr")
    ours = [np.array(paint.outline) for paint in world.scene.map.paint if paint.kind == "crosswalk"]
    found = [np.array(paint.outline) for paint in given.paint if paint.kind == "crosswalk"]
    assert len(found) == len(ours) > 0
    for outline in ours:
        apart = [np.linalg.norm(outline[:, None] - other, axis=2).min(axis=1).max() for other in found]
        assert min(apart) < 0.02
    root = ElementTree.fromstring(text)
    crosswalks = [item for item in root.iter("object") if item.get("type") == "crosswalk"]
    assert all(item.find("outline/cornerLocal") is not None for item in crosswalks), "where CARLA looks"
