"""How far the map of an export is from the lane graph and the labels of a sample: lanes beside centre lines, their
boundaries, paint, links, crossings and areas. Nothing here is shared with the writers."""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, product

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from synth3dlanes.formats.comparing import (
    SURE_POINTS,
    Comparison,
    Flags,
    Gap,
    Points,
    Rule,
    SourceSample,
    distances,
    is_beside,
    too_far,
)
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.polylines import distances_between, feet_of, lengths_along, resampled
from synth3dlanes.labels.labels import MIRRORED, Lane, Marking, PaintColor, Pair
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Matrix4, Points3, Scalars
from synth3dlanes.world.world import scene_network

# How far a boundary may be from half a lane's width, and the step between places where it is looked at.
SIDE_M, SIDE_STEP_M = 0.05, 1.0
# No boundary of a lane is longer, but a damaged file may say so.
MOST_LONG_M = 1e4
# Length over which an endless road of the paper is measured.
ENDLESS_M = 300.0
# A boundary is compared at PLACES places, as far as the labels reach. It runs along a delimiter if the share ON_LINE of
# these is within ON_LINE_M of it, and has no paint if at most the share 1 - ON_LINE is within BESIDE_M of any: where
# lanes part, lines are not quite at their edges.
ON_LINE_M, BESIDE_M, ON_LINE, PLACES = 0.05, 0.5, 0.9, 200
# The labels have all paint between these distances: the first ahead of the camera, the second from it.
AHEAD_M, SURE_M = 5.0, 80.0


@dataclass(frozen=True, eq=False)
class FoundLane:
    """A lane of a map, or a piece of one: its id, the segment of the lane graph that it is, and its middle. What a map
    does not tell is left out: boundaries by their side (left or right, as traffic drives), the words of their paint,
    and the ids of what follows and precedes it."""

    id: str
    segment: str
    middle: Points
    sides: Mapping[str, Points] = field(default_factory=dict)
    paint: Mapping[str, str] = field(default_factory=dict)
    after: Collection[str] | None = None
    before: Collection[str] | None = None

    def without(self, ids: Collection[str]) -> "FoundLane":
        """It without links to these."""
        after, before = (at if at is None else {*at} - {*ids} for at in (self.after, self.before))
        return replace(self, after=after, before=before)


def paint_word(
    marking: Marking, color: PaintColor | None = None, double: bool | None = None, pair: Pair | None = None
) -> str:
    """The stripes of paint from the left and its colour, as Lanelet2 and our maps name them; a double dashed line is
    dashed."""
    subtype = pair or ("solid_solid" if double and marking == "solid" else marking)
    return subtype if marking == "none" else f"{subtype} {color}"


@dataclass(frozen=True)
class MapRule(Rule):
    """How lanes of a map are compared. `word` is what the map calls paint (its marking, colour, whether it is double,
    its pair); pieces of a segment have paint of their own if it is `of_pieces`. The labels must reach more than the
    `painted_share` of a boundary: paint may change along a lane, as at the nose of an exit. Lanes that follow each
    other meet within `gap_m`, but for what our own do not; those whose gap is more than `joined_m` in our map need no
    link."""

    name: str = "lane"
    word: Callable[[Marking, PaintColor | None, bool | None, Pair | None], str] | None = None
    of_pieces: bool = False
    painted_share: float = 0.6
    gap_m: float = 0.005
    joined_m: float = np.inf


