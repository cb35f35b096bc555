"""Maps and scenes of maps made by hand for tests: a T junction, a crossing of four arms, and a road with sections."""

from typing import Any

from synth3dlanes.scene.road_map import (
    MapJunction,
    MapLane,
    MapMark,
    MapPaint,
    MapRoad,
    MapSection,
    PlanPiece,
    Polynomial,
    RoadMap,
)
from synth3dlanes.scene.scene import Gaussian, Scene, Terrain
from tests.scenes import FLAT

WIDTH_M, HALF_M, ARM_M = 3.5, 12.0, 120.0
HILLS = Terrain(
    gaussians=(
        Gaussian(center_m=(40, 30), magnitude_m=8, sd_m=(60, 90), orientation_rad=0.3),
        Gaussian(center_m=(-60, -50), magnitude_m=-5, sd_m=(50, 50), orientation_rad=0.0),
    )
)


def constant(value: float) -> tuple[Polynomial, ...]:
    """The same value along a road."""
    return (Polynomial(s_m=0.0, a=value),)


def two_way() -> tuple[MapLane, ...]:
    """A lane in each direction with a dashed line between them, edge lines, kerbs and walkways."""
    return (
        MapLane(number=0, kind="none", marks=(MapMark(kind="dashed"),)),
        *(MapLane(number=n, kind="driving", widths=constant(WIDTH_M), marks=(MapMark(kind="solid"),)) for n in (1, -1)),
        *(MapLane(number=2 * n, kind="shoulder", widths=constant(0.4)) for n in (1, -1)),
        *(MapLane(number=3 * n, kind="walkway", widths=constant(2.0)) for n in (1, -1)),
    )


# Arms of a junction at the origin by name: the heading (unit x, y) from the junction outwards, and its angle.
ARMS = {"south": (0, -1, -1.5707963267948966), "north": (0, 1, 1.5707963267948966), "east": (1, 0, 0.0),
        "west": (-1, 0, 3.141592653589793)}  # fmt: skip


def arm(name: str, **changes: Any) -> MapRoad:
    """A straight road outwards from HALF_M beside the origin: lane 1 leads to the junction, lane -1 away from it."""
    x, y, heading = ARMS[name]
    piece = PlanPiece(x_m=x * HALF_M, y_m=y * HALF_M, heading_rad=heading, length_m=ARM_M)
    values: dict[str, Any] = {"sections": (MapSection(s_m=0.0, lanes=two_way()),)}
    return MapRoad(id=name, plan=(piece,), **(values | changes))


def connector(start: str, end: str) -> MapRoad:
    """A connecting road of one lane (-1) from an arm's incoming lane to another's outgoing one: an arc, or straight."""
    (ax, ay, a), (bx, by, b) = ARMS[start], ARMS[end]
    # Traffic comes in against the arm's heading, on its left side: the right side as it drives.
    left, right = (-ay, ax), (by, -bx)
    x0, y0 = ax * HALF_M + left[0] * WIDTH_M / 2, ay * HALF_M + left[1] * WIDTH_M / 2
    x1, y1 = bx * HALF_M + right[0] * WIDTH_M / 2, by * HALF_M + right[1] * WIDTH_M / 2
    heading = a + 3.141592653589793
    turn = (b - heading + 3.141592653589793) % 6.283185307179586 - 3.141592653589793
    if abs(turn) < 1e-6:
        length_m, curvature = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5, 0.0
    else:
        # Both ends are as far from where their tangents meet.
        radius_m = HALF_M - (WIDTH_M / 2 if turn < 0 else -WIDTH_M / 2)
        length_m, curvature = abs(turn) * radius_m, (1 if turn > 0 else -1) / radius_m
    piece = PlanPiece(
        x_m=x0, y_m=y0, heading_rad=heading, length_m=length_m, curvature=curvature, curvature_end=curvature
    )
    lanes = (
        MapLane(number=1, kind="none"),
        MapLane(number=0, kind="none"),
        MapLane(number=-1, kind="driving", widths=constant(WIDTH_M)),
    )
    offset = (Polynomial(s_m=0.0, a=WIDTH_M / 2),)
    section = (MapSection(s_m=0.0, lanes=lanes),)
    return MapRoad(id=f"{start}_{end}", plan=(piece,), sections=section, lane_offsets=offset, junction="cross")


