"""Human bodies in clothes as lofts, from the places of their joints.

x right, y forward, z up, metres. Shares of a build are those of a man of 1.78 m, whose hip joints are at 0.95 m.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from shapes import Shape, grid_faces

UPPER, LOWER, SKIN, HAIR, SHOE = range(5)

Vector = Float[np.ndarray, "3"]
Rings = Float[np.ndarray, "n 3"]
# Lengths of the man: from the sole to the ankle, shank, thigh, upper arm, forearm; half the distances of hips and of
# shoulders, and the height of these over the hips.
ANKLE_M, SHANK_M, THIGH_M, UPPER_ARM_M, FOREARM_M = 0.08, 0.43, 0.44, 0.30, 0.26
HIP_M, SHOULDER_M, SHOULDER_UP_M = 0.09, 0.172, 0.455
MAN_M = 1.78
# Sections over the hips: height, half width, half depth, forward.
PELVIS = ((-0.11, 0.07, 0.07, 0.0), (-0.09, 0.14, 0.10, 0.0), (-0.03, 0.168, 0.117, -0.004), (0.05, 0.172, 0.118, 0.0),
          (0.12, 0.158, 0.106, 0.0))  # fmt: skip
TORSO = ((-0.075, 0.165, 0.112, 0.0), (-0.07, 0.184, 0.132, 0.0), (0.03, 0.178, 0.126, 0.002),
         (0.15, 0.165, 0.115, 0.004), (0.27, 0.176, 0.122, 0.006), (0.37, 0.196, 0.130, 0.0),
         (0.43, 0.200, 0.120, -0.008), (0.475, 0.182, 0.102, -0.012), (0.51, 0.135, 0.086, -0.012),
         (0.545, 0.085, 0.072, -0.008), (0.57, 0.066, 0.064, -0.002), (0.572, 0.055, 0.055, 0.0))  # fmt: skip
NECK = ((0.54, 0.052, 0.055, 0.0), (0.60, 0.051, 0.054, 0.004), (0.64, 0.050, 0.056, 0.010))
HEAD = ((0.602, 0.012, 0.020, 0.070), (0.606, 0.034, 0.044, 0.055), (0.625, 0.052, 0.072, 0.034),
        (0.650, 0.062, 0.086, 0.022), (0.680, 0.069, 0.094, 0.013), (0.715, 0.074, 0.099, 0.006),
        (0.745, 0.076, 0.100, 0.001), (0.775, 0.073, 0.096, -0.003), (0.802, 0.061, 0.081, -0.005),
        (0.820, 0.041, 0.056, -0.006), (0.829, 0.012, 0.018, -0.006))  # fmt: skip
# Along limbs: shares of the way from joint to joint (0 to 1, 1 to 2) and radii.
LEG = ((-0.06, 0.050), (0.0, 0.088), (0.2, 0.090), (0.5, 0.076), (0.8, 0.063), (0.92, 0.060), (1.0, 0.060),
       (1.08, 0.059), (1.25, 0.060), (1.5, 0.057), (1.8, 0.054), (1.97, 0.056), (1.975, 0.045))  # fmt: skip
BARE_LEG = ((0.0, 0.07), (0.5, 0.065), (0.85, 0.052), (1.0, 0.048), (1.15, 0.046), (1.3, 0.052), (1.6, 0.042),
            (1.9, 0.033), (2.0, 0.034))  # fmt: skip
ARM = ((-0.13, 0.022), (-0.09, 0.044), (0.02, 0.058), (0.25, 0.056), (0.6, 0.050), (0.9, 0.045), (1.0, 0.045),
       (1.1, 0.044), (1.4, 0.043), (1.8, 0.036), (1.93, 0.037), (1.94, 0.026))  # fmt: skip
HAND = ((-0.03, 0.023, 0.020), (0.03, 0.030, 0.020), (0.07, 0.041, 0.022), (0.11, 0.040, 0.020), (0.15, 0.028, 0.015),
        (0.175, 0.008, 0.006))  # fmt: skip
# Along a shoe: from the ankle forward, half width, height of its top over the sole.
SOLE = ((-0.085, 0.012, 0.035), (-0.075, 0.030, 0.062), (-0.045, 0.038, 0.095), (0.0, 0.041, 0.105),
        (0.05, 0.043, 0.082), (0.11, 0.048, 0.060), (0.16, 0.046, 0.050), (0.19, 0.034, 0.040),
        (0.205, 0.010, 0.022))  # fmt: skip


@dataclass(frozen=True)
class Build:
    """A body and its clothes: height, breadths as shares of the man's, how far the belly stands out, and the size of
    the head beside that of the rest. The hem of a skirt or coat is a share of the thigh's length below the hips."""

    height_m: float = MAN_M
    shoulders: float = 1.0
    waist: float = 1.0
    hips: float = 1.0
    limbs: float = 1.0
    belly_m: float = 0.0
    bust_m: float = 0.0
    head: float = 1.0
    hair: Literal["short", "long", "helmet", "integral"] = "short"
    skirt: float = 0.0
    coat: float = 0.0

    @property
    def scale(self) -> float:
        """Its size beside the man's, without the head's."""
        return self.height_m / (MAN_M + 0.23 * (self.head - 1))


