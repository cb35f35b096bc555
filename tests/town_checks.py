"""An own reading of maps, by summing small steps, and what must hold in every town, told as lines of problems; written
without the sampler's code."""

from collections.abc import Iterator
from functools import cache
from itertools import combinations

import numpy as np
import shapely

from synth3dlanes.scene.assets.catalogue import THINGS
from synth3dlanes.scene.road_map import MapLane, MapRoad, PlanPiece, Polynomial, RoadMap
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.traffic_elements import TrafficSignal
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.world.world import World

STEPS = 150


def _piece(piece: PlanPiece) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stations, points and headings of a piece at its ends and between, by the midpoint rule."""
    if piece.u is None or piece.v is None:
        s = np.linspace(0, piece.length_m, STEPS + 1)
        middles = (s[1:] + s[:-1]) / 2
        by = (piece.curvature_end - piece.curvature) / piece.length_m

        def heading(at: np.ndarray) -> np.ndarray:
            return np.asarray(piece.heading_rad + piece.curvature * at + by * at**2 / 2)

        turns = np.stack([np.cos(heading(middles)), np.sin(heading(middles))], -1) * np.diff(s)[:, None]
        points = np.array([piece.x_m, piece.y_m]) + np.concatenate([np.zeros((1, 2)), np.cumsum(turns, axis=0)])
        return s, points, heading(s)
    p = np.linspace(0, piece.parameter_end, STEPS + 1)
    u, v = (np.polynomial.Polynomial(c) for c in (piece.u, piece.v))
    cos, sin = np.cos(piece.heading_rad), np.sin(piece.heading_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    points = np.array([piece.x_m, piece.y_m]) + np.stack([u(p), v(p)], -1) @ turn.T
    along = np.stack([u.deriv()(p), v.deriv()(p)], -1) @ turn.T
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return s, points, np.unwrap(np.arctan2(along[:, 1], along[:, 0]))


def values(polynomials: tuple[Polynomial, ...], s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes of cubics at stations; 0 without polynomials."""
    value, slope = np.zeros_like(s), np.zeros_like(s)
    for at in polynomials:
        x = s - at.s_m
        here = x >= -1e-9
        value = np.where(here, at.a + x * (at.b + x * (at.c + x * at.d)), value)
        slope = np.where(here, at.b + x * (2 * at.c + x * 3 * at.d), slope)
    return value, slope


