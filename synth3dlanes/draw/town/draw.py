"""The maker of towns: their values, the map with the host's way, and the cars on it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.draw.cars import car_look
from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw, DrawsOf
from synth3dlanes.draw.makers import Roads, draw_camera, draw_hills, first_shot, map_roads
from synth3dlanes.draw.town.furniture import StreetDraws, furnish, street_trees
from synth3dlanes.draw.town.lanes import LaneLine, LaneLines, Route
from synth3dlanes.draw.town.layout import TownMap, lay_out
from synth3dlanes.draw.town.plan import poses
from synth3dlanes.draw.town.streets import LANES, PARKING_M
from synth3dlanes.draw.town.traffic import (
    CarBody,
    HostPlan,
    MovingCar,
    TownDrive,
    Usual,
    body_places,
    draw_meetings,
    plan_host,
    simulate,
)
from synth3dlanes.params.distributions import extent
from synth3dlanes.params.shots import Shots
from synth3dlanes.scene.assets.catalogue import Assets, CarModel
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.scene import Car, Markings, Scene, Terrain, Tree
from synth3dlanes.scene.town import ROUNDABOUTS, Town
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.placement import footprint, touches_any

# Least distance of parked cars from the ends of a parking lane, and their greatest length.
BAY_END_M, LONGEST_PARKED_M = 4.0, 5.4
N_BENDS = 4
# Parked and moving cars farther than this from the host's place are left out.
PARKED_M, MOVING_M = 90.0, 160.0
# Draws of a model until one is short enough; vehicles longer than this go straight on only.
TRIES, LONG_M = 30, 6.5
# Steps along the host's way.
WAY_STEP_M = 5.0


class DrawnTown(NamedTuple):
    """A town with the host's way, its place on it, and the lines of all lanes."""

    map: TownMap
    host: HostPlan
    lines: LaneLines


def town_roads(of: DrawsOf, shots: Shots, assets: Assets) -> Roads:
    """A town, its traffic up to where the host is at its place, and what stands along its streets."""
    own, layout = of("town_streets"), of("town", "town_layout").rng
    bay_m, trees_apart_m = own("bay_m"), own("trees_apart_m")
    town_map = lay_out(town_of(of("town")), of("markings").part(Markings), own, layout)
    lines = LaneLines(town_map)
    host = plan_host(town_map, lines, own, layout)
    camera, hills = draw_camera(of("camera"), 1, round(host.at_m, SCENE_DECIMALS)), draw_hills(of("terrain"))
    town = DrawnTown(town_map, host._replace(offset_m=camera.offset_m), lines)
    shot, flow, looks = first_shot(shots, None), of("town", "town_flow"), of("cars", "town_cars")
    bodies = of("cars", "town_traffic")

    def body(may_be_long: bool) -> CarBody:
        return _body(bodies, assets, lambda body, _: may_be_long or body.length_m <= LONG_M)[0]

    farthest_m = extent(of.params.town_streets.speed_m_s)[1] * shot.duration_s
    host_places = lines.route(host.lanes).xy(host.at_m + np.arange(0.0, farthest_m + 1.0, WAY_STEP_M))
    meetings = partial(draw_meetings, town_map, host_places, of, shot.duration_s)
    usual = Usual.draw(own, bodies.rng, flow("traffic"))
    traffic = simulate(lines, town.host, body, usual, shot.duration_s, meetings)

    def stand(scene: Scene, ground: Ground) -> Roadside:
        draws = StreetDraws(of("town", "town_fronts"), of("roadside"), of("structures"), own)
        return furnish(town_map, traffic.lights, ground, draws)

    def drive(scene: Scene, ground: Ground) -> tuple[Car, ...]:
        moving = _cars_of(town, traffic, scene.terrain, looks, assets)
        return moving + _parked_cars(town, traffic, flow("parked"), bay_m, looks, assets)

    def grow(scene: Scene, ground: Ground, trees: tuple[Tree, ...]) -> tuple[Tree, ...]:
        draws = of("town", "town_trees"), trees_apart_m, of("trees", "street_trees")
        return (*street_trees(town_map, ground, scene.roadside, *draws), *trees)

    shot = _shot_of(town, traffic, shot, hills)
    roads = map_roads(of, town_map.road_map(host.lanes), camera, shot, stand)
    fields = roads.fields | {"town": town_map.town}
    return replace(
        roads, fields=fields, drive=drive, grow=grow, crossers=traffic.crossers if shot.n_frames > 1 else None
    )


def town_of(draw: Draw) -> Town:
    """The values of a town. Roundabouts have their own number of lanes and no turn lanes; side streets are no wider
    than the main one; only streets of one lane are equal."""
    drawn = {key: draw(key.replace("_rad", "_deg")) for key in Town.model_fields if key != "bends_rad"}
    drawn["bends_rad"] = tuple(draw("bend_deg") for _ in range(N_BENDS))
    n_lanes = ROUNDABOUTS.get(drawn["junction"], drawn["n_lanes"])
    if drawn["junction"] in ROUNDABOUTS:
        drawn |= {"turn_lanes": "none", "control": "priority"}
    if drawn["control"] == "equal":
        drawn |= {"turn_lanes": "none"} if n_lanes == 1 else {"control": "priority"}
    return Town(**drawn | {"n_lanes": n_lanes, "n_side": min(drawn["n_side"], n_lanes)})


def _shot_of(drawn: DrawnTown, found: TownDrive, shot: Shot, terrain: Terrain) -> Shot:
    """The host's shot, with its track in a clip."""
    if shot.n_frames == 1:
        return shot
    track = _driven(drawn.lines.route(found.host.lanes), found.host, terrain)
    return shot.model_copy(update={"speed_m_s": _speed(track), "track": track})


