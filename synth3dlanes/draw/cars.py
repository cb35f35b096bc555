"""The cars of a scene: in their lanes or parked, clear of each other and of the host, all through a clip."""

from collections.abc import Sequence

import numpy as np

from synth3dlanes.draw.car_colors import sold_color
from synth3dlanes.draw.draws import DECIMALS, Draw
from synth3dlanes.draw.traffic import SPEED_TRIES, Traffic
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.scene import Car
from synth3dlanes.system.errors import InputError
from synth3dlanes.world import placement
from synth3dlanes.world.camera import world_from_host
from synth3dlanes.world.world import World

# The streams of the cars: looks as in the paper, and what was added since, so that it changes none of these.
CAR_STREAMS = ("cars", "car_places", "car_saturation", "car_palette", "parked_cars")
# Free length and width around a car, and draws of a place for each.
CAR_GAP_M, TRIES = (1.0, 0.3), 300
# Cars park at least this far from where roads part.
PARKING_BEFORE_M = 20.0


def draw_cars(world: World, draws: Sequence[Draw], speeds: Draw) -> tuple[Car, ...]:
    """The cars of a world, from the draws of CAR_STREAMS and of their speeds. From the first on for which there is no
    room, they are left out.

    Raises InputError where these are fewer than `cars.n` allows.
    """
    scene, network = world.scene, world.network
    looks, places, paints, sold, parking = draws
    taken = [placement.host_footprint(world_from_host(network, scene.camera))]
    traffic = Traffic(network, scene.camera, scene.shot) if scene.shot.n_frames > 1 else None
    parked = parking("parked")
    cars: list[Car] = []
    for number in range(looks("n")):
        model, scale = looks("model"), looks("scale")
        (color,) = zip(*looks.rows(("color",), 3), strict=True)
        gloss = looks("gloss")
        body = scene.assets.car_models[model - 1]
        size = body.length_m * scale + CAR_GAP_M[0], body.width_m * scale + CAR_GAP_M[1]
        is_parked = parking.rng.random() < parked
        drawn_m_s = [speeds("car_speed_m_s") for _ in range(SPEED_TRIES)] if traffic else []
        for _ in range(TRIES):
            s_m = places("s_m")
            lanes = network.lanes_at(s_m * network.onwards)
            lane = lanes[int(places.rng.random() * len(lanes))].id
            offset_m = 0.0
            if is_parked and (found := _parking(network, s_m, size[1], parking.rng)):
                lane, offset_m = found
            place = placement.footprint(*placement.car_place(network, lane, s_m, offset_m), *size)
            if placement.overlaps_any(place, np.array(taken)):
                continue
            speed_m_s = traffic.join(lane, s_m, offset_m, size, [0.0] if offset_m else drawn_m_s) if traffic else 0.0
            if speed_m_s is not None:
                break
        else:
            if number >= looks.least("n"):
                break
            raise InputError(f"cars.n: no room for car {number + 1} within cars.s_m of scene {scene.index}")
        taken.append(place)
        saturation = paints("saturation")
        palette, (u_paint, u_shade) = sold("palette"), sold.rng.random(2)
        if palette == "sold":
            color, saturation = sold_color(body, u_paint, u_shade), 1.0
        looks_of = {"model": model, "scale": scale, "color": color, "gloss": gloss, "saturation": saturation}
        cars.append(Car(**looks_of, lane=lane, s_m=s_m, offset_m=offset_m, speed_m_s=speed_m_s))
    return tuple(cars)


def _parking(network: Network, s_m: float, width_m: float, rng: np.random.Generator) -> tuple[str, float] | None:
    """A lane at whose outer shoulder a car can stand, and its offset there to the driver's right; None without room.

    Nobody parks where roads part, or left of the host's lanes.
    """
    road, s = network.main, s_m * network.onwards
    left, right = road.lanes_at(s)[0], road.lanes_at(s)[-1]
    outermost = [right.id] if all(s <= at.start_m - PARKING_BEFORE_M for at in network.branches(road)) else []
    outermost += [left.id] if left.direction == "oncoming" else []
    if not outermost or road.shoulder_m < width_m:
        return None
    offset_m = network.rightward * (road.lane_width_m + road.shoulder_m) / 2
    return outermost[int(rng.random() * len(outermost))], round(offset_m, DECIMALS)


def car_look(looks: Draw, assets: Assets, model: int, scale: float) -> dict[str, object]:
    """Model and colours of a car on a map."""
    (color,) = zip(*looks.rows(("color",), 3), strict=True)
    gloss, saturation, palette = looks("gloss"), looks("saturation"), looks("palette")
    u_paint, u_shade = looks.rng.random(2)
    if palette == "sold":
        color, saturation = sold_color(assets.car_models[model - 1], u_paint, u_shade), 1.0
    return {"model": model, "scale": scale, "color": color, "gloss": gloss, "saturation": saturation}
