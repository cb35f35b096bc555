"""The paint of the delimiters as strips over the road: dashes, Botts' dots, double lines, missing stretches. World
frame."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.polylines import lengths_along, parted
from synth3dlanes.labels.labels import Marking, PaintColor, Pair
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.terrain import gradient_at, height_at
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import Points3, Scalars
from synth3dlanes.system.streams import Streams
from synth3dlanes.world.camera import Sector
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.meshes import Mesh, grid, is_facing_up, where

# Height of the paint over the road, by distance: more than the road's faces can rise between two rows.
PAINT_LIFT_M = (0.0015, 0.002, 0.008, 0.04, 0.12, 2.0)
PAINT_LIFT_AT_M = (0.0, 40.0, 80.0, 160.0, 250.0, 4000.0)
# Greatest height of another road's pavement over a hollow, between its columns, that covers no paint.
HOLLOW_M = 0.001
# Upper limit of the ratio of paint height to camera height by which paint is moved sideways (see `_floating`).
MAX_SHARE = 0.05
# The line's direction is measured over this length.
ALONG_M = 0.01
# Farther away than this, dashes and gaps are much smaller than a pixel. They are replaced by a continuous line whose
# width is reduced to the share of paint.
DASHES_M = 420.0
# Botts' dots: their number in place of a dash, diameter and height, and the distance up to which they are single discs;
# beyond it they merge into dashes that cover the same share of the image.
DOTS, DOT_M, DOT_HEIGHT_M, DOTS_M = 4, 0.1, 0.018, 60.0
EYE_M = 1.5  # the camera's height over the road, for the share that far dots cover
# Half the side of a regular octagon, and places of the rows of a disc, in radii.
OCTAGON = 2**0.5 - 1
DISC_ROWS = np.array([-1, -OCTAGON, OCTAGON, 1])
# Missing stretches are 3 to 12 m long and are drawn up to this length of a line to either side of station 0.
GONE_M, GONE_REACH_M = (3.0, 12.0), 600.0

NO_PAINT = Mesh(np.zeros((0, 3)), np.zeros((0, 4), dtype=int), np.zeros((0, 2)), np.zeros(0, dtype=int))

Intervals = Float[np.ndarray, "_ 2"]
Lengths = Float[np.ndarray, " _"]


class Stripe(NamedTuple):
    """One stripe of a line: the offset of its centre from the line's own, to the right as the host drives, and its
    pattern."""

    right_m: float
    marking: Marking


class StripRows(NamedTuple):
    """The rows of a line's strip: stations, how far they are from the host, whether the strip after each row is
    painted, the strip's width as a share of the line's, and the height of its surface over paint (of dots)."""

    s: Scalars
    away_m: Scalars
    painted: Bool[np.ndarray, " m"]
    share: Scalars
    raised_m: Scalars


def paint_meshes(
    ground: Ground,
    lines: Sequence[LaneCurve],
    eye_world: Float[np.ndarray, "3"],
    streams: Streams,
    seen: Sector | None = None,
) -> dict[str, Mesh]:
    """The paint of every delimiter in `lines`, by id, corrected for parallax so that it looks in place from the eye.
    Meshes of lines out of what is `seen` may be empty."""
    drawn = ground.paved.drawn([line for line in lines if line.kind == "delimiter"], seen)
    found = dict.fromkeys((line.id for line in drawn), NO_PAINT)
    return found | _paint(ground, [line for line, own in drawn.items() if own], eye_world, streams)


def paint_color(line: LaneCurve, markings: Markings) -> PaintColor | None:
    """The colour of a delimiter's paint; None for a centre line."""
    if line.kind != "delimiter":
        return None
    if line.paint is not None:
        return "yellow" if line.paint.yellow else "white"
    return "yellow" if markings.left_yellow and line.is_inner else "white"