def compare_lanes(
    lanes: Sequence[FoundLane],
    truth: SourceSample,
    rule: MapRule,
    b_from_world: Matrix4 | None = None,
    is_in_area: Callable[[Points], Flags] = lambda points: np.ones(len(points), dtype=bool),
) -> Comparison:
    """Lanes beside those of the labels: middles in metres (`compare_map`), sides, links and paint. `b_from_world` is
    given for a map in another frame than the world, in which `truth` then is, too. Lanes of the scene's map that are
    beyond the lane graph are counted alone."""
    segments = {segment.id for segment in truth.labels.graph.segments}
    others = {lane.segment for lane in lanes} - segments
    beyond = others & {*truth.scene.roads.driving_lanes} if others else others
    if beyond:
        there = {lane.id for lane in lanes if lane.segment in beyond}
        lanes = [lane.without(there) for lane in lanes if lane.id not in there]
    by_segment = dict[str, list[FoundLane]]()
    for lane in lanes:
        by_segment.setdefault(lane.segment, []).append(lane)
    middles = [(lane.segment, lane.middle) for lane in lanes]
    if not rule.of_pieces:
        middles = [(name, np.concatenate([lane.middle for lane in own])) for name, own in by_segment.items()]
    compared = compare_map(middles, truth, rule, is_in_area)
    compared += Comparison(outside=Counter({rule.name: len(beyond)}))
    known = {name: own for name, own in by_segment.items() if name in segments}
    sided = [lane for own in known.values() for lane in own if lane.sides]
    halves_m = half_widths(truth.scene, {lane.segment for lane in sided}, b_from_world)
    pieces = [[lane] for own in known.values() for lane in own]
    return compared.because(
        [
            *(text for at in sided for text in side_problems(at.segment, at.middle, at.sides, halves_m[at.segment])),
            *link_problems(known, truth, rule),
            *_paint_problems(pieces if rule.of_pieces else known.values(), truth, rule),
        ]
    )


def middle_of(left: Points3, right: Points3) -> Points3:
    """The middle between boundaries with a point on each side; otherwise each is cut anew at equal shares."""
    if len(left) != len(right):
        left, right = (resampled(line, 100) for line in (left, right))
    return (left + right) / 2


def half_widths(
    scene: Scene, names: Iterable[str], b_from_world: Matrix4 | None = None
) -> dict[str, tuple[float, float]]:
    """Half the least and the greatest width of each lane from above; of another frame, that of its edges in space."""
    found, network = dict[str, tuple[float, float]](), scene_network(scene)
    for name in names:
        lane = network.lanes[name]
        first_m, last_m = np.nan_to_num([lane.start_m, lane.end_m], posinf=ENDLESS_M, neginf=-ENDLESS_M)
        s = np.linspace(first_m, last_m, 50)
        low, high = (edge(s) for edge in lane.edges)
        widths_m = high - low
        if b_from_world is not None:
            road = network.road(lane.road)
            left, right = (transform(b_from_world, road.points(s, t))[:, :2] for t in (low, high))
            # On a slope what is beside a place is not square to the road from above.
            widths_m = np.abs(_to_left(right - left, np.gradient((left + right) / 2, axis=0)))
        found[name] = float(widths_m.min()) / 2, float(widths_m.max()) / 2
    return found


def side_problems(
    name: str, middle: Points, sides: Mapping[str, Points], halves_m: tuple[float, float]
) -> Iterator[str]:
    """Findings where the left or right boundary of a lane is on the other side, or not half its least to half its
    greatest width from its middle, seen from above."""
    least_m, most_m = halves_m
    path = middle[:, :2]
    for side, line in sides.items():
        length_m = lengths_along(line[:, :2])[-1] if len(line) else 0.0
        if not 0 < length_m < MOST_LONG_M:
            yield f"lane {name}: expected a {side} boundary, got one of {length_m:.3g} m"
            continue
        fine = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line[:, :2]), SIDE_STEP_M))
        at = distances_between(fine, path).argmin(axis=1)
        to_left_m = float(np.median(_to_left(fine - path[at], np.gradient(path, axis=0)[at])))
        got_m = to_left_m if side == "left" else -to_left_m
        if not least_m - SIDE_M <= got_m <= most_m + SIDE_M:
            yield f"lane {name}: expected its {side} boundary {most_m:.3f} m on that side, got {got_m:.3f} m"


def _to_left(steps: Points, along: Points) -> np.ndarray:
    """How far steps go to the left of directions, seen from above."""
    (x, y), (dx, dy) = steps.T, along.T
    return np.asarray((dx * y - dy * x) / np.maximum(np.hypot(dx, dy), 1e-9))


