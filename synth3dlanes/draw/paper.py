"""The maker of the paper's roads: a road with its exit, the host in a lane of it, and what is only there: signals over
the lanes of gantries, signs before exits, and paint that bounds no lane. Stations of the main road."""

import numpy as np

from synth3dlanes.draw.cars import cars_along_road
from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw, DrawsOf
from synth3dlanes.draw.makers import Roads, draw_camera, draw_hills, first_shot
from synth3dlanes.draw.roadside import draw_roadside
from synth3dlanes.draw.rules import lane_of_host
from synth3dlanes.draw.works import with_works
from synth3dlanes.params.shots import Shots
from synth3dlanes.roads.from_paper import is_wide_enough, paper_network
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane, Side
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.host import HostCamera, Shot
from synth3dlanes.scene.roadside import Crossing, Roadside
from synth3dlanes.scene.scene import MIN_MEDIAN_M, PaperRoad, Scene, Symbol
from synth3dlanes.scene.traffic_elements import LaneSignal, LaneState, SignKind, TrafficSign
from synth3dlanes.system.schema import SymbolKind
from synth3dlanes.world.beside import beside, frames_beside
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.roadside import footprints
from synth3dlanes.world.sign_faces import SIGN_FACES
from synth3dlanes.world.signals import board_size
from synth3dlanes.world.symbols import LENGTHS_M, gore_of

# Draws of a place for each symbol.
SYMBOL_TRIES = 300
# Arrows that allow a turn as well, and arrows that demand it.
STRAIGHT: SymbolKind = "arrow_straight"
TO_LEFT: tuple[SymbolKind, SymbolKind] = ("arrow_straight_left", "arrow_left")
TO_RIGHT: tuple[SymbolKind, SymbolKind] = ("arrow_straight_right", "arrow_right")
# The shoulder texture that is pavement.
PAVED = 2
# Least distance along the road between symbols, and between them and places where roads part.
SYMBOL_GAP_M, PARTING_GAP_M = 1.0, 8.0
MM_DECIMALS, ANGLE_DECIMALS, SIGN_TRIES = 3, 6, 12
# How far from the edge of the pavement, or from a rail before it, a sign stands, and how far over a wall.
ASIDE_M, BEHIND_RAIL_M, OVER_WALL_M = 1.0, 0.9, 0.3
# Room around a sign's foot, distance from crossings, and where signs stand, from behind the host to ahead of it.
ROOM_M, APART_M, AHEAD_OF_HOST_M = 0.6, 4.0, (-30.0, 180.0)


def paper_roads(of: DrawsOf, shots: Shots, assets: Assets) -> Roads:
    """The paper's road with its exit."""
    terrain, road, shot = draw_hills(of("terrain")), draw_road(of("road")), first_shot(shots, of("motion"))
    network, draw = paper_network(road, terrain), of("camera")
    u_lane, y_m = draw.rng.random(), draw("y_m")
    lane = lane_of_host(of.params.camera.lane, road.lanes_present(y_m)).draw(u_lane)
    camera = _on_its_road(network, draw_camera(draw, lane, y_m), shot)
    road, camera = with_works(road, camera, of("works"))
    if road.works is not None:
        network = paper_network(road, terrain)

    def stand(scene: Scene, ground: Ground) -> Roadside:
        own = of("structures")
        return draw_elements(
            ground, draw_roadside(ground, of("roadside"), own), of("roadside", "traffic_elements"), own
        )

    return Roads(
        network=network,
        fields={"terrain": terrain, "road": road, "camera": camera, "shot": shot},
        stand=stand,
        drive=lambda scene, ground: cars_along_road(scene, ground.network, of),
        paint=lambda scene, ground: draw_symbols(scene, ground.network, of("symbols")),
    )


def draw_road(draw: Draw) -> PaperRoad:
    """The numbers of the road, by its rules (docs/params.md)."""
    drawn = {field: draw(field.replace("_rad", "_deg")) for field in PaperRoad.model_fields if field != "works"}
    if drawn["topology"] > 2:
        drawn["n_lanes"] = max(drawn["n_lanes"], 2)
    if drawn["n_oncoming"] == 0 or drawn["median_m"] < MIN_MEDIAN_M:
        drawn["median_m"] = 0.0
    road = PaperRoad(**drawn)
    return road if is_wide_enough(road) else road.model_copy(update={"n_oncoming": 0, "median_m": 0.0})