class MapReader:
    """Lanes of a map by name: points of the middle, headings as traffic drives, and width."""

    def __init__(self, road_map: RoadMap) -> None:
        self.roads = {road.id: road for road in road_map.roads}
        self.lines = {road.id: self._line(road) for road in road_map.roads}

    @staticmethod
    def _line(road: MapRoad) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s, points, headings, start = [], [], [], 0.0
        for piece in road.plan:
            own, xy, heading = _piece(piece)
            own = own * piece.length_m / own[-1]
            s.append(start + own)
            points.append(xy)
            headings.append(heading)
            start += piece.length_m
        turns = np.unwrap(np.concatenate(headings))
        return np.concatenate(s), np.concatenate(points), turns

    @cache  # noqa: B019
    def lane(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points, headings and widths along a lane's middle, as its traffic drives."""
        road_id, section, number_text = name.rsplit(".", 2)
        road, i, number = self.roads[road_id], int(section), int(number_text)
        start = road.sections[i].s_m
        end = road.sections[i + 1].s_m if i + 1 < len(road.sections) else road.length_m
        s_all, xy_all, h_all = self.lines[road_id]
        s = np.unique(np.concatenate([[start, end], s_all[(s_all > start) & (s_all < end)]]))
        xy = np.stack([np.interp(s, s_all, xy_all[:, k]) for k in (0, 1)], -1)
        heading = np.interp(s, s_all, h_all)
        inside = np.minimum(s, end - 1e-7)
        t, slope = values(road.lane_offsets, inside)
        sign = 1 if number > 0 else -1
        lanes: dict[int, MapLane] = {lane.number: lane for lane in road.sections[i].lanes}
        width = np.zeros_like(s)
        for k in range(1, abs(number) + 1):
            width, its_slope = values(lanes[sign * k].widths, inside - start)
            half = 0.5 if k == abs(number) else 1.0
            t, slope = t + sign * half * width, slope + sign * half * its_slope
        left = np.stack([-np.sin(heading), np.cos(heading)], -1)
        points = xy + t[:, None] * left
        headings = heading + np.arctan(slope)
        if number > 0:
            return points[::-1], headings[::-1] + np.pi, width[::-1]
        return points, headings, width


def off(a: float, b: float) -> float:
    """The angle between two headings."""
    return float(abs((a - b + np.pi) % (2 * np.pi) - np.pi))


APART_M, TURNED_RAD, LEAST_RADIUS_M, SIDEWAYS = 0.01, np.radians(0.1), 4.0, 3.0
# Width and length.
HOST_M = 2.0, 5.0


def map_problems(roads: RoadMap) -> Iterator[str]:
    """Lanes that do not go on, turns without room, lanes off the pavement of their junction, yielding in a circle."""
    reader = MapReader(roads)
    for a, b in roads.links:
        (end, heading, width), (start, other, its) = reader.lane(a), reader.lane(b)
        apart_m, turned = float(np.linalg.norm(end[-1] - start[0])), off(heading[-1], other[0])
        if apart_m > APART_M or turned > TURNED_RAD or abs(width[-1] - its[0]) > APART_M:
            yield f"{a} to {b}: {apart_m:.4f} m, {np.degrees(turned):.3f} degrees, widths {width[-1]:.3f}, {its[0]:.3f}"
    outlines = {at.id: shapely.Polygon(at.outline).buffer(0.06) for at in roads.junctions}
    for road in roads.roads:
        if road.junction is None or f"{road.id}.0.-1" not in roads.driving_lanes:
            continue
        points, headings, width = reader.lane(f"{road.id}.0.-1")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        fine = steps > 1e-6
        bend = float((np.abs(np.diff(headings))[fine] / steps[fine]).max())
        if bend > 1 / LEAST_RADIUS_M:
            yield f"{road.id}: radius {1 / bend:.2f} m"
        left = np.stack([-np.sin(headings), np.cos(headings)], -1) * width[:, None] / 2
        strip = shapely.Polygon(np.concatenate([points + left, (points - left)[::-1]])).buffer(0)
        beyond = strip.difference(outlines[road.junction]).area
        if beyond > 0.15:
            yield f"{road.id}: {beyond:.2f} m2 off the pavement of {road.junction}"
    for at in roads.junctions:
        if not shapely.Polygon(at.outline).is_valid or not shapely.Polygon(at.outline).exterior.is_ccw:
            yield f"{at.id}: outline crosses itself or is clockwise"
        both = {pair for pair in at.yields if pair[::-1] in at.yields}
        yield from (f"{at.id}: {a} and {b} yield to each other" for a, b in both)


def order_problems(scene: Scene) -> Iterator[str]:
    """Ways through a junction that meet without an order between them, or with two; lights that are green together
    do not keep them apart."""
    roads = scene.map
    assert roads is not None
    reader = MapReader(roads)
    before: dict[str, set[str]] = {}
    after: dict[str, set[str]] = {}
    for a, b in roads.links:
        before.setdefault(b, set()).add(a)
        after.setdefault(a, set()).add(b)
    green = {lane: _green(signal) for signal in scene.roadside.signals for lane in signal.lanes}
    for at in roads.junctions:
        inside = [f"{road.id}.0.-1" for road in roads.roads if road.junction == at.id]
        ways = {name: shapely.LineString(reader.lane(name)[0]) for name in inside if name in roads.driving_lanes}
        for one, other in combinations(ways, 2):
            follow = other in after[one] or one in after[other] or before[one] & before[other]
            if follow or not (ways[one].crosses(ways[other]) or after[one] & after[other]):
                continue
            lights = [next((green[lane] for lane in before[way] if lane in green), None) for way in (one, other)]
            if lights[0] is not None and lights[1] is not None and not (lights[0] & lights[1]).any():
                continue
            orders = ((one, other) in at.yields) + ((other, one) in at.yields)
            if orders != 1:
                yield f"{at.id}: {one} and {other} meet with {orders} orders"


def _green(signal: TrafficSignal) -> np.ndarray:
    """Whether a signal lets traffic go, every tenth of a second of two minutes."""
    ends = np.cumsum([phase.seconds for phase in signal.phases])
    at = (np.arange(0, 120, 0.1) + signal.shift_s) % ends[-1]
    goes = np.array([phase.state in ("green", "amber") for phase in signal.phases])
    return goes[np.searchsorted(ends, at, side="right")]


def rectangle(pose: Matrix4, width_m: float, length_m: float) -> shapely.Polygon:
    """A body from above."""
    corners = np.array([[x * width_m / 2, y * length_m / 2, 0, 1] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return shapely.Polygon((corners @ pose.T)[:, :2])


def bodies(world: World) -> list[shapely.Polygon]:
    """The host and all cars from above at the instant of a world's shot, by the poses that are rendered."""
    view, scene = world.view, world.scene
    found = [rectangle(view.world_from_host, *HOST_M)]
    for car, pose in zip(scene.cars, view.world_from_cars, strict=True):
        model = scene.assets.car_models[car.model - 1]
        found.append(rectangle(pose, model.width_m * car.scale, model.length_m * car.scale))
    return found


def thing_bodies(world: World) -> list[shapely.Polygon]:
    """The boxes of all things from above, by the poses that are rendered."""
    found = []
    for thing, pose in zip(world.scene.things, world.view.world_from_things, strict=True):
        model = THINGS[thing.kind][thing.model - 1]
        found.append(rectangle(pose, model.width_m * thing.scale, model.length_m * thing.scale))
    return found


def houses(scene: Scene) -> list[shapely.Polygon]:
    """Walls of buildings from above."""
    found = []
    for at in scene.roadside.buildings:
        x, y, cos, sin = at.width_m / 2, at.length_m / 2, np.cos(at.yaw_rad), np.sin(at.yaw_rad)
        places = [(a * x, b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        found.append(shapely.Polygon([(at.x_m + cos * u - sin * v, at.y_m + sin * u + cos * v) for u, v in places]))
    return found


def touching(polygons: list[shapely.Polygon]) -> list[tuple[int, int]]:
    """Pairs of bodies that touch, by their places in the list."""
    if len(polygons) < 2:
        return []
    tree = shapely.STRtree(polygons)
    pairs = tree.query(polygons, predicate="intersects").T.tolist()
    return [(i, j) for i, j in pairs if i < j]


def crosswalk_problems(world: World) -> Iterator[str]:
    """Bars of crosswalks that are not along the lane that they are on."""
    roads = world.scene.map
    assert roads is not None
    reader, of_streets = MapReader(roads), {road.id for road in roads.roads if road.junction is None}
    lanes = [reader.lane(name) for name in roads.driving_lanes if name.split(".")[0] in of_streets]
    points, headings = (np.concatenate([lane[i] for lane in lanes]) for i in (0, 1))
    for form in world.symbol_shapes:
        for bar in form.polygons if form.kind == "crosswalk" else ():
            corners = form.points_world(bar)[:, :2]
            longest = max(np.roll(corners, -1, axis=0) - corners, key=lambda side: float(np.hypot(*side)))
            heading = headings[np.argmin(np.hypot(*(points - corners.mean(axis=0)).T))]
            turned = abs(np.sin(np.arctan2(longest[1], longest[0]) - heading))
            if turned > np.sin(np.radians(5)):
                off_deg = np.degrees(np.arcsin(turned))
                yield f"a bar at {corners.mean(axis=0).round(1)} is {off_deg:.0f} degrees off its lane"


def standing_problems(world: World) -> Iterator[str]:
    """Bodies in each other or in buildings, buildings on the pavement or in each other; bars across their lane."""
    yield from crosswalk_problems(world)
    cars = bodies(world)
    yield from (f"bodies {i} and {j} touch" for i, j in touching(cars))
    walls = houses(world.scene)
    yield from (f"buildings {i} and {j} touch" for i, j in touching(walls))
    everything = shapely.union_all(walls)
    yield from (f"body {i} is in a building" for i, car in enumerate(cars) if car.intersects(everything))
    if walls:
        paved = shapely.intersection(world.ground.paved.pavement, everything).area  # type: ignore[union-attr]
        if paved > 0.01:
            yield f"buildings on {paved:.2f} m2 of pavement"
