"""Links between the lanes of a given map, as traffic drives: within roads, from road to road, and through junctions."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal
from xml.etree.ElementTree import Element

from synth3dlanes.roads.maps.lanes import Section
from synth3dlanes.scene.road_map import LaneName, MapLane
from synth3dlanes.system.schema import Name

End = Literal["start", "end"]
# A lane at an end of its road: the road's id in the file, the number of its section, its own number.
LaneKey = tuple[str, int, int]


@dataclass(frozen=True)
class RoadEnd:
    """What a road is linked to at one of its ends: an end of another road, or a junction."""

    kind: Literal["road", "junction"]
    id: str
    contact: End | None


@dataclass(frozen=True)
class LinkedRoad:
    """A road of a file as far as links need it: its id there, ours, and its sections, those too that only join
    others."""

    id: str
    name: Name
    sections: tuple[Section, ...]
    before: RoadEnd | None
    after: RoadEnd | None
    junction: str | None
    keeps_left: bool

    @cached_property
    def numbers(self) -> dict[int, int]:
        """The number of each section that is no mere joint, counted without joints."""
        return {i: n for n, i in enumerate(i for i, section in enumerate(self.sections) if not section.is_short)}

    def section_at(self, end: End) -> int:
        """The number of the section at an end."""
        return 0 if end == "start" else len(self.sections) - 1

    def link_at(self, end: End) -> RoadEnd | None:
        """What is linked to an end."""
        return self.before if end == "start" else self.after


def read_end(road: Element, tag: Literal["predecessor", "successor"], left_out: Counter[str]) -> RoadEnd | None:
    """What follows the element that a road's link has for an end."""
    element = road.find(f"link/{tag}")
    if element is None:
        return None
    kind, contact = element.get("elementType"), element.get("contactPoint")
    if kind == "junction":
        return RoadEnd("junction", element.get("elementId", ""), None)
    if kind == "road" and contact in ("start", "end"):
        return RoadEnd("road", element.get("elementId", ""), "start" if contact == "start" else "end")
    left_out["links of roads without a contact point"] += 1
    return None


def lane_links(
    roads: Mapping[str, LinkedRoad], junctions: Mapping[str, Element], left_out: Counter[str]
) -> tuple[tuple[LaneName, LaneName], ...]:
    """The links between driving lanes, each once, as traffic drives."""
    found: dict[tuple[LaneName, LaneName], None] = {}
    for one, one_end, other, other_end in _joined(_touching(roads, junctions, left_out), roads):
        if 0 in (one[2], other[2]):
            continue
        lanes = [_lane(roads, place) for place in (one, other)]
        if None in lanes:
            left_out["links to lanes that are not there"] += 1
            continue
        if one == other and one_end == other_end:
            left_out["links of lanes to themselves"] += 1
            continue
        if any(lane is None or lane.kind != "driving" for lane in lanes):
            continue
        leaves = [
            (end == "end") == lane.ascends(roads[place[0]].keeps_left)
            for place, end, lane in zip((one, other), (one_end, other_end), lanes, strict=True)
            if lane is not None
        ]
        if leaves[0] == leaves[1]:
            left_out["links of lanes against each other's traffic"] += 1
            continue
        a, b = (one, other) if leaves[0] else (other, one)
        found[_name(roads, a), _name(roads, b)] = None
    return tuple(found)


def _joined(pairs: Iterable["LanePair"], roads: Mapping[str, LinkedRoad]) -> Iterator["LanePair"]:
    """Pairs of lanes that touch, or have between them only lanes of sections without length."""
    found = list(pairs)
    beside: dict[tuple[LaneKey, End], dict[tuple[LaneKey, End], None]] = {}
    for one, one_end, other, other_end in found:
        for at, there in (((one, one_end), (other, other_end)), ((other, other_end), (one, one_end))):
            if _is_joint(roads, at[0]):
                beside.setdefault(at, {})[there] = None
    for one, one_end, other, other_end in found:
        if _is_joint(roads, one):
            one, one_end, other, other_end = other, other_end, one, one_end
        if _is_joint(roads, one):
            continue
        known, reached = set[tuple[LaneKey, End]](), [(other, other_end)]
        while reached:
            place, end = at = reached.pop()
            if not _is_joint(roads, place):
                yield one, one_end, place, end
            elif at not in known and (lane := _lane(roads, place)) and lane.kind == "driving":
                known.add(at)
                reached += beside.get((place, "start" if end == "end" else "end"), ())


