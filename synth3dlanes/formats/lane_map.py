"""The lanes of a world as a map: lane segments with both boundaries and their paint, and the edges of the pavement.

Segments are those of the lane graph. World frame, metres; lines go as their traffic does.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.arrays import Points3, Scalars
from synth3dlanes.geometry.lane_curves import LaneCurve
from synth3dlanes.geometry.map_ground import MapGround
from synth3dlanes.geometry.map_network import MapNetwork
from synth3dlanes.geometry.map_roads import map_network
from synth3dlanes.geometry.meshes import grass_in_medians
from synth3dlanes.geometry.network import Network
from synth3dlanes.geometry.paint import is_double, paint_color, pair_of
from synth3dlanes.geometry.roads import SIDES, NetworkLane, Road
from synth3dlanes.labels import Marking, PaintColor, Pair, Segment
from synth3dlanes.scene import Scene
from synth3dlanes.world import World

STEP_M = 0.5
REACH_M = 75.0  # beyond the corner of the area that is labelled
ON_LINE_M = 0.4  # from a point of a delimiter, of which there is one every half metre
LEAST_PAINTED = 0.5
LEAST_GAP_M = 0.25
MIRRORED: dict[Pair, Pair] = {"solid_dashed": "dashed_solid", "dashed_solid": "solid_dashed"}
"""A pair as the traffic sees it that comes from the other side."""


@dataclass(frozen=True, eq=False)
class Boundary:
    """One side of a lane segment, and the paint along most of it; `none` where there is none. `pair` names stripes that
    differ, from the left as the lane's traffic drives."""

    points_world: Points3
    marking: Marking
    color: PaintColor | None
    double: bool | None
    pair: Pair | None = None


@dataclass(frozen=True, eq=False)
class LaneSegment:
    """A lane between two junctions: segment `index` of the lane graph. Each boundary's point i is beside point i of the
    centre line."""

    index: int
    id: str
    points_world: Points3
    left: Boundary
    right: Boundary
    is_connector: bool = False


def lane_segments(
    world: World, segments: tuple[Segment, ...], at_world: Float[np.ndarray, "3"], reach_m: float = REACH_M
) -> Iterator[LaneSegment]:
    """The segments of the lane graph within about `reach_m` of a place of the host."""
    network = world.network
    if isinstance(network, MapNetwork):
        yield from _map_segments(world, network, segments, at_world[:2], 2 * reach_m)
        return
    near_m = float(at_world[1])
    stations = network.stations(near_m + np.arange(-reach_m, reach_m + STEP_M / 2, STEP_M))
    delimiters = {line: _delimiter_xy(line, np.sort(stations)) for line in network.delimiters}
    for index, segment in enumerate(segments):
        lane = network.lanes[segment.id]
        s = np.unique(np.clip(stations, lane.start_m, lane.end_m))
        if len(s) < 2:
            continue
        # Offsets grow to one side of the line; the traffic's left depends on its direction.
        sign = 1 if lane.direction == "same" else -1
        side_m = float(lane.width_m / 2 * network.rightward * sign)
        lines = _lines(network, lane, s, (0.0, -side_m, side_m))
        middle, left, right = (line[:: int(network.onwards * sign)] for line in lines)
        left_side, right_side = (_painted(world, side, delimiters, lane) for side in (left, right))
        yield LaneSegment(index, segment.id, middle, left_side, right_side)


def _map_segments(
    world: World, network: MapNetwork, segments: tuple[Segment, ...], at_xy: Float[np.ndarray, "2"], reach_m: float
) -> Iterator[LaneSegment]:
    """Those of a map: as wide as its lanes are, and those through a junction named as connectors."""
    points = {line: network.sampled_xy(line) for line in network.delimiters}
    delimiters = {line: xy for line, xy in points.items() if (np.linalg.norm(xy - at_xy, axis=1) < reach_m).any()}
    for index, segment in enumerate(segments):
        lane = network.lanes[segment.id]
        first_m, last_m = lane.driven
        s = np.linspace(first_m, last_m, max(2 + int(abs(last_m - first_m) / STEP_M), 3))
        left, right = (edge(s) for edge in network.road(lane.road).edges_of(lane)[:: 1 if lane.ascends else -1])
        middle, *sides = (network.road(lane.road).points(s, t) for t in (lane.middle(s), left, right))
        if (np.linalg.norm(middle[:, :2] - at_xy, axis=1) < reach_m).any():
            left_side, right_side = (_painted(world, side, delimiters, lane) for side in sides)
            yield LaneSegment(index, segment.id, middle, left_side, right_side, lane.junction is not None)


def pavement_edges(world: World, at_world: Float[np.ndarray, "3"], reach_m: float = REACH_M) -> Iterator[Points3]:
    """The edges of the pavement, shoulders included, and of a median's grass, within about `reach_m` of a place."""
    if isinstance(world.ground, MapGround):
        for ring in world.ground.rings(at_world[:2], 2 * reach_m):
            yield np.column_stack([ring, world.ground.under(ring)])
        return
    for road, s, (left, *grass, right) in _pavement_lines(world, at_world, reach_m):
        for t in (left, right, *grass):
            yield from runs(road.points(s, t), ~world.ground.is_on_other(road, road.xy(s, t)))


