"""What a map's roads have that leave the ground: decks with parapets, piers and abutments, tunnels with portals. World
frame, metres."""

from collections.abc import Callable, Sequence
from itertools import repeat
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.polylines import parted, stretches
from synth3dlanes.roads.cross_section import KERB_M
from synth3dlanes.system.arrays import Points2, Points3, Scalars
from synth3dlanes.world.cells import PlanPlaces
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
# Spacing of piers, half of their width, their distance from pavement below, and the least height below a deck with
# piers.
PIER_SPACING_M, HALF_PIER_M, PIER_CLEARANCE_M, LEAST_PIER_HEIGHT_M = 22.0, 0.45, 1.0, 2.0
# Shifts along the deck that are tried for a pier without room at its place.
PIER_SHIFTS_M = np.array([0, 2, -2, 4, -4, 6, -6, 8, -8.0])
# Most depth of the ground behind an abutment below the road, the length of its wings, and places across its wall.
BANK_M, WING_M, ACROSS = 2.0, 3.0, 7
# The wall around a portal: how far it reaches beside that and over the ground, and its fall towards its ends.
PORTAL_M, COPING_M, PORTAL_SLOPE = 8.0, 0.5, 0.6
CONCRETE, DARK = (0.4, 0.39, 0.37), (0.24, 0.235, 0.225)

AnyFlags = Bool[np.ndarray, " _"]
Heights = Float[np.ndarray, " _"]


class _Abutment(NamedTuple):
    """The end of a deck: places of a wall across the road below it and of the wings beside it, how high the road is
    there, and the places where the ground is asked: off the deck, below it, and at the wall and the wings."""

    wall: Points2
    wings: Float[np.ndarray, "2 2 2"]
    top_m: Scalars
    asked: PlanPlaces

    @classmethod
    def of(cls, span: Span, end_m: float, outward: float) -> "_Abutment":
        """The abutment at the end `end_m` of a deck, from which the road goes on in the direction `outward`."""
        road, at = span.road, np.full(ACROSS, end_m)
        t = np.linspace(float(road.left(at)[0]) - SIDE_M, float(road.right(at)[0]) + SIDE_M, ACROSS)
        line = road.xy(at, t)
        along = road.xy(at[:1], np.zeros(1)) - road.xy(at[:1] - 0.5 * outward, np.zeros(1))
        along = along[0] / np.linalg.norm(along)
        wall, wings = line - 0.05 * along, line[[0, -1]][:, None] + np.array([-0.05, WING_M])[:, None] * along
        asked = np.concatenate([line + along, line - along, wall, *wings])
        return cls(wall, wings, _points(span, at, t, 0.0)[:, 2], asked)


