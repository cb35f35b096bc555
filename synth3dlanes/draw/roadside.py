"""Ground -> Roadside: draw what stands beside and over the road, clear of every pavement. Stations of the roads' lines.

Rails fill the stretches of an edge that are free: along the outer edges of the roads, and between roads that part once
there is room for them.
"""

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.draw.draws import Draw
from synth3dlanes.geometry.polylines import stretches
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import SIDES, Side
from synth3dlanes.scene.roadside import Building, Crossing, Post, Rail, RailKind, RoadSide, Roadside
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.system.schema import Color
from synth3dlanes.world.beside import beside
from synth3dlanes.world.buildings import building_frame
from synth3dlanes.world.crossings import crossing_frame, crossing_span, dam_section
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.rails import KERBS, RAILS
from synth3dlanes.world.roadside import Footprints, footprints
from synth3dlanes.world.sign_faces import FACES, SIGNS

Rng = np.random.Generator
Place = Literal["left", "right", "inner"]
BuildingKind = Literal["house", "hall", "block"]

MM_DECIMALS, TRIES = 3, 30
# Stations from behind the host to where rails cannot be told from the road, and the least length of a rail.
BEHIND_M, AHEAD_M, MIN_RAIL_M = 30.0, 330.0, 14.0
# Distance of barriers from the edge of a raised road, where the ground falls away; the height from which it is raised.
RAISED_ASIDE_M, RAISED_FROM_M = 0.3, 0.3
# Least distance of a rail's back from any pavement, and the range of the ground's height at its front over the edge of
# the pavement.
BACK_M, LEVEL_M = 0.25, (-0.8, 0.15)
# Least distance of a barrier in the median from the edge lines.
MEDIAN_GAP_M = 0.3
# Least distances of things from the rail in front of them, and of posts from crossings; the greatest half of a
# crossing's span.
BEHIND_RAIL_M, APART_M, HALF_SPAN_M = 0.7, 3.0, 40.0
# Least distances of a dam's foot and of a building from any pavement.
DAM_GAP_M, BUILDING_GAP_M = 1.0, 5.0
GRAYS = ((0.3, 0.3, 0.29), (0.42, 0.41, 0.38))
WALLS = ((0.33, 0.31, 0.28), (0.12, 0.16, 0.1), (0.2, 0.13, 0.08), (0.25, 0.26, 0.27), (0.3, 0.2, 0.14))
FRONTS = ((0.6, 0.58, 0.52), (0.5, 0.4, 0.24), (0.32, 0.13, 0.09), (0.4, 0.39, 0.37), (0.55, 0.5, 0.38))
ROOFS = ((0.22, 0.06, 0.035), (0.09, 0.08, 0.08), (0.14, 0.08, 0.05), (0.2, 0.2, 0.21))
BOARDS, WOOD = ((0.005, 0.15, 0.07), (0.01, 0.07, 0.33)), (0.11, 0.08, 0.055)
BUILDINGS: tuple[BuildingKind, ...] = ("house", "hall", "block")


class RailDraw(NamedTuple):
    """What is drawn of rails of one kind."""

    kind: RailKind
    aside_m: float
    height_m: float
    color: Color


class PostRow(NamedTuple):
    """Posts at equal distances along the outer edges of one side."""

    kind: Literal["lamp", "delineator"]
    place: Place
    aside_m: float
    spacing_m: float
    height_m: float


class CrossingDraw(NamedTuple):
    """Gantries or bridges: how many, their free height, and the least distance between any two crossings."""

    kind: Literal["gantry", "bridge"]
    n: int
    clearance_m: float
    apart_m: float


class Edge(NamedTuple):
    """An edge of the pavement and the stations where it bounds a place."""

    road: str
    side: Side
    low_m: float = -np.inf
    high_m: float = np.inf