def crossing(arms: tuple[str, ...], route: tuple[str, str], **changes: Any) -> RoadMap:
    """A junction of these arms; the host comes on the first of `route` and leaves on the second."""
    pairs = [(a, b) for a in arms for b in arms if a != b]
    links = [(f"{a}.0.1", f"{a}_{b}.0.-1") for a, b in pairs] + [(f"{a}_{b}.0.-1", f"{b}.0.-1") for a, b in pairs]
    start, end = route
    yields = tuple((f"east_{b}.0.-1", "south_north.0.-1") for b in arms if b != "east" and "north" in arms)
    values: dict[str, Any] = {
        "roads": (*(arm(name) for name in arms), *(connector(a, b) for a, b in pairs)),
        "links": tuple(links),
        "junctions": (MapJunction(id="cross", yields=yields),),
        "route": (f"{start}.0.1", f"{start}_{end}.0.-1", f"{end}.0.-1"),
        "paint": (
            MapPaint(kind="stop_line", lane=f"{start}.0.1", s_m=1.0),
            MapPaint(kind="arrow_straight", lane=f"{start}.0.1", s_m=12.0),
            MapPaint(kind="crosswalk", outline=((-3.5, 13.5), (3.5, 13.5), (3.5, 16.5), (-3.5, 16.5))),
        ),
    }
    return RoadMap(**(values | changes))


FOUR_WAY = crossing(("south", "north", "east", "west"), ("south", "north"))
LEFT_TURN = crossing(("south", "north", "east", "west"), ("south", "west"))
T_JUNCTION = crossing(("south", "east", "west"), ("south", "east"))


def sections_road() -> RoadMap:
    """A road of a line, a spiral, an arc and two cubics, with three sections: a lane opens on its right, and its middle
    moves aside."""
    plan = (
        PlanPiece(x_m=5.0, y_m=-80.0, heading_rad=1.4, length_m=60.0),
        PlanPiece(x_m=15.198028574, y_m=-20.873016201, heading_rad=1.4, length_m=40.0, curvature_end=0.02),
        PlanPiece(
            x_m=16.692766799, y_m=18.815123842, heading_rad=1.8, length_m=50.0, curvature=0.02, curvature_end=0.02
        ),
    )
    opening = (Polynomial(s_m=0.0, a=0.0, c=3 * 3.2 / 900, d=-2 * 3.2 / 27_000), Polynomial(s_m=30.0, a=3.2))

    def lanes(right: tuple[Polynomial, ...] | None) -> tuple[MapLane, ...]:
        dashed = (MapMark(kind="dashed"),)
        outer = () if right is None else (
            MapLane(number=-2, kind="driving", widths=right, marks=(MapMark(kind="solid"),)),
        )  # fmt: skip
        return (
            MapLane(number=1, kind="driving", widths=constant(3.4), marks=(MapMark(kind="solid", yellow=True),)),
            MapLane(number=0, kind="none", marks=(MapMark(kind="solid_dashed", yellow=True),)),
            MapLane(
                number=-1, kind="driving", widths=constant(3.6), marks=dashed if outer else (MapMark(kind="solid"),)
            ),
            *outer,
        )

    sections = (
        MapSection(s_m=0.0, lanes=lanes(None)),
        MapSection(s_m=50.0, lanes=lanes(opening)),
        MapSection(s_m=110.0, lanes=lanes(constant(3.2))),
    )
    offsets = (
        Polynomial(s_m=0.0, a=0.0),
        Polynomial(s_m=20.0, a=0.0, c=0.002, d=-0.00002),
        Polynomial(s_m=60.0, a=1.92),
    )
    links = [(f"r.{i}.-1", f"r.{i + 1}.-1") for i in (0, 1)] + [("r.1.-2", "r.2.-2")]
    links += [("r.0.-1", "r.1.-2"), *((f"r.{i + 1}.1", f"r.{i}.1") for i in (0, 1))]
    road = MapRoad(id="r", plan=plan, sections=sections, lane_offsets=offsets)
    return RoadMap(roads=(road,), links=tuple(links), route=("r.0.-1", "r.1.-1", "r.2.-1"))


def map_scene(roads: RoadMap, y_m: float = 80.0, **parts: Any) -> Scene:
    """A scene on a map, with the rest as on the flat road; `parts` are other fields of the scene."""
    values = FLAT.model_dump() | {"road": None, "map": roads.model_dump()}
    values["camera"] |= {"lane": 1, "y_m": y_m}
    for name, fields in parts.items():
        values[name] = values[name] | fields if isinstance(fields, dict) else fields
    return Scene.model_validate(values)