def pavement_strips(
    world: World, at_world: Float[np.ndarray, "3"], reach_m: float
) -> Iterator[tuple[Points3, Points3]]:
    """Both edges of each strip of pavement within about `reach_m` of a place: of every road, and on both sides of a
    median's grass."""
    if isinstance(world.ground, MapGround):
        yield from world.ground.paved_strips(at_world[:2], 2 * reach_m)
        return
    for road, s, offsets in _pavement_lines(world, at_world, reach_m):
        for low, high in zip(offsets[::2], offsets[1::2], strict=True):
            if len(s) > 1:
                yield road.points(s, low), road.points(s, high)


def _pavement_lines(
    world: World, at_world: Float[np.ndarray, "3"], reach_m: float
) -> Iterator[tuple[Road, Scalars, list[Scalars]]]:
    """Of every road the stations, and the offsets where pavement begins and ends in turn, as t grows."""
    near_m = float(at_world[1])
    stations = np.sort(world.network.stations(near_m + np.arange(-reach_m, reach_m + STEP_M / 2, STEP_M)))
    for road in world.network.roads:
        s = stations[(stations >= road.start_m) & (stations <= road.end_m)]
        grass = [np.full(len(s), t) for median in grass_in_medians(world.ground, road) for t in median]
        left, right = (road.edge(side, s) for side in SIDES)
        yield road, s, [left, *grass, right]


def runs(points: Float[np.ndarray, "n 3"], keep: Bool[np.ndarray, " n"]) -> list[Float[np.ndarray, "_ 3"]]:
    """The stretches of a line that are kept, of two points or more."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(int), [0]])))
    return [points[a:b] for a, b in ends.reshape(-1, 2) if b - a >= 2]


def _lines(
    network: Network, lane: NetworkLane, s: Scalars, asides_m: tuple[float, ...]
) -> list[Float[np.ndarray, "_ 3"]]:
    """A lane's centre and lines beside it, at stations in ascending order."""
    road = network.road(lane.road)
    offsets = [lane.middle(s) + aside_m for aside_m in asides_m]
    lines = [road.points(s, t) for t in offsets]
    before = next((at for at in network.joined_to(lane) if at.road != lane.road and at.end_m == lane.start_m), None)
    if before is None or s[0] > lane.start_m:
        return lines
    # It begins where the lane before it ends, on another road; its own first points may lie behind that.
    other = network.road(before.road)
    ahead = np.all([other.line.project(road.xy(s, t))[0] > s[0] + LEAST_GAP_M for t in offsets], axis=0)
    starts = [other.points(s[:1], before.middle(s[:1]) + aside_m) for aside_m in asides_m]
    return [np.concatenate([start, line[ahead]]) for start, line in zip(starts, lines, strict=True)]


def _delimiter_xy(line: LaneCurve, s: Scalars) -> Float[np.ndarray, "_ 2"]:
    return line.xy_world(s[(s >= line.start_m) & (s <= line.end_m)])


def _painted(
    world: World,
    points_world: Points3,
    delimiters: dict[LaneCurve, Float[np.ndarray, "_ 2"]],
    lane: NetworkLane,
) -> Boundary:
    best, best_share = None, LEAST_PAINTED
    for line, xy in delimiters.items():
        if len(xy):
            gaps_m = np.linalg.norm(points_world[:, None, :2] - xy, axis=2).min(axis=1)
            share = float(np.mean(gaps_m < ON_LINE_M))
            if share > best_share:
                best, best_share = line, share
    if best is None:
        return Boundary(points_world, "none", None, None)
    markings = world.scene.markings
    pair = pair_of(best, markings)
    if pair is not None and _is_against(best, delimiters[best], points_world, lane):
        pair = MIRRORED[pair]
    return Boundary(points_world, best.marking, paint_color(best, markings), is_double(best, markings), pair)


def _is_against(line: LaneCurve, xy: Float[np.ndarray, "_ 2"], points_world: Points3, lane: NetworkLane) -> bool:
    """Whether a line goes the other way than the points of a lane beside it; those of the paper's roads go as the host
    drives."""
    if not line.is_measured:
        return lane.direction == "oncoming"
    first, last = (int(np.linalg.norm(xy - end, axis=1).argmin()) for end in points_world[[0, -1], :2])
    return last < first


def half_widths(scene: Scene, names: list[str]) -> list[tuple[float, float]]:
    """Half the least and the greatest width of each lane."""
    if scene.map is None:
        half_m = scene.paper_road.lane_width_m / 2
        return [(half_m, half_m)] * len(names)
    found = []
    network = map_network(scene.map, scene.terrain, scene.camera.y_m)
    for name in names:
        lane = network.lanes[name]
        left, right = network.road(lane.road).edges_of(lane)
        s = np.linspace(lane.start_m, lane.end_m, 50)
        widths_m = right(s) - left(s)
        found.append((float(widths_m.min()) / 2, float(widths_m.max()) / 2))
    return found
