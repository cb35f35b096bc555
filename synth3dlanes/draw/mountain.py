"""The maker of mountain roads: two lanes that climb in serpentines, with a rail or posts on the valley side and
sometimes a lay-by. World frame, metres and radians; stations grow uphill, t to the left."""

from collections.abc import Iterator
from itertools import accumulate, pairwise
from typing import Literal, NamedTuple

import numpy as np

from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw, DrawsOf
from synth3dlanes.draw.makers import Roads, draw_camera, first_shot, map_roads
from synth3dlanes.draw.town.plan import PlanPose, chain, poses
from synth3dlanes.draw.town.streets import smooth
from synth3dlanes.params.shots import Shots
from synth3dlanes.scene.assets.catalogue import Assets
from synth3dlanes.scene.road_map import (
    MapLane,
    MapLaneKind,
    MapMark,
    MapMarkKind,
    MapRoad,
    MapSection,
    Polynomial,
    RoadMap,
)
from synth3dlanes.scene.roadside import Post, Rail, Roadside
from synth3dlanes.scene.scene import Scene
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.rails import RAILS

ROAD = "m"
# Widths of shoulders and of a lay-by; lengths of a lay-by's full width and of each of its tapers.
SHOULDER_M, LAY_BY_M, LAY_BY_LENGTH_M, TAPER_M = 0.5, 2.75, 25.0, 12.0
LAY_BY_IN_ALL_M = LAY_BY_LENGTH_M + 2 * TAPER_M
# Length of a spiral before and behind each bend's arc, and of the legs at both ends of the road.
SPIRAL_M, END_LEG_M = 15.0, 100.0
# Distance of the host from both ends of its way.
HOST_BEHIND_M, HOST_AHEAD_M = 30.0, 150.0
# Distance of rails and posts from the pavement, spacing of posts, and their height.
RAIL_ASIDE_M, POST_ASIDE_M, POST_APART_M, POST_M = 0.4, 0.4, 12.0, 1.0
# Step of the grid of the ground: legs one above the other are 25 m apart.
GROUND_STEP_M = 8.0
GRAY = (0.36, 0.37, 0.38)


class LegOrBend(NamedTuple):
    """A leg or a bend: its length, whether it bends to the left (+1), to the right (-1) or not (0), the side of the
    valley, and whether a lay-by lies on its right."""

    length_m: float
    bend: int
    valley: Literal["left", "right"]
    has_lay_by: bool = False


def mountain_roads(of: DrawsOf, shots: Shots, assets: Assets) -> Roads:
    """A mountain road; the host drives up or down on it, in the right lane."""
    draw = of("mountain")
    rail, is_descent, u_place = draw("rail"), draw("descent"), draw("host_place")
    road, stretches = lay_out(draw, of("markings")("left_yellow"))
    up, down = ([f"{ROAD}.{i}.{side}" for i in range(len(stretches))] for side in (-1, 1))
    links = (*pairwise(up), *((after, before) for before, after in pairwise(down)))
    roads = RoadMap(roads=(road,), links=links, route=tuple(down[::-1] if is_descent else up))
    at_m = HOST_BEHIND_M + u_place * (road.length_m - HOST_BEHIND_M - HOST_AHEAD_M)
    camera = draw_camera(of("camera"), 1, round(at_m, SCENE_DECIMALS))

    def stand(scene: Scene, ground: Ground) -> Roadside:
        return _beside(stretches, rail)

    return map_roads(of, roads, camera, first_shot(shots, of("motion")), stand, GROUND_STEP_M)


