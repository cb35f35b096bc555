"""Cyclists on cycle lanes or beside kerbs and motorcyclists on lanes near the host, with gaps to vehicles. They ride
along their lane at their speed, and on maps stop before a junction. World frame, metres and seconds."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from synth3dlanes.draw.bodies import Bodies, Motion, track_times, way_poses
from synth3dlanes.draw.colors import dressed
from synth3dlanes.draw.draws import Draw, DrawsOf
from synth3dlanes.params.distributions import extent
from synth3dlanes.roads.cross_section import CrossSection
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane
from synth3dlanes.scene.road_map import lane_key
from synth3dlanes.scene.scene import Scene, Thing
from synth3dlanes.scene.things import ThingKind
from synth3dlanes.system.arrays import Scalars

# On maps: greatest distance from the host's places; draws of a place for each rider.
MAX_FROM_HOST_M, TRIES = 60.0, 12
# Room before and behind riders, and beside them; of a cyclist from the middle to the edge of the lane.
ROOM_M: dict[str, tuple[float, float]] = {"cyclist": (0.8, 0.2), "motorcyclist": (2.5, 0.2)}
KERB_M, PARKED_M, LEAST_LANE_M = 0.30, 0.55, 2.5
# Least distance of a cyclist's middle from the edges of a cycle lane.
IN_CYCLE_LANE_M = 0.4
# Greatest distance of motorcyclists from the middle of their lane.
MIDDLE_M = 0.4
# Distance before the end of a street, where crosswalks and lines are, at which riders stop, and their deceleration.
LINE_M, DECELERATION_M_S2 = 7.5, 1.5


class Ridden(NamedTuple):
    """A lane of traffic near the host, the offset to the driver's right of its middle at which a cyclist rides, and
    whether that is on a cycle lane beside it."""

    lane: NetworkLane
    offset_m: float
    is_cycle_lane: bool


class RiderPlace(NamedTuple):
    """A way and a station of it; the offset to the rider's right; how far the way leads."""

    way: LaneCurve
    start_m: float
    offset_m: float
    room_m: float


# The places that riders of a kind may have, to be tried one after the other.
RiderPlaces = Callable[[Bodies, ThingKind, np.random.Generator, DrawsOf], Iterator[RiderPlace]]


def draw_riders(scene: Scene, bodies: Bodies, of: DrawsOf, places: RiderPlaces) -> Iterator[Thing]:
    """The cyclists and motorcyclists of a scene at such places."""
    own, looks = of("riders"), of("riders", "riders_looks")
    numbers: list[tuple[ThingKind, int]] = [("motorcyclist", own("motorcyclists")), ("cyclist", own("cyclists"))]
    for kind, number in numbers:
        for _ in range(number):
            thing = _rider(scene, bodies, kind, (own, looks), partial(places, bodies, kind, own.rng, of))
            if thing is not None:
                yield thing


def _rider(
    scene: Scene, bodies: Bodies, kind: ThingKind, draws: tuple[Draw, Draw], places: Callable[[], Iterator[RiderPlace]]
) -> Thing | None:
    """A rider at the first free place of some; None without any."""
    own, looks = draws
    models = scene.assets.thing_models(kind)
    number = 1 + int(looks.rng.random() * len(models))
    model, colors = models[number - 1], dressed(models[number - 1], looks.rng)
    speed_m_s, phase = own(f"{kind}_m_s"), round(float(looks.rng.random()), 4)
    times_s = track_times(scene.shot)
    for place in places():
        gone_m = ridden(times_s, speed_m_s, place.room_m)
        if gone_m is None:
            continue
        xy, heading = way_poses(place.way, place.start_m, gone_m, place.offset_m)
        speeds = np.gradient(gone_m, times_s) if len(times_s) > 1 else np.full(1, speed_m_s)
        motion = Motion(times_s, xy, np.arctan2(-heading[:, 0], heading[:, 1]), speeds)
        if bodies.join(motion, model, 1.0, ROOM_M[kind]):
            return motion.thing(phase, kind=kind, model=number, colors=colors)
    return None


def ridden(times_s: Scalars, speed_m_s: float, room_m: float) -> Scalars | None:
    """How far somebody has ridden at times, who slows down to stop within `room_m`; None where there is no room."""
    braking_m = speed_m_s**2 / (2 * DECELERATION_M_S2)
    if room_m < braking_m:
        return None
    brakes_s = (room_m - braking_m) / speed_m_s
    braking_s = np.clip(times_s - brakes_s, 0.0, speed_m_s / DECELERATION_M_S2)
    return np.asarray(
        np.minimum(times_s, brakes_s) * speed_m_s + braking_s * (speed_m_s - DECELERATION_M_S2 * braking_s / 2)
    )


