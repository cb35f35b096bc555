"""Lanelet2 files as given maps: lanes where lanelets are, what follows what, paint, lights, and hostile files."""

import gzip
import pickle
from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.formats.lanelet2 import lanelet2
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.given_map import GivenMap, LanePlace
from synth3dlanes.roads.maps.lanelet_map import read_lanelet2
from synth3dlanes.roads.maps.lanelet_roads import arcs
from synth3dlanes.roads.maps.read import read_map
from synth3dlanes.scene.traffic_elements import TrafficSign, TrafficSignal
from synth3dlanes.system.errors import FormatError
from synth3dlanes.world.world import World
from tests.formats.test_lanelet2 import SEGMENT, File
from tests.hostile import edited_xml
from tests.maps.lanelet_files import Sheet, along, street
from tests.maps.test_round_trip import check_lanes, middle
from tests.thorough import first


def read(sheet: Sheet | bytes) -> GivenMap:
    data = sheet.data() if isinstance(sheet, Sheet) else sheet
    return read_lanelet2(data, "x.osm", "map x.osm")


def y_of(place: LanePlace) -> float:
    """Where the middle of a lane of a street along x is."""
    return round(float(np.median(middle(place)[:, 1])), 2)


# -- out and in


def segments_of(text: str, given: GivenMap) -> dict[str, str]:
    """The segments of our lane graph by the names of a map's lanes: lanelets are matched by where their traffic enters
    and leaves them."""
    file, found = File(text), {}
    ends = {
        name: np.concatenate([points[0, :2], points[-1, :2]])
        for name, place in given.lanes.items()
        for points in [middle(place)[:: 1 if place.ascends else -1]]
    }
    for lane in (lane for lane in file.lanes if SEGMENT in lane.tags):
        points = file.middle(lane)
        own = np.concatenate([points[0, :2], points[-1, :2]])
        name = min((name for name in ends if name not in found), key=lambda name: float(np.abs(ends[name] - own).max()))
        found[name] = lane.tags[SEGMENT]
    return found


def check(world: World) -> None:
    """Write a world, read the file, and compare lanes, links, yields and what stands there."""
    text, _ = lanelet2(world)
    given = read(text.encode())
    assert given.broken == ()
    assert given.left_out == {}
    names = segments_of(text, given)
    check_lanes(world, given, names)
    if world.scene.map is None:
        return
    wanted = {pair for at in world.scene.map.junctions for pair in at.yields if {*pair} <= set(world.network.lanes)}
    assert {(names[a], names[b]) for at in given.junctions for a, b in at.yields} == wanted
    inside = {names[name] for name, place in given.lanes.items() if place.road.junction is not None}
    assert inside == {lane.id for lane in world.network.lanes.values() if lane.junction is not None}
    kinds = sorted(form.kind for form in world.symbol_shapes)
    assert sorted(paint.kind for paint in given.paint) == kinds
    written = [item for item in world.scene.roadside.free_elements if {*item.lanes} & set(world.network.lanes)]
    assert len(given.elements) == len(written)
    for item in written:
        right = np.array([np.cos(item.yaw_rad), np.sin(item.yaw_rad)])
        head = np.array([item.x_m, item.y_m]) + item.reach_m * right
        alike = [at.element for at in given.elements if type(at.element) is type(item)]
        near = min(alike, key=lambda at: np.hypot(*(head - [at.x_m, at.y_m])) + abs(at.yaw_rad - item.yaw_rad) % 6.28)
        assert np.hypot(*(head - [near.x_m, near.y_m])) < 0.05
        assert np.cos(near.yaw_rad - item.yaw_rad) > 0.999
        assert {names[lane] for lane in near.lanes} == set(item.lanes)
        name = "form" if isinstance(item, TrafficSignal) else "kind"
        assert getattr(near, name) == getattr(item, name)


ROUND = [
    ("streets", 5, 0),
    *(("town", seed, i) for seed in (5, 6, 7) for i in range(4)),
    ("streets", 5, 3),
    ("appendix_i", 5, 2),
]


