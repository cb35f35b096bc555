"""The pictures on signs, and what signs stand where: own drawings of coloured shapes, with bars for text. Metres; x to
the right, y up, seen from the front, with the middle of the board at (0, 0)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene import N_SIGN_FACES, Color

Outline = Float[np.ndarray, "n 2"]

WHITE, BLACK, RED, YELLOW = (0.72, 0.72, 0.7), (0.02, 0.02, 0.02), (0.42, 0.015, 0.02), (0.75, 0.42, 0.02)
BLUE, GREEN, BROWN, ORANGE = (0.01, 0.07, 0.33), (0.005, 0.15, 0.07), (0.14, 0.06, 0.03), (0.75, 0.22, 0.02)


@dataclass(frozen=True, eq=False)
class Patch:
    """A convex shape of one colour; later layers are in front of earlier ones."""

    outline: Outline
    color: Color

    def quads(self) -> Float[np.ndarray, "n 4 3"]:
        """Quads that cover the shape: from its middle by half a side to a corner and half a side back. z is 0."""
        corners, middle = self.outline, self.outline.mean(axis=0)
        halves = (corners + np.roll(corners, -1, axis=0)) / 2
        flat = np.stack([np.broadcast_to(middle, corners.shape), np.roll(halves, 1, axis=0), corners, halves], axis=1)
        return np.concatenate([flat, np.zeros((len(flat), 4, 1))], axis=2)


def _disc(n: int, radius_m: float, turn: float = 0.0) -> Outline:
    """A regular polygon; its first corner is up, or turned from there by a share of a corner."""
    angles = 2 * np.pi * (np.arange(n) + turn) / n
    return radius_m * np.stack([np.sin(angles), np.cos(angles)], -1)


def _rectangle(width_m: float, height_m: float, x: float = 0.0, y: float = 0.0) -> Outline:
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * [width_m / 2, height_m / 2] + [x, y]


def _arrow(x: float, y: float, size_m: float, turn_rad: float) -> list[Outline]:
    """The shaft and the head of an arrow that points up, turned clockwise."""
    shaft = _rectangle(0.18 * size_m, 0.6 * size_m, 0, -0.2 * size_m)
    head = np.array([(-0.3, 0.0), (0.3, 0.0), (0.0, 0.5)]) * size_m
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return [shape @ np.array([[c, -s], [s, c]]) + [x, y] for shape in (shaft, head)]


def board(width_m: float, height_m: float, color: Color, variant: int) -> tuple[Patch, ...]:
    """A guide board: a border, lines of text as bars, and an arrow; `variant` changes their lengths and direction (1 up
    to the left, 2 up to the right)."""
    w, h, ink = width_m, height_m, WHITE if sum(color) < 1 else BLACK
    turn = (np.pi, -np.pi / 4, np.pi / 4, 0.0)[variant % 4]
    layers = [
        Patch(_rectangle(w, h), ink),
        Patch(_rectangle(w - 0.08, h - 0.08), color),
        *(Patch(shape, ink) for shape in _arrow(-0.36 * w, -0.05 * h, 0.45 * h, turn)),
    ]
    for line in range(2 if h < 1.6 else 3):
        long_m = w * (0.56, 0.38, 0.48, 0.3, 0.52)[(2 * line + variant) % 5]
        layers.append(Patch(_rectangle(long_m, 0.13 * h, -0.2 * w + long_m / 2, (0.28 - 0.27 * line) * h), ink))
    return tuple(layers)


def _ringed(fill: Color, *ink: Outline) -> tuple[Patch, ...]:
    """A round sign with a red ring."""
    return (
        Patch(_disc(16, 0.38), RED),
        Patch(_disc(16, 0.29), fill),
        *(Patch(shape, BLACK) for shape in ink),
    )


FACES: tuple[tuple[Patch, ...], ...] = (
    _ringed(WHITE, _rectangle(0.13, 0.26, -0.1), _rectangle(0.13, 0.26, 0.1)),
    (Patch(_disc(3, 0.56), RED), Patch(_disc(3, 0.38), WHITE), Patch(_rectangle(0.08, 0.26, 0, -0.02), BLACK)),
    (Patch(_disc(4, 0.6), BLACK), Patch(_disc(4, 0.57), YELLOW), *(Patch(s, BLACK) for s in _arrow(0, 0, 0.6, 0.5))),
    (Patch(_rectangle(0.6, 0.75), BLACK), Patch(_rectangle(0.57, 0.72), WHITE),
     Patch(_rectangle(0.36, 0.09, 0, 0.22), BLACK),
     Patch(_rectangle(0.15, 0.28, -0.1, -0.1), BLACK), Patch(_rectangle(0.15, 0.28, 0.1, -0.1), BLACK)),
    (Patch(_disc(16, 0.38), BLUE), *(Patch(s, WHITE) for s in _arrow(0, 0, 0.55, 0.0))),
    (Patch(_disc(8, 0.42, 0.5), WHITE), Patch(_disc(8, 0.39, 0.5), RED), Patch(_rectangle(0.5, 0.16), WHITE)),
    (Patch(_rectangle(0.75, 0.75), WHITE), Patch(_rectangle(0.7, 0.7), BLUE),
     Patch(_rectangle(0.2, 0.42, 0, -0.02), WHITE)),
    board(2.4, 1.5, GREEN, 1),
    board(3.2, 2.0, BLUE, 2),
    board(1.8, 1.0, WHITE, 3),
    board(1.8, 1.3, BROWN, 4),
    (Patch(_rectangle(0.9, 0.9), ORANGE), *(Patch(s, BLACK) for s in _arrow(0, 0, 0.7, -np.pi / 2))),
    board(2.4, 1.5, GREEN, 2),
    board(3.2, 2.0, BLUE, 1),
    (Patch(_rectangle(0.9, 0.9), ORANGE), *(Patch(s, BLACK) for s in _arrow(0, 0, 0.7, np.pi / 2))),
    (Patch(_disc(4, 0.6), BLACK), Patch(_disc(4, 0.57), YELLOW), *(Patch(s, BLACK) for s in _arrow(0, 0, 0.6, -0.5))),
)  # fmt: skip
assert len(FACES) == N_SIGN_FACES


@dataclass(frozen=True)
class Sign:
    """What a sign tells: the numbers of its faces left and right of the traffic that it is for, of equal size. One that
    forbids entry is for those who would drive against the traffic beside it, which sees its back."""

    left: int
    right: int
    forbids_entry: bool = False


# Boards and warnings that point aside stand where they point to; the orange arrow leads back to the road.
SIGNS: tuple[Sign, ...] = (
    Sign(1, 1),
    Sign(2, 2),
    Sign(16, 3),
    Sign(4, 4),
    Sign(5, 5),
    Sign(6, 6, forbids_entry=True),
    Sign(7, 7),
    Sign(8, 13),
    Sign(14, 9),
    Sign(10, 10),
    Sign(11, 11),
    Sign(15, 12),
)
