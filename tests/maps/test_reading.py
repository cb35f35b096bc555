"""Given maps: what the reader makes of a file, its signals, signs, paint and objects, is what the file says."""

import numpy as np
import pytest

from synth3dlanes.draw.cars import red_lines
from synth3dlanes.draw.given_map import MapPlace, _shown
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import value
from synth3dlanes.roads.maps.elements import GivenElement
from synth3dlanes.roads.maps.given_map import GivenMap, read_opendrive
from synth3dlanes.roads.maps.part import read_place
from synth3dlanes.scene.road_map import MapMark
from synth3dlanes.scene.traffic_elements import TrafficSign, TrafficSignal
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.world import World
from tests.maps.files import ON, PLAIN, TWO, lane, link, opendrive, plan, road, section

PIECES = {
    "line": "<line/>",
    "arc": '<arc curvature="-0.02"/>',
    "spiral": '<spiral curvStart="0.001" curvEnd="-0.03"/>',
    "poly3": '<poly3 a="0" b="0" c="0.004" d="-0.00005"/>',
    "unit": '<paramPoly3 pRange="arcLength" aU="0" bU="1" cU="0" dU="-0.00001" aV="0" bV="0" cV="0.003" dV="0"/>',
    "share": '<paramPoly3 pRange="normalized" aU="0" bU="38" cU="4" dU="-3" aV="0" bV="0" cV="9" dV="-2"/>',
}


def read(*parts: str) -> GivenMap:
    """The map of a file of these parts."""
    return read_opendrive(opendrive(*parts), "test.xodr", "map test.xodr")


def test_a_map_far_from_its_origin_is_read_relative_to_a_round_place() -> None:
    found = read(road(plan((PIECES["line"], 30.0), start=(4_512_345.5, 5_400_678.25, 0.0))))
    x, y, _ = plan_points(found.roads["1"].plan, np.zeros(1))[0]
    assert found.origin == (4_512_000.0, 5_401_000.0)
    assert (x + found.origin[0], y + found.origin[1]) == (4_512_345.5, 5_400_678.25)


def marks_of(inside: str, number: int = -1) -> tuple[MapMark, ...]:
    """The marks that a lane with these elements has."""
    lanes = section(
        *(lane(at, f"{PLAIN[: PLAIN.index('<roadMark')]}{inside}" if at == number else PLAIN) for at in (1, -1))
    )
    (part,) = read(road(plan((PIECES["line"], 60.0)), lanes)).roads["1"].sections
    return next(at.marks for at in part.lanes if at.number == number)


@pytest.mark.parametrize(
    ("mark", "number", "kind", "yellow", "width_m"),
    [
        ('type="solid" color="white" width="0.15"', -1, "solid", False, 0.15),
        ('type="broken" color="yellow"', -1, "dashed", True, 0.12),
        ('type="broken" weight="bold"', -1, "dashed", False, 0.25),
        ('type="solid solid" width="0.36"', -1, "solid_solid", False, 0.12),
        ('type="solid broken"', -1, "solid_dashed", False, 0.12),
        ('type="solid broken"', 1, "solid_dashed", False, 0.12),
        ('type="broken solid" color="orange"', -1, "dashed_solid", True, 0.12),
        ('type="broken broken"', -1, "dashed_dashed", False, 0.12),
        ('type="botts dots"', -1, "dots", False, 0.12),
        ('type="curb"', -1, "none", False, 0.12),
        ('type="none"', -1, "none", False, 0.12),
    ],
)
def test_every_kind_of_road_mark(mark: str, number: int, kind: str, yellow: bool, width_m: float) -> None:
    (found,) = marks_of(f'<roadMark sOffset="0" {mark}/>', number)
    assert (found.kind, found.yellow, found.width_m) == (kind, yellow, pytest.approx(width_m))