def is_double(line: LaneCurve, markings: Markings) -> bool | None:
    """Whether a delimiter is painted as two stripes; None for a centre line."""
    if line.paint is not None:
        return line.paint.is_double
    return None if line.kind != "delimiter" else markings.left_double and line.is_inner and line.marking == "solid"


def is_dotted(line: LaneCurve, markings: Markings) -> bool:
    """Whether a delimiter consists of Botts' dots."""
    if line.paint is not None:
        return line.paint.is_dotted
    return markings.dots and line.marking == "dashed"


def line_width_m(line: LaneCurve, markings: Markings) -> float:
    """Width of a delimiter's stripes, or diameter of its dots."""
    width_m = markings.width_m if line.paint is None else line.paint.width_m
    return DOT_M if is_dotted(line, markings) else width_m


def pair_of(line: LaneCurve, markings: Markings) -> Pair | None:
    """The stripes of a double line from the left as the host drives, if they differ."""
    if line.paint is not None:
        return line.paint.pair
    return markings.left_pair if is_double(line, markings) and markings.left_pair != "same" else None


def stripes(line: LaneCurve, markings: Markings) -> tuple[Stripe, ...]:
    """The stripes from the left as the host drives; the gap of a double line is as wide as a stripe."""
    if not is_double(line, markings):
        return (Stripe(0.0, line.marking),)
    pair, width_m = pair_of(line, markings), line_width_m(line, markings)
    return (
        Stripe(-width_m, "dashed" if pair == "dashed_solid" else line.marking),
        Stripe(width_m, "dashed" if pair == "solid_dashed" else line.marking),
    )


def _paint(
    ground: Ground, curves: Sequence[LaneCurve], eye_world: Float[np.ndarray, "3"], streams: Streams
) -> dict[str, Mesh]:
    """The paint of curves by their ids, from places on all of them at once."""
    markings, to_right = ground.markings, int(ground.network.rightward)
    of = [(curve, *stripe) for curve in curves for stripe in stripes(curve, markings)[::to_right]]
    lines = [curve for curve, _, _ in of]
    rows = painted_rows(ground, [(curve, marking) for curve, _, marking in of], streams)
    offsets = [to_right * right_m + np.array([-0.5, 0.5]) * line_width_m(curve, markings) for curve, right_m, _ in of]
    # Behind its end a curve has no points.
    steps_m = [
        np.where(own.s + ALONG_M > curve.end_m, -ALONG_M, ALONG_M) for curve, own in zip(lines, rows, strict=True)
    ]
    stations = [np.concatenate([own.s, own.s + step_m]) for own, step_m in zip(rows, steps_m, strict=True)]
    pairs = [at.reshape(2, -1, 2, 3) for at in ground.paved.points_beside(lines, stations, offsets)]
    sides, beside = np.concatenate([np.zeros((2, 0, 2, 3)), *pairs], axis=1)
    share, away_m, raised_m = (
        np.concatenate([np.zeros(0), *(getattr(own, name) for own in rows)]) for name in ("share", "away_m", "raised_m")
    )
    over_m = [_over_hollows_m(ground, curve, own.s) for curve, own in zip(lines, rows, strict=True)]
    along = np.sign(np.concatenate([np.zeros(0), *steps_m]))[:, None] * (beside - sides).mean(axis=1)
    middle = sides.mean(axis=1, keepdims=True)
    lift_m = np.interp(away_m, PAINT_LIFT_AT_M, PAINT_LIFT_M) + raised_m + np.concatenate([np.zeros(0), *over_m])
    floating = _floating(eye_world, middle + share[:, None, None] * (sides - middle), along, lift_m)
    meshes = dict[str, list[Mesh]]()
    for curve, own, offset, at in zip(
        lines, rows, offsets, parted(floating, [len(own.s) for own in rows]), strict=True
    ):
        uv = np.stack(np.broadcast_arrays(offset[None, :], own.s[:, None]), -1)
        mesh = grid(at, uv, np.zeros(1, dtype=int))
        # Where a line goes on along another road, a face of a few millimetres may fold back over the previous one.
        kept = own.painted & is_facing_up(mesh)
        mesh = replace(mesh, faces=mesh.faces[kept], material=mesh.material[kept])
        meshes.setdefault(curve.id, []).append(mesh)
    return {name: where(_joined(own), ground.paved.is_built) for name, own in meshes.items()}


