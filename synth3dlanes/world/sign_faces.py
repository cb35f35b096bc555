"""The pictures on signs, and what signs stand where: own drawings of coloured shapes, with bars for text. Metres; x to
the right, y up, seen from the front, with the middle of the board at (0, 0)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene.roadside import N_SIGN_FACES
from synth3dlanes.scene.traffic_elements import FaceKind, SignKind
from synth3dlanes.system.schema import Color

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


def disc(n: int, radius_m: float, turn: float = 0.0) -> Outline:
    """A regular polygon; its first corner is up, or turned from there by a share of a corner."""
    angles = 2 * np.pi * (np.arange(n) + turn) / n
    return radius_m * np.stack([np.sin(angles), np.cos(angles)], -1)


def _rectangle(width_m: float, height_m: float, x: float = 0.0, y: float = 0.0) -> Outline:
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * [width_m / 2, height_m / 2] + [x, y]


def bar(width_m: float, height_m: float, turn_rad: float) -> Outline:
    """A rectangle, turned clockwise."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return np.asarray(_rectangle(width_m, height_m) @ np.array([[c, -s], [s, c]]))


def arrow(x: float, y: float, size_m: float, turn_rad: float) -> list[Outline]:
    """The shaft and the head of an arrow that points up, turned clockwise."""
    shaft = _rectangle(0.18 * size_m, 0.5 * size_m, 0, -0.25 * size_m)
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
        *(Patch(shape, ink) for shape in arrow(-0.36 * w, -0.05 * h, 0.45 * h, turn)),
    ]
    for line in range(2 if h < 1.6 else 3):
        long_m = w * (0.56, 0.38, 0.48, 0.3, 0.52)[(2 * line + variant) % 5]
        layers.append(Patch(_rectangle(long_m, 0.13 * h, -0.2 * w + long_m / 2, (0.28 - 0.27 * line) * h), ink))
    return tuple(layers)


def _ringed(fill: Color, *ink: Outline) -> tuple[Patch, ...]:
    """A round sign with a red ring."""
    return (
        Patch(disc(16, 0.38), RED),
        Patch(disc(16, 0.29), fill),
        *(Patch(shape, BLACK) for shape in ink),
    )


FACES: tuple[tuple[Patch, ...], ...] = (
    _ringed(WHITE, _rectangle(0.13, 0.26, -0.1), _rectangle(0.13, 0.26, 0.1)),
    (Patch(disc(3, 0.56), RED), Patch(disc(3, 0.38), WHITE), Patch(_rectangle(0.08, 0.26, 0, -0.02), BLACK)),
    (Patch(disc(4, 0.6), BLACK), Patch(disc(4, 0.57), YELLOW), *(Patch(s, BLACK) for s in arrow(0, 0, 0.6, 0.5))),
    (Patch(_rectangle(0.6, 0.75), BLACK), Patch(_rectangle(0.57, 0.72), WHITE),
     Patch(_rectangle(0.36, 0.09, 0, 0.22), BLACK),
     Patch(_rectangle(0.15, 0.28, -0.1, -0.1), BLACK), Patch(_rectangle(0.15, 0.28, 0.1, -0.1), BLACK)),
    (Patch(disc(16, 0.38), BLUE), *(Patch(s, WHITE) for s in arrow(0, 0, 0.55, 0.0))),
    (Patch(disc(16, 0.42), WHITE), Patch(disc(16, 0.39), RED), Patch(_rectangle(0.5, 0.16), WHITE)),
    (Patch(_rectangle(0.75, 0.75), WHITE), Patch(_rectangle(0.7, 0.7), BLUE),
     Patch(_rectangle(0.2, 0.42, 0, -0.02), WHITE)),
    board(2.4, 1.5, GREEN, 1),
    board(3.2, 2.0, BLUE, 2),
    board(1.8, 1.0, WHITE, 3),
    board(1.8, 1.3, BROWN, 4),
    (Patch(_rectangle(0.9, 0.9), ORANGE), *(Patch(s, BLACK) for s in arrow(0, 0, 0.7, -np.pi / 2))),
    board(2.4, 1.5, GREEN, 2),
    board(3.2, 2.0, BLUE, 1),
    (Patch(_rectangle(0.9, 0.9), ORANGE), *(Patch(s, BLACK) for s in arrow(0, 0, 0.7, np.pi / 2))),
    (Patch(disc(4, 0.6), BLACK), Patch(disc(4, 0.57), YELLOW), *(Patch(s, BLACK) for s in arrow(0, 0, 0.6, -0.5))),
)  # fmt: skip
FACE_KINDS: tuple[FaceKind | SignKind, ...] = (
    "speed_limit", "warning", "bend_right", "speed_limit", "ahead_only", "no_entry", "information",
    "direction_left", "direction_right", "direction_ahead", "direction_down", "roadworks_left",
    "direction_right", "direction_left", "roadworks_right", "bend_left",
)  # fmt: skip
# What boards of a gantry are, by variant.
BOARD_KINDS: tuple[FaceKind, ...] = ("direction_down", "direction_left", "direction_right", "direction_ahead")
assert len(FACES) == len(FACE_KINDS) == N_SIGN_FACES

