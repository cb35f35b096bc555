"""Values along a road as cubic pieces: read from a file, moved along the road, subtracted."""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from operator import attrgetter
from xml.etree.ElementTree import Element

import numpy as np

from synth3dlanes.maps.document import number
from synth3dlanes.road_map import Polynomial

Cubics = tuple[Polynomial, ...]
# Pieces that begin this close to each other begin at one station.
SAME_M = 1e-6
# Products are told by cubics so long.
STEP_M = 5.0


def read_cubics(elements: Iterable[Element], key: str, where: str) -> Cubics:
    """The pieces that elements with a, b, c and d describe, by the station in `key`; of those at one station the last
    one holds."""
    found: dict[float, Polynomial] = {}
    for element in elements:
        a, b, c, d = (number(element, name, where, 0.0) for name in "abcd")
        station = number(element, key, where, 0.0)
        found[station] = Polynomial(s_m=station, a=a, b=b, c=c, d=d)
    return _plain([found[station] for station in sorted(found)])


def _plain(cubics: Iterable[Polynomial]) -> Cubics:
    """The pieces without those that only go on as the one before."""
    kept: list[Polynomial] = []
    for piece in cubics:
        if not kept or not _is_small(
            *(a - b for a, b in zip(_numbers(piece), _begun(kept[-1], piece.s_m), strict=True))
        ):
            kept.append(piece)
    return tuple(kept)


def piece_at(cubics: Sequence[Polynomial], s_m: float) -> Polynomial | None:
    """The piece that holds at a station: the last that begins at or before it, the first before that."""
    if not cubics:
        return None
    return cubics[max(0, bisect_right(cubics, s_m + SAME_M, key=attrgetter("s_m")) - 1)]


def value(cubics: Sequence[Polynomial], s_m: float) -> float:
    """The value at a station; 0 without any piece."""
    piece = piece_at(cubics, s_m)
    if piece is None:
        return 0.0
    x = s_m - piece.s_m
    return piece.a + x * (piece.b + x * (piece.c + x * piece.d))


def slope(cubics: Sequence[Polynomial], s_m: float) -> float:
    """The slope at a station; 0 without any piece."""
    piece = piece_at(cubics, s_m)
    if piece is None:
        return 0.0
    x = s_m - piece.s_m
    return piece.b + x * (2 * piece.c + x * 3 * piece.d)


def begun_at(piece: Polynomial, s_m: float) -> Polynomial:
    """The same cubic, told from another station on."""
    a, b, c, d = _begun(piece, s_m)
    return Polynomial(s_m=s_m, a=a, b=b, c=c, d=d)


def _begun(piece: Polynomial, s_m: float) -> tuple[float, float, float, float]:
    x, (a, b, c, d) = s_m - piece.s_m, _numbers(piece)
    return a + x * (b + x * (c + x * d)), b + x * (2 * c + x * 3 * d), c + 3 * d * x, d


def _numbers(piece: Polynomial) -> tuple[float, float, float, float]:
    return piece.a, piece.b, piece.c, piece.d


def moved(cubics: Sequence[Polynomial], by_m: float) -> Cubics:
    """The pieces with all stations greater by `by_m`."""
    return tuple(piece.model_copy(update={"s_m": piece.s_m + by_m}) for piece in cubics)


def part(cubics: Sequence[Polynomial], from_m: float, to_m: float) -> Cubics:
    """The pieces that hold between two stations, the first one told from `from_m` on; stations count from there."""
    first = piece_at(cubics, from_m)
    if first is None:
        return ()
    inside = [piece for piece in cubics if from_m + SAME_M < piece.s_m < to_m - SAME_M]
    return moved((begun_at(first, from_m), *inside), -from_m)


def times(cubics: Sequence[Polynomial], factor: Callable[[float], float], to_m: float) -> Cubics:
    """A value times another that changes slowly, from station 0 to `to_m`: cubics with its values and slopes at places
    STEP_M apart."""
    if not cubics:
        return ()
    stations = sorted({*np.arange(0.0, to_m, STEP_M).tolist(), to_m, *(p.s_m for p in cubics if 0 < p.s_m < to_m)})
    found = []
    for low, high in pairwise(stations):
        piece, h = begun_at(piece_at(cubics, low) or cubics[0], low), high - low
        if h < SAME_M:
            continue
        ends = []
        for x in (0.0, h):
            e = min(1e-3, h / 4)
            rate = (factor(low + x + e) - factor(low + x - e)) / (2 * e)
            at, bend = value([piece], low + x), slope([piece], low + x)
            ends.append((at * factor(low + x), bend * factor(low + x) + at * rate))
        (a, b), (end, rise) = ends
        c, d = (3 * (end - a) / h - 2 * b - rise) / h, (b + rise - 2 * (end - a) / h) / h**2
        found.append(Polynomial(s_m=low, a=a, b=b, c=c, d=d))
    return _plain(found)


def steepened(banks: Sequence[Polynomial], heights: Sequence[Polynomial], to_m: float, power: int) -> Cubics:
    """Banks with their tangents divided (`power` 1) or multiplied (-1) by the cosine of the road's climb. A file's roll
    turns a plane that climbs already, which moves its places along the road: from above its fall is steeper."""

    def factor(s_m: float) -> float:
        bank, rise = value(banks, s_m), math.hypot(1.0, slope(heights, s_m)) ** power
        return math.atan(math.tan(bank) * rise) / bank if abs(bank) > 1e-6 else rise

    return times(banks, factor, to_m)


def difference(one: Sequence[Polynomial], other: Sequence[Polynomial], sign: float = 1.0) -> Cubics:
    """`sign` times the first less the second; where there are no pieces, 0."""
    stations = sorted({piece.s_m for piece in (*one, *other)})
    zero = Polynomial(s_m=0.0, a=0.0)
    found = []
    for s in stations:
        p, q = (begun_at(piece_at(cubics, s) or zero, s) for cubics in (one, other))
        found.append(
            Polynomial(s_m=s, **{name: sign * (getattr(p, name) - getattr(q, name)) for name in ("a", "b", "c", "d")})
        )
    return tuple(found)


def is_zero(cubics: Iterable[Polynomial]) -> bool:
    """Whether the value is 0, to a micrometre within ten metres."""
    return all(_is_small(*_numbers(piece)) for piece in cubics)


def _is_small(a: float, b: float, c: float, d: float) -> bool:
    return math.hypot(a, 10 * b, 100 * c, 1e3 * d) < 1e-6


def rounded(cubics: Iterable[Polynomial]) -> Cubics:
    """The pieces without digits that change nothing by more than a tenth of a millimetre in a kilometre."""
    return tuple(
        Polynomial(
            s_m=round(piece.s_m, 6),
            a=round(piece.a, 6),
            b=round(piece.b, 9),
            c=round(piece.c, 12),
            d=round(piece.d, 15),
        )
        for piece in cubics
    )