def _over_hollows_m(ground: Ground, curve: LaneCurve, s: Scalars) -> Scalars:
    """How far the pavement of another road, which is straight between its columns, lies over hollows of the terrain
    under a line."""
    if not ground.network.has_partings:
        return np.zeros(len(s))
    road, xy, terrain = curve.pieces[0].road, curve.xy_world(s), ground.network.terrain
    aside = curve.points_beside(s, np.full(len(s), ground.paved.column_m / 2))[:, :2] - xy
    over_m = (height_at(terrain, xy + aside) + height_at(terrain, xy - aside)) / 2 - height_at(terrain, xy)
    hidden = over_m > HOLLOW_M
    hidden[hidden] = ground.network.is_on_other(road, xy[hidden], s[hidden])
    return np.where(hidden, over_m, 0.0)


def _floating(
    eye_world: Float[np.ndarray, "3"],
    sides: Float[np.ndarray, "n 2 3"],
    along: Float[np.ndarray, "n 3"],
    lift_m: Scalars,
) -> Float[np.ndarray, "n 2 3"]:
    """A stripe raised by `lift_m` over the road, and moved across the line so that the eye sees it where the line is:
    without this, parallax would show it beside the line. `along` is the line's direction."""
    across = sides[:, 1] - sides[:, 0]
    normal = np.cross(across, along)
    to_eye = eye_world - sides.mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        eye_over_road_m = np.clip((to_eye * normal).sum(axis=-1) / normal[:, 2], 0, None)
        # lift / height, which falls to 0 where the eye is near the road's plane or below it
        share = lift_m * eye_over_road_m / (eye_over_road_m**2 + (lift_m / MAX_SHARE) ** 2)
        aside = (to_eye * across).sum(axis=-1) / (across * across).sum(axis=-1)
    moved = np.where(np.isfinite(share * aside), share * aside, 0.0)[:, None] * across
    return np.asarray(sides + (moved + lift_m[:, None] * [0, 0, 1])[:, None])


def towards_eye(
    ground: Ground, points_world: Float[np.ndarray, "n 3"], eye_world: Float[np.ndarray, "3"], share_of_lift: float = 1
) -> Float[np.ndarray, "n 3"]:
    """Points of the road raised as paint is, along their lines of sight, so that parallax does not move them."""
    slope = gradient_at(ground.network.terrain, points_world[:, :2])
    to_eye = eye_world - points_world
    eye_over_road_m = np.clip(to_eye[:, 2] - (to_eye[:, :2] * slope).sum(axis=1), 0, None)
    lift_m = share_of_lift * np.interp(ground.way.away_at(points_world[:, :2]), PAINT_LIFT_AT_M, PAINT_LIFT_M)
    # lift / height, which falls to 0 where the eye is near the road's plane or below it
    share = lift_m * eye_over_road_m / (eye_over_road_m**2 + (lift_m / MAX_SHARE) ** 2)
    return np.asarray(points_world + share[:, None] * to_eye)


def _joined(meshes: list[Mesh]) -> Mesh:
    first = np.cumsum([0, *(len(mesh.vertices_world) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices_world for mesh in meshes]),
        np.concatenate([mesh.faces + n for mesh, n in zip(meshes, first, strict=False)]),
        np.concatenate([mesh.uv_m for mesh in meshes]),
        np.concatenate([mesh.material for mesh in meshes]),
    )


