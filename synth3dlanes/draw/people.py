"""People near the host, on the walkways of maps. They stand, walk round corners, and cross at crosswalks when their
light is green and no vehicle comes; in a clip of a town, vehicles stop for them. World frame, metres and seconds."""

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from synth3dlanes.draw.bodies import AHEAD_S, AHEAD_STEP_S, ROOM_M, Bodies, Motion, track_times
from synth3dlanes.draw.colors import dressed
from synth3dlanes.draw.crossing import BEHIND_M, STEP_S, WAIT_M, Crosser, kept_after, kept_before
from synth3dlanes.draw.draws import Draw, DrawsOf
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.assets.catalogue import ThingModel
from synth3dlanes.scene.scene import Scene, Thing
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.world import placement

# Distance between points of strips, least width of a walkway, distance at which ends are joined.
STRIP_STEP_M, LEAST_WIDTH_M, JOINED_M = 1.0, 1.0, 1.0
# Headings are measured over this length to both sides.
HEADING_M = 0.3
# Greatest distance of people from the host's places in its clip, the most people, and draws of a place for each.
MAX_FROM_HOST_M, MAX_PEOPLE, TRIES = 55.0, 120, 5
# They keep this far from the kerb, where poles stand, and from the walkway's other edge; those who wait are nearer.
ASIDE_M, OUTSIDE_M = 0.8, 0.4
# People who cross are at least this far from vehicles, and at no place within this time of one.
VEHICLE_ROOM_M, BESIDE_VEHICLES_S = 0.8, 1.0
# A walkway that people come from or go to is this near to the crosswalk.
WALKWAY_REACH_M = 1.5
WITH_UMBRELLA = "umbrella"


class Walkway(NamedTuple):
    """A walkway: points of its edge at the road and of its other edge, beside each other."""

    inner: Points2
    outer: Points2

    @property
    def middle(self) -> Points2:
        """The line in its middle."""
        return (self.inner + self.outer) / 2

    def beside(self, aside_m: float, room_m: float) -> Points2:
        """The line `aside_m` from the edge at the road, at least `room_m` from the other one."""
        across = self.outer - self.inner
        width_m = np.linalg.norm(across, axis=1, keepdims=True)
        return self.inner + across * np.clip(np.minimum(aside_m, width_m - room_m) / width_m, 0.0, 1.0)


class WalkedLine(NamedTuple):
    """A line that somebody goes along, with lengths along it at its points."""

    points: Points2
    lengths_m: Scalars

    @classmethod
    def through(cls, points: Points2) -> "WalkedLine":
        """The route through points; of points that almost coincide it keeps one."""
        kept = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-3])
        return cls(points[kept], lengths_along(points[kept]))

    @property
    def length_m(self) -> float:
        """Its length."""
        return float(self.lengths_m[-1])

    def at(self, gone_m: Scalars) -> tuple[Points2, Scalars]:
        """Places at lengths along it, and where it leads there: counter-clockwise from world y."""
        behind, here, ahead = (self._places(gone_m + by) for by in (-HEADING_M, 0.0, HEADING_M))
        x, y = (ahead - behind).T
        return here, np.arctan2(-x, y)

    def _places(self, gone_m: Scalars) -> Points2:
        return np.stack([np.interp(gone_m, self.lengths_m, column) for column in self.points.T], -1)


