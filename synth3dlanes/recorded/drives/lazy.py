"""Frames that are made when they are asked for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, overload

if TYPE_CHECKING:
    from synth3dlanes.recorded.drives.drive import DriveFrame


@dataclass(frozen=True)
class MadeFrames(Sequence["DriveFrame"]):
    """`n` frames, of which `make` makes each from its number; none is kept."""

    n: int
    make: "Callable[[int], DriveFrame]"

    def __len__(self) -> int:
        return self.n

    @overload
    def __getitem__(self, index: int) -> "DriveFrame": ...
    @overload
    def __getitem__(self, index: slice) -> "Sequence[DriveFrame]": ...
    def __getitem__(self, index: int | slice) -> "DriveFrame | Sequence[DriveFrame]":
        if isinstance(index, slice):
            numbers = range(self.n)[index]
            return MadeFrames(len(numbers), lambda number: self.make(numbers[number]))
        if not -self.n <= index < self.n:
            raise IndexError(f"expected a frame in 0..{self.n - 1}, got {index}")
        return self.make(index % self.n)
