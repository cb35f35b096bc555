"""Places of heads of signals and of boards, and the bodies of boards. World frame, metres."""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import from_axes
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.world.sign_faces import Patch
from synth3dlanes.world.solids import METAL, SHEETING_GLOSS, Body, GroundFrame, QuadCorners, Quads

# A board: its depth, and where its back and the first layer of its face are in it; each further layer is nearer. All
# are close together: a rim of the face that shows beside the back would shine in headlights.
BOARD_M, BACK_M, FACE_M, LAYER_M = 0.08, 0.0, -0.002, 0.003


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
