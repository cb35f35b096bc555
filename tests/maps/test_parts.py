"""The part of a map that a scene keeps: the same roads in the world's frame, a route that goes on, and places of the
host by length or as told."""

import pickle
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import value
from synth3dlanes.roads.maps.furniture import edges_at, section_index
from synth3dlanes.roads.maps.given_map import GivenMap, read_opendrive
from synth3dlanes.roads.maps.part import KEPT_M, part_around
from synth3dlanes.roads.maps.places import MapStation, draw_place, read_place
from synth3dlanes.roads.maps.plan import places
from synth3dlanes.scene.road_map import MapRoad, RoadMap
from synth3dlanes.system.errors import InputError
from tests.maps.files import lane, opendrive, plan, road, section

ON = '<predecessor id="{0}"/><successor id="{0}"/>'
CLIMB = "".join(
    f'<elevation s="{s}" a="{a}" b="{b}" c="{c}" d="0"/>' for s, a, b, c in [(0, 40, 0.02, 0), (900, 58, 0, 0.0001)]
)
WIDE = '<width sOffset="0" a="3" b="0" c="0" d="0"/><width sOffset="300" a="3" b="0.001" c="0" d="0"/>'


def link(before: str = "", after: str = "") -> str:
    """The links of a road to others, as NAME:CONTACT."""
    texts = []
    for tag, text in (("predecessor", before), ("successor", after)):
        name, _, contact = text.partition(":")
        if text:
            texts.append(f'<{tag} elementType="road" elementId="{name}" contactPoint="{contact}"/>')
    return "".join(texts)


def lanes() -> str:
    """Two lanes in sections of which the second one begins 700 m on."""
    return "".join(
        section(lane(1, WIDE, link=ON.format(1)), lane(-1, WIDE, link=ON.format(-1)), s=s) for s in (0.0, 700.0)
    )


def long_map() -> GivenMap:
    """A road of 2.4 km with bends, and one of 300 m that goes on from it, in UTM-like coordinates."""
    pieces = [
        ("<line/>", 800.0),
        ('<arc curvature="0.001"/>', 800.0),
        ('<spiral curvStart="0.001" curvEnd="0"/>', 800.0),
    ]
    start = (4_500_120.0, 5_400_340.0, 0.6)
    first = road(
        plan(*pieces, start=start),
        lanes(),
        "7",
        link=link(after="8:start"),
        profile=f"<elevationProfile>{CLIMB}</elevationProfile>",
    )
    only = read_opendrive(opendrive(first), "a.xodr", "map a.xodr")
    x, y, heading = plan_points(only.roads["7"].plan, np.array([2400.0]))[0]
    end = (x + only.origin[0], y + only.origin[1], heading)
    on = section(lane(1, link=ON.format(1)), lane(-1, link=ON.format(-1)))
    second = road(plan(("<line/>", 300.0), start=end), on, "8", link=link(before="7:end"))
    return read_opendrive(opendrive(first, second), "a.xodr", "map a.xodr")


LONG = long_map()


def in_file(part: RoadMap, xy_world: np.ndarray) -> np.ndarray:
    """Coordinates of the file of places in the world."""
    assert part.given_frame is not None
    x, y, _, turn = part.given_frame
    cos, sin = np.cos(turn), np.sin(turn)
    return xy_world @ np.array([[cos, sin], [-sin, cos]]) + [x, y]


def surface(road: MapRoad, s: float) -> dict[int, np.ndarray]:
    """(x, y, z) of the outer edge of every lane."""
    z = value(road.heights, s)
    found = {}
    for at, _, outer in edges_at(road, section_index(road, s), s):
        found[at.number] = np.append(places(road.plan, np.array([s]), np.array([outer]))[0], z)
    return found


@pytest.mark.parametrize("station", [5.0, 1300.0, 2390.0])
def test_a_part_is_the_map_in_another_frame_and_names_its_stations(station: float) -> None:
    at = MapStation(f"7.{int(station > 700)}.-1", station)
    part, *_ = part_around(LONG, at, np.random.default_rng(1))
    kept = {found.id: found for found in part.roads}
    cut = kept["7"]
    assert (cut.given_from_m, cut.given_section) == {5.0: (0, 0), 1300.0: (800, 1), 2390.0: (1600, 1)}[station]
    for s in np.linspace(cut.given_from_m + 0.5, cut.given_from_m + cut.length_m - 0.5, 9):
        wanted, found = surface(LONG.roads["7"], s), surface(cut, s - cut.given_from_m)
        assert sorted(found) == sorted(wanted) == [-1, 1]
        for number, place in found.items():
            file = in_file(part, place[None, :2])[0]
            assert np.abs(file - wanted[number][:2] - LONG.origin).max() < 1e-5
            assert place[2] + part.given_frame[2] == pytest.approx(wanted[number][2], abs=1e-5)
    assert ("8" in kept) == (station > 1800)


def test_the_world_begins_at_the_host_and_looks_along_its_lane() -> None:
    for number, sign in ((-1, 1), (1, -1)):
        part, *_ = part_around(LONG, MapStation(f"7.0.{number}", 300.0), np.random.default_rng(1))
        x, y, heading = plan_points(part.roads[0].plan, np.array([300.0]))[0]
        assert np.hypot(x, y) < 1e-3
        assert np.cos(heading - sign * np.pi / 2) == pytest.approx(1)
        assert value(part.roads[0].heights, 300.0) == pytest.approx(0, abs=1e-3)


