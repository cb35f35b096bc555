"""The map expansion of nuScenes: the layers of a scene's map from above, in its level frame; read back,
and compared in the global frame.

| theirs | ours |
|---|---|
| `lane`, `lane_connector` | segments of the lane graph: their strips, and the paint along the sides of lanes |
| `arcline_path_3`, `connectivity` | middles of segments as arcs and straight pieces; which follows which |
| `lane_divider`, `road_divider` | sides that lanes share; sides towards oncoming lanes |
| `drivable_area`, `road_segment` | the pavement of traffic; the same, cut where junctions begin |
| `walkway`, `ped_crossing`, `stop_line` | walkways, crosswalks, stop and give-way lines with what they are for |
| `traffic_light` | signals |
"""

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import shapely
from jaxtyping import Bool, Float
from pydantic import Field, TypeAdapter, create_model
from shapely.geometry.base import BaseGeometry

from synth3dlanes.formats.comparing import Comparison, SourceSample, distances, is_beside, stations
from synth3dlanes.formats.comparing_maps import FoundLane, MapRule, area_problems, compare_lanes, symbol_problems
from synth3dlanes.formats.lane_map import Boundary, LaneSegment, lane_segments
from synth3dlanes.geometry.frames import invert, transform, turned
from synth3dlanes.geometry.polylines import stretches, thinned
from synth3dlanes.labels.labels import MIRRORED, Labels, Lane, LaneGraph, Marking, PaintColor, Pair
from synth3dlanes.scene.roadside import Rail
from synth3dlanes.scene.things import classes_in
from synth3dlanes.system.arrays import Matrix4, Points2, Points3, Scalars
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import Row3, Row4
from synth3dlanes.system.schema import Excerpt, Number, Positive
from synth3dlanes.world.areas import (
    difference,
    filled,
    intersection,
    outset,
    polygon_between,
    polygons_of,
    ring_area,
    union,
    valid,
)
from synth3dlanes.world.beside import beside
from synth3dlanes.world.elements import TrafficElement
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.rails import WALKWAY_M, rail_stations
from synth3dlanes.world.world import World

CATEGORIES, ELEMENTS = classes_in("nuscenes"), classes_in("nuscenes", of_elements=True)


TOKENS, POSE_FIELDS = list[str], {"translation": Row3, "rotation": Row4}


class _Hole(Excerpt):
    node_tokens: list[str]


class _Paint(Excerpt):
    node_token: str
    segment_type: str


class _Place(Excerpt):
    tx: Number
    ty: Number
    tz: Number


_AREA, _LINE, _SIDE = {"polygon_token": str}, {"line_token": str}, list[_Paint]


LAYERS: dict[str, dict[str, Any]] = {
    "node": {"x": Number, "y": Number},
    "line": {"node_tokens": TOKENS},
    "polygon": {"exterior_node_tokens": TOKENS, "holes": list[_Hole]},
    "drivable_area": {"polygon_tokens": TOKENS},
    "road_segment": _AREA,
    "road_block": {},
    "lane": {**_AREA, "left_lane_divider_segments": _SIDE, "right_lane_divider_segments": _SIDE},
    "lane_connector": _AREA,
    "ped_crossing": _AREA,
    "walkway": _AREA,
    "stop_line": _AREA,
    "carpark_area": {},
    "road_divider": _LINE,
    "lane_divider": {**_LINE, "lane_divider_segments": _SIDE},
    "traffic_light": {"pose": _Place},
}
"""The lists of a map, and what is read of their records; `road_block` and `carpark_area` stay empty."""


PATHS, LINKS = "arcline_path_3", "connectivity"
SIDES = {"left": "left_lane_divider_segments", "right": "right_lane_divider_segments"}


_Length = Annotated[float, Field(ge=0, le=1e4)]


class Arc(Excerpt):
    """A piece of a path: up to three arcs and straight pieces, by the letters of its shape."""

    start_pose: Row3
    shape: str
    radius: Positive
    segment_length: tuple[_Length, _Length, _Length]


class _Links(Excerpt):
    incoming: list[str]
    outgoing: list[str]


def token(*names: object) -> str:
    """The 32 hex digits that name a record, by what it is."""
    return hashlib.md5("/".join(map(str, names)).encode(), usedforsecurity=False).hexdigest()