# Rows of the letters on signs from the top, three bits each.
GLYPHS = {
    "0": (7, 5, 5, 5, 7), "1": (2, 6, 2, 2, 7), "2": (7, 1, 7, 4, 7), "3": (7, 1, 7, 1, 7), "4": (5, 5, 7, 1, 1),
    "5": (7, 4, 7, 1, 7), "6": (7, 4, 7, 5, 7), "7": (7, 1, 1, 1, 1), "8": (7, 5, 7, 5, 7), "9": (7, 5, 7, 1, 7),
    "S": (7, 4, 7, 1, 7), "T": (7, 2, 2, 2, 2), "O": (7, 5, 5, 5, 7), "P": (7, 5, 7, 4, 4),
}  # fmt: skip
# Bits of a row -> its runs, as first column and length.
RUNS = {1: ((2, 1),), 2: ((1, 1),), 4: ((0, 1),), 5: ((0, 1), (2, 1)), 6: ((0, 2),), 7: ((0, 3),)}


def _text(text: str, height_m: float) -> list[Outline]:
    """Letters in the middle of a sign; a cell of theirs is as wide as high."""
    cell, found = height_m / 5, []
    left = -cell * (4 * len(text) - 1) / 2
    for number, letter in enumerate(text):
        for row, bits in enumerate(GLYPHS[letter]):
            for first, n in RUNS[bits]:
                x = left + cell * (4 * number + first + n / 2)
                found.append(_rectangle(n * cell, cell, x, (2 - row) * cell))
    return found


def _round(fill: Color, shapes: list[Outline]) -> tuple[Patch, ...]:
    """A round sign with a white edge."""
    return (Patch(disc(24, 0.38), WHITE), Patch(disc(24, 0.36), fill), *(Patch(shape, WHITE) for shape in shapes))


def _ring(shapes: list[Outline], is_barred: bool = False) -> tuple[Patch, ...]:
    """A round sign with a red ring, with a bar through what it forbids."""
    return (
        Patch(disc(24, 0.38), RED),
        Patch(disc(24, 0.3), WHITE),
        *(Patch(shape, BLACK) for shape in shapes),
        *((Patch(bar(0.7, 0.075, np.pi / 4), RED),) if is_barred else ()),
    )


def _around() -> list[Outline]:
    """An arrow that turns back to the left."""
    head = np.array([(-0.26, -0.02), (-0.02, -0.02), (-0.14, -0.16)])
    bars = ((0.07, 0.36, 0.12, -0.03), (0.33, 0.07, 0.0, 0.16), (0.07, 0.2, -0.14, 0.07))
    return [*(_rectangle(*bar) for bar in bars), head]


LEFT_RAD, RIGHT_RAD = -np.pi / 2, np.pi / 2
SIGN_FACES: dict[SignKind, tuple[Patch, ...]] = {
    "stop": (
        Patch(disc(8, 0.45, 0.5), WHITE),
        Patch(disc(8, 0.42, 0.5), RED),
        *(Patch(shape, WHITE) for shape in _text("STOP", 0.23)),
    ),
    "give_way": (Patch(disc(3, 0.55, 0.5), RED), Patch(disc(3, 0.36, 0.5), WHITE)),
    "priority": (Patch(disc(4, 0.5), BLACK), Patch(disc(4, 0.485), WHITE), Patch(disc(4, 0.36), YELLOW)),
    "no_entry": _round(RED, [_rectangle(0.52, 0.13)]),
    "speed_20": _ring(_text("20", 0.28)),
    "speed_30": _ring(_text("30", 0.28)),
    "speed_40": _ring(_text("40", 0.28)),
    "speed_50": _ring(_text("50", 0.28)),
    "speed_60": _ring(_text("60", 0.28)),
    "speed_70": _ring(_text("70", 0.28)),
    "speed_80": _ring(_text("80", 0.28)),
    "speed_90": _ring(_text("90", 0.28)),
    "speed_100": _ring(_text("100", 0.22)),
    "speed_120": _ring(_text("120", 0.22)),
    "speed_130": _ring(_text("130", 0.22)),
    "ahead_only": _round(BLUE, arrow(0, -0.02, 0.55, 0.0)),
    "left_only": _round(BLUE, arrow(0, 0, 0.55, LEFT_RAD)),
    "right_only": _round(BLUE, arrow(0, 0, 0.55, RIGHT_RAD)),
    "no_left_turn": _ring(arrow(0, 0, 0.45, LEFT_RAD), is_barred=True),
    "no_right_turn": _ring(arrow(0, 0, 0.45, RIGHT_RAD), is_barred=True),
    "no_u_turn": _ring(_around(), is_barred=True),
    "exit_left": board(2.4, 1.5, GREEN, 1),
    "exit_right": board(2.4, 1.5, GREEN, 2),
}


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
