"""The grid of the terrain mesh: fine cells around the host, which grow to the horizon. World frame, metres."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.system.arrays import AnyPoints2, AnyScalars, Scalars

# Size of the fine cells, and the greatest multiple of it that depths and widths near roads are given for.
CELL_M = 1.25
MAX_CELL_SCALE = 8.0
# Horizontal over vertical extent of embankments and cuts.
EMBANKMENT_SLOPE = 1.5
# Growth of the cells per metre outside the fine area.
GROWTH = 0.06
# How far the grid goes: ahead and aside, and behind a host that does not look there.
HORIZON_M, BEHIND_M = 4000.0, 300.0


@dataclass(frozen=True, eq=False)
class TerrainGrid:
    """The grid whose cells are fine within the area (x0, y0, x1, y1); with `both_ways` it goes to the horizon behind
    that, too."""

    area: tuple[float, float, float, float]
    both_ways: bool

    def cell_scale(self, xy_world: AnyPoints2) -> AnyScalars:
        """Size of the cells as a multiple of CELL_M, as `axes` lays them out."""
        x0, y0, x1, y1 = self.area
        out = np.maximum(
            np.maximum(x0 - xy_world[..., 0], xy_world[..., 0] - x1),
            np.maximum(y0 - xy_world[..., 1], xy_world[..., 1] - y1),
        )
        return np.clip(1 + np.clip(out, 0, None) * GROWTH / CELL_M, 1, MAX_CELL_SCALE)

    @cached_property
    def axes(self) -> tuple[Scalars, Float[np.ndarray, " m"]]:
        """World x of the columns of vertices, and world y of their rows."""
        x0, y0, x1, y1 = self.area
        return _axis(x0, x1, HORIZON_M), _axis(y0, y1, HORIZON_M if self.both_ways else BEHIND_M)


def _axis(low: float, high: float, before_m: float) -> Scalars:
    """Coordinates CELL_M apart in [low, high]; outside, to `before_m` before it and HORIZON_M beyond it, cells grow by
    GROWTH per metre of distance."""

    def outside(reach_m: float) -> Scalars:
        n = int(np.ceil(np.log1p(reach_m * GROWTH / CELL_M) / np.log1p(GROWTH)))
        return np.asarray(CELL_M / GROWTH * ((1 + GROWTH) ** np.arange(1, n + 1) - 1))

    inner = np.linspace(low, high, int(np.ceil((high - low) / CELL_M)) + 1)
    return np.concatenate([low - outside(before_m)[::-1], inner, high + outside(HORIZON_M)])
