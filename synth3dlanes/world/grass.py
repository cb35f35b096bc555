"""Grass beside the pavement near the host: tufts of blades that hide no point of a lane. World frame, metres.

Far away the terrain's texture is enough. Tufts stand on the verge, up to where its texture begins to look like depth.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from synth3dlanes.roads.roads import SIDES
from synth3dlanes.system.arrays import Points3, Scalars
from synth3dlanes.world.ground import Ground

TuftsAndPoints = Integer[np.ndarray, " pairs"]

# Tufts along every edge of the pavement: how many, how far ahead of the host, and how far beside the edge. There are
# two edges of the roads of the host's way, and two of their branches.
PER_EDGE, AHEAD_M, BESIDE_M = 1200, (2.0, 45.0), (0.25, 3.6)
N_EDGES = 4
# More of them for each metre that the host drives.
PER_M = 40
# Grass is mown next to the road: its height grows from the share SHARE_AT_EDGE at the edge to all of it at FULL_AT_M.
SHARE_AT_EDGE, FULL_AT_M = 0.35, 1.5
# A tuft: its blades, the radius of their feet, their lean over their height, their width over their height.
BLADES, RADIUS_M, LEAN, WIDTH = 9, 0.14, 0.7, 0.12
SINK_M = 0.04
# Lines of sight to points of lanes, every SIGHT_STEP_M up to RANGE_M, pass tufts by ROOM_M and by ROOM_SHARE of the
# distance, which is more than a pixel.
SIGHT_STEP_M, RANGE_M, ROOM_M, ROOM_SHARE = 1.0, 115.0, 0.1, 0.004


@dataclass(frozen=True, eq=False)
class Blades:
    """Triangles: two corners at the foot and a tip, with a shade and a dryness for each blade, both 0 to 1."""

    corners_world: Float[np.ndarray, "n 3 3"]
    shade: Scalars
    dryness: Scalars


def blades(ground: Ground, eye_world: Float[np.ndarray, "3"], grass_m: float, rng: np.random.Generator) -> Blades:
    """The blades of grass of `grass_m` height that a camera at `eye_world` sees beside the road."""
    feet, height_m = _tufts(ground, grass_m, rng)
    points = lane_points(ground)
    free = ~_in_sight(feet, height_m, eye_world, points)
    return _grown(feet[free], height_m[free], rng)


def lane_points(ground: Ground) -> Points3:
    """Points of all lane curves around the host, spaced as those of the labels, up to RANGE_M."""
    network, driven_m = ground.network, np.arange(*ground.way.range_m(RANGE_M, -SIGHT_STEP_M), SIGHT_STEP_M)
    stations = network.lines.around(driven_m, lambda xy_world: ground.way.away_at(xy_world) < RANGE_M)
    return np.concatenate([*network.points_along(stations), np.zeros((0, 3))])


def _tufts(ground: Ground, grass_m: float, rng: np.random.Generator) -> tuple[Points3, Scalars]:
    """Feet and heights of tufts along the edges of the pavement; the nearer to the host, the denser."""
    network, last_m = ground.network, ground.way.near_m + ground.way.driven_m
    draws = rng.random((4, N_EDGES, PER_EDGE))
    driven_m = last_m + _away(draws[0])
    if ground.way.driven_m:
        more = rng.random((4, N_EDGES, int(PER_M * ground.way.driven_m)))
        draws = np.concatenate([draws, more], axis=2)
        driven_m = np.concatenate([driven_m, ground.way.near_m + AHEAD_M[0] + ground.way.driven_m * more[0]], axis=1)
    if ground.way.both_ways:
        more = rng.random((4, N_EDGES, PER_EDGE))
        draws = np.concatenate([draws, more], axis=2)
        driven_m = np.concatenate([driven_m, ground.way.near_m - _away(more[0])], axis=1)
    beside = BESIDE_M[0] + (BESIDE_M[1] - BESIDE_M[0]) * draws[1]
    s, xy = network.stations(driven_m), [np.zeros((0, 2))]
    for edge, (own_s, own_m) in enumerate(zip(s, beside, strict=True)):
        is_aside, side = edge // len(SIDES), SIDES[edge % len(SIDES)]
        for at, piece in network.way.parts_at(own_s):
            for road in network.branches(piece.road) if is_aside else (piece.road,):
                on = piece.on(own_s[at])
                here = (on >= road.start_m) & (on <= road.end_m) & network.way.has(own_s[at])
                xy.append(road.xy(on[here], road.edge(side, on[here], own_m[at][here])))
    places = np.concatenate(xy)
    from_edge_m = ground.clearance(places)
    kept = (from_edge_m > BESIDE_M[0]) & (from_edge_m < BESIDE_M[1])
    places, from_edge_m = places[kept], from_edge_m[kept]
    height_m = grass_m * np.clip(SHARE_AT_EDGE + (1 - SHARE_AT_EDGE) * from_edge_m / FULL_AT_M, 0, 1)
    height_m *= 0.6 + 0.4 * draws[2].ravel()[: len(places)]
    return np.column_stack([places, ground.height(places) - SINK_M]), height_m


def _away(draws: Float[np.ndarray, "e n"]) -> Float[np.ndarray, "e n"]:
    """Distances from the host, from random numbers."""
    return np.asarray(AHEAD_M[0] * (AHEAD_M[1] / AHEAD_M[0]) ** draws)


def _in_sight(
    feet: Points3, height_m: Scalars, eye_world: Float[np.ndarray, "3"], points_world: Float[np.ndarray, "p 3"]
) -> Bool[np.ndarray, " n"]:
    """Which tufts reach into a line of sight from the eye to a point."""
    to_feet, to_points = feet - eye_world, points_world - eye_world
    to_points = to_points[np.argsort(np.arctan2(to_points[:, 1], to_points[:, 0]))]
    distance_m, reach_m = (np.hypot(way[:, 0], way[:, 1]) for way in (to_feet, to_points))
    room_m = ROOM_M + ROOM_SHARE * np.linalg.norm(to_feet, axis=1)
    radius_m = RADIUS_M + LEAN * height_m + room_m
    tuft, point = _about_one_way(to_feet, distance_m / radius_m, to_points)
    along = to_points[point, :2] / reach_m[point, None]
    at_m = (to_feet[tuft, :2] * along).sum(axis=1)
    beside_m = np.abs(to_feet[tuft, 1] * along[:, 0] - to_feet[tuft, 0] * along[:, 1])
    last_m = np.minimum(at_m + radius_m[tuft], reach_m[point])
    first_m = at_m - radius_m[tuft]
    slope = to_points[point, 2] / reach_m[point]
    top_z = to_feet[:, 2] + height_m + room_m
    is_low = np.minimum(slope * first_m, slope * last_m) < top_z[tuft]
    meets = (beside_m < radius_m[tuft]) & (first_m < reach_m[point]) & (last_m > 0) & is_low
    hidden = np.zeros(len(feet), dtype=bool)
    hidden[tuft[meets]] = True
    return hidden


def _about_one_way(
    to_feet: Points3, away: Scalars, to_points: Float[np.ndarray, "p 3"]
) -> tuple[TuftsAndPoints, TuftsAndPoints]:
    """The pairs of a tuft and a point, these in the order of their directions, that a tuft `away` times its radius from
    the eye may stand between; all points for the nearest."""
    half = np.where(away > 2, np.arcsin(np.minimum(1 / away, 0.5)), np.pi)
    toward, angles = (np.arctan2(way[:, 1], way[:, 0]) for way in (to_feet, to_points))
    turns = np.concatenate([angles - 2 * np.pi, angles, angles + 2 * np.pi])
    first, last = (np.searchsorted(turns, towards) for towards in (toward - half, toward + half))
    n = last - first
    point = np.arange(n.sum()) + np.repeat(first - np.cumsum(n) + n, n)
    return np.repeat(np.arange(len(to_feet)), n), point % max(1, len(to_points))


def _grown(feet: Points3, height_m: Scalars, rng: np.random.Generator) -> Blades:
    """BLADES blades for each tuft, which lean to all sides."""
    n = len(feet) * BLADES
    around, lean, size = 2 * np.pi * rng.random(n), LEAN * rng.random(n), 0.3 + 0.7 * rng.random(n) ** 1.5
    length_m = np.repeat(height_m, BLADES) * size
    out = np.stack([np.cos(around), np.sin(around), np.zeros(n)], axis=1)
    foot = np.repeat(feet, BLADES, axis=0) + RADIUS_M * np.sqrt(rng.random((n, 1))) * out
    turn = 2 * np.pi * rng.random(n)
    side = np.stack([np.cos(turn), np.sin(turn), np.zeros(n)], axis=1) * (WIDTH / 2 * length_m + 0.006)[:, None]
    tip = foot + length_m[:, None] * (lean[:, None] * out + [0, 0, 1.0]) + [0, 0, SINK_M]
    dryness = np.repeat(rng.random(len(feet)), BLADES) * rng.random(n)
    return Blades(np.stack([foot - side, foot + side, tip], axis=1), rng.random(n), dryness)