def painted_rows(ground: Ground, stripes: Sequence[tuple[LaneCurve, Marking]], streams: Streams) -> list[StripRows]:
    """Rows of stripes of lines, each with its pattern, with a row at every end of paint. Lengths are measured along a
    line from station 0, so that dashes and gaps do not move with the camera."""
    curves = [curve for curve, _ in stripes]
    given = [_within(curve, rows) for curve, rows in zip(curves, ground.paved.curve_rows(curves), strict=True)]
    away = ground.way.away_on(curves, given)
    near = [_near(*at) for at in zip(given, away, strict=True)]
    rows = {curve: at.rows for curve, at in zip(curves, near, strict=True)}
    points = dict(zip(rows, ground.network.points_along(rows), strict=True))
    drawn = [
        _painted(ground.markings, *stripe, at, points[stripe[0]], streams)
        for stripe, at in zip(stripes, near, strict=True)
    ]
    # Between rows distances are nearly even.
    away = [np.interp(own.s, s, own_m) for own, s, own_m in zip(drawn, given, away, strict=True)]
    return [_narrowed(ground.markings, *at) for at in zip(stripes, drawn, away, strict=True)]


class _NearRows(NamedTuple):
    """Rows of a line that may have ends of paint, how far these are from the host, and those before and behind them."""

    rows: Scalars
    away_m: Scalars
    before: Scalars
    behind: Scalars


class _DrawnRows(NamedTuple):
    """Rows of a stripe, the length along its line at each, whether the strip after it is painted, and the middles of
    its dots."""

    s: Scalars
    length_m: Scalars
    painted: Bool[np.ndarray, " m"]
    dots: Lengths


def _within(curve: LaneCurve, rows: Scalars) -> Float[np.ndarray, " m"]:
    """The rows that are on a curve, and its ends."""
    low, high = max(rows[0], curve.start_m), min(rows[-1], curve.end_m)
    return np.array([low, low]) if low >= high else np.concatenate([[low], rows[(rows > low) & (rows < high)], [high]])


def _near(rows: Scalars, away_m: Scalars) -> _NearRows:
    is_near = away_m <= DASHES_M
    first, last = np.flatnonzero(is_near)[[0, -1]].tolist() if is_near.any() else (0, len(rows) - 1)
    own = slice(first, last + 1)
    return _NearRows(rows[own], away_m[own], rows[:first], rows[last + 1 :])


def _painted(
    markings: Markings, curve: LaneCurve, marking: Marking, near: _NearRows, points_world: Points3, streams: Streams
) -> _DrawnRows:
    """The rows of a stripe, by points at those that are near."""
    rows, rows_away_m, before, behind = near
    length = lengths_along(points_world)
    length -= np.interp(0.0, rows, length)
    dashes, gone = _dashes(markings, marking, length), _gone(markings, streams(f"missing_paint/{curve.id}"))
    dots = np.zeros(0)
    if is_dotted(curve, markings):
        dots, dashes = _dots(markings, dashes, length, rows_away_m)
    ends = np.concatenate([dashes.ravel(), gone.ravel(), (dots[:, None] + DISC_ROWS[1:3] * DOT_M / 2).ravel()])
    ends = np.interp(ends[(ends > length[0]) & (ends < length[-1])], length, rows)
    rows_all = np.unique(np.concatenate([rows, ends]))
    middle = np.interp((rows_all[1:] + rows_all[:-1]) / 2, rows, length)
    painted = _inside(dashes, middle) & ~_inside(gone, middle)
    is_painted = np.full(max(len(before), len(behind)), markings.missing < 1)
    s = np.concatenate([before, rows_all, behind])
    painted = np.concatenate([is_painted[: len(before)], painted, is_painted[: len(behind)]])
    return _DrawnRows(s, np.interp(s, rows, length), painted, dots)


