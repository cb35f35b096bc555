"""Houses, industrial halls and blocks of flats. World frame, metres."""

import numpy as np

from synth3dlanes.scene.roadside import Building
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.world.beside import ground_over
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.solids import SINK_M, Body, GroundFrame, Quads

Range = tuple[float, float]

STOREY_M = 3.0
GLASS = (0.05, 0.06, 0.08, 0.35)


def building_frame(building: Building, floor_m: float = 0.0) -> GroundFrame:
    """The middle of a building's floor, at this height."""
    forward = np.array([-np.sin(building.yaw_rad), np.cos(building.yaw_rad)])
    return GroundFrame(np.array([building.x_m, building.y_m, floor_m]), forward)


def building_body(ground: Ground, building: Building) -> Body:
    """A building on its floor, with walls down into the ground."""
    quads = Quads(building.kind, "building")
    x, y, h = building.width_m / 2, building.length_m / 2, building.height_m
    frame = building_frame(building, float(ground.height(np.array([[building.x_m, building.y_m]]))[0]))
    wall, roof = (*building.color, 0.0), (*building.roof, 0.1)
    corners = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    bottom = float(ground_over(ground, frame, corners).min()) - SINK_M
    quads.box(frame, (-x, -y, min(bottom, -SINK_M)), (x, y, h), wall)
    if building.kind == "house":
        ridge = h + 0.8 * x
        for side in (-1, 1):
            slope = [
                (side * (x + 0.5), -y - 0.4, h - 0.4),
                (side * (x + 0.5), y + 0.4, h - 0.4),
                (0, y + 0.4, ridge),
                (0, -y - 0.4, ridge),
            ]
            quads.add(frame.world(np.array([slope])), roof)
            gable = [(-x, side * y, h), (x, side * y, h), (0, side * y, ridge), (0, side * y, ridge - 0.01)]
            quads.add(frame.world(np.array([gable])), wall)
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
        panes = _panes(building.kind, half, h)
        for sign in (-1, 1):
            for (a, b), (low, high), is_gate in panes:
                ring = [(a, low), (b, low), (b, high), (a, high)]
                d = sign * (depth + 0.03)
                corners = np.array([[(d, u, z) if along_y else (u, d, z) for u, z in ring]])
                quads.add(frame.world(corners), tuple(0.5 * c for c in building.roof) if is_gate else GLASS)


def _panes(kind: str, half: float, height_m: float) -> list[tuple[Range, Range, bool]]:
    """Where a wall of length 2 half has panes: along it and up, and whether each is a gate."""

    def places(spacing_m: float) -> Scalars:
        n = max(1, int(2 * half / spacing_m))
        return ((np.arange(n) + 0.5) / n * 2 - 1) * half

    storeys = np.arange(max(1, int(height_m / STOREY_M))) * STOREY_M
    if kind == "house":
        return [((u - 0.55, u + 0.55), (z + 0.9, z + 2.2), False) for z in storeys for u in places(3.2)]
    if kind == "block":
        wide = 0.8 * half / max(1, int(half / 6))
        return [((u - wide, u + wide), (z + 1.0, z + 2.4), False) for z in storeys for u in places(12.0)]
    gates = [((u - 1.8, u + 1.8), (0.0, min(3.8, 0.6 * height_m)), True) for u in places(16.0)]
    return [((-0.9 * half, 0.9 * half), (height_m - 1.8, height_m - 0.9), False), *gates]