@dataclass(frozen=True)
class Joints:
    """Where a body's joints are, right ones first. The spine leads from the middle of the hips to that of the
    shoulders; both are turned about the vertical, counter-clockwise. `head_rad` is how far the head nods forward,
    `feet_rad` how far toes point up."""

    hips: tuple[Vector, Vector]
    knees: tuple[Vector, Vector]
    ankles: tuple[Vector, Vector]
    feet_rad: tuple[float, float]
    lean_rad: float
    pelvis_rad: float
    chest_rad: float
    head_rad: float
    elbows: tuple[Vector, Vector]
    wrists: tuple[Vector, Vector]

    @property
    def root(self) -> Vector:
        """The middle of the hips."""
        return (self.hips[0] + self.hips[1]) / 2


def point(x: float, y: float, z: float) -> Vector:
    """A place, or the way to another one."""
    return np.array([x, y, z])


def loft(
    shape: Shape, centers: Rings, across: Rings, ahead: Rings, material: int, sides: int, power: float = 2.0
) -> None:
    """Skin rings with these half axes, closed at both ends; `across` x `ahead` points along the loft. Rings are
    superellipses of this power."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    cos, sin = (np.sign(v) * np.abs(v) ** (2 / power) for v in (np.cos(angle), np.sin(angle)))
    rings = centers[:, None] + cos[None, :, None] * across[:, None] + sin[None, :, None] * ahead[:, None]
    n = len(centers)
    ends = np.stack([centers[0], centers[-1]])
    after = (np.arange(sides) + 1) % sides
    first = np.stack([np.full(sides, n * sides), after, np.arange(sides), np.full(sides, -1)], -1)
    last = (n - 1) * sides
    final = np.stack([np.full(sides, n * sides + 1), last + np.arange(sides), last + after, np.full(sides, -1)], -1)
    faces = np.concatenate([grid_faces(n, sides, wrap=True), first, final])
    shape.add(np.concatenate([rings.reshape(-1, 3), ends]), faces, material)


def turned(points: Float[np.ndarray, "*n 3"], yaw_rad: float) -> Float[np.ndarray, "*n 3"]:
    """Points turned counter-clockwise about the vertical."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


def limb(
    shape: Shape,
    joints: tuple[Vector, Vector, Vector],
    profile: tuple[tuple[float, float], ...],
    scale: float,
    material: int,
    sides: int = 8,
) -> None:
    """A sleeve or leg along two bones, rounded where these meet."""
    shares, radii = np.array(profile).T
    start, middle, end = joints
    first, second = middle - start, end - middle
    near = shares[:, None] <= 1
    centers = np.where(near, start + shares[:, None] * first, middle + (shares[:, None] - 1) * second)
    tangents = np.gradient(centers, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    # Inside of a sharp bend rings would cut each other.
    side = np.array([1.0, 0.0, 0.0]) if abs(tangents[:, 0]).max() < 0.9 else np.array([0.0, 0.0, 1.0])
    across = side - (tangents @ side)[:, None] * tangents
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    ahead = np.cross(tangents, across)
    loft(shape, centers, scale * radii[:, None] * across, scale * radii[:, None] * ahead, material, sides)


def spine_rings(
    sections: tuple[tuple[float, float, float, float], ...], build: Build, joints: Joints, fullness: float = 1.0
) -> tuple[Rings, Rings, Rings]:
    """Centres and half axes of sections of the trunk, along the spine; `fullness` is that of belly and bust."""
    s = build.scale
    up, width, depth, forward = np.array(sections).T
    by = np.clip(up / SHOULDER_UP_M, 0, 1)
    breadth = np.interp(up, (0.0, 0.15, 0.30, 0.44), (build.hips, build.waist, 0.5 * (build.waist + build.shoulders),
                                                      build.shoulders))  # fmt: skip
    belly = build.belly_m * np.exp(-(((up - 0.10) / 0.13) ** 2)) + build.bust_m * np.exp(-(((up - 0.33) / 0.06) ** 2))
    belly *= fullness
    yaw = joints.pelvis_rad + by * (joints.chest_rad - joints.pelvis_rad)
    lean = joints.lean_rad
    axis = np.array([0.0, np.sin(lean), np.cos(lean)])
    front = np.array([0.0, np.cos(lean), -np.sin(lean)])
    across = np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], -1)
    ahead = np.stack([-np.sin(yaw), np.cos(yaw) * front[1], np.cos(yaw) * front[2]], -1)
    centers = joints.root + s * (up[:, None] * axis + (forward + belly / 2)[:, None] * ahead)
    return (
        centers,
        s * (width * breadth)[:, None] * across,
        s * (depth * (0.4 + 0.6 * breadth) + belly / 2)[:, None] * ahead,
    )