@pytest.mark.parametrize(
    ("lines", "number", "kind"),
    [
        ([(0.0, 4, 8)], -1, "dashed"), ([(0.0, 4, 0)], -1, "solid"),
        ([(0.1, 4, 0), (-0.1, 4, 8)], -1, "solid_dashed"), ([(0.1, 4, 0), (-0.1, 4, 8)], 1, "dashed_solid"),
        ([(-0.1, 4, 0), (0.1, 4, 0)], -1, "solid_solid"), ([(-0.1, 4, 0), (0.1, 3, 9)], -1, "dashed_solid"),
    ],
)  # fmt: skip
def test_lines_of_a_mark_say_more_than_its_type(lines: list[tuple[float, int, int]], number: int, kind: str) -> None:
    told = "".join(f'<line length="{a}" space="{b}" tOffset="{t}" sOffset="0" width="0.1"/>' for t, a, b in lines)
    (found,) = marks_of(
        f'<roadMark sOffset="0" type="custom"><type name="" width="0.1">{told}</type></roadMark>', number
    )
    assert (found.kind, found.width_m) == (kind, 0.1)
    # Files of some editors have a line of no length in marks that are none.
    (found,) = marks_of(
        f'<roadMark sOffset="0" type="none"><type name="none" width="0">{told}</type></roadMark>', number
    )
    assert found.kind == "none"


LINE = (PIECES["line"], 50.0)


def test_links_go_as_traffic_drives_whatever_way_roads_are_drawn() -> None:
    """Road 2 is drawn against road 1: the end of one meets the end of the other."""
    one = section(lane(1, link='<successor id="-1"/>'), lane(-1, link='<successor id="1"/>'))
    two = section(lane(1, link='<successor id="-1"/>'), lane(-1, link='<successor id="1"/>'))
    parts = (
        road(plan(LINE), one, "1", link=link(after="2:end")),
        road(plan(LINE, start=(100.0, 0.0, np.pi)), two, "2", link=link(after="1:end")),
    )
    assert set(read(*parts).links) == {("1.0.-1", "2.0.1"), ("2.0.-1", "1.0.1")}
    left = (
        part.replace('id="1" ', 'id="1" rule="LHT" ', 1).replace('id="2" ', 'id="2" rule="LHT" ', 1) for part in parts
    )
    assert set(read(*left).links) == {("2.0.1", "1.0.-1"), ("1.0.1", "2.0.-1")}


def test_links_through_a_junction_and_who_yields() -> None:
    connecting = [
        road(
            plan((PIECES["line"], 10.0), start=(50.0, 0.0, 0.0)),
            section(lane(-1, link=ON.format(-1))),
            name,
            link=link("1:end", f"{other}:start"),
            more='junction="9"',
        )
        for name, other in (("11", "2"), ("12", "3"))
    ]
    ends = [
        road(plan(LINE, start=(60.0, y, 0.0)), TWO, name, link=link(before="9")) for name, y in (("2", 0.0), ("3", 4.0))
    ]
    junction = (
        '<junction id="9" name=""><connection id="0" incomingRoad="1" connectingRoad="11" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        '<connection id="1" incomingRoad="1" connectingRoad="12" contactPoint="start"><laneLink from="-1" to="-1"/>'
        '</connection><priority high="11" low="12"/></junction>'
    )
    found = read(road(plan(LINE), TWO, "1", link=link(after="9")), *connecting, *ends, junction)
    assert set(found.links) == {(a, b) for a, b, in [
        ("1.0.-1", "11.0.-1"), ("1.0.-1", "12.0.-1"), ("11.0.-1", "2.0.-1"), ("12.0.-1", "3.0.-1"),
    ]}  # fmt: skip
    assert [(at.id, at.yields) for at in found.junctions] == [("9", (("12.0.-1", "11.0.-1"),))]
    assert {name: at.junction for name, at in found.roads.items()} == {
        "1": None, "2": None, "3": None, "11": "9", "12": "9",
    }  # fmt: skip


