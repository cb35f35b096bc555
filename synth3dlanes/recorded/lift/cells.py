"""A level grid of square cells in the world, and sums over them. Metres. numpy, scipy."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from synth3dlanes.system.arrays import Points2, Scalars
from synth3dlanes.system.errors import InputError

# Memory of a grid: 4000 cells of half a metre are 2 km.
MAX_CELLS = 16_000_000
# Radius of a window in standard deviations.
TRUNCATE = 2.0


@dataclass(frozen=True, eq=False)
class GroundGrid:
    """Square cells from `corner` on: the first index counts along x, the second along y."""

    corner: Float[np.ndarray, "2"]
    cell_m: float
    shape: tuple[int, int]

    @staticmethod
    def around(xy_world: Points2, cell_m: float) -> "GroundGrid":
        """The least grid that holds all points. Raises InputError where it is too large."""
        low = np.floor(xy_world.min(axis=0) / cell_m)
        size = np.floor(xy_world.max(axis=0) / cell_m) - low + 1
        if size.prod() > MAX_CELLS:
            extent = " x ".join(f"{n * cell_m:,.0f}" for n in size)
            raise InputError(f"poses: expected a stretch of road of 2 x 2 km at most, got one of {extent} m")
        return GroundGrid(low * cell_m, cell_m, (int(size[0]), int(size[1])))

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        return np.asarray(self.corner + np.array(self.shape) * self.cell_m / 2)

    def cells(self, xy_world: Points2) -> Int[np.ndarray, "n 2"]:
        """The indices of the cells that hold places, in the grid or beyond it."""
        return np.floor((xy_world - self.corner) / self.cell_m).astype(int)

    def numbers(self, cells: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
        """Cells as single numbers; those beyond the grid as the nearest in it."""
        row, col = np.clip(cells, 0, np.array(self.shape) - 1).T
        return np.asarray(row * self.shape[1] + col)

    def holds(self, cells: Int[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        return np.asarray(((cells >= 0) & (cells < self.shape)).all(axis=1))

    def middles(self) -> Float[np.ndarray, "rows cols 2"]:
        x, y = (self.corner[i] + (np.arange(self.shape[i]) + 0.5) * self.cell_m for i in (0, 1))
        return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)

    def total(self, number: Int[np.ndarray, " n"], values: Scalars | None = None) -> Float[np.ndarray, "rows cols"]:
        """The sum of values, or the number of points, in each cell."""
        return np.bincount(number, values, minlength=self.shape[0] * self.shape[1]).reshape(self.shape).astype(float)

    def windowed(self, values: Float[np.ndarray, "rows cols"], window_m: float) -> Float[np.ndarray, "rows cols"]:
        """The sums of values around each cell, weighted with a bell of this standard deviation, which is 1 in its
        middle."""
        sigma = window_m / self.cell_m
        mean = scipy.ndimage.gaussian_filter(values, sigma, mode="constant", truncate=TRUNCATE)
        return np.asarray(mean * (2 * np.pi * sigma**2))

    def scans(
        self, number: Int[np.ndarray, " n"], scan: Int[np.ndarray, " n"], weight: Scalars
    ) -> Float[np.ndarray, "rows cols"]:
        """How many scans tell of each cell: each counts by the mean weight of its points there, relative to others."""
        if not len(number):
            return np.zeros(self.shape)
        both = number * (scan.max() + 1) + scan
        pairs, which = np.unique(both, return_inverse=True)
        which = which.ravel()
        mean = np.bincount(which, weight) / np.bincount(which)
        at = pairs // (scan.max() + 1)
        squares = self.total(at, mean**2)
        return np.where(squares > 0, self.total(at, mean) ** 2 / np.where(squares > 0, squares, 1.0), 0.0)