@pytest.mark.parametrize(("preset", "seed", "index"), first(1, ROUND))
def test_scenes_come_back_with_their_lanes_links_rules_and_paint(preset: str, seed: int, index: int) -> None:
    check(sample_world(Scenes(load_params(preset), seed, "round"), index))


# -- small maps


def test_lanelets_beside_each_other_are_lanes_of_one_road() -> None:
    given = read(street())
    assert given.left_out == {}
    assert len(given.roads) == 2
    road = next(
        road
        for road in given.roads.values()
        if len([lane for lane in road.sections[0].lanes if lane.kind == "driving"]) == 3
    )
    lanes = {f"{road.id}.0.{lane.number}": lane for lane in road.sections[0].lanes if lane.kind == "driving"}
    ys = {y_of(given.lanes[name]): given.lanes[name].ascends for name in lanes}
    assert ys == {1.75: False, -1.75: True, -5.25: True}
    # The way goes east: its left stripe, the solid one, is the road's left one.
    marks = {lane.number: lane.marks[0].kind for lane in road.sections[0].lanes if lane.marks}
    assert marks == {1: "solid", 0: "solid_dashed", -1: "dashed", -2: "solid"}
    ((one, other),) = given.links
    assert (y_of(given.lanes[one]), y_of(given.lanes[other])) == (-1.75, -1.75)
    assert not road.keeps_left


def test_traffic_that_keeps_left_has_its_oncoming_lane_on_the_right() -> None:
    sheet = Sheet()
    lines = {y: sheet.line(along(y), type="line_thin", subtype="dashed") for y in (3.5, 0.0, -3.5)}
    sheet.lanelet(lines[3.5], lines[0.0])
    sheet.lanelet(lines[-3.5], lines[0.0])
    given = read(sheet)
    (road,) = given.roads.values()
    assert road.keeps_left
    found = {y_of(place): place.ascends for place in given.lanes.values()}
    assert found == {1.75: True, -1.75: False}


def test_bounds_may_be_drawn_against_the_traffic_or_against_each_other() -> None:
    for turned in ((False, True), (True, False), (True, True)):
        sheet = Sheet()
        left, right = (
            sheet.line(along(y)[:: -1 if back else 1], type="virtual")
            for y, back in zip((0.0, -3.5), turned, strict=True)
        )
        sheet.lanelet(left, right)
        (place,) = read(sheet).lanes.values()
        points = middle(place)[:: 1 if place.ascends else -1]
        assert np.allclose(points[:, 1], -1.75)
        assert points[-1, 0] > points[0, 0], "traffic goes east where its left bound is in the north"


def crossing() -> Sheet:
    """Four ways: the one from the west goes on to the east and turns to the north, and crosses the one to the south."""
    sheet = Sheet()

    def lane(a: list[tuple[float, float, float]], b: list[tuple[float, float, float]], **tags: str) -> int:
        return sheet.lanelet(sheet.line(a, type="virtual"), sheet.line(b, type="virtual"), **tags)

    lane([(-60.0, 0.0, 5.0), (-10.0, 0.0, 5.0)], [(-60.0, -3.5, 5.0), (-10.0, -3.5, 5.0)])
    lane([(-10.0, 0.0, 5.0), (10.0, 0.0, 5.0)], [(-10.0, -3.5, 5.0), (10.0, -3.5, 5.0)])
    lane([(10.0, 0.0, 5.0), (60.0, 0.0, 5.0)], [(10.0, -3.5, 5.0), (60.0, -3.5, 5.0)])
    lane([(1.75, 20.0, 5.0), (1.75, -20.0, 5.0)], [(-1.75, 20.0, 5.0), (-1.75, -20.0, 5.0)])
    arc = [(-10.0 + 15 * np.sin(t), 15 - 15 * np.cos(t), 5.0) for t in np.linspace(0, np.pi / 2, 12).tolist()]
    outer = [(-10.0 + 18.5 * np.sin(t), 15 - 18.5 * np.cos(t), 5.0) for t in np.linspace(0, np.pi / 2, 12).tolist()]
    lane([(-10.0, 0.0, 5.0), *arc[1:]], [(-10.0, -3.5, 5.0), *outer[1:]])
    return sheet