class Walkways:
    """The walkways of a map that come within a reach of some places."""

    def __init__(self, network: Network, places: Points2, reach_m: float) -> None:
        self.strips = list[Walkway]()
        if any(lane.kind == "walkway" for road in network.roads for at in road.sections for lane in at.lanes):
            low, high = network.index.boxes
            near = ((low < places.max(axis=0) + reach_m) & (high > places.min(axis=0) - reach_m)).all(axis=1)
            self.strips += [strip for i in np.flatnonzero(near).tolist() for strip in _strips(network.roads[i])]
        self.ends = np.array([strip.middle[[0, -1]] for strip in self.strips]).reshape(-1, 2)

    def starts(self, places: Points2, reach_m: float) -> list[tuple[int, int]]:
        """The strips and the numbers of their points within a reach of some places."""
        found = []
        for k, strip in enumerate(self.strips):
            away_m = np.linalg.norm(strip.middle[:, None] - places, axis=2).min(axis=1)
            found += [(k, i) for i in np.flatnonzero(away_m < reach_m).tolist()]
        return found

    def nearest(self, place: Float[np.ndarray, "2"]) -> tuple[tuple[int, int], float] | None:
        """The strip and the number of its point that is nearest to a place, and how far that is; None without any."""
        away_m = [np.linalg.norm(strip.middle - place, axis=1) for strip in self.strips]
        if not away_m:
            return None
        k = int(np.argmin([each.min() for each in away_m]))
        return (k, int(away_m[k].argmin())), float(away_m[k].min())

    def onward(
        self, start: tuple[int, int], forward: bool, aside: tuple[float, float], length_m: float
    ) -> list[Points2]:
        """The lines, beside the road as `Walkway.beside` says, from a point of a strip on until they are long enough or
        the walkway ends."""
        (k, i), lines, gone_m = start, list[Points2](), 0.0
        for _ in range(12):
            line = self.strips[k].beside(*aside)
            line = line[i:] if forward else line[: i + 1][::-1]
            lines.append(line)
            gone_m += float(lengths_along(line)[-1]) if len(line) > 1 else 0.0
            joined = self._joined(2 * k + int(forward))
            if gone_m > length_m or joined is None:
                break
            k, forward = joined // 2, joined % 2 == 0
            i = 0 if forward else len(self.strips[k].inner) - 1
        return lines

    def _joined(self, end: int) -> int | None:
        """The end of a strip where another one's end is."""
        away_m = np.linalg.norm(self.ends - self.ends[end], axis=1)
        away_m[[end - end % 2, end - end % 2 + 1]] = np.inf
        nearest = int(away_m.argmin())
        return nearest if away_m[nearest] < JOINED_M else None


def _strips(road: Road) -> Iterator[Walkway]:
    """The walkways of a road, section by section."""
    for stretch in road.stretches:
        (section,) = stretch.sections
        for i, lane in enumerate(section.lanes):
            if lane.kind == "walkway":
                s = np.linspace(
                    section.start_m, section.end_m, 2 + int((section.end_m - section.start_m) / STRIP_STEP_M)
                )
                inner, outer = (i + 1, i) if lane.number > 0 else (i, i + 1)
                found = Walkway(*(stretch.xy(s, section.edge(edge, s)) for edge in (inner, outer)))
                if np.linalg.norm(found.outer - found.inner, axis=1).min() > LEAST_WIDTH_M:
                    yield found


class Person(NamedTuple):
    """Who somebody is: number and model, scale, and the colours of its paints."""

    number: int
    model: ThingModel
    scale: float
    colors: tuple[tuple[float, float, float], ...]

    def thing(self, motion: Motion, phase: float) -> Thing:
        """The person as a thing with this motion."""
        fields = {"kind": "pedestrian", "model": self.number, "scale": self.scale, "colors": self.colors}
        return motion.thing(round(phase, 4), **fields)


class Crosswalk(NamedTuple):
    """A crosswalk: two corners on one side of the street, in order along its width, and those beside them."""

    near: Points2
    far: Points2
    lanes: tuple[str, ...]

    def kerbs(self, from_near: bool, across: float) -> Points2:
        """Where somebody leaves one side and comes to the other one, at a share of the width."""
        share = 0.15 + 0.7 * across
        sides = (self.near, self.far) if from_near else (self.far, self.near)
        return np.stack([side[0] + share * (side[1] - side[0]) for side in sides])


