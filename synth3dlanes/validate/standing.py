"""Check that cars, trees and structures stand on the rendered ground, structures beside the pavement, and that the
terrain does not penetrate the road.

Compares with the meshes that Blender renders, which are flat between their rows, instead of the formulas.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import Matrix4, Points2, Points3, Scalars
from synth3dlanes.validate.boxes import beside_world
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Bounded, Finding, Measure, Result
from synth3dlanes.validate.places import places
from synth3dlanes.world import meshes
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.placement import TREE_SINK_M
from synth3dlanes.world.spans import PASSAGE_M
from synth3dlanes.world.world import World

# Limits of visible gaps: a rigid car on the sharpest crests has a wheel up to 0.21 m off (1,350 scenes; mostly below
# 5 cm), and beyond RANGE_M along the road the ground's faces are metres long. A tree's base is 0.1 m below the ground
# and its root reaches 0.3 m deeper.
MAX_WHEEL_M, MAX_TREE_M, RANGE_M = 0.25, 0.4, 100.0
# Terrain pixels this far inside the pavement's edge penetrate the road; every STEP-th pixel within NEAR_M is checked.
INSIDE_M, STEP, NEAR_M = 0.3, 2, 80.0
MAX_THROUGH = 3
# Every eighth foot of a structure is checked; structures reach as deep into the ground as trees do.
FEET_STEP = 8
# Kerbs stand at the very edge.
ROOM_M = 0.05


def check_standing(evidence: Evidence) -> Iterator[Result]:
    """Findings, and the measures `wheel_gap_m`, `tree_gap_m` and `structure_gap_m`. With depth and semantic ids, checks
    the road too."""
    world, camera = evidence.world, evidence.camera
    wheels = _ahead(camera, _wheels(world))
    trunks = _ahead(camera, world.site.trees_world + np.array([0, 0, TREE_SINK_M]))
    on_ground_m = np.fmax(_under(world.site.surfaces.verges, trunks), terrain_height(world.ground, trunks[:, :2]))
    feet = np.concatenate([np.zeros((0, 3)), *(body.feet_world[::FEET_STEP] for body in world.site.structures)])
    feet = _ahead(camera, feet)
    under_m = np.fmax(
        _under([*world.site.surfaces.pavement, *world.site.surfaces.verges], feet),
        terrain_height(world.ground, feet[:, :2]),
    )
    standing = [
        ("wheel_gap_m", wheels, _under(world.site.surfaces.pavement, wheels), MAX_WHEEL_M),
        ("tree_gap_m", trunks, on_ground_m, MAX_TREE_M),
        *([("structure_gap_m", feet, under_m, MAX_TREE_M)] if len(feet) else []),
    ]
    for name, points, ground_m, limit_m in standing:
        known = np.isfinite(ground_m)
        gap_m = np.abs(points[:, 2] - ground_m)[known]
        yield Measure(name, _in(camera.world_from_cam, points)[known, 1], gap_m)
        is_near = np.abs(_in(world.view.world_from_host, points)[known, 1]) < RANGE_M
        yield Bounded(f"standing.{name}", float(gap_m[is_near].max(initial=0)), most=limit_m)
        off_m = gap_m[(gap_m > limit_m) & is_near]
        if off_m.size:
            reason = f"{name}: expected at most {limit_m} m, got {off_m.size} beyond, up to {off_m.max():.2f} m"
            yield Finding("", reason)
    if {"depth", "semantic"} <= evidence.has:
        yield from _through(evidence)


def _wheels(world: World) -> Points3:
    """The contact points of all cars' tyres."""
    wheels = [np.zeros((0, 3))]
    for car, world_from_car in zip(world.scene.cars, world.view.world_from_cars, strict=True):
        model = world.scene.assets.car_models[car.model - 1]
        x, y = model.track_m / 2 * car.scale, model.wheelbase_m / 2 * car.scale
        wheels.append(transform(world_from_car, np.array([[-x, y, 0], [x, y, 0], [-x, -y, 0], [x, -y, 0]])))
    return np.concatenate(wheels)


def _ahead(camera: CameraLabel, points_world: Points3) -> Float[np.ndarray, "m 3"]:
    """The points that are ahead of the camera."""
    return points_world[_in(camera.world_from_cam, points_world)[:, 1] > 0]


def _in(world_from_frame: Matrix4, points_world: Points3) -> Points3:
    """The points in another frame."""
    return transform(invert(world_from_frame), points_world)


def _under(surfaces: Sequence[meshes.Mesh], points_world: Points3) -> Scalars:
    """Height of the highest face at each point that does not pass over it on a deck."""
    return mesh_height(surfaces, points_world[:, :2], points_world[:, 2] + PASSAGE_M)


def mesh_height(surfaces: Sequence[meshes.Mesh], xy: Points2, most_m: Scalars | float = np.inf) -> Scalars:
    """Height of the highest face at each point, at most `most_m`; of the lowest where all are higher, NaN where there
    is none."""
    most_m = np.broadcast_to(most_m, len(xy))
    height_m, over_m = np.full(len(xy), -np.inf), np.full(len(xy), np.inf)
    by_y = np.argsort(xy[:, 1])
    y = xy[by_y, 1]
    for mesh in surfaces:
        corners = mesh.vertices_world[mesh.faces]
        low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
        # First by y alone, which separates most of a road's faces: each has a run of the points in their order.
        start, end = np.searchsorted(y, low[:, 1]), np.searchsorted(y, high[:, 1], side="right")
        n = end - start
        face = np.repeat(np.arange(len(n)), n)
        i = by_y[np.arange(len(face)) + (start - np.cumsum(n) + n)[face]]
        over = (low[face, 0] <= xy[i, 0]) & (xy[i, 0] <= high[face, 0])
        i, face = i[over], face[over]
        for triangle in ([0, 1, 2], [0, 2, 3]):
            found_m = _on_triangles(corners[face][:, triangle], xy[i])
            is_over = found_m > most_m[i]
            np.fmax.at(height_m, i[~is_over], found_m[~is_over])
            np.fmin.at(over_m, i[is_over], found_m[is_over])
    height_m = np.where(np.isfinite(height_m), height_m, over_m)
    return np.where(np.isfinite(height_m), height_m, np.nan)