def inside(data: bytes) -> int:
    """How many lanes of a map are in a junction."""
    return sum(place.road.junction is not None for place in read(data).lanes.values())


def test_what_crosses_or_begins_with_what_does_is_a_junction_but_for_bridges_and_where_a_tag_says() -> None:
    data = crossing().data().decode()
    given = read(data.encode())
    assert (len(given.junctions), inside(data.encode()), len(given.links)) == (1, 3, 3)
    high = data
    for x in (1.75, -1.75):
        for y in (20.0, -20.0):
            node = f'<tag k="local_x" v="{x}"/><tag k="local_y" v="{y}"/><tag k="ele" v="5.0"/>'
            assert node in high
            high = high.replace(node, node.replace('"5.0"', '"12.0"'))
    assert inside(high.encode()) == 0
    # A turn direction of the lanelet straight on alone.
    parts = data.split("<relation ")
    parts[2] = parts[2].replace("</relation>", '<tag k="turn_direction" v="straight"/></relation>')
    assert inside("<relation ".join(parts).encode()) == 1


def test_places_by_degrees_alone_are_those_of_utm() -> None:
    """Karlsruhe: a quarter of a second of arc is some metres."""
    nodes = {1: (49.0, 8.4), 2: (49.0, 8.401), 3: (48.99997, 8.4), 4: (48.99997, 8.401)}
    text = "".join(f'<node id="{i}" lat="{lat}" lon="{lon}"/>' for i, (lat, lon) in nodes.items())
    ways = '<way id="11"><nd ref="1"/><nd ref="2"/></way><way id="12"><nd ref="3"/><nd ref="4"/></way>'
    lanelet = '<relation id="21"><member type="way" ref="11" role="left"/><member type="way" ref="12" role="right"/>'
    data = f'<osm>{text}{ways}{lanelet}<tag k="type" v="lanelet"/><tag k="subtype" v="road"/></relation></osm>'
    given = read(data.encode())
    (place,) = given.lanes.values()
    # One thousandth of a degree along the parallel of 49 degrees, times UTM's scale there.
    assert place.length_m == pytest.approx(73.17 * 0.99970, abs=0.05)
    assert given.origin == (456_000.0, 5_428_000.0)


def lit() -> Sheet:
    """A street with a stop line, a light over it, and a sign beside it."""
    sheet = street()
    stop = sheet.line([(95.0, 0.0, 0.0), (95.0, -3.5, 0.0)], type="stop_line")
    light = sheet.line([(98.0, -4.0, 5.5), (98.0, -4.4, 5.5)], type="traffic_light", subtype="red_yellow_green")
    sign = sheet.line([(50.0, -8.0, 2.2), (50.0, -8.6, 2.2)], type="traffic_sign", subtype="de274-50")
    rule = sheet.rule("traffic_light", ("way", light, "refers"), ("way", stop, "ref_line"))
    limit = sheet.rule("speed_limit", ("way", sign, "refers"))
    refers = "".join(f'<member type="relation" ref="{at}" role="regulatory_element"/>' for at in (rule, limit))
    sheet.relations[0] = sheet.relations[0].replace("<tag", f"{refers}<tag", 1)
    return sheet


def test_lights_signs_and_stop_lines_are_those_of_their_lanes() -> None:
    given = read(lit())
    by_y = {y_of(place): name for name, place in given.lanes.items() if place.length_m > 80}
    (stop,) = given.paint
    assert (stop.kind, stop.lane) == ("stop_line", by_y[-1.75])
    assert stop.s_m == pytest.approx(95.0, abs=0.01)
    light, sign = (at.element for at in given.elements)
    assert isinstance(light, TrafficSignal)
    assert light.lanes == sign.lanes == (by_y[-1.75],)
    # The traffic drives east: a quarter turn to the right of world y.
    assert light.yaw_rad == pytest.approx(-np.pi / 2)
    assert (light.x_m, light.y_m, light.height_m) == pytest.approx((98.0 + 0.52, -4.2, 5.5))
    assert isinstance(sign, TrafficSign)
    assert (sign.kind, sign.height_m) == ("speed_50", 2.2)


