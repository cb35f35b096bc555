"""Lamp posts, signs and delineators. World frame, metres."""

from collections.abc import Sequence

import numpy as np

from synth3dlanes.scene.roadside import Post
from synth3dlanes.system.arrays import Points3
from synth3dlanes.world.beside import frames_beside
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.sign_faces import FACES
from synth3dlanes.world.signals import Mounted, board_size
from synth3dlanes.world.solids import (
    BLACK,
    DARK_METAL,
    METAL,
    REFLECTOR_GLOSS,
    SINK_M,
    WHITE,
    Body,
    GroundFrame,
    Quads,
)

# From the middle of a post to that of its board.
SIGN_BEFORE_M = 0.07
LAMP_ARM_M, LAMP_HEAD_M = 1.8, np.array([0.14, 0.38, 0.06])


def post_frames(ground: Ground, posts: Sequence[Post]) -> list[GroundFrame]:
    """Where posts stand."""
    found: dict[int, GroundFrame] = {}
    for road, side in dict.fromkeys((post.road, post.side) for post in posts):
        own = [i for i, post in enumerate(posts) if (post.road, post.side) == (road, side)]
        s, aside_m = np.array([(posts[i].s_m, posts[i].aside_m) for i in own]).T
        found |= dict(zip(own, frames_beside(ground, road, side, s, aside_m), strict=True))
    return [found[i] for i in range(len(posts))]


def post_body(post: Post, frame: GroundFrame) -> Body:
    """A post in its frame."""
    quads = Quads(post.kind, "pole")
    if post.kind == "lamp":
        _lamp(quads, frame, post)
    elif post.kind == "delineator":
        h = post.height_m
        for low, high, color in ((-SINK_M, h - 0.32, WHITE), (h - 0.32, h - 0.08, BLACK), (h - 0.08, h, WHITE)):
            quads.box(frame, (-0.06, -0.04, low), (0.06, 0.04, high), color)
        for y in (-0.045, 0.045):
            reflector = (0.75, 0.45, 0.1, REFLECTOR_GLOSS)
            quads.box(frame, (-0.03, y - 0.004, h - 0.29), (0.03, y + 0.004, h - 0.12), reflector)
    else:
        _sign(quads, frame, post)
    quads.feet.append(frame.origin[None])
    return quads.body()


def _lamp(quads: Quads, frame: GroundFrame, post: Post) -> None:
    """A tapered pole, with an arm and a head over the road; on a median, with one over either side."""
    h = post.height_m
    quads.tube(frame.world(np.array([(0, 0, -SINK_M), (0, 0, h)])), (0.1, 0.06), METAL)
    for side in _arms(post):
        out = -side * frame.outward
        quads.tube(frame.world(np.array([(0, 0, h - 0.05), (out * LAMP_ARM_M, 0, h + 0.25)])), (0.05, 0.04), METAL)
        middle = np.array([out * (LAMP_ARM_M + LAMP_HEAD_M[1]), 0, h + 0.28])
        half = LAMP_HEAD_M[[1, 0, 2]]
        quads.box(frame, (middle - half).tolist(), (middle + half).tolist(), DARK_METAL)
        glass = middle - [0, 0, half[2] + 0.01]
        half = half * [0.8, 0.8, 0.1]
        quads.box(frame, (glass - half).tolist(), (glass + half).tolist(), WHITE)


def _arms(post: Post) -> tuple[int, ...]:
    return (1, -1) if post.side == "median" else (1,)


def lamp_heads_of(frame: GroundFrame, post: Post) -> Points3:
    """The middles of the lower sides of a lamp post's heads."""
    reach, z = LAMP_ARM_M + LAMP_HEAD_M[1], post.height_m + 0.28 - LAMP_HEAD_M[2] - 0.02
    return np.array([frame.world(np.array([-side * frame.outward * reach, 0, z])) for side in _arms(post)])


def _sign(quads: Quads, frame: GroundFrame, post: Post) -> None:
    """One or two tubes behind the board of a sign."""
    width_m, up_m = np.ptp(FACES[post.face - 1][0].outline, axis=0)
    for x in (-0.3 * width_m, 0.3 * width_m) if width_m > 1.3 else (0.0,):
        quads.tube(frame.world(np.array([(x, 0, -SINK_M), (x, 0, post.height_m + 0.9 * up_m)])), (0.04, 0.04), METAL)


def sign_place(frame: GroundFrame, post: Post) -> Mounted:
    """Where the board of a sign hangs: its lower edge is at the post's height."""
    size_m = board_size(FACES[post.face - 1])
    middle = np.array([0, -SIGN_BEFORE_M, post.height_m + size_m[2] / 2])
    return Mounted(frame.turned_round() if post.turned else frame, middle, size_m)