def places_on_map(bodies: Bodies, kind: ThingKind, rng: np.random.Generator, of: DrawsOf) -> Iterator[RiderPlace]:
    """Places on lanes near the host."""
    network, lanes = bodies.network, list(map_lanes(bodies.network, bodies, kind == "cyclist"))
    for lane, at, aside in rng.random((TRIES if lanes else 0, 3)).tolist():
        chosen, offset_m, is_cycle_lane = lanes[int(lane * len(lanes))]
        # A cycle lane may end where the next section begins.
        way = network.way_through([chosen] if is_cycle_lane else _onward(network, chosen))
        own_m = way.pieces[0].end_m
        start_m = at * own_m
        by_m = offset_m if kind == "cyclist" else MIDDLE_M * (2 * aside - 1)
        yield RiderPlace(way, start_m, by_m, way.end_m - LINE_M - start_m)


def places_along_road(bodies: Bodies, kind: ThingKind, rng: np.random.Generator, of: DrawsOf) -> Iterator[RiderPlace]:
    """Places of motorcyclists at the stations of cars; there are none of cyclists."""
    network, (low, high) = bodies.network, extent(of.params.cars.s_m)
    for _ in range(TRIES if kind == "motorcyclist" else 0):
        s_m, choice, aside = low + (high - low) * rng.random(), rng.random(), rng.random()
        here = network.lanes_at(s_m * network.onwards)
        lane = here[int(choice * len(here))]
        yield RiderPlace(network.path(lane.id), s_m * network.onwards, MIDDLE_M * (2 * aside - 1), np.inf)


def map_lanes(network: Network, bodies: Bodies, for_cyclists: bool) -> Iterator[Ridden]:
    """The lanes near the host outside junctions. `for_cyclists`: only lanes with a cycle lane beside them, and the
    outermost lanes of a direction."""
    for lane in network.lanes.values():
        if lane.junction is not None or lane.width_m < LEAST_LANE_M:
            continue
        road = network.road(lane.road)
        s = np.linspace(lane.start_m, lane.end_m, 2 + int((lane.end_m - lane.start_m) / 5))
        away_m = np.linalg.norm(road.xy(s, lane.middle(s))[:, None] - bodies.host_places, axis=2)
        if away_m.min() > MAX_FROM_HOST_M:
            continue
        (section,) = road.stretch_of(lane).sections
        _, _, number = lane_key(lane.id)
        outwards = [at for at in section.lanes if at.number * number > 0 and abs(at.number) > abs(number)]
        outside = min(outwards, key=lambda at: abs(at.number)).kind if outwards else "none"
        if for_cyclists and (offset_m := _to_cycle_lane(section, lane, number, s)) is not None:
            yield Ridden(lane, offset_m, True)
        elif not for_cyclists or outside != "driving":
            room_m = PARKED_M if outside in ("parking", "none") else KERB_M
            # Where traffic keeps left, kerbs are on the left.
            side = 1 if (number < 0) == lane.ascends else -1
            yield Ridden(lane, side * (lane.width_m / 2 - room_m), False)


def _to_cycle_lane(section: CrossSection, lane: NetworkLane, number: int, s: Scalars) -> float | None:
    """The offset to the driver's right from a lane's middle to the middle of the cycle lane beside it, without a lane
    of traffic between them; None if no cycle lane is wide enough all along."""
    edges, numbers = section.edges(s), [at.number for at in section.lanes]
    step = 1 if number > 0 else -1
    beyond = range(numbers.index(number) - step, len(numbers) if step < 0 else -1, -step)
    kinds = [section.lanes[i].kind for i in beyond]
    if "cycle" not in kinds or "driving" in kinds[: kinds.index("cycle")]:
        return None
    i = beyond[kinds.index("cycle")]
    aside_m = (edges[i : i + 2] - lane.middle(s)) * (1 if lane.ascends else -1)
    low_m, high_m = float(aside_m.min(axis=0).max()), float(aside_m.max(axis=0).min())
    return (low_m + high_m) / 2 if high_m - low_m > 2 * IN_CYCLE_LANE_M else None


def _onward(network: Network, lane: NetworkLane) -> list[NetworkLane]:
    """A lane and its successors up to a junction."""
    lanes = [lane]
    while len(lanes) < 12:
        after = [at for at in network.successors(lanes[-1].id) if at.junction is None and at not in lanes]
        if len(after) != 1:
            break
        lanes.append(after[0])
    return lanes
