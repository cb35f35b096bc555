"""Objects of given maps: paint and islands where the file says."""

import numpy as np
import pytest

from synth3dlanes.roads.maps.given_map import GivenMap, read_opendrive
from tests.maps.files import lane, opendrive, plan, road, section

ARC = plan(("<line/>", 30.0), ('<arc curvature="0.01"/>', 60.0), start=(5.0, 6.0, np.pi / 2))
LANES = section(lane(1), lane(-1), lane(-2), lane(-3, kind="sidewalk"))


def read(objects: str, signals: str = "") -> GivenMap:
    """The map of a road with these objects and signals."""
    after = f"<objects>{objects}</objects><signals>{signals}</signals>"
    return read_opendrive(opendrive(road(ARC, LANES, after=after)), "test.xodr", "map test.xodr")


def test_a_crosswalk_of_road_corners_lies_there_with_its_bars_along_the_road() -> None:
    corners = "".join(
        f'<cornerRoad id="{i}" s="{s}" t="{t}"/>' for i, (s, t) in enumerate([(12, -8), (12, 4), (15, 4), (15, -8)])
    )
    (paint,) = read(f'<object id="1" type="crosswalk" s="13" t="0"><outline>{corners}</outline></object>').paint
    # The road runs up from (5, 6), so that t is to the left of x = 5.
    assert sorted(paint.outline) == [pytest.approx(at) for at in sorted([(13, 18), (1, 18), (1, 21), (13, 21)])]
    # Its bars begin on a side across the road.
    first = np.subtract(paint.outline[1], paint.outline[0])
    assert abs(first[1]) < 1e-6 < abs(first[0])


def test_a_rectangle_of_length_and_width_is_an_outline_too() -> None:
    (paint,) = read(f'<object id="1" type="crosswalk" s="10" t="1" hdg="{np.pi / 2}" length="12" width="3"/>').paint
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
    found = read(f'<object id="1" type="roadMark" name="StopLine" s="20" {told}/>').paint
    assert {(paint.kind, paint.lane, paint.s_m) for paint in found} == {("stop_line", name, 20.0) for name in lanes}


def test_signals_of_paint_and_their_lanes() -> None:
    stop = '<signal id="1" type="294" s="25" t="-4"><validity fromLane="-2" toLane="-2"/></signal>'
    arrow = '<signal id="2" type="297" subtype="10" s="18" t="-2" orientation="+"/>'
    light = '<signal id="3" type="1000001" s="26" t="-9"/>'
    found = read("", stop + arrow + light)
    assert [(paint.kind, paint.lane) for paint in found.paint] == [("stop_line", "1.0.-2"), ("arrow_left", "1.0.-1")]
    assert [item.element.height_m for item in found.elements] == [2.3]
    assert found.left_out == {}


def test_a_line_across_one_direction_is_there_whatever_its_orientation_says() -> None:
    """RoadRunner's files say the direction in which a thing faces, not that of its traffic."""
    found = read('<object id="1" type="-1" name="StopLine" s="20" t="-3.5" width="7" orientation="-"/>').paint
    assert {paint.lane for paint in found} == {"1.0.-1", "1.0.-2"}


def test_a_traffic_island_has_its_outline_and_height() -> None:
    corners = "".join(f'<cornerLocal u="{u}" v="{v}" z="0"/>' for u, v in [(-2, -1), (2, -1), (2, 1), (-2, 1)])
    outline = f"<outlines><outline>{corners}</outline></outlines>"
    (island,) = read(f'<object id="1" type="trafficIsland" s="10" t="0" height="0.2">{outline}</object>').islands
    assert sorted(island.outline) == [pytest.approx(at) for at in sorted([(4, 14), (6, 14), (4, 18), (6, 18)])]
    assert island.height_m == 0.2


def test_what_is_told_for_beyond_the_ends_of_a_road_is_left_out() -> None:
    def things(*stations: float) -> GivenMap:
        objects = "".join(
            f'<object id="{s}" type="roadMark" name="StopLine" s="{s}" t="-2" width="3"/>' for s in stations
        )
        signals = "".join(f'<signal id="{s}" type="1000001" s="{s}" t="-9"/>' for s in stations)
        return read(objects, signals)

    found, near = things(-20.0, 40.0, 500.0), things(-0.4, 40.0, 90.5)
    assert ([at.s_m for at in found.paint], len(found.elements)) == ([40.0], 1)
    beyond = "beyond the ends of their roads"
    assert found.left_out == {f"objects {beyond}": 2, f"signals {beyond}": 2}
    assert ([at.s_m for at in near.paint], len(near.elements)) == ([0.0, 40.0, 90.0], 3)
    assert near.left_out == {}
