"""The lanes of a world as lanelets: pieces along which neither the lanes beside them nor the paint on their edges
changes. Those beside each other share their bounds, and those that follow each other the ends of these.

World frame, metres; bounds go with the stations of their roads.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.formats.comparing import distances
from synth3dlanes.geometry.polylines import resampled, thinned
from synth3dlanes.labels.labels import MIRRORED
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import Polyline3, Scalars
from synth3dlanes.world.paint import is_double, line_width_m, paint_color, pair_of
from synth3dlanes.world.world import World

# The tags of a primitive.
Tags = Mapping[str, str]
# Roads without ends are written between these stations.
REACH_M = 250.0
# Distance between the points of bounds before thinning, and the most that thinning moves a line.
BOUND_STEP_M, LINE_M = 0.5, 0.002
LEAST_WIDTH_M = 0.1
# Lines within SAME_M of each other are one. Paint is that of a line at most PAINT_M from a lane's edge, or of a line of
# another road along the share ON_LINE of it; where paint changes nearer than LEAST_M to an end, it does so there.
SAME_M, PAINT_M, ON_LINE, LEAST_M = 0.02, 0.05, 0.9, 1.0
# Lanes are joined over gaps of up to JOIN_M; the next points are at least NEXT_M from where they then meet.
JOIN_M, NEXT_M = 0.5, 0.25
THICK_M = 0.18


@dataclass(frozen=True)
class Paint:
    """Paint along a road between two of its stations: its tags as s grows, and as s falls, and whether it is a line of
    road works that moves."""

    t: Offset
    from_m: float
    to_m: float
    ascending: Tags
    descending: Tags
    is_temporary: bool


@dataclass(eq=False)
class Bound:
    """A line along a road, as s grows, with the numbers of the joints at its ends."""

    points: Polyline3
    joints: tuple[int, int]
    paint: Paint | None


@dataclass(eq=False)
class LaneletPiece:
    """A part of a lane that is a lanelet, with its bounds and, once it is written, its id."""

    lane: NetworkLane
    left: Bound
    right: Bound
    id: int = 0

    def ends(self, leaves: bool) -> tuple[int, int]:
        """The joints on the left and the right where traffic leaves it, or enters it."""
        at = int(leaves == self.lane.ascends)
        return self.left.joints[at], self.right.joints[at]

    @cached_property
    def middle(self) -> Polyline3:
        """The middle between its bounds as its traffic drives."""
        return np.asarray((self.left.points + self.right.points)[:: 1 if self.lane.ascends else -1] / 2)


@dataclass
class Lanelets:
    """The pieces of all lanes in the order of traffic, and the joints of their bounds: places, of which some are
    one."""

    pieces: dict[str, list[LaneletPiece]] = field(default_factory=dict)
    places: list[Float[np.ndarray, "3"]] = field(default_factory=list)
    same_as: list[int] = field(default_factory=list)

    def joint(self, place: Float[np.ndarray, "3"]) -> int:
        self.places.append(place)
        self.same_as.append(len(self.same_as))
        return len(self.same_as) - 1

    def first(self, joint: int) -> int:
        """The first of the joints that are one with a joint."""
        while self.same_as[joint] != joint:
            joint = self.same_as[joint]
        return joint

    def line(self, bound: Bound) -> Polyline3:
        """The points of a bound between the joints at its ends, as stations grow."""
        ends = [self.places[self.first(joint)] for joint in bound.joints]
        kept = bound.points[1:-1]
        for own, other, end in zip(bound.points[[0, -1]], bound.points[[1, -2]], ends, strict=True):
            if np.linalg.norm(own - end) > SAME_M:
                # What lies behind a joint that has moved, or just before it.
                inward = (other - own) / np.linalg.norm(other - own)
                is_near = np.linalg.norm(kept - own, axis=1) < 2 * JOIN_M
                kept = kept[~is_near | ((kept - end) @ inward > NEXT_M)]
        return np.concatenate([ends[:1], kept, ends[1:]])

    def join(self, leaving: tuple[int, int], entering: tuple[int, int]) -> bool:
        """Make joints on the left and on the right one; not where they are too far apart."""
        pairs = [sorted((self.first(a), self.first(b))) for a, b in zip(leaving, entering, strict=True)]
        if any(np.linalg.norm(self.places[a] - self.places[b]) > JOIN_M for a, b in pairs):
            return False
        for a, b in pairs:
            self.same_as[b] = a
        return True


def lanelets_of(world: World) -> tuple[Lanelets, int]:
    """The lanelets of all lanes, and how many links are left out because lanes do not meet."""
    found, network = Lanelets(), world.network
    for road in network.roads:
        lanes = [(lane, *ends) for lane in road.lanes if (ends := _wide(road, lane))]
        painted = list(_paint_along(world, road))
        before = dict[str, LaneletPiece]()
        for from_m, to_m in pairwise(_cuts(lanes, painted, road)):
            here = [lane for lane, low, high in lanes if low <= from_m and to_m <= high]
            pieces = _pieces(road, here, from_m, to_m, painted, found) if here else {}
            for name, piece in pieces.items():
                if name in before:
                    for old, new in ((before[name].left, piece.left), (before[name].right, piece.right)):
                        found.join((old.joints[1],) * 2, (new.joints[0],) * 2)
                own = found.pieces.setdefault(name, [])
                own.insert(len(own) if piece.lane.ascends else 0, piece)
            before = pieces
    met = [found.join(found.pieces[a][-1].ends(True), found.pieces[b][0].ends(False)) for a, b in network.links]
    return found, met.count(False)


def _wide(road: Road, lane: NetworkLane) -> tuple[float, float] | None:
    """The stations between which a lane is written: readers stumble over bounds that begin at one place."""
    from_m, to_m = np.nan_to_num([lane.start_m, lane.end_m], neginf=-REACH_M, posinf=REACH_M)
    s = np.linspace(from_m, to_m, 3 + int(abs(to_m - from_m) / BOUND_STEP_M))
    low, high = lane.edges
    wide = s[high(s) - low(s) > LEAST_WIDTH_M] if to_m > from_m else s[:0]
    return (float(wide[0]), float(wide[-1])) if len(wide) > 1 else None


def _look(line: LaneCurve, markings: Markings) -> tuple[Tags, Tags]:
    """The tags of a painted line in its own direction, and in the other one."""
    pair, width_m = pair_of(line, markings), line_width_m(line, markings)
    word = pair or ("solid_solid" if is_double(line, markings) and line.marking == "solid" else line.marking)
    tags = {"type": "line_thick" if width_m > THICK_M else "line_thin", "subtype": word}
    tags |= {"color": str(paint_color(line, markings)), "width": f"{width_m:.3f}"}
    if pair is None:
        tags["lane_change"] = "yes" if word == "dashed" else "no"
    return tags, {**tags, "subtype": MIRRORED[pair]} if pair else tags


def painted_lines(world: World) -> Iterator[tuple[Polyline3, Tags, Tags]]:
    """Points of all painted lines, and what they look like in their order and against it."""
    for line in world.network.delimiters:
        low, high = np.nan_to_num([line.start_m, line.end_m], neginf=-REACH_M, posinf=REACH_M)
        s = np.linspace(low, high, 2 + int((high - low) / BOUND_STEP_M))
        tags, other = _look(line, world.scene.markings)
        yield line.points_world(s), *((tags, other) if world.network.onwards > 0 else (other, tags))


def painted_along(points: Polyline3, painted: Sequence[tuple[Polyline3, Tags, Tags]]) -> Tags | None:
    """What a painted line looks like that runs along most of these points, in their order."""
    fine, best, best_share = resampled(points, 2 + len(points)), None, ON_LINE
    low, high = fine.min(axis=0) - PAINT_M, fine.max(axis=0) + PAINT_M
    for line, tags, other in painted:
        near = ((line > low) & (line < high)).all(axis=1)
        if not near.any():
            continue
        first, last = np.flatnonzero(near)[[0, -1]]
        part = line[max(first - 1, 0) : last + 2]
        share = float(np.mean(distances(fine, part) < PAINT_M)) if len(part) > 1 else 0.0
        if share > best_share:
            is_along = np.linalg.norm(part[0] - fine[0]) < np.linalg.norm(part[0] - fine[-1])
            best, best_share = tags if is_along else other, share
    return best


def _paint_along(world: World, road: Road) -> Iterator[Paint]:
    for line in world.network.delimiters:
        tags, other = _look(line, world.scene.markings)
        for piece in line.pieces:
            if piece.road.id == road.id:
                ends = np.clip([max(piece.start_m, line.start_m), min(piece.end_m, line.end_m)], -1e6, 1e6)
                low, high = sorted(piece.on(ends).tolist())
                along = piece.along * world.network.onwards
                is_temporary = bool(world.network.removed) and piece.offset.moves is not None
                yield Paint(piece.offset, low, high, *((tags, other) if along > 0 else (other, tags)), is_temporary)


def _cuts(lanes: Sequence[tuple[NetworkLane, float, float]], painted: Sequence[Paint], road: Road) -> list[float]:
    """The stations where lanelets of a road end: where lanes do, and where paint on their edges begins or ends."""
    ends = {end for _, *own in lanes for end in own}
    for paint in painted:
        for s_m in (paint.from_m, paint.to_m):
            at = np.array([s_m])
            is_on = any(
                low < s_m < high and np.abs(edge(at) - paint.t(at))[0] < PAINT_M
                for lane, low, high in lanes
                for edge in lane.edges
            )
            if is_on and min(abs(s_m - end) for end in ends) > LEAST_M:
                ends.add(s_m)
        for s_m in _meeting(lanes, paint) if paint.is_temporary else ():
            if min(abs(s_m - end) for end in ends) > LEAST_M:
                ends.add(s_m)
    return sorted(ends)


def _meeting(lanes: Sequence[tuple[NetworkLane, float, float]], paint: Paint) -> Iterator[float]:
    """The stations where a line of road works comes to the edge of a lane, or leaves it."""
    for lane, low, high in lanes:
        s = np.arange(max(low, paint.from_m), min(high, paint.to_m), BOUND_STEP_M)
        for edge in lane.edges:
            is_near = np.abs(edge(s) - paint.t(s)) < PAINT_M
            yield from s[1:][is_near[1:] != is_near[:-1]].tolist()


def _pieces(
    road: Road, lanes: Sequence[NetworkLane], from_m: float, to_m: float, painted: Sequence[Paint], found: Lanelets
) -> dict[str, LaneletPiece]:
    """The pieces of lanes of a road between two stations; where these are beside each other they share a bound."""
    s = np.linspace(from_m, to_m, 3 + int((to_m - from_m) / BOUND_STEP_M))
    lines, edges, sides = list[Scalars](), list[Polyline3](), dict[str, list[int]]()
    for lane in lanes:
        offsets = lane.edges
        for t in (offset(s) for offset in offsets):
            at = next((i for i, line in enumerate(lines) if np.abs(line - t).max() < SAME_M), len(lines))
            if at == len(lines):
                lines.append(t)
                edges.append(road.stretch_of(lane).points(s, t))
            sides.setdefault(lane.id, []).append(at)
    places = thinned(np.stack(edges, axis=1), LINE_M)
    bounds = []
    for i, t in enumerate(lines):
        points = places[:, i]
        along = [at for at in painted if np.mean(_is_along(at, s, t)) > 0.5]
        paint = min(along, key=lambda at: float(np.abs(at.t(s) - t).mean()), default=None)
        bounds.append(Bound(points, (found.joint(points[0]), found.joint(points[-1])), paint))
    made = {}
    for lane in lanes:
        low, high = (bounds[i] for i in sides[lane.id])
        made[lane.id] = LaneletPiece(lane, *((low, high) if lane.ascends != road.line.is_mirrored else (high, low)))
    return made


def _is_along(paint: Paint, s: Scalars, t: Scalars) -> Bool[np.ndarray, " n"]:
    return np.asarray((s >= paint.from_m) & (s <= paint.to_m) & (np.abs(paint.t(s) - t) < PAINT_M))
