"""Check a lidar's sweep: its pavement against the world's, and what the image shows too against the passes.

Points are projected into the image. Depth is interpolated between the four pixels around a point, as on a plane, where
the sixteen around it show one surface without an edge.
"""

from collections.abc import Iterator

import numpy as np

from synth3dlanes.frames import transform
from synth3dlanes.geometry.camera import project
from synth3dlanes.sensors.sweep import LidarPoints, Sweep
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.findings import PROOF_M, Finding, Measure
from synth3dlanes.validate.passes_proof import Passes
from synth3dlanes.world import World

# Pavement is built of faces, and only as far as labels are proved.
MAX_GROUND_M, MAX_RANGE_M, MAX_SHARE, MIN_POINTS = 0.02, 0.01, 0.02, 20
PAVEMENT = [SEMANTIC_IDS[name] for name in ("road", "shoulder")]
# Depth is interpolated where its error by the surface's bend is below this; surfaces whose depths differ by a larger
# share are two.
MAX_BEND_M, ONE_SURFACE = 0.003, 0.02


def prove_lidar(world: World, sweep: Sweep, passes: Passes) -> tuple[list[Finding], list[Measure]]:
    """Findings, and distances of points from the pavement and from the depth pass."""
    points = sweep.points()
    ground = _off_pavement(world, points)
    findings = list(_judge(ground, MAX_GROUND_M, "the pavement of the scene"))
    if not {"depth", "semantic", "instance"} <= set(passes):
        return findings, [ground]
    depth, n_behind, n_otherwise = _against_passes(world, points, passes)
    findings += _judge(depth, MAX_RANGE_M, "the depth pass")
    n = len(depth.values)
    if n_behind > max(MIN_POINTS, MAX_SHARE * n):
        findings.append(
            Finding("", f"lidar: expected points on what the depth pass shows, got {n_behind} in front of it")
        )
    if n_otherwise > max(MIN_POINTS, MAX_SHARE * n):
        findings.append(
            Finding("", f"lidar: expected the ids of the passes, got others at {n_otherwise} of {n} points")
        )
    return findings, [ground, depth]


def _judge(measure: Measure, limit_m: float, of: str) -> Iterator[Finding]:
    values = measure.values[measure.y_m < PROOF_M]
    wrong = values > limit_m
    if wrong.sum() > max(MIN_POINTS, MAX_SHARE * len(values)):
        off = f"{wrong.sum()} of {len(values)} off, by {np.median(values):.3g} m in the median"
        yield Finding("", f"lidar: expected points within {limit_m} m of {of}, got {off}")


def _off_pavement(world: World, points: LidarPoints) -> Measure:
    """Vertical distance of points on road and shoulder from the world's ground, by their range."""
    at = np.isin(points.semantic, PAVEMENT)
    xyz_world = transform(world.view.world_from_lidar, points.xyz_lidar[at])
    off_m = np.abs(xyz_world[:, 2] - world.ground.height(xyz_world[:, :2]))
    return Measure("lidar_ground_m", points.range_m[at].astype(float), off_m)


def _against_passes(world: World, points: LidarPoints, passes: Passes) -> tuple[Measure, int, int]:
    """Differences of range between points and the depth pass, along the camera's rays, where both see one surface; how
    many points are in front of what the pass shows there; and how many of the former have other ids."""
    x, y, z = points.xyz_cam.T
    uv = project(world.view.camera, points.xyz_cam)
    shape = passes["depth"].shape
    with np.errstate(invalid="ignore"):
        inside = ((uv > 2) & (uv < np.array(shape[::-1]) - 2)).all(axis=1)
    uv, y, slant = uv[inside], y[inside], np.sqrt(x**2 + y**2 + z**2)[inside] / y[inside]
    # The sixteen pixels around each point, row by row, and its place between the middle four.
    first = np.floor(uv - 0.5).astype(int)
    rows, columns = (first[:, axis] + np.arange(-1, 3)[:, None] for axis in (1, 0))
    square = rows[:, None], columns[None]
    right, down = (uv - 0.5 - first).T
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / passes["depth"][square].astype(float)
        (a, b), (c, d) = inverse[1, 1:3], inverse[2, 1:3]
        depth = 1 / ((a * (1 - right) + b * right) * (1 - down) + (c * (1 - right) + d * right) * down)
        # A sixteenth of the sum of second differences at both ends is the error of a parabola's chord in its middle.
        bends = sum(
            np.abs(a - b - c + d).max(axis=0) / 16 for a, b, c, d in (inverse[:, 1:3], inverse.swapaxes(0, 1)[:, 1:3])
        )
        clear = bends * depth**2 * slant < MAX_BEND_M
    for ids in (passes["semantic"][square], passes["instance"][square]):
        clear &= (ids == ids[1, 1]).all(axis=(0, 1))
    share = depth / y - 1
    same = clear & (np.abs(share) < ONE_SURFACE)
    is_other = (passes["semantic"][square][1, 1] != points.semantic[inside]) | (
        passes["instance"][square][1, 1] != points.instance[inside]
    )
    measure = Measure("lidar_depth_m", y[same], (np.abs(depth - y) * slant)[same])
    return measure, int((clear & (share > ONE_SURFACE)).sum()), int(is_other[same].sum())
