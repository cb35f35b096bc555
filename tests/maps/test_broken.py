"""Maps that are broken in parts: a piece without length is passed over and its links joined, a broken road is left out
with its reason, and the rest is used. Mutations of small maps end in no traceback, and in no refusal of a file with a
road to drive on."""

import re
from functools import partial
from xml.etree import ElementTree

import numpy as np
import pytest

from synth3dlanes.roads.maps.given_map import GivenMap, read_opendrive
from synth3dlanes.roads.maps.part import draw_place, part_around
from synth3dlanes.system.errors import FormatError, InputError
from tests.hostile import edited_xml, refused_or_read
from tests.maps.files import lane, link, opendrive, plan, road, section
from tests.thorough import first

LINE = ("<line/>", 60.0)
ON = '<predecessor id="{0}"/><successor id="{1}"/>'


def straight(name: str, x: float, length: float, lanes: str, before: str = "", after: str = "", more: str = "") -> str:
    """A straight road along x."""
    pieces = f'<planView><geometry s="0" x="{x}" y="0" hdg="0" length="{length}"><line/></geometry></planView>'
    return road(pieces, lanes, name, link=link(before, after), more=more)


def read(data: bytes) -> GivenMap:
    """The map in the bytes of a file."""
    return read_opendrive(data, "x.xodr", "map x.xodr")


def through(before: int = -1, number: int = -1, after: int = -1, s: float = 0.0) -> str:
    """A section of one lane, linked to lanes of these numbers; of number -2 beside another."""
    inner = [lane(-1)] if number == -2 else []
    return section(*inner, lane(number, link=ON.format(before, after)), s=s)


FIRST = straight("1", 0, 60, through(), after="2:start")
LAST = straight("3", 60, 60, through(), before="2:end")
JUNCTION = (
    '<junction id="9"><connection id="0" incomingRoad="1" connectingRoad="2" contactPoint="start">'
    '<laneLink from="-1" to="-2"/></connection></junction>'
)
RENAMED = through(-1, -2, -1)
JOINED = {
    "a road of 1e-8 m": (FIRST, straight("2", 60, 1e-8, through(), "1:end", "3:start"), LAST),
    "a road of 0.9 mm": (FIRST, straight("2", 60, 9e-4, through(), "1:end", "3:start"), LAST),
    "a road of 0 m with other lanes": (
        straight("1", 0, 60, through(after=-2), after="2:start"),
        straight("2", 60, 0.0, RENAMED, "1:end", "3:start"),
        straight("3", 60, 60, through(before=-2), before="2:end"),
    ),
    "two roads of 0 m": (
        FIRST,
        straight("2", 60, 0.0, through(), "1:end", "2b:start"),
        straight("2b", 60, 0.0, through(), "2:end", "3:start"),
        straight("3", 60, 60, through(), before="2b:end"),
    ),
    "a connecting road of 0 m": (
        road(plan(LINE), through(), "1", link=link(after="9")),
        straight("2", 60, 0.0, RENAMED, "1:end", "3:start", 'junction="9"'),
        straight("3", 60, 60, through(), before="2:end"),
        JUNCTION,
    ),
    "sections without length at both ends": (
        straight(
            "1", 0, 60, through() + through(-1, -1, -2, s=59.9995) + through(-2, -2, -2, s=59.9999), after="3:start"
        ),
        straight("3", 60, 60, through(-2, -2, -1) + through(-2, -1, -1, s=1e-7), before="1:end"),
    ),
    "sections without length in between": (
        straight(
            "1",
            0,
            60,
            through() + through(-1, -1, -2, s=30) + through(-1, -2, -1, s=40) + through(-2, s=40.0005),
            after="3:start",
        ),
        straight("3", 60, 60, through(), before="1:end"),
    ),
}


@pytest.mark.parametrize("name", JOINED)
def test_the_links_of_what_has_no_length_are_joined(name: str) -> None:
    found = read(opendrive(*JOINED[name]))
    assert not found.broken
    assert {"1", "3"} == set(found.roads)
    assert any("without length" in what for what in found.left_out)
    assert "links" not in " ".join(found.left_out)
    assert set(found.following) == set(found.lanes) - {"3.0.-1"}
    at = "1.0.-1"
    for _ in found.lanes:
        at = found.following.get(at, [at])[0]
    assert at == "3.0.-1"
    assert found.reach_m["1.0.-1"] == pytest.approx(120, abs=1e-3)