def draw_roadside(ground: Ground, draw: Draw, own: Draw) -> Roadside:
    """All structures of one scene, their kinds and numbers by `draw`, their places and sizes by `own`; those that find
    no room in a few tries are left out."""
    rng = draw.rng
    lamp_aside_m, delineator_aside_m = own("lamp_aside_m"), own("delineator_aside_m")
    signs_apart_m, crossings_apart_m = own("signs_apart_m"), own("crossings_apart_m")
    things = own.with_numbers_of(rng)
    kinds: dict[Place, Any] = {"left": draw("outer"), "right": draw("outer"), "inner": draw("inner")}
    has_ramp_rail, aside_m = draw("ramp_rail"), draw("rail_aside_m")
    wall_m = draw("wall_height_m")
    rails: list[Rail] = []
    for place, kind in kinds.items():
        color = shaded(rng, WALLS if kind == "noise_wall" else GRAYS)
        on_ramp: RailKind = kind if kind in ("guardrail", "concrete") else "guardrail"
        for edge in _edges(ground.network, place):
            if kind != "none":
                beside_m = 0.0 if kind in KERBS else aside_m
                rails += _rails(ground, edge, RailDraw(kind, beside_m, RAILS[kind].height_m or wall_m, color), False)
            if has_ramp_rail and ground.network.road(edge.road).ramp is not None:
                height_m = RAILS[on_ramp].height_m or wall_m
                rails += _rails(ground, edge, RailDraw(on_ramp, RAISED_ASIDE_M, height_m, color), True)
    rails += _median_rail(ground, draw("median"), shaded(rng, GRAYS))
    bridges = CrossingDraw("bridge", draw("n_bridges"), draw("clearance_m"), crossings_apart_m)
    crossings = _crossings(ground, bridges, things, [])
    gantries = CrossingDraw("gantry", draw("n_gantries"), draw("clearance_m"), crossings_apart_m)
    crossings += _crossings(ground, gantries, things, crossings)
    behind_m = {place: _behind(kind, aside_m) for place, kind in kinds.items()}
    lamp_sides, spacing_m, height_m = draw("lamps"), draw("lamp_spacing_m"), draw("lamp_height_m")
    posts: list[Post] = []
    for side in SIDES:
        if lamp_sides in (side, "both"):
            lamp_m = round(max(lamp_aside_m, behind_m[side]), MM_DECIMALS)
            posts += _row(ground, PostRow("lamp", side, lamp_m, spacing_m, height_m), rng, crossings)
    has_delineators, spacing_m = draw("delineators"), draw("delineator_spacing_m")
    for side in SIDES:
        if has_delineators and kinds[side] == "none":
            posts += _row(ground, PostRow("delineator", side, delineator_aside_m, spacing_m, 1.0), rng, crossings)
    posts += _signs(ground, draw("n_signs"), signs_apart_m, behind_m, things, crossings)
    line, pole_m = draw("power_line"), round(things.next("pole_height_m"), MM_DECIMALS)
    pole_aside_m = round(aside_m + things.next("pole_aside_m"), MM_DECIMALS)
    if line != "none" and not any(crossing.kind == "bridge" for crossing in crossings):
        for edge in _edges(ground.network, line):
            rails += _rails(ground, edge, RailDraw("power_line", pole_aside_m, pole_m, WOOD), False)
    drawn = Roadside(rails=tuple(rails), posts=tuple(posts), crossings=tuple(crossings))
    taken, buildings = footprints(ground, drawn), list[Building]()
    for kind in BUILDINGS:
        for _ in range(draw(f"n_{kind}s")):
            buildings += _building(ground, taken, buildings, kind, draw("building_aside_m"), things)
    return drawn.model_copy(update={"buildings": tuple(buildings)})


def _edges(network: Network, place: str) -> list[Edge]:
    """The edges on the left or the right (as t grows) of all roads, or between them. Where another road begins beside
    it, a road's right edge is an outer one before that and an inner one behind it."""
    found = []
    for road in network.roads:
        starts = [branch.start_m for branch in network.branches(road)]
        is_first = road.parting is None
        if place == "left":
            found += [Edge(road.id, "left")] if is_first else []
        elif place == "right":
            found.append(Edge(road.id, "right", road.start_m, min(starts, default=np.inf)))
        else:
            found += [Edge(road.id, "right", low_m=min(starts))] if starts else []
            found += [] if is_first else [Edge(road.id, "left", low_m=road.start_m)]
    return found