def shoulders(build: Build, joints: Joints) -> tuple[Vector, Vector]:
    """The joints of the shoulders."""
    s, lean = build.scale, joints.lean_rad
    middle = joints.root + s * SHOULDER_UP_M * np.array([0.0, np.sin(lean), np.cos(lean)])
    out = turned(np.array([s * SHOULDER_M * build.shoulders, 0.0, 0.0]), joints.chest_rad)
    return middle + out, middle - out


def head(shape: Shape, build: Build, joints: Joints) -> None:
    """Neck, face and hair or a helmet, which nod about the neck."""
    s, lean = build.scale, joints.lean_rad
    loft(shape, *spine_rings(NECK, build, joints), SKIN, 10)
    foot = joints.root + s * 0.57 * np.array([0.0, np.sin(lean), np.cos(lean)])
    nod = joints.head_rad
    axis, front = np.array([0.0, np.sin(nod), np.cos(nod)]), np.array([0.0, np.cos(nod), -np.sin(nod)])
    up, width, depth, forward = (np.array(HEAD) - [0.57, 0, 0, 0]).T * build.head
    sides = 14
    centers = foot + s * (up[:, None] * axis + forward[:, None] * front)
    across = s * width[:, None] * np.array([1.0, 0.0, 0.0])
    own = Shape()
    loft(own, centers, across, s * depth[:, None] * front, SKIN, sides)
    vertices, faces, _ = own.arrays()
    out = vertices - foot
    high, ahead = out @ axis / s / build.head, out @ front / s / build.head
    # The nose, between eyes and mouth.
    is_nose = (np.abs(out[:, 0]) < 0.25 * s * 0.076) & (ahead > 0.06) & (high > 0.09) & (high < 0.15)
    vertices[is_nose] += s * 0.014 * front
    hairline = 0.168 if build.hair == "short" else 0.165
    is_hair = high > hairline - 0.115 * np.clip((0.055 - ahead) / 0.06, 0, 1)
    if build.hair == "long":
        is_hair |= (ahead < -0.02) & (high > 0.0)
    if build.hair == "helmet":
        is_hair = high > 0.15 - 0.05 * np.clip((0.02 - ahead) / 0.05, 0, 1)
    if build.hair == "integral":
        is_hair = (ahead < 0.05) | (high < 0.075) | (high > 0.165)
    middle = centers[len(centers) // 2 + 1]
    grown = {"helmet": 0.022, "integral": 0.034}.get(build.hair, 0.010)
    away = vertices - middle
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
    vertices[is_hair] += s * build.head * grown * away[is_hair]
    corners = np.where(faces < 0, faces[:, :1], faces)
    material = np.where(is_hair[corners].mean(axis=1) > 0.7, HAIR, SHOE if build.hair == "integral" else SKIN)
    shape.add(vertices, faces, material)
    if build.hair == "long":
        fall = ((0.16, 0.079, 0.060, -0.045), (0.08, 0.086, 0.062, -0.048), (0.02, 0.092, 0.058, -0.056),
                (-0.05, 0.098, 0.05, -0.075), (-0.10, 0.085, 0.04, -0.095), (-0.12, 0.06, 0.025, -0.10))  # fmt: skip
        up, width, depth, forward = np.array(fall[::-1]).T
        centers = foot + s * (up[:, None] * axis + forward[:, None] * front)
        loft(shape, centers, s * width[:, None] * [1.0, 0, 0], s * depth[:, None] * front, HAIR, 8)


def hand(shape: Shape, build: Build, elbow: Vector, wrist: Vector) -> None:
    """A hand that goes on from the forearm."""
    s = build.scale
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    at, wide, thick = np.array(HAND).T * s
    side = np.array([1.0, 0.0, 0.0])
    across = side - (along @ side) * along
    across /= np.linalg.norm(across)
    ahead = np.cross(along, across)
    centers = wrist + at[:, None] * along
    loft(shape, centers, thick[:, None] * across, wide[:, None] * ahead, SKIN, 6)


def shoe(shape: Shape, build: Build, ankle: Vector, pitch_rad: float, yaw_rad: float) -> None:
    """A shoe with a flat sole; its toes point up by `pitch_rad`."""
    s = build.scale * (0.92 + 0.08 * build.limbs)
    at, half, top = np.array(SOLE).T * s
    front = turned(np.array([0.0, np.cos(pitch_rad), np.sin(pitch_rad)]), yaw_rad)
    side = turned(np.array([1.0, 0.0, 0.0]), yaw_rad)
    up = np.cross(side, front)
    low = -ANKLE_M * build.scale + 0.06 * s * np.clip((at / s - 0.12) / 0.085, 0, 1) ** 2
    middle = low + top / 2
    centers = ankle + at[:, None] * front + middle[:, None] * up
    loft(shape, centers, top[:, None] / 2 * up, half[:, None] * side, SHOE, 8, 2.6)


def hem(build: Build, joints: Joints, reach: float, width: float) -> tuple[float, float, float, float]:
    """The section of a skirt or coat around both thighs, a share of their length below the hips."""
    s, root = build.scale, joints.root
    thighs = [hip + reach * (knee - hip) for hip, knee in zip(joints.hips, joints.knees, strict=True)]
    low, high = min(point[1] for point in thighs) - root[1], max(point[1] for point in thighs) - root[1]
    up = np.mean([point[2] for point in thighs]) - root[2]
    return float(up / s), width, float((high - low) / 2 / s + 0.105), float((high + low) / 2 / s)


def body(build: Build, joints: Joints) -> Shape:
    """A body in its clothes, as a shape with the materials UPPER to SHOE."""
    shape, s = Shape(), build.scale
    limbs = s * build.limbs
    legs = list(zip(joints.hips, joints.knees, joints.ankles, strict=True))
    for leg in legs:
        limb(shape, leg, BARE_LEG if build.skirt else LEG, limbs, SKIN if build.skirt else LOWER)
    lower = PELVIS
    if build.skirt:
        hems = [hem(build, joints, share * build.skirt, 0.18 + 0.03 * share) for share in (1.0, 0.66, 0.33)]
        lower = (*hems, *PELVIS[2:])
    loft(shape, *spine_rings(lower, build, joints, 0.6), LOWER, 14, 2.3)
    upper = TORSO
    if build.coat:
        hems = [hem(build, joints, share * build.coat, 0.195) for share in (1.0, 0.6, 0.25)]
        upper = (*hems, *TORSO[2:])
    loft(shape, *spine_rings(upper, build, joints), UPPER, 16, 2.3)
    for k, shoulder in enumerate(shoulders(build, joints)):
        limb(shape, (shoulder, joints.elbows[k], joints.wrists[k]), ARM, limbs, UPPER)
        hand(shape, build, joints.elbows[k], joints.wrists[k])
        shoe(shape, build, joints.ankles[k], joints.feet_rad[k], (1 - 2 * k) * -0.12 + joints.pelvis_rad)
    head(shape, build, joints)
    return shape


def reached(start: Vector, end: Vector, lengths: tuple[float, float], towards: Vector) -> tuple[Vector, Vector]:
    """Where two bones from `start` bend and end to reach `end`, or as near to it as they do; the joint is on the side
    `towards`."""
    first, second = lengths
    way = end - start
    away = float(np.linalg.norm(way))
    along, away = way / away, min(away, 0.999 * (first + second))
    ahead = (first**2 - second**2 + away**2) / (2 * away)
    out = towards - (towards @ along) * along
    out /= np.linalg.norm(out)
    return start + ahead * along + np.sqrt(max(first**2 - ahead**2, 0.0)) * out, start + away * along