def draw_people(scene: Scene, bodies: Bodies, of: DrawsOf, crossers: tuple[Crosser, ...] | None) -> Iterator[Thing]:
    """The people of a scene: first people at crosswalks, then people on the walkways of roads. `crossers` are the
    people that the traffic of a clip stops for, None if it stops for nobody."""
    own, looks, network = of("people"), of("people", "people_looks"), bodies.network
    density, n_crossing = own("per_100_m") / 100, own("crossing")
    if not (density or n_crossing):
        return
    walkways = Walkways(network, bodies.host_places, MAX_FROM_HOST_M)
    found = 0
    if scene.shot.n_frames == 1:
        crosswalks = _crosswalks(scene, bodies) if n_crossing else ()
        tried = (
            _at_crosswalk(scene, bodies, crosswalk, (own, _person(scene, looks)))
            for crosswalk in crosswalks
            for _ in range(n_crossing)
        )
    else:
        met = _crossers(scene, bodies, own, n_crossing) if crossers is None else crossers
        tried = (_in_clip(scene, bodies, walkways, crosser, (own, _person(scene, looks))) for crosser in met)
    for thing in tried:
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
    """Somebody who crosses, or waits for it, in a single picture; None without room."""
    (own, person), rng = who, who[0].rng
    speed_m_s = own("speed_m_s")
    for side, across, start, _, phase in rng.random((TRIES, 5)).tolist():
        kerbs = crosswalk.kerbs(side < 0.5, across)
        ahead = (kerbs[1] - kerbs[0]) / np.linalg.norm(kerbs[1] - kerbs[0])
        width_m = float(np.linalg.norm(kerbs[1] - kerbs[0]))
        first, last = kerbs[0] - BEHIND_M * ahead, kerbs[1] + BEHIND_M * ahead
        route = WalkedLine.through(np.stack([first, *kerbs, last]))
        gone_m = start * (BEHIND_M + width_m)
        if _may_cross(bodies, crosswalk, route, (gone_m, width_m), speed_m_s):
            xy, yaw = route.at(np.array([gone_m]))
            motion = Motion(np.zeros(1), xy, yaw, np.full(1, speed_m_s))
        else:
            xy, yaw = route.at(np.array([BEHIND_M - WAIT_M]))
            motion = Motion(np.zeros(1), xy, yaw + 0.3 * (phase - 0.5), np.zeros(1))
        if bodies.join(motion, person.model, person.scale, (ROOM_M, ROOM_M)):
            return person.thing(motion, phase)
    return None


def _in_clip(
    scene: Scene, bodies: Bodies, walkways: Walkways, crosser: Crosser, who: tuple[Draw, Person]
) -> Thing | None:
    """Somebody who comes to a crosswalk in a clip, from a walkway and on along another one where there is room; None
    without any."""
    own, person = who
    times_s, phase = track_times(scene.shot), float(own.rng.random())
    gone_m = crosser.gone_at(times_s)
    behind, end_m = BEHIND_M - WAIT_M, crosser.across_m + BEHIND_M
    places = crosser.kerb - BEHIND_M * crosser.ahead, crosser.beyond + BEHIND_M * crosser.ahead
    reaches_m = -float(gone_m[0]) - behind, float(gone_m[-1]) - end_m
    before, after = (_ways_from(walkways, place, reach_m) for place, reach_m in zip(places, reaches_m, strict=True))
    for way_here, way_on in product(before, after):
        here_m = gone_m if way_here is not None else kept_after(gone_m, 0.0)
        here_m = here_m if way_on is not None else kept_before(here_m, end_m)
        parts = [places[0][None], places[1][None]]
        parts = parts if way_here is None else [way_here[::-1], *parts]
        route = WalkedLine.through(np.concatenate(parts if way_on is None else [*parts, way_on]))
        start_m = behind + (
            0.0 if way_here is None else float(lengths_along(np.concatenate([places[0][None], way_here]))[-1])
        )
        xy, yaw = route.at(start_m + here_m)
        speeds = np.gradient(here_m, times_s)
        if bodies.join(motion := Motion(times_s, xy, yaw, speeds), person.model, person.scale, (ROOM_M, ROOM_M)):
            return person.thing(motion, phase)
    return None


