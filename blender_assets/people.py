"""People who stand and walk: their builds, and the joints of a walk cycle.

Angles of joints over a cycle follow published gait curves of healthy adults (D. A. Winter, Biomechanics and Motor
Control of Human Movement): hips, knees and ankles in degrees, from one heel strike of a leg to its next one.
"""

import numpy as np
from bodies import (
    FOREARM_M,
    HIP_M,
    SHANK_M,
    SHOE,
    THIGH_M,
    UPPER_ARM_M,
    Build,
    Joints,
    Vector,
    body,
    point,
    reached,
    shoulders,
    turned,
)
from scipy.interpolate import PchipInterpolator
from shapes import Shape, grid_faces, tube

from synth3dlanes.scene.assets.catalogue import THINGS, ThingModel

UMBRELLA = SHOE + 1
HIP = ((0.0, 24), (0.12, 21), (0.3, 5), (0.5, -12), (0.6, -6), (0.72, 14), (0.86, 26))
KNEE = ((0.0, 4), (0.14, 15), (0.28, 7), (0.4, 5), (0.5, 12), (0.6, 36), (0.72, 58), (0.86, 26), (0.95, 4))
ANKLE = ((0.0, 0), (0.07, -5), (0.2, 3), (0.45, 9), (0.55, -4), (0.62, -16), (0.75, 0), (0.9, 1))
BUILDS = {
    "man": Build(),
    "woman": Build(1.66, 0.88, 0.88, 1.0, 0.88, bust_m=0.02, head=1.03, hair="long"),
    "child": Build(1.22, 0.92, 0.98, 0.92, 0.92, head=1.32),
    "heavy_man": Build(1.74, 1.12, 1.24, 1.14, 1.18, belly_m=0.11),
    "woman_in_skirt": Build(1.68, 0.87, 0.86, 1.0, 0.9, bust_m=0.02, head=1.02, hair="long", skirt=0.95),
    "man_in_coat": Build(1.80, 1.04, 1.06, 1.04, 1.0, coat=0.8),
    "man_with_umbrella": Build(1.77, 1.02, 1.02, 1.02, 1.0),
    "woman_with_umbrella": Build(1.67, 0.9, 0.92, 1.0, 0.88, bust_m=0.02, head=1.03, hair="long", coat=0.7),
}


def at(curve: tuple[tuple[float, float], ...], phase: float) -> float:
    """The angle of a joint in radians at a share of the cycle."""
    x, y = np.array(curve).T
    periodic = PchipInterpolator(np.concatenate([x - 1, x, x + 1]), np.tile(y, 3))
    return float(np.radians(periodic(phase % 1)))


def swung(angle_rad: float, length_m: float) -> Vector:
    """A bone that hangs down, swung forward."""
    return np.array([0.0, length_m * np.sin(angle_rad), -length_m * np.cos(angle_rad)])