def link_problems(found: Mapping[str, Sequence[FoundLane]], truth: SourceSample, rule: MapRule) -> Iterator[str]:
    """Findings where links are not those of the lane graph and between the pieces of a lane, or where lanes do not
    meet: our own may not quite do so either. Where a map cuts lanes off, they do not meet and need no link."""
    pairs = [(a, b) for a, after in truth.labels.graph.successors.items() for b in after if a in found and b in found]
    apart_m = dict.fromkeys(((name, name) for name in found), 0.0) | link_gaps(truth.scene, pairs)
    gaps_m, limits_m = dict[tuple[str, str], float](), dict[tuple[str, str], float]()
    needed = {True: defaultdict[str, set[str]](set), False: defaultdict[str, set[str]](set)}
    for (a, b), own_m in apart_m.items():
        for one, other in product(found[a], found[b]):
            if one is not other or (a, b) in pairs:
                link = one.id, other.id
                gaps_m[link], limits_m[link] = float(np.linalg.norm(one.middle[-1] - other.middle[0])), own_m
                if gaps_m[link] <= rule.gap_m + own_m and own_m <= rule.joined_m:
                    needed[True][one.id].add(other.id)
                    needed[False][other.id].add(one.id)
    for lane in chain.from_iterable(found.values()):
        for word, got, is_after in (("follow", lane.after, True), ("precede", lane.before, False)):
            if got is None:
                continue
            links = {other: (lane.id, other) if is_after else (other, lane.id) for other in got}
            wanted = needed[is_after][lane.id]
            if wanted - {*got} or any(link not in gaps_m for link in links.values()):
                told = [", ".join(sorted(ids)) or "none" for ids in (wanted, got)]
                yield f"lane {lane.segment}: expected {told[0]} to {word} it, got {told[1]}"
            for name, link in links.items():
                if is_after and link in gaps_m and not gaps_m[link] <= rule.gap_m + limits_m[link]:
                    told_m = f"{gaps_m[link]:.3f} m"
                    yield f"lane {lane.segment}: expected {name} to begin where it ends, got it {told_m} away"


def link_gaps(scene: Scene, links: Iterable[tuple[str, str]]) -> dict[tuple[str, str], float]:
    """How far the end of a lane is from the beginning of the next: maps may have lanes that do not quite meet."""
    network, found = scene_network(scene), {}
    for one, other in links:
        (_, end_m), (start_m, _) = (network.lanes[name].driven for name in (one, other))
        ends = []
        for name, s_m in ((one, end_m), (other, start_m)):
            lane, s = network.lanes[name], np.array([s_m])
            ends.append(network.road(lane.road).points(s, lane.middle(s))[0])
        found[one, other] = float(np.linalg.norm(ends[0] - ends[1]))
    return found


def compare_map(
    found: Sequence[tuple[str, Points]],
    truth: SourceSample,
    rule: Rule,
    is_in_area: Callable[[Points], Flags] = lambda points: np.ones(len(points), dtype=bool),
) -> Comparison:
    """Lanes of a map by the segments of the lane graph that they are, in the world frame, beside the centre lines that
    follow these segments, seen from above, and in height. Only what the labels reach is compared: ahead of the camera,
    in the area."""
    labels = truth.labels
    ours = {
        lane.id: (transform(labels.camera.world_from_cam, lane.xyz_cam), lane.direction)
        for lane in labels.lanes
        if lane.kind == "centerline"
    }
    segments = labels.graph.segments
    paths = {segment.id: [name for name in segment.centerlines if name in ours] for segment in segments}
    gaps, problems, strange, outside = list[Gap](), list[str](), Counter[str](), set[str]()
    covered = {name: np.zeros(len(ours[name][0]), dtype=bool) for name in ours}
    for name, points in found:
        if name not in paths:
            problems.append(f"{rule.name} {name}: expected a segment of the lane graph, got none of this name")
            strange[rule.name] += 1
            continue
        gap, wrong = _nearest_path(points, [(path, *ours[path]) for path in paths[name]], rule)
        for path in paths[name]:
            covered[path] |= distances(ours[path][0], points) < COVERED_M
        if gap is None:
            outside.add(name)
            continue
        gaps.append(replace(gap, name=name))
        if not gap.worst <= rule.limit:
            problems.append(f"{rule.name} {name}: {too_far(gap, rule)}")
        problems += (f"{rule.name} {name}: {problem}" for problem in wrong)
    for name, (points, _) in ours.items():
        bare = is_in_area(points) & ~covered[name]
        if bare.sum() >= SURE_POINTS:
            apart = min((float(distances(points[bare], line).max()) for _, line in found), default=np.inf)
            problems.append(f"{rule.name} along {name}: expected one, got none nearer than {apart:.3g} m")
    beyond = Counter({rule.name: len(outside - {gap.name for gap in gaps})})
    return Comparison(tuple(gaps), tuple(problems), strange=strange, outside=beyond)