def test_what_is_left_out_is_counted_in_one_line() -> None:
    crossing = '<junction id="9" type="virtual"/>'
    lanes = section(lane(1, PLAIN.replace("solid", "zigzag")), lane(-1, kind="mystery"))
    objects = '<objects><object id="1" type="tree" s="3" t="9"/><object id="2" type="tree" s="9" t="9"/></objects>'
    text = read(road(plan(LINE), lanes, after=objects), crossing).text()
    assert "\n" not in text
    for told in (
        "2 objects of type tree",
        "1 marks of type zigzag",
        "1 the type mystery of lanes",
        "1 virtual junctions",
    ):
        assert told in text
    assert "left out: nothing" in read(road(plan(LINE))).text()


def test_a_flat_map_has_no_heights_and_another_one_has_them_on_every_road() -> None:
    flat = road(plan(LINE), profile='<elevationProfile><elevation s="0" a="0" b="0" c="0" d="0"/></elevationProfile>')
    assert read(flat).roads["1"].heights == ()
    climb = '<elevationProfile><elevation s="0" a="100" b="0.05" c="0" d="0"/></elevationProfile>'
    bank = '<lateralProfile><superelevation s="0" a="0.03" b="0" c="0" d="0"/></lateralProfile>'
    found = read(road(plan(LINE), profile=climb + bank), road(plan(LINE, start=(0.0, 90.0, 0.0)), name="2"))
    assert value(found.roads["1"].heights, 20.0) == pytest.approx(101)
    # The plane that is rolled climbs already, which makes it steeper across as seen from above.
    steeper = np.arctan(np.tan(0.03) * np.hypot(1.0, 0.05))
    assert value(found.roads["1"].banks, 20.0) == pytest.approx(steeper)
    assert value(found.roads["2"].heights, 20.0) == 0
    assert len(found.roads["2"].heights) == 1


EAST = plan(("<line/>", 300.0))
AHEAD = plan(("<line/>", 200.0), start=(300.0, 0.0, 0.0))


def read_signals(signals: str, more: str = "", objects: str = "") -> GivenMap:
    """Two roads to the east, one after the other; the first one has these signals."""
    lanes = section(lane(1, link='<successor id="1"/>'), lane(-1, link='<successor id="-1"/>'))
    after = f"<objects>{objects}</objects><signals>{signals}</signals>"
    first = road(EAST, lanes, "1", link=link(after="2:start"), after=after)
    reference = (
        '<signals><signalReference id="7" s="4" t="0"><validity fromLane="-1" toLane="-1"/></signalReference></signals>'
    )
    return read_opendrive(
        opendrive(first, road(AHEAD, TWO, "2", link=link(before="1:end"), after=reference), more), "t", "map t"
    )


def world_of(given: GivenMap, frames: int = 1, at: str = "1:200:-1", index: int = 0) -> World:
    """A scene there."""
    params = load_params("streets", ("cars.n=8", "trees.n=0"))
    place = MapPlace(given, read_place(given, at))
    return sample_world(Scenes(params, 3, shots=clips(frames, 5.0, ()), map=place), index)


def test_the_rim_of_a_walkway_beside_the_grass_is_not_painted() -> None:
    middle = lane(0, PLAIN[PLAIN.index("<roadMark") :], "none")
    walk = section(middle, lane(1, kind="sidewalk"), lane(-1, kind="sidewalk"))
    lanes = section(lane(1), lane(-1), lane(-2), lane(-3, kind="sidewalk"))
    straight = plan((PIECES["line"], 400.0))
    alone = road(plan((PIECES["line"], 400.0), start=(0.0, 12.0, 0.0)), walk, "2")
    world = world_of(read(road(straight, lanes), alone))
    painted = {lane.id for lane in label(world, world.view).lanes if lane.kind == "delimiter"}
    # Of the walkway's lanes the line between them is on top.
    assert painted == {"1.0.1.line", "1.0.-1.line", "1.0.-2.line", "2.0.0.line"}