def segment_type(marking: Marking, color: PaintColor | None, double: bool | None, pair: Pair | None = None) -> str:
    """The name of paint; the stripes of a pair from the left, as the lane's traffic drives."""
    if marking == "none":
        return "NIL"
    stripes = pair or f"{'double' if double else 'single'}_{marking}"
    return f"{stripes}_{color or 'white'}".upper()


def excerpt(**fields: Any) -> Any:
    made: Any = {name: (of, ...) for name, of in fields.items()}
    return create_model("row", __base__=Excerpt, **made)


def records(fields: Mapping[str, Any]) -> Any:
    return list[excerpt(token=str, **fields)]  # type: ignore[misc]


MAP_FILE = TypeAdapter[Any](
    excerpt(
        canvas_edge=tuple[Positive, Positive],
        arcline_path_3=dict[str, list[Arc]],
        connectivity=dict[str, _Links],
        **{name: records(fields) for name, fields in LAYERS.items()},
    )
)


@dataclass(frozen=True, eq=False)
class PlaceMap:
    """A place's map as its file says."""

    layers: Any

    def places(self, tokens: list[str]) -> Points2:
        return np.array([self._nodes[name] for name in tokens]).reshape(-1, 2)

    @cached_property
    def _nodes(self) -> dict[str, tuple[float, float]]:
        return {node.token: (node.x, node.y) for node in self.layers.node}

    @cached_property
    def lines(self) -> dict[str, Points2]:
        return {line.token: self.places(line.node_tokens) for line in self.layers.line}

    @cached_property
    def polygons(self) -> dict[str, shapely.Polygon]:
        """Polygons by their tokens; empty ones of rings that are none."""
        found = dict[str, shapely.Polygon]()
        for of in self.layers.polygon:
            shell, *holes = map(self.places, (of.exterior_node_tokens, *(at.node_tokens for at in of.holes)))
            rings = [ring for ring in holes if len(ring) > 2]
            found[of.token] = shapely.Polygon(shell, rings) if len(shell) > 2 else shapely.Polygon()
        return found


MM_DECIMALS, LINE_M, SAME_LINE_M = 3, 0.005, 0.2
"""How far thinned lines may be from those with all points, and how far boundaries that are one line may be apart."""
ARC_M, LEAST_CURVATURE, STRAIGHT_RADIUS_M = 0.01, 1e-5, 1000.0
"""How far arcs may be from the middle of a lane, and the least curvature (1/m) of one; a straight path has a radius
too."""
MOST_ARC_RAD = 2.0
SEAM_M = 0.01
"""How far junctions overlap what is around them, so that tools that join both find no seam."""
MEDIAN_M, LEAST_POINTS = 20.0, 2
"""The widest median, and the points (every half metre) of which a divider has more."""
NEAR_STOP_M, CROSSING_M = 1.0, 6.0
"""How far a stop line may be from its lane, and from its crosswalk."""
SHAPES = {"ball": "CIRCLE", "left": "LEFT_ARROW", "straight": "UP_ARROW", "right": "RIGHT_ARROW"}

Record = dict[str, Any]


def map_layers(world: World, graph: LaneGraph, log: str, world_from_ego: Matrix4, reach_m: float) -> Record:
    """All layers of the map of a scene, whose first sample has this vehicle frame."""
    at = world.view.world_from_host[:3, 3]
    lanes = list(lane_segments(world, graph.segments, at, reach_m))
    made = _Layers(log, level_from_world(world_from_ego), world, graph)
    areas = {lane.id: made.lane(lane) for lane in lanes}
    made.links(lanes)
    made.dividers(lanes)
    junctions = filled(union(areas[lane.id] for lane in lanes if lane.is_connector))
    made.surfaces(at[:2], reach_m, junctions)
    made.lights()
    made.stop_lines(areas, made.crossings())
    return made.layers


def level_from_world(world_from_ego: Matrix4) -> Matrix4:
    """The level frame of a scene, given the vehicle frame of its first sample."""
    yaw_rad = float(np.arctan2(world_from_ego[1, 0], world_from_ego[0, 0]))
    return np.asarray(turned(yaw_rad) @ invert(world_from_ego))