def _stations(ground: Ground, edge: Edge | None = None) -> Scalars:
    """Stations a metre apart in the range of structures, where an edge bounds its place."""
    low, high = np.sort(ground.network.stations(np.array(ground.way.range_m(AHEAD_M, BEHIND_M))))
    if edge is not None:
        low, high = max(low, edge.low_m), min(high, edge.high_m)
    return np.arange(np.ceil(low), np.floor(high) + 0.5)


def _ahead(ground: Ground, things: Draw, key: str) -> float:
    """A station at a distance ahead of the host where it drives; with `both_ways` ahead or behind."""
    u = things.rng.random()
    away_m = np.array([things.at(key, u) + ground.way.driven_m * u])
    if ground.way.both_ways and things.rng.random() < 0.5:
        away_m = ground.way.driven_m - away_m
    return round(float(ground.network.stations(ground.way.near_m + away_m)[0]), MM_DECIMALS)


def _free(ground: Ground, edge: Edge, s: Scalars, aside_m: float) -> Bool[np.ndarray, " n"]:
    """At which stations a place `aside_m` outside an edge has this distance from every other pavement, too."""
    return ground.clearance(beside(ground, edge.road, edge.side, s, aside_m)) > aside_m - 0.02


def _rails(ground: Ground, edge: Edge, rail: RailDraw, raised: bool) -> Iterator[Rail]:
    """Rails of one kind along the free stretches of an edge, where its road is raised or where it is not."""
    s, form = _stations(ground, edge), RAILS[rail.kind]
    if len(s) < 2:
        return

    def at(aside_m: float) -> Points2:
        return beside(ground, edge.road, edge.side, s, aside_m)

    free = _free(ground, edge, s, rail.aside_m)
    free &= ground.clearance(at(rail.aside_m + form.depth_m)) > BACK_M - 0.2 * (rail.kind in KERBS)
    free &= (ground.network.road(edge.road).raised(s) > RAISED_FROM_M) == raised
    if form.is_level:
        front, inside = (ground.height(at(aside_m)) for aside_m in (rail.aside_m, -0.05))
        free &= (front - inside > LEVEL_M[0]) & (front - inside < LEVEL_M[1])
    for from_m, to_m in _runs(s, free):
        yield Rail(road=edge.road, side=edge.side, from_m=from_m, to_m=to_m, **rail._asdict())


def _median_rail(ground: Ground, kind: Literal["none", "guardrail", "concrete"], color: Color) -> list[Rail]:
    """A barrier along the middle of the first median that has room for it."""
    road = ground.network.main
    if kind == "none":
        return []
    form, s = RAILS[kind], _stations(ground)
    assert form.height_m is not None, "barriers have a height of their own"
    for left_m, right_m in road.medians:
        if right_m - left_m >= form.depth_m + 2 * MEDIAN_GAP_M:
            drawn = RailDraw(kind, round((left_m + right_m) / 2, MM_DECIMALS), form.height_m, color)
            return [Rail(road=road.id, side="median", from_m=float(s[0]), to_m=float(s[-1]), **drawn._asdict())]
    return []


def _runs(s: Scalars, free: Bool[np.ndarray, " n"]) -> Iterator[tuple[float, float]]:
    """The first and last stations of the free stretches that are long enough."""
    for first, end in stretches(free):
        if s[end - 1] - s[first] >= MIN_RAIL_M:
            yield float(s[first]), float(s[end - 1])


def _behind(kind: str, aside_m: float) -> float:
    """Least distance from the edge of what stands behind a rail; a kerb is in nothing's way."""
    return 0.0 if kind in ("none", *KERBS) else aside_m + BEHIND_RAIL_M


