"""What a map's roads have that leave the ground: decks with parapets, piers and abutments, tunnels with portals. World
frame, metres."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.polylines import stretches
from synth3dlanes.roads.cross_section import KERB_M
from synth3dlanes.system.arrays import Points3, Scalars
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.paved_areas import PavedAreas
from synth3dlanes.world.solids import SINK_M, Body, GroundFrame, Quads
from synth3dlanes.world.spans import CEILING_M, COVER_M, DECK_M, WALL_M, Span

# The walls of tunnels stand on the edges of the pavement.
INSET_M = 0.12
# Rows along decks and tunnels; the width of a deck beside its pavement, and the height of its parapets over that.
ROW_M, SIDE_M, PARAPET_M = 2.0, 0.35, 0.95
# There is no parapet where another road goes on within BESIDE_M of an edge and LEVEL_M of its height.
BESIDE_M, LEVEL_M = 0.5, 1.5
# Distance of piers, half of their section, how far from pavement they stand, and the least room below a deck for any.
PIERS_M, PIER_M, CLEAR_M, LEAST_PIER_M = 22.0, 0.45, 1.0, 2.0
# Where piers are tried, from the place at which they should be.
TRIED_M = np.array([0, 2, -2, 4, -4, 6, -6, 8, -8.0])
# Most depth of the ground behind an abutment below the road, and the length of its wings.
BANK_M, WING_M = 2.0, 3.0
# The wall around a portal: how far it reaches beside that and over the ground, and its fall towards its ends.
PORTAL_M, COPING_M, PORTAL_SLOPE = 8.0, 0.5, 0.6
CONCRETE, DARK = (0.4, 0.39, 0.37), (0.24, 0.235, 0.225)


def span_bodies(ground: Ground, paved: PavedAreas) -> list[Body]:
    """The bodies of all decks and tunnels, in the order of `PavedAreas.spans`."""
    return [_tunnel(paved, span) if span.is_tunnel else _deck(ground, paved, span) for span in paved.spans]


def _points(span: Span, s: Scalars, t: Scalars, up_m: Scalars | float) -> Points3:
    """Places across a road, outside its pavement as high as its edge."""
    road = span.road
    inside = np.clip(t, road.left(s), road.right(s))
    z = road.base_points(s, inside)[:, 2] + up_m
    return np.column_stack([road.xy(s, t), z])


def _deck(ground: Ground, paved: PavedAreas, span: Span) -> Body:
    """A slab with parapets where its edges are free, on abutments and piers."""
    quads, road, s = Quads("bridge", "bridge"), span.road, span.rows(ROW_M)
    left, right = road.left(s), road.right(s)
    quads.sweep(_rows(span, s, [(left - SIDE_M, -DECK_M), (right + SIDE_M, -DECK_M)]), DARK)
    for edge, out in ((left, -1.0), (right, 1.0)):
        free = _is_free(paved, span, s, edge + out * BESIDE_M)
        top = PARAPET_M + road.kerb(s, edge - out * KERB_M)
        for first, end in stretches(free):
            on = slice(first, end)
            outer, inner = edge[on] + out * SIDE_M, edge[on] + out * 0.03
            rows = _rows(span, s[on], [(outer, -DECK_M), (outer, top[on]), (inner, top[on]), (inner, -0.1)])
            quads.sweep(rows, CONCRETE)
            quads.add(rows[[0, -1]], CONCRETE)
        for first, end in stretches(~free):
            on = slice(first, end)
            outer = edge[on] + out * SIDE_M
            quads.sweep(_rows(span, s[on], [(outer, -DECK_M), (outer, -0.08), (edge[on], -0.08)]), DARK)
    for end_m, outward in ((span.from_m, -1.0), (span.to_m, 1.0)):
        _abutment(quads, paved, span, end_m, outward)
    _piers(quads, paved, span)
    feet = _points(span, s, (left + right) / 2, 0.0)
    quads.feet.append(np.column_stack([feet[:, :2], ground.height(feet[:, :2])]))
    return quads.body()


def _rows(span: Span, s: Scalars, section: Sequence[tuple[Scalars, Scalars | float]]) -> Float[np.ndarray, "r c 3"]:
    """Points of a section (offset, height over the pavement's edge) along a road."""
    return np.stack([_points(span, s, t, up) for t, up in section], axis=1)


def _is_free(paved: PavedAreas, span: Span, s: Scalars, t: Scalars) -> Bool[np.ndarray, " n"]:
    """At which stations no other pavement is beside the edge of a deck, about as high."""
    points = _points(span, s, t, 0.0)
    table, at = paved.network.index.table, paved.network.index.places(points[:, :2], BESIDE_M)
    at = at.of(at.road != table.roads.index(span.road))
    on, across, away_m = table.nearest(at)
    is_level = np.abs(table.base_points(at.road, on, across)[:, 2] - points[at.point, 2]) < LEVEL_M
    free = np.ones(len(s), dtype=bool)
    free[at.point[(away_m < BESIDE_M) & is_level]] = False
    return free


def _abutment(quads: Quads, paved: PavedAreas, span: Span, end_m: float, outward: float) -> None:
    """A wall below the end of a deck, with wings into the bank; none where the road goes on from there on a deck."""
    road, n = span.road, 7
    at = np.full(n, end_m)
    t = np.linspace(float(road.left(at)[0]) - SIDE_M, float(road.right(at)[0]) + SIDE_M, n)
    line = road.xy(at, t)
    along = road.xy(at[:1], np.zeros(1)) - road.xy(at[:1] - 0.5 * outward, np.zeros(1))
    along = along[0] / np.linalg.norm(along)
    face, ways = line - 0.05 * along, line[[0, -1]][:, None] + np.array([-0.05, WING_M])[:, None] * along
    graded_m = paved.graded(np.concatenate([line + along, line - along, face, *ways]))
    behind, before, at_face, *feet = np.split(graded_m, np.cumsum([n, n, n, 2]))
    top = _points(span, at, t, 0.0)[:, 2]
    if (top - behind).min() > BANK_M:
        return
    low = np.minimum(before, at_face) - 1.0
    wall = np.stack([np.column_stack([face, np.minimum(low, top - 1.0)]), np.column_stack([face, top - 0.08])], axis=1)
    quads.sweep(wall, CONCRETE)
    for way, foot, z in zip(ways, feet, top[[0, -1]], strict=True):
        ends = foot.min() - 1.0, z - 0.08
        quads.sweep(np.stack([np.column_stack([way, np.full(2, at_z)]) for at_z in ends], axis=1), CONCRETE)


def _piers(quads: Quads, paved: PavedAreas, span: Span) -> None:
    """Pairs of columns below a deck, clear of pavement."""
    road = span.road
    n = int((span.to_m - span.from_m) / PIERS_M)
    middles_m = np.linspace(span.from_m, span.to_m, n + 2)[1:-1]
    s = np.repeat(np.clip(middles_m[:, None] + TRIED_M, span.from_m + 1, span.to_m - 1).ravel(), 2)
    left, right = road.left(s), road.right(s)
    top = _points(span, s, left + (right - left) * np.tile([0.22, 0.78], len(s) // 2), -DECK_M)
    low = paved.graded(top[:, :2])
    rise_m = top[:, 2] - low
    has_room = (rise_m >= LEAST_PIER_M) & paved.is_off_ground_pavement(top[:, :2], CLEAR_M)
    pairs = has_room.reshape(n, len(TRIED_M), 2).all(axis=2)
    for i in np.flatnonzero(pairs.any(axis=1)).tolist():
        first = 2 * (i * len(TRIED_M) + int(pairs[i].argmax()))
        along = np.diff(road.xy(s[first] + np.array([-0.5, 0.5]), np.zeros(2)), axis=0)[0]
        for at in (first, first + 1):
            frame = GroundFrame(np.array([*top[at, :2], low[at]]), along / np.linalg.norm(along))
            quads.box(frame, (-PIER_M, -PIER_M, -SINK_M), (PIER_M, PIER_M, float(rise_m[at]) + 0.05), CONCRETE)


def _tunnel(paved: PavedAreas, span: Span) -> Body:
    """Walls and a ceiling, and walls around both portals."""
    quads, road, s = Quads("tunnel", "bridge"), span.road, span.rows(ROW_M)
    left, right = road.left(s), road.right(s)
    inner = left + INSET_M, right - INSET_M
    section = [(inner[i], up) for i, up in ((0, -SINK_M), (0, CEILING_M), (1, CEILING_M), (1, -SINK_M), (0, -SINK_M))]
    quads.sweep(_rows(span, s, section), CONCRETE)
    for edge in (left - WALL_M, right + WALL_M):
        xy = road.xy(s, edge)
        top, low = paved.beside_tunnels(xy, is_over=True), paved.beside_tunnels(xy, is_over=False)
        wall = [np.column_stack([xy, np.minimum(low, top) - SINK_M]), np.column_stack([xy, top + 0.05])]
        quads.sweep(np.stack(wall, axis=1), DARK)
    for end_m in (span.from_m, span.to_m):
        _portal(quads, span, end_m)
    return quads.body()


def _portal(quads: Quads, span: Span, end_m: float) -> None:
    """The wall around the opening of a tunnel."""
    at = np.full(1, end_m)
    left, right = float(span.road.left(at)[0]) + INSET_M, float(span.road.right(at)[0]) - INSET_M
    top = CEILING_M + COVER_M + COPING_M
    for inner, sign in ((left, -1.0), (right, 1.0)):
        t = inner + sign * np.array([0.0, WALL_M + INSET_M + 1.5, PORTAL_M])
        high = np.array([top, top, top - PORTAL_SLOPE * (PORTAL_M - 1.5)])
        s = np.full(3, end_m)
        quads.sweep(np.stack([_points(span, s, t, -2.0), _points(span, s, t, high)], axis=1), CONCRETE)
    t, s = np.array([left, right]), np.full(2, end_m)
    quads.sweep(np.stack([_points(span, s, t, CEILING_M), _points(span, s, t, top)], axis=1), CONCRETE)
