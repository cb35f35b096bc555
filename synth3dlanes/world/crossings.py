"""Gantries and bridges over the road. World frame, metres."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.roads import NetworkLane
from synth3dlanes.scene.roadside import Crossing
from synth3dlanes.world.beside import frames_beside, ground_over, on_ground
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.sign_faces import Patch, board
from synth3dlanes.world.signals import LANE_HEAD_M, Mounted, board_size
from synth3dlanes.world.solids import METAL, SINK_M, Body, GroundFrame, Quads

# Least gap between a crossing's supports and any pavement, and how far from its axis supports are looked for.
SUPPORT_GAP_M, MAX_SPAN_M = 0.8, 90.0
# From a bridge's outer columns to its abutments, the slope and the fall of the dams behind these, and their length.
ABUTMENT_M, DAM_SLOPE, DAM_FALL, DAM_M = 7.0, 1.5, 0.05, 110.0
DECK_M, PARAPET_M, ABUTMENT_WALL_M = 1.1, 0.95, 1.0
# From the front of a gantry to the middle of its boards.
BOARD_BEFORE_M, HAIR_M = 0.13, 1e-6
EARTH = (0.1, 0.1, 0.05, 0.0)


class GantryBoard(NamedTuple):
    """A board of a gantry: its place and picture, the number of its variant, and the lanes below it."""

    place: Mounted
    layers: tuple[Patch, ...]
    variant: int
    lanes: tuple[str, ...]


@dataclass(frozen=True)
class CrossingSpan:
    """A crossing in its frame: x of its legs and of a bridge's abutments (left and right), and the world heights of its
    lower side and its top."""

    legs_m: tuple[float, float]
    abutments_m: tuple[float, float]
    under_m: float
    top_m: float


def crossing_frame(ground: Ground, crossing: Crossing) -> GroundFrame:
    return frames_beside(ground, ground.network.main.id, "median", np.array([crossing.s_m]), 0.0)[0]


def crossing_span(ground: Ground, crossing: Crossing) -> CrossingSpan:
    """Where a crossing's legs and abutments stand clear of all pavements, and how high it is above these."""
    frame = crossing_frame(ground, crossing)
    half_m = crossing.width_m / 2
    x = np.arange(-MAX_SPAN_M, MAX_SPAN_M + 0.1, 0.25)
    y = np.linspace(-half_m, half_m, 5)
    strip = frame.world(np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((len(x), len(y)))], -1))[..., :2]
    clearance_m = ground.clearance(strip).min(axis=1)
    gap_m = SUPPORT_GAP_M + (0.5 if crossing.kind == "bridge" else 0.2)
    legs, abutments = [], []
    for sign in (-1, 1):
        out = np.flatnonzero((sign * x > 0) & (clearance_m > gap_m))
        legs.append(float(x[out[np.abs(x[out]).argmin()]]) if out.size else sign * MAX_SPAN_M)
        paved = sign * x[(sign * x > 0) & (clearance_m < 3.0)]
        abutments.append(sign * max(float(paved.max(initial=0.0)) + 1.0, sign * legs[-1] + ABUTMENT_M))
    ends = abutments if crossing.kind == "bridge" else legs
    under = strip[(x > ends[0]) & (x < ends[1])]
    heights = ground.height(under.reshape(-1, 2)).reshape(under.shape[:2])
    paved_m = heights[ground.clearance(under.reshape(-1, 2)).reshape(under.shape[:2]) < 0.5]
    under_m = float(paved_m.max()) + crossing.clearance_m
    depth_m = DECK_M if crossing.kind == "bridge" else 2.0
    return CrossingSpan((legs[0], legs[1]), (abutments[0], abutments[1]), under_m, under_m + depth_m)


def crossing_body(ground: Ground, crossing: Crossing) -> Body:
    """A gantry or bridge."""
    frame, span = crossing_frame(ground, crossing), crossing_span(ground, crossing)
    quads = Quads(crossing.kind, "pole" if crossing.kind == "gantry" else "bridge")
    if crossing.kind == "gantry":
        _gantry(quads, ground, crossing, frame, span)
    else:
        _bridge(quads, ground, crossing, frame, span)
    return quads.body()


