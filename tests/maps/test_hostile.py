"""A map costs as much as its file says, not as its roads are long; hostile files are refused quickly, in one line."""

import gzip
import hashlib
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps import document
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.roads.maps.lanelet_map import read_lanelet2
from synth3dlanes.roads.maps.read import read_map
from synth3dlanes.scene.road_map import PlanPiece
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.truth.ground_truth import ground_truth
from tests.map_scenes import FOUR_WAY, map_scene
from tests.maps.files import ON, TWO, lane, link, opendrive, plan, road, section

NO_TYPE = "expected a map without a document type, got <!DOCTYPE"
LINE = plan(("<line/>", 50.0))
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {b} "{("&" + a + ";") * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def changed(old: str, new: str) -> bytes:
    """A sound file with one text replaced."""
    text = opendrive(road(LINE)).decode()
    assert old in text
    return text.replace(old, new, 1).encode()


def profiled(profile: str) -> bytes:
    """A sound file with heights or banks."""
    return opendrive(road(LINE, profile=profile))


HOSTILE = {
    "nothing": (b"", "expected XML, got no element found"),
    "no XML": (b"\x00\x01\x02", "expected XML"),
    "another root": (b"<html/>", "expected an OpenDRIVE file, got one of 'html'"),
    "entities": (f"{BOMB}]><OpenDRIVE>&i;</OpenDRIVE>".encode(), NO_TYPE),
    "a file from outside": (b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///x">]><OpenDRIVE>&a;</OpenDRIVE>', NO_TYPE),
    "entities of parameters": (b'<!DOCTYPE x [<!ENTITY % a "b">%a;]><OpenDRIVE/>', NO_TYPE),
    "a type from outside": (b'<!DOCTYPE x SYSTEM "file:///x"><OpenDRIVE/>', NO_TYPE),
    "attributes by default": (
        (f'<!DOCTYPE x [<!ATTLIST a {" ".join(f"k{i} CDATA {chr(39)}v{chr(39)}" for i in range(5000))}>]><OpenDRIVE>'
         + "<a/>" * 100_000 + "</OpenDRIVE>").encode(), NO_TYPE),
    "not gzip": (b"\x1f\x8bnothing of it", "expected data of gzip, got Unknown compression method"),
    "gzip and more": (gzip.compress(b"<OpenDRIVE/>") + b"more", "expected data of gzip, got Not a gzipped file"),
    "gzip cut off": (gzip.compress(b"<OpenDRIVE/>")[:-9], "expected data of gzip, got a file that is cut off"),
    "depth": (b"<OpenDRIVE>" + b"<a>" * 100_000 + b"</a>" * 100_000 + b"</OpenDRIVE>", "within each other"),
    "no roads": (opendrive(), "expected 1 to 100000 roads, got 0"),
    "no plan": (opendrive("<road id='1' length='3'><lanes/></road>"), "expected roads with geometry"),
    "no length": (changed('length="50.0"><line/>', 'length="0"><line/>'), "expected a road with a length, got none"),
    "not a number": (changed('hdg="0.0"', 'hdg="nan"'), "geometry: hdg: expected a number up to 1e+08, got 'nan'"),
    "infinite": (changed('x="0.0"', 'x="inf"'), "geometry: x: expected a number up to 1e+08, got 'inf'"),
    "absurd length": (changed('length="50.0"><line/>', 'length="1e7"><line/>'), "expected at most 100000, got"),
    "a missing number": (changed('hdg="0.0"', ""), "geometry: hdg: expected a number, got none"),
    "no geometry that we know": (changed("<line/>", "<clothoid/>"), "expected line, arc, spiral, poly3 or paramPoly3"),
    "a lane number": (changed('<lane id="1"', '<lane id="1.5"'), "lane: id: expected a whole number, got '1.5'"),
    "a lane far out": (opendrive(road(LINE, section(lane(-1), lane(-900)))), "right: expected lanes numbered up to 20"),
    "a gap of lanes": (opendrive(road(LINE, section(lane(-1), lane(-3)))), "lanes without gaps between their numbers"),
    "a lane twice": (opendrive(road(LINE, section(lane(-1), lane(-1)))), "expected one lane -1, got another"),
    "a lane on the other side": (changed('<left><lane id="1"', '<left><lane id="-7"'), "lanes without gaps"),
    "a wide lane": (changed('a="3.5"', 'a="1e7"'), "expected"),
    "lanes far aside": (changed('b="0"', 'b="50"'), "edges of lanes: expected at most 1000, got 1254 at s = 25"),
    "a steep road": (profiled('<elevationProfile><elevation s="0" d="9e3"/></elevationProfile>'), "heights: expected"),
    "a bank": (profiled('<lateralProfile><superelevation s="0" a="1.6"/></lateralProfile>'), "superelevations: "),
    "a curve that stands still": (
        changed("<line/>", '<paramPoly3 aU="0" bU="0" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"/>'),
        "paramPoly3: expected a curve with a length",
    ),
}  # fmt: skip


LANELET = '<relation id="9"><member type="way" ref="1" role="left"/><member type="way" ref="2" role="right"/>'
TAGS = '<tag k="type" v="lanelet"/><tag k="subtype" v="road"/></relation>'
LANELETS = {
    "nothing": (b"", "expected XML, got no element found"),
    "another root": (b"<OpenDRIVE/>", "expected an OSM file, got one of 'OpenDRIVE'"),
    "entities": (b'<!DOCTYPE x [<!ENTITY a "aaa">]><osm>&a;</osm>', "without a document type"),
    "depth": (b"<osm>" + b"<a>" * 100_000 + b"</a>" * 100_000 + b"</osm>", "within each other"),
    "gzip cut off": (gzip.compress(b"<osm/>")[:-9], "expected data of gzip, got a file that is cut off"),
    "no nodes": (b"<osm/>", "expected nodes with places, got none"),
    "nodes without places": (b'<osm><node id="1"/></osm>', "expected nodes with lat and lon, or all with local_x"),
    "streets of OpenStreetMap": (
        b'<osm><node id="1" lat="49" lon="8"/><way id="2"><nd ref="1"/><tag k="highway" v="road"/></way></osm>',
        "expected a lanelet of traffic, got none",
    ),
    "a bound without length": (
        f'<osm><node id="1" lat="49" lon="8"/><way id="1"><nd ref="1"/><nd ref="1"/></way>'
        f'<way id="2"><nd ref="1"/></way>{LANELET}{TAGS}</osm>'.encode(),
        "lanelet 9: expected a left bound of some length",
    ),
    "one line twice": (
        f'<osm><node id="1" lat="49" lon="8"/><node id="2" lat="49.001" lon="8"/>'
        f'<way id="1"><nd ref="1"/><nd ref="2"/></way>'
        f'<way id="2"><nd ref="1"/><nd ref="2"/></way>{LANELET}{TAGS}</osm>'.encode(),
        "lanelet 9: expected a left and a right bound beside each other",
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("read", "data", "wanted"),
    [*((read_opendrive, *row) for row in HOSTILE.values()), *((read_lanelet2, *row) for row in LANELETS.values())],
    ids=[*HOSTILE, *(f"lanelets: {name}" for name in LANELETS)],
)
def test_a_hostile_file_is_refused_in_one_line(read: Callable[..., object], data: bytes, wanted: str) -> None:
    start = time.process_time()
    with pytest.raises(FormatError) as caught:
        read(data, "x.xodr", "map x.xodr")
    text = str(caught.value)
    assert text.startswith("map x.xodr: ")
    assert wanted in text
    assert "\n" not in text
    assert len(text) < 220
    assert time.process_time() - start < 1.0


def test_a_compressed_file_is_the_map_in_it_with_the_digest_of_the_file(tmp_path: Path) -> None:
    """Members of gzip are one file, and prefixes of namespaces do not count."""
    data = opendrive(road(LINE))
    plain = read_opendrive(data, "x.xodr", "map x")
    packed = gzip.compress(data[:300]) + gzip.compress(data[300:])
    prefixed = re.sub(rb"<(/?)(\w)", rb"<\1od:\2", data).replace(b"<od:OpenDRIVE", b'<od:OpenDRIVE xmlns:od="u"')
    for other in (packed, prefixed):
        (tmp_path / "x.xodrz").write_bytes(other)
        found = read_map(tmp_path / "x.xodrz")
        assert (found.roads, found.left_out) == (plain.roads, plain.left_out)
        assert found.digest == hashlib.sha256(other).hexdigest() != plain.digest


def test_a_compressed_file_is_decompressed_up_to_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(document, "MAX_FILE_BYTES", 1000)
    with pytest.raises(FormatError, match="expected at most 1,000 bytes in the compressed file, got more"):
        read_opendrive(gzip.compress(b" " * 5_000_000), "x.xodrz", "map x")


THROUGH = section(lane(-1, link=ON.format(-1)))


def ring(form: str, length_m: float) -> str:
    """A road that leads back to itself."""
    return road(plan((form, length_m)), THROUGH, link=link("1:end", "1:start"))


def test_links_in_circles_and_to_nowhere_end() -> None:
    """Roads that follow themselves or each other are maps; links to what is not there are left out."""
    lost = road(LINE, TWO, "2", link=link(after="404:start"))
    found = read_opendrive(opendrive(ring('<arc curvature="0.1"/>', 20 * np.pi), lost), "x.xodr", "map x.xodr")
    assert found.links == (("1.0.-1", "1.0.-1"),)
    assert found.left_out == {"links to roads that are not there": 1}


FAR = plan(("<line/>", 300.0), start=(5000.0, 0.0, 0.0))
NO_PLACE = {
    "no lanes of traffic": (
        opendrive(road(LINE, section(lane(-1, kind="sidewalk")))),
        "expected driving lanes, got none",
    ),
    "a road of a metre": (opendrive(road(plan(("<line/>", 1.0)))), "a way of 10 m and more ahead of the host"),
    "a ring of a metre": (opendrive(ring("<line/>", 1.0)), "a way of 10 m and more"),
}


@pytest.mark.parametrize("name", NO_PLACE)
def test_a_map_without_a_place_for_a_host_is_refused(name: str) -> None:
    data, wanted = NO_PLACE[name]
    start = time.process_time()
    with pytest.raises(InputError, match=wanted):
        MapPlace(read_opendrive(data, "x.xodr", "map x.xodr")).draw(np.random.default_rng(1))
    assert time.process_time() - start < 1.0


def test_such_a_map_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "x.xodr").write_bytes(NO_PLACE["a road of a metre"][0])
    args = ["generate", "--n", "2", "--out", f"{tmp_path / 'out'}", "--map", f"{tmp_path / 'x.xodr'}"]
    result = CliRunner().invoke(main, args)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_lanes_that_do_not_touch_are_not_linked() -> None:
    first, second = road(LINE, THROUGH, link=link("", "2:start")), road(FAR, THROUGH, "2", link=link("1:end"))
    found = read_opendrive(opendrive(first, second), "x.xodr", "map x.xodr")
    assert not found.links
    assert found.left_out == {"links of lanes that do not touch": 1}


def test_a_value_of_many_pieces_is_read_in_proportion_to_them() -> None:
    """Processor time of four times as many pieces: quadratic reading would take sixteen times as long."""

    def seconds(n: int) -> float:
        widths = "".join(f'<width sOffset="{i / 100}" a="{3 + i % 2}" b="0" c="0" d="0"/>' for i in range(n))
        text = opendrive(road(LINE, section(lane(-1, widths))))
        start = time.process_time()
        read_opendrive(text, "x.xodr", "map x.xodr")
        return time.process_time() - start

    assert min(seconds(1200) for _ in range(2)) < 8 * min(seconds(300) for _ in range(3))


@pytest.mark.parametrize("width", ["0", "-3", "0.01"])
def test_a_host_on_a_lane_without_width_does_not_end_the_program(width: str) -> None:
    thin = f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/>'
    given = read_opendrive(opendrive(road(plan(("<line/>", 300.0)), section(lane(-1, thin)))), "x.xodr", "map x.xodr")
    world = sample_world(Scenes(load_params("tiny", ("cars.n=1", "trees.n=0")), 1, "train", map=MapPlace(given)), 0)
    assert ground_truth(world.scene).lanes


def test_cars_and_rails_of_a_scene_on_roads_that_are_not_there_are_refused() -> None:
    """A scene of somebody else's making may have a car in a lane without width, or beyond what is looked at."""
    north = FOUR_WAY.roads[1]
    (own,) = north.sections
    away = (PlanPiece(x_m=900.0, y_m=0.0, heading_rad=0.0, length_m=50.0),)
    far = north.model_copy(update={"id": "far", "plan": away, "junction": None})
    lanes = tuple(at.model_copy(update={"widths": ()}) for at in own.lanes)
    thin = north.model_copy(update={"id": "thin", "sections": (own.model_copy(update={"lanes": lanes}),)})
    roads = FOUR_WAY.model_copy(update={"roads": (*FOUR_WAY.roads, far, thin)})
    car = sample_scene(Scenes(load_params("tiny"), 1, "train"), 0).cars[0]
    for name in ("far.0.1", "thin.0.1"):
        scene = map_scene(roads, cars=(car.model_copy(update={"lane": name, "s_m": 10.0}),))
        with pytest.raises(InputError, match=f"expected lanes of traffic near the host, with a width, got {name}"):
            ground_truth(scene)


BANKED = (
    '<elevationProfile><elevation s="0" a="0" b="0.01" c="0" d="0"/></elevationProfile>'
    '<lateralProfile><superelevation s="0" a="0.05" b="1e-6" c="0" d="0"/></lateralProfile>'
)


def far(name: int) -> str:
    """A banked road of 99 km with 20 lanes."""
    pieces = plan(("<line/>", 99_000.0), start=(0.0, 300.0 * name, 0.0))
    return road(pieces, section(*(lane(n) for n in range(-10, 11) if n)), str(name), profile=BANKED)


def test_roads_of_a_hundred_kilometres_cost_what_their_file_says() -> None:
    start = time.process_time()
    given = read_opendrive(opendrive(*(far(i) for i in range(20))), "x.xodr", "map x.xodr")
    assert not given.broken
    params = load_params("tiny", ("cars.n=1", "trees.n=0"))
    world = sample_world(Scenes(params, 1, "train", map=MapPlace(given)), 0)
    assert time.process_time() - start < 10.0
    assert max(at.length_m for at in world.scene.map.roads) < 2500
    assert len(world.scene.model_dump_json()) < 100_000


@pytest.mark.parametrize(
    "form",
    ["<line/>", '<arc curvature="1e-4"/>', '<spiral curvStart="-1e-4" curvEnd="2e-4"/>'],
    ids=["line", "arc", "spiral"],
)
def test_the_parts_of_a_long_piece_are_the_piece(form: str) -> None:
    pieces = [road(plan((form, length_m), start=(5.0, 7.0, 0.3))) for length_m in (999.0, 5700.0)]
    short, whole = (read_opendrive(opendrive(at), "x.xodr", "map x.xodr").roads["1"].plan for at in pieces)
    assert len(short) == 1
    assert len(whole) == 10
    one = whole[0].model_copy(update={"length_m": 5700.0, "curvature_end": whole[-1].curvature_end})
    s = np.linspace(0, 5700, 400)
    assert plan_points(whole, s) == pytest.approx(plan_points([one], s), abs=1e-6)