def _is_joint(roads: Mapping[str, LinkedRoad], place: LaneKey) -> bool:
    road, section, _ = place
    return roads[road].sections[section].is_short


def _name(roads: Mapping[str, LinkedRoad], place: LaneKey) -> LaneName:
    """ROAD.SECTION.NUMBER."""
    road, section, number = place
    return f"{roads[road].name}.{roads[road].numbers[section]}.{number}"


def _lane(roads: Mapping[str, LinkedRoad], place: LaneKey) -> MapLane | None:
    road, section, number = place
    found = roads[road].sections[section].lanes.get(number)
    return found.lane if found else None


LanePair = tuple[LaneKey, End, LaneKey, End]


def _touching(
    roads: Mapping[str, LinkedRoad], junctions: Mapping[str, Element], left_out: Counter[str]
) -> Iterator[LanePair]:
    """Pairs of lanes that touch, each with the end of it that does."""
    for road in roads.values():
        yield from _within(road)
        ends: tuple[End, End] = ("start", "end")
        for end in ends:
            link = road.link_at(end)
            if link is None or link.kind == "junction" or link.contact is None:
                continue
            if link.id not in roads:
                left_out["links to roads that are not there"] += 1
                continue
            section = road.section_at(end)
            there = roads[link.id].section_at(link.contact)
            for number, lane in road.sections[section].lanes.items():
                for other in lane.before if end == "start" else lane.after:
                    yield (road.id, section, number), end, (link.id, there, other), link.contact
    for name, junction in junctions.items():
        kind = junction.get("type", "default")
        if kind in ("virtual", "crossing"):
            left_out[f"{kind} junctions"] += 1
            continue
        for connection in junction.iterfind("connection"):
            yield from _connected(roads, name, connection, left_out)


def _within(road: LinkedRoad) -> Iterator[LanePair]:
    """The lanes of sections that follow each other."""
    for i, (section, following) in enumerate(pairwise(road.sections)):
        pairs = {(number, other) for number, lane in section.lanes.items() for other in lane.after}
        pairs |= {(other, number) for number, lane in following.lanes.items() for other in lane.before}
        for number, other in sorted(pairs):
            yield (road.id, i, number), "end", (road.id, i + 1, other), "start"


def _connected(
    roads: Mapping[str, LinkedRoad], junction: str, connection: Element, left_out: Counter[str]
) -> Iterator[LanePair]:
    """The lanes that a connection of a junction links; in a direct one, of two roads without another between them."""
    incoming = roads.get(connection.get("incomingRoad", ""))
    other = roads.get(connection.get("connectingRoad", connection.get("linkedRoad", "")))
    contact = connection.get("contactPoint")
    if incoming is None or other is None or contact not in ("start", "end"):
        left_out["connections of junctions that lack a road or a contact point"] += 1
        return
    other_end: End = "start" if contact == "start" else "end"
    link, end = other.link_at(other_end), None
    if link is not None and link.kind == "road" and link.id == incoming.id:
        end = link.contact
    if end is None:
        ends: tuple[End, End] = ("end", "start")
        end = next((at for at in ends if incoming.link_at(at) == RoadEnd("junction", junction, None)), None)
    if end is None:
        left_out["connections of junctions that lack a road or a contact point"] += 1
        return
    for pair in connection.iterfind("laneLink"):
        try:
            one, two = int(pair.get("from", "")), int(pair.get("to", ""))
        except ValueError:
            left_out["links to lanes that are not there"] += 1
            continue
        yield (
            (incoming.id, incoming.section_at(end), one),
            end,
            (other.id, other.section_at(other_end), two),
            other_end,
        )
