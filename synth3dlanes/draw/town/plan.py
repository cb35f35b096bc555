"""Plans of streets and connectors: pieces of lines, arcs, spirals and cubics, each from where the previous one ends.
World frame, metres and radians; curvature is positive to the left."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.line_forms import line_of
from synth3dlanes.scene.road_map import PlanPiece
from synth3dlanes.system.arrays import Points2, Scalars

# Share of a turn's angle in its two spirals; the rest is in the arc between them.
SPIRAL_SHARE = 0.4
# Turns between these angles have an arc; others are one cubic.
ARC_FROM_RAD, ARC_TO_RAD = 0.2, 2.8
POINT_DECIMALS, ANGLE_DECIMALS = 6, 9
CUBIC_NODES = 400


class PlanPose(NamedTuple):
    """A place and a heading (counter-clockwise from world x)."""

    x: float
    y: float
    heading: float

    def moved(self, ahead_m: float, left_m: float = 0.0, turn_rad: float = 0.0) -> "PlanPose":
        """The pose at a distance ahead and to the left of this one, turned counter-clockwise."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        x, y = self.x + ahead_m * cos - left_m * sin, self.y + ahead_m * sin + left_m * cos
        return PlanPose(float(x), float(y), self.heading + turn_rad)

    def seen(self, other: "PlanPose") -> tuple[float, float, float]:
        """How far another pose is ahead, to the left, and turned to the left, in (-pi, pi]."""
        cos, sin, dx, dy = np.cos(self.heading), np.sin(self.heading), other.x - self.x, other.y - self.y
        return float(dx * cos + dy * sin), float(dy * cos - dx * sin), wrapped(other.heading - self.heading)


def wrapped(angle_rad: float) -> float:
    """The same direction in (-pi, pi]."""
    return float(np.pi - (np.pi - angle_rad) % (2 * np.pi))


def poses(pieces: Sequence[PlanPiece], s: Scalars) -> tuple[Points2, Scalars]:
    """Points and headings at stations, which are lengths from the first piece's start."""
    starts = np.cumsum([0.0, *(piece.length_m for piece in pieces[:-1])])
    which = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, None)
    points, headings = np.zeros((len(s), 2)), np.zeros(len(s))
    for i in np.unique(which):
        at, piece, line = which == i, pieces[i], line_of(pieces[i])
        own = s[at] - starts[i]
        if piece.u is not None:
            parameters = np.linspace(0, piece.parameter_end, CUBIC_NODES + 1)
            steps = np.linalg.norm(np.diff(line.frames(parameters).points_world, axis=0), axis=1)
            own = np.interp(own, np.concatenate([[0.0], np.cumsum(steps)]), parameters)
        frames = line.frames(own)
        points[at] = frames.points_world
        headings[at] = np.arctan2(frames.normals[:, 0], -frames.normals[:, 1])
    return points, headings


def end_of(pieces: Sequence[PlanPiece]) -> PlanPose:
    """The pose at the end of the last piece."""
    last = pieces[-1]
    frames = line_of(last).frames(np.array([last.length_m if last.u is None else last.parameter_end]))
    normal = frames.normals[0]
    heading = float(np.arctan2(normal[0], -normal[1]))
    return PlanPose(float(frames.points_world[0, 0]), float(frames.points_world[0, 1]), heading)


def sampled(pieces: Sequence[PlanPiece], step_m: float) -> Float[np.ndarray, "n 2"]:
    """Points along pieces, both ends included, no farther apart than a step."""
    length = sum(piece.length_m for piece in pieces)
    return poses(pieces, np.linspace(0, length, 2 + int(length / step_m)))[0]


def chain(start: PlanPose, parts: Iterable[tuple[float, float, float]]) -> tuple[PlanPiece, ...]:
    """Pieces by length and curvature at both ends, one after the other; those without a length are left out."""
    found: list[PlanPiece] = []
    at = start
    for length_m, curvature, curvature_end in parts:
        if length_m < 1e-6:
            continue
        piece = _piece(at, length_m, curvature=round(curvature, 12), curvature_end=round(curvature_end, 12))
        found.append(piece)
        at = end_of(found)
    return tuple(found)


def connection(start: PlanPose, end: PlanPose, widest_m: float = np.inf) -> tuple[PlanPiece, ...]:
    """From one pose to another without a corner: a line, a turn of spiral, arc and spiral, and a line, where the lines
    through both meet between them; else one cubic. The turn is no longer than a circle of the radius `widest_m`."""
    ahead, left, turn = start.seen(end)
    if ARC_FROM_RAD < abs(turn) < ARC_TO_RAD:
        # Lengths from both ends to where the lines meet.
        after_m = left / np.sin(turn)
        before_m = ahead - after_m * np.cos(turn)
        angle = abs(turn)
        tangent_m = min(before_m, after_m, widest_m * float(np.tan(angle / 2)))
        if tangent_m > 0:
            unit = _turn(PlanPose(0.0, 0.0, 0.0), angle, 1.0)
            reach = end_of(unit)
            radius_m = tangent_m / (reach.x - reach.y / np.tan(angle))
            own = [
                (before_m - tangent_m, 0.0, 0.0),
                *_turn_parts(angle, radius_m, float(np.sign(turn))),
                (after_m - tangent_m, 0.0, 0.0),
            ]
            return chain(start, own)
    return (_cubic(start, ahead, left, turn),)


def _turn_parts(angle: float, radius_m: float, sign: float) -> list[tuple[float, float, float]]:
    curvature = sign / radius_m
    spiral_m, arc_m = SPIRAL_SHARE * angle * radius_m, (1 - SPIRAL_SHARE) * angle * radius_m
    return [(spiral_m, 0.0, curvature), (arc_m, curvature, curvature), (spiral_m, curvature, 0.0)]


def _turn(start: PlanPose, angle: float, radius_m: float) -> tuple[PlanPiece, ...]:
    return chain(start, _turn_parts(angle, radius_m, 1.0))


def _cubic(start: PlanPose, ahead: float, left: float, turn: float) -> PlanPiece:
    """The Hermite cubic between two poses, the second given as `PlanPose.seen` gives it."""
    pull = float(np.hypot(ahead, left))
    du, dv = pull * float(np.cos(turn)), pull * float(np.sin(turn))
    u = (0.0, pull, 3 * ahead - 2 * pull - du, -2 * ahead + pull + du)
    v = (0.0, 0.0, 3 * left - dv, -2 * left + dv)
    parameters = np.linspace(0, 1, CUBIC_NODES + 1)
    points = np.stack([np.polyval(u[::-1], parameters), np.polyval(v[::-1], parameters)], -1)
    length_m = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return _piece(start, length_m, u=_rounded(u), v=_rounded(v))


def _rounded(values: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(round(value, ANGLE_DECIMALS) for value in values)


def _piece(at: PlanPose, length_m: float, **fields: Any) -> PlanPiece:
    return PlanPiece(
        x_m=round(at.x, POINT_DECIMALS),
        y_m=round(at.y, POINT_DECIMALS),
        heading_rad=round(at.heading, ANGLE_DECIMALS),
        length_m=round(length_m, POINT_DECIMALS),
        **fields,
    )
