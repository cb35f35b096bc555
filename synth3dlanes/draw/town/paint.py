"""Paint and islands of a town: stop and give-way lines, crosswalks, arrows, raised medians. World frame, metres."""

from collections.abc import Iterator, Sequence

import numpy as np

from synth3dlanes.draw.town.junctions import Arm, Turn
from synth3dlanes.draw.town.plan import PlanPose, poses
from synth3dlanes.draw.town.rules import JunctionRules, turns_of_lane
from synth3dlanes.draw.town.streets import LaneAt, Street
from synth3dlanes.scene.road_map import GroundPoint, MapIsland, MapMark, MapPaint, MapRoad
from synth3dlanes.system.schema import SymbolKind

# From where an arm begins: a crosswalk, and the lines before and without one.
CROSSWALK_M, LINE_BEHIND_CROSSWALK_M, LINE_M = (0.8, 4.4), 5.6, 0.6
# Distance of arrows before the line, and room behind that place; long turn lanes have another ARROWS_APART_M behind it.
ARROW_M, ARROW_ROOM_M, ARROWS_APART_M = 7.5, 4.0, 18.0
# Raised medians: least width, distance from lanes to kerbs, step along the street.
LEAST_MEDIAN_M, MEDIAN_GAP_M, MEDIAN_STEP_M = 1.2, 0.25, 2.0
ARROWS: dict[frozenset[Turn], SymbolKind] = {
    frozenset({"straight"}): "arrow_straight",
    frozenset({"left"}): "arrow_left",
    frozenset({"right"}): "arrow_right",
    frozenset({"straight", "left"}): "arrow_straight_left",
    frozenset({"straight", "right"}): "arrow_straight_right",
}


def line_m(has_crosswalk: bool) -> float:
    """How far before the junction cars wait."""
    return LINE_BEHIND_CROSSWALK_M if has_crosswalk else LINE_M


def station(arm: Arm, back_m: float) -> float:
    """The station of an arm's street at a distance from the junction."""
    return round(back_m if arm.at_start else arm.street.length_m - back_m, 6)


def waits(rules: JunctionRules, arm: int) -> bool:
    """Whether there is a line where the traffic of an arm waits."""
    if rules.junction.is_roundabout or rules.control == "signals":
        return True
    return rules.control != "equal" and arm not in rules.major


def paint_of(rules: JunctionRules, has_crosswalks: bool) -> Iterator[MapPaint]:
    """The paint at the arms of a junction."""
    junction, back_m = rules.junction, line_m(has_crosswalks)
    gives_way = junction.is_roundabout or rules.control == "priority"
    for number, arm in enumerate(junction.arms):
        incoming = arm.lanes(incoming=True)
        if has_crosswalks:
            yield MapPaint(kind="crosswalk", outline=_crosswalk(arm))
        if waits(rules, number):
            for lane in incoming:
                kind = "give_way_line" if gives_way else "stop_line"
                yield MapPaint(kind=kind, lane=lane.name, s_m=station(arm, back_m))
        if len(incoming) > 1:
            for lane in incoming:
                yield from _arrows(rules, arm, lane, back_m)


def _arrows(rules: JunctionRules, arm: Arm, lane: LaneAt, back_m: float) -> Iterator[MapPaint]:
    kind = ARROWS.get(frozenset(turns_of_lane(rules.ways, lane.name)))
    # The lane has its name up to where the street's section near the junction ends; at the other end of a short street
    # may be a crosswalk.
    section_m = arm.street.pieces[0 if arm.at_start else -1].length_m
    free_m = min(section_m, arm.street.length_m - CROSSWALK_M[1])
    if kind is None:
        return
    for at_m in (back_m + ARROW_M, back_m + ARROW_M + ARROWS_APART_M):
        if at_m + ARROW_ROOM_M < free_m:
            yield MapPaint(kind=kind, lane=lane.name, s_m=station(arm, at_m))