def _on_its_road(network: Network, camera: HostCamera, shot: Shot) -> HostCamera:
    """The host, in the lane beside its own if its own leads from its road within the clip."""
    lane = network.host_lane(camera.lane, camera.y_m)
    beside = [at for at in network.lanes_at(camera.y_m * network.onwards) if abs(at.number - lane.number) == 1]
    # On the inside of a bend a lane is shorter than its stations.
    reached_m = camera.y_m + 2 * shot.speed_m_s * shot.duration_s
    after = network.successors(lane.id) if reached_m * network.onwards >= lane.end_m else []
    if not after or any(at.road == lane.road for at in after):
        return camera
    return camera.model_copy(update={"lane": beside[0].number})


def draw_symbols(scene: Scene, network: Network, draw: Draw) -> tuple[Symbol, ...]:
    """Symbols that do not overlap along the road; those without room are left out, and a gore on a gravel shoulder."""
    partings = [(at.start_m, at.parting.station(0.0)) for at in network.branches(network.main) if at.parting]
    asked: dict[SymbolKind, int] = {"crosswalk": draw("crosswalks"), "stop_line": draw("stop_lines")}
    n_arrow_rows, gore = draw("arrow_rows"), draw("gore")
    turns = draw.rng.random(2).tolist()
    works = scene.roads.works
    taken = [] if works is None else [((works.start_m + works.end_m) / 2, works.end_m - works.start_m)]

    def place(length_m: float, before_only: bool = False) -> float | None:
        """A free station on the host's road, before others leave it or also where their lanes have parted from it."""
        for _ in range(SYMBOL_TRIES):
            s_m = draw("s_m")
            s, reach_m = s_m * network.onwards, length_m / 2 + SYMBOL_GAP_M
            is_clear = all(
                s + reach_m < start_m - PARTING_GAP_M or (not before_only and s - reach_m > end_m + PARTING_GAP_M)
                for start_m, end_m in partings
            )
            if is_clear and all(abs(s_m - other_m) > (length_m + other) / 2 + SYMBOL_GAP_M for other_m, other in taken):
                taken.append((s_m, length_m))
                return s_m
        return None

    symbols = []
    for kind, n in asked.items():
        for _ in range(n):
            if (s_m := place(LENGTHS_M[kind], before_only=True)) is not None:
                symbols.append(Symbol(kind=kind, lane=None, s_m=s_m))
    for _ in range(n_arrow_rows):
        if (s_m := place(LENGTHS_M["arrow_straight"])) is not None:
            lanes = [lane for lane in network.lanes_at(s_m * network.onwards) if lane.direction == "same"]
            symbols += [Symbol(kind=_arrow(network, lane, turns), lane=lane.id, s_m=s_m) for lane in lanes]
    hatched = gore_of(network)
    if gore and hatched is not None and scene.surface.shoulder_texture == PAVED:
        symbols.append(Symbol(kind="gore", lane=None, s_m=round(hatched[1] * network.onwards, SCENE_DECIMALS)))
    return tuple(symbols)


def _arrow(network: Network, lane: NetworkLane, turns: list[float]) -> SymbolKind:
    """The arrow of a lane: where its successors lead, or as before a junction where no roads part, where `turns` in
    [0, 1) decide what the outer lanes may do."""
    if not network.links:
        n = max(at.number for at in network.lanes.values() if at.section == lane.section)
        if lane.number == 1:
            return (STRAIGHT, *TO_LEFT)[int(3 * turns[0])]
        return (STRAIGHT, *TO_RIGHT)[int(3 * turns[1])] if lane.number == n else STRAIGHT
    # Roads part to the right as t grows, and lead back to the left.
    aside, back = (TO_RIGHT, TO_LEFT) if network.rightward > 0 else (TO_LEFT, TO_RIGHT)
    after = [at.road != lane.road for at in network.successors(lane.id)]
    if not any(after):
        return STRAIGHT
    if network.road(lane.road).parting is not None:
        return back[1]
    return aside[1] if all(after) else aside[0]


def draw_elements(ground: Ground, roadside: Roadside, draw: Draw, own: Draw) -> Roadside:
    """The roadside with its signals and signs that govern lanes of their own."""
    crossings = tuple(_with_signals(ground.network, crossing, draw) for crossing in roadside.crossings)
    drawn = roadside.model_copy(update={"crossings": crossings})
    has_signs, rng = draw("exit_signs"), draw.rng
    numbers = rng.random((SIGN_TRIES, 3))
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