@pytest.mark.parametrize(
    ("told", "lanes", "heading_deg"),
    [
        ('orientation="+"', ("1.0.-1",), 0),
        ('orientation="-"', ("1.0.1",), 180),
        ('orientation="none"', ("1.0.1", "1.0.-1"), None),
        # Files by RoadRunner: the heading is that of the traffic, whatever the orientation says.
        ('id="7" orientation="-" hOffset="0.1"><validity fromLane="0" toLane="0"/></signal', ("2.0.-1",), 5.73),
        ('orientation="+" hOffset="3.1416"><validity fromLane="1" toLane="1"/></signal', ("1.0.1",), 180),
        # Degrees in place of radians.
        ('orientation="-" hOffset="43.8"', ("1.0.1",), 180),
    ],
)
def test_a_signal_faces_the_traffic_of_the_lanes_that_it_governs(
    told: str, lanes: tuple[str, ...], heading_deg: float | None
) -> None:
    end = ">" if told.endswith("signal") else "/>"
    (found,) = read_signals(f'<signal s="290" t="-6" type="1000001" dynamic="yes" zOffset="2.5" {told}{end}').elements
    assert found.element.lanes == lanes
    if heading_deg is not None:
        off = np.degrees(found.element.yaw_rad) + 90 - heading_deg
        assert abs((off + 180) % 360 - 180) < 0.01
    assert (found.element.x_m, found.element.y_m, found.element.height_m) == (290.0, -6.0, 2.5)


@pytest.mark.parametrize(
    ("told", "kind"),
    [
        ('type="206" subtype="-1"', "stop"), ('type="205"', "give_way"), ('type="274" value="80"', "speed_80"),
        ('type="274" subtype="56"', "speed_60"), ('type="R1-1" country="US"', "stop"),
        ('type="209" subtype="20"', "right_only"), ('type="1000011" subtype="10"', "left"),
        ('type="1000002"', None), ('type="274" value="35"', None),
    ],
)  # fmt: skip
def test_what_signals_and_signs_are(told: str, kind: str | None) -> None:
    given = read_signals(f'<signal id="1" s="290" t="-6" orientation="+" {told}/>')
    found = [getattr(item.element, "kind", getattr(item.element, "form", None)) for item in given.elements]
    assert found == ([kind] if kind else [])
    assert bool(given.left_out) == (kind is None)


def test_poles_stand_beside_the_pavement_and_arms_reach_over_it() -> None:
    at = 's="290" type="1000001" zOffset="5.5" orientation="+"'
    signs = '<signal id="3" s="280" t="-6" type="206" zOffset="2" orientation="+"/>' * 2
    world = world_of(read_signals(f'<signal id="1" t="-1.5" {at}/><signal id="2" t="-6" {at}/>{signs}'))
    ground, items = world.ground, world.scene.roadside.free_elements
    assert len(items) == 4
    feet = np.array([(item.x_m, item.y_m) for item in items])
    assert (ground.paved.off_carriageways(feet) > 0.2).all()
    over = next(item for item in items if item.reach_m)
    # The host drives along world y at its origin; the light stays where the file has it.
    head = np.array([over.x_m, over.y_m]) + over.reach_m * np.array([np.cos(over.yaw_rad), np.sin(over.yaw_rad)])
    assert head == pytest.approx([1.5, 90.0], abs=0.01)
    boards = sorted(item.height_m for item in items if isinstance(item, TrafficSign))
    assert boards[1] > boards[0] + 0.9


@pytest.mark.parametrize(("n_lanes", "reach_m"), [(5, 16.55), (9, None)])
def test_over_wide_roads_a_long_thick_arm_holds_what_would_float(n_lanes: int, reach_m: float | None) -> None:
    lanes = section(*(lane(number) for number in range(n_lanes, -n_lanes - 1, -1) if number))
    light = '<signals><signal id="1" s="290" t="-1.5" type="1000001" zOffset="6" orientation="+"/></signals>'
    world = world_of(read_opendrive(opendrive(road(EAST, lanes, "1", after=light)), "t", "map t"))
    (item,) = world.scene.roadside.signals
    assert (item.has_pole, abs(item.reach_m)) == (reach_m is not None, pytest.approx(reach_m or 0.0, abs=0.25))
    poles = [body.corners_world for body in world.site.structures if body.kind == "signal"]
    assert len(poles) == item.has_pole
    for corners in poles:
        assert np.ptp(corners[..., 0]) > 16, "it reaches the light"
        assert np.ptp(corners[..., 1]) == pytest.approx(0.4, abs=0.05), "its pole"


