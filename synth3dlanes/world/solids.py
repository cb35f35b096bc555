"""Bodies of flat coloured quads, made of boxes, tubes and sweeps, and upright frames. World frame, metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import cross
from synth3dlanes.scene.things import KINDS
from synth3dlanes.system.arrays import Points3

QuadCorners = Float[np.ndarray, "f 4 3"]

# The semantic names of bodies.
SURFACES = tuple(kind.name for kind in KINDS if kind.series == "structure")
# How far bodies reach into the ground, so that none floats on a slope.
SINK_M = 0.4
# Linear red, green and blue, and gloss.
METAL, DARK_METAL = (0.36, 0.37, 0.38, 0.5), (0.2, 0.21, 0.22, 0.4)
WHITE, BLACK = (0.7, 0.7, 0.68, 0.3), (0.02, 0.02, 0.02, 0.2)
# The gloss of what throws headlights back, by which it is known at night: faces of signs, and reflectors of posts.
SHEETING_GLOSS, REFLECTOR_GLOSS = 0.55, 1.0
# The gloss of lit lenses of signals, by which they are known.
LIT_GLOSS = 1.0


@dataclass(frozen=True, eq=False)
class Body:
    """One structure: its semantic name, one of SURFACES, its quads, each with a colour (linear red, green, blue, and
    gloss), and the points where it stands on the ground."""

    kind: str
    surface: str
    corners_world: QuadCorners
    colors: Float[np.ndarray, "f 4"]
    feet_world: Points3


class Quads:
    """Collects the quads of one body."""

    def __init__(self, kind: str, surface: str) -> None:
        self.kind, self.surface = kind, surface
        self.corners: list[QuadCorners] = []
        self.colors: list[Float[np.ndarray, "f 4"]] = []
        self.feet: list[Points3] = []

    def add(self, corners: QuadCorners, color: Sequence[float] | Float[np.ndarray, "f 4"]) -> None:
        """Quads of one colour, or of one each."""
        colors = color if isinstance(color, np.ndarray) else np.array(_glossy(color), dtype=float)
        self.corners.append(corners)
        self.colors.append(np.broadcast_to(colors, (len(corners), 4)))

    def box(self, frame: "GroundFrame", low: Sequence[float], high: Sequence[float], color: Sequence[float]) -> None:
        """A box between two corners of a frame."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        walls = [[(*a, z0), (*b, z0), (*b, z1), (*a, z1)] for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)]
        ends = [[(*corner, z) for corner in ring] for z in (z0, z1)]
        self.add(frame.world(np.array(walls + ends)), color)

    def tube(
        self, ends_world: Float[np.ndarray, "2 3"], radii_m: tuple[float, float], color: Sequence[float], n: int = 6
    ) -> None:
        """The side of a tapered prism with n faces between two points."""
        along = ends_world[1] - ends_world[0]
        along /= np.linalg.norm(along)
        across = cross(along, np.array([1.0, 0, 0] if abs(along[0]) < 0.7 else [0, 1.0, 0]))
        across /= np.linalg.norm(across)
        angles = 2 * np.pi * (np.arange(n + 1) + 0.5) / n
        ring = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * cross(along, across)
        rings = ends_world[:, None] + np.array(radii_m)[:, None, None] * ring
        self.sweep(rings, color)

    def sweep(self, rows: Float[np.ndarray, "r c 3"], color: Sequence[float]) -> None:
        """Quads between consecutive rows and columns of points."""
        corners = np.stack([rows[:-1, :-1], rows[:-1, 1:], rows[1:, 1:], rows[1:, :-1]], axis=2)
        self.add(corners.reshape(-1, 4, 3), color)

    def body(self) -> Body:
        """The body of all quads that were added."""
        return Body(
            self.kind,
            self.surface,
            np.concatenate([*self.corners, np.zeros((0, 4, 3))]),
            np.concatenate([*self.colors, np.zeros((0, 4))]),
            np.concatenate([*self.feet, np.zeros((0, 3))]),
        )


@dataclass(frozen=True, eq=False)
class GroundFrame:
    """A place on the ground: x to the right as the host drives, y forward, z up; `outward` is 1 where the road lies on
    the left of it, and -1 where it lies on the right."""

    origin: Float[np.ndarray, "3"]
    forward: Float[np.ndarray, "2"]
    outward: float = 1.0

    def world(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """World points of points in this frame."""
        fx, fy = self.forward
        x, y = points[..., 0], points[..., 1]
        return self.origin + np.stack([x * fy + y * fx, y * fy - x * fx, points[..., 2]], -1)

    def turned_round(self) -> "GroundFrame":
        """The same place as one sees it who drives the other way."""
        return GroundFrame(self.origin, -self.forward, -self.outward)

    def of_world(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points of this frame of world points."""
        fx, fy = self.forward
        x, y, z = np.moveaxis(points - self.origin, -1, 0)
        return np.stack([x * fy - y * fx, x * fx + y * fy, z], -1)


def _glossy(color: Sequence[float]) -> tuple[float, ...]:
    return tuple(color) if len(color) == 4 else (*color, 0.1)
