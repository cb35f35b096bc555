"""The scene's paint along delimiters: which points are painted, its width and direction, in the camera's frame; and
where points are, seen from above, beside the lines of a world. Metres.

Points are projected to their station on the road, so that a line whose label is offset from its paint is still judged
where the paint has dashes.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float
from shapely.geometry.base import BaseGeometry

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import CameraLabel, Lane, Marking, PaintColor
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.scene.assets.catalogue import ROAD_MEANS
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Points2, Points3, Scalars
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.paint import DOTS_M, is_dotted, line_width_m, painted_rows, stripes
from synth3dlanes.world.symbols import dense
from synth3dlanes.world.world import World

# Two roads whose heights differ by more than APART_M at a point on both, or up to EDGE_M beside one, are two surfaces.
APART_M, EDGE_M = 0.01, 0.3
# How far from a point roads are searched for.
SEARCH_M = 0.5
# Points farther than this beside a curve are not near it.
BESIDE_M = 30.0
# Paint narrower, or a dash lower in the image, than this may fall between the pixels' single samples.
RESOLVED_PX = 1.0
# Paint may appear up to this far beyond its end along the line, because it floats over the road.
END_M = 0.06

# The length over which sides of symbols are straight from above, and the distance from a symbol up to which points are
# compared with it.
SIDE_M, NEAR_M = 0.5, 1.0

Stretches = Float[np.ndarray, "m 2"]


def beside(curve: LaneCurve, xy_world: Points2) -> tuple[Scalars, Scalars]:
    """Stations of points along a curve, of the piece to which each is nearest, and distances beside it, as t grows, or
    to the right of one that is measured; infinite where it is not near."""
    station, right = np.zeros(len(xy_world)), np.full(len(xy_world), np.inf)
    best = np.full(len(xy_world), BESIDE_M)
    for piece in curve.pieces:
        low, high = np.sort(piece.on(np.array([piece.start_m, piece.end_m])))
        s, t = piece.road.line.project(xy_world)
        on = np.clip(s, low, high)
        aside = (t - piece.offset(on)) * piece.along
        apart = np.hypot(aside, s - on)
        nearer = apart < best
        station = np.where(nearer, piece.stations(on), station)
        right, best = np.where(nearer, aside, right), np.where(nearer, apart, best)
    return station, right


def is_single(ground: Ground, xy_world: Points2) -> Bool[np.ndarray, " n"]:
    """Which points are not where roads lie over each other, as bridges, or as ways through a junction, each by heights
    of its own."""
    if not any(road.has_heights for road in ground.network.roads):
        return np.ones(len(xy_world), dtype=bool)
    low, high = np.full((2, len(xy_world)), np.inf) * [[1], [-1]]
    table, at = ground.network.index.table, ground.network.index.places(xy_world, SEARCH_M)
    on, _, away_m = table.nearest(at)
    at = at.of((away_m < EDGE_M) & (on == at.s))
    z = table.base_points(at.road, at.s, at.t)[:, 2]
    np.minimum.at(low, at.point, z)
    np.maximum.at(high, at.point, z)
    return np.asarray((high - low < APART_M) & ~ground.is_stacked(xy_world))


class Strip(NamedTuple):
    """Points along a line, the unit vectors to its right in the surface, the surface normals, and whether all stripes
    are painted at each point, and large enough to appear in single pixels."""

    points_cam: Points3
    across_cam: Points3
    normal_cam: Points3
    resolved: Bool[np.ndarray, " n"]


# Beyond these limits paint may be invisible: rubbed off, as gray as the road, under water or in fog; so it may be under
# snow and behind drops on the glass.
MAX_WORN, MIN_GRAYSCALE, MAX_WETNESS, MIN_VISIBILITY_M = 0.7, 0.35, 0.8, 300.0
# A wetter road than MAX_DRY mirrors the sky: in puddles more than its paint does, and where it is damp as brightly as
# paint that is worn by more than MAX_WORN_DAMP.
MAX_DRY, MAX_WORN_DAMP = 0.3, 0.4
# Least mean brightness of paint that is both gray and worn, and the least ratio of it to the road's.
MIN_LEFT, BRIGHTER = 0.22, 1.6
# The mean of the channels of paint, relative to white.
BRIGHTNESS: dict[PaintColor, float] = {"white": 1.0, "yellow": 0.54}
MAX_DROPS = 0.3
# The slope of a road across a line is measured over this length to both sides.
ACROSS_M = 0.05


def _albedo(scene: Scene) -> float:
    """The mean albedo of the road's texture; 0 for a user's, of which nothing is known here."""
    return 0.0 if scene.assets.roads else float(np.mean(ROAD_MEANS[f"road_{scene.surface.road_texture}"][0]))


class WorldPaint:
    """The paint of a world: painted intervals of plan stations by delimiter id. `shows` is False if the paint may be
    invisible in a correct picture, `is_dry` if some of its lines may be."""

    def __init__(self, world: World) -> None:
        scene = world.scene
        self.world = world
        self.shows = (
            scene.markings.wear <= MAX_WORN
            and scene.markings.grayscale >= MIN_GRAYSCALE
            and scene.markings.grayscale * (1 - scene.markings.wear) >= MIN_LEFT
            and self.stands_out("white")
            and scene.surface.wetness <= MAX_WETNESS
            and scene.air.visibility_m >= MIN_VISIBILITY_M
            and scene.weather.snow_on_road == 0
            and scene.sensor.drops <= MAX_DROPS
        )
        wetness, wear = scene.surface.wetness, scene.markings.wear
        self.is_dry = wetness == 0 or (wetness <= MAX_DRY and wear <= MAX_WORN_DAMP)
        self._lines = {line.id: line for line in world.site.lines}
        self._curves = {id_: line for id_, line in self._lines.items() if line.kind == "delimiter"}
        self._stretches = {}
        for id_, curve in self._curves.items():
            by_marking = {marking: self._of(curve, marking) for _, marking in stripes(curve, scene.markings)}
            self._stretches[id_] = [by_marking[marking] for _, marking in stripes(curve, scene.markings)]

    def _of(self, curve: LaneCurve, marking: Marking) -> Stretches:
        """Where a stripe of this pattern is painted along a line."""
        world, scene = self.world, self.world.scene
        (rows,) = painted_rows(world.ground, [(curve, marking)], scene.stream)
        # Far dots are merged into dashes that are too narrow to be checked.
        painted = rows.painted & ((rows.away_m[1:] < DOTS_M) | (not is_dotted(curve, scene.markings)))
        return _merged(np.column_stack([rows.s[:-1], rows.s[1:]])[painted])

    def stands_out(self, color: PaintColor) -> bool:
        """Whether lines of this colour are brighter than the road."""
        return self.contrast(color) >= BRIGHTER

    def contrast(self, color: PaintColor) -> float:
        """How many times brighter lines of this colour are than the road, in equal light."""
        markings, albedo = self.world.scene.markings, _albedo(self.world.scene)
        return markings.grayscale * BRIGHTNESS[color] * (1 - markings.wear) / albedo if albedo else np.inf

    def strip(self, camera: CameraLabel, lane: Lane, points_cam: Points3) -> Strip:
        """The strip of points along a lane; at least two points, in order."""
        points_world = transform(camera.world_from_cam, points_cam)
        steps = np.gradient(points_cam, axis=0)
        along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        curve, painted_m = self._lines.get(lane.id), np.zeros(len(points_cam))
        # A line that the world does not have lies on level ground.
        across = np.cross(along, camera.world_from_cam[2, :3])
        if curve is not None:
            s, aside = beside(curve, points_world[:, :2])[0], np.full(len(points_cam), ACROSS_M)
            across = curve.points_beside(s, aside) - curve.points_beside(s, -aside)
            across = self.world.network.rightward * across @ camera.world_from_cam[:3, :3]
            painted_m = self._painted_m(lane.id, s) if lane.id in self._curves else painted_m
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        half_m = self.width_m(lane.id) / 2
        left, right, behind, ahead = (
            camera.project(points_cam + step)
            for step in (-half_m * across, half_m * across, -0.01 * along, 0.01 * along)
        )
        side, course = right - left, ahead - behind
        height_px = np.abs(course[:, 1]) / 0.02 * painted_m
        width_px = np.abs(side[:, 0] * course[:, 1] - side[:, 1] * course[:, 0]) / np.hypot(*course.T)
        resolved = (height_px >= RESOLVED_PX) & (width_px >= RESOLVED_PX)
        return Strip(points_cam, across, np.cross(across, along), resolved)

    @property
    def ids(self) -> tuple[str, ...]:
        """The ids of all delimiters, including those beyond the labels' range."""
        return tuple(self._stretches)

    def stripes_m(self, id_: str) -> tuple[float, ...]:
        """Offsets of the stripes' centres to the right of a line."""
        if id_ not in self._curves:
            return (0.0,)
        return tuple(stripe.right_m for stripe in stripes(self._curves[id_], self.world.scene.markings))

    def width_m(self, id_: str) -> float:
        """Width of a line's stripes; of a centre line that of any line."""
        markings = self.world.scene.markings
        return line_width_m(self._curves[id_], markings) if id_ in self._curves else markings.width_m

    def beyond_m(self, id_: str, xy_world: Points2, end_m: float = END_M) -> Scalars:
        """Distance of points on the road outside a line's paint, across it or (reduced by `end_m`) along it; negative
        inside."""
        s, aside_m = beside(self._curves[id_], xy_world)
        right_m = self.world.network.rightward * aside_m
        of_stripes = [
            np.maximum(np.abs(right_m - middle_m) - self.width_m(id_) / 2, _beyond(stretches, s) - end_m)
            for middle_m, stretches in zip(self.stripes_m(id_), self._stretches[id_], strict=True)
        ]
        return np.min(of_stripes, axis=0)

    def _painted_m(self, id_: str, s: Scalars) -> Scalars:
        """Length of the shortest stripe's painted stretch at stations of a line; 0 where not all are painted."""
        return np.min([_length(stretches, s) for stretches in self._stretches[id_]], axis=0)


