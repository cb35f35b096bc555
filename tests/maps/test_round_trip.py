"""Scenes written as OpenDRIVE and read back as maps: the same lanes in the same places, and the same graph."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial import cKDTree

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.formats.opendrive import opendrive
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.cross_section import CrossSection
from synth3dlanes.roads.line_forms import plan_line
from synth3dlanes.roads.maps.given_map import GivenMap, LanePlace, read_opendrive
from synth3dlanes.system.arrays import Points3
from synth3dlanes.world.world import World
from tests.maps.files import lane, link, plan, road, section
from tests.maps.files import opendrive as file_of
from tests.thorough import first

PRESETS = ("streets", "town", "appendix_i", "diverse", "realistic")
NEAR_M, HEIGHT_M, STEEP = 0.02, 0.03, 0.4


def segments(text: str, given: GivenMap) -> dict[str, str]:
    """The segments of our lane graph by the names of a map's lanes."""
    return {
        f"{given.names[str(road.get('id'))]}.{i}.{lane.get('id')}": str(data.get("value"))
        for road in ElementTree.fromstring(text).iter("road")
        for i, part in enumerate(road.iter("laneSection"))
        for lane in part.iter("lane")
        for data in lane.iter("userData")
    }


def middle(place: LanePlace) -> Points3:
    """Points of the middle of a lane of a map."""
    (low, high), section = place.span_m, CrossSection.of(place.road, place.section)
    s = np.linspace(low, high, 3 + int(high - low))
    edges, k = section.edges(s), section.n_left - place.lane.number
    t = (edges[k] + edges[k + np.sign(place.lane.number)]) / 2
    z = section.height(s, t) if place.road.heights else 0 * s
    return np.column_stack([plan_line(place.road.plan).xy(s, t), z])[1:-1]


def off(points: Points3, world: World, segment: str) -> tuple[float, float]:
    """How far points are from the middle of a lane of a world, from above and in height."""
    lane = world.network.lanes[segment]
    own = world.network.road(lane.road)
    ends = np.clip([lane.start_m, lane.end_m], -270.0, 270.0) if world.scene.map is None else (lane.start_m, lane.end_m)
    s = np.linspace(*ends, 10 + int(20 * (ends[1] - ends[0])))
    line = own.base_points(s, lane.middle(s)) if world.scene.map is not None else own.points(s, lane.middle(s))
    apart, nearest = cKDTree(line[:, :2]).query(points[:, :2])
    step = float(np.max(np.hypot(*np.diff(line[:, :2], axis=0).T)))
    aside = np.sqrt(np.maximum(apart**2 - (step / 2) ** 2, 0.0))
    # The paper's steepest ramps climb by more than their length; a rolled plane there moves places along the road.
    along = np.hypot(*np.gradient(line[:, :2], axis=0).T)
    level = np.abs(np.gradient(line[:, 2]))[nearest] < STEEP * along[nearest]
    return float(aside.max()), float(np.abs(points[:, 2] - line[nearest, 2])[level].max(initial=0.0))


def check_lanes(world: World, given: GivenMap, names: Mapping[str, str]) -> None:
    """Compare the lanes and links of a world with those of a map, whose lanes are these of the world."""
    assert set(names) == set(given.lanes)
    assert set(names.values()) == set(world.network.lanes)
    graph = {(names[a], names[b]) for a, b in given.links}
    assert {(a, b) for a, b in graph if a != b} == {(a, b) for a, b in world.network.links if a != b}
    yields = {(names[a], names[b]) for at in given.junctions for a, b in at.yields if {a, b} <= set(names)}
    assert yields == set(world.network.yields or ())
    for name, place in given.lanes.items():
        aside_m, height_m = off(middle(place), world, names[name])
        assert aside_m < NEAR_M, name
        assert height_m < HEIGHT_M, name


def check(world: World) -> None:
    """Write a world, read the file, and compare."""
    text = opendrive(world, "scene")
    given = read_opendrive(text.encode(), "scene.xodr", "map scene.xodr")
    check_lanes(world, given, segments(text, given))


@pytest.mark.parametrize("preset", first(1, PRESETS))
def test_scenes_of_presets_come_back(preset: str) -> None:
    for index in range(2):
        check(sample_world(Scenes(load_params(preset), 5, "round"), index))


