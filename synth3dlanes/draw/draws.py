"""Draws of parameters from named random streams, a number each; `Neighbourhood` draws near a given scene."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from synth3dlanes.draw.like import DrawKey, Neighbourhood, near
from synth3dlanes.params.distributions import Uniform, extent
from synth3dlanes.params.groups import Group
from synth3dlanes.params.params import Params
from synth3dlanes.system.streams import stream

# Numbers of scenes are rounded, so that they are readable and equal on every machine.
SCENE_DECIMALS = 6

# One random number, or several.
Numbers = TypeVar("Numbers", float, np.ndarray)


def draws_of(params: Params, group: str, drawn: DrawKey, like: Neighbourhood | None, name: str = "") -> "Draw":
    """Draws of a group of parameters from the stream `name` of a scene (by default the group's)."""
    of_group, name = getattr(params, group), name or group
    if like is None:
        return Draw(of_group, stream(*drawn, name))
    given = stream(*like.given(drawn[-1]), name)
    return NearDraw(of_group, given, partial(like.spread_of, group), stream(*drawn, name))


class DrawsOf(NamedTuple):
    """The draws of a scene: `of(group)`, or from a stream of another name."""

    params: Params
    drawn: DrawKey
    like: Neighbourhood | None

    def __call__(self, group: str, name: str = "") -> "Draw":
        """Draws of a group from a stream, from its beginning."""
        return draws_of(self.params, group, self.drawn, self.like, name)


class Draw:
    """Draws the parameters of one group, with one random number each."""

    def __init__(self, group: Group, rng: np.random.Generator) -> None:
        self.group = group
        self.rng = rng

    def __call__(self, key: str) -> Any:
        """Draw parameter `key` of the group: degrees become radians, floats are rounded."""
        return self._rounded(key, getattr(self.group, key).draw(self._moved(key, self.rng.random())))

    def at(self, key: str, u: float) -> Any:
        """The value of parameter `key` of the group for a random number in [0, 1), not rounded, in its own unit."""
        return getattr(self.group, key).draw(u)

    def next(self, key: str) -> Any:
        """The value of parameter `key` of the group for the next random number, not rounded, in its own unit."""
        return self.at(key, self.rng.random())

    def with_numbers_of(self, rng: np.random.Generator) -> "Draw":
        """Draws of the same group with the numbers of another stream, from where it is."""
        return Draw(self.group, rng)

    def weights(self, key: str) -> dict[str, float]:
        """The weights of the names that parameter `key` of the group may have."""
        names = getattr(self.group, key)
        return dict(zip(names.values, names.weights, strict=True))

    def least(self, key: str) -> Any:
        """The least value that a parameter of the group may have, in its own unit."""
        return extent(getattr(self.group, key))[0]

    def part(self, kind: Any) -> Any:
        """A part of a scene whose fields are one parameter of the group each."""
        return kind(**{field: self(field.replace("_rad", "_deg")) for field in kind.model_fields})

    def rows(self, keys: tuple[str, ...], n: int) -> list[tuple[Any, ...]]:
        """`n` draws of several parameters, row by row."""
        numbers = self.rng.random((n, len(keys)))
        columns = (self._column(key, self._moved(key, numbers[:, j])) for j, key in enumerate(keys))
        return list(zip(*columns, strict=True))

    def _moved(self, key: str, us: Numbers) -> Numbers:
        """The random numbers of a parameter."""
        return us

    def _column(self, key: str, us: Float[np.ndarray, " n"]) -> list[Any]:
        distribution = getattr(self.group, key)
        if not isinstance(distribution, Uniform):
            return [self._rounded(key, distribution.draw(u)) for u in us.tolist()]
        values = distribution.low + (distribution.high - distribution.low) * us
        return list(np.round(np.radians(values) if key.endswith("_deg") else values, SCENE_DECIMALS).tolist())

    @staticmethod
    def _rounded(key: str, value: Any) -> Any:
        if key.endswith("_deg"):
            value = math.radians(value)
        return round(value, SCENE_DECIMALS) if isinstance(value, float) else value


class NearDraw(Draw):
    """Draws near a given scene's, whose random numbers are `rng`'s: real parameters within their spread, all others as
    given."""

    def __init__(
        self, group: Group, rng: np.random.Generator, spread: Callable[[str], float], moves: np.random.Generator
    ) -> None:
        super().__init__(group, rng)
        self.spread, self.moves = spread, moves

    def _moved(self, key: str, us: Numbers) -> Numbers:
        if not isinstance(getattr(self.group, key), Uniform):
            return us
        return near(us, self.spread(key), self.moves.random(np.shape(us)))