def _on_triangles(triangles: Float[np.ndarray, "n 3 3"], xy: Points2) -> Scalars:
    """Height of each triangle at its point, NaN for points outside the triangle."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(triangles[:, 1:] - triangles[:, :1], 0, -1)
    x, y = (xy - triangles[:, 0, :2]).T
    area = ax * by - ay * bx
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (x * by - y * bx) / area, (ax * y - ay * x) / area
        inside = (np.abs(area) > 1e-9) & (np.minimum(a, b) > -1e-9) & (a + b < 1 + 1e-9)
        return np.where(inside, triangles[:, 0, 2] + a * az + b * bz, np.nan)


def terrain_height(ground: Ground, xy: Points2) -> Scalars:
    """Height of the terrain mesh, interpolated bilinearly in its cells."""
    xs, ys = ground.mesh_axes
    j = np.clip(np.searchsorted(xs, xy[:, 0]) - 1, 0, len(xs) - 2)
    i = np.clip(np.searchsorted(ys, xy[:, 1]) - 1, 0, len(ys) - 2)
    corners = np.stack([xs[[j, j + 1, j, j + 1]], ys[[i, i, i + 1, i + 1]]], axis=-1)
    z = ground.mesh_heights(corners)
    a, b = (xy[:, 0] - xs[j]) / (xs[j + 1] - xs[j]), (xy[:, 1] - ys[i]) / (ys[i + 1] - ys[i])
    near, far = z[0] + a * (z[1] - z[0]), z[2] + a * (z[3] - z[2])
    return np.asarray(near + b * (far - near))


def _through(evidence: Evidence) -> Iterator[Result]:
    """Finding for pixels that show terrain where the scene has pavement."""
    ground, passes = evidence.world.ground, evidence.passes
    depth_m, semantic = passes["depth"][::STEP, ::STEP], passes["semantic"][::STEP, ::STEP]
    v, u = np.nonzero((semantic == SEMANTIC_IDS["terrain"]) & (depth_m < NEAR_M) & evidence.has_points[::STEP, ::STEP])
    points = evidence.points_world(STEP * v, STEP * u)
    inside = ground.clearance(points[:, :2]) < -INSIDE_M
    inside &= ~ground.is_grass(points[:, :2], INSIDE_M)
    # Below a deck, and over a tunnel, the ground goes on.
    inside &= ~ground.is_stacked(points[:, :2])
    through = int(inside.sum())
    yield Bounded("standing.through", float(through), most=MAX_THROUGH)
    if through > MAX_THROUGH:
        yield Finding("", f"passes: expected pavement, got terrain at {through} pixels of {len(u)} on the road")


def check_roadside(evidence: Evidence) -> Iterator[Finding]:
    """Findings about structures on a pavement; poles may stand on the walkways of a map, and below its decks. What
    stands on a median is left to the road's own checks, and what has no pole hangs."""
    ground = evidence.world.ground
    for name, feet in _feet(evidence):
        place = places(ground, feet)
        inside_m = -(place.outside() if name.startswith("buildings") else place.off_carriageways())
        inside_m[ground.is_stacked(feet)] = -np.inf
        wrong = int((inside_m > ROOM_M).sum())
        if wrong:
            reason = (
                f"expected it beside the pavement, got {wrong} of {len(feet)} places up to {inside_m.max():.2f} m on it"
            )
            yield Finding("", f"roadside.{name}: {reason}")


def _feet(evidence: Evidence) -> Iterator[tuple[str, Float[np.ndarray, "n 2"]]]:
    """The name of every structure with a place beside the road, and points where it stands."""
    world, roadside = evidence.world, evidence.scene.roadside
    for i, rail in enumerate(roadside.rails):
        if rail.side != "median":
            s = np.linspace(rail.from_m, rail.to_m, 2 + int(abs(rail.to_m - rail.from_m) / 2))
            yield f"rails.{i}", beside_world(world, rail.road, rail.side, s, rail.aside_m)
    for i, post in enumerate(roadside.posts):
        if post.side != "median":
            yield f"posts.{i}", beside_world(world, post.road, post.side, np.array([post.s_m]), post.aside_m)
    for name in ("signals", "signs"):
        for i, item in enumerate(getattr(roadside, name)):
            if item.has_pole:
                yield f"{name}.{i}", np.array([[item.x_m, item.y_m]])
    first_owner = len(roadside.rails) + len(roadside.posts) + len(roadside.crossings)
    first = int(np.searchsorted(evidence.structures.owners, first_owner))
    boxes = [values[first : first + len(roadside.buildings)] for values in evidence.structures.boxes]
    share = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), [0.0]), -1).reshape(-1, 3)
    for i, (pose, low, high) in enumerate(zip(*boxes, strict=True)):
        yield f"buildings.{i}", transform(pose, low + share * (high - low))[:, :2]