def walking(build: Build, phase: float | None, holds: bool) -> Joints:
    """The joints at a share of the walk cycle, or standing (None), the hips over the origin; with one hand up if it
    holds an umbrella."""
    s = build.scale
    moves = phase is not None
    own = phase or 0.0
    phases = (own, own + 0.5)
    bends = [(at(HIP, p), at(KNEE, p), at(ANKLE, p)) if moves else (0.02, 0.03, 0.01) for p in phases]
    if not moves:
        bends[1] = (0.10, 0.16, 0.06)
    sway = np.cos(2 * np.pi * own) if moves else 0.0
    pelvis, chest = np.radians(4) * sway, np.radians(-6) * sway
    out = turned(np.array([s * HIP_M * build.hips, 0.0, 0.0]), pelvis)
    hips = (out, -out)
    knees = tuple(hip + swung(bend[0], s * THIGH_M) for hip, bend in zip(hips, bends, strict=True))
    # Feet come closer to the middle than hips are.
    inward = [np.array([side * 0.22 * HIP_M * s, 0.0, 0.0]) for side in (-1, 1)]
    ankles = tuple(
        knee + swung(bend[0] - bend[1], s * SHANK_M) + (by if moves else -by)
        for knee, bend, by in zip(knees, bends, inward, strict=True)
    )
    feet = tuple(bend[0] - bend[1] + bend[2] for bend in bends)
    joints = Joints(hips, knees, ankles, feet, 0.03, pelvis, chest, 0.02, (out, out), (out, out))  # type: ignore[arg-type]
    elbows, wrists = [], []
    for k, shoulder in enumerate(shoulders(build, joints)):
        side = 1 - 2 * k
        swing = np.radians(-19) * np.cos(2 * np.pi * phases[k]) if moves else 0.04 * side
        spread = side * (0.13 + 0.25 * max(build.waist - 1, 0))
        upper = swung(swing - 0.05, s * UPPER_ARM_M)
        upper = np.array([np.sin(spread) * s * UPPER_ARM_M, upper[1], upper[2] * np.cos(spread)])
        lower = swung(swing + np.radians(20) + 0.35 * max(swing, 0), s * FOREARM_M)
        elbow, wrist = shoulder + upper, shoulder + upper + lower
        if holds and k == 0:
            wrist = shoulder + s * np.array([-0.06, 0.27, -0.16])
            elbow, wrist = reached(shoulder, wrist, (s * UPPER_ARM_M, s * FOREARM_M), np.array([0.35, -0.1, -1.0]))
        elbows.append(elbow)
        wrists.append(wrist)
    return Joints(hips, knees, ankles, feet, 0.03, pelvis, chest, 0.02, tuple(elbows), tuple(wrists))  # type: ignore[arg-type]


def umbrella(shape: Shape, grip: Vector) -> None:
    """An open umbrella above a hand: a canopy of eight panels that sag between the ribs, and its stick."""
    foot, top = grip + point(0.0, 0.0, -0.07), grip + point(-0.10, -0.12, 0.82)
    path = foot + np.linspace(0, 1, 4)[:, None] * (top - foot)
    shape.add(*tube(path, np.array([0.013, 0.009, 0.008, 0.008]), 5), SHOE)
    sides = 16
    angle = 2 * np.pi * np.arange(sides) / sides
    up = (top - grip) / np.linalg.norm(top - grip)
    right = np.array([1.0, 0.0, 0.0]) - up[0] * up
    right /= np.linalg.norm(right)
    ahead = np.cross(up, right)
    rings = []
    for radius, drop in ((0.02, 0.0), (0.18, 0.03), (0.34, 0.10), (0.47, 0.19), (0.53, 0.25)):
        sag = 1 - 0.055 * (radius / 0.53) * (np.arange(sides) % 2)
        ring = radius * sag[:, None] * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * ahead)
        rings.append(top + ring - drop * up)
    outside = np.array(rings)
    # From the rim inwards, so that the cloth has two sides.
    inside = outside[::-1] - 0.006 * up
    points = np.concatenate([outside, inside])
    n = len(points)
    # The rings go clockwise around the way along them.
    shape.add(points.reshape(-1, 3), grid_faces(n, sides, wrap=True)[:, ::-1], UMBRELLA)


def person(model: ThingModel, pose: int) -> Shape:
    """A person of the catalogue, standing (pose 0) or at an instant of its walk cycle, the lowest point on z = 0."""
    build, holds = BUILDS[model.name], "umbrella" in model.paints
    phase = (pose - 1) / model.n_poses if pose else None
    joints = walking(build, phase, holds)
    shape = body(build, joints)
    if holds:
        along = (joints.wrists[0] - joints.elbows[0]) / np.linalg.norm(joints.wrists[0] - joints.elbows[0])
        umbrella(shape, joints.wrists[0] + 0.08 * build.scale * along)
    return grounded(shape)


def grounded(shape: Shape) -> Shape:
    """The shape moved up or down until its lowest point is on z = 0."""
    low = min(float(part[:, 2].min()) for part in shape.vertices)
    shape.vertices = [part - point(0.0, 0.0, low) for part in shape.vertices]
    return shape


def people() -> list[tuple[str, Shape]]:
    """All meshes of people by name."""
    models = THINGS["pedestrian"]
    return [(f"{m.name}.{pose}", person(m, pose)) for m in models for pose in m.poses]
