"""Check a lidar's sweep all around: its pavement and bodies against the world's, as those of the passes are; and what
the image shows too against the passes.

Points are projected into the image. Depth is interpolated between the four pixels around a point, as on a plane, where
the sixteen around it show one surface without an edge.
"""

from collections.abc import Iterator

import numpy as np

from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.sweep import LidarPoints
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import Passes
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Bounded, Finding, Measure, Result
from synth3dlanes.validate.ids import THINGS, disagreement, kind_of, outside_bodies
from synth3dlanes.validate.pixels import around, depth_between
from synth3dlanes.validate.places import places
from synth3dlanes.validate.surface import MAX_GAP_M, PAVEMENT, misplaced, pavement_at
from synth3dlanes.world.camera import project
from synth3dlanes.world.world import World

# Error of a point's range, the share of points that may have more, and the least number of points that is judged.
MAX_RANGE_M, MAX_SHARE, MIN_POINTS = 0.01, 0.02, 20
# Depth is interpolated where its error by the surface's bend is below this; surfaces whose depths differ by a larger
# share are two.
MAX_BEND_M, ONE_SURFACE = 0.003, 0.02
# Rows of the pavement are 1 m apart where labels are.
FINE_M = 1.5


def check_lidar(evidence: Evidence) -> Iterator[Result]:
    """Findings, and distances of points from the pavement and from the depth pass."""
    points, world = evidence.returns, evidence.world
    assert points is not None
    points_world = transform(world.view.world_from_lidar, points.xyz_lidar)
    paved = np.isin(points.semantic, PAVEMENT) & (points.range_m < PROOF_M)
    paved[paved] = places(world.ground, points_world[paved, :2]).is_firm()
    eye_world, range_m = world.view.world_from_lidar[:3, 3], points.range_m[paved].astype(float)
    pavement = pavement_at(world, eye_world, points_world[paved], range_m, points.semantic[paved])
    pavement = pavement.at(pavement.places.is_fine(FINE_M))
    ground = Measure("lidar_ground_m", pavement.range_m, np.abs(pavement.gap_m))
    yield ground
    yield from _judge(ground, MAX_GAP_M, "the pavement of the scene")
    yield from misplaced("lidar", pavement)
    yield from disagreement("lidar", points.semantic, points.instance)
    for key in THINGS:
        at = kind_of(points.instance) == SEMANTIC_IDS[key]
        yield from outside_bodies(evidence, "lidar", key, points_world[at], points.instance[at].astype(int))
    if not {"depth", "semantic", "instance"} <= evidence.has:
        return
    depth, n_behind, n_otherwise, n = _against_passes(world, points, evidence.passes)
    yield depth
    yield from _judge(depth, MAX_RANGE_M, "the depth pass")
    if n_behind > max(MIN_POINTS, MAX_SHARE * n):
        yield Finding("", f"lidar: expected points on what the depth pass shows, got {n_behind} in front of it")
    if n_otherwise > max(MIN_POINTS, MAX_SHARE * n):
        yield Finding("", f"lidar: expected the ids of the passes, got others at {n_otherwise} of {n} points")


def _judge(measure: Measure, limit_m: float, of: str) -> Iterator[Result]:
    values = measure.values[measure.y_m < PROOF_M]
    wrong = values > limit_m
    if len(values) >= MIN_POINTS / MAX_SHARE:
        yield Bounded(f"lidar.{measure.name}", float(wrong.mean()), most=MAX_SHARE)
    if wrong.sum() > max(MIN_POINTS, MAX_SHARE * len(values)):
        off = f"{wrong.sum()} of {len(values)} off, by {np.median(values):.3g} m in the median"
        yield Finding("", f"lidar: expected points within {limit_m} m of {of}, got {off}")


def _against_passes(world: World, points: LidarPoints, passes: Passes) -> tuple[Measure, int, int, int]:
    """Differences of range between points and the depth pass, along the camera's rays, where both see one pavement
    (bodies have parts smaller than a pixel); how many points are in front of what the pass shows; how many on it have
    other ids; and how many are on it."""
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
    paved = same & np.isin(points.semantic[inside], PAVEMENT)
    measure = Measure("lidar_depth_m", y[paved], (np.abs(between.depth_m - y) * slant)[paved])
    return measure, int((clear & (share > ONE_SURFACE)).sum()), int(is_other[same].sum()), int(same.sum())
