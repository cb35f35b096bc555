"""Check a lidar's sweep: its pavement against the world's, and what the image shows too against the passes.

Points are projected into the image. Depth is interpolated between the four pixels around a point, as on a plane, where
the sixteen around it show one surface without an edge.
"""

from collections.abc import Iterator

import numpy as np

from synth3dlanes.frames import transform
from synth3dlanes.geometry.camera import project
from synth3dlanes.sensors.sweep import LidarPoints
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Finding, Measure, Result
from synth3dlanes.validate.pixels import Passes, around, depth_between
from synth3dlanes.world import World

# Pavement is built of faces, and only as far as labels are proved.
MAX_GROUND_M, MAX_RANGE_M, MAX_SHARE, MIN_POINTS = 0.02, 0.01, 0.02, 20
PAVEMENT = [SEMANTIC_IDS[name] for name in ("road", "shoulder")]
# Depth is interpolated where its error by the surface's bend is below this; surfaces whose depths differ by a larger
# share are two.
MAX_BEND_M, ONE_SURFACE = 0.003, 0.02


def check_lidar(evidence: Evidence) -> Iterator[Result]:
    """Findings, and distances of points from the pavement and from the depth pass."""
    sweep = evidence.sweep
    assert sweep is not None
    points = sweep.points()
    ground = _off_pavement(evidence.world, points)
    yield ground
    yield from _judge(ground, MAX_GROUND_M, "the pavement of the scene")
    if not {"depth", "semantic", "instance"} <= evidence.has:
        return
    depth, n_behind, n_otherwise = _against_passes(evidence.world, points, evidence.passes)
    yield depth
    yield from _judge(depth, MAX_RANGE_M, "the depth pass")
    n = len(depth.values)
    if n_behind > max(MIN_POINTS, MAX_SHARE * n):
        yield Finding("", f"lidar: expected points on what the depth pass shows, got {n_behind} in front of it")
    if n_otherwise > max(MIN_POINTS, MAX_SHARE * n):
        yield Finding("", f"lidar: expected the ids of the passes, got others at {n_otherwise} of {n} points")


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
    between, square = depth_between(passes["depth"], uv), around(uv, shape, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        clear = between.bend * between.depth_m * slant < MAX_BEND_M
        share = between.depth_m / y - 1
    is_other = np.zeros(len(y), dtype=bool)
    for name, found in (("semantic", points.semantic), ("instance", points.instance)):
        ids = passes[name][square]
        clear &= (ids == ids[0]).all(axis=0)
        is_other |= ids[0] != found[inside]
    same = clear & (np.abs(share) < ONE_SURFACE)
    measure = Measure("lidar_depth_m", y[same], (np.abs(between.depth_m - y) * slant)[same])
    return measure, int((clear & (share > ONE_SURFACE)).sum()), int(is_other[same].sum())