@pytest.mark.parametrize("length", [0.0, 1e-7, 9e-4])
def test_records_without_length_are_passed_over_whatever_they_say(length: float) -> None:
    wild = '<width sOffset="{}" a="1e300" b="nan" c="-3e11" d="no"/>'
    widths = wild.format(0) + f'<width sOffset="{length}" a="3" b="0" c="0" d="0"/>' + wild.format(60 - length)
    heights = (
        f'<elevation s="20" a="inf"/><elevation s="{20 + length}" a="0" b="0.1"/><elevation s="{60 - length}" a="x"/>'
    )
    profile = f"<elevationProfile><elevation s='0' a='0'/>{heights}</elevationProfile>"
    found = read(opendrive(road(plan(LINE), section(lane(-1, widths)), profile=profile)))
    assert not found.broken
    (one,) = found.roads.values()
    (width,), (level, climb) = one.sections[0].lanes[1].widths, one.heights
    assert (width.s_m, width.a) == (pytest.approx(0, abs=1e-3), 3.0)
    assert (level.b, climb.b, climb.s_m) == (0.0, 0.1, 20 + length)


def test_many_records_close_together_still_hold() -> None:
    widths = "".join(f'<width sOffset="{i * 4e-4:.4f}" a="{3 + i / 1000}" b="0"/>' for i in range(1000))
    (one,) = read(opendrive(road(plan(LINE), section(lane(-1, widths))))).roads.values()
    stations = np.array([at.s_m for at in one.sections[0].lanes[1].widths])
    assert np.diff(stations).min() >= 1e-3
    assert np.diff(stations).max() < 2e-3