class _Layers:
    """Layers that are being made; places that are equal to the millimetre are one node."""

    def __init__(self, log: str, level_from_world: Matrix4, world: World, graph: LaneGraph) -> None:
        self.log, self.level_from_world, self.world, self.graph = log, level_from_world, world, graph
        self.layers: Record = {name: list[Record]() for name in LAYERS} | {PATHS: {}, LINKS: {}}
        self._nodes = dict[tuple[float, float], str]()

    def level(self, points_world: Points3) -> Points2:
        """World points from above."""
        return np.asarray(transform(self.level_from_world, points_world)[:, :2])

    def area(self, area_world: BaseGeometry) -> BaseGeometry:
        """An area of the ground from above."""

        def placed(xy: Points2) -> Points2:
            return self.level(np.column_stack([xy, self.world.ground.height(xy)])) if len(xy) else xy

        # Seen square to a slope, an area may fold where one road leaves another at its own height.
        unfolded = shapely.make_valid(shapely.transform(area_world, placed), method="structure", keep_collapsed=False)
        return shapely.simplify(unfolded, LINE_M)

    def token(self, *names: object) -> str:
        """The name of a record of this scene."""
        return token(self.log, *names)

    def add(self, layer: str, name: str, **fields: Any) -> None:
        self.layers[layer].append({"token": name, **fields})

    def nodes(self, xy: Points2) -> list[str]:
        """The nodes at places; of equal ones after each other, one."""
        found = list[str]()
        for x, y in (np.round(xy, MM_DECIMALS) + 0.0).tolist():
            if (x, y) not in self._nodes:
                self._nodes[x, y] = self.token("node", len(self._nodes))
                self.add("node", self._nodes[x, y], x=x, y=y)
            if not found or found[-1] != self._nodes[x, y]:
                found.append(self._nodes[x, y])
        return found

    def line(self, xy: Points2) -> str:
        name = self.token("line", len(self.layers["line"]))
        self.add("line", name, node_tokens=self.nodes(xy))
        return name

    def areas(self, layer: str, parts: Iterable[shapely.Polygon], word: str = "", **fields: Any) -> list[str]:
        """Records of a layer that are polygons; their names."""
        names = list[str]()
        for part in parts:
            of = self.polygon(part)
            names.append(self.token(word or layer, of))
            self.add(layer, names[-1], polygon_token=of, **fields)
        return names

    def polygon(self, polygon: shapely.Polygon) -> str:
        """A polygon, whose rings do not name their first node again."""
        name = self.token("polygon", len(self.layers["polygon"]))
        rings = [self.nodes(np.array(ring.coords)[:-1]) for ring in (polygon.exterior, *polygon.interiors)]
        holes = [{"node_tokens": ring} for ring in rings[1:] if len(ring) > 2]
        self.add("polygon", name, exterior_node_tokens=rings[0], holes=holes)
        return name

    def lane(self, lane: LaneSegment) -> BaseGeometry:
        """A lane or a connector with its path; return its area."""
        name = self.token("lane", lane.id)
        sides = thinned(np.stack([lane.left.points_world, lane.right.points_world], axis=1), LINE_M)
        left, right = self.level(sides[:, 0]), self.level(sides[:, 1])
        parts = _parts(ring_area(np.concatenate([left, right[::-1]]))) or _parts(polygon_between(left, right))
        area = max(parts, key=lambda part: part.area, default=shapely.Polygon(np.concatenate([left, right[::-1]])))
        self.layers[PATHS][name] = arcline_paths(self.level(lane.points_world))
        if lane.is_connector:
            self.add("lane_connector", name, polygon_token=self.polygon(area))
            return area
        segments = (
            [{"node_token": node, "segment_type": _paint(of)} for node in self.nodes(side)]
            for side, of in ((left, lane.left), (right, lane.right))
        )
        self.add(
            "lane",
            name,
            polygon_token=self.polygon(area),
            lane_type="CAR",
            from_edge_line_token=self.line(np.stack([left[0], right[0]])),
            to_edge_line_token=self.line(np.stack([left[-1], right[-1]])),
            **dict(zip(SIDES.values(), segments, strict=True)),
        )
        return area

    def links(self, lanes: Sequence[LaneSegment]) -> None:
        known = {lane.id for lane in lanes}
        links = [(a, b) for a in known for b in self.graph.successors.get(a, ()) if b in known]
        for lane in lanes:
            self.layers[LINKS][self.token("lane", lane.id)] = {
                "incoming": sorted(self.token("lane", a) for a, b in links if b == lane.id),
                "outgoing": sorted(self.token("lane", b) for a, b in links if a == lane.id),
            }

    def dividers(self, lanes: Sequence[LaneSegment]) -> None:
        """Lines between lanes of one direction, with their paint, where they are beside each other; and those between
        both directions: one, or one on each side of a median."""
        lanes = [lane for lane in lanes if not lane.is_connector]
        for lane in lanes:
            for other in lanes:
                if other is not lane:
                    for line in _runs(lane.right, _apart(lane.right.points_world, [other.left]) < SAME_LINE_M):
                        of = self.line(self.level(line))
                        nodes = self.layers["line"][-1]["node_tokens"]
                        paint = [{"node_token": node, "segment_type": _paint(lane.right)} for node in nodes]
                        self.add("lane_divider", self.token("divider", of), line_token=of, lane_divider_segments=paint)
            self._between_directions(lane, lanes)

    def _between_directions(self, lane: LaneSegment, lanes: Sequence[LaneSegment]) -> None:
        """The line to the oncoming lanes beside a lane, which are to the right where traffic keeps left."""
        on, own = self.world.network.lanes, self.world.network.lanes[lane.id]
        across = [of for of in lanes if on[of.id].road == own.road and on[of.id].ascends != own.ascends]
        sides = (lane.left, [of.left for of in across]), (lane.right, [of.right for of in across])
        beside = self.world.network.neighbours(self.graph.segments[lane.index])
        for (side, others), neighbour in zip(sides, beside, strict=True):
            if neighbour is None and others:
                apart_m, middle = _apart(side.points_world, others), _apart(lane.points_world, others)
                # One line has two sides, of which one is enough.
                is_between = (apart_m < np.minimum(middle, MEDIAN_M)) & (own.ascends | (apart_m > SAME_LINE_M))
                for line in _runs(side, is_between):
                    of = self.line(self.level(line))
                    self.add("road_divider", self.token("divider", of), line_token=of, road_segment_token="")

    def surfaces(self, at: Float[np.ndarray, "2"], reach_m: float, junctions: BaseGeometry) -> None:
        """The pavement of traffic, cut where junctions begin, and the walkways beside it."""
        ground, rails = self.world.ground, self.world.site.roadside.rails
        paved = self.area(ground.paved.carriageway(at, reach_m))
        inner = intersection(outset(junctions, SEAM_M), paved)
        drivable = self.token("drivable_area")
        self.add("drivable_area", drivable, polygon_tokens=[self.polygon(part) for part in _parts(paved)])
        for area, is_junction in ((difference(paved, junctions), False), (inner, True)):
            self.areas("road_segment", _parts(area), is_intersection=is_junction, drivable_area_token=drivable)
        paths = [walkway(ground, rail) for rail in rails if rail.kind == "walkway"]
        self.areas("walkway", _parts(self.area(union([ground.paved.walkways(at, reach_m), *paths]))))

    def crossings(self) -> dict[str, BaseGeometry]:
        found = list(self._symbols("crosswalk"))
        return dict(zip(self.areas("ped_crossing", found, "crossing", road_segment_token=""), found, strict=True))

    def _symbols(self, kind: str) -> Iterator[shapely.Polygon]:
        for form in self.world.symbol_shapes:
            if form.kind == kind:
                yield from _parts(shapely.simplify(ring_area(self.level(form.points_world(form.outline))), LINE_M))

    def lights(self) -> None:
        """Signals: a line of a metre from each along which it looks."""
        for number, element in self._signals():
            pose = self.level_from_world @ element.place.world_from_face
            (x, y, z), (dx, dy, _) = pose[:3, 3].tolist(), (-pose[:3, 1]).tolist()
            high_m, yaw_rad = float(element.place.size_m[2]), float(np.arctan2(dy, dx))
            lamps = [
                {
                    "color": color,
                    "shape": SHAPES[element.kind],
                    "rel_pos": _pose(0.0, 0.0, share * high_m, 0.0),
                    "to_road_block_tokens": [],
                }
                for color, share in (("RED", 1 / 3), ("YELLOW", 0.0), ("GREEN", -1 / 3))
            ]
            self.add(
                "traffic_light",
                self.token("light", number),
                line_token=self.line(np.array([[x, y], [x + dx, y + dy]])),
                traffic_light_type="VERTICAL",
                from_road_block_token="",
                items=lamps,
                pose=_pose(x, y, z, yaw_rad),
            )

    def _signals(self) -> list[tuple[int, TrafficElement]]:
        elements = enumerate(self.world.site.elements)
        return [(number, element) for number, element in elements if element.category in ELEMENTS]

    def stop_lines(self, areas: Mapping[str, BaseGeometry], crossings: Mapping[str, BaseGeometry]) -> None:
        """Stop lines with what they are for: lights and signs of the lanes that they cross, or a crosswalk beyond."""
        for kind in ("stop_line", "give_way_line"):
            for area in self._symbols(kind):
                near = shapely.buffer(area, NEAR_STOP_M)
                crossed = {name for name, lane in areas.items() if shapely.intersects(lane, near)}
                ahead = crossed | {after for name in crossed for after in self.graph.successors.get(name, ())}
                lights = [self.token("light", i) for i, element in self._signals() if ahead & {*element.lanes}]
                signs = {element.kind for element in self.world.site.elements if ahead & {*element.lanes}}
                beyond = [name for name, of in crossings.items() if shapely.distance(of, area) < CROSSING_M]
                if lights:
                    why = "TRAFFIC_LIGHT"
                elif kind == "give_way_line":
                    why = "YIELD"
                elif "stop" in signs or not beyond:
                    why = "STOP_SIGN"
                else:
                    why = "PED_CROSSING"
                more: Record = {"ped_crossing_tokens": beyond if why == "PED_CROSSING" else []}
                more |= {"traffic_light_tokens": lights, "road_block_token": ""}
                self.areas("stop_line", [area], stop_line_type=why, **more)


