"""Rails along the edges of the pavement: guardrails, barriers, noise walls, kerbs, power lines. World frame, metres."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene.roadside import Rail, RailKind
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.beside import beside, frames_beside, on_ground
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.solids import BLACK, SINK_M, Body, Quads

# Lengths of a rail's pieces: up to these distances ahead of the host, and beyond.
PIECES_M = ((60.0, 2.0), (140.0, 4.0), (np.inf, 8.0))
# Distance between the posts of guardrail and noise wall near the host, and beyond FAR_POSTS_M.
POSTS_M, FAR_POSTS_M, POSTS_FAR_M = 4.0, 80.0, 12.0
# A guardrail's face, from its front (across, up) with its top at 0; it is sunk to the ground over END_M at both ends.
W_BEAM_M = np.array([(0.08, 0.0), (0.0, -0.06), (0.08, -0.155), (0.0, -0.25), (0.08, -0.31)])
END_M = 6.0
# Half of a concrete barrier's section (Jersey shape) as shares of its height, from the bottom.
JERSEY = np.array([(0.37, 0.0), (0.37, 0.1), (0.2, 0.4), (0.1, 1.0)])
KERB_M, WALKWAY_M, WALL_M = 0.15, 1.8, 0.14
POLES_M, WIRE_M, SAG_M, CROSSARM_M = 45.0, 0.025, 0.9, 1.1


def rail_stations(ground: Ground, rail: Rail) -> Scalars:
    """Stations of the rows of a rail, denser near the host."""
    low, high = sorted((rail.from_m, rail.to_m))
    s = np.linspace(low, high, 2 + int(high - low))
    away_m = ground.way.away_at(ground.network.road(rail.road).xy(s, 0.0))
    rows = [low]
    while rows[-1] < high:
        here_m = np.interp(rows[-1], s, away_m)
        step = next(step for reach, step in PIECES_M if here_m < reach)
        rows.append(min(rows[-1] + step, high))
    return np.array(rows)


def rail_body(ground: Ground, rail: Rail) -> Body:
    """A rail from its first station to its last."""
    form, s = RAILS[rail.kind], rail_stations(ground, rail)
    quads = Quads(rail.kind, form.surface)
    form.add(quads, ground, rail, s)
    if not quads.feet:
        quads.feet.append(on_ground(ground, _rows(ground, rail, s, np.zeros(1), np.zeros((len(s), 1)))[:, 0, :2]))
    return quads.body()


def _rows(
    ground: Ground, rail: Rail, s: Scalars, across_m: Float[np.ndarray, " c"], z: Float[np.ndarray, "*#rows"]
) -> Float[np.ndarray, "r c 3"]:
    """World points at stations and distances outwards from a rail's front, at heights z."""
    z = np.broadcast_to(z, (len(s), len(across_m)))
    columns = [beside(ground, rail.road, rail.side, s, rail.aside_m + across) for across in across_m]
    return np.concatenate([np.stack(columns, axis=1), z[..., None]], axis=2)


def _edge_height(ground: Ground, rail: Rail, s: Scalars) -> Scalars:
    """Height of the pavement beside a rail: what stands near its edge is as high over the road everywhere."""
    inside = rail.aside_m if rail.side == "median" else -0.02
    return ground.height_along(rail.road, beside(ground, rail.road, rail.side, s, inside))


def foot_of_front(ground: Ground, rail: Rail, s: Scalars) -> Float[np.ndarray, "n 3"]:
    """World points at the front of a rail, as high as the pavement beside it."""
    xy_world = beside(ground, rail.road, rail.side, s, rail.aside_m)
    return np.column_stack([xy_world, _edge_height(ground, rail, s)])


def _foot_height(ground: Ground, rail: Rail, s: Scalars, across_m: float) -> Scalars:
    return ground.height_along(rail.road, beside(ground, rail.road, rail.side, s, rail.aside_m + across_m))


def _guardrail(quads: Quads, ground: Ground, rail: Rail, s: Scalars) -> None:
    """W-beams before posts; a median's has beams on both sides."""
    color = (*rail.color, 0.5)
    s = np.unique(np.concatenate([s, [rail.from_m + END_M, rail.to_m - END_M]]))
    s = s[(s >= rail.from_m) & (s <= rail.to_m)]
    up = np.clip(np.minimum(s - rail.from_m, rail.to_m - s) / END_M, 0, 1)
    top = _edge_height(ground, rail, s) + rail.height_m * up + 0.05 * (up - 1)
    for sign in (1, -1) if rail.side == "median" else (1,):
        offset = -0.2 if rail.side == "median" else 0.0
        quads.sweep(_rows(ground, rail, s, sign * (W_BEAM_M[:, 0] + offset), top[:, None] + W_BEAM_M[:, 1]), color)
    behind_m = 0.0 if rail.side == "median" else 0.16
    _posts(quads, ground, rail, RailPosts(behind_m, (0.07, 0.055), rail.height_m - 0.03, END_M), color)


def _concrete(quads: Quads, ground: Ground, rail: Rail, s: Scalars) -> None:
    """A Jersey barrier; in a median its middle is at the rail's place."""
    half = JERSEY * rail.height_m
    section = np.concatenate([half[:1] - [0, SINK_M], half, half[::-1] * [-1, 1], half[:1] * [-1, 1] - [0, SINK_M]])
    section[:, 0] += half[0, 0] if rail.side != "median" else 0.0
    _sweep(quads, ground, rail, s, section)


def _kerb(quads: Quads, ground: Ground, rail: Rail, s: Scalars) -> None:
    """A kerb, of a walkway with its paved path."""
    back_m, up = (WALKWAY_M if rail.kind == "walkway" else KERB_M), rail.height_m
    section = [(0, -SINK_M), (0, up - 0.02), (0.02, up), (KERB_M, up), (back_m, up), (back_m, -SINK_M - 0.3)]
    _sweep(quads, ground, rail, s, np.array(section))


