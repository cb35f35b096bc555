"""Signals, signs, paint and objects of given maps: what they are, where they stand and which lanes they govern."""

import numpy as np
import pytest

from synth3dlanes.draw.cars import red_lines
from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.given_standing import _shown
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.roads.maps.elements import GivenElement
from synth3dlanes.roads.maps.given_map import GivenMap, read_opendrive
from synth3dlanes.roads.maps.places import read_place
from synth3dlanes.scene.traffic_elements import TrafficSign, TrafficSignal
from synth3dlanes.world.world import World
from tests.maps.files import TWO, lane, opendrive, plan, road, section

EAST = plan(("<line/>", 300.0))
AHEAD = plan(("<line/>", 200.0), start=(300.0, 0.0, 0.0))
NEXT = '<successor elementType="road" elementId="2" contactPoint="start"/>'
BEFORE = '<predecessor elementType="road" elementId="1" contactPoint="end"/>'


def read(signals: str, more: str = "", objects: str = "") -> GivenMap:
    """Two roads to the east, one after the other; the first one has these signals."""
    lanes = section(lane(1, link='<successor id="1"/>'), lane(-1, link='<successor id="-1"/>'))
    after = f"<objects>{objects}</objects><signals>{signals}</signals>"
    first = road(EAST, lanes, "1", link=NEXT, after=after)
    reference = (
        '<signals><signalReference id="7" s="4" t="0"><validity fromLane="-1" toLane="-1"/></signalReference></signals>'
    )
    return read_opendrive(opendrive(first, road(AHEAD, TWO, "2", link=BEFORE, after=reference), more), "t", "map t")


def world_of(given: GivenMap, frames: int = 1, at: str = "1:200:-1", index: int = 0) -> World:
    """A scene there."""
    params = load_params("streets", ("cars.n=8", "trees.n=0"))
    place = MapPlace(given, read_place(given, at))
    return sample_world(Scenes(params, 3, shots=clips(frames, 5.0, ()), map=place), index)


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
    (found,) = read(f'<signal s="290" t="-6" type="1000001" dynamic="yes" zOffset="2.5" {told}{end}').elements
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
    given = read(f'<signal id="1" s="290" t="-6" orientation="+" {told}/>')
    found = [getattr(item.element, "kind", getattr(item.element, "form", None)) for item in given.elements]
    assert found == ([kind] if kind else [])
    assert bool(given.left_out) == (kind is None)


def test_poles_stand_beside_the_pavement_and_arms_reach_over_it() -> None:
    at = 's="290" type="1000001" zOffset="5.5" orientation="+"'
    signs = '<signal id="3" s="280" t="-6" type="206" zOffset="2" orientation="+"/>' * 2
    world = world_of(read(f'<signal id="1" t="-1.5" {at}/><signal id="2" t="-6" {at}/>{signs}'))
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


def test_one_group_of_a_junction_has_its_turn() -> None:
    given = read("".join(f'<signal id="{i}" s="290" t="-6" type="1000001" orientation="+"/>' for i in range(3)))
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
    given = read('<signal id="1" s="290" t="-6" type="1000001" orientation="+"/>')
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
    given = read("", objects=objects + without)
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


def test_a_crosswalk_of_road_corners_lies_there_with_its_bars_along_the_road() -> None:
    corners = "".join(
        f'<cornerRoad id="{i}" s="{s}" t="{t}"/>' for i, (s, t) in enumerate([(12, -8), (12, 4), (15, 4), (15, -8)])
    )
    (paint,) = read_objects(f'<object id="1" type="crosswalk" s="13" t="0"><outline>{corners}</outline></object>').paint
    # The road runs up from (5, 6), so that t is to the left of x = 5.
    assert sorted(paint.outline) == [pytest.approx(at) for at in sorted([(13, 18), (1, 18), (1, 21), (13, 21)])]
    # Its bars begin on a side across the road.
    first = np.subtract(paint.outline[1], paint.outline[0])
    assert abs(first[1]) < 1e-6 < abs(first[0])


def test_a_rectangle_of_length_and_width_is_an_outline_too() -> None:
    (paint,) = read_objects(
        f'<object id="1" type="crosswalk" s="10" t="1" hdg="{np.pi / 2}" length="12" width="3"/>'
    ).paint
    assert sorted(paint.outline) == [
        pytest.approx(at) for at in sorted([(10, 14.5), (10, 17.5), (-2, 14.5), (-2, 17.5)])
    ]


@pytest.mark.parametrize(
    ("told", "lanes"),
    [
        ('t="-3.5" width="7" orientation="+"', {"1.0.-1", "1.0.-2"}),
        ('t="0" orientation="-"', {"1.0.1"}),
        ('t="-5" width="3" orientation="none"', {"1.0.-2"}),
    ],
)
def test_a_stop_line_crosses_the_lanes_that_it_is_for(told: str, lanes: set[str]) -> None:
    found = read_objects(f'<object id="1" type="roadMark" name="StopLine" s="20" {told}/>').paint
    assert {(paint.kind, paint.lane, paint.s_m) for paint in found} == {("stop_line", name, 20.0) for name in lanes}


def test_signals_of_paint_and_their_lanes() -> None:
    stop = '<signal id="1" type="294" s="25" t="-4"><validity fromLane="-2" toLane="-2"/></signal>'
    arrow = '<signal id="2" type="297" subtype="10" s="18" t="-2" orientation="+"/>'
    light = '<signal id="3" type="1000001" s="26" t="-9"/>'
    found = read_objects("", stop + arrow + light)
    assert [(paint.kind, paint.lane) for paint in found.paint] == [("stop_line", "1.0.-2"), ("arrow_left", "1.0.-1")]
    assert [item.element.height_m for item in found.elements] == [2.3]
    assert found.left_out == {}


def test_a_line_across_one_direction_is_there_whatever_its_orientation_says() -> None:
    """RoadRunner's files say the direction in which a thing faces, not that of its traffic."""
    found = read_objects('<object id="1" type="-1" name="StopLine" s="20" t="-3.5" width="7" orientation="-"/>').paint
    assert {paint.lane for paint in found} == {"1.0.-1", "1.0.-2"}


def test_a_traffic_island_has_its_outline_and_height() -> None:
    corners = "".join(f'<cornerLocal u="{u}" v="{v}" z="0"/>' for u, v in [(-2, -1), (2, -1), (2, 1), (-2, 1)])
    outline = f"<outlines><outline>{corners}</outline></outlines>"
    (island,) = read_objects(
        f'<object id="1" type="trafficIsland" s="10" t="0" height="0.2">{outline}</object>'
    ).islands
    assert sorted(island.outline) == [pytest.approx(at) for at in sorted([(4, 14), (6, 14), (4, 18), (6, 18)])]
    assert island.height_m == 0.2


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