def _narrowed(markings: Markings, stripe: tuple[LaneCurve, Marking], rows: _DrawnRows, away_m: Scalars) -> StripRows:
    """The rows of a stripe, far ones as narrow as paint covers of them."""
    (curve, marking), n = stripe, len(rows.s)
    share, raised_m = _disc(rows.dots, rows.length_m) if len(rows.dots) else (np.ones(n), np.zeros(n))
    if is_dotted(curve, markings):
        share = np.where(away_m > DOTS_M, np.minimum(share, _dots_cover(markings, away_m)), share)
    painted_share = (markings.dash_fraction if marking == "dashed" else 1.0) * (1 - markings.missing)
    share = np.where(away_m > DASHES_M, painted_share * share, share)
    return StripRows(rows.s, away_m, rows.painted, share, raised_m)


def _dashes(markings: Markings, marking: Marking, length: Scalars) -> Intervals:
    """Painted intervals along a line's length according to a marking."""
    if marking != "dashed":
        return np.array([[-np.inf, np.inf]])
    cycle, fraction = markings.dash_cycle_m, markings.dash_fraction
    numbers = np.arange(np.floor(length[0] / cycle), np.ceil(length[-1] / cycle) + 1)
    return np.stack([numbers, numbers + fraction], axis=1) * cycle


def _dots_per_dash(markings: Markings) -> int:
    return int(np.clip(markings.dash_cycle_m * markings.dash_fraction / (2 * DOT_M), 1, DOTS))


def _dots(markings: Markings, dashes: Intervals, length: Scalars, away_m: Scalars) -> tuple[Lengths, Intervals]:
    """The centres of the dots in place of near dashes, and the painted intervals with these dots. `away_m` is the
    distance from the host at each `length`."""
    is_near = np.interp(dashes[:, 0], length, away_m) < DOTS_M
    first, last = dashes[is_near].T[:, :, None] + np.array([[DOT_M / 2], [-DOT_M / 2]])[:, None]
    centers = (first + (last - first) * np.linspace(0, 1, _dots_per_dash(markings))).ravel()
    painted = np.concatenate([centers[:, None] + np.array([-0.5, 0.5]) * DOT_M, dashes[~is_near]])
    return centers, painted[np.argsort(painted[:, 0])]


def _disc(dots: Lengths, at: Scalars) -> tuple[Scalars, Scalars]:
    """Width, as a share of the diameter, and height of octagonal discs at places along the line; width 1 elsewhere."""
    radii = 2 / DOT_M * np.abs(at[:, None] - dots).min(axis=1)
    is_disc, is_top = radii < 1 + 1e-6, radii < OCTAGON + 1e-6
    return np.where(is_disc, np.clip(2**0.5 - radii, OCTAGON, 1), 1.0), np.where(is_top, DOT_HEIGHT_M, 0.0)


def _dots_cover(markings: Markings, away_m: Scalars) -> Scalars:
    """The share of a dash as wide as a dot that its dots cover in the image, their height included."""
    area_m2 = _dots_per_dash(markings) * 2 * OCTAGON * DOT_M**2
    seen = 1 + DOT_HEIGHT_M / DOT_M * away_m / EYE_M
    return np.minimum(1.0, seen * area_m2 / (DOT_M * markings.dash_cycle_m * markings.dash_fraction))


def _gone(markings: Markings, rng: np.random.Generator) -> Intervals:
    """Intervals of missing paint: one stretch at a random place in each period of stretch / share metres."""
    share = markings.missing
    if share == 0:
        return np.zeros((0, 2))
    gone_m = rng.uniform(*GONE_M, int(np.ceil(2 * GONE_REACH_M * share / GONE_M[0])))
    period_m = gone_m / share
    start_m = np.cumsum(period_m) - period_m - GONE_REACH_M + rng.uniform(0, 1, len(gone_m)) * (period_m - gone_m)
    return np.stack([start_m, start_m + gone_m], axis=1)


def _inside(intervals: Intervals, at: Float[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Which places lie in one of the intervals; the intervals are sorted and disjoint."""
    if not len(intervals):
        return np.zeros(at.shape, dtype=bool)
    before = np.clip(np.searchsorted(intervals[:, 0], at, side="right") - 1, 0, None)
    return np.asarray((at >= intervals[before, 0]) & (at < intervals[before, 1]))