def _cars_of(drawn: DrawnTown, found: TownDrive, terrain: Terrain, looks: Draw, assets: Assets) -> tuple[Car, ...]:
    """The cars of the traffic."""
    cars, lines = [], drawn.lines
    host = lines.route(drawn.host.lanes).xy(np.array([drawn.host.at_m]))
    for moving in found.cars:
        route = lines.route(moving.lanes)
        ends = route.xy(np.array([moving.track[0][1], moving.track[-1][1]]))
        if np.linalg.norm(ends - host, axis=1).min() > MOVING_M:
            continue
        k, s_m = route.place_at(moving.track[0][1])
        values = car_look(looks, assets, moving.body.model, moving.body.scale)
        values |= {
            "lane": route.lanes[k],
            "s_m": round(s_m, SCENE_DECIMALS),
            "speed_m_s": round(moving.speed_m_s, SCENE_DECIMALS),
        }
        if len(moving.track) > 1:
            track = _driven(route, moving, terrain)
            values |= {"speed_m_s": _speed(track), "track": track, "route": route.lanes[k + 1 :]}
        cars.append(Car(**values))
    return tuple(cars)


def _parked_cars(
    drawn: DrawnTown, found: TownDrive, share: float, bay_m: float, looks: Draw, assets: Assets
) -> tuple[Car, ...]:
    """Cars in the parking lanes near the host, which stand beside the outermost lanes, where nobody who drives would
    touch them: in bends the ends of long vehicles swing out of their lanes."""
    cars, rng = list[Car](), looks.rng
    host = drawn.lines.route(drawn.host.lanes).xy(np.array([drawn.host.at_m]))
    driven = _driven_places(drawn, found)

    def fits(body: CarBody, own: CarModel) -> bool:
        return own.length_m < LONGEST_PARKED_M and own.width_m < PARKING_M

    for street in drawn.map.streets:
        for i, piece in enumerate(street.pieces):
            for side in ("left", "right"):
                names = street.names(i)[side]
                if piece.near or "parking" not in piece.start.left or "parking" not in piece.end.left:
                    continue
                lane = [key for key in LANES if key in names][-1]
                start_m = street.stations[i]
                places = np.arange(start_m + BAY_END_M, start_m + piece.length_m - BAY_END_M, bay_m)
                away_m = np.linalg.norm(poses(street.plan, places)[0] - host, axis=1)
                for s_m, its_away_m in zip(places.tolist(), away_m.tolist(), strict=True):
                    if rng.random() >= share or its_away_m > PARKED_M:
                        continue
                    body, is_short = _body(looks, assets, fits)
                    if is_short:
                        moved_m = float(rng.uniform(-0.4, 0.4))
                        offset_m = (street.profile.lane_m + PARKING_M) / 2 + float(rng.uniform(-0.05, 0.12))
                        place = {"lane": names[lane], "s_m": round(s_m + moved_m, SCENE_DECIMALS)}
                        look = car_look(looks, assets, body.model, body.scale)
                        car = Car(**look, **place, offset_m=round(offset_m, SCENE_DECIMALS))
                        if not touches_any(_standing(drawn.lines[car.lane], car, body)[None], driven[:, None]):
                            cars.append(car)
    return tuple(cars)


def _driven_places(drawn: DrawnTown, found: TownDrive) -> Float[np.ndarray, "n 4 2"]:
    """The corners of the host and of every car that drives at the instants of its track, with the room it needs."""
    places = []
    for car in (found.host, *found.cars):
        offset_m = drawn.host.offset_m if car is found.host else 0.0
        lengths_m = np.array([length_m for _, length_m in car.track])
        places.append(body_places(drawn.lines.route(car.lanes), lengths_m, car.body, offset_m))
    return np.concatenate(places)


def _standing(line: LaneLine, car: Car, body: CarBody) -> Float[np.ndarray, "4 2"]:
    """The corners of a parked car."""
    order = np.argsort(line.stations)
    at = [
        np.interp(car.s_m, line.stations[order], values[order]) for values in (*line.points.T, np.unwrap(line.headings))
    ]
    heading = np.array([np.cos(at[2]), np.sin(at[2])])
    middle = np.array(at[:2]) + car.offset_m * np.array([heading[1], -heading[0]])
    return footprint(middle, heading, body.length_m, body.width_m)


def _body(looks: Draw, assets: Assets, fits: Callable[[CarBody, CarModel], bool]) -> tuple[CarBody, bool]:
    """A car that fits, or the last one of some that do not; and whether it does."""
    for _ in range(TRIES):
        model, scale = looks("model"), looks("scale")
        own = assets.car_models[model - 1]
        body = CarBody(model, scale, own.length_m * scale, own.width_m * scale)
        if fits(body, own):
            return body, True
    return body, False


def _driven(route: Route, moving: MovingCar, terrain: Terrain) -> tuple[tuple[float, float], ...]:
    """How far a car has driven along the ground at instants."""
    times, lengths = np.array(moving.track).T
    driven = route.climbed(terrain, lengths)
    driven = np.maximum.accumulate(np.round(driven - driven[0], 4))
    return tuple(zip(times.tolist(), driven.tolist(), strict=True))


def _speed(track: Sequence[tuple[float, float]]) -> float:
    (start_s, start_m), (end_s, end_m) = track[:2]
    return round((end_m - start_m) / (end_s - start_s), SCENE_DECIMALS)
