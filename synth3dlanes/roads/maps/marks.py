"""Road marks of a given map, in the kinds that are painted here."""

from collections import Counter
from typing import get_args
from xml.etree.ElementTree import Element

from synth3dlanes.roads.maps.document import number
from synth3dlanes.scene.road_map import MapMark, MapMarkKind

KINDS: dict[str, MapMarkKind] = {
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
UNPAINTED = ("grass", "curb", "edge")
YELLOW, WHITE = ("yellow", "orange"), ("white", "standard", "")
# Widths of stripes without one in the file, and the widest.
STANDARD_M, BOLD_M, WIDEST_M = 0.12, 0.25, 2.0
# The gap of two stripes is as wide as each of them, a third of both together. A wider value is that of both.
WIDE_M = 0.2
# Lines closer together than this are one.
ONE_M = 0.02


def read_marks(lane: Element, number_of_lane: int, where: str, left_out: Counter[str]) -> tuple[MapMark, ...]:
    """The marks of a lane by the stations of its section; of those at one station the last one holds. One told from
    before the section is that where it begins."""
    marks = [_mark(mark, number_of_lane, where, left_out) for mark in lane.iterfind("roadMark")]
    by_station = {mark.s_m: mark for mark in marks}
    return tuple(by_station[station] for station in sorted(by_station))


def _mark(mark: Element, number_of_lane: int, where: str, left_out: Counter[str]) -> MapMark:
    station = max(number(mark, "sOffset", where, 0.0), 0.0)
    name, color = mark.get("type", "none").lower().replace("_", " "), mark.get("color", "standard").lower()
    kind, is_named = KINDS.get(name, "none"), name in KINDS or name in UNPAINTED
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