ASIDE_M = 8.0
"""A place of a lane that is farther aside of its path is beyond the path's end."""
COVERED_M = 0.5
"""A centre line of ours has a lane of the map where one is this near."""


def _nearest_path(points: Points, paths: Sequence[tuple[str, Points, str]], rule: Rule) -> tuple[Gap | None, list[str]]:
    """How far points are aside of the nearest path, where it reaches, and what is wrong with height and direction. A
    lane goes on beyond the end of its path, in a serpentine to the side of a part of it: that is another place. Where a
    path bends, the lane may lie between its chords and the arc through its points."""
    found = list[tuple[Gap, list[str]]]()
    for name, line, direction in paths:
        apart, at, share = feet_of(points[:, :2], line[:, :2])
        inner = (at + share > 0) & (at + share < len(line) - 1) & (apart < ASIDE_M)
        if inner.sum() < 2:
            continue
        apart = np.maximum(apart - 4 * share * (1 - share) * _bows(line[:, :2])[at], 0)
        problems, feet = [], line[at] + share[:, None] * np.diff(line, axis=0, append=line[-1:])[at]
        above = float(np.abs(points - feet)[inner, 2].max())
        if not above <= rule.slack:
            problems.append(f"expected {name} within {rule.slack:g} m of the labels' height, got it {above:.3g} m away")
        along = (at + share)[inner] * (-1 if direction == "oncoming" else 1)
        back = float(np.max(np.maximum.accumulate(along) - along))
        if back > COVERED_M:
            problems.append(f"expected points of {name} as its traffic goes, got about {back:.3g} m back")
        found.append((Gap.of(name, "m", apart[inner], rule.name), problems))
    return min(found, key=lambda pair: pair[0].worst, default=(None, []))


def _bows(line: Points) -> Scalars:
    """How far the middle of each chord of a line is from the arc through its ends, if the line bends on as it does
    beside it."""
    if len(line) < 3:
        return np.zeros(len(line))
    step = np.diff(line, axis=0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0]))))
    sharper = np.maximum(np.append(0.0, turn), np.append(turn, 0.0))
    return np.asarray(np.linalg.norm(step, axis=1) * np.tan(sharper / 4) / 2)


def _paint_problems(groups: Iterable[Sequence[FoundLane]], truth: SourceSample, rule: MapRule) -> Iterator[str]:
    """Findings where a boundary has other paint than a delimiter along which it runs, or some where there is none; the
    pieces of a group are painted alike. Where lines follow each other along a boundary, either may have its paint."""
    word, pose, graph = rule.word, truth.labels.camera.world_from_cam, truth.labels.graph
    if word is None:
        return
    world = {lane.id: transform(pose, lane.xyz_cam) for lane in truth.labels.lanes if len(lane.xyz_cam) > 1}
    ours = [(lane, world[lane.id]) for lane in truth.labels.lanes if lane.kind == "delimiter" and lane.id in world]
    paths = {segment.id: [world[at] for at in segment.centerlines if at in world] for segment in graph.segments}
    for group in groups:
        beside, name = paths.get(group[0].segment, ()), group[0].segment
        for side in group[0].paint if beside else ():
            line = np.concatenate([lane.sides[side] for lane in group])
            if len(line) < 2:
                continue
            fine = resampled(line, PLACES)
            fine = fine[np.any([is_beside(fine, path) for path in beside], axis=0)]
            if len(fine) <= rule.painted_share * PLACES:
                continue
            alike = _paint_along(fine, ours)
            expected = {word(lane.marking, lane.color, lane.double, pair) for lane, pair in alike}
            if not alike and _is_sure(fine, truth):
                near = sum(len(on_line(fine, line, BESIDE_M)) for _, line in ours)
                expected |= {word("none", None, None, None)} if near < (1 - ON_LINE) * len(fine) else set()
            told = {lane.paint[side] for lane in group}
            if expected and not told <= expected:
                like = f", as {alike[0][0].id} is painted" if alike else ""
                texts = [" or ".join(sorted(words)) for words in (expected, told)]
                yield f"lane {name}: expected {texts[0]} on its {side}{like}, got {texts[1]}"