def _length(stretches: Stretches, s: Scalars) -> Scalars:
    """Length of the stretch that has each station; 0 if none has."""
    if not len(stretches):
        return np.zeros(len(s))
    start, end = stretches[np.clip(np.searchsorted(stretches[:, 0], s, side="right") - 1, 0, None)].T
    return np.where((s >= start) & (s <= end), end - start, 0.0)


def _beyond(stretches: Stretches, s: Scalars) -> Scalars:
    """Distance of stations from the nearest stretch; negative inside."""
    if not len(stretches):
        return np.full(s.shape, np.inf)
    start, end = stretches[np.clip(np.searchsorted(stretches[:, 0], s, side="right") - 1, 0, None)].T
    after = np.append(stretches[:, 0], np.inf)[np.searchsorted(stretches[:, 0], s, side="right")]
    return np.minimum(np.maximum(start - s, s - end), after - s)


def _merged(stretches: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Stretches in order, with adjacent ones merged."""
    ordered = stretches[np.argsort(stretches[:, 0])]
    first = np.append(True, ordered[1:, 0] > ordered[:-1, 1] + 1e-6)[: len(ordered)]
    return np.column_stack([ordered[first, 0], ordered[np.roll(first, -1), 1]])


class Painted(NamedTuple):
    """A line or a symbol: its words, the lane to name, and how far points are outside its paint, seen from above;
    negative inside."""

    whose: str
    lane: str
    beyond_m: Callable[[Points2], Scalars]


def painted_symbols(world: World) -> list[Painted]:
    """The symbols on the road, by their outlines."""
    found = []
    for i, form in enumerate(world.symbol_shapes):
        outlines = [form.places_world(dense(polygon, SIDE_M))[:, :2] for polygon in form.polygons]
        paint = shapely.union_all(shapely.make_valid([shapely.Polygon(outline) for outline in outlines]))
        found.append(Painted(f"symbol {i}", "", partial(_beyond_outline, paint)))
    return found


def _beyond_outline(paint: BaseGeometry, xy_world: Points2) -> Scalars:
    low, high = np.reshape(paint.bounds, (2, 2))
    near = ((xy_world > low - NEAR_M) & (xy_world < high + NEAR_M)).all(axis=1)
    beyond_m = np.full(len(xy_world), np.inf)
    signs = np.where(shapely.intersects_xy(paint, xy_world[near]), -1, 1)
    beyond_m[near] = signs * shapely.distance(paint.boundary, np.asarray(shapely.points(xy_world[near])))
    return beyond_m
