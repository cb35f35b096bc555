"""The paint of a map that bounds no lane: arrows, stop and give-way lines across lanes, crosswalks. World frame."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.map_network import MapNetwork
from synth3dlanes.scene.road_map import MapPaint
from synth3dlanes.world.map_ground import MapGround
from synth3dlanes.world.symbols import (
    ARROWS,
    BAR_M,
    COLUMN_M,
    LENGTHS_M,
    OUTLINE_STEP_M,
    Polygon,
    SymbolShape,
    dense,
)

# A line across a lane ends this far from its edges. Teeth of a give-way line, their bases towards the junction.
INSET_M, TOOTH_M, TOOTH_GAP_M, TOOTH_LENGTH_M = 0.1, 0.5, 0.3, 0.6


def map_symbols(ground: MapGround, paint: Sequence[MapPaint]) -> list[SymbolShape]:
    """The shapes of a map's paint on the lanes that its network has, in the map's order."""
    found, network = [], ground.network
    for item in paint:
        if item.kind == "crosswalk":
            if len(item.outline) == 4:
                found.append(_crosswalk(ground, np.array(item.outline, float)))
        elif item.lane in network.lanes:
            found.append(_in_lane(network, item, item.lane))
    return found


def _in_lane(network: MapNetwork, item: MapPaint, lane: str) -> SymbolShape:
    """An arrow or a line across a lane: metres right and ahead of its place there."""
    way = network.way_through([network.lanes[lane]])
    at_m = way.pieces[0].station(item.s_m)
    half_m = network.lanes[lane].width_m / 2 - INSET_M

    def points_world(places: Polygon) -> Float[np.ndarray, "_ 3"]:
        return way.points_beside(np.clip(at_m + places[:, 1], 0.0, way.end_m), places[:, 0])

    if item.kind in ARROWS:
        polygons = [ARROWS[item.kind]]
        outline = polygons[0]
    elif item.kind == "give_way_line":
        polygons = _teeth(half_m)
        outline = _rectangle(half_m, TOOTH_LENGTH_M)
    else:
        outline = _rectangle(half_m, LENGTHS_M["stop_line"])
        polygons = [outline]
    return SymbolShape(item.kind, polygons, dense(outline, OUTLINE_STEP_M), points_world, COLUMN_M)


def _rectangle(half_m: float, length_m: float) -> Polygon:
    half = np.array([half_m, length_m / 2])
    return np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half


def _teeth(half_m: float) -> list[Polygon]:
    n = max(int((2 * half_m + TOOTH_GAP_M) / (TOOTH_M + TOOTH_GAP_M)), 1)
    middles = (np.arange(n) - (n - 1) / 2) * (TOOTH_M + TOOTH_GAP_M)
    tooth = np.array([[0.0, -TOOTH_LENGTH_M], [TOOTH_M, TOOTH_LENGTH_M], [-TOOTH_M, TOOTH_LENGTH_M]]) / 2
    return [tooth + np.array([x, 0.0]) for x in middles]


def _crosswalk(ground: MapGround, corners: Float[np.ndarray, "4 2"]) -> SymbolShape:
    """Bars from the first side to the third one: metres along the first side and towards the third one."""
    a, b, c, d = corners
    length_m, depth_m = float(np.hypot(*(b - a))), float(np.hypot(*(d - a)))

    def points_world(places: Polygon) -> Float[np.ndarray, "_ 3"]:
        u, v = (places / [length_m, depth_m]).T[..., None]
        xy = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
        return np.column_stack([xy, ground.height(xy)])

    n = max(round(length_m / (2 * BAR_M)), 1)
    bars = (np.arange(n)[:, None] + [0.25, 0.75]) * length_m / n
    polygons = [np.array([[x0, 0.0], [x1, 0.0], [x1, depth_m], [x0, depth_m]]) for x0, x1 in bars]
    outline = np.array([[0.0, 0.0], [length_m, 0.0], [length_m, depth_m], [0.0, depth_m]])
    return SymbolShape("crosswalk", polygons, dense(outline, OUTLINE_STEP_M), points_world, COLUMN_M)