def _paint_along(points: Points, delimiters: Sequence[tuple[Lane, Points]]) -> list[tuple[Lane, Pair | None]]:
    """The delimiters along which a boundary runs, each with its pair as those see it who go along the boundary."""
    close = [(lane, line) for lane, line in delimiters if len(on_line(points, line)) >= ON_LINE * len(points)]
    return [
        (lane, MIRRORED[lane.pair] if lane.pair is not None and goes_back(points, line) else lane.pair)
        for lane, line in close
    ]


def on_line(points: Points, line: Points, limit_m: float = ON_LINE_M) -> Points:
    """Which points are on a line; most lines are too far away to be asked point by point."""
    low, high = line.min(axis=0) - limit_m, line.max(axis=0) + limit_m
    around = points[((points > low) & (points < high)).all(axis=1)]
    return around[distances(around, line) < limit_m] if len(around) else around


def goes_back(points: Points, line: Points) -> bool:
    """Whether points along a line go against it: from the far end to the near one, as the host drives."""
    middle = len(points) // 2
    _, (at,), _ = feet_of(points[middle : middle + 1], line)
    return bool((line[at + 1] - line[at]) @ (points[middle] - points[middle - 1]) < 0)


def _is_sure(points_world: Points3, truth: SourceSample) -> bool:
    """Whether the labels have all paint at points of the world."""
    points_cam = transform(invert(truth.labels.camera.world_from_cam), points_world)
    return bool((points_cam[:, 1] > AHEAD_M).all() and np.linalg.norm(points_cam, axis=1).max() < SURE_M)


def symbol_problems(
    word: str, found: Sequence[Points], truth: SourceSample, kinds: Sequence[str], limit_m: float, is_whole: bool = True
) -> Iterator[str]:
    """Findings where outlines are not those of the labels' symbols of these kinds; if the map `is_whole`, it has no
    others."""
    ours = [symbol for symbol in truth.labels.symbols if symbol.kind in kinds]
    if is_whole and len(found) != len(ours):
        yield f"{word}: expected {len(ours)} as in the labels, got {len(found)}"
    for symbol in ours:
        outline = transform(truth.labels.camera.world_from_cam, symbol.xyz_cam)
        off_m = min((_outlines_apart(outline, other) for other in found), default=np.inf)
        if not off_m <= limit_m:
            yield f"{word}: expected one on a {symbol.kind}, got none nearer than {off_m:.3g} m"


def _outlines_apart(ours: Points, found: Points) -> float:
    """The farthest that the corners of two outlines are from the other one, ours from above: on a bent road those of
    rectangles are fewer. Of a line, how far its ends are."""
    there = float(distances(found, np.concatenate([ours, ours[:1]])).max())
    back = distances(ours[:, :2], np.concatenate([found, found[:1]])[:, :2]) if len(found) > 2 else np.zeros(1)
    return max(there, float(back.max()))


def area_problems(area: BaseGeometry, truth: SourceSample) -> Iterator[str]:
    """Findings where centre lines are not in an area, from above."""
    shapely.prepare(area)
    for lane in truth.labels.lanes:
        x, y, _ = transform(truth.labels.camera.world_from_cam, lane.xyz_cam).T
        inside = shapely.contains_xy(area, x, y)
        if lane.kind == "centerline" and not inside.all():
            yield f"lane {lane.id}: expected it in the drivable area, got {int((~inside).sum())} points outside"