GAP = (
    '<planView><geometry s="0" x="0" y="0" hdg="0" length="5"><line/></geometry>'
    '<geometry s="5" x="5" y="{}" hdg="0" length="5"><line/></geometry></planView>'
)
BROKEN = {
    "a gap": (road(GAP.format(9), name="7"), "road 7: planView: expected geometry without gaps, got one of 9 m"),
    "a gap of 2000 km": (
        road(GAP.format(-2e6), name="7"),
        "road 7: planView: expected places at most 1000 km from (0, 0), got one at (5, -2e+06)",
    ),
    "a length below 0": (
        straight("7", 0, 5, through()).replace('length="5"><line', 'length="-1"><line'),
        "road 7: planView: expected pieces of 0 m or more, got -1 m",
    ),
    "no plan": ('<road id="7"><lanes/></road>', "road 7: planView: expected pieces of 0 m or more, got none"),
    "no lanes": (road(plan(LINE), "", "7"), "road 7: expected a lane section, got none"),
    "not a number": (
        road(plan(LINE), section(lane(-1, '<width sOffset="0" a="nan"/>')), "7"),
        "road 7: laneSection 0: lane -1: width: a: expected a number up to 1e+08, got 'nan'",
    ),
    "a number beyond ours": (
        road(plan(LINE), section(lane(-1, '<width sOffset="0" a="3" d="2e6"/>')), "7"),
        "road 7: d: expected at most 1e+06, got 2000000.0",
    ),
    "heights": (
        road(plan(LINE), through(), "7", profile='<elevationProfile><elevation s="x"/></elevationProfile>'),
        "road 7: elevation: s: expected a number up to 1e+08, got 'x'",
    ),
    "an id of another": (straight("1", 0, 60, through()), "road 1: expected ids of roads that differ, got one twice"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_road_is_left_out_with_its_reason(name: str) -> None:
    broken, reason = BROKEN[name]
    sound = straight("1", 0, 60, through())
    found = read(opendrive(sound, broken))
    assert found.broken == (reason,)
    assert list(found.roads) == ["1"]
    assert found.text().endswith(f"left out: 1 broken road ({reason})")
    assert found.roads == read(opendrive(sound)).roads
    with pytest.raises(FormatError, match=r"^map x.xodr: road 7: [^\n]*; 1 more roads are broken$"):
        read(opendrive(*(BROKEN[other][0] for other in ("no lanes", "a gap"))))


def test_broken_objects_and_signals_are_left_out_alone() -> None:
    things = (
        '<objects><object type="building" s="nan" t="3" height="4"/>'
        '<object type="trafficIsland" s="0" t="x"/></objects>'
        '<signals><signal type="1000001" s="" t="1e300" id="1"/><signal type="294" s="z"/>'
        '<signalReference id="1" s="no"/></signals>'
    )
    found = read(opendrive(road(plan(LINE), through(), after=things)))
    assert (found.broken, list(found.roads)) == ((), ["1"])
    assert found.left_out == {"broken objects": 2, "broken signals": 2, "broken signalReferences": 1}


def test_ids_that_are_written_in_another_way_here_are_linked_and_stay_apart() -> None:
    """Ids whose characters become equal, and one that is what another becomes, are roads of their own."""
    first, second = (
        straight("a b", 0, 60, through(), after="c/d:start"),
        straight("c/d", 60, 60, through(), before="a b:end"),
    )
    more = ["a_b", "a:b", "a_b_1", "x" * 90, "x" * 91]
    found = read(opendrive(first, second, *(straight(name, 0, 60, through()) for name in more)))
    assert (found.names["a_b"], found.names["a_b_1"]) == ("a_b", "a_b_1")
    assert len(found.roads) == len(set(found.names.values())) == 7
    assert found.links == ((f"{found.names['a b']}.0.-1", "c_d.0.-1"),)
    assert not found.left_out


def test_numbers_of_lanes_count_not_their_group() -> None:
    """SUMO writes lanes of the right in the group of the left in left-hand nets."""
    text = section(lane(-1)).replace("right>", "left>")
    assert read(opendrive(road(plan(LINE), text))).roads == read(opendrive(road(plan(LINE), section(lane(-1))))).roads


# -- mutations


def a_map() -> bytes:
    """A junction of a road with two others, with heights, banks, marks, an object, a signal and a controller."""
    two = section(lane(1, link=ON.format(1, 1)), lane(-1, link=ON.format(-1, -1)))
    wide = '<width sOffset="0" a="3" b="0.01" c="0" d="0"/><width sOffset="20" a="3.2" b="0" c="0" d="0"/>'
    parts = section(
        lane(-1, wide + '<roadMark sOffset="0" type="broken"/>', link=ON.format(-1, -1)),
        lane(-2, kind="sidewalk"),
        s=30,
    )
    profile = (
        '<elevationProfile><elevation s="0" a="1" b="0.02" c="0" d="0"/></elevationProfile>'
        '<lateralProfile><superelevation s="0" a="0.03" b="0" c="0" d="0"/></lateralProfile>'
    )
    things = (
        '<objects><object type="building" id="1" s="20" t="20" length="9" width="8" height="7"/></objects>'
        '<signals><signal id="5" type="1000001" s="50" t="-5" orientation="+"/></signals>'
    )
    bend = plan(('<arc curvature="0.02"/>', 30.0), start=(60.0, 0.0, 0.0))
    return opendrive(
        road(plan(LINE), two + parts, "1", link=link(after="9"), profile=profile, after=things),
        road(plan(LINE, start=(80.0, 0.0, 0.0)), two, "2", link=link(before="9"), profile=profile),
        road(plan(LINE, start=(88.0, 9.0, 0.6)), two, "3", link=link(before="9")),
        straight("4", 60, 20, through(), "1:end", "2:start", 'junction="9"'),
        road(bend, through(), "5", link=link("1:end", "3:start"), more='junction="9"'),
        '<controller id="8"><control signalId="5"/></controller><junction id="9">'
        '<connection id="0" incomingRoad="1" connectingRoad="4" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        '<connection id="1" incomingRoad="1" connectingRoad="5" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        '<priority high="4" low="5"/></junction>',
    )


NO_PLACE = ("map x.xodr: expected a way of", "map x.xodr: expected driving lanes")


def refusal(data: bytes) -> tuple[GivenMap | None, str]:
    """The map, or why it is refused."""
    try:
        return read(data), ""
    except FormatError as error:
        return None, str(error)


def has_sound_road(data: bytes) -> bool:
    """Whether any road of a file, alone, is one to drive on."""
    roads = ElementTree.fromstring(data).findall("road")
    alone = (refusal(opendrive(ElementTree.tostring(element).decode()))[0] for element in roads)
    return any(found and found.lanes for found in alone)


@pytest.mark.parametrize(("n", "seed"), first(1, [(150, 1), *((300, seed) for seed in range(2, 6))]))
def test_mutants_are_read_without_their_broken_roads(n: int, seed: int) -> None:
    """And a place is drawn on each."""
    broken = refused = 0
    for data in edited_xml(a_map(), n, seed):
        found, reason = refusal(data)
        if found is None:
            assert re.fullmatch("map x.xodr: [^\n]+", reason)
            assert not has_sound_road(data), reason
            refused += 1
            continue
        broken += bool(found.broken)
        assert all(re.fullmatch("road [^\n]+", line) for line in found.broken)
        rng = np.random.default_rng(seed)
        refused_or_read(
            partial(lambda at, rng: part_around(at, draw_place(at, rng), rng), found, rng), *NO_PLACE, error=InputError
        )
    assert broken > n // 10 > refused