def test_one_group_of_a_junction_has_its_turn() -> None:
    given = read_signals("".join(f'<signal id="{i}" s="290" t="-6" type="1000001" orientation="+"/>' for i in range(3)))
    items = [
        GivenElement(item.element, "j", group) for item, group in zip(given.elements, ("a", "b", "b"), strict=True)
    ]
    shown = [_shown(items, frozenset(), False, np.random.default_rng(seed)) for seed in range(40)]
    assert all(a in ("green", "amber") and b == c and b in ("red", "red_amber") for a, b, c in shown if a[0] in "ga")
    assert {a[0] in "ga" for a, _, _ in shown} == {True, False}
    assert all((a[0] in "ga") != (b[0] in "ga") for a, b, _ in shown)
    # In clips the host's group.
    assert _shown(items, frozenset({"1.0.-1"}), True, np.random.default_rng(0)) == ["green"] * 3


def test_a_lone_light_is_red_and_cars_of_a_clip_stop_before_it() -> None:
    """The host is on the other side; those who drive towards the light do not pass it."""
    given = read_signals('<signal id="1" s="290" t="-6" type="1000001" orientation="+"/>')
    seen = []
    for index in range(4):
        world = world_of(given, 12, "1:260:1", index)
        lines = red_lines(world.scene, world.network)  # type: ignore[arg-type]
        duration_s = world.scene.shot.duration_s
        for car in world.scene.cars:
            half_m = world.scene.assets.car_models[car.model - 1].length_m * car.scale / 2
            if lines and car.lane == "1.0.-1" and car.s_m + half_m < 300:
                assert car.s_m + car.speed_m_s * duration_s + half_m < 300.1
                seen.append(car.speed_m_s)
        assert all(isinstance(signal, TrafficSignal) for signal in world.scene.roadside.signals)
    assert seen


def test_buildings_and_trees_have_the_files_sizes() -> None:
    objects = (
        '<object id="1" type="building" s="210" t="30" hdg="0.5" length="20" width="10" height="12"/>'
        '<object id="2" type="tree" s="230" t="-20" height="7"/>'
        '<object id="3" type="building" s="240" t="2" length="20" width="10" height="12"/>'
        '<object id="4" type="pole" s="230" t="-20" height="7"/>'
    )
    without = (
        '<object id="5" type="building" s="9" t="30" length="1e7" width="10" height="12"/>'
        '<object id="6" type="building" s="9" t="30" height="12"/>'
        '<object id="7" type="tree" s="9" t="30" height="1e-9"/>'
    )
    given = read_signals("", objects=objects + without)
    assert given.left_out == {"objects of type pole": 1, "objects of type building": 2, "objects of type tree": 1}
    scene = world_of(given).scene
    (house,), (tree,) = scene.roadside.buildings, scene.trees
    assert sorted([house.width_m, house.length_m]) == pytest.approx([10, 20])
    assert (house.x_m, house.y_m, house.height_m) == pytest.approx((-30, 10, 12))
    assert tree.scale * scene.assets.tree_models[tree.model - 1].height_m == pytest.approx(7, abs=0.01)


ARC = plan(("<line/>", 30.0), ('<arc curvature="0.01"/>', 60.0), start=(5.0, 6.0, np.pi / 2))
LANES = section(lane(1), lane(-1), lane(-2), lane(-3, kind="sidewalk"))


def read_objects(objects: str, signals: str = "") -> GivenMap:
    """The map of a road with these objects and signals."""
    after = f"<objects>{objects}</objects><signals>{signals}</signals>"
    return read_opendrive(opendrive(road(ARC, LANES, after=after)), "test.xodr", "map test.xodr")


def corners(tag: str, *places: tuple[float, float]) -> str:
    """An outline; by s and t or by u and v."""
    first, other = ("s", "t") if tag == "cornerRoad" else ("u", "v")
    texts = (f'<{tag} id="{i}" {first}="{a}" {other}="{b}" z="0"/>' for i, (a, b) in enumerate(places))
    return f"<outline>{''.join(texts)}</outline>"


