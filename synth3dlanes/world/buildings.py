"""Houses, industrial halls and blocks of flats. World frame, metres."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.scene.roadside import Building
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.solids import SINK_M, Body, GroundFrame, Quads

STOREY_M = 3.0
GLASS = (0.05, 0.06, 0.08, 0.35)


def building_frame(building: Building, floor_m: float = 0.0) -> GroundFrame:
    """The middle of a building's floor, at this height."""
    forward = np.array([-np.sin(building.yaw_rad), np.cos(building.yaw_rad)])
    return GroundFrame(np.array([building.x_m, building.y_m, floor_m]), forward)


def building_bodies(ground: Ground, buildings: Sequence[Building]) -> list[Body]:
    """Buildings on their floors, with walls down into the ground."""
    if not buildings:
        return []
    half_m = np.array([(building.width_m / 2, building.length_m / 2) for building in buildings])
    corners = half_m[:, None] * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    frames = list(map(building_frame, buildings))
    places = [frame.world(np.column_stack([at, np.zeros(4)]))[:, :2] for frame, at in zip(frames, corners, strict=True)]
    middles = np.array([frame.origin[:2] for frame in frames])
    floors_m, around_m = np.split(ground.height(np.concatenate([middles, *places])), [len(frames)])
    lowest_m = (around_m.reshape(-1, 4) - floors_m[:, None]).min(axis=1)
    return list(map(_body, buildings, floors_m.tolist(), lowest_m.tolist()))


def _body(building: Building, floor_m: float, lowest_m: float) -> Body:
    """A building on its floor, around which the ground is this high over it at the lowest corner."""
    quads = Quads(building.kind, "building")
    x, y, h = building.width_m / 2, building.length_m / 2, building.height_m
    frame = building_frame(building, floor_m)
    wall, roof = (*building.color, 0.0), (*building.roof, 0.1)
    bottom = lowest_m - SINK_M
    quads.box(frame, (-x, -y, min(bottom, -SINK_M)), (x, y, h), wall)
    if building.kind == "house":
        ridge = h + 0.8 * x
        faces = []
        for side in (-1, 1):
            slope = [
                (side * (x + 0.5), -y - 0.4, h - 0.4),
                (side * (x + 0.5), y + 0.4, h - 0.4),
                (0, y + 0.4, ridge),
                (0, -y - 0.4, ridge),
            ]
            gable = [(-x, side * y, h), (x, side * y, h), (0, side * y, ridge), (0, side * y, ridge - 0.01)]
            faces += [slope, gable]
        quads.add(frame.world(np.array(faces)), np.array([roof, wall, roof, wall]))
        quads.box(
            frame,
            (0.3 * x, 0.2 * y, h),
            (0.3 * x + 0.6, 0.2 * y + 0.6, ridge + 0.5),
            (*(0.6 * c for c in building.color), 0.0),
        )
    else:
        quads.box(frame, (-x - 0.1, -y - 0.1, h), (x + 0.1, y + 0.1, h + 0.35), roof)
    _windows(quads, frame, building)
    quads.feet.append(frame.origin[None])
    return quads.body()


def _windows(quads: Quads, frame: GroundFrame, building: Building) -> None:
    """Windows of houses, bands of windows of other buildings, and gates of halls, in front of the walls."""
    x, y, h = building.width_m / 2, building.length_m / 2, building.height_m
    for depth, half, along_y in ((x, y, True), (y, x, False)):
        along, up, is_gate = _panes(building.kind, half, h)
        colors = np.where(is_gate[:, None], (*(0.5 * c for c in building.roof), 0.1), GLASS)
        u, z = along[:, [0, 1, 1, 0]], up[:, [0, 0, 1, 1]]
        for sign in (-1, 1):
            d = np.full(u.shape, sign * (depth + 0.03))
            quads.add(frame.world(np.stack((d, u, z) if along_y else (u, d, z), -1)), colors)


def _panes(
    kind: str, half: float, height_m: float
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Where a wall of length 2 half has panes: along it and up, and whether each is a gate."""

    def places(spacing_m: float) -> Scalars:
        n = max(1, int(2 * half / spacing_m))
        return ((np.arange(n) + 0.5) / n * 2 - 1) * half

    def windows(
        spacing_m: float, half_m: float, up_m: tuple[float, float]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        storeys, at = np.arange(max(1, int(height_m / STOREY_M))) * STOREY_M, places(spacing_m)
        along, up = np.tile(at, len(storeys)), np.repeat(storeys, len(at))
        return along[:, None] + [-half_m, half_m], up[:, None] + up_m, np.zeros(len(up), dtype=bool)

    if kind == "house":
        return windows(3.2, 0.55, (0.9, 2.2))
    if kind == "block":
        return windows(12.0, 0.8 * half / max(1, int(half / 6)), (1.0, 2.4))
    gates, top_m = places(16.0)[:, None] + [-1.8, 1.8], min(3.8, 0.6 * height_m)
    along = np.concatenate([[(-0.9 * half, 0.9 * half)], gates])
    up = np.array([(height_m - 1.8, height_m - 0.9), *[(0.0, top_m)] * len(gates)])
    return along, up, np.arange(len(along)) > 0
