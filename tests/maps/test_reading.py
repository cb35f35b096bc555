"""Given maps: what the reader makes of a file is what the file's own numbers say, evaluated by small steps."""

import numpy as np
import pytest

from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import value
from synth3dlanes.roads.maps.given_map import GivenMap, read_opendrive
from synth3dlanes.scene.road_map import MapMark
from tests.maps.files import PLAIN, TWO, lane, opendrive, plan, road, section

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


def link(before: str = "", after: str = "") -> str:
    """The link of a road."""
    texts = {"predecessor": before, "successor": after}
    return "".join(f"<{tag} {text}/>" for tag, text in texts.items() if text)


def to_road(name: str, contact: str) -> str:
    """The attributes of a link to a road."""
    return f'elementType="road" elementId="{name}" contactPoint="{contact}"'


JUNCTION = 'elementType="junction" elementId="9"'
LINE = (PIECES["line"], 50.0)


def test_links_go_as_traffic_drives_whatever_way_roads_are_drawn() -> None:
    """Road 2 is drawn against road 1: the end of one meets the end of the other."""
    one = section(lane(1, link='<successor id="-1"/>'), lane(-1, link='<successor id="1"/>'))
    two = section(lane(1, link='<successor id="-1"/>'), lane(-1, link='<successor id="1"/>'))
    parts = (
        road(plan(LINE), one, "1", link=link(after=to_road("2", "end"))),
        road(plan(LINE, start=(100.0, 0.0, np.pi)), two, "2", link=link(after=to_road("1", "end"))),
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
            section(lane(-1, link='<predecessor id="-1"/><successor id="-1"/>')),
            name,
            link=link(to_road("1", "end"), to_road(other, "start")),
            more='junction="9"',
        )
        for name, other in (("11", "2"), ("12", "3"))
    ]
    ends = [
        road(plan(LINE, start=(60.0, y, 0.0)), TWO, name, link=link(before=JUNCTION))
        for name, y in (("2", 0.0), ("3", 4.0))
    ]
    junction = (
        '<junction id="9" name=""><connection id="0" incomingRoad="1" connectingRoad="11" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        '<connection id="1" incomingRoad="1" connectingRoad="12" contactPoint="start"><laneLink from="-1" to="-1"/>'
        '</connection><priority high="11" low="12"/></junction>'
    )
    found = read(road(plan(LINE), TWO, "1", link=link(after=JUNCTION)), *connecting, *ends, junction)
    assert set(found.links) == {(a, b) for a, b, in [
        ("1.0.-1", "11.0.-1"), ("1.0.-1", "12.0.-1"), ("11.0.-1", "2.0.-1"), ("12.0.-1", "3.0.-1"),
    ]}  # fmt: skip
    assert [(at.id, at.yields) for at in found.junctions] == [("9", (("12.0.-1", "11.0.-1"),))]
    assert {name: at.junction for name, at in found.roads.items()} == {
        "1": None, "2": None, "3": None, "11": "9", "12": "9",
    }  # fmt: skip


def test_a_direct_junction_links_roads_without_another_between_them() -> None:
    junction = (
        '<junction id="9" type="direct"><connection id="0" incomingRoad="1" linkedRoad="2" contactPoint="start">'
        '<laneLink from="-2" to="-1"/></connection></junction>'
    )
    parts = [
        road(plan(LINE), section(lane(-1), lane(-2)), "1", link=link(after=JUNCTION)),
        road(plan(LINE, start=(50.0, -3.5, 0.0)), section(lane(-1)), "2", link=link(before=JUNCTION)),
    ]
    found = read(*parts, junction)
    assert set(found.links) == {("1.0.-2", "2.0.-1")}
    assert found.junctions == ()


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