def _gantry(quads: Quads, ground: Ground, crossing: Crossing, frame: GroundFrame, span: CrossingSpan) -> None:
    """Two legs, and two chords with struts between them."""
    half, (left, right) = crossing.width_m / 2, span.legs_m
    base, rise_m = _gantry_base(ground, crossing, frame), 1.3
    feet = np.array([(left, 0.0), (right, 0.0)])
    for (x, _), z in zip(feet, ground_over(ground, frame, feet), strict=True):
        quads.box(frame, (x - 0.16, -0.16, z - SINK_M), (x + 0.16, 0.16, base + rise_m + 0.1), METAL)
    for y in (-half, half):
        for z in (base, base + rise_m):
            quads.box(frame, (left, y - 0.07, z - 0.07), (right, y + 0.07, z + 0.07), METAL)
        ends = np.linspace(left, right, 2 + int((right - left) / 2.2))
        for i, (a, b) in enumerate(pairwise(ends)):
            low, high = (base, base + rise_m) if i % 2 else (base + rise_m, base)
            quads.tube(frame.world(np.array([(a, y, low), (b, y, high)])), (0.04, 0.04), METAL, n=3)
    quads.feet.append(on_ground(ground, frame.world(np.column_stack([feet, np.zeros(2)]))[:, :2]))


def gantry_boards(ground: Ground, crossing: Crossing) -> list[GantryBoard]:
    """The boards in front of a gantry without signals, towards the traffic below."""
    if crossing.kind != "gantry" or crossing.signals:
        return []
    frame, road, to_right = crossing_frame(ground, crossing), ground.network.main, ground.network.rightward
    base, s = _gantry_base(ground, crossing, frame), np.array([crossing.s_m])
    edges = np.array([road.left(s)[0], road.right(s)[0]]) * to_right
    middle, width_m = float(edges.mean()), float(np.ptp(edges)) - 2 * road.shoulder_m
    n = max(1, min(3, round(width_m / 5)))
    found = []
    for i, x in enumerate((middle + width_m * ((np.arange(n) + 0.5) / n - 0.5)).tolist()):
        variant = i + round(10 * abs(crossing.s_m))
        layers = board(0.82 * min(width_m / n, 5.5), 2.0, crossing.color, variant)
        is_oncoming = road.is_oncoming(x * to_right)
        before_m = crossing.width_m / 2 + BOARD_BEFORE_M
        own = GroundFrame(frame.world(np.array([x, 0.0, 0.0])), -frame.forward if is_oncoming else frame.forward)
        place = Mounted(own, np.array([0.0, -before_m, base - 0.35 + 1.0]), board_size(layers))
        below = [
            lane.id
            for lane in sorted(road.lanes_at(crossing.s_m), key=lambda lane: to_right * lane.middle.base_m)
            if abs(float(lane.middle(s)[0]) * to_right - x) <= width_m / n / 2 + HAIR_M
            and (lane.direction == "oncoming") == is_oncoming
        ]
        found.append(GantryBoard(place, layers, variant, tuple(below)))
    return found


def _gantry_base(ground: Ground, crossing: Crossing, frame: GroundFrame) -> float:
    """The height of a gantry's lower chords in its frame."""
    return crossing_span(ground, crossing).under_m - float(frame.origin[2]) + 0.35


def lane_signal_places(ground: Ground, crossing: Crossing) -> list[Mounted]:
    """Where the signals of a gantry hang: over the middles of their lanes, towards the traffic of these."""
    if not crossing.signals:
        return []
    network, frame = ground.network, crossing_frame(ground, crossing)
    low_m = crossing_span(ground, crossing).under_m - float(frame.origin[2]) + 0.05
    found = []
    for signal in crossing.signals:
        lane = network.lanes[signal.lane]
        road = network.road(lane.road)
        s = _station_below(ground, crossing, lane)
        sign = 1.0 if lane.direction == "same" else -1.0
        at = frame.of_world(np.array([*road.xy(s, lane.middle(s))[0], 0.0]))
        own = GroundFrame(frame.world(np.array([at[0], 0.0, 0.0])), sign * frame.forward)
        own_half = crossing.width_m / 2 + 0.12 + LANE_HEAD_M[1] / 2
        middle = np.array([0.0, -own_half, low_m + LANE_HEAD_M[2] / 2])
        found.append(Mounted(own, middle, LANE_HEAD_M))
    return found