def lay_out(draw: Draw, is_yellow: bool) -> tuple[MapRoad, list[LegOrBend]]:
    """The road, and its legs and bends. The middle of the road is at the origin."""
    n, side = draw("n_bends"), 1 if draw("first_left") else -1
    lane_m, widening_m, has_lay_by = draw("lane_width_m"), draw("widening_m"), draw("lay_by")
    parts, stretches, grades = list[list[tuple[float, float, float]]](), list[LegOrBend](), list[float]()
    for i in range(n + 1):
        length_m = END_LEG_M if i in (0, n) else draw("leg_m")
        # The next leg is higher and on the side to which the road bends next.
        valley: Literal["left", "right"] = "right" if side > 0 else "left"
        parts.append([(length_m, 0.0, 0.0)])
        stretches.append(LegOrBend(length_m, 0, valley, has_lay_by and i == n // 2 and length_m > LAY_BY_IN_ALL_M))
        grades.append(draw("grade"))
        if i < n:
            radius_m, turn_rad = draw("radius_m"), draw("turn_deg")
            arc_m = turn_rad * radius_m - SPIRAL_M
            curvature = side / radius_m
            parts.append([(SPIRAL_M, 0.0, curvature), (arc_m, curvature, curvature), (SPIRAL_M, curvature, 0.0)])
            stretches.append(LegOrBend(arc_m + 2 * SPIRAL_M, side, valley))
            side = -side
    flat = [part for of_one in parts for part in of_one]
    start = PlanPose(0.0, 0.0, 0.0)
    whole = chain(start, flat)
    middle = poses(whole, np.array([sum(piece.length_m for piece in whole) / 2]))[0][0]
    plan = chain(PlanPose(-float(middle[0]), -float(middle[1]), 0.0), flat)
    stations = _stations(stretches)
    sections = tuple(
        MapSection(s_m=round(s_m, 6), lanes=tuple(_lanes(at, lane_m, widening_m, is_yellow)))
        for s_m, at in zip(stations, stretches, strict=False)
    )
    heights = tuple(_heights(stations, grades))
    return MapRoad(id=ROAD, plan=plan, sections=sections, heights=heights), stretches


def _stations(stretches: list[LegOrBend]) -> list[float]:
    return list(accumulate((at.length_m for at in stretches), initial=0.0))


def _heights(stations: list[float], grades: list[float]) -> Iterator[Polynomial]:
    """Constant grades along legs, and along each bend an even change from one to the next; 0 at the road's middle."""
    found, z = list[Polynomial](), 0.0
    for i, (s_m, end_m) in enumerate(pairwise(stations)):
        length_m, first = end_m - s_m, grades[i // 2]
        c = (grades[(i + 1) // 2] - first) / (2 * length_m) if i % 2 else 0.0
        found.append(Polynomial(s_m=round(s_m, 6), a=z, b=first, c=c))
        z += length_m * (first + c * length_m)
    half_m = stations[-1] / 2
    at = next(piece for piece in reversed(found) if piece.s_m <= half_m)
    x = half_m - at.s_m
    middle_z = at.a + x * (at.b + x * at.c)
    for piece in found:
        yield piece.model_copy(update={"a": round(piece.a - middle_z, 9), "c": round(piece.c, 12)})


def _lanes(at: LegOrBend, lane_m: float, widening_m: float, is_yellow: bool) -> Iterator[MapLane]:
    """The lanes of a stretch from the left: lanes are wider in bends, whose dividing line is solid."""
    wide, edge = _widths(at.length_m, lane_m, lane_m + widening_m * abs(at.bend), SPIRAL_M), MapMark(kind="solid")
    shoulder = (Polynomial(s_m=0.0, a=SHOULDER_M),)
    kind: MapMarkKind = "solid" if at.bend else "dashed"
    yield _lane(2, "shoulder", shoulder)
    yield _lane(1, "driving", wide, edge)
    yield MapLane(number=0, kind="none", marks=(MapMark(kind=kind, yellow=is_yellow),))
    if at.has_lay_by:
        bare_m = (at.length_m - LAY_BY_IN_ALL_M) / 2
        bay = (Polynomial(s_m=0.0, a=0.0), *_bay(bare_m))
        edges = (0.0, edge), (bare_m, MapMark(kind="dashed")), (at.length_m - bare_m, edge)
        marks = [mark.model_copy(update={"s_m": round(s_m, 6)}) for s_m, mark in edges]
        yield _lane(-1, "driving", wide, *marks)
        yield _lane(-2, "parking", bay)
        yield _lane(-3, "shoulder", shoulder)
    else:
        yield _lane(-1, "driving", wide, edge)
        yield _lane(-2, "shoulder", shoulder)


def _lane(number: int, kind: MapLaneKind, widths: tuple[Polynomial, ...], *marks: MapMark) -> MapLane:
    return MapLane(number=number, kind=kind, widths=widths, marks=marks)


def _bay(bare_m: float) -> Iterator[Polynomial]:
    yield smooth(round(bare_m, 6), TAPER_M, 0.0, LAY_BY_M)
    yield Polynomial(s_m=round(bare_m + TAPER_M, 6), a=LAY_BY_M)
    yield smooth(round(bare_m + TAPER_M + LAY_BY_LENGTH_M, 6), TAPER_M, LAY_BY_M, 0.0)
    yield Polynomial(s_m=round(bare_m + LAY_BY_IN_ALL_M, 6), a=0.0)


def _widths(length_m: float, start_m: float, wide_m: float, taper_m: float) -> tuple[Polynomial, ...]:
    """A width that grows at the beginning of a stretch and shrinks at its end."""
    if wide_m == start_m:
        return (Polynomial(s_m=0.0, a=start_m),)
    return (
        smooth(0.0, taper_m, start_m, wide_m),
        Polynomial(s_m=taper_m, a=wide_m),
        smooth(round(length_m - taper_m, 6), taper_m, wide_m, start_m),
    )


def _beside(stretches: list[LegOrBend], kind: str) -> Roadside:
    """Rails or posts on the valley side of legs and around the outside of bends."""
    stations, rails, posts = _stations(stretches), list[Rail](), list[Post]()
    # A leg and the bend at its end have the valley on one side.
    for i in range(0, len(stretches), 2):
        from_m, to_m, side = stations[i], stations[min(i + 2, len(stretches))], stretches[i].valley
        if kind == "guardrail":
            height_m = RAILS["guardrail"].height_m
            assert height_m is not None, "guard rails have a height of their own"
            own = {"from_m": round(from_m + 2.0, 3), "to_m": round(to_m - 2.0, 3), "aside_m": RAIL_ASIDE_M}
            rails.append(Rail(kind="guardrail", road=ROAD, side=side, height_m=height_m, color=GRAY, **own))
        elif kind == "posts":
            for s_m in np.arange(from_m + POST_APART_M / 2, to_m, POST_APART_M).round(3).tolist():
                place = {"road": ROAD, "side": side, "s_m": s_m, "aside_m": POST_ASIDE_M}
                posts.append(Post(kind="delineator", height_m=POST_M, **place))
    return Roadside(rails=tuple(rails), posts=tuple(posts))