def test_a_route_follows_links_behind_and_ahead() -> None:
    part, number, s_m, *_ = part_around(LONG, MapStation("7.1.-1", 2390.0), np.random.default_rng(1))
    assert (part.route, number) == (("7.0.-1", "8.0.-1"), 0)
    assert s_m + part.roads[0].given_from_m == pytest.approx(2390)
    against, number, *_ = part_around(LONG, MapStation("8.0.1", 290.0), np.random.default_rng(1))
    assert (against.route, number) == (("8.0.1", "7.0.1"), 0)
    behind, number, *_ = part_around(LONG, MapStation("8.0.-1", 10.0), np.random.default_rng(1))
    assert (behind.route, number) == (("7.0.-1", "8.0.-1"), 1)


def fork() -> GivenMap:
    """A road that goes on to a short one without an end of its own, and to a long one."""
    on = section(lane(-1, link='<predecessor id="-1"/>'))
    stem = section(lane(-1))
    parts = [
        road(plan(("<line/>", 100.0)), stem, "1", link='<successor elementType="junction" elementId="9"/>'),
        road(plan(("<line/>", 30.0), start=(100.0, 0.0, 0.0)), on, "2", link=link(before="1:end")),
        road(plan(("<line/>", 400.0), start=(100.0, 0.0, 0.3)), on, "3", link=link(before="1:end")),
        road(plan(("<line/>", 500.0), start=(100.0, 0.0, 0.6)), on, "4", link=link(before="1:end")),
    ]
    return read_opendrive(opendrive(*parts), "fork.xodr", "map fork.xodr")


def test_where_ways_part_each_that_goes_on_far_enough_is_taken() -> None:
    given = fork()
    taken = Counter(
        part_around(given, MapStation("1.0.-1", 40.0), np.random.default_rng(seed)).map.route[-1] for seed in range(60)
    )
    assert set(taken) == {"3.0.-1", "4.0.-1"}
    assert min(taken.values()) > 15


def test_places_are_drawn_by_length_where_the_way_goes_on() -> None:
    given, rng = fork(), np.random.default_rng(3)
    drawn = [draw_place(given, rng) for _ in range(600)]
    by_road = Counter(at.lane[0] for at in drawn)
    # Of the places from which 250 m are left: 100 m of road 1, 150 m of road 3, 250 m of road 4.
    assert {name: by_road[name] / 600 for name in "134"} == pytest.approx({"1": 0.2, "3": 0.3, "4": 0.5}, abs=0.07)
    assert "2" not in by_road
    short = read_opendrive(opendrive(road(plan(("<line/>", 60.0)))), "s.xodr", "map s.xodr")
    assert {draw_place(short, rng).lane for _ in range(20)} == {"1.0.1", "1.0.-1"}


def test_a_ring_goes_on_and_ends() -> None:
    ring = road(
        plan(('<arc curvature="0.05"/>', 40 * np.pi)),
        section(lane(-1, link=ON.format(-1))),
        link=link("1:end", "1:start"),
    )
    given = read_opendrive(opendrive(ring), "ring.xodr", "map ring.xodr")
    part, *_ = part_around(given, MapStation("1.0.-1", 3.0), np.random.default_rng(1))
    assert 4 <= len(part.route) < 12
    assert all(pair == ("1.0.-1", "1.0.-1") for pair in pairwise(part.route))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("7", "expected ROAD:s:lane"),
        ("7:x:-1", "expected ROAD:s:lane"),
        ("70:5:-1", "expected a road of a.xodr, got '70'"),
        ("7:nan:-1", "expected a station of road 7 from 0 to 2400.00, got nan"),
        ("7:2401:-1", "expected a station of road 7 from 0 to 2400.00, got 2401"),
        ("7:20:-2", r"expected a driving lane of road 7 there \(1, -1\), got -2"),
        ("7:20:0", "expected a driving lane"),
    ],
)
def test_a_place_that_is_not_there(text: str, message: str) -> None:
    with pytest.raises(InputError, match=f"^at: {message}"):
        read_place(LONG, text)


def test_a_place_as_told() -> None:
    assert read_place(LONG, "7:900.5:-1") == MapStation("7.1.-1", 900.5)


def test_far_roads_are_left_out() -> None:
    far = road(plan(("<line/>", 90.0), start=(0.0, KEPT_M + 50, 0.0)), name="far")
    near = road(plan(("<line/>", 90.0), start=(0.0, KEPT_M - 50, 0.0)), name="near")
    given = read_opendrive(opendrive(road(plan(("<line/>", 90.0))), far, near), "x.xodr", "map x.xodr")
    part, *_ = part_around(given, MapStation("1.0.-1", 45.0), np.random.default_rng(1))
    assert {found.id for found in part.roads} == {"1", "near"}


def test_a_process_reads_a_map_once_however_often_it_is_sent_to_it() -> None:
    given = long_map()
    sent = pickle.dumps(given)
    assert len(sent) < 3000
    here, again = pickle.loads(sent), pickle.loads(sent)
    assert here is again
    assert (here.text(), here.digest, here.roads, here.links) == (given.text(), given.digest, given.roads, given.links)
    assert pickle.loads(pickle.dumps(here)) is here
