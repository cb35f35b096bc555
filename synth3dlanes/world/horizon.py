"""How far the terrain goes: the grid of its mesh, and beyond every label far hills. World frame."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Scalars

# Distances from the world's origin, on a map from the host, at which the hills begin and reach their full height.
HILLS_FROM_M, FULL_HILLS_FROM_M = 500.0, 1600.0
N_WAVES = 14
LENGTHS_M = np.geomspace(600.0, 3000.0, N_WAVES)
MAX_HEIGHT_M = 90.0
# Size of the fine cells; near roads, depths and widths grow with the cells up to MAX_CELL_SCALE times.
CELL_M = 1.25
MAX_CELL_SCALE = 8.0
# Growth of the cells per metre outside the fine area: the terrain's hills are smooth over tens of metres.
GROWTH = 0.08
# How far the grid goes: ahead and aside, and behind a host that does not look there.
HORIZON_M, BEHIND_M = 4000.0, 300.0


@dataclass(frozen=True, eq=False)
class FarHills:
    """A sum of plane waves: `height_m` scales it, `waves` are wave vectors in rad/m, `phases` are in rad."""

    height_m: float
    waves: Float[np.ndarray, "2 k"]
    phases: Float[np.ndarray, " k"]
    center_world: Float[np.ndarray, "2"]

    @classmethod
    def draw(cls, rng: np.random.Generator, center_world: Float[np.ndarray, "2"]) -> "FarHills":
        """Draw the hills of one scene, around a place."""
        height_m = MAX_HEIGHT_M * rng.random() ** 1.5
        angles, phases = 2 * np.pi * rng.random((2, N_WAVES))
        waves = 2 * np.pi / LENGTHS_M * np.stack([np.cos(angles), np.sin(angles)])
        return cls(height_m, waves, phases, center_world)

    def height(self, xy_world: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Metres to add to the terrain; 0 near the roads."""
        x, y = self.center_world
        share = np.clip(
            (np.hypot(xy_world[..., 0] - x, xy_world[..., 1] - y) - HILLS_FROM_M) / (FULL_HILLS_FROM_M - HILLS_FROM_M),
            0,
            1,
        )
        far, heights_m = share > 0, np.zeros_like(share)
        rolling = 0.4 + 2.5 * (np.sin(xy_world[far] @ self.waves + self.phases) @ (LENGTHS_M / LENGTHS_M.sum()))
        heights_m[far] = self.height_m * share[far] ** 2 * (3 - 2 * share[far]) * np.maximum(rolling, 0)
        return heights_m


@dataclass(frozen=True, eq=False)
class TerrainGrid:
    """The grid whose cells are fine within the area (x0, y0, x1, y1); with `both_ways` it goes to the horizon behind
    that, too."""

    area: tuple[float, float, float, float]
    both_ways: bool

    def cell_scale(self, xy_world: AnyPoints2) -> AnyScalars:
        """Size of the cells as a multiple of CELL_M, as `axes` lays them out."""
        return scale_outside(self.area, xy_world, GROWTH)

    @cached_property
    def axes(self) -> tuple[Scalars, Float[np.ndarray, " m"]]:
        """World x of the columns of vertices, and world y of their rows."""
        x0, y0, x1, y1 = self.area
        return _axis(x0, x1, HORIZON_M), _axis(y0, y1, HORIZON_M if self.both_ways else BEHIND_M)


def scale_outside(area: tuple[float, float, float, float], xy_world: AnyPoints2, growth: float) -> AnyScalars:
    """How many times larger than in an area (x0, y0, x1, y1) cells are at places, at most MAX_CELL_SCALE: they grow by
    `growth` for each metre outside it along x or y."""
    x0, y0, x1, y1 = area
    out_m = np.maximum(
        np.maximum(x0 - xy_world[..., 0], xy_world[..., 0] - x1),
        np.maximum(y0 - xy_world[..., 1], xy_world[..., 1] - y1),
    )
    return np.clip(1 + np.clip(out_m, 0, None) * growth / CELL_M, 1, MAX_CELL_SCALE)


def _axis(low: float, high: float, before_m: float) -> Scalars:
    """Coordinates CELL_M apart in [low, high]; outside, to `before_m` before it and HORIZON_M beyond it, cells grow by
    GROWTH per metre of distance."""

    def outside(reach_m: float) -> Scalars:
        n = int(np.ceil(np.log1p(reach_m * GROWTH / CELL_M) / np.log1p(GROWTH)))
        return np.asarray(CELL_M / GROWTH * ((1 + GROWTH) ** np.arange(1, n + 1) - 1))

    inner = np.linspace(low, high, int(np.ceil((high - low) / CELL_M)) + 1)
    return np.concatenate([low - outside(before_m)[::-1], inner, high + outside(HORIZON_M)])
