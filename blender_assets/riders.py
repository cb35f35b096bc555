"""People on bicycles and motorcycles. Origin between the wheels on the ground, +y forward, metres."""

import numpy as np
from bodies import (
    FOREARM_M,
    HIP_M,
    SHANK_M,
    THIGH_M,
    UPPER_ARM_M,
    Build,
    Joints,
    Vector,
    body,
    loft,
    point,
    reached,
    shoulders,
)
from jaxtyping import Float
from shapes import Shape, grid_faces, rounded_box, tube

from synth3dlanes.scene.assets.catalogue import THINGS, ThingModel
from synth3dlanes.scene.things import ThingKind

TRIM, BODY, TYRE, METAL, GLASS, LAMP, TAIL = 4, 5, 6, 7, 8, 9, 10
CYCLISTS = {
    "man_on_bicycle": Build(1.78, hair="helmet"),
    "woman_on_bicycle": Build(1.69, 0.88, 0.88, 1.0, 0.9, bust_m=0.02, head=1.02, hair="long"),
}
MOTORCYCLISTS = {"motorcyclist": Build(1.78, 1.06, 1.08, 1.04, 1.1, hair="integral", head=1.05)}
# A bicycle: wheels, bottom bracket, crank, saddle, handlebar.
WHEEL_M, TYRE_M, AXLE_M = 0.34, 0.022, 0.53
BRACKET, CRANK_M, PEDAL_OUT_M = np.array([0.0, -0.10, 0.29]), 0.17, 0.13
SADDLE, BAR = np.array([0.0, -0.29, 0.95]), np.array([0.27, 0.31, 1.04])


def ring(shape: Shape, middle: Vector, radius_m: float, thick_m: float, wide_m: float, n: int, material: int) -> None:
    """A tyre about an axle along x."""
    angle, own = 2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(6) / 6
    reach = radius_m - thick_m + thick_m * np.cos(own)
    points = np.stack(
        [
            np.broadcast_to(wide_m * np.sin(own), (n, 6)),
            np.cos(angle)[:, None] * reach,
            np.sin(angle)[:, None] * reach,
        ],
        -1,
    )
    faces = grid_faces(n, 6, wrap=True)
    last = np.array([[(n - 1) * 6 + k, (n - 1) * 6 + (k + 1) % 6, (k + 1) % 6, k] for k in range(6)])
    shape.add(points.reshape(-1, 3) + middle, np.concatenate([faces, last])[:, ::-1], material)


def rod(shape: Shape, points: list[Vector] | Float[np.ndarray, "n 3"], radius_m: float, material: int) -> None:
    """A tube of one radius along points."""
    path = np.array(points)
    shape.add(*tube(path, np.full(len(path), radius_m), 6), material)


def bicycle(shape: Shape, crank_rad: float) -> None:
    """Wheels, frame, fork, handlebar, saddle, mudguard, cranks and pedals."""
    rear, front = np.array([0.0, -AXLE_M, WHEEL_M]), np.array([0.0, AXLE_M, WHEEL_M])
    for axle in (rear, front):
        ring(shape, axle, WHEEL_M, TYRE_M, TYRE_M, 20, TYRE)
        ring(shape, axle, WHEEL_M - 0.03, 0.012, 0.012, 20, METAL)
        rod(shape, [axle - point(0.05, 0, 0), axle + point(0.05, 0, 0)], 0.022, METAL)
        for k in range(8):
            to = np.array([0.0, np.cos(np.pi * k / 4), np.sin(np.pi * k / 4)])
            rod(shape, [axle, axle + (WHEEL_M - 0.04) * to], 0.003, METAL)
    head_low, head_top = np.array([0.0, 0.40, 0.74]), np.array([0.0, 0.36, 0.88])
    seat = SADDLE - point(0, 0, 0.05)
    for a, b in ((BRACKET, seat), (BRACKET, head_low), (BRACKET + 0.82 * (seat - BRACKET), head_top)):
        rod(shape, [a, b], 0.018, BODY)
    for side in (-0.06, 0.06):
        rod(shape, [BRACKET + point(side / 3, 0, 0), rear + point(side, 0, 0)], 0.011, BODY)
        rod(shape, [BRACKET + 0.8 * (seat - BRACKET), rear + point(side, 0, 0)], 0.010, BODY)
        rod(shape, [head_low, front + point(side, 0.0, 0.0)], 0.012, BODY)
        tip = BAR * [np.sign(side), 1, 1]
        stem, bend = head_top + point(0, -0.01, 0.12), head_top + point(np.sign(side) * 0.12, 0.0, 0.13)
        rod(shape, [stem, bend, tip, tip + point(0, -0.08, -0.01)], 0.013, TRIM)
    rod(shape, [head_low, head_top, head_top + point(0, -0.01, 0.12)], 0.020, BODY)
    shape.add(*rounded_box((0.0, -0.30, 0.935), (0.15, 0.25, 0.06), 0.03), TRIM)
    shape.add(*rounded_box((0.0, -AXLE_M - 0.18, 0.74), (0.05, 0.03, 0.06), 0.01, 1), TAIL)
    shape.add(*rounded_box((0.0, 0.46, 0.86), (0.06, 0.05, 0.06), 0.02, 1), LAMP)
    arc = np.linspace(0.15, 0.95, 6) * np.pi
    guard = rear + 0.37 * np.stack([0 * arc, np.cos(arc), np.sin(arc)], -1)
    rod(shape, guard, 0.02, BODY)
    for side in (1, -1):
        pedal = pedal_at(crank_rad, side)
        rod(shape, [BRACKET + point(0.07 * side, 0, 0), pedal - point(0.05 * side, 0, 0)], 0.012, METAL)
        shape.add(*rounded_box(tuple(pedal), (0.09, 0.08, 0.025), 0.008, 1), TRIM)
    ring(shape, BRACKET + point(0.05, 0, 0), 0.095, 0.02, 0.004, 14, METAL)