@pytest.mark.parametrize(
    ("told", "outline"),
    [
        (f'type="crosswalk" s="13" t="0">{corners("cornerRoad", (12, -8), (12, 4), (15, 4), (15, -8))}',
         [(13, 18), (1, 18), (1, 21), (13, 21)]),
        (f'type="crosswalk" s="10" t="1" hdg="{np.pi / 2}" length="12" width="3">',
         [(10, 14.5), (10, 17.5), (-2, 14.5), (-2, 17.5)]),
        (f'type="trafficIsland" s="10" t="0" height="0.2"><outlines>'
         f'{corners("cornerLocal", (-2, -1), (2, -1), (2, 1), (-2, 1))}</outlines>',
         [(4, 14), (6, 14), (4, 18), (6, 18)]),
    ],
)  # fmt: skip
def test_crosswalks_and_islands_have_their_outlines(told: str, outline: list[tuple[float, float]]) -> None:
    """The road runs up from (5, 6), so that t is to the left of x = 5."""
    given = read_objects(f'<object id="1" {told}</object>')
    (found,) = (*given.paint, *given.islands)
    assert sorted(found.outline) == [pytest.approx(at) for at in sorted(outline)]
    if given.islands:
        assert given.islands[0].height_m == 0.2
    elif "corner" in told:  # its bars begin on a side across the road
        first = np.subtract(found.outline[1], found.outline[0])
        assert abs(first[1]) < 1e-6 < abs(first[0])


@pytest.mark.parametrize(
    ("told", "lanes"),
    [
        ('type="roadMark" t="-3.5" width="7" orientation="+"', {"1.0.-1", "1.0.-2"}),
        ('type="roadMark" t="0" orientation="-"', {"1.0.1"}),
        ('type="roadMark" t="-5" width="3" orientation="none"', {"1.0.-2"}),
        # RoadRunner's files say the direction in which a thing faces, not that of its traffic.
        ('type="-1" t="-3.5" width="7" orientation="-"', {"1.0.-1", "1.0.-2"}),
    ],
)
def test_a_stop_line_crosses_the_lanes_that_it_is_for(told: str, lanes: set[str]) -> None:
    found = read_objects(f'<object id="1" name="StopLine" s="20" {told}/>').paint
    assert {(paint.kind, paint.lane, paint.s_m) for paint in found} == {("stop_line", name, 20.0) for name in lanes}


def test_signals_of_paint_and_their_lanes() -> None:
    stop = '<signal id="1" type="294" s="25" t="-4"><validity fromLane="-2" toLane="-2"/></signal>'
    arrow = '<signal id="2" type="297" subtype="10" s="18" t="-2" orientation="+"/>'
    light = '<signal id="3" type="1000001" s="26" t="-9"/>'
    found = read_objects("", stop + arrow + light)
    assert [(paint.kind, paint.lane) for paint in found.paint] == [("stop_line", "1.0.-2"), ("arrow_left", "1.0.-1")]
    assert [item.element.height_m for item in found.elements] == [2.3]
    assert found.left_out == {}


def test_what_is_told_for_beyond_the_ends_of_a_road_is_left_out() -> None:
    def things(*stations: float) -> GivenMap:
        objects = "".join(
            f'<object id="{s}" type="roadMark" name="StopLine" s="{s}" t="-2" width="3"/>' for s in stations
        )
        signals = "".join(f'<signal id="{s}" type="1000001" s="{s}" t="-9"/>' for s in stations)
        return read_objects(objects, signals)

    found, near = things(-20.0, 40.0, 500.0), things(-0.4, 40.0, 90.5)
    assert ([at.s_m for at in found.paint], len(found.elements)) == ([40.0], 1)
    beyond = "beyond the ends of their roads"
    assert found.left_out == {f"objects {beyond}": 2, f"signals {beyond}": 2}
    assert ([at.s_m for at in near.paint], len(near.elements)) == ([0.0, 40.0, 90.0], 3)
    assert near.left_out == {}