def _row(ground: Ground, row: PostRow, rng: Rng, crossings: list[Crossing]) -> Iterator[Post]:
    """The posts of a row, clear of every pavement and all crossings."""
    shift_m = float(rng.random()) * row.spacing_m
    for edge in _edges(ground.network, row.place):
        s = _stations(ground, edge)
        if not len(s):
            continue
        s = np.round(np.arange(s[0] + (shift_m - s[0]) % row.spacing_m, s[-1], row.spacing_m), MM_DECIMALS)
        places = {"kind": row.kind, "road": edge.road, "side": edge.side, "aside_m": row.aside_m}
        for s_m in s[_free(ground, edge, s, row.aside_m)].tolist():
            if _is_apart(s_m, crossings):
                yield Post(s_m=s_m, height_m=row.height_m, **places)


def _is_apart(s_m: float, crossings: list[Crossing]) -> bool:
    """Whether a post is clear of all crossings."""
    return all(abs(crossing.s_m - s_m) > crossing.width_m / 2 + APART_M for crossing in crossings)


def _signs(
    ground: Ground, n: int, apart_m: float, behind_m: dict[Place, float], things: Draw, crossings: list[Crossing]
) -> Iterator[Post]:
    """Signs beside the outer edges, for the traffic there; guide boards stand farther away. None beside oncoming lanes
    forbids entry: it would face the host."""
    taken: list[float] = []
    rng, least_m = things.rng, things.least("sign_aside_m")
    for _ in range(n):
        for _ in range(TRIES):
            place: Place = "left" if rng.random() < 0.5 else "right"
            sign = SIGNS[int(rng.random() * len(SIGNS))]
            edges = _edges(ground.network, place)
            edge = edges[int(rng.random() * len(edges))]
            s_m = _ahead(ground, things, "sign_ahead_m")
            width_m = float(np.ptp(FACES[sign.right - 1][0].outline[:, 0]))
            aside_m = round(
                things.next("sign_aside_m") + max(0.0, behind_m[place] - least_m) + width_m / 2, MM_DECIMALS
            )
            height_m = round(things.next("sign_height_m"), MM_DECIMALS)
            is_here = edge.low_m <= s_m <= edge.high_m and all(abs(s_m - other) > apart_m for other in taken)
            if is_here and _is_apart(s_m, crossings) and _free(ground, edge, np.array([s_m]), aside_m)[0]:
                taken.append(s_m)
                beside_it = ground.network.road(edge.road).carriageways[0 if edge.side == "left" else -1]
                is_oncoming = beside_it.direction == "oncoming"
                if not (is_oncoming and sign.forbids_entry):
                    is_right = ((edge.side == "right") == (ground.network.rightward > 0)) != is_oncoming
                    yield Post(
                        kind="sign",
                        road=edge.road,
                        side=edge.side,
                        s_m=s_m,
                        aside_m=aside_m,
                        height_m=height_m,
                        face=sign.right if is_right else sign.left,
                        turned=is_oncoming or sign.forbids_entry,
                    )
                break


def _crossings(ground: Ground, drawn: CrossingDraw, things: Draw, others: list[Crossing]) -> list[Crossing]:
    """Crossings with a span of plausible length, apart from each other, whose dams end clear of all pavements."""
    rng, found, kind = things.rng, list(others), drawn.kind
    for _ in range(drawn.n):
        for _ in range(TRIES):
            s_m = _ahead(ground, things, "crossing_ahead_m")
            width_m = round(things.next(f"{kind}_width_m"), MM_DECIMALS)
            color = shaded(rng, GRAYS) if kind == "bridge" else BOARDS[int(rng.random() * len(BOARDS))]
            crossing = Crossing(kind=kind, s_m=s_m, clearance_m=drawn.clearance_m, width_m=width_m, color=color)
            if all(abs(s_m - other.s_m) > drawn.apart_m for other in found) and _spans(ground, crossing):
                found.append(crossing)
                break
    return found[len(others) :]


