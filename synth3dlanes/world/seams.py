"""What looks like lines on the pavement and is none: cracks filled with tar, removed lines, and the joint between old
and new asphalt. World frame.

Along the road all of it stays inside the lanes, at least CLEAR_M from every line, and on lanes that lead to no other
road.
"""

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.polylines import stretches
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.system.streams import Streams
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.meshes import Mesh, facing_up
from synth3dlanes.world.paint import towards_eye

# A line on the road: station, offset and width of each of its points.
Trace = Float[np.ndarray, "_ 3"]

# Distance from lines; up to 1 m is compared with a line's own paint.
CLEAR_M = 1.1
# Stations with seams. All of it lies below paint, by this share of its height over the road.
REACH_M, LIFT_SHARE = 115.0, 0.6
# Cracks across the road by the metre where tar is 1, and the share of these that cross all lanes.
CRACKS_PER_M, ACROSS_ALL = 0.1, 0.6
# Steps along a crack, and how far it wanders: over KNOT_M slowly, and from step to step.
STEP_M, KNOT_M, WANDER_M, JITTER_M = 0.4, 2.0, 0.12, 0.015
TAR_WIDTH_M, CRACK_LENGTH_M, GHOST_STEP_M = (0.03, 0.08), (15.0, 70.0), 0.5
# Reflectance of the asphalt beside a joint, and of a removed line, at contrast 1: lighter where it was milled off.
OLD_ASPHALT, GHOST_SHADES = 0.6, (0.55, 1.6)


def tar_mesh(ground: Ground, amount: float, eye_world: Float[np.ndarray, "3"], streams: Streams) -> Mesh | None:
    """Cracks along and across the host's road, filled with tar; None without any."""
    network, rng = ground.network, streams("tar")
    traces = []
    for _ in range(rng.poisson(2 * REACH_M * CRACKS_PER_M * amount)):
        at_m = rng.uniform(-REACH_M, REACH_M)
        low_m, width_m, lanes = _lanes_at(network, at_m)
        first, last = (0, lanes) if rng.random() < ACROSS_ALL else sorted(rng.integers(0, lanes + 1, 2))
        t = np.arange(low_m + first * width_m, low_m + last * width_m, STEP_M)
        if len(t) > 1:
            traces.append(np.column_stack([at_m + _wander(t, rng), t, _widths(t, rng)]))
    for lane in clear_lanes(network):
        if rng.random() < amount:
            start, length = rng.uniform(-REACH_M, REACH_M / 2), rng.uniform(*CRACK_LENGTH_M)
            s = np.arange(start, start + length, STEP_M)
            t = inside_lane(lane, rng.random()) + np.clip(_wander(s, rng), -WANDER_M, WANDER_M)
            traces.append(np.column_stack([s, t, _widths(s, rng)]))
    return _mesh(ground, traces, eye_world)


def ghost_mesh(ground: Ground, markings: Markings, eye_world: Float[np.ndarray, "3"], streams: Streams) -> Mesh | None:
    """Lines of an earlier layout of the lanes, beside today's."""
    rng = streams("ghost_lines")
    share, is_dashed, phase = rng.random(3)
    s = np.arange(-REACH_M, REACH_M, GHOST_STEP_M)
    is_painted = (s / markings.dash_cycle_m + phase) % 1 < (markings.dash_fraction if is_dashed < 0.5 else 1.0)
    traces = [
        np.column_stack(np.broadcast_arrays(s[first:last], inside_lane(lane, share), markings.width_m))
        for lane in clear_lanes(ground.network)
        for first, last in stretches(is_painted)
        if last - first > 1
    ]
    return _mesh(ground, traces, eye_world)


def joint(network: Network, contrast: float, streams: Streams) -> tuple[float, float]:
    """Where a joint runs, in metres right of the road's line as the host drives, and by which share the asphalt right
    of it is darker; less than 0 where it is lighter."""
    rng, lanes = streams("joint"), clear_lanes(network) or _same(network, -np.inf)[:1]
    lane, share, side = rng.integers(0, len(lanes)), rng.random(), rng.random() < 0.5
    darker = 1 - OLD_ASPHALT**contrast
    aside_m = inside_lane(lanes[lane], share)
    return network.rightward * aside_m, (darker if side else 1 - 1 / (1 - darker))


def ghost_shade(contrast: float, streams: Streams) -> float:
    """Reflectance of removed lines, as a share of the road's."""
    return float(GHOST_SHADES[int(streams("ghost_shade").random() < 0.5)] ** contrast)


def clear_lanes(network: Network) -> list[NetworkLane]:
    """The lanes of the host's road and direction, as t grows, that lead to no other road."""
    road = network.main

    def stays(lane: NetworkLane) -> bool:
        return all(beyond.road == road.id for beyond in network.joined_to(lane))

    return [lane for lane in _same(network, -np.inf) if stays(lane)]


def inside_lane(lane: NetworkLane, share: float) -> float:
    """An offset in a lane, clear of its lines."""
    free_m = max(lane.width_m - 2 * CLEAR_M, 0.0)
    return lane.middle.base_m + (share - 0.5) * free_m


def _same(network: Network, s: float) -> list[NetworkLane]:
    """The lanes of the host's road and direction at a station, as t grows."""
    return [lane for lane in network.main.lanes_at(s) if lane.direction == "same"]


def _lanes_at(network: Network, s: float) -> tuple[float, float, int]:
    """The leftmost edge, the width and the number of these lanes."""
    lanes = _same(network, s)
    return lanes[0].middle.base_m - lanes[0].width_m / 2, lanes[0].width_m, len(lanes)


def _wander(along: Scalars, rng: np.random.Generator) -> Scalars:
    knots = np.arange(along[0], along[-1] + 2 * KNOT_M, KNOT_M)
    slow = np.interp(along, knots, rng.normal(0, WANDER_M, len(knots)))
    return slow + rng.normal(0, JITTER_M, len(along))


def _widths(along: Scalars, rng: np.random.Generator) -> Scalars:
    return rng.uniform(*TAR_WIDTH_M) * rng.uniform(0.6, 1.4, len(along))


def _mesh(ground: Ground, traces: list[Trace], eye_world: Float[np.ndarray, "3"]) -> Mesh | None:
    """Strips along the traces on the host's road."""
    if not traces:
        return None
    corners = []
    for trace in traces:
        middle, steps = trace[:, :2], np.gradient(trace[:, :2], axis=0)
        aside = steps[:, ::-1] * [1, -1] / np.linalg.norm(steps, axis=1, keepdims=True) * trace[:, 2:] / 2
        left, right = middle - aside, middle + aside
        corners.append(np.stack([left[:-1], right[:-1], right[1:], left[1:]], axis=1))
    places = np.concatenate(corners).reshape(-1, 2)
    xyz = ground.network.main.points(places[:, 0], places[:, 1])
    return facing_up(towards_eye(ground, xyz, eye_world, LIFT_SHARE), places[:, ::-1].copy())
