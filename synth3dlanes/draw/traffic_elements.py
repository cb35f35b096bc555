"""Ground -> Roadside: signals over the lanes of gantries, and signs before exits. Stations of the main road."""

import numpy as np

from synth3dlanes.draw.draws import Draw
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane, Side
from synth3dlanes.scene.roadside import Crossing, Roadside
from synth3dlanes.scene.traffic_elements import LaneSignal, LaneState, SignKind, TrafficSign
from synth3dlanes.world.beside import beside, frames_beside
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.mounted import board_size
from synth3dlanes.world.roadside import footprints
from synth3dlanes.world.sign_faces import SIGN_FACES

MM_DECIMALS, ANGLE_DECIMALS, TRIES = 3, 6, 12
# How far from the edge of the pavement, or from a rail before it, a sign stands, and how far over a wall.
ASIDE_M, BEHIND_RAIL_M, OVER_WALL_M = 1.0, 0.9, 0.3
# Room around a sign's foot, distance from crossings, and where signs stand, from behind the host to ahead of it.
ROOM_M, APART_M, AHEAD_OF_HOST_M = 0.6, 4.0, (-30.0, 180.0)


def draw_elements(ground: Ground, roadside: Roadside, draw: Draw, own: Draw) -> Roadside:
    """The roadside with its signals and signs that govern lanes of their own."""
    crossings = tuple(_with_signals(ground.network, crossing, draw) for crossing in roadside.crossings)
    drawn = roadside.model_copy(update={"crossings": crossings})
    has_signs, rng = draw("exit_signs"), draw.rng
    numbers = rng.random((TRIES, 3))
    signs = _exit_sign(ground, drawn, numbers, own) if has_signs else ()
    return drawn.model_copy(update={"signs": signs})


def _with_signals(network: Network, crossing: Crossing, draw: Draw) -> Crossing:
    """A gantry with a signal over each lane, or as it was."""
    if crossing.kind != "gantry" or not draw("lane_signals"):
        return crossing
    below = {lane.id for road in network.roads if road.parting is None for lane in road.lanes_at(crossing.s_m)}
    lanes = [lane for lane in network.lanes.values() if lane.id in below]
    signals = tuple(LaneSignal(lane=lane.id, state=_possible(draw("lane_state"), lane, below)) for lane in lanes)
    return crossing.model_copy(update={"signals": signals})


def _possible(state: LaneState, lane: NetworkLane, beside: set[str]) -> LaneState:
    """The state, if there is a lane where its arrow sends the traffic; else a cross."""
    to_right = {"amber_right": 1, "amber_left": -1}.get(state, 0) * (1 if lane.direction == "same" else -1)
    return state if not to_right or f"{lane.section}_{lane.number + to_right}" in beside else "red_cross"


def _exit_sign(ground: Ground, roadside: Roadside, numbers: np.ndarray, own: Draw) -> tuple[TrafficSign, ...]:
    """A sign beside the road before an exit that points to it, on its side; none where there is no room."""
    network = ground.network
    leaving = [
        (network.lanes[before], network.lanes[after])
        for before, after in network.links
        if network.lanes[before].road == network.main.id != network.lanes[after].road
    ]
    if not leaving:
        return ()
    exit_road = network.road(leaving[0][1].road)
    lanes = tuple(dict.fromkeys([before.id for before, _ in leaving] + [after.id for _, after in leaving]))
    side: Side = "right"
    kind: SignKind = "exit_right" if network.rightward > 0 else "exit_left"
    half_m, taken = board_size(SIGN_FACES[kind])[0] / 2, footprints(ground, roadside)
    for before, aside, height in numbers.tolist():
        s_m = exit_road.start_m - network.onwards * own.at("exit_sign_before_m", before)
        ahead_m = s_m * network.onwards - ground.way.near_m
        rails = [
            rail
            for rail in roadside.rails
            if (rail.road, rail.side) == (network.main.id, side) and rail.from_m - 3 <= s_m <= rail.to_m + 3
        ]
        aside_m = max([ASIDE_M, *(rail.aside_m + BEHIND_RAIL_M for rail in rails)]) + half_m + aside
        # Over a wall, so that it can be read.
        over_m = max((rail.height_m for rail in rails if rail.kind == "noise_wall"), default=0.0)
        raised_m = max(0.0, over_m + OVER_WALL_M - own.least("exit_sign_height_m"))
        height_m = own.at("exit_sign_height_m", height) + raised_m
        s = np.array([s_m])
        foot = beside(ground, network.main.id, side, s, aside_m)
        is_free = taken.clear(foot, ROOM_M)[0] and ground.clearance(foot)[0] > aside_m - 0.02
        is_apart = all(abs(crossing.s_m - s_m) > crossing.width_m / 2 + APART_M for crossing in roadside.crossings)
        if is_free and is_apart and AHEAD_OF_HOST_M[0] < ahead_m < AHEAD_OF_HOST_M[1] + ground.way.driven_m:
            (frame,) = frames_beside(ground, network.main.id, side, s, aside_m)
            sign = TrafficSign(
                x_m=round(float(foot[0, 0]), MM_DECIMALS),
                y_m=round(float(foot[0, 1]), MM_DECIMALS),
                yaw_rad=round(float(np.arctan2(-frame.forward[0], frame.forward[1])), ANGLE_DECIMALS),
                height_m=round(height_m, MM_DECIMALS),
                kind=kind,
                lanes=lanes,
            )
            return (sign,)
    return ()
