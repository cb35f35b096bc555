"""Values along a road as cubic pieces: read from a file, moved along the road, subtracted."""

import math
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from operator import attrgetter
from typing import TypeVar
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.maps.document import number
from synth3dlanes.scene.road_map import MapMark, Polynomial
from synth3dlanes.system.arrays import AnyScalars

Cubics = tuple[Polynomial, ...]
# Stations within this distance are one, because files round them.
SAME_M = 1e-3
# A product is split into cubics until they are this exact unless told, measured at SHARES of them, or shorter than
# SHORT_M.
EXACT, SHORT_M, SHARES = 1e-7, 5.0, (0.25, 0.5, 0.75)
# What holds from a station on.
Begun = TypeVar("Begun", Polynomial, MapMark)
BEGIN = attrgetter("s_m")


@dataclass(frozen=True, eq=False)
class Profile:
    """A value along a road, by cubics of the distance from where each begins; before the first one it goes on."""

    pieces: tuple[Polynomial, ...]

    @cached_property
    def table(self) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "4 k"]]:
        """Where each cubic begins, and its coefficients."""
        pieces = sorted(self.pieces, key=lambda piece: piece.s_m) or [Polynomial(s_m=0.0, a=0.0)]
        rows = [[piece.a, piece.b, piece.c, piece.d] for piece in pieces]
        return np.array([piece.s_m for piece in pieces]), np.array(rows, float).T

    @cached_property
    def constant(self) -> float | None:
        """Its value if it is the same everywhere, as most widths are; else None."""
        _, table = self.table
        return None if table[1:].any() or np.ptp(table[0]) else float(table[0, 0])

    def __call__(self, s: AnyScalars) -> AnyScalars:
        """Values at stations."""
        if self.constant is not None:
            return np.full(s.shape, self.constant)
        starts, table = self.table
        # Most have one piece, and no time is to be lost with looking for it.
        which = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, None) if len(starts) > 1 else 0
        x, (a, b, c, d) = s - starts[which], table[:, which]
        return np.asarray(a + x * (b + x * (c + x * d)))


def read_cubics(elements: Iterable[Element], key: str, where: str, end_m: float, left_out: Counter[str]) -> Cubics:
    """The pieces that elements with a, b, c and d describe, by the station in `key`, of which the last one holds up to
    `end_m`; of those at one station the last one holds. Pieces that hold for less than SAME_M are passed over."""
    by_station = {number(element, key, where, 0.0): element for element in elements}
    if end_m < SAME_M:
        return ()
    found: list[Polynomial] = []
    first = min(by_station, default=0.0)
    for station in sorted(by_station, reverse=True):
        element = by_station[station]
        if end_m - station < SAME_M and (found or station > first):
            left_out["records without length"] += 1
            continue
        a, b, c, d = (number(element, name, where, 0.0) for name in "abcd")
        found.append(Polynomial(s_m=station, a=a, b=b, c=c, d=d))
        end_m = station
    return _plain(found[::-1])


def _plain(cubics: Iterable[Polynomial]) -> Cubics:
    """The pieces without those that only go on as the one before."""
    kept: list[Polynomial] = []
    for piece in cubics:
        if not kept or not _is_small(
            *(a - b for a, b in zip(_numbers(piece), _begun(kept[-1], piece.s_m), strict=True))
        ):
            kept.append(piece)
    return tuple(kept)


def holding(items: Sequence[Begun], from_m: float, to_m: float) -> Sequence[Begun]:
    """The items that hold anywhere from one station up to another; each holds from its own station, by which they are
    sorted, to the next one's. The first item holds before its station, too."""
    begun = bisect_right(items, from_m + SAME_M, key=BEGIN)
    ends = bisect_left(items, to_m - SAME_M, key=BEGIN)
    first = max(min(begun, ends) - 1, 0)
    return items[first : max(ends, first + 1)]


def piece_at(cubics: Sequence[Polynomial], s_m: float, end_m: float = math.inf) -> Polynomial | None:
    """The piece that holds at a station, of those that begin before `end_m`."""
    begun = bisect_right(cubics, s_m + SAME_M, hi=bisect_left(cubics, end_m - SAME_M, key=BEGIN), key=BEGIN)
    return cubics[max(begun - 1, 0)] if cubics else None


def value(cubics: Sequence[Polynomial], s_m: float, end_m: float = math.inf) -> float:
    """The value at a station; 0 without any piece."""
    piece = piece_at(cubics, s_m, end_m)
    return 0.0 if piece is None else _begun(piece, s_m)[0]


def slope(cubics: Sequence[Polynomial], s_m: float, end_m: float = math.inf) -> float:
    """The slope at a station; 0 without any piece."""
    piece = piece_at(cubics, s_m, end_m)
    return 0.0 if piece is None else _begun(piece, s_m)[1]


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
    kept = holding(cubics, from_m, to_m)
    return moved((*(begun_at(first, from_m) for first in kept[:1]), *kept[1:]), -from_m)


def times(
    cubics: Sequence[Polynomial],
    factor: Callable[[float, float], float],
    to_m: float,
    breaks: Iterable[float] = (),
    exact: float = EXACT,
) -> Cubics:
    """A value times another that changes slowly but at its `breaks`, from station 0 to `to_m`: cubics with its values
    and slopes at their ends, as few as it takes. `factor` takes a station, and where the cubic ends: there it is from
    below."""
    if not cubics:
        return ()
    starts = (*breaks, *(piece.s_m for piece in cubics))
    stations = sorted({0.0, to_m, *(s_m for s_m in starts if 0 < s_m < to_m)})
    found, left = [], list(pairwise(stations))[::-1]
    while left:
        low, high = left.pop()
        h = high - low
        if h < SAME_M:
            continue
        ends, e = [], min(1e-3, h / 4)
        for s_m, inward in ((low, e), (high, -e)):
            here, near, next_to = (factor(s_m + k * inward, high) for k in range(3))
            rate = (4 * near - next_to - 3 * here) / (2 * inward)
            at, bend = value(cubics, s_m, high), slope(cubics, s_m, high)
            ends.append((at * here, bend * here + at * rate))
        (a, b), (end, rise) = ends
        c, d = (3 * (end - a) / h - 2 * b - rise) / h, (b + rise - 2 * (end - a) / h) / h**2
        piece = Polynomial(s_m=low, a=a, b=b, c=c, d=d)
        places = (low + share * h for share in SHARES)
        if h <= SHORT_M or all(
            abs(value([piece], s_m) - value(cubics, s_m, high) * factor(s_m, high)) <= exact for s_m in places
        ):
            found.append(piece)
        else:
            left += [(low + h / 2, high), (low, low + h / 2)]
    return _plain(found)


def steepened(banks: Sequence[Polynomial], heights: Sequence[Polynomial], to_m: float, power: int) -> Cubics:
    """Banks with their tangents divided (`power` 1) or multiplied (-1) by the cosine of the road's climb. A file's roll
    turns a plane that climbs already, which moves its places along the road: from above its fall is steeper."""

    def factor(s_m: float, end_m: float) -> float:
        bank, rise = value(banks, s_m, end_m), math.hypot(1.0, slope(heights, s_m, end_m)) ** power
        return math.atan(math.tan(bank) * rise) / bank if abs(bank) > 1e-6 else rise

    return times(banks, factor, to_m, (piece.s_m for piece in heights))


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
