"""People near the host, on the walkways of maps: they stand, walk round corners, and cross at crosswalks when no
vehicle comes and lights let them. World frame, metres and seconds."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from synth3dlanes.draw.bodies import AHEAD_S, AHEAD_STEP_S, ROOM_M, Bodies, Motion, track_times
from synth3dlanes.draw.clothes import dressed
from synth3dlanes.draw.draws import Draw, DrawsOf
from synth3dlanes.draw.walkways import WalkedLine, Walkways
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.assets.catalogue import ThingModel
from synth3dlanes.scene.scene import Scene, Thing
from synth3dlanes.system.arrays import Points2
from synth3dlanes.world import placement

# Greatest distance of people from the host's places in its clip, the most people, and draws of a place for each.
MAX_FROM_HOST_M, MAX_PEOPLE, TRIES = 55.0, 120, 5
# They keep this far from the kerb, where poles stand, and from the walkway's other edge; those who wait are nearer.
ASIDE_M, OUTSIDE_M, WAIT_M = 0.8, 0.4, 0.75
# Those who cross come from at most this distance behind the kerb; their least distance from vehicles, and the time
# between them.
BEFORE_M, VEHICLE_ROOM_M, APART_S = 1.4, 0.8, 1.0
WITH_UMBRELLA = "umbrella"


class Person(NamedTuple):
    """Who somebody is: number and model, scale, and the colours of its paints."""

    number: int
    model: ThingModel
    scale: float
    colors: tuple[tuple[float, float, float], ...]

    def thing(self, motion: Motion, phase: float) -> Thing:
        """The person, going so."""
        fields = {"kind": "pedestrian", "model": self.number, "scale": self.scale, "colors": self.colors}
        return motion.thing(round(phase, 4), **fields)


class Crosswalk(NamedTuple):
    """A crosswalk: two corners on one side of the street, in order along its width, and those beside them."""

    near: Points2
    far: Points2
    lanes: tuple[str, ...]


def draw_people(scene: Scene, bodies: Bodies, of: DrawsOf) -> Iterator[Thing]:
    """The people of a scene on a map: first those at crosswalks, then the others."""
    own, looks, network = of("people"), of("people", "people_looks"), bodies.network
    density, n_crossing = own("per_100_m") / 100, own("crossing")
    if not (density or n_crossing) or scene.map is None:
        return
    walkways = Walkways(network, bodies.host_places, MAX_FROM_HOST_M)
    found = 0
    for crosswalk in _crosswalks(scene, bodies) if n_crossing else ():
        for _ in range(n_crossing):
            thing = _at_crosswalk(scene, bodies, crosswalk, (own, _person(scene, looks)))
            if thing is not None:
                found += 1
                yield thing
    starts = walkways.starts(bodies.host_places, MAX_FROM_HOST_M)
    for _ in range(min(int(density * len(starts) + own.rng.random()), MAX_PEOPLE - found)):
        thing = _on_walkway(scene, bodies, walkways, starts, (own, _person(scene, looks)))
        if thing is not None:
            yield thing


def _person(scene: Scene, looks: Draw) -> Person:
    """Somebody; in rain perhaps with an umbrella."""
    models = scene.assets.thing_models("pedestrian")
    number, scale, holds, u = looks("model"), looks("scale"), looks("umbrella"), looks.rng.random(2)
    if scene.weather.rain > 0 and u[0] < holds:
        among = [i + 1 for i, model in enumerate(models) if WITH_UMBRELLA in model.paints]
        number = among[int(u[1] * len(among))] if among else number
    model = models[number - 1]
    return Person(number, model, scale, dressed(model, looks.rng))


def _on_walkway(
    scene: Scene,
    bodies: Bodies,
    walkways: Walkways,
    starts: list[tuple[int, int]],
    who: tuple[Draw, Person],
) -> Thing | None:
    """Somebody who stands or walks on a walkway; None without room."""
    (own, person), rng = who, who[0].rng
    speed_m_s = 0.0 if rng.random() < own("standing") else own("speed_m_s")
    times_s = track_times(scene.shot) if speed_m_s else np.zeros(1)
    for start, forward, share, turn, phase in rng.random((TRIES, 5)).tolist():
        at = starts[int(start * len(starts))]
        width_m = float(np.linalg.norm(np.subtract(*(edge[at[1]] for edge in walkways.strips[at[0]]))))
        aside_m = ASIDE_M + share * max(width_m - ASIDE_M - OUTSIDE_M, 0.0)
        need_m = speed_m_s * scene.shot.duration_s
        lines = walkways.onward(at, forward < 0.5, (aside_m, OUTSIDE_M), need_m + 1.0)
        points = np.concatenate(lines)
        if len(points) < 2 or (route := WalkedLine.through(points)).length_m < need_m:
            continue
        xy, yaw = route.at(speed_m_s * times_s)
        motion = Motion(times_s, xy, yaw if speed_m_s else yaw + 2 * np.pi * turn, np.full(len(xy), speed_m_s))
        if bodies.join(motion, person.model, person.scale, (ROOM_M, ROOM_M)):
            return person.thing(motion, phase)
    return None


def _at_crosswalk(scene: Scene, bodies: Bodies, crosswalk: Crosswalk, who: tuple[Draw, Person]) -> Thing | None:
    """Somebody who crosses, or waits for it; None without room."""
    (own, person), rng = who, who[0].rng
    speed_m_s, times_s = own("speed_m_s"), track_times(scene.shot)
    for side, across, start, _, phase in rng.random((TRIES, 5)).tolist():
        near, far = (crosswalk.near, crosswalk.far) if side < 0.5 else (crosswalk.far, crosswalk.near)
        share = 0.15 + 0.7 * across
        kerb, beyond = near[0] + share * (near[1] - near[0]), far[0] + share * (far[1] - far[0])
        ahead = (beyond - kerb) / np.linalg.norm(beyond - kerb)
        width_m, before_m = float(np.linalg.norm(beyond - kerb)), BEFORE_M
        first, last = kerb - before_m * ahead, beyond + before_m * ahead
        route = WalkedLine.through(np.stack([first, kerb, beyond, last]))
        need_m = speed_m_s * scene.shot.duration_s
        # In a clip nobody steps over a kerb, where the height of feet would jump from one frame to the next.
        low_m, high_m = (before_m, before_m + width_m - need_m) if need_m else (0.0, before_m + width_m)
        gone_m = low_m + start * (high_m - low_m)
        if high_m > low_m and _may_cross(scene, bodies, crosswalk, route, (gone_m, width_m), speed_m_s):
            xy, yaw = route.at(gone_m + speed_m_s * times_s)
            motion = Motion(times_s, xy, yaw, np.full(len(xy), speed_m_s))
        else:
            xy, yaw = route.at(np.array([before_m - WAIT_M]))
            motion = Motion(np.zeros(1), xy, yaw + 0.3 * (phase - 0.5), np.zeros(1))
        if bodies.join(motion, person.model, person.scale, (ROOM_M, ROOM_M)):
            return person.thing(motion, phase)
    return None


def _may_cross(
    scene: Scene, bodies: Bodies, crosswalk: Crosswalk, route: WalkedLine, gone: tuple[float, float], speed_m_s: float
) -> bool:
    """Whether lights let somebody cross until the other side is reached, and no vehicle comes until then."""
    gone_m, width_m = gone
    times_s = np.arange(0.0, (BEFORE_M + width_m - gone_m) / speed_m_s + AHEAD_STEP_S, AHEAD_STEP_S)
    if times_s[-1] + APART_S > AHEAD_S:
        return False
    entered_s = (BEFORE_M - gone_m) / speed_m_s
    lit_s = np.arange(entered_s, times_s[-1] + AHEAD_STEP_S, AHEAD_STEP_S).tolist()
    signals = [signal for signal in scene.roadside.signals if {*signal.lanes} & {*crosswalk.lanes}]
    if any(signal.state_at(time_s) != "red" for signal in signals for time_s in lit_s):
        return False
    xy, yaw = route.at(gone_m + speed_m_s * times_s)
    heading, side_m = np.stack([-np.sin(yaw), np.cos(yaw)], -1), 1.0 + 2 * VEHICLE_ROOM_M
    own, n, margin = placement.footprint(xy, heading, side_m, side_m), len(times_s), round(APART_S / AHEAD_STEP_S)
    # Somewhat earlier and later, too; nobody knows where vehicles were before the start.
    moments = [np.maximum(np.arange(n) + by, 0) for by in range(-margin, margin + 1)]
    return not any(placement.overlaps_any(own, bodies.vehicles_ahead[:, at]) for at in moments)


def _crosswalks(scene: Scene, bodies: Bodies) -> Iterator[Crosswalk]:
    """The crosswalks near the host, with the lanes with signals that lead across them."""
    assert scene.map is not None, "asked only of maps"
    network, places = bodies.network, bodies.host_places
    governed = {lane for signal in scene.roadside.signals for lane in signal.lanes}
    for paint in scene.map.paint:
        corners = np.array(paint.outline)
        if paint.kind != "crosswalk" or len(corners) != 4:
            continue
        middle = corners.mean(axis=0)
        if np.linalg.norm(places - middle, axis=1).min() > MAX_FROM_HOST_M:
            continue
        area = shapely.Polygon(corners)
        lanes = tuple(name for name in sorted(governed) if _leads_through(network, name, area, middle))
        yield Crosswalk(corners[[0, 3]], corners[[1, 2]], lanes)


def _leads_through(network: Network, name: str, area: shapely.Polygon, middle: Float[np.ndarray, "2"]) -> bool:
    """Whether the middle of a lane passes through an area."""
    if name not in network.lanes:
        return False
    lines = network.lane_lines(network.lanes[name], middle, 15.0)
    return lines is not None and shapely.LineString(lines[0][:, :2]).intersects(area)
