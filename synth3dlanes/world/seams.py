"""What looks like lines on the pavement and is none: cracks filled with tar, removed lines, and the joint between old
and new asphalt. World frame.

Along the road all of it stays inside the lanes, at least CLEAR_M from every line, and on lanes that lead to no other
road.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.polylines import stretches
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import NetworkLane, Road
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.system.streams import Streams
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.meshes import Mesh, facing_up
from synth3dlanes.world.paint import towards_eye

# A line on the road: station, offset and width of each of its points.
Trace = Float[np.ndarray, "_ 3"]
# A road between two stations.
RoadPart = tuple[Road, float, float]

# Distance from lines; up to 1 m is compared with a line's own paint.
CLEAR_M = 1.1
# Height over the road as a share of that of paint, and the distance from the host's way up to which there is any.
LIFT_SHARE, SEEN_M = 0.6, 250.0
# Each part of a lane of this length has at most one crack along the road, with probability 1 where tar is 1.
PART_M = 230.0
# Cracks across the road per metre where tar is 1, and the share of these that cross all lanes.
CRACKS_PER_M, ACROSS_ALL = 0.1, 0.6
# Steps along a crack; its slow wandering from knot to knot, and its jitter from step to step.
CRACK_STEP_M, KNOT_M, WANDER_M, JITTER_M = 0.4, 2.0, 0.12, 0.015
TAR_WIDTH_M, CRACK_LENGTH_M, GHOST_STEP_M = (0.03, 0.08), (15.0, 70.0), 0.5
# Reflectance of the asphalt beside a joint, and of a removed line, at contrast 1: lighter where it was milled off.
OLD_ASPHALT, GHOST_SHADES = 0.6, (0.55, 1.6)


def tar_mesh(ground: Ground, amount: float, eye_world: Float[np.ndarray, "3"], streams: Streams) -> Mesh | None:
    """Cracks along and across the host's roads, filled with tar; None without any."""
    network, rng = ground.network, streams("tar")
    traces = []
    for road, low_m, high_m in network.host_stretches:
        ends = np.linspace(low_m, high_m, 1 + int(np.ceil((high_m - low_m) / PART_M)))
        for part in pairwise(ends.tolist()):
            traces += [(road, trace) for trace in _cracks(network, (road, *part), amount, rng)]
    return _mesh(ground, traces, eye_world)


def removed_mesh(ground: Ground, markings: Markings, eye_world: Float[np.ndarray, "3"]) -> Mesh | None:
    """The lines of the network that were removed, as they were painted; dashes may lie elsewhere."""
    traces = []
    for line in ground.network.removed:
        piece = line.pieces[0]
        s = np.arange(line.start_m, line.end_m, GHOST_STEP_M)
        is_painted = (s / markings.dash_cycle_m) % 1 < (markings.dash_fraction if line.marking == "dashed" else 1.0)
        for first, last in stretches(is_painted):
            at = s[first:last]
            columns = np.broadcast_arrays(at, piece.offset(at), markings.width_m)
            traces.append((piece.road, np.column_stack(columns)))
    return _mesh(ground, traces, eye_world)


def ghost_mesh(ground: Ground, markings: Markings, eye_world: Float[np.ndarray, "3"], streams: Streams) -> Mesh | None:
    """Lines of an earlier layout of the lanes, beside today's."""
    rng, traces = streams("ghost_lines"), []
    share, is_dashed, phase = rng.random(3)
    for stretch in ground.network.host_stretches:
        road, low_m, high_m = stretch
        s = np.arange(low_m, high_m, GHOST_STEP_M)
        is_painted = (s / markings.dash_cycle_m + phase) % 1 < (markings.dash_fraction if is_dashed < 0.5 else 1.0)
        traces += [
            (road, np.column_stack(np.broadcast_arrays(at, inside_lane(lane, share)(at), markings.width_m)))
            for lane in clear_lanes(ground.network, stretch)
            for at in (s[first:last] for first, last in stretches(is_painted) if last - first > 1)
        ]
    return _mesh(ground, traces, eye_world)


def joint(network: Network, contrast: float, streams: Streams) -> tuple[float, float]:
    """Where a joint runs, in metres right of the road's line as the host drives, and by which share the asphalt right
    of it is darker; less than 0 where it is lighter. There is none where no place of the texture is along all roads, or
    lines were moved."""
    if not network.across.is_along or network.removed:
        return 0.0, 0.0
    stretch = network.host_stretches[0]
    rng, lanes = streams("joint"), clear_lanes(network, stretch) or _same(stretch[0], stretch[1])[:1]
    lane, share, side = rng.integers(0, len(lanes)), rng.random(), rng.random() < 0.5
    darker = 1 - OLD_ASPHALT**contrast
    aside_m = inside_lane(lanes[lane], share).base_m
    return network.rightward * aside_m, (darker if side else 1 - 1 / (1 - darker))