def pedal_at(crank_rad: float, side: int) -> Vector:
    """The middle of a pedal; the right one is ahead at 0 and goes down first."""
    angle = crank_rad if side > 0 else crank_rad + np.pi
    return BRACKET + np.array([side * PEDAL_OUT_M, CRANK_M * np.cos(angle), -CRANK_M * np.sin(angle)])


def seated(
    build: Build,
    seat: Vector,
    lean_rad: float,
    ankles: tuple[Vector, Vector],
    hands: Vector,
    feet_rad: tuple[float, float],
) -> Joints:
    """The joints of a rider: on a seat, with feet and hands at their places; knees point forward."""
    s = build.scale
    out = np.array([s * HIP_M * build.hips, 0.0, 0.0])
    hips, nothing = (seat + out, seat - out), (seat, seat)
    legs = [
        reached(hip, ankle, (s * THIGH_M, s * SHANK_M), np.array([side * 0.25, 1.0, 0.2]))
        for hip, ankle, side in zip(hips, ankles, (1, -1), strict=True)
    ]
    knees, feet = zip(*legs, strict=True)
    joints = Joints(hips, knees, feet, feet_rad, lean_rad, 0.0, 0.0, 0.12 * lean_rad, nothing, nothing)  # type: ignore[arg-type]
    arms = [
        reached(shoulder, hands * [side, 1, 1] + point(0, -0.09 * s, 0.02), (s * UPPER_ARM_M, s * FOREARM_M),
                np.array([side * 0.5, -0.4, -0.7]))
        for shoulder, side in zip(shoulders(build, joints), (1, -1), strict=True)
    ]  # fmt: skip
    elbows, wrists = zip(*arms, strict=True)
    return Joints(hips, knees, feet, feet_rad, lean_rad, 0.0, 0.0, 0.12 * lean_rad, elbows, wrists)  # type: ignore[arg-type]


def cyclist(model: ThingModel, pose: int) -> Shape:
    """A rider with a foot on the ground (pose 0), or at an instant of a turn of the cranks."""
    build = CYCLISTS[model.name]
    crank = 2 * np.pi * (pose - 1) / model.n_poses if pose else 0.3
    ankles, feet = [], []
    for side in (1, -1):
        pedal = pedal_at(crank, side)
        down = (pedal[2] - BRACKET[2]) / CRANK_M
        ankles.append(pedal + point(-0.02 * side, -0.10, 0.10))
        feet.append(-0.25 + 0.15 * down)
    if not pose:
        ankles[1] = np.array([-0.21, -0.16, 0.085])
        feet[1] = 0.0
    seat = SADDLE + point(0.0, 0.02, 0.085) if pose else SADDLE + point(-0.05, 0.10, -0.03)
    joints = seated(build, seat, 0.52, (ankles[0], ankles[1]), BAR, (feet[0], feet[1]))
    shape = body(build, joints)
    bicycle(shape, crank)
    return shape