def _spans(ground: Ground, crossing: Crossing) -> bool:
    frame, span = crossing_frame(ground, crossing), crossing_span(ground, crossing)
    if crossing.kind == "gantry":
        return bool(max(np.abs(span.legs_m)) < HALF_SPAN_M)
    top_m = span.top_m - float(frame.origin[2])
    sections = [
        dam_section(ground, frame, x, sign, crossing.width_m / 2, top_m)
        for x, sign in zip(span.abutments_m, (-1, 1), strict=True)
    ]
    feet = frame.world(np.concatenate(sections).reshape(-1, 3))[:, :2]
    return bool(max(np.abs(span.abutments_m)) < HALF_SPAN_M and (ground.clearance(feet) > DAM_GAP_M).all())


def _building(
    ground: Ground,
    taken: Footprints,
    others: list[Building],
    kind: BuildingKind,
    aside_m: float,
    things: Draw,
) -> Iterator[Building]:
    """A building along the road on nearly level ground, clear of all pavements and structures."""
    rng, narrowest_m = things.rng, things.least(f"{kind}_width_m")
    for _ in range(TRIES):
        width_m, length_m, height_m = (round(size_m, MM_DECIMALS) for size_m in building_size(things, kind))
        side: RoadSide = "left" if rng.random() < 0.5 else "right"
        s = _ahead(ground, things, "building_ahead_m") + np.array([0.0, 1.0])
        far_m = aside_m + (width_m - narrowest_m) / 2 + (0.0 if kind == "house" else width_m / 2)
        (x, y), ahead = beside(ground, ground.network.main.id, side, s, far_m)
        turn = rng.normal(0, 0.06) + np.pi / 2 * int(rng.random() * 2)
        yaw_rad = float(np.arctan2(x - ahead[0], ahead[1] - y) + turn)
        x, y = (round(float(value), MM_DECIMALS) for value in (x, y))
        building = coloured(kind, (x, y), yaw_rad, (width_m, length_m, height_m), rng)
        outline = floor_plan(building)
        if not (
            taken.clear(outline, 2.0) & footprints(ground, Roadside(buildings=tuple(others))).clear(outline, 2.0)
        ).all():
            continue
        heights = ground.height(outline)
        is_level = np.ptp(heights) < 0.3 * height_m + 1.0
        if is_level and (ground.clearance(outline) > BUILDING_GAP_M).all():
            yield building
            return


def building_size(things: Draw, kind: BuildingKind) -> tuple[float, float, float]:
    """The width, length and height of the walls of a building, in metres."""
    width_m, length_m, height_m = (things.next(f"{kind}_{of}_m") for of in ("width", "length", "height"))
    return width_m, length_m, height_m


def coloured(
    kind: BuildingKind, xy: tuple[float, float], yaw_rad: float, sizes_m: tuple[float, float, float], rng: Rng
) -> Building:
    """A building with the colours of its walls and roof drawn; `sizes_m` are its width, its length and their height."""
    width_m, length_m, height_m = (round(size_m, 6) for size_m in sizes_m)
    x_m, y_m, yaw_rad = round(xy[0], 6), round(xy[1], 6), round(yaw_rad, 6)
    sizes = {"width_m": width_m, "length_m": length_m, "height_m": height_m}
    colors = {"color": shaded(rng, FRONTS), "roof": shaded(rng, ROOFS)}
    return Building(kind=kind, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, **sizes, **colors)


def floor_plan(building: Building) -> Float[np.ndarray, "n 2"]:
    """World points over a building's floor plan."""
    share = np.linspace(-0.5, 0.5, 7)
    x, y = np.meshgrid(share * building.width_m, share * building.length_m)
    places = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    return np.asarray(building_frame(building).world(places)[:, :2])


def shaded(rng: Rng, among: tuple[Color, ...]) -> Color:
    """One of some colours, a little lighter or darker."""
    color, shade = among[int(rng.random() * len(among))], 0.85 + 0.3 * rng.random()
    red, green, blue = (round(min(shade * channel, 1.0), 4) for channel in color)
    return red, green, blue
