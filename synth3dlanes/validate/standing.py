"""Do cars and trees stand on the ground that was rendered, and does none of it come up through the road?

Against the very meshes that Blender was given, which are flat between their rows, not against the formulas.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry import meshes
from synth3dlanes.geometry.ground import Ground
from synth3dlanes.geometry.placement import TREE_SINK_M, tree_positions, world_from_car
from synth3dlanes.geometry.road import RoadPlan
from synth3dlanes.geometry.transforms import invert, transform
from synth3dlanes.labels import CameraLabel, Labels
from synth3dlanes.scene import Scene
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.findings import Finding, Measure
from synth3dlanes.validate.passes_proof import Passes

# A fault is what one would see: a rigid car on a crest may have a wheel 5 cm off, and beyond RANGE_M the ground's faces
# are metres long. A trunk's place is 0.1 m in the ground, and its root goes 0.3 m deeper.
MAX_WHEEL_M, MAX_TREE_M, RANGE_M = 0.1, 0.4, 120.0
# Terrain this far inside the pavement's edge is on the road; every STEP-th pixel is asked, within NEAR_M.
INSIDE_M, STEP, NEAR_M = 0.3, 2, 80.0
MAX_THROUGH = 3

Points2 = Float[np.ndarray, "n 2"]
Values = Float[np.ndarray, " n"]


def check_standing(scene: Scene, labels: Labels, passes: Passes) -> tuple[list[Finding], list[Measure]]:
    """Faults by object, with measures `wheel_gap_m` and `tree_gap_m`; with depth and semantic ids, of the road, too."""
    plan = RoadPlan(scene)
    ground = Ground(plan)
    surfaces = meshes.road_meshes(ground)
    wheels = _wheels(plan)
    feet = tree_positions(ground, scene.trees)
    measures = [
        _measure("wheel_gap_m", labels.camera, wheels, _height(surfaces, wheels[:, :2])),
        _measure(
            "tree_gap_m",
            labels.camera,
            feet + np.array([0, 0, TREE_SINK_M]),
            np.fmax(_height(meshes.verge_meshes(ground), feet[:, :2]), _terrain_height(ground, feet[:, :2])),
        ),
    ]
    findings = []
    for measure, limit_m in zip(measures, (MAX_WHEEL_M, MAX_TREE_M), strict=True):
        off_m = measure.values[(measure.values > limit_m) & (measure.y_m < RANGE_M)]
        if off_m.size:
            reason = f"{measure.name}: expected at most {limit_m} m, got {off_m.size} beyond, up to {off_m.max():.2f} m"
            findings.append(Finding("", reason))
    if {"depth", "semantic"} <= set(passes):
        findings += _through(ground, labels.camera, passes)
    return findings, measures


def _wheels(plan: RoadPlan) -> Float[np.ndarray, "n 3"]:
    """Where the tyres of all cars end."""
    wheels = [np.zeros((0, 3))]
    for car in plan.scene.cars:
        model = plan.scene.assets.car_models[car.model - 1]
        x, y = model.track_m / 2 * car.scale, model.wheelbase_m / 2 * car.scale
        wheels.append(transform(world_from_car(plan, car), np.array([[-x, y, 0], [x, y, 0], [-x, -y, 0], [x, -y, 0]])))
    return np.concatenate(wheels)


def _measure(name: str, camera: CameraLabel, points_world: Float[np.ndarray, "n 3"], ground_m: Values) -> Measure:
    """Gaps of points over ground, either way, where there is ground and ahead of the camera."""
    ahead_m = transform(invert(camera.world_from_cam), points_world)[:, 1]
    known = np.isfinite(ground_m) & (ahead_m > 0)
    return Measure(name, ahead_m[known], np.abs(points_world[:, 2] - ground_m)[known])


def _height(surfaces: Sequence[meshes.Mesh], xy: Points2) -> Values:
    """Height of the uppermost face over each point, NaN where there is none."""
    height_m = np.full(len(xy), np.nan)
    for mesh in surfaces:
        corners = mesh.vertices_world[mesh.faces]
        low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
        for i, point in enumerate(xy):
            for quad in corners[((low <= point) & (point <= high)).all(axis=1)]:
                for triangle in (quad[[0, 1, 2]], quad[[0, 2, 3]]):
                    height_m[i] = np.fmax(height_m[i], _on_triangle(triangle, point))
    return height_m


def _on_triangle(triangle: Float[np.ndarray, "3 3"], point: Float[np.ndarray, "2"]) -> float:
    """Height of a triangle over a point, NaN beside it."""
    edges = triangle[1:, :2] - triangle[0, :2]
    area = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    if abs(area) < 1e-9:
        return float("nan")
    a, b = np.linalg.solve(edges.T, point - triangle[0, :2])
    if min(a, b) < -1e-9 or a + b > 1 + 1e-9:
        return float("nan")
    return float(triangle[0, 2] + np.array([a, b]) @ (triangle[1:, 2] - triangle[0, 2]))


def _terrain_height(ground: Ground, xy: Points2) -> Values:
    """Height of the terrain's mesh, taken as bilinear in its cells."""
    vertices = meshes.terrain_mesh(ground).vertices_world
    xs, ys = np.unique(vertices[:, 0]), np.unique(vertices[:, 1])
    z = vertices[:, 2].reshape(len(ys), len(xs))
    j = np.clip(np.searchsorted(xs, xy[:, 0]) - 1, 0, len(xs) - 2)
    i = np.clip(np.searchsorted(ys, xy[:, 1]) - 1, 0, len(ys) - 2)
    a, b = (xy[:, 0] - xs[j]) / (xs[j + 1] - xs[j]), (xy[:, 1] - ys[i]) / (ys[i + 1] - ys[i])
    near, far = z[i, j] + a * (z[i, j + 1] - z[i, j]), z[i + 1, j] + a * (z[i + 1, j + 1] - z[i + 1, j])
    return np.asarray(near + b * (far - near))


def _through(ground: Ground, camera: CameraLabel, passes: Passes) -> Iterator[Finding]:
    """Pixels that show terrain where there is pavement in the plan."""
    depth_m, semantic = passes["depth"][::STEP, ::STEP], passes["semantic"][::STEP, ::STEP]
    v, u = np.nonzero((semantic == SEMANTIC_IDS["terrain"]) & (depth_m < NEAR_M))
    rays_cam = np.column_stack([STEP * u + 0.5, STEP * v + 0.5, np.ones(len(u))]) @ np.linalg.inv(camera.img_from_cam).T
    points = transform(camera.world_from_cam, rays_cam * depth_m[v, u, None].astype(float))
    through = int((ground.clearance(points[:, :2]) < -INSIDE_M).sum())
    if through > MAX_THROUGH:
        yield Finding("", f"passes: expected pavement, got terrain at {through} pixels of {len(u)} on the road")