def _ways_from(walkways: Walkways, place: Float[np.ndarray, "2"], length_m: float) -> list[Points2 | None]:
    """Lines along the walkway from beside a place on, in both directions, where they are long enough; None, for staying
    there, comes last."""
    nearest = walkways.nearest(place)
    found: list[Points2 | None] = []
    if length_m > 0 and nearest is not None and nearest[1] < WALKWAY_REACH_M:
        for forward in (True, False):
            lines = walkways.onward(nearest[0], forward, (BEHIND_M, OUTSIDE_M), length_m + 1.0)
            # The first point may be beside the place, or behind it.
            line = np.concatenate(lines)[1:]
            if len(line) and lengths_along(np.concatenate([place[None], line]))[-1] > length_m:
                found.append(line)
    return [*found, None]


def _crossers(scene: Scene, bodies: Bodies, own: Draw, n: int) -> Iterator[Crosser]:
    """The people who come to the crosswalks of a given map in a clip, where no vehicle stops for them."""
    for crosswalk in _crosswalks(scene, bodies) if n else ():
        for i in range(n):
            speed_m_s, (side, at, share) = own("speed_m_s"), own.rng.random(3).tolist()
            kerbs = crosswalk.kerbs(side < 0.5, (i + 0.4 + 0.2 * at) / n)
            crosser = Crosser.draw(kerbs, speed_m_s, share, scene.shot.duration_s)
            route = WalkedLine.through(
                np.stack([kerbs[0] - BEHIND_M * crosser.ahead, kerbs[1] + BEHIND_M * crosser.ahead])
            )

            def may_start(
                crosser: Crosser = crosser, crosswalk: Crosswalk = crosswalk, route: WalkedLine = route
            ) -> bool:
                gone = crosser.gone_m + BEHIND_M - WAIT_M, crosser.across_m - WAIT_M
                at_s = STEP_S * max(len(crosser.track_m) - 1, 0)
                return _may_cross(bodies, crosswalk, route, gone, crosser.wish_m_s, at_s)

            crosser.begin(may_start)
            for _ in range(int(np.ceil(scene.shot.duration_s / STEP_S - 1e-9))):
                crosser.step(may_start)
            yield crosser


def _may_cross(
    bodies: Bodies,
    crosswalk: Crosswalk,
    route: WalkedLine,
    gone: tuple[float, float],
    speed_m_s: float,
    at_s: float = 0.0,
) -> bool:
    """Whether lights let somebody cross from a time of the clip on until the other side is reached, and no vehicle
    comes until then."""
    gone_m, width_m = gone
    times_s = np.arange(0.0, (BEHIND_M + width_m - gone_m) / speed_m_s + AHEAD_STEP_S, AHEAD_STEP_S)
    if at_s + times_s[-1] + BESIDE_VEHICLES_S > AHEAD_S:
        return False
    entered_s = (BEHIND_M - gone_m) / speed_m_s
    lit_s = np.arange(entered_s, times_s[-1] + AHEAD_STEP_S, AHEAD_STEP_S).tolist()
    signals = [signal for signal in bodies.scene.roadside.signals if {*signal.lanes} & {*crosswalk.lanes}]
    if any(signal.state_at(at_s + time_s) != "red" for signal in signals for time_s in lit_s):
        return False
    xy, yaw = route.at(gone_m + speed_m_s * times_s)
    heading, side_m = np.stack([-np.sin(yaw), np.cos(yaw)], -1), 1.0 + 2 * VEHICLE_ROOM_M
    own, n, margin = (
        placement.footprint(xy, heading, side_m, side_m),
        len(times_s),
        round(BESIDE_VEHICLES_S / AHEAD_STEP_S),
    )
    # Somewhat earlier and later, too; nobody knows where vehicles were before the start.
    first = round(at_s / AHEAD_STEP_S)
    moments = [np.maximum(first + np.arange(n) + by, 0) for by in range(-margin, margin + 1)]
    return not any(placement.touches_any(own, bodies.vehicles_ahead[:, at]) for at in moments)


def _crosswalks(scene: Scene, bodies: Bodies) -> Iterator[Crosswalk]:
    """The crosswalks near the host, with the lanes with signals that lead across them."""
    network, places = bodies.network, bodies.host_places
    governed = {lane for signal in scene.roadside.signals for lane in signal.lanes}
    for paint in scene.roads.paint:
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