def ghost_shade(contrast: float, streams: Streams) -> float:
    """Reflectance of removed lines, as a share of the road's."""
    return float(GHOST_SHADES[int(streams("ghost_shade").random() < 0.5)] ** contrast)


def clear_lanes(network: Network, stretch: RoadPart) -> list[NetworkLane]:
    """The lanes of the host's direction of a stretch, as t grows, that are wide enough to be clear of their lines all
    along it, and lead to no other road within it; none where lines were moved, which may run anywhere."""
    if network.removed:
        return []
    road, low_m, high_m = stretch
    s = np.linspace(low_m, high_m, 9)

    def stays(lane: NetworkLane) -> bool:
        left, right = lane.edges
        is_whole = lane.start_m <= low_m and lane.end_m >= high_m
        is_here = is_whole or all(beyond.road == road.id for beyond in network.joined_to(lane))
        return bool(is_here and (right(s) - left(s)).min() > 2 * CLEAR_M)

    return [lane for lane in _same(road, low_m) if stays(lane)]


def inside_lane(lane: NetworkLane, share: float) -> Offset:
    """A line in a lane, clear of its lines."""
    free_m = max(lane.width_m - 2 * CLEAR_M, 0.0)
    return lane.middle.shifted((share - 0.5) * free_m)


def _same(road: Road, s: float) -> list[NetworkLane]:
    """The lanes of a road that go the host's way at a station, as t grows."""
    return [lane for lane in road.lanes_at(s) if lane.direction == "same"]


def _cracks(network: Network, part: RoadPart, amount: float, rng: np.random.Generator) -> Iterator[Trace]:
    """The cracks of a part of a road."""
    road, low_m, high_m = part
    for _ in range(rng.poisson((high_m - low_m) * CRACKS_PER_M * amount)):
        at_m = rng.uniform(low_m, high_m)
        lanes, s = _same(road, at_m), np.array([at_m])
        edges = [float(line(s)[0]) for lane in lanes for line in lane.edges]
        first, last = (0, len(lanes)) if rng.random() < ACROSS_ALL else sorted(rng.integers(0, len(lanes) + 1, 2))
        t = np.arange(edges[2 * first], edges[2 * last - 1], CRACK_STEP_M) if first < last else np.zeros(0)
        if len(t) > 1:
            yield np.column_stack([at_m + _wander(t, rng), t, _widths(t, rng)])
    for lane in clear_lanes(network, part):
        if rng.random() < amount * (high_m - low_m) / PART_M:
            start, length = rng.uniform(low_m, high_m - (high_m - low_m) / 4), rng.uniform(*CRACK_LENGTH_M)
            s = np.arange(start, min(start + length, road.end_m), CRACK_STEP_M)
            t = inside_lane(lane, rng.random())(s) + np.clip(_wander(s, rng), -WANDER_M, WANDER_M)
            yield np.column_stack([s, t, _widths(s, rng)])


def _wander(along: Scalars, rng: np.random.Generator) -> Scalars:
    knots = np.arange(along[0], along[-1] + 2 * KNOT_M, KNOT_M)
    slow = np.interp(along, knots, rng.normal(0, WANDER_M, len(knots)))
    return slow + rng.normal(0, JITTER_M, len(along))


def _widths(along: Scalars, rng: np.random.Generator) -> Scalars:
    return rng.uniform(*TAR_WIDTH_M) * rng.uniform(0.6, 1.4, len(along))


def _mesh(ground: Ground, traces: list[tuple[Road, Trace]], eye_world: Float[np.ndarray, "3"]) -> Mesh | None:
    """Strips along traces on roads, those that are near the host."""
    points, places = [np.zeros((0, 4, 3))], [np.zeros((0, 4, 2))]
    for road, trace in traces:
        if len(trace) > 1:
            middle, steps = trace[:, :2], np.gradient(trace[:, :2], axis=0)
            aside = steps[:, ::-1] * [1, -1] / np.linalg.norm(steps, axis=1, keepdims=True) * trace[:, 2:] / 2
            left, right = middle - aside, middle + aside
            corners = np.stack([left[:-1], right[:-1], right[1:], left[1:]], axis=1)
            places.append(corners)
            points.append(road.points(corners[..., 0], corners[..., 1]))
    xyz, st = np.concatenate(points), np.concatenate(places)
    is_near = ground.way.away_at(xyz[:, 0, :2]) < SEEN_M
    if not is_near.any():
        return None
    xyz, st = xyz[is_near].reshape(-1, 3), st[is_near].reshape(-1, 2)
    return facing_up(towards_eye(ground, xyz, eye_world, LIFT_SHARE), st[:, ::-1].copy())
