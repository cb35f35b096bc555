"""Signals and signs at free places, and signals over the lanes of a gantry: places of heads and boards, poles, heads,
lit lenses and boards. World frame, metres."""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import from_axes
from synth3dlanes.scene.traffic_elements import LaneState, LensForm, SignalState, TrafficSign, TrafficSignal
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.system.schema import Color
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.sign_faces import SIGN_FACES, Outline, Patch, arrow, bar, disc
from synth3dlanes.world.solids import (
    DARK_METAL,
    LIT_GLOSS,
    METAL,
    SHEETING_GLOSS,
    SINK_M,
    Body,
    GroundFrame,
    QuadCorners,
    Quads,
)

# A board: its depth, and where its back and the first layer of its face are in it; each further layer is nearer. All
# are close together: a rim of the face that shows beside the back would shine in headlights.
BOARD_M, BACK_M, FACE_M, LAYER_M = 0.08, 0.0, -0.002, 0.003
HOUSING, DARK_LENS = (0.012, 0.014, 0.012, 0.25), (0.03, 0.03, 0.03, 0.5)
RED_LIGHT, AMBER_LIGHT, GREEN_LIGHT = (1.0, 0.02, 0.012), (1.0, 0.36, 0.01), (0.02, 1.0, 0.38)
# A head with three lights: its size with the hoods of its lenses, their radius, how far apart they are, and the depth
# of the hoods.
HEAD_M, LENS_M, LENSES_APART_M, HOOD_M = np.array([0.42, 0.42, 1.24]), 0.15, 0.39, 0.2
# The glass and the hood of a light, around its middle.
LENS = Patch(disc(12, LENS_M), DARK_LENS[:3]).quads()[..., [0, 2, 1]] - [0, 0.004, 0]
HOOD = (LENS_M + 0.02) * np.array([(np.sin(at), 0.0, np.cos(at)) for at in np.linspace(-0.6 * np.pi, 0.6 * np.pi, 7)])
HOOD = np.stack([HOOD, HOOD - [0, HOOD_M, 0]])
# A signal over a lane, and how far the pole is behind what it carries.
LANE_HEAD_M, BEHIND_M = np.array([0.95, 0.2, 0.95]), 0.1
BESIDE_POLE_M = 0.05
# Arms over wide roads are as thick as beams of gantries.
LONG_ARM_M, LONG_ARM_RADIUS_M = 12.0, 0.2
# Lights from the top, and which of them shine.
LIGHTS: tuple[Color, ...] = (RED_LIGHT, AMBER_LIGHT, GREEN_LIGHT)
SHINING: dict[SignalState, tuple[int, ...]] = {
    "off": (), "red": (0,), "red_amber": (0, 1), "amber": (1,), "green": (2,)
}  # fmt: skip
TURNS_RAD: dict[LensForm, float] = {"left": -np.pi / 2, "straight": 0.0, "right": np.pi / 2}
CROSS = [bar(0.9, 0.12, turn) for turn in (np.pi / 4, -np.pi / 4)]
LANE_LIGHTS: dict[LaneState, tuple[Color, list[Outline]]] = {
    "off": (RED_LIGHT, []),
    "red_cross": (RED_LIGHT, CROSS),
    "green_arrow": (GREEN_LIGHT, arrow(0, 0, 0.75, np.pi)),
    "amber_left": (AMBER_LIGHT, arrow(0, 0, 0.75, -3 * np.pi / 4)),
    "amber_right": (AMBER_LIGHT, arrow(0, 0, 0.75, 3 * np.pi / 4)),
}


class Mounted(NamedTuple):
    """The middle of a head or a board in the frame of its foot, and its size: width, depth and height."""

    frame: GroundFrame
    middle: Float[np.ndarray, "3"]
    size_m: Float[np.ndarray, "3"]

    @property
    def world_from_face(self) -> Matrix4:
        """Its pose: x to the right and y ahead as its traffic drives, z up, in its middle."""
        x, y = self.frame.forward
        right, forward, up = np.array([[y, -x, 0.0], [x, y, 0.0], [0.0, 0.0, 1.0]])
        return from_axes(right, forward, up, self.frame.world(self.middle))


def board_size(layers: Sequence[Patch]) -> Float[np.ndarray, "3"]:
    """Width, depth and height of a board."""
    width_m, height_m = np.ptp(layers[0].outline, axis=0)
    return np.array([width_m, BOARD_M, height_m])


def board_body(place: Mounted, layers: tuple[Patch, ...]) -> Body:
    """A board's gray back and the layers of its face, towards its traffic."""
    corners, colors = _board(layers)
    quads = Quads("face", "sign")
    quads.add(place.frame.world(place.middle + corners), colors)
    return quads.body()


@lru_cache(maxsize=64)
def _board(layers: tuple[Patch, ...]) -> tuple[QuadCorners, Float[np.ndarray, "f 4"]]:
    """The quads of a board around its middle, and their colours with gloss. Consecutive shapes of one colour are one
    layer: thick faces would cast shadows on themselves."""
    outline = layers[0].outline
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    level, before, found, colors = 0, METAL[:3], list[QuadCorners](), list[tuple[float, ...]]()
    for i, layer in enumerate([Patch(outline, METAL[:3]), *layers]):
        quads = layer.quads()
        level, before = level + (layer.color != before), layer.color
        x, up = np.moveaxis(quads[..., :2] - middle, -1, 0)
        depth = np.full(x.shape, BACK_M if i == 0 else FACE_M - LAYER_M * level)
        found.append(np.stack([x, depth, up], -1))
        colors += [(*layer.color, METAL[3] if i == 0 else SHEETING_GLOSS)] * len(quads)
    return np.concatenate(found), np.array(colors)