class _Deck(NamedTuple):
    """A deck: the stations of its rows, its middle there, its abutments, and stations and tops of piers."""

    span: Span
    s: Scalars
    middle_world: Points3
    abutments: tuple[_Abutment, _Abutment]
    piers_s: Float[np.ndarray, " k"]
    piers_world: Float[np.ndarray, "k 3"]

    @classmethod
    def of(cls, span: Span) -> "_Deck":
        """The deck of a span."""
        road, s = span.road, span.rows(ROW_M)
        n = int((span.to_m - span.from_m) / PIER_SPACING_M)
        middles_m = np.linspace(span.from_m, span.to_m, n + 2)[1:-1]
        at = np.repeat(np.clip(middles_m[:, None] + PIER_SHIFTS_M, span.from_m + 1, span.to_m - 1).ravel(), 2)
        left, right = road.left(at), road.right(at)
        piers = _points(span, at, left + (right - left) * np.tile([0.22, 0.78], len(at) // 2), -DECK_M)
        middle = _points(span, s, (road.left(s) + road.right(s)) / 2, 0.0)
        return cls(
            span, s, middle, (_Abutment.of(span, span.from_m, -1.0), _Abutment.of(span, span.to_m, 1.0)), at, piers
        )

    @property
    def asked(self) -> PlanPlaces:
        """The places where the ground below it is asked."""
        return np.concatenate([*(end.asked for end in self.abutments), self.piers_world[:, :2]])


def span_bodies(ground: Ground, paved: PavedAreas) -> list[Body]:
    """The bodies of all decks and tunnels, in the order of `PavedAreas.spans`."""
    decks = [_Deck.of(span) for span in paved.spans if not span.is_tunnel]
    if not decks:
        return [_tunnel(paved, span) for span in paved.spans]
    # What the ground is like at all decks is asked at once.
    graded_m = _of_each(paved.graded, [deck.asked for deck in decks])
    feet_m = _of_each(ground.height, [deck.middle_world[:, :2] for deck in decks])
    bodies = map(_deck, decks, graded_m, feet_m, _free(paved, decks), repeat(paved))
    return [_tunnel(paved, span) if span.is_tunnel else next(bodies) for span in paved.spans]


def _of_each(told: Callable[[PlanPlaces], Heights], places: Sequence[PlanPlaces]) -> list[Heights]:
    """The values of a function at the places of each list, by one call."""
    return parted(told(np.concatenate(places)), list(map(len, places)))


def _points(span: Span, s: Scalars, t: Scalars, up_m: Scalars | float) -> Points3:
    """Places across a road, outside its pavement as high as its edge."""
    road = span.road
    inside = np.clip(t, road.left(s), road.right(s))
    z = road.base_points(s, inside)[:, 2] + up_m
    return np.column_stack([road.xy(s, t), z])


def _deck(deck: _Deck, graded_m: Heights, feet_m: Heights, free: tuple[AnyFlags, AnyFlags], paved: PavedAreas) -> Body:
    """A slab with parapets where its edges are free, on abutments and piers, by the heights of the graded ground at the
    places that it asks, and of the ground at its middle."""
    quads, span, s = Quads("bridge", "bridge"), deck.span, deck.s
    road = span.road
    left, right = road.left(s), road.right(s)
    quads.sweep(_rows(span, s, [(left - SIDE_M, -DECK_M), (right + SIDE_M, -DECK_M)]), DARK)
    for edge, out, is_free in zip((left, right), (-1.0, 1.0), free, strict=True):
        top = PARAPET_M + road.kerb(s, edge - out * KERB_M)
        for first, end in stretches(is_free):
            on = slice(first, end)
            outer, inner = edge[on] + out * SIDE_M, edge[on] + out * 0.03
            rows = _rows(span, s[on], [(outer, -DECK_M), (outer, top[on]), (inner, top[on]), (inner, -0.1)])
            quads.sweep(rows, CONCRETE)
            quads.add(rows[[0, -1]], CONCRETE)
        for first, end in stretches(~is_free):
            on = slice(first, end)
            outer = edge[on] + out * SIDE_M
            quads.sweep(_rows(span, s[on], [(outer, -DECK_M), (outer, -0.08), (edge[on], -0.08)]), DARK)
    *ends_m, piers_m = parted(graded_m, [*(len(at.asked) for at in deck.abutments), len(deck.piers_s)])
    for abutment, own_m in zip(deck.abutments, ends_m, strict=True):
        _abutment(quads, abutment, own_m)
    _piers(quads, paved, deck, piers_m)
    quads.feet.append(np.column_stack([deck.middle_world[:, :2], feet_m]))
    return quads.body()


def _rows(span: Span, s: Scalars, section: Sequence[tuple[Scalars, Scalars | float]]) -> Float[np.ndarray, "r c 3"]:
    """Points of a section (offset, height over the pavement's edge) along a road."""
    return np.stack([_points(span, s, t, up) for t, up in section], axis=1)


def _free(paved: PavedAreas, decks: Sequence[_Deck]) -> list[tuple[AnyFlags, AnyFlags]]:
    """At which rows of decks no other pavement is beside their left and their right edge, about as high."""
    table, sides = paved.network.index.table, list[Points3]()
    for deck in decks:
        road, s = deck.span.road, deck.s
        sides += [_points(deck.span, s, t, 0.0) for t in (road.left(s) - BESIDE_M, road.right(s) + BESIDE_M)]
    counts, points = list(map(len, sides)), np.concatenate(sides)
    own = np.repeat([table.roads.index(deck.span.road) for deck in decks for _ in range(2)], counts)
    at = paved.network.index.places(points[:, :2], BESIDE_M)
    at = at.of(at.road != own[at.point])
    on, across, away_m = table.nearest(at)
    is_level = np.abs(table.base_points(at.road, on, across)[:, 2] - points[at.point, 2]) < LEVEL_M
    free = np.ones(len(points), dtype=bool)
    free[at.point[(away_m < BESIDE_M) & is_level]] = False
    each = parted(free, counts)
    return list(zip(each[::2], each[1::2], strict=True))


def _abutment(quads: Quads, end: _Abutment, graded_m: Heights) -> None:
    """A wall below the end of a deck, with wings into the bank; none where the road goes on from there on a deck."""
    behind, before, at_wall, *feet = parted(graded_m, [ACROSS, ACROSS, ACROSS, 2, 2])
    wall, wings, top, _ = end
    if (top - behind).min() > BANK_M:
        return
    low = np.minimum(before, at_wall) - 1.0
    rows = np.stack([np.column_stack([wall, np.minimum(low, top - 1.0)]), np.column_stack([wall, top - 0.08])], axis=1)
    quads.sweep(rows, CONCRETE)
    for wing, foot, z in zip(wings, feet, top[[0, -1]], strict=True):
        ends = foot.min() - 1.0, z - 0.08
        quads.sweep(np.stack([np.column_stack([wing, np.full(2, at_z)]) for at_z in ends], axis=1), CONCRETE)


def _piers(quads: Quads, paved: PavedAreas, deck: _Deck, low_m: Heights) -> None:
    """Pairs of columns below a deck, clear of pavement, on the ground at these heights."""
    top, s = deck.piers_world, deck.piers_s
    rise_m = top[:, 2] - low_m
    has_room = (rise_m >= LEAST_PIER_HEIGHT_M) & paved.is_off_ground_pavement(top[:, :2], PIER_CLEARANCE_M)
    pairs = has_room.reshape(-1, len(PIER_SHIFTS_M), 2).all(axis=2)
    for i in np.flatnonzero(pairs.any(axis=1)).tolist():
        first = 2 * (i * len(PIER_SHIFTS_M) + int(pairs[i].argmax()))
        along = np.diff(deck.span.road.xy(s[first] + np.array([-0.5, 0.5]), np.zeros(2)), axis=0)[0]
        for at in (first, first + 1):
            frame = GroundFrame(np.array([*top[at, :2], low_m[at]]), along / np.linalg.norm(along))
            quads.box(
                frame,
                (-HALF_PIER_M, -HALF_PIER_M, -SINK_M),
                (HALF_PIER_M, HALF_PIER_M, float(rise_m[at]) + 0.05),
                CONCRETE,
            )


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