# -- reference lines


@pytest.mark.parametrize("radius_m", [12.0, 200.0])
def test_arcs_follow_a_bend_between_straights_within_millimetres(radius_m: float) -> None:
    """Points as maps have them: two of a long straight, and those of a bend, 2 mm from straight lines between them."""
    turn = np.linspace(0, 1.2, 2 + int(1.2 / np.sqrt(8 * 0.002 / radius_m)))[1:]
    bend = np.column_stack([60 + radius_m * np.sin(turn), radius_m * (1 - np.cos(turn))])
    leaving = bend[-1] + 50 * np.array([np.cos(1.2), np.sin(1.2)])
    plan = arcs(np.concatenate([[[0.0, 0.0], [60.0, 0.0]], bend, leaving[None]]))
    length_m = sum(piece.length_m for piece in plan)
    assert length_m == pytest.approx(60 + 1.2 * radius_m + 50, abs=0.02)
    x, y, heading = plan_points(plan, np.linspace(0, length_m, 500)).T
    on_straight = x < 58
    assert np.abs(y[on_straight]).max() < 0.003
    inside = (x > 60) & (np.hypot(x - bend[-1, 0], y - bend[-1, 1]) > 1) & (heading < 1.19)
    assert np.abs(np.hypot(x[inside] - 60, y[inside] - radius_m) - radius_m).max() < 0.005
    assert np.abs(np.diff(heading)).max() < 0.1, "directions go on where arcs meet"


# -- broken and hostile files


BROKEN = {
    "a node that is not there": ('<nd ref="7', '<nd ref="97', "node '97"),
    "no right bound": ('role="right"', 'role="center"', "expected one right bound, got 0"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_lanelet_is_left_out_with_its_id_and_the_rest_is_used(name: str) -> None:
    old, new, told = BROKEN[name]
    given = read(street().data().decode().replace(old, new, 1).encode())
    assert given.broken
    assert all(line.startswith("lanelet 1") for line in given.broken)
    assert told in given.broken[0]
    assert given.lanes
    assert "broken" in given.text()
    assert given.broken[0] in given.text()


def test_numbers_that_are_none_cost_their_node_alone() -> None:
    data = street().data()
    for bad in (b"nan", b"1e300", b"x", b""):
        given = read(data.replace(b'<tag k="local_x" v="160.0"/>', b'<tag k="local_x" v="' + bad + b'"/>', 1))
        assert given.left_out["broken nodes"] == 1
        assert len(given.broken) == 1
        assert len(given.lanes) == 3


def test_mutations_of_a_file_end_in_no_traceback() -> None:
    n_read, told = 0, []
    for data in edited_xml(lit().data(), 100, seed=5):
        try:
            n_read += bool(read(data).lanes)
        except FormatError as error:
            told.append(str(error))
    assert n_read > 60
    assert not any("\n" in line for line in told)


def test_a_file_is_read_by_its_name_and_a_copy_for_another_process_is_the_same(tmp_path: Path) -> None:
    for name, data in (("a.osm", street().data()), ("b.osm.gz", gzip.compress(street().data()))):
        (tmp_path / name).write_bytes(data)
        given = read_map(tmp_path / name)
        assert given.roads == read(street()).roads
        assert pickle.loads(pickle.dumps(given)).roads == given.roads
    (tmp_path / "c.xodr").write_bytes(street().data())
    with pytest.raises(FormatError, match="expected an OpenDRIVE file, got one of 'osm'"):
        read_map(tmp_path / "c.xodr")