def foot_frames(ground: Ground, items: Sequence[TrafficSignal | TrafficSign]) -> list[GroundFrame]:
    """The frames on the ground at the feet of signals and signs: y as their traffic drives."""
    xy_world = np.array([(item.x_m, item.y_m) for item in items]).reshape(-1, 2)
    yaw_rad = np.array([item.yaw_rad for item in items])
    forward = np.stack([-np.sin(yaw_rad), np.cos(yaw_rad)], axis=-1)
    return list(map(GroundFrame, np.column_stack([xy_world, ground.height(xy_world)]), forward))


def mounted(item: TrafficSignal | TrafficSign, frame: GroundFrame) -> Mounted:
    """Where the head of a signal, or a sign, hangs over its foot."""
    size_m = HEAD_M if isinstance(item, TrafficSignal) else board_size(SIGN_FACES[item.kind])
    middle = np.array([item.reach_m, -BEHIND_M - size_m[1] / 2, item.height_m + size_m[2] / 2])
    return Mounted(frame, middle, size_m)


def pole_body(item: TrafficSignal | TrafficSign, frame: GroundFrame) -> Body:
    """The pole of a signal or sign on its foot, with an arm where that hangs beside it."""
    is_signal = isinstance(item, TrafficSignal)
    place, quads = mounted(item, frame), Quads("signal" if is_signal else "sign", "pole")
    (_, _, height_m), reach_m = place.size_m, item.reach_m
    has_arm, middle_m = abs(reach_m) > BESIDE_POLE_M, item.height_m + height_m / 2
    radius_m = (0.11 if abs(reach_m) > 2 else 0.06) if is_signal else 0.035
    radius_m = LONG_ARM_RADIUS_M if abs(reach_m) > LONG_ARM_M else radius_m
    top_m = middle_m + 0.3 if has_arm else item.height_m + 0.95 * height_m
    color = DARK_METAL if is_signal else METAL
    quads.tube(frame.world(np.array([(0, 0, -SINK_M), (0, 0, top_m)])), (radius_m, 0.8 * radius_m), color, n=8)
    if has_arm:
        ends = np.array([(0, 0, middle_m), (reach_m + 0.2 * np.sign(reach_m), 0, middle_m)])
        quads.tube(frame.world(ends), (0.7 * radius_m, 0.5 * radius_m), color)
    quads.feet.append(frame.origin[None])
    return quads.body()


def head_body(place: Mounted) -> Body:
    """The head of a signal with three lights, all of them off."""
    quads, (frame, middle, size_m) = Quads("head", "signal"), place
    low = middle - size_m / 2 + [0, HOOD_M, 0]
    quads.box(frame, low.tolist(), (middle + size_m / 2).tolist(), HOUSING)
    lenses = _lenses(place)[:, None, None]
    for lens, hood in zip(frame.world(lenses + LENS), frame.world(lenses + HOOD), strict=True):
        quads.add(lens, DARK_LENS)
        quads.sweep(hood, HOUSING)
    return quads.body()


def lane_head_body(place: Mounted) -> Body:
    """A signal over a lane, off."""
    quads, (frame, middle, size_m) = Quads("head", "signal"), place
    quads.box(frame, (middle - size_m / 2).tolist(), (middle + size_m / 2).tolist(), HOUSING)
    return quads.body()


def head_light(place: Mounted, form: LensForm, state: SignalState) -> Body:
    """The lit lenses of a head with three lights."""
    quads = Quads("head", "signal")
    shapes = [disc(12, LENS_M)] if form == "ball" else arrow(0, 0, 1.7 * LENS_M, TURNS_RAD[form])
    for number in SHINING[state]:
        for shape in shapes:
            at = _lenses(place)[number] - [0, 0.01, 0]
            _add_patch(quads, place.frame, Patch(shape, LIGHTS[number]), at)
    return quads.body()


def lane_light(place: Mounted, state: LaneState) -> Body:
    """The lit shape of a signal over a lane."""
    quads, (color, shapes) = Quads("head", "signal"), LANE_LIGHTS[state]
    for number, shape in enumerate(shapes):
        at = place.middle - [0, place.size_m[1] / 2 + 0.01 + 0.002 * number, 0]
        _add_patch(quads, place.frame, Patch(shape, color), at)
    return quads.body()


def _lenses(place: Mounted) -> Float[np.ndarray, "3 3"]:
    """The middles of the lenses from the top, on the front of a head."""
    down = np.array([1.0, 0.0, -1.0])[:, None] * [0, 0, LENSES_APART_M]
    return np.asarray(place.middle - [0, place.size_m[1] / 2 - HOOD_M, 0] + down)


def _add_patch(quads: Quads, frame: GroundFrame, patch: Patch, at: Float[np.ndarray, "3"]) -> None:
    """A lit patch upright at a place of a frame, towards the traffic."""
    corners = patch.quads()[..., [0, 2, 1]]
    quads.add(frame.world(corners + at), (*patch.color, LIT_GLOSS))
