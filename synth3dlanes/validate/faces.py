"""Where points are on the very meshes that are rendered: the nearest face of each, and the height of faces over (x, y).
World frame, metres."""

from collections.abc import Iterator, Sequence
from functools import lru_cache, reduce
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from synth3dlanes.system.arrays import AnyScalars, Points2, Points3, Scalars
from synth3dlanes.world.meshes import Mesh
from synth3dlanes.world.world import World

# How far a point may be from a face to belong to it.
REACH_M = 0.3
# Faces are kept up to this distance from the camera along x and y.
NEAR_M = 130.0
# Points are compared with a face up to ROOM_M around its box, and lie on a triangle up to the share ON_SIDE beyond its
# sides.
ROOM_M, ON_SIDE = 1e-3, 1e-5
# Triangles as Blender renders a quad.
SPLIT = ([0, 1, 2], [0, 2, 3])

FaceCorners = Float[np.ndarray, "k 3 3"]
FaceNumbers = Int[np.ndarray, " k"]


class NearestFaces(NamedTuple):
    """The nearest face of each point: how far the point is above it along its normal (infinite where none is near),
    that normal, which points up, and the face's material (-1 for none)."""

    above_m: Scalars
    up_world: Points3
    material: Int[np.ndarray, " n"]


class MeshFaces:
    """The faces of some meshes, found from above; where an eye is given, those within NEAR_M of it."""

    def __init__(self, meshes: Sequence[Mesh], eye_world: Float[np.ndarray, "3"] | None = None) -> None:
        near = [_near(mesh, eye_world) for mesh in meshes]
        faces = [mesh.vertices_world[mesh.faces[at]] for mesh, at in zip(meshes, near, strict=True)]
        corners = np.concatenate([np.zeros((0, 4, 3)), *faces])
        material = [mesh.material[at] for mesh, at in zip(meshes, near, strict=True)]
        one, other, third = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
        # Blender splits a quad that has an inward corner at this corner.
        is_inward = (np.cross(one, other) * np.cross(other, third)).sum(axis=1) < 0
        corners[is_inward] = np.roll(corners[is_inward], 1, axis=1)
        self._corners, self._material = corners, np.concatenate([np.zeros(0, dtype=int), *material])
        low, high = (reduce(of, corners[..., :2].swapaxes(0, 1)) for of in (np.minimum, np.maximum))
        self._tree = shapely.STRtree(shapely.box(*(low - ROOM_M).T, *(high + ROOM_M).T))

    def nearest(self, points_world: Points3, reach_m: float = REACH_M) -> NearestFaces:
        """The nearest face of each point among those at most `reach_m` away along their normals; upright ones count,
        too."""
        n = len(points_world)
        found = NearestFaces(np.full(n, np.inf), np.zeros((n, 3)), np.full(n, -1))
        for i, triangles, material in self._candidates(points_world[:, :2]):
            u, v, normal, size = _on_planes(triangles, points_world[i])
            with np.errstate(divide="ignore", invalid="ignore"):
                normal *= (np.where(normal[:, 2] < 0, -1, 1) / size)[:, None]
                above_m = ((points_world[i] - triangles[:, 0]) * normal).sum(axis=1)
                inside = (np.minimum(u, v) > -ON_SIDE) & (u + v < 1 + ON_SIDE) & (np.abs(above_m) < reach_m)
            # The nearest face of a point comes last, and stays.
            nearer = np.flatnonzero(inside)[np.argsort(-np.abs(above_m[inside]))]
            nearer = nearer[np.abs(above_m[nearer]) < np.abs(found.above_m[i[nearer]])]
            for values, own in zip(found, (above_m, normal, material), strict=True):
                values[i[nearer]] = own[nearer]
        return found

    def height(self, xy_world: Points2, most_m: AnyScalars | float = np.inf) -> Scalars:
        """Height of the highest face at each place, at most `most_m`; of the lowest where all are higher, NaN where
        there is none."""
        most_m = np.broadcast_to(most_m, len(xy_world))
        height_m, over_m = np.full(len(xy_world), -np.inf), np.full(len(xy_world), np.inf)
        for i, triangles, _ in self._candidates(xy_world):
            u, v, _, size = _on_planes(triangles * [1, 1, 0], np.column_stack([xy_world[i], np.zeros(len(i))]))
            inside = (size > ON_SIDE**2) & (np.minimum(u, v) > -(ON_SIDE**2)) & (u + v < 1 + ON_SIDE**2)
            i, z = i[inside], triangles[inside, :, 2]
            found_m = z[:, 0] + u[inside] * (z[:, 1] - z[:, 0]) + v[inside] * (z[:, 2] - z[:, 0])
            is_over = found_m > most_m[i]
            np.fmax.at(height_m, i[~is_over], found_m[~is_over])
            np.fmin.at(over_m, i[is_over], found_m[is_over])
        height_m = np.where(np.isfinite(height_m), height_m, over_m)
        return np.where(np.isfinite(height_m), height_m, np.nan)

    def _candidates(self, xy_world: Points2) -> Iterator[tuple[FaceNumbers, FaceCorners, FaceNumbers]]:
        """Places and triangles whose faces may have them: the numbers of the places, the triangles and their
        materials."""
        i, face = self._tree.query(shapely.points(xy_world))
        for corners in SPLIT:
            yield i, self._corners[face][:, corners], self._material[face]


def _near(mesh: Mesh, eye_world: Float[np.ndarray, "3"] | None) -> Bool[np.ndarray, " f"]:
    """Which faces are not beyond NEAR_M on one side of an eye."""
    if eye_world is None:
        return np.ones(len(mesh.faces), dtype=bool)
    away_m = mesh.vertices_world[:, :2] - eye_world[:2]
    beyond = np.packbits(np.concatenate([away_m >= NEAR_M, away_m <= -NEAR_M], axis=1), axis=1)[:, 0]
    return np.bitwise_and.reduce(beyond[mesh.faces], axis=1) == 0


@lru_cache(maxsize=1)
def pavement_of(world: World) -> MeshFaces:
    """The faces of a world's pavement near its camera."""
    return MeshFaces(world.site.surfaces.pavement, world.view.eye_world)


@lru_cache(maxsize=1)
def ground_of(world: World) -> MeshFaces:
    """The faces of a world's pavement and terrain near its camera."""
    surfaces = world.site.surfaces
    return MeshFaces([*surfaces.pavement, surfaces.terrain], world.view.eye_world)


def _on_planes(triangles: FaceCorners, points: Float[np.ndarray, "k 3"]) -> tuple[np.ndarray, ...]:
    """Each point's foot on the plane of its triangle, as shares of the two sides from the first corner; the normals of
    the planes, as long as twice the triangles' areas; and these lengths. NaN where a triangle has no area."""
    side, other = np.moveaxis(triangles[:, 1:] - triangles[:, :1], 1, 0)
    to, normal = points - triangles[:, 0], np.cross(side, other)
    size = np.linalg.norm(normal, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (np.cross(to, other) * normal).sum(axis=1) / size**2
        v = (np.cross(side, to) * normal).sum(axis=1) / size**2
    return u, v, normal, size