def _parts(area: BaseGeometry) -> list[shapely.Polygon]:
    """The valid polygons of an area with its corners rounded as nodes are."""
    return polygons_of(shapely.set_precision(valid(area), 10.0**-MM_DECIMALS))


def walkway(ground: Ground, rail: Rail) -> BaseGeometry:
    """The paved path behind the kerb of a walkway, from above."""
    s = rail_stations(ground, rail)
    front, back = (beside(ground, rail.road, rail.side, s, rail.aside_m + across) for across in (0.0, WALKWAY_M))
    return polygon_between(front, back)


def arcline_paths(middle: Points2) -> list[Record]:
    """The middle of a lane as arcs and straight pieces, the longest that are within ARC_M of all points."""
    paths, first = [], 0
    while first < len(middle) - 1:
        last, step = first + 1, 1
        while step:
            tried = min(last + step, len(middle) - 1)
            fits = tried > last and _arc_gap(middle[first : tried + 1]) <= ARC_M
            last, step = (tried, 2 * step) if fits else (last, step // 2)
        paths.append(_arc(middle[first : last + 1]))
        first = last
    return paths


def _curvature(points: Points2) -> float:
    """The curvature of the circle through the first, the middle and the last of some points, positive to the left; 0
    for a straight line."""
    a, b, c = points[0], points[len(points) // 2], points[-1]
    (ux, uy), (vx, vy) = b - a, c - b
    sides = np.linalg.norm(b - a) * np.linalg.norm(c - b) * np.linalg.norm(c - a)
    found = 2 * (ux * vy - uy * vx) / max(float(sides), 1e-12) if len(points) > 2 else 0.0
    return float(found) if abs(found) >= LEAST_CURVATURE else 0.0


def _arc_gap(points: Points2) -> float:
    """How far points are from the arc through the first, the middle and the last of them; infinite if it turns much."""
    chord, k = points[-1] - points[0], _curvature(points)
    length_m = max(float(np.linalg.norm(chord)), 1e-9)
    along = np.array([chord[0], chord[1]]) / length_m
    left = np.array([-along[1], along[0]])
    if k == 0:
        return float(np.abs((points - points[0]) @ left).max())
    if abs(k) * length_m / 2 >= np.sin(MOST_ARC_RAD / 2):
        return np.inf
    to_center = np.sqrt(1 / k**2 - length_m**2 / 4)
    center = (points[0] + points[-1]) / 2 + left * to_center * np.sign(k)
    return float(np.abs(np.linalg.norm(points - center, axis=1) - 1 / abs(k)).max())


def _arc(points: Points2) -> Record:
    (dx, dy), k = points[-1] - points[0], _curvature(points)
    chord_m, yaw_rad = float(np.hypot(dx, dy)), float(np.arctan2(dy, dx))
    half_rad = float(np.arcsin(k * chord_m / 2))
    length_m = 2 * half_rad / k if k else chord_m
    ends = (*points[0].tolist(), yaw_rad - half_rad), (*points[-1].tolist(), yaw_rad + half_rad)
    return {
        "start_pose": list(ends[0]),
        "end_pose": list(ends[1]),
        "shape": "RSR" if k < 0 else "LSL",
        "radius": 1 / abs(k) if k else STRAIGHT_RADIUS_M,
        "segment_length": [length_m, 0.0, 0.0] if k else [0.0, length_m, 0.0],
    }


def _apart(points: Points3, others: Sequence[Boundary]) -> Scalars:
    """How far points are from the nearest of some boundaries; infinite if none is near any of them."""
    lines = shapely.MultiLineString([other.points_world[:, :2] for other in others])
    box = shapely.box(*points[:, :2].min(axis=0), *points[:, :2].max(axis=0))
    if shapely.distance(box, lines) > MEDIAN_M:
        return np.full(len(points), np.inf)
    return np.asarray(shapely.distance(shapely.points(points[:, :2]), lines))


def _runs(side: Boundary, kept: Bool[np.ndarray, " n"]) -> Iterator[Points3]:
    """The unbroken parts of a boundary of points that are kept."""
    for first, end in stretches(kept):
        if end - first > LEAST_POINTS:
            yield thinned(side.points_world[first:end, None], LINE_M)[:, 0]


def _paint(side: Boundary) -> str:
    return segment_type(side.marking, side.color, side.double, side.pair)


def _pose(x: float, y: float, z: float, yaw_rad: float) -> dict[str, float]:
    return {"tx": x, "ty": y, "tz": z, "rx": 0.0, "ry": 0.0, "rz": yaw_rad}


# -- compared with the labels


# Lanes are within this of the labels from above: arcs are fitted, and on a slope heights between the labels' points
# count too, for which other formats have a limit of their own. A map has no heights.
RULE = MapRule("m", 0.1, slack=np.inf, word=segment_type, gap_m=0.03)
# A label's line between two lanes is in a map if the share ON_LINE of it is within ON_LINE_M of dividers.
ON_LINE_M, ON_LINE, LEAST_COMPARED = 0.06, 0.9, 10
# The largest share of a line with a lane on one side only along which it may be one between lanes, farther on.
MAX_ONE_SIDED_SHARE = 0.5
# The most that lanes of the other direction are beyond the line beside a median.
FACING_M = 25.0
# How far from a lane's middle its polygon may end; the step between places of an arc.
AREA_M, ARC_STEP_M = 0.05, 0.5
Line2 = Float[np.ndarray, "_ 2"]
TURN = {"L": 1, "S": 0, "R": -1}


class _FromAbove(SourceSample):
    """A sample whose world frame is an export's global frame, and whose lines lie in its plane."""

    def __init__(self, truth: SourceSample, global_from_cam: Matrix4) -> None:
        super().__init__(truth.reader, truth.place)
        self.global_from_cam = global_from_cam

    @cached_property
    def labels(self) -> Labels:
        own = SourceSample(self.reader, self.place).labels
        lanes = tuple(replace(lane, xyz_cam=self._flat(lane.xyz_cam)) for lane in own.lanes)
        symbols = tuple(replace(symbol, xyz_cam=self._flat(symbol.xyz_cam)) for symbol in own.symbols)
        return replace(own, camera=replace(own.camera, world_from_cam=np.eye(4)), lanes=lanes, symbols=symbols)

    def _flat(self, points_cam: Points3) -> Points3:
        return np.asarray(transform(self.global_from_cam, points_cam) * [1, 1, 0])


def compare_place(found: PlaceMap, log: str, where: str, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """Lanes in metres; sides, links and paint; what else is on the road, of the scene of a log. FormatErrors begin with
    `where`."""
    above = _FromAbove(truth, global_from_cam)
    names = {token(log, "lane", segment.id): segment.id for segment in truth.labels.graph.segments}
    own = {lane.token: lane for lane in (*found.layers.lane, *found.layers.lane_connector)}
    lanes, problems = list[FoundLane](), list[str]()
    try:
        for name, arcs in found.layers.arcline_path_3.items():
            path = _places(arcs) if name in names else np.zeros((0, 2))
            if len(path) < 2:
                continue
            links, sides, paint = found.layers.connectivity[name], dict[str, Points3](), dict[str, str]()
            area = found.polygons[own[name].polygon_token] if name in own else shapely.Polygon()
            if not shapely.contains_xy(shapely.buffer(area, AREA_M), *path.T).all():
                problems.append(f"lane {names[name]}: expected its middle in its polygon, got it outside")
            for side, key in SIDES.items() if name in own and own[name] in found.layers.lane else ():
                nodes = getattr(own[name], key)
                sides[side] = _in_plane(found.places([at.node_token for at in nodes]))
                paint[side] = ", ".join(sorted({at.segment_type for at in nodes}))
            lanes.append(FoundLane(name, names[name], _in_plane(path), sides, paint, links.outgoing, links.incoming))
        problems += [*_divider_problems(found, above.labels), *_thing_problems(found, above, truth, global_from_cam)]
    except KeyError as error:
        raise FormatError(f"{where}: expected a record with the token {error}, got none") from None
    global_from_world = global_from_cam @ invert(truth.labels.camera.world_from_cam)
    return compare_lanes(lanes, above, RULE, global_from_world).because(problems)


def _in_plane(xy: Points2) -> Points3:
    return np.column_stack([xy, np.zeros(len(xy))])


def _places(arcs: list[Arc]) -> Points2:
    """Places along the arcs of a path."""
    found = list[tuple[float, float]]()
    for arc in arcs:
        x, y, yaw = arc.start_pose
        for letter, length in zip(arc.shape, arc.segment_length, strict=False):
            k = TURN.get(letter, 0) / arc.radius
            steps = np.linspace(0, length, 1 + max(1, int(np.ceil(length / ARC_STEP_M)))) if length else np.zeros(1)
            # sinc keeps straight pieces in the same formula: the chord of an arc, in the direction of its middle.
            chords, headings = steps * np.sinc(k * steps / 2 / np.pi), yaw + k * steps / 2
            found += zip(x + chords * np.cos(headings), y + chords * np.sin(headings), strict=True)
            (x, y), yaw = found[-1], yaw + k * length
    return np.array(found).reshape(-1, 2)


def _divider_problems(found: PlaceMap, labels: Labels) -> Iterator[str]:
    """Findings where a painted line between two lanes is no divider, or one of another kind or paint."""
    centers = {lane.id: lane for lane in labels.lanes if lane.kind == "centerline" and len(lane.xyz_cam) > 1}
    kinds: dict[str, list[tuple[Points2, set[str] | None]]] = {
        "road divider": [(found.lines[row.line_token], None) for row in found.layers.road_divider],
        "lane divider": [
            (found.lines[row.line_token], {of.segment_type for of in row.lane_divider_segments})
            for row in found.layers.lane_divider
        ],
    }
    kinds = {kind: [divider for divider in of if len(divider[0]) > 1] for kind, of in kinds.items()}
    every = [divider for dividers in kinds.values() for divider in dividers]
    for line in labels.lanes:
        if line.kind != "delimiter" or line.junction is not None:
            continue
        sides = [centers[name] for name in (line.left, line.right) if name in centers]
        if len(sides) < 2:
            if len(line.xyz_cam) >= LEAST_COMPARED and not (sides and _faces_others(line, sides[0], centers)):
                xy = line.xyz_cam[:, :2]
                on = [distances(xy, of) < ON_LINE_M for of, _ in every if _may_touch(of, xy)]
                share = np.any(on, axis=0).mean() if on else 0.0
                if share > MAX_ONE_SIDED_SHARE:
                    yield f"{line.id}: expected no divider along the edge of a road, got one along {share:.0%} of it"
            continue
        xy = line.xyz_cam[:, :2]
        xy = xy[np.all([is_beside(xy, side.xyz_cam[:, :2]) for side in sides], axis=0)]
        if len(xy) < LEAST_COMPARED:
            continue
        kind = "lane divider" if len({_goes_on(side, xy) for side in sides}) == 1 else "road divider"
        near = [(of, paint, distances(xy, of) < ON_LINE_M) for of, paint in kinds[kind] if _may_touch(of, xy)]
        covered = np.any([at for _, _, at in near], axis=0).mean() if near else 0.0
        if not covered >= ON_LINE:
            yield f"{line.id}: expected a {kind} along it, got one along {covered:.0%} of it"
            continue
        for of, paint, at in near:
            if paint is not None and at.mean() > ON_LINE:
                expected = _paint_along(line, of, xy)
                if paint != {expected}:
                    told = ", ".join(sorted(paint))
                    yield f"{line.id}: expected the paint {expected}, got {told}"


def _faces_others(line: Lane, own: Lane, centers: Mapping[str, Lane]) -> bool:
    """Whether a line is on that side of its lane where others drive the other way, beyond a median."""
    xy, middle = line.xyz_cam[:, :2], own.xyz_cam[:, :2]
    is_onward = _goes_on(own, xy)
    for other in centers.values():
        its = other.xyz_cam[:, :2]
        if is_beside(xy, its).sum() > min(LEAST_COMPARED, len(xy) / 2) and _goes_on(other, xy) != is_onward:
            apart_m = float(np.median(distances(xy, its)))
            if apart_m < min(float(np.median(distances(middle, its))), FACING_M):
                return True
    return False


def _goes_on(lane: Lane, xy: Points2) -> bool:
    """Whether the traffic of a lane goes from the first to the last of some places beside it."""
    first_m, last_m = stations(xy[[0, -1]], lane.xyz_cam[:, :2])
    return bool((last_m > first_m) != (lane.direction == "oncoming"))


def _may_touch(of: Line2, xy: Line2) -> bool:
    """Whether the boxes around two lines touch."""
    return bool((of.min(axis=0) <= xy.max(axis=0) + 1).all() and (of.max(axis=0) >= xy.min(axis=0) - 1).all())


def _paint_along(line: Lane, of: Line2, xy: Line2) -> str:
    """The paint of a line of the labels as the traffic along a divider sees it."""
    text = segment_type(line.marking, line.color, line.double, line.pair)
    if line.pair is not None and (xy[-1] - xy[0]) @ (of[-1] - of[0]) < 0:
        return text.replace(line.pair.upper(), MIRRORED[line.pair].upper())
    return text


def _thing_problems(
    found: PlaceMap, above: SourceSample, truth: SourceSample, global_from_cam: Matrix4
) -> Iterator[str]:
    """Findings where symbols, signals or the pavement below lanes are not in the map."""
    layers = found.layers
    for word, rows, kinds in (
        ("pedestrian crossing", layers.ped_crossing, ("crosswalk",)),
        ("stop line", layers.stop_line, ("stop_line", "give_way_line")),
    ):
        outlines = [np.array(found.polygons[row.polygon_token].exterior.coords)[:-1] for row in rows]
        yield from symbol_problems(word, [*map(_in_plane, outlines)], above, kinds, RULE.limit, is_whole=False)
    lights = np.array([(row.pose.tx, row.pose.ty, row.pose.tz) for row in layers.traffic_light]).reshape(-1, 3)
    for item in truth.labels.traffic_elements or ():
        if item.category in ELEMENTS:
            (place,) = transform(global_from_cam, item.center_cam[None])
            off_m = float(np.linalg.norm(lights - place, axis=1).min(initial=np.inf))
            if not off_m <= RULE.limit:
                yield f"expected a traffic light at that of the labels, got none nearer than {off_m:.3g} m"
    names = [name for row in layers.drivable_area for name in row.polygon_tokens]
    yield from area_problems(shapely.buffer(shapely.union_all([found.polygons[at] for at in names]), RULE.limit), above)