def _sweep(quads: Quads, ground: Ground, rail: Rail, s: Scalars, section: Float[np.ndarray, "c 2"]) -> None:
    """A section (across, up) along a rail, and its ends."""
    rows = _rows(ground, rail, s, section[:, 0], section[:, 1] + _edge_height(ground, rail, s)[:, None])
    quads.sweep(rows, (*rail.color, 0.0))
    quads.add(rows[[0, -1]][:, [0, 2, 3, -1]], (*rail.color, 0.0))


def _noise_wall(quads: Quads, ground: Ground, rail: Rail, s: Scalars) -> None:
    """Panels in bands of two shades between posts, and a light cap."""
    foot, color = _foot_height(ground, rail, s, WALL_M / 2)[:, None], (*rail.color, 0.0)
    n_bands = max(2, round(rail.height_m / 0.8))
    levels = np.linspace(0, rail.height_m, n_bands + 1)
    for band, (low, high) in enumerate(pairwise(levels)):
        shade = 1.0 if band % 2 else 0.86
        tone = (*(shade * channel for channel in color[:3]), 0.0)
        low = low if band else -SINK_M
        for across in (0.0, WALL_M):
            quads.sweep(_rows(ground, rail, s, np.full(2, across), foot + np.array([low, high])), tone)
    quads.sweep(_rows(ground, rail, s, np.array([-0.03, WALL_M + 0.03]), foot + rail.height_m + 0.03), color)
    dark = (*(0.75 * channel for channel in color[:3]), 0.0)
    _posts(quads, ground, rail, RailPosts(WALL_M / 2, (0.11, 0.09), rail.height_m + 0.05, 0.0), dark)


class RailPosts(NamedTuple):
    """A rail's posts: their middle behind its front, half their section, their height over the edge of the pavement (of
    a noise wall: over the ground), and how far from the rail's ends they begin."""

    across_m: float
    half_m: tuple[float, float]
    height_m: float
    from_ends_m: float


def _posts(quads: Quads, ground: Ground, rail: Rail, posts: RailPosts, color: Sequence[float]) -> None:
    first_m = rail.from_m + posts.from_ends_m
    s = np.arange(first_m, rail.to_m - (first_m - rail.from_m) + 0.01, POSTS_M)
    away = ground.way.away_at(ground.network.road(rail.road).xy(s, 0.0))
    s = s[(away < FAR_POSTS_M) | (np.arange(len(s)) % round(POSTS_FAR_M / POSTS_M) == 0)]
    foot = _foot_height(ground, rail, s, posts.across_m)
    top = foot if rail.kind == "noise_wall" else _edge_height(ground, rail, s)
    frames = frames_beside(ground, rail.road, rail.side, s, rail.aside_m + posts.across_m)
    for frame, rise_m in zip(frames, (top - foot + posts.height_m).tolist(), strict=True):
        x, y = posts.half_m
        quads.box(frame, (-x, -y, -SINK_M), (x, y, rise_m), color)


def _power_line(quads: Quads, ground: Ground, rail: Rail, s: Scalars) -> None:
    """Wooden poles with a crossarm and three wires."""
    color = (*rail.color, 0.0)
    n = max(1, round((rail.to_m - rail.from_m) / POLES_M))
    frames = frames_beside(ground, rail.road, rail.side, np.linspace(rail.from_m, rail.to_m, n + 1), rail.aside_m)
    h = rail.height_m
    ties = np.array([(-CROSSARM_M, 0, h + 0.1), (0, 0, h + 0.35), (CROSSARM_M, 0, h + 0.1)])
    for frame in frames:
        quads.tube(frame.world(np.array([(0, 0, -SINK_M), (0, 0, h + 0.3)])), (0.15, 0.1), color)
        quads.box(frame, (-CROSSARM_M - 0.1, -0.06, h - 0.1), (CROSSARM_M + 0.1, 0.06, h + 0.05), color)
    sag = np.linspace(-1, 1, 7)[:, None]
    for a, b in pairwise(frames):
        for tie in ties:
            start, end = a.world(tie), b.world(tie)
            wire = start + (sag + 1) / 2 * (end - start) - SAG_M * (1 - sag**2) * [0, 0, 1.0]
            for piece in pairwise(wire):
                quads.tube(np.array(piece), (WIRE_M, WIRE_M), BLACK, n=3)
    quads.feet.append(on_ground(ground, np.array([frame.origin[:2] for frame in frames])))


class RailForm(NamedTuple):
    """What is fixed of a kind of rail: the semantic name of its faces, its depth, its height if that is not drawn,
    whether it stands on ground about as high as the pavement's edge, and what adds its quads."""

    surface: Literal["barrier", "kerb", "pole"]
    depth_m: float
    height_m: float | None
    is_level: bool
    add: Callable[[Quads, Ground, Rail, Scalars], None]


RAILS: dict[RailKind, RailForm] = {
    "guardrail": RailForm("barrier", 0.25, 0.75, True, _guardrail),
    "concrete": RailForm("barrier", 0.7, 0.9, True, _concrete),
    "noise_wall": RailForm("barrier", 0.3, None, False, _noise_wall),
    "kerb": RailForm("kerb", KERB_M, 0.12, True, _kerb),
    "walkway": RailForm("kerb", WALKWAY_M, 0.13, True, _kerb),
    "power_line": RailForm("pole", 1.5, None, False, _power_line),
}
KERBS = tuple(kind for kind, form in RAILS.items() if form.surface == "kerb")
