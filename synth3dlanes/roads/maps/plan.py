"""The plan of a road of a given map: its reference line from above, and places beside it. Frame of the map, metres."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from xml.etree.ElementTree import Element

import numpy as np

from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import SAME_M
from synth3dlanes.roads.maps.document import number
from synth3dlanes.scene.road_map import PlanPiece
from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import MAX_NUMBER

# Greatest gap between pieces; curves shorter than POINT_M are points.
GAP_M, POINT_M = 1.0, 1e-6
# Pieces longer than this are divided.
LONG_M = 1000.0
# Points at which the length of a cubic is measured.
N_LENGTH = 257


def read_plan(road: Element, where: str, origin: tuple[float, float], left_out: Counter[str]) -> tuple[PlanPiece, ...]:
    """The pieces of a road's `planView` that are no shorter than SAME_M: none of a road that is shorter itself.
    `origin` is where (0, 0) of the result lies in the file. Raises FormatError for a road without geometry, with an
    unknown one or with a gap."""
    geometries = sorted(road.iterfind("planView/geometry"), key=lambda at: number(at, "s", where, 0.0))
    lengths = [number(geometry, "length", where) for geometry in geometries]
    if not geometries or min(lengths) < 0:
        got = f"{min(lengths):g} m" if lengths else "none"
        raise FormatError(f"{where}: planView: expected pieces of 0 m or more, got {got}")
    if sum(lengths) < SAME_M:
        return ()
    kept = [at for at in zip(geometries, lengths, strict=True) if at[1] >= SAME_M]
    if not kept:
        raise FormatError(f"{where}: planView: expected a piece of {SAME_M:g} m or more, got {max(lengths):g} m")
    left_out["pieces of plans without length"] += len(geometries) - len(kept)
    pieces = [part for geometry, length in kept for part in _parts(_piece(geometry, length, where, origin))]
    for one, other in pairwise(pieces):
        x, y, _ = plan_points([one], np.array([one.length_m]))[0]
        gap = float(np.hypot(x - other.x_m, y - other.y_m))
        if not gap <= GAP_M:
            raise FormatError(f"{where}: planView: expected geometry without gaps, got one of {gap:.3g} m")
    return tuple(pieces)


def _parts(piece: PlanPiece) -> Iterator[PlanPiece]:
    """A piece, one of a kilometre and more in parts: a scene keeps those near its host."""
    n = int(piece.length_m / LONG_M) if piece.u is None else 0
    if not n:
        yield piece
        return
    ends = np.linspace(0, piece.length_m, 2 * n + 1)
    bends = np.interp(ends, (0, piece.length_m), (piece.curvature, piece.curvature_end)).tolist()
    for (x, y, heading), (low, high), (bend, bend_end) in zip(
        plan_points([piece], ends[:-1]).tolist(), pairwise(ends.tolist()), pairwise(bends), strict=True
    ):
        start = {"x_m": x, "y_m": y, "heading_rad": heading, "length_m": high - low}
        yield PlanPiece(**start, curvature=bend, curvature_end=bend_end)


def _piece(geometry: Element, length: float, where: str, origin: tuple[float, float]) -> PlanPiece:
    x, y = (number(geometry, key, where) - at for key, at in zip("xy", origin, strict=True))
    if not max(abs(x), abs(y)) <= MAX_NUMBER:
        raise FormatError(
            f"{where}: planView: expected places at most {MAX_NUMBER / 1000:g} km from ({origin[0]:g}, {origin[1]:g}), "
            f"got one at ({x + origin[0]:g}, {y + origin[1]:g})"
        )
    start = {"x_m": x, "y_m": y, "heading_rad": number(geometry, "hdg", where), "length_m": length}
    for form in geometry:
        if form.tag == "line":
            return PlanPiece(**start)
        if form.tag == "arc":
            curvature = number(form, "curvature", where)
            return PlanPiece(**start, curvature=curvature, curvature_end=curvature)
        if form.tag == "spiral":
            ends = {"curvature": number(form, "curvStart", where), "curvature_end": number(form, "curvEnd", where)}
            return PlanPiece(**start, **ends)
        if form.tag == "poly3":
            along, aside = (0.0, 1.0, 0.0, 0.0), _four(form, "", where)
            return PlanPiece(**start, u=along, v=aside, parameter_end=_parameter_at(along, aside, length))
        if form.tag == "paramPoly3":
            end = 1.0 if form.get("pRange", "normalized") == "normalized" else length
            u, v = (_four(form, axis, where) for axis in "UV")
            if not _lengths(u, v, np.linspace(0, end, N_LENGTH))[-1] > POINT_M:
                raise FormatError(f"{where}: geometry: paramPoly3: expected a curve with a length, got a point")
            return PlanPiece(**start, u=u, v=v, parameter_end=end)
    raise FormatError(f"{where}: geometry: expected line, arc, spiral, poly3 or paramPoly3, got none of them")


def _four(form: Element, axis: str, where: str) -> tuple[float, float, float, float]:
    a, b, c, d = (number(form, letter + axis, where) for letter in "abcd")
    return a, b, c, d


def _parameter_at(u: Sequence[float], v: Sequence[float], length: float) -> float:
    """The parameter up to which a cubic has this length."""
    end = length
    # A curve over u is never shorter than u.
    p = np.linspace(0, end, N_LENGTH)
    return float(np.interp(length, _lengths(u, v, p), p))


def _lengths(u: Sequence[float], v: Sequence[float], p: Scalars) -> Scalars:
    """The lengths of a cubic from its start to parameters that grow."""
    middle, half = (p[1:] + p[:-1]) / 2, np.diff(p) / 2
    # Gauss's three nodes in each step.
    at = middle[:, None] + half[:, None] * np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
    speed = np.hypot(*(c[1] + at * (2 * c[2] + at * 3 * c[3]) for c in (u, v)))
    return np.concatenate([[0.0], np.cumsum((speed * np.array([5, 8, 5]) / 9).sum(axis=1) * half)])


def places(pieces: Sequence[PlanPiece], s: Scalars, t: Scalars) -> Points2:
    """Places `t` metres to the left of stations."""
    x, y, heading = plan_points(pieces, s).T
    return np.column_stack([x - t * np.sin(heading), y + t * np.cos(heading)])