def _station_below(ground: Ground, crossing: Crossing, lane: NetworkLane) -> Float[np.ndarray, "1"]:
    """The station of a lane's road below a crossing, which is at a station of the main road."""
    road, frame = ground.network.road(lane.road), crossing_frame(ground, crossing)
    s = np.array([crossing.s_m])
    for _ in range(6):
        ahead_m = frame.of_world(np.array([*road.xy(s, lane.middle(s))[0], 0.0]))[1]
        s = s - ahead_m * ground.network.onwards
    return s


def _bridge(quads: Quads, ground: Ground, crossing: Crossing, frame: GroundFrame, span: CrossingSpan) -> None:
    """A deck with parapets on columns and abutments, and dams of earth behind these."""
    half, color = crossing.width_m / 2, (*crossing.color, 0.0)
    dark = (*(0.8 * channel for channel in crossing.color), 0.0)
    under, top = span.under_m - float(frame.origin[2]), span.top_m - float(frame.origin[2])
    (left, right), (far_left, far_right) = span.legs_m, span.abutments_m
    quads.box(frame, (far_left, -half + 0.8, under), (far_right, half - 0.8, top - 0.35), dark)
    quads.box(frame, (far_left, -half, top - 0.35), (far_right, half, top), color)
    for y in (-half, half - 0.25):
        quads.box(frame, (far_left - 4, y, top), (far_right + 4, y + 0.25, top + PARAPET_M), color)
    columns = np.array([(x, y) for x in (left, right) for y in np.linspace(1.2 - half, half - 1.2, 3)])
    for (x, y), z in zip(columns, ground_over(ground, frame, columns), strict=True):
        quads.box(frame, (x - 0.4, y - 0.4, z - SINK_M), (x + 0.4, y + 0.4, under), dark)
    for sign, x in ((-1, far_left), (1, far_right)):
        wall = np.column_stack([np.full(5, x), np.linspace(-half, half, 5)])
        low = float(ground_over(ground, frame, wall).min()) - 1.0
        back = x + sign * (ABUTMENT_WALL_M + 0.1)
        quads.box(frame, (min(x, back), -half, min(low, under - 0.5)), (max(x, back), half, top - 0.35), color)
        rows = dam_section(ground, frame, x + sign * ABUTMENT_WALL_M, sign, half, top)
        quads.sweep(frame.world(rows), EARTH)
        quads.add(frame.world(rows[:1]), EARTH)
    quads.feet.append(on_ground(ground, frame.world(np.column_stack([columns, np.zeros(len(columns))]))[:, :2]))


def dam_section(
    ground: Ground, frame: GroundFrame, x: float, sign: int, half_m: float, top_m: float
) -> Float[np.ndarray, "r 4 3"]:
    """Rows of foot, top, top and foot of the dam of a bridge's road, from its abutment outwards to DAM_M, in the
    crossing's frame."""
    way = np.linspace(0, DAM_M, 12)
    middle = np.column_stack([x + sign * way, np.zeros(12)])
    low = ground_over(ground, frame, middle)
    top = np.maximum(top_m - DAM_FALL * way, low - 1.0)
    foot = np.zeros((12, 2))
    for side, y_sign in enumerate((-1, 1)):
        y = np.full(12, y_sign * half_m)
        for _ in range(4):
            z = ground_over(ground, frame, np.column_stack([middle[:, 0], y]))
            y = y_sign * (half_m + DAM_SLOPE * np.clip(top - z, 0, None))
        foot[:, side] = y
    ends = np.array([-half_m, half_m])
    y = np.column_stack([foot[:, 0], np.tile(ends, (12, 1)), foot[:, 1]])
    z_foot = [top - (np.abs(foot[:, k]) - half_m) / DAM_SLOPE - 0.3 for k in (0, 1)]
    z = np.column_stack([z_foot[0], top, top, z_foot[1]])
    return np.stack([np.tile(middle[:, :1], (1, 4)), y, z], -1)