def motorcycle(shape: Shape) -> None:
    """Wheels, fork, tank, seat, engine, exhaust, lamps."""
    rear, front = np.array([0.0, -0.70, 0.31]), np.array([0.0, 0.72, 0.31])
    for axle, wide_m in ((rear, 0.085), (front, 0.06)):
        ring(shape, axle, 0.31, 0.06, wide_m, 24, TYRE)
        ring(shape, axle, 0.22, 0.025, 0.03, 16, METAL)
        ring(shape, axle + point(0.05, 0, 0), 0.15, 0.03, 0.006, 14, METAL)
        for k in range(5):
            to = np.array([0.0, np.cos(0.4 * np.pi * k), np.sin(0.4 * np.pi * k)])
            rod(shape, [axle, axle + 0.21 * to], 0.018, METAL)
    for side in (-0.09, 0.09):
        rod(shape, [front + point(side, 0, 0), np.array([side, 0.47, 0.92])], 0.026, METAL)
        rod(shape, [rear + point(side, 0, 0), np.array([side, -0.18, 0.42])], 0.03, TRIM)
        tip = np.array([4.0 * side, 0.30, 1.02])
        rod(shape, [np.array([0.0, 0.44, 0.98]), np.array([2.0 * side, 0.42, 1.03]), tip], 0.015, TRIM)
        rod(shape, [tip + point(0, 0.02, 0), tip + point(side * 0.6, 0.04, 0.13)], 0.006, TRIM)
        shape.add(*rounded_box((4.9 * side, 0.34, 1.16), (0.11, 0.02, 0.075), 0.01, 1), GLASS)
    at = np.array([0.42, 0.36, 0.22, 0.05, -0.06, -0.10])
    centers = np.stack([0 * at, at, [0.86, 0.87, 0.86, 0.82, 0.79, 0.78]], -1)
    loft(shape, centers, np.outer([0.06, 0.13, 0.16, 0.14, 0.11, 0.05], [1.0, 0, 0]),
         np.outer([0.03, 0.12, 0.155, 0.13, 0.09, 0.03], [0, 0, 1.0]), BODY, 12, 2.4)  # fmt: skip
    at = np.array([-0.06, -0.12, -0.35, -0.60, -0.82, -0.90])
    centers = np.stack([0 * at, at, [0.77, 0.77, 0.78, 0.83, 0.87, 0.88]], -1)
    loft(shape, centers, np.outer([0.08, 0.13, 0.14, 0.13, 0.08, 0.04], [1.0, 0, 0]),
         np.outer([0.02, 0.06, 0.065, 0.07, 0.05, 0.02], [0, 0, 1.0]), TRIM, 10, 2.6)  # fmt: skip
    shape.add(*rounded_box((0, 0.10, 0.52), (0.34, 0.46, 0.34), 0.09), METAL)
    shape.add(*rounded_box((0, -0.12, 0.60), (0.24, 0.42, 0.26), 0.08), TRIM)
    shape.add(*rounded_box((0, -0.62, 0.76), (0.20, 0.46, 0.10), 0.04), BODY)
    shape.add(*rounded_box((0, 0.62, 0.66), (0.13, 0.40, 0.05), 0.02), BODY)
    rod(shape, [np.array([0.14, 0.25, 0.40]), np.array([0.17, -0.1, 0.27]), np.array([0.19, -0.5, 0.36]),
                np.array([0.2, -0.85, 0.45])], 0.045, METAL)  # fmt: skip
    shape.add(*rounded_box((0, 0.56, 0.90), (0.24, 0.16, 0.22), 0.08), BODY)
    shape.add(*rounded_box((0, 0.625, 0.90), (0.18, 0.07, 0.17), 0.03), LAMP)
    shape.add(*rounded_box((0, 0.52, 1.08), (0.26, 0.03, 0.20), 0.015, 1), GLASS)
    shape.add(*rounded_box((0, -0.91, 0.84), (0.16, 0.05, 0.07), 0.02), TAIL)
    shape.add(*rounded_box((0, -0.95, 0.62), (0.19, 0.02, 0.20), 0.01, 1), TRIM)


def motorcyclist(model: ThingModel) -> Shape:
    """A rider on a motorcycle."""
    build = MOTORCYCLISTS[model.name]
    feet = [np.array([side * 0.19, -0.12, 0.40]) for side in (1, -1)]
    hands = np.array([0.36, 0.27, 1.02])
    joints = seated(build, np.array([0.0, -0.27, 0.92]), 0.30, (feet[0], feet[1]), hands, (-0.1, -0.1))
    shape = body(build, joints)
    motorcycle(shape)
    return shape


def riders() -> dict[ThingKind, list[tuple[str, Shape]]]:
    """All meshes of riders by kind and name."""
    bicycles, motorcycles = THINGS["cyclist"], THINGS["motorcyclist"]
    return {
        "cyclist": [(f"{m.name}.{pose}", cyclist(m, pose)) for m in bicycles for pose in m.poses],
        "motorcyclist": [(f"{m.name}.0", motorcyclist(m)) for m in motorcycles],
    }
