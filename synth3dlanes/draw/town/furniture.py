"""What stands along the streets of a town: signals and signs at junctions, lamps, buildings, trees. World frame,
metres."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw
from synth3dlanes.draw.roadside import BuildingKind, building_size, coloured, floor_plan
from synth3dlanes.draw.town.junctions import Arm
from synth3dlanes.draw.town.layout import TownMap
from synth3dlanes.draw.town.paint import line_m
from synth3dlanes.draw.town.plan import PlanPose, poses
from synth3dlanes.draw.town.rules import JunctionRules, LightGroup, Lights
from synth3dlanes.draw.town.streets import LaneAt, Street
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.roadside import Building, Post, Roadside
from synth3dlanes.scene.scene import Tree
from synth3dlanes.scene.traffic_elements import LensForm, SignKind, TrafficSign, TrafficSignal
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.placement import overlaps_any

# Distance of poles behind the front of a kerb, and beside a pavement without a kerb.
BEHIND_KERB_M, BESIDE_M = 0.5, 0.8
# Heights of the lower edges of heads beside and over lanes, and of signs.
HEAD_M, OVERHEAD_M, SIGN_M = 2.3, 5.2, 2.1
# From the junction to the signs of the priority road and of speed.
PRIORITY_M, SPEED_M = 16.0, 62.0
# Station of the first building along an arm (before its beginning, at the corner), and the step where there is no room.
FIRST_BUILDING_M, BUILDING_STEP_M = -12.0, 4.0
KINDS: tuple[BuildingKind, ...] = ("block", "house", "hall")
# Distance of walls from pavements, which leaves room for eaves.
ROOM_M, RIM_M, MOST_BUILDINGS = 1.2, 1.5, 110
TREE_BEHIND_M = 1.2


class StreetDraws(NamedTuple):
    """What stands along streets: the share of fronts, which has the random numbers of all others, the lamps, the sizes
    of buildings, and what `town_streets` has."""

    town: Draw
    lamps: Draw
    sizes: Draw
    streets: Draw


def furnish(town_map: TownMap, lights: dict[str, Lights], ground: Ground, draws: StreetDraws) -> Roadside:
    """All that stands along the streets, but trees."""
    rng = draws.town.rng
    streets = draws.streets.with_numbers_of(rng)
    signals, signs = list[TrafficSignal](), list[TrafficSign]()
    has_far = streets.next("far_signals")
    for rules in town_map.junctions:
        for number in range(len(rules.junction.arms)):
            back_m = line_m(town_map.town.has_crosswalks)
            if rules.control == "signals" and not rules.junction.is_roundabout:
                signals += _signals(rules, number, lights[rules.junction.id], (has_far, back_m))
            else:
                signs += _signs(rules, number, back_m)
    limit: SignKind = streets.next("speed_limit")
    signs += _speed_signs(town_map, limit)
    posts = tuple(_lamps(town_map, draws.lamps))
    drawn = Roadside(posts=posts, signals=tuple(signals), signs=tuple(signs))
    alike, share = draws.streets("alike"), draws.town("fronts")
    buildings = _buildings(town_map, ground, (share, alike), streets, draws.sizes.with_numbers_of(rng))
    return drawn.model_copy(update={"buildings": tuple(buildings)})


def _beside(arm: Arm, back_m: float) -> PlanPose:
    """The place of a pole on the right of the entering traffic, at a distance before the junction, with the traffic's
    heading."""
    cross = arm.cross
    out_m = cross.edge("left") + (BEHIND_KERB_M if "walkway" in cross.left else BESIDE_M)
    return arm.pose.moved(back_m, out_m, np.pi)


def _yaw(pose: PlanPose) -> float:
    return round(float((pose.heading - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi), SCENE_DECIMALS)


def _signals(rules: JunctionRules, number: int, lights: Lights, style: tuple[bool, float]) -> Iterator[TrafficSignal]:
    """The heads of an arm: beside the line, and over the lanes of several or behind the junction."""
    has_far, back_m = style
    arm = rules.junction.arms[number]
    groups: dict[LightGroup, list[LaneAt]] = {}
    for lane in arm.lanes(incoming=True):
        groups.setdefault(rules.group(number, lane.key), []).append(lane)
    near = _beside(arm, back_m - 0.2)
    is_wide = sum(map(len, groups.values())) > 1
    far = _far(rules, number) if has_far else None
    over = far or (near if is_wide else None)
    main: LightGroup = "minor" if "minor" in groups else "major"

    def head(at: PlanPose, group: LightGroup, height_m: float, reach_m: float, has_pole: bool) -> TrafficSignal:
        form: LensForm = "left" if group == "major_left" else "ball"
        return TrafficSignal(
            x_m=round(at.x, SCENE_DECIMALS),
            y_m=round(at.y, SCENE_DECIMALS),
            yaw_rad=_yaw(at),
            height_m=height_m,
            phases=lights.phases(group),
            lanes=tuple(lane.name for lane in groups[group]),
            form=form,
            reach_m=round(reach_m, 3),
            shift_s=lights.shift_s,
            has_pole=has_pole,
        )

    yield head(near, main, HEAD_M, 0.0, True)
    if over is None:
        return
    # As its traffic drives, a place's distance to the right of the arm's axis is its offset to the left, looking away.
    right_m = over.seen(arm.pose)[1]
    reaches = {group: float(np.mean([lane.offset_m for lane in lanes])) - right_m for group, lanes in groups.items()}
    order = sorted(reaches, key=lambda group: -abs(reaches[group]))
    for i, group in enumerate(order):
        if abs(reaches[group]) < 19:
            yield head(over, group, OVERHEAD_M, reaches[group], i == 0)


def _far(rules: JunctionRules, number: int) -> PlanPose | None:
    """The place of a pole behind the junction, on the right of the street straight ahead; None without one."""
    arms = rules.junction.arms
    heading = arms[number].pose.heading + np.pi
    for other in arms:
        turn = (other.pose.heading - heading + np.pi) % (2 * np.pi) - np.pi
        if abs(turn) < 0.15:
            cross = other.cross
            out_m = cross.edge("right") - (BEHIND_KERB_M if "walkway" in cross.right else BESIDE_M)
            at = other.pose.moved(1.0, out_m)
            return PlanPose(at.x, at.y, heading)
    return None


def _signs(rules: JunctionRules, number: int, back_m: float) -> Iterator[TrafficSign]:
    """The sign of an arm without signals."""
    arm = rules.junction.arms[number]
    lanes = tuple(lane.name for lane in arm.lanes(incoming=True))
    if rules.junction.is_roundabout:
        yield _sign(_beside(arm, back_m), "give_way", lanes)
    elif rules.control in ("priority", "stop"):
        if number in rules.major:
            yield _sign(_beside(arm, PRIORITY_M), "priority", lanes)
        else:
            yield _sign(_beside(arm, back_m), "stop" if rules.control == "stop" else "give_way", lanes)


def _sign(at: PlanPose, kind: SignKind, lanes: tuple[str, ...]) -> TrafficSign:
    place = {"x_m": round(at.x, SCENE_DECIMALS), "y_m": round(at.y, SCENE_DECIMALS), "yaw_rad": _yaw(at)}
    return TrafficSign(**place, height_m=SIGN_M, kind=kind, lanes=lanes)


def _speed_signs(town_map: TownMap, kind: SignKind) -> Iterator[TrafficSign]:
    """A sign for the traffic that leaves the first junction, on every other street."""
    for arm in town_map.junctions[0].junction.arms[::2]:
        street = arm.street
        if street.length_m < SPEED_M + 30:
            continue
        s_m = SPEED_M if arm.at_start else street.length_m - SPEED_M
        side = "right" if arm.at_start else "left"
        at = _along(street, side, s_m, BEHIND_KERB_M if street.profile.walkway_m else BESIDE_M)
        lanes = tuple(
            name for key, name in street.names(street.section_at(s_m))[side].items() if key.startswith("lane")
        )
        yield _sign(at.moved(0.0, 0.0, 0.0 if side == "right" else np.pi), kind, lanes)


def _along(street: Street, side: str, s_m: float, aside_m: float) -> PlanPose:
    """A place beside a street at a station, from the edge of its pavement or the front of its kerb; with its heading
    there."""
    points, headings = poses(street.plan, np.array([s_m]))
    piece, share = street.eased_at(s_m)
    start, end = abs(piece.start.edge(side)), abs(piece.end.edge(side))
    out_m = start + share * (end - start) + aside_m
    at = PlanPose(float(points[0, 0]), float(points[0, 1]), float(headings[0]))
    return at.moved(0.0, out_m if side == "left" else -out_m)


def _lamps(town_map: TownMap, draw: Draw) -> Iterator[Post]:
    """Lamp posts along the streets, behind kerbs."""
    sides, spacing_m, height_m = draw("lamps"), draw("lamp_spacing_m"), draw("lamp_height_m")
    for street in town_map.streets:
        walkway_m = street.profile.walkway_m
        aside_m = BEHIND_KERB_M - walkway_m if walkway_m else BESIDE_M
        for n, side in enumerate(("left", "right")):
            if sides not in (side, "both"):
                continue
            first_m = 9.0 + n * spacing_m / 2
            for s_m in np.arange(first_m, street.length_m - 6.0, spacing_m).round(3).tolist():
                place = {"road": street.id, "side": side, "s_m": s_m, "aside_m": round(aside_m, 3)}
                yield Post(kind="lamp", height_m=height_m, **place)


def _buildings(
    town_map: TownMap, ground: Ground, shares: tuple[float, float], streets: Draw, sizes: Draw
) -> list[Building]:
    """Buildings along the streets, the first ones at the corners; rows of one kind."""
    found: list[Building] = []
    taken: list[np.ndarray] = []
    share, alike = shares
    if not share:
        return found
    rng, usual = streets.rng, streets.next("building")
    for street in town_map.streets:
        for side in ("left", "right"):
            s_m = FIRST_BUILDING_M + float(rng.uniform(0, 2))
            while s_m < street.length_m - 8 and len(found) < MOST_BUILDINGS:
                kind = usual if rng.random() < alike else KINDS[int(rng.random() * 3)]
                width_m, length_m, height_m = building_size(sizes, kind)
                form = kind, width_m, length_m, height_m
                if rng.random() >= share:
                    s_m += length_m + streets.next("gap_m")
                    continue
                building = _building(street, side, s_m, form, streets)
                outline = floor_plan(building)
                corners = outline[[0, 6, 48, 42]]
                if _has_room(ground, outline, height_m) and not (taken and overlaps_any(corners, np.array(taken))):
                    found.append(building)
                    taken.append(corners)
                    s_m += length_m + streets.next("gap_m") * (0.3 if kind == "block" else 1.0)
                else:
                    s_m += BUILDING_STEP_M
    return found


def _has_room(ground: Ground, outline: np.ndarray, height_m: float) -> bool:
    """Whether a building stands off all pavements and on nearly level ground."""
    is_level = np.ptp(height_at(ground.network.terrain, outline)) < 0.3 * height_m + 1.0
    corners = outline[[0, 6, 48, 42, 0]]
    sides = [
        a + (b - a) * np.linspace(0, 1, 2 + int(np.linalg.norm(b - a) / RIM_M))[:, None] for a, b in pairwise(corners)
    ]
    rim = np.concatenate(sides)
    return bool(is_level) and bool(ground.paved.is_clear(rim, ROOM_M).all())


def _building(
    street: Street,
    side: str,
    s_m: float,
    form: tuple[BuildingKind, float, float, float],
    streets: Draw,
) -> Building:
    (kind, width_m, length_m, height_m), rng = form, streets.rng
    aside_m = street.profile.walkway_m + width_m / 2 + streets.next(f"{kind}_setback_m") + 0.3
    at = _along(street, side, min(s_m + length_m / 2, street.length_m), aside_m)
    yaw_rad = at.heading - np.pi / 2 + float(rng.normal(0, 0.01))
    return coloured(kind, (at.x, at.y), yaw_rad, (width_m, length_m, height_m), rng)


def street_trees(
    town_map: TownMap, ground: Ground, roadside: Roadside, draw: Draw, apart_m: float, looks: Draw
) -> tuple[Tree, ...]:
    """Trees in rows behind the walkways, where no building stands."""
    share, rng = draw("street_trees"), draw.rng
    found: list[Tree] = []
    fronts = np.concatenate([np.full((1, 2), np.inf), *(floor_plan(building) for building in roadside.buildings)])
    models = [1, 3, 6]
    for street in town_map.streets if share else ():
        for side in ("left", "right"):
            model = models[int(rng.random() * len(models))]
            for s_m in np.arange(8.0, street.length_m - 5, apart_m).tolist():
                if rng.random() >= share:
                    continue
                at = _along(street, side, s_m, street.profile.walkway_m + TREE_BEHIND_M)
                xy = np.array([[at.x, at.y]])
                near = np.hypot(*(fronts - xy).T).min()
                if near > 2.5 and ground.paved.is_clear(xy, 0.6)[0]:
                    yaw_rad, scale = looks("yaw_deg"), looks("scale")
                    place = {"x_m": round(at.x, SCENE_DECIMALS), "y_m": round(at.y, SCENE_DECIMALS)}
                    found.append(Tree(model=model, **place, yaw_rad=yaw_rad, scale=scale))
    return tuple(found)
