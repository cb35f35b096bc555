"""Paint that bounds no lane: arrows, stop and give-way lines, crosswalks and the hatching of gores. World frame.

Every symbol is a set of polygons in a frame of its own on the road. For arrows and lines across lanes its coordinates
are metres to the right and metres ahead of the symbol's middle, as the host or the lane's traffic drives; for a map's
crosswalk metres along its first side and towards the third one. For a gore they are the share of the way from the line
of one road (0) to that of the road that parts from it (1), and the station.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.road_map import MapPaint
from synth3dlanes.scene.scene import Scene, Symbol
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.system.schema import SymbolKind
from synth3dlanes.world.camera import Sector
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.meshes import Mesh, facing_up
from synth3dlanes.world.paint import NO_PAINT, towards_eye

Polygon = Float[np.ndarray, "_ 2"]

# Arrows of 5 m, as painted where traffic is slow: all of them are stretched along the road.
STRAIGHT = np.array(
    [(-0.08, -2.5), (0.08, -2.5), (0.08, 0.6), (0.38, 0.6), (0, 2.5), (-0.38, 0.6), (-0.08, 0.6)]
)  # fmt: skip
RIGHT = np.array([
    (-0.43, -2.5), (-0.27, -2.5), (-0.27, 0.35), (-0.08, 0.75), (0.18, 0.85), (0.18, 0.1), (0.85, 1.3), (0.18, 2.5),
    (0.18, 1.65), (-0.2, 1.5), (-0.43, 0.9),
])  # fmt: skip
STRAIGHT_RIGHT = np.array([
    (-0.08, -2.5), (0.08, -2.5), (0.08, -1.1), (0.16, -0.8), (0.4, -0.7), (0.4, -1.2), (0.95, -0.4), (0.4, 0.4),
    (0.4, -0.1), (0.08, -0.2), (0.08, 0.95), (0.38, 0.95), (0, 2.5), (-0.38, 0.95), (-0.08, 0.95),
])  # fmt: skip
ARROWS: dict[SymbolKind, Polygon] = {
    "arrow_straight": STRAIGHT,
    "arrow_right": RIGHT,
    "arrow_left": RIGHT * [-1, 1],
    "arrow_straight_right": STRAIGHT_RIGHT,
    "arrow_straight_left": STRAIGHT_RIGHT * [-1, 1],
}
# Extents along the road.
LENGTHS_M: dict[SymbolKind, float] = {**dict.fromkeys(ARROWS, 5.0), "stop_line": 0.5, "crosswalk": 4.0}
# Mean width of a crosswalk's bars and their gaps.
BAR_M = 0.55
# Gap between a line across a lane and its edges. Teeth of a give-way line, their bases towards the junction.
INSET_M, TOOTH_M, TOOTH_GAP_M, TOOTH_LENGTH_M = 0.1, 0.5, 0.3, 0.6
# Chevrons of a gore, along the road: their period and the length of an arm. They begin where the gore is GORE_FROM_M
# wide, and end GORE_GAP_M beside the lines.
CHEVRON_PERIOD_M, CHEVRON_M, GORE_FROM_M, GORE_GAP_M = 3.0, 1.1, 1.2, 0.15
# Without a ramp they end here.
GORE_TO_M = 100.0
# Faces are no larger than this across and along the road, so that they follow it; steps along the outlines of labels.
COLUMN_M, ROW_M, OUTLINE_STEP_M = 0.45, 0.5, 1.0


@dataclass(frozen=True, eq=False)
class SymbolShape:
    """A kind, painted polygons and an outline in a frame of its own, the places of that frame in the world, and
    the size of COLUMN_M in it. Those of a map's crosswalk have no height of their own but that of the ground `under`
    it."""

    kind: SymbolKind
    polygons: list[Polygon]
    outline: Polygon
    places_world: Callable[[Polygon], Float[np.ndarray, "_ 3"]]
    column: float
    under: Ground | None = None

    def points_world(self, places: Polygon) -> Float[np.ndarray, "_ 3"]:
        """World points of places of its frame."""
        return np.concatenate(symbol_points([self], [places]))


def symbol_points(forms: Sequence[SymbolShape], places: Sequence[Polygon]) -> list[Float[np.ndarray, "_ 3"]]:
    """World points of places of each of some symbols on one ground."""
    found = [form.places_world(at) for form, at in zip(forms, places, strict=True)]
    low = {i: form.under for i, form in enumerate(forms) if form.under is not None}
    for ground in list(low.values())[:1]:
        # Faces beside each other share their corners.
        corners = np.concatenate([found[i][:, :2] for i in low])
        _, first, which = np.unique(corners @ [1.0, 1j], return_index=True, return_inverse=True)
        heights = ground.height(corners[first])[which]
        ends = np.cumsum([len(found[i]) for i in low])[:-1]
        for i, z in zip(low, np.split(heights, ends), strict=True):
            found[i][:, 2] = z
    return found


def symbol_items(network: Network, scene: Scene) -> list[Symbol | MapPaint]:
    """All paint of a scene that bounds no lane, in the order of its labels. Paint of a map on lanes that are not near
    is left out."""
    lanes, paint = network.lanes, scene.roads.paint
    near = (at for at in paint if (len(at.outline) == 4 if at.kind == "crosswalk" else at.lane in lanes))
    return [*scene.symbols, *near]


def symbol_shapes(ground: Ground, scene: Scene) -> list[SymbolShape]:
    """The shapes of these."""
    return [shape(ground, item) for item in symbol_items(ground.network, scene)]


def shape(ground: Ground, item: Symbol | MapPaint) -> SymbolShape:
    """The shape of a symbol on its road, or of paint of a map."""
    if isinstance(item, MapPaint) and item.kind == "crosswalk":
        return _between(ground, np.array(item.outline, float))
    if item.kind == "gore" and item.lane is None:
        return _gore(ground, item.s_m)
    if item.kind in ARROWS:
        outline, polygons = ARROWS[item.kind], [ARROWS[item.kind]]
    elif item.lane is None:
        polygons = _crossing(ground, item.kind)
        outline = _rectangle(np.min(polygons, axis=(0, 1)), np.max(polygons, axis=(0, 1)))
    else:
        half_m, is_line = ground.network.lanes[item.lane].width_m / 2 - INSET_M, item.kind != "give_way_line"
        half = np.array([half_m, (LENGTHS_M["stop_line"] if is_line else TOOTH_LENGTH_M) / 2])
        outline = _rectangle(-half, half)
        polygons = [outline] if is_line else _teeth(half_m)
    network, s = ground.network, item.s_m * ground.network.onwards
    path = network.way if item.lane is None else network.path(item.lane)
    places = path.places_from(s if item.lane is None else float(path.stations_on(item.lane, s)))
    return SymbolShape(item.kind, polygons, dense(outline, OUTLINE_STEP_M), places, COLUMN_M)


def symbol_meshes(
    ground: Ground, forms: Sequence[SymbolShape], eye_world: Float[np.ndarray, "3"], seen: Sector | None = None
) -> list[Mesh]:
    """The paint of symbols over the road, moved towards the eye so that it looks in place from there. Meshes of symbols
    out of what is `seen` are empty."""
    meshes, drawn = [NO_PAINT] * len(forms), [*range(len(forms))]
    if seen is not None:
        drawn = [i for i, form in enumerate(forms) if seen.holds(form.places_world(form.outline)[:, :2]).any()]
    if not drawn:
        return meshes
    shown = [forms[i] for i in drawn]
    places = [_quads(np.stack(form.polygons), form.column).reshape(-1, 2) for form in shown]
    vertices = towards_eye(ground, np.concatenate(symbol_points(shown, places)), eye_world)
    parts = np.split(vertices, np.cumsum(list(map(len, places)))[:-1])
    for i, own, uv in zip(drawn, parts, places, strict=True):
        meshes[i] = facing_up(own, uv)
    return meshes


def gore_of(network: Network) -> tuple[Road, float, float] | None:
    """A road that parts from another, and the stations between which there is room for hatching before it rises; None
    without such a gore."""
    for road in network.roads:
        if road.parting is not None:
            s = np.arange(road.start_m, road.ramp.start_m if road.ramp else GORE_TO_M, 0.5)
            wide = s[road.parting.gap_m(s) > GORE_FROM_M]
            if len(wide) > 2 * CHEVRON_PERIOD_M / 0.5:
                return road, float(wide[0]), float(wide[-1])
    return None


def _crossing(ground: Ground, kind: SymbolKind) -> list[Polygon]:
    """The rectangles of a stop line, which ends at the oncoming lanes, or of a crosswalk, lane by lane, clear of the
    lines between the lanes."""
    road, markings, half_m = ground.network.main, ground.markings, LENGTHS_M[kind] / 2
    width_m, to_right = road.lane_width_m, ground.network.rightward
    bars, inset = 1, 0.0
    if kind == "crosswalk":
        bars, inset = max(1, round(width_m / (2 * BAR_M))), 0.25
    lefts = [
        part.left_m + lane * width_m
        for part in sorted(road.carriageways, key=lambda part: part.direction == "oncoming")
        if kind == "crosswalk" or part.direction == "same"
        for lane in range(part.n_lanes)
    ]
    begun = [line for line in ground.network.delimiters if line.pieces[0].road is road and line.start_m == road.start_m]
    doubles = [line.pieces[0].offset.base_m for line in begun if line.is_inner]
    lines = np.array(lefts)[:, None] + [0.0, width_m]
    is_double = np.isclose(lines[..., None], doubles).any(axis=-1) & markings.left_double
    inner = lines + np.where(is_double, 1.5, 0.5) * markings.width_m * [1, -1]
    shares = (np.arange(bars)[:, None] + [inset, 1 - inset]) / bars
    sides = inner[:, :1, None] + (inner[:, 1:, None] - inner[:, :1, None]) * shares
    rights = np.sort(to_right * sides.reshape(-1, 2), axis=1)
    return [np.array([[a, -half_m], [b, -half_m], [b, half_m], [a, half_m]]) for a, b in rights]


def _rectangle(low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> Polygon:
    (x0, y0), (x1, y1) = low, high
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _teeth(half_m: float) -> list[Polygon]:
    """The triangles of a give-way line across a lane."""
    n = max(int((2 * half_m + TOOTH_GAP_M) / (TOOTH_M + TOOTH_GAP_M)), 1)
    middles = (np.arange(n) - (n - 1) / 2) * (TOOTH_M + TOOTH_GAP_M)
    tooth = np.array([[0.0, -TOOTH_LENGTH_M], [TOOTH_M, TOOTH_LENGTH_M], [-TOOTH_M, TOOTH_LENGTH_M]]) / 2
    return [tooth + np.array([x, 0.0]) for x in middles]


def _between(ground: Ground, corners: Float[np.ndarray, "4 2"]) -> SymbolShape:
    """The bars of a crosswalk from its first side to the third one: metres along the first side and towards the third
    one."""
    a, b, c, d = corners
    length_m, depth_m = float(np.hypot(*(b - a))), float(np.hypot(*(d - a)))

    def places_world(places: Polygon) -> Float[np.ndarray, "_ 3"]:
        u, v = (places / [length_m, depth_m]).T[..., None]
        xy = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
        return np.column_stack([xy, np.zeros(len(xy))])

    n = max(round(length_m / (2 * BAR_M)), 1)
    bars = (np.arange(n)[:, None] + [0.25, 0.75]) * length_m / n
    polygons = [_rectangle(np.array([x0, 0.0]), np.array([x1, depth_m])) for x0, x1 in bars]
    outline = _rectangle(np.zeros(2), np.array([length_m, depth_m]))
    return SymbolShape("crosswalk", polygons, dense(outline, OUTLINE_STEP_M), places_world, COLUMN_M, ground)


def _gore(ground: Ground, s_m: float) -> SymbolShape:
    """Chevrons that point to where the roads part."""
    network = ground.network
    start_m = float(s_m * network.onwards)
    gore = gore_of(network)
    end_m = gore[2] if gore else start_m
    branch = gore[0] if gore else network.roads[-1]
    parting = branch.parting
    assert parting is not None, "a scene with a gore has a road that parts"
    s = np.arange(start_m, max(end_m, start_m + 1.0), OUTLINE_STEP_M)
    middles = [float(lane.middle(s[:1])[0]) for lane in parting.road.lanes_at(start_m)]
    at_m = max(middles) + parting.road.lane_width_m / 2

    def width_m(s: Scalars) -> Scalars:
        return np.maximum(parting.gap_m(s), 0.01)

    def points_world(places: Polygon) -> Float[np.ndarray, "_ 3"]:
        share, s = places.T
        main = parting.road.xy(s, at_m)
        return network.lift(main + share[:, None] * (branch.xy(s, branch.carriageways[0].left_m) - main))

    apex = np.arange(start_m, end_m, CHEVRON_PERIOD_M)
    inset = np.minimum((ground.markings.width_m / 2 + GORE_GAP_M) / width_m(apex), 0.45)
    reach_m = (0.5 - inset) * width_m(apex)
    fits = apex + reach_m + CHEVRON_M < end_m
    polygons = [
        np.array([[0.5, a], [side, a + r], [side, a + r + CHEVRON_M], [0.5, a + CHEVRON_M]])
        for a, i, r in zip(apex[fits], inset[fits], reach_m[fits], strict=True)
        for side in (i, 1 - i)
    ]
    outline = np.concatenate([np.column_stack([0 * s, s]), np.column_stack([0 * s + 1, s])[::-1]])
    return SymbolShape("gore", polygons, outline, points_world, COLUMN_M / float(width_m(s).max()))


def _quads(polygons: Float[np.ndarray, "p n 2"], column: float) -> Float[np.ndarray, "k 4 2"]:
    """Polygons as quads whose front and back are level in the second coordinate, no wider than `column` and no longer
    than ROW_M."""
    y, to = polygons[..., 1], np.roll(polygons, -1, axis=1)
    breaks = [np.unique(np.concatenate([own, np.arange(own.min(), own.max(), ROW_M)])) for own in y]
    ends = np.concatenate([np.stack([own[:-1], own[1:]], axis=1) for own in breaks])
    of = np.repeat(np.arange(len(polygons)), [len(own) - 1 for own in breaks])
    # The sides that cross each row, from the left.
    low, high = (end(y, to[..., 1])[of] for end in (np.minimum, np.maximum))
    row, side = np.nonzero((low <= ends[:, :1]) & (high >= ends[:, 1:]))
    start, step = (values[of[row], side] for values in (polygons, to - polygons))
    at = start[:, :1] + step[:, :1] * ((ends[row] - start[:, 1:]) / step[:, 1:])
    at = at[np.lexsort((at.sum(axis=1), row))]
    left, wide = at[::2], at[1::2] - at[::2]
    n = np.maximum(np.ceil(wide.max(axis=1) / column), 1).astype(int)
    quad = np.repeat(np.arange(len(n)), n)
    number = np.arange(len(quad)) - np.repeat(np.cumsum(n) - n, n)
    x0, x1 = (left[quad] + wide[quad] * ((number + i) / n[quad])[:, None] for i in (0, 1))
    corners = np.stack([x0[:, 0], x1[:, 0], x1[:, 1], x0[:, 1]], axis=1)
    return np.stack([corners, ends[row[::2]][quad][:, [0, 0, 1, 1]]], axis=-1)


def dense(polygon: Polygon, step: float) -> Polygon:
    """A closed polygon with further points on its longer sides."""
    sides = zip(polygon, np.roll(polygon, -1, axis=0), strict=True)
    return np.concatenate(
        [a + (b - a) * (np.arange(n := max(1, int(np.ceil(np.hypot(*(b - a)) / step)))) / n)[:, None] for a, b in sides]
    )