def _crosswalk(arm: Arm) -> tuple[GroundPoint, ...]:
    """Its outline: across the street first, so that its bars are along it."""
    first, last = CROSSWALK_M
    left, right = arm.cross.edge("left") - 0.1, arm.cross.edge("right") + 0.1
    corners = [(first, left), (first, right), (last, right), (last, left)]
    return tuple(_point(arm.pose.moved(ahead, side)) for ahead, side in corners)


def painted(street: Street, has_crosswalks: bool) -> MapRoad:
    """A street as a road of a map, whose lines end before its crosswalks."""
    road = street.road
    if not has_crosswalks:
        return road
    back_m, sections = line_m(has_crosswalks), list(road.sections)
    for i, at_start in ((0, True), (-1, False)):
        if at_start or street.end is not None:
            cut = back_m if at_start else street.pieces[-1].length_m - back_m
            lanes = tuple(
                lane.model_copy(update={"marks": _cut(lane.marks, cut, at_start)}) for lane in sections[i].lanes
            )
            sections[i] = sections[i].model_copy(update={"lanes": lanes})
    return road.model_copy(update={"sections": tuple(sections)})


def _cut(marks: Sequence[MapMark], at_m: float, before: bool) -> tuple[MapMark, ...]:
    """The marks of a lane's edge with none before a station of its section, or behind it."""
    if not marks:
        return ()
    none = MapMark(kind="none", s_m=0.0 if before else round(at_m, 6))
    if not before:
        return (*marks, none)
    first, *others = marks
    return (none, first.model_copy(update={"s_m": round(at_m, 6)}), *others)


def islands_of(streets: Sequence[Street], has_crosswalks: bool) -> Iterator[MapIsland]:
    """The raised medians of streets, from behind their crosswalks on."""
    back_m = 1.2 + line_m(has_crosswalks)
    for street in streets:
        if street.profile.median_m < LEAST_MEDIAN_M:
            continue
        until_m = street.length_m - (back_m if street.end is not None else 0.0)
        s = np.arange(back_m, until_m, MEDIAN_STEP_M)
        edges = np.array([_median(street, at) for at in s.tolist()])
        wide = edges[:, 0] - edges[:, 1] > 2 * MEDIAN_GAP_M + 0.25
        if wide.sum() < 6:
            continue
        yield MapIsland(outline=_around(street, s[wide], edges[wide]))


def _median(street: Street, s_m: float) -> tuple[float, float]:
    """The offsets to the left of both edges of the median at a station."""
    piece, share = street.eased_at(s_m)

    def between(start: float, end: float) -> float:
        return start + share * (end - start)

    shift_m = between(piece.start.shift_m, piece.end.shift_m)
    left = between(piece.start.left.get("median", 0.0), piece.end.left.get("median", 0.0))
    right = between(piece.start.right.get("median", 0.0), piece.end.right.get("median", 0.0))
    return shift_m + left, shift_m - right


def _around(street: Street, s: np.ndarray, edges: np.ndarray) -> tuple[GroundPoint, ...]:
    """The outline of a raised median with rounded ends."""
    points, headings = poses(street.plan, s)
    middles, halves = edges.mean(axis=1), (edges[:, 0] - edges[:, 1]) / 2 - MEDIAN_GAP_M
    at = [PlanPose(float(x), float(y), float(heading)) for (x, y), heading in zip(points, headings, strict=True)]
    right = [pose.moved(0.0, float(m - h)) for pose, m, h in zip(at, middles, halves, strict=True)]
    left = [pose.moved(0.0, float(m + h)) for pose, m, h in zip(at, middles, halves, strict=True)]
    turns = np.linspace(-np.pi / 2, np.pi / 2, 7)[1:-1]
    nose = [at[-1].moved(halves[-1] * np.cos(a), middles[-1] + halves[-1] * np.sin(a)) for a in turns]
    tail = [at[0].moved(-halves[0] * np.cos(a), middles[0] - halves[0] * np.sin(a)) for a in turns]
    return tuple(_point(pose) for pose in (*right, *nose, *reversed(left), *tail))


def _point(pose: PlanPose) -> GroundPoint:
    return round(pose.x, 6), round(pose.y, 6)
