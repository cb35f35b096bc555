"""Hostile files are refused in one line, and quickly."""

import re
import time
from pathlib import Path

import pytest

from synth3dlanes.errors import FormatError, InputError
from synth3dlanes.maps.given_map import read_map, read_opendrive
from tests.maps.files import PLAIN, TWO, lane, opendrive, plan, road, section

LINE = plan(("<line/>", 50.0))
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{("&" + a + ";") * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def changed(old: str, new: str) -> bytes:
    """A sound file with one text replaced."""
    text = opendrive(road(LINE)).decode()
    assert old in text
    return text.replace(old, new, 1).encode()


HOSTILE = {
    "nothing": (b"", "expected XML, got no element found"),
    "no XML": (b"\x00\x01\x02", "expected XML"),
    "another root": (b"<html/>", "expected an OpenDRIVE file, got one of 'html'"),
    "entities": (f"{BOMB}]><OpenDRIVE>&i;</OpenDRIVE>".encode(), "without entities"),
    "a file from outside": (b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///x">]><OpenDRIVE>&a;</OpenDRIVE>', "entities"),
    "depth": (b"<OpenDRIVE>" + b"<a>" * 100_000 + b"</a>" * 100_000 + b"</OpenDRIVE>", "within each other"),
    "no roads": (opendrive(), "expected 1 to 100000 roads, got 0"),
    "two roads of one id": (opendrive(road(LINE), road(LINE)), "ids of roads that differ"),
    "no plan": (opendrive("<road id='1' length='3'><lanes/></road>"), "expected roads with geometry"),
    "no length": (changed('length="50.0"><line/>', 'length="0"><line/>'), "road 1: expected a plan with a length"),
    "negative length": (changed('length="50.0"><line/>', 'length="-4"><line/>'), "expected a plan with a length"),
    "not a number": (changed('hdg="0.0"', 'hdg="nan"'), "geometry: hdg: expected a number up to 1e+08, got 'nan'"),
    "infinite": (changed('x="0.0"', 'x="inf"'), "geometry: x: expected a number up to 1e+08, got 'inf'"),
    "absurd": (changed('y="0.0"', 'y="1e300"'), "geometry: y: expected a number up to 1e+08, got '1e300'"),
    "absurd length": (changed('length="50.0"><line/>', 'length="1e7"><line/>'), "expected at most 100000, got"),
    "a missing number": (changed('hdg="0.0"', ""), "geometry: hdg: expected a number, got none"),
    "no geometry that we know": (changed("<line/>", "<clothoid/>"), "expected line, arc, spiral, poly3 or paramPoly3"),
    "a gap": (
        opendrive(road('<planView><geometry s="0" x="0" y="0" hdg="0" length="5"><line/></geometry>'
                       '<geometry s="5" x="9" y="0" hdg="0" length="5"><line/></geometry></planView>')),
        "expected geometry without gaps, got one of 4 m",
    ),
    "no lanes": (opendrive(road(LINE, "")), "road 1: expected a lane section, got none"),
    "a lane number": (changed('<lane id="1"', '<lane id="1.5"'), "lane: id: expected a whole number, got '1.5'"),
    "a lane far out": (opendrive(road(LINE, section(lane(-1), lane(-900)))), "right: expected lanes numbered up to 20"),
    "a gap of lanes": (opendrive(road(LINE, section(lane(-1), lane(-3)))), "lanes without gaps between their numbers"),
    "a lane twice": (opendrive(road(LINE, section(lane(-1), lane(-1)))), "expected one lane -1, got another"),
    "a lane on the other side": (changed('<left><lane id="1"', '<left><lane id="-7"'), "left: expected lanes numbered"),
    "a wide lane": (changed('a="3.5"', 'a="1e7"'), "expected"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_in_one_line(name: str) -> None:
    data, wanted = HOSTILE[name]
    start = time.process_time()
    with pytest.raises(FormatError) as caught:
        read_opendrive(data, "x.xodr", "map x.xodr")
    text = str(caught.value)
    assert text.startswith("map x.xodr: ")
    assert wanted in text
    assert "\n" not in text
    assert len(text) < 200
    assert time.process_time() - start < 1.0


def test_links_in_circles_and_to_nowhere_end(tmp_path: Path) -> None:
    """Roads that follow themselves or each other are maps; links to what is not there are left out."""
    ring = '<predecessor elementType="road" elementId="1" contactPoint="end"/>' + (
        '<successor elementType="road" elementId="1" contactPoint="start"/>'
    )
    onward = '<predecessor id="-1"/><successor id="-1"/>'
    lost = '<successor elementType="road" elementId="404" contactPoint="start"/>'
    data = opendrive(road(LINE, section(lane(-1, PLAIN, link=onward)), link=ring), road(LINE, TWO, "2", link=lost))
    found = read_opendrive(data, "x.xodr", "map x.xodr")
    assert found.links == (("1.0.-1", "1.0.-1"),)
    assert found.left_out == {"links to roads that are not there": 1}


def test_a_file_that_is_not_there_or_is_a_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.xodr", tmp_path):
        with pytest.raises((InputError, FormatError), match=re.escape(f"{path}")):
            read_map(path)
