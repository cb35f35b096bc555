"""How much of each object a camera sees: rays through the pixels that it would fill, against meshes and ground."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from synth3dlanes.blender.build import MeshInstance
from synth3dlanes.blender.occlusion import Bounds, bounding_box, hidden_by_objects, search_tree
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.system.arrays import Points2, Points3

# Number of rays towards every object; one that is seen in part gets up to MAX_RAYS.
SOME_RAYS = 100
# Rays go through the centres of the pixels in an object's box, of at most MAX_RAYS of them. Columns and rows of the
# grid over the image that finds the boxes.
MAX_RAYS, GRID = 1000, (40, 30)
# Steps of a lattice that is even however many of its points are taken, and leaves no gaps along upright edges, as rows
# and columns would.
LATTICE = np.array([0.7548776662466927, 0.5698402909980532])


def seen_fractions(
    items: list[MeshInstance],
    placed: list[MeshInstance],
    structures: BVHTree | None,
    camera: CameraLabel,
    seen_over_ground: Callable[[Points3], Bool[np.ndarray, " n"]],
) -> tuple[float, ...]:
    """For each object, the share of the pixels that it would fill, were it alone, that ground and others leave to it; 0
    for one without any."""
    eye, grid = camera.world_from_cam[:3, 3], _grid(camera)
    rays = [_rays(item, camera, *grid) for item in items]

    def seen(numbers: list[int], first: int, last: int) -> list[Bool[np.ndarray, " n"]]:
        """For each of these objects, which of the places that its rays `first` to `last` meet are seen."""
        surfaces = [_surface(items[i], eye, rays[i][first:last]) for i in numbers]
        points = np.concatenate([*surfaces, np.zeros((0, 3))])
        found = seen_over_ground(points)
        found[found] = ~hidden_by_objects(placed, structures, eye, points[found])
        return np.split(found, np.cumsum([len(surface) for surface in surfaces]))[:-1]

    found = seen(list(range(len(items))), 0, SOME_RAYS)
    partly = [i for i, share in enumerate(found) if share.any() and not share.all()]
    for i, more in zip(partly, seen(partly, SOME_RAYS, MAX_RAYS), strict=True):
        found[i] = np.concatenate([found[i], more])
    return tuple(round(float(share.mean()), 3) if share.size else 0.0 for share in found)


def _size(camera: CameraLabel) -> Float[np.ndarray, "2"]:
    return np.array([camera.width_px, camera.height_px], dtype=float)


def _grid(camera: CameraLabel) -> tuple[Points2, Points3]:
    """Pixels all over the image up to its borders, and the unit vectors (camera frame) along which they look."""
    axes = [np.linspace(0.5, size - 0.5, n) for n, size in zip(GRID, _size(camera), strict=True)]
    pixels = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    return pixels, camera.rays(pixels)


def _rays(item: MeshInstance, camera: CameraLabel, grid: Points2, grid_rays: Points3) -> Float[np.ndarray, "m 3"]:
    """Unit vectors in the object's frame from the eye through pixels of its bounding box; any number of the first of
    them is evenly spread over it."""
    box = bounding_box(item.mesh.name)
    object_from_cam = invert(item.world_from_object) @ camera.world_from_cam
    turn, eye = object_from_cam[:3, :3].T, object_from_cam[:3, 3] / item.scale
    # A box smaller than the grid's cells is found by its corners, one around the camera by the grid.
    on_grid, cell = grid[_meets(box, eye, grid_rays @ turn)], _size(camera) / (np.array(GRID) - 1)
    corners = np.stack(np.meshgrid(*np.transpose(box)), axis=-1).reshape(-1, 3) * item.scale
    uv = np.concatenate([camera.project(transform(invert(object_from_cam), corners)), on_grid - cell, on_grid + cell])
    uv = np.clip(uv[np.isfinite(uv).all(axis=1)], 0, _size(camera))
    if not len(uv) or not np.ptp(uv, axis=0).all():
        return np.zeros((0, 3))
    rays = camera.rays(_pixels(np.floor(uv.min(axis=0)), np.ceil(uv.max(axis=0)))) @ turn
    return np.asarray(rays[_meets(box, eye, rays)])


def _pixels(low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> Points2:
    """The centres of the pixels of a rectangle, or of MAX_RAYS of them: any number of the first is evenly spread."""
    columns, rows = (high - low).astype(int)
    if columns * rows > MAX_RAYS:
        return low + np.floor((high - low) * (np.arange(MAX_RAYS)[:, None] * LATTICE % 1)) + 0.5
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return low + pixels[np.argsort((pixels @ LATTICE) % 1, kind="stable")] + 0.5


def _meets(box: Bounds, eye: Float[np.ndarray, "3"], rays: Points3) -> Bool[np.ndarray, " n"]:
    """Which rays from the eye meet a box; none that are NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (np.stack(box)[:, None] - eye) / rays
    enters, leaves = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
    return np.asarray((leaves > 0) & (enters < leaves))


def _surface(item: MeshInstance, eye_world: Float[np.ndarray, "3"], rays: Points3) -> Float[np.ndarray, "m 3"]:
    """World points where rays from the eye, in the object's frame, first meet it."""
    eye = transform(invert(item.world_from_object), eye_world) / item.scale
    tree, origin = search_tree(item.mesh.name), Vector(eye)
    hits = (tree.ray_cast(origin, ray)[0] for ray in rays.tolist())
    points = np.array([hit for hit in hits if hit is not None]).reshape(-1, 3)
    return transform(item.world_from_object, points * item.scale)
