"""Lane sections of a given map: the kinds, widths and marks of lanes, and the numbers that they are linked to."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, starmap
from typing import get_args
from xml.etree.ElementTree import Element

from synth3dlanes.roads.maps.cubics import EXACT, SAME_M, Cubics, difference, holding, part, read_cubics, times
from synth3dlanes.roads.maps.document import number, whole
from synth3dlanes.scene.road_map import MAX_LANES, MapLane, MapLaneKind, MapMark, MapMarkKind, MapRoad, MapSection
from synth3dlanes.system.errors import FormatError

MARK_KINDS: dict[str, MapMarkKind] = {
    "none": "none",
    "solid": "solid",
    "broken": "dashed",
    "solid solid": "solid_solid",
    "solid broken": "solid_dashed",
    "broken solid": "dashed_solid",
    "broken broken": "dashed_dashed",
    "botts dots": "dots",
}
# Marks that are no paint on the pavement.
UNPAINTED = ("none", "grass", "curb", "edge")
YELLOW, WHITE = ("yellow", "orange"), ("white", "standard", "")
# Widths of stripes without one in the file, and the widest.
STANDARD_M, BOLD_M, WIDEST_M = 0.12, 0.25, 2.0
# The gap of two stripes is as wide as each of them, a third of both together. A wider value is that of both.
WIDE_M = 0.2
# Lines closer together than this are one.
ONE_M = 0.02
RAMPS = ("entry", "exit", "offRamp", "onRamp", "connectingRamp", "slipLane", "mwyEntry", "mwyExit")
DRIVING = ("driving", *RAMPS, "bidirectional", "bus", "taxi", "HOV", "shared")
RESTRICTED = ("restricted", "special1", "special2", "special3", "rail", "tram", "roadWorks")
KINDS: dict[str, MapLaneKind] = {
    **dict.fromkeys(DRIVING, "driving"),
    "shoulder": "shoulder",
    "stop": "shoulder",
    "border": "border",
    "parking": "parking",
    "sidewalk": "walkway",
    "walking": "walkway",
    "biking": "cycle",
    "median": "median",
    "curb": "kerb",
    "none": "none",
    **dict.fromkeys(RESTRICTED, "restricted"),
}
SIDES = {"left": 1, "center": 0, "right": -1}


def read_marks(lane: Element, number_of_lane: int, where: str, left_out: Counter[str]) -> tuple[MapMark, ...]:
    """The marks of a lane by the stations of its section; of those at one station the last one holds. One told from
    before the section is that where it begins."""
    marks = [_mark(mark, number_of_lane, where, left_out) for mark in lane.iterfind("roadMark")]
    by_station = {mark.s_m: mark for mark in marks}
    return tuple(by_station[station] for station in sorted(by_station))


def _mark(mark: Element, number_of_lane: int, where: str, left_out: Counter[str]) -> MapMark:
    station = max(number(mark, "sOffset", where, 0.0), 0.0)
    name, color = mark.get("type", "").lower().replace("_", " "), mark.get("color", "standard").lower()
    kind, is_named = MARK_KINDS.get(name, "none"), not name or name in MARK_KINDS or name in UNPAINTED
    width_m = number(mark, "width", where, 0.0)
    if "_" in kind and width_m > WIDE_M:
        width_m /= 3
    lines = list(mark.iterfind("type/line"))
    if mark.find("explicit") is not None:
        left_out["explicit lines of marks"] += 1
    if lines and name not in UNPAINTED and kind != "dots":
        told = _of_lines(lines, number_of_lane, where)
        kind, width_m, is_named = told[0], told[1] or width_m, True
        left_out["lines of marks beyond two"] += max(0, len({_offset(line, where) for line in lines}) - 2)
    if not is_named:
        left_out[f"marks of type {name}"] += 1
    if kind != "none" and color not in (*YELLOW, *WHITE):
        left_out[f"the color {color} of marks"] += 1
    if mark.find("sway") is not None:
        left_out["swaying marks"] += 1
    standard_m = BOLD_M if mark.get("weight") == "bold" else STANDARD_M
    width_m = min(width_m, WIDEST_M) if width_m > 0 else standard_m
    return MapMark(s_m=station, kind=kind, yellow=color in YELLOW, width_m=width_m)


def _offset(line: Element, where: str) -> float:
    return round(number(line, "tOffset", where, 0.0) / ONE_M) * ONE_M


def _of_lines(lines: list[Element], number_of_lane: int, where: str) -> tuple[MapMarkKind, float]:
    """The kind, named from inside out, and the width of a stripe, by a mark's lines; of more than two, the outer
    ones."""
    by_place: dict[float, Element] = {_offset(line, where): line for line in lines}
    outward = -1 if number_of_lane <= 0 else 1
    stripes = [by_place[t] for t in sorted(by_place, key=lambda t: t * outward)]
    widths = [number(line, "width", where, 0.0) for line in stripes]
    words = [
        "dashed" if number(line, "space", where, 0.0) > 0 and number(line, "length", where, 0.0) > 0 else "solid"
        for line in stripes
    ]
    kind = words[0] if len(words) == 1 else f"{words[0]}_{words[-1]}"
    return next(known for known in get_args(MapMarkKind) if known == kind), max(widths[0], 0.0)


@dataclass(frozen=True)
class SectionLane:
    """A lane of a section, and the numbers of its lanes before and behind as s grows."""

    lane: MapLane
    before: tuple[int, ...] = ()
    after: tuple[int, ...] = ()


@dataclass(frozen=True)
class Section:
    """A lane section as a file has it: the lanes by their numbers, from the left. One that is shorter than SAME_M only
    joins the lanes before and behind it."""

    s_m: float
    lanes: dict[int, SectionLane]
    is_short: bool = False

    def whole(self) -> MapSection:
        """Without the links."""
        return MapSection(s_m=self.s_m, lanes=tuple(at.lane for at in self.lanes.values()))

    def between(self, from_m: float, to_m: float) -> "Section":
        """The section between two stations of its road."""
        span = from_m - self.s_m, to_m - self.s_m
        lanes = {n: replace(at, lane=lane_between(at.lane, *span)) for n, at in self.lanes.items()}
        return Section(from_m, lanes)

    def divided(self, at_m: Sequence[float], end_m: float) -> Iterator["Section"]:
        """The parts of the section between stations of its road, from one to the next of which its lanes go on."""
        ends = [self.s_m, *at_m, end_m]
        for k, between in enumerate(starmap(self.between, pairwise(ends))):
            yield replace(
                between,
                lanes={
                    n: replace(at, before=at.before if k == 0 else (n,), after=at.after if k == len(at_m) else (n,))
                    for n, at in between.lanes.items()
                },
            )


def lane_between(lane: MapLane, from_m: float, to_m: float) -> MapLane:
    """A lane between two stations of its section, from the first of which its own count."""
    marks = (mark for mark in holding(lane.marks, from_m, to_m) if mark.s_m < to_m)
    return lane.model_copy(
        update={
            "widths": part(lane.widths, from_m, to_m),
            "marks": tuple(mark.model_copy(update={"s_m": max(mark.s_m - from_m, 0.0)}) for mark in marks),
        }
    )


def widened(
    road: MapRoad, factor: Callable[[float, float], float], breaks: Sequence[float] = (), exact: float = EXACT
) -> MapRoad:
    """A road with its offsets, and the widths of all but level lanes, times a factor that `times` asks for at stations
    of the road."""

    def later(from_m: float, x_m: float, to_m: float) -> float:
        return factor(from_m + x_m, from_m + to_m)

    sections = []
    for i, section in enumerate(road.sections):
        from_m, end_m = road.span_m(i)
        within = partial(later, from_m), end_m - from_m, [s_m - from_m for s_m in breaks], exact
        lanes = (
            lane if lane.level else lane.model_copy(update={"widths": times(lane.widths, *within)})
            for lane in section.lanes
        )
        sections.append(section.model_copy(update={"lanes": tuple(lanes)}))
    offsets = times(road.lane_offsets, factor, road.length_m, breaks, exact)
    return road.model_copy(update={"sections": tuple(sections), "lane_offsets": offsets})


def read_sections(
    road: Element, length_m: float, is_tilted: bool, where: str, left_out: Counter[str]
) -> tuple[Section, ...]:
    """The lane sections of a road, short ones included, each with what holds in it, level lanes where the road
    `is_tilted`. One for a single side keeps the lanes of the other."""
    elements = sorted(road.iterfind("lanes/laneSection"), key=lambda at: number(at, "s", where, 0.0))
    if not elements:
        raise FormatError(f"{where}: expected a lane section, got none")
    stations = [0.0, *(number(element, "s", where, 0.0) for element in elements[1:])]
    found: list[Section] = []
    is_single = [element.get("singleSide") == "true" for element in elements]
    for i, (element, (s_m, end_m)) in enumerate(zip(elements, pairwise([*stations, length_m]), strict=True)):
        at, is_short = f"{where}: laneSection {s_m:g}", end_m - s_m < SAME_M
        # The lanes of one side may go on through the sections of the other.
        holds_to_m = next((stations[k] for k in range(i + 1, len(stations)) if not is_single[k]), length_m)
        section = Section(s_m, _lanes(element, holds_to_m - s_m, is_tilted, at, left_out), is_short)
        left_out["lane sections without length"] += is_short
        if found and is_single[i]:
            section = _with_other_side(section, found[-1])
        found.append(section)
    whole = [section.s_m for section in found if not section.is_short]
    ends = dict(pairwise([*whole, length_m]))
    return tuple(at if at.is_short else at.between(at.s_m, ends[at.s_m]) for at in found)


def _lanes(
    section: Element, length_m: float, is_tilted: bool, where: str, left_out: Counter[str]
) -> dict[int, SectionLane]:
    found = {0: SectionLane(MapLane(number=0, kind="none"))}
    borders: dict[int, Cubics] = {}
    for side, sign in SIDES.items():
        for element in section.iterfind(f"{side}/lane"):
            at = whole(element, "id", where)
            # SUMO's left-hand nets have lanes of the right in the group of the left: numbers decide.
            if (at == 0) != (sign == 0) or abs(at) > MAX_LANES:
                raise FormatError(f"{where}: {side}: expected lanes numbered up to {MAX_LANES}, got {at}")
            if at and at in found:
                raise FormatError(f"{where}: expected one lane {at}, got another")
            name = f"{where}: lane {at}"
            widths, borders[at] = read_cubics(element.iterfind("width"), "sOffset", name, length_m, left_out), ()
            if not widths:
                borders[at] = read_cubics(element.iterfind("border"), "sOffset", name, length_m, left_out)
            found[at] = SectionLane(_lane(element, at, widths, is_tilted, name, left_out), *_linked(element, name))
    if borders:
        found |= _by_borders(found, borders)
    found = {at: found[at] for at in sorted(found, reverse=True)}
    for at in found:
        if at and at - (1 if at > 0 else -1) not in found:
            raise FormatError(f"{where}: expected lanes without gaps between their numbers, got lane {at} alone")
    return found


def _lane(element: Element, at: int, widths: Cubics, is_tilted: bool, where: str, left_out: Counter[str]) -> MapLane:
    name = element.get("type", "none")
    if at and name not in KINDS:
        left_out[f"the type {name} of lanes"] += 1
    direction = element.get("direction", "standard")
    if name == "bidirectional" or direction == "both":
        left_out["the other direction of lanes for both"] += 1
    if element.find("height") is not None:
        left_out["heights of lanes over the road"] += 1
    return MapLane(
        number=at,
        kind=KINDS.get(name, "none") if at else "none",
        widths=widths if at else (),
        marks=read_marks(element, at, where, left_out),
        against=direction == "reversed",
        level=is_tilted and at != 0 and element.get("level") in ("true", "1"),
    )


def _linked(element: Element, where: str) -> tuple[tuple[int, ...], tuple[int, ...]]:
    before, after = (
        tuple(whole(link, "id", where) for link in element.iterfind(f"link/{tag}"))
        for tag in ("predecessor", "successor")
    )
    return before, after


def _by_borders(found: dict[int, SectionLane], borders: dict[int, Cubics]) -> dict[int, SectionLane]:
    """The lanes whose outer borders are given, with their widths: from the outer edge of the lane inside."""
    told: dict[int, SectionLane] = {}
    for sign in (1, -1):
        edge: Cubics = ()
        for at in sorted((n for n in found if n * sign > 0), key=abs):
            lane = found[at]
            if borders.get(at):
                widths = difference(borders[at], edge, sign)
                told[at] = replace(lane, lane=lane.lane.model_copy(update={"widths": widths}))
                edge = borders[at]
            else:
                edge = difference(edge, difference((), lane.lane.widths, sign))
    return told


def _with_other_side(section: Section, before: Section) -> Section:
    """A section with the lanes of the one before on the side of which it has none."""
    own = {(at > 0) - (at < 0) for at in section.lanes if at}
    gone_on = before.between(section.s_m, math.inf).lanes
    kept = {at: replace(lane, before=(at,)) for at, lane in gone_on.items() if at and (at > 0) - (at < 0) not in own}
    lanes = section.lanes | kept
    return replace(section, lanes={at: lanes[at] for at in sorted(lanes, reverse=True)})
