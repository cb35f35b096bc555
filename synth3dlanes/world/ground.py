"""The ground as built, as one height over (x, y): terrain, pavement and what is raised over it, banks, decks, tunnels.
World frame, metres.

`PavedAreas` says what is paved, and what lies beside that; of the paper's roads `Verges` does. `surfaces.py` builds
this surface; `visibility.py` tests lines of sight against it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Int

from synth3dlanes.roads.network import Network
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.scene import Markings
from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Points2, Points3, Scalars
from synth3dlanes.world.areas import Outlined, contains, outlined, outset, signed_distance
from synth3dlanes.world.horizon import FarHills
from synth3dlanes.world.host_way import HostWay
from synth3dlanes.world.paved_areas import PavedAreas
from synth3dlanes.world.spans import CEILING_M, DECK_M, Span

# People climb a kerb over STRIDE_M to both sides of it; gaps between neighbouring strips are at most twice GAP_M.
STRIDE_M, GAP_M = 0.3, 0.01


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground around the way of a host, as its roads are paved."""

    paved: PavedAreas

    @property
    def way(self) -> HostWay:
        """The way of the host."""
        return self.paved.way

    @property
    def markings(self) -> Markings:
        """How lines are painted."""
        return self.paved.markings

    @property
    def hills(self) -> FarHills:
        """The hills far away."""
        return self.paved.hills

    @property
    def network(self) -> Network:
        """The roads."""
        return self.way.network

    # -- heights

    def height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the ground as built."""
        return height_at(self.network.terrain, xy_world) + self.above_terrain(xy_world)

    def above_terrain(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of the built ground over the analytic terrain at any points (0 away from roads): on decks, and over
        tunnels."""
        flat = xy_world.reshape(-1, 2)
        return self._built_above(flat, self.paved.above(flat)).reshape(xy_world.shape[:-1])

    def _built_above(self, flat: Points2, graded_m: Scalars) -> Scalars:
        """Height of the built ground over the terrain, by that of the ground below all decks."""
        above = graded_m.copy()
        for span, at in self._spans_at(flat):
            if not span.is_tunnel:
                above[at] = np.maximum(above[at], span.height(flat[at]) - height_at(self.network.terrain, flat[at]))
        for polygon, raised_m in self.paved.raised:
            above[contains(polygon, flat)] += raised_m
        return above

    def foot_height(self, xy_world: AnyPoints2) -> AnyScalars:
        """Height of somebody who walks over the ground: kerbs are climbed smoothly, STRIDE_M to both sides of them."""
        flat = xy_world.reshape(-1, 2)
        z = self.height(flat)
        for (polygon, raised_m), outline in zip(self.paved.raised, self._raised_outlined, strict=True):
            share = np.clip(0.5 - signed_distance(outline, flat) / (2 * STRIDE_M), 0.0, 1.0)
            z += raised_m * (share**2 * (3 - 2 * share) - contains(polygon, flat))
        return z.reshape(xy_world.shape[:-1])

    @cached_property
    def _raised_outlined(self) -> list[Outlined]:
        """The outlines of what is raised, without the gaps between strips beside each other."""
        return [outlined(outset(polygon, GAP_M)) for polygon, _ in self.paved.raised]

    def is_in(self, points_world: Points3, limits_m: tuple[Scalars, Scalars] | None = None) -> Bool[np.ndarray, " n"]:
        """Which points lie in the ground as built: below a deck there is none down to the graded ground, and none in a
        tunnel. `limits_m` is what `paved.limits` says of them, if that is known."""
        # Most points are far above or below the graded ground, whose height takes long to find: its least is enough.
        xy = points_world[:, :2]
        terrain_m = height_at(self.network.terrain, xy)
        above_m, most_m = limits_m or self.paved.limits(xy)
        over_m = points_world[:, 2] - terrain_m
        found = over_m < above_m
        is_near = ~found & (over_m < most_m)
        for polygon, raised_m in self.paved.raised:
            kerb = np.flatnonzero(~found & ~is_near & (over_m < most_m + raised_m))
            is_near[kerb[contains(polygon, xy[kerb])]] = True
        above_m[is_near] = self.paved.above(xy[is_near])
        for span in self.paved.spans:
            is_near |= contains(span.area, xy)
        found[is_near] = self._is_in(points_world[is_near], terrain_m[is_near], above_m[is_near])
        return found

    def _is_in(self, points_world: Points3, terrain_m: Scalars, above_m: Scalars) -> Bool[np.ndarray, " n"]:
        """What `is_in` says of points that are near the ground, or on or below a deck, or in or over a tunnel, by the
        height of the graded ground over the terrain."""
        xy = points_world[:, :2]
        graded_m, found = terrain_m + above_m, terrain_m + self._built_above(xy, above_m) > points_world[:, 2]
        for span, at in self._spans_at(xy):
            z, floor_m = points_world[at, 2], span.height(xy[at])
            if span.is_tunnel:
                found[at] &= (z < floor_m) | (z > floor_m + CEILING_M)
            else:
                found[at] &= (z < graded_m[at]) | (z > floor_m - DECK_M)
        return np.asarray(found)

    def height_near(self, points_world: Points3) -> Scalars:
        """Height of the ground as built at points; where there are two surfaces, at a bridge or a tunnel, of the one
        nearer to the point."""
        found = self.height(points_world[:, :2])
        for span, at in self._spans_at(points_world[:, :2]):
            xy, z = points_world[at, :2], points_world[at, 2]
            other = span.height(xy) if span.is_tunnel else height_at(self.network.terrain, xy) + self.paved.above(xy)
            found[at] = np.where(np.abs(other - z) < np.abs(found[at] - z), other, found[at])
        return found

    def height_along(self, road: str, xy_world: Points2) -> Scalars:
        """Height of the ground as built at places beside a road: on its deck, below that of another, or in its
        tunnel."""
        if not self.paved.spans:
            return self.height(xy_world)
        own = self.network.road(road)
        s, t = own.line.project(xy_world)
        on = np.clip(s, own.start_m, own.end_m)
        z = own.base_points(on, np.clip(t, own.left(on), own.right(on)))[:, 2]
        return self.height_near(np.column_stack([xy_world, z]))

    def _spans_at(self, xy_world: Points2) -> Iterator[tuple[Span, Int[np.ndarray, " m"]]]:
        """The decks and tunnels at places, each with the indices of its places."""
        for span in self.paved.spans:
            at = np.flatnonzero(contains(span.area, xy_world))
            if at.size:
                yield span, at

    def is_stacked(self, xy_world: Points2) -> Bool[np.ndarray, " n"]:
        """At which places there is a road over another, or over or below the ground."""
        found = np.zeros(len(xy_world), dtype=bool)
        for _, at in self._spans_at(xy_world):
            found[at] = True
        return found

    def mesh_heights(self, xy_world: AnyPoints2) -> AnyScalars:
        """Heights of the terrain mesh's vertices, far hills included."""
        z = self.paved.bed_height(xy_world.reshape(-1, 2)).reshape(xy_world.shape[:-1])
        return np.asarray(z + self.hills.height(xy_world))

    def drawn_height(self, xy_world: Points2) -> Scalars:
        """Height of the terrain mesh, whose cells are flat between their corners, at places beside the pavement. The
        cells that its border cuts have other faces, which differ a little from this."""
        shares, corners = np.zeros((2, len(xy_world))), np.zeros((len(xy_world), 2, 2, 2))
        for i, axis in enumerate(self.paved.grid.axes):
            before = np.clip(np.searchsorted(axis, xy_world[:, i]) - 1, 0, len(axis) - 2)
            shares[i] = (xy_world[:, i] - axis[before]) / (axis[before + 1] - axis[before])
            ends = axis[before[:, None] + [0, 1]]
            corners[..., i] = ends[:, :, None] if i == 0 else ends[:, None]
        z = self.mesh_heights(corners)
        # Blender splits a cell from its first corner to the one across.
        low, high = shares.min(axis=0), shares.max(axis=0)
        between = np.where(shares[0] > shares[1], z[:, 1, 0], z[:, 0, 1])
        return np.asarray((1 - high) * z[:, 0, 0] + (high - low) * between + low * z[:, 1, 1])

    # -- distances and areas from above

    def clearance(self, xy_world: AnyPoints2) -> AnyScalars:
        """Distance from the nearest pavement (shoulders included), negative on it, infinite far away."""
        return self.paved.distance(xy_world.reshape(-1, 2)).reshape(xy_world.shape[:-1])