@pytest.mark.parametrize("kind", first(1, ("lane_closed", "lanes_shifted", "lanes_narrowed", "shoulder_closed")))
def test_road_works_come_back_with_the_links_of_their_lanes(kind: str) -> None:
    given = "works.present=true", f"works.kind={kind}", "road.topology=1", "road.n_lanes=3"
    params = load_params("streets", given)
    flips = set()
    for index in range(2):
        world = sample_world(Scenes(params, 11, "works"), index)
        flips.add((world.scene.paper_road.flip_lateral, world.scene.paper_road.flip_longitudinal))
        check(world)
    assert len(flips) > 1, "roads that are mirrored and that are not"


def forks() -> Iterator[str]:
    """A road that parts into two without a connecting road."""
    on = section(lane(-1, link='<predecessor id="-1"/>'))
    yield road(
        plan(("<line/>", 120.0), ('<spiral curvStart="0" curvEnd="0.01"/>', 60.0)),
        section(lane(-1), lane(-2), lane(1)),
        "1",
        link=link(after="9"),
        profile='<lateralProfile><superelevation s="0" a="0.05" b="0.0004" c="0" d="0"/></lateralProfile>',
    )
    yield '<junction id="9" type="direct"><connection id="0" incomingRoad="1" linkedRoad="2" contactPoint="start">'
    yield '<laneLink from="-1" to="-1"/></connection>'
    yield '<connection id="1" incomingRoad="1" linkedRoad="3" contactPoint="start"><laneLink from="-2" to="-1"/>'
    yield "</connection></junction>"
    for name, y in (("2", 2.0), ("3", -2.0)):
        pieces = plan((f'<arc curvature="{y / 1000}"/>', 150.0), start=(179.6, 6.0 + y, 0.3))
        yield road(pieces, on, name, link=link(before="9"))


def test_given_maps_come_back_with_banks_and_direct_junctions() -> None:
    given = read_opendrive(file_of(*forks()), "forks.xodr", "map forks.xodr")
    assert set(given.links) == {("1.0.-1", "2.0.-1"), ("1.0.-2", "3.0.-1")}
    scenes = replace(Scenes(load_params("streets"), 5, "round"), map=MapPlace(given))
    for index in range(2):
        check(sample_world(scenes, index))


def test_two_roads_that_lead_to_two_come_back_with_all_four_links() -> None:
    """One direct junction, not one for each road that parts, of which the last would take the ends."""
    ends = [("1", 100.0, 0.0), ("4", 100.0, 0.1), ("2", 150.0, 0.0), ("3", 150.0, 0.1)]
    parts = []
    for name, length, turn in ends:
        x, y = (-length * np.cos(turn), -length * np.sin(turn)) if name in "14" else (0.0, 0.0)
        links = link(after="9") if name in "14" else link(before="9")
        parts.append(road(plan(("<line/>", length), start=(x, y, turn)), section(lane(-1)), name, link=links))
    parts.append('<junction id="9" type="direct">')
    for i, (one, other) in enumerate(product("14", "23")):
        at = f'<connection id="{i}" incomingRoad="{one}" linkedRoad="{other}" contactPoint="start">'
        parts.append(f'{at}<laneLink from="-1" to="-1"/></connection>')
    given = read_opendrive(file_of(*parts, "</junction>"), "two.xodr", "map two.xodr")
    assert set(given.links) == {(f"{one}.0.-1", f"{other}.0.-1") for one, other in product("14", "23")}
    check(sample_world(replace(Scenes(load_params("streets"), 5, "round"), map=MapPlace(given)), 0))


@pytest.mark.parametrize(("told", "minor"), [("", "7"), ('direction="reversed"', "8")])
def test_lanes_against_their_side_come_back_in_a_version_that_knows_them(told: str, minor: str) -> None:
    roads = road(plan(("<line/>", 300.0)), section(lane(1, more=told), lane(-1)), "1")
    given = read_opendrive(file_of(roads), "one.xodr", "map one.xodr")
    world = sample_world(replace(Scenes(load_params("streets"), 5, "round"), map=MapPlace(given)), 0)
    check(world)
    text = opendrive(world, "scene")
    header = ElementTree.fromstring(text).find("header")
    assert header is not None
    assert (header.get("revMinor"), told in text) == (minor, True)
    back = read_opendrive(text.encode(), "scene.xodr", "map scene.xodr").lanes
    assert {name: place.ascends for name, place in back.items()} == {"1.0.1": bool(told), "1.0.-1": True}
