"""Scenes near given ones: the random numbers of a given scene, each moved a little (docs/like.md)."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError, field_validator

from synth3dlanes.params.groups import DAYTIMES, KINDS, REPLACED, Group
from synth3dlanes.params.params import Params
from synth3dlanes.scene.settings import N_SCENE_NUMBERS, SPLIT_NAME
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import Seed, validation_problems

MAX_SCENES = 10_000
SPREAD = 0.1

Share = Annotated[float, Field(ge=0, le=1)]


# A scene's draw, on which its random numbers depend: seed, split and index.
DrawKey = tuple[
    Seed,
    Annotated[str, Field(pattern=f"^{SPLIT_NAME}$", max_length=200)],
    Annotated[int, Field(ge=0, lt=N_SCENE_NUMBERS)],
]


class Neighbourhood(Group):
    """Scene i of a split is near scene i mod k of the k given scenes, which were drawn from the same parameters.
    `spread` is the width of the interval around a given value, as a share of the parameter's range; `spreads` has the
    spreads of single parameters, as `camera.pitch_deg`."""

    scenes: Annotated[tuple[DrawKey, ...], Field(min_length=1, max_length=MAX_SCENES)]
    spread: Share = SPREAD
    spreads: tuple[tuple[str, Share], ...] = ()

    @field_validator("spreads")
    @classmethod
    def _of_parameters(cls, spreads: tuple[tuple[str, float], ...]) -> tuple[tuple[str, float], ...]:
        """Raise ValueError for what is no parameter."""
        for path, _ in spreads:
            group, _, key = path.partition(".")
            kind = Params.model_fields[group].annotation if group in Params.model_fields else None
            if key not in getattr(kind, "model_fields", ()):
                raise ValueError(f"{path}: expected a parameter such as camera.pitch_deg")
            if group in (*KINDS, *DAYTIMES):
                raise ValueError(f"{path}: expected {REPLACED[key]}, which it replaces")
        return spreads

    def given(self, index: int) -> DrawKey:
        """The given scene that scene `index` is near."""
        return self.scenes[index % len(self.scenes)]

    def spread_of(self, group: str, key: str) -> float:
        """The spread of one parameter."""
        return dict(self.spreads).get(f"{group}.{key}", self.spread)

    def texts(self) -> tuple[str, ...]:
        """The spreads as `read_like` takes them."""
        return (repr(self.spread), *(f"{path}={share!r}" for path, share in self.spreads))

    def text(self) -> str:
        """In words, for messages."""
        single = "".join(f", {path} {spread:g}" for path, spread in self.spreads)
        return f"near {len(self.scenes)} given scenes (spread {self.spread:g}{single})"


def near(u: Any, spread: float, moved: Any) -> Any:
    """Numbers in [0, 1) around `u`: where `moved` in [0, 1) is in a window as wide as `spread`, which ends where [0, 1)
    does."""
    return np.clip(u - spread / 2, 0, 1 - spread) + spread * moved


def read_like(scenes: Sequence[DrawKey], texts: Sequence[str]) -> Neighbourhood:
    """Near these scenes, with spreads as `0.1` for all parameters or `camera.pitch_deg=0.3` for one; raise
    InputError."""
    spread: Any = SPREAD
    spreads: list[tuple[str, Any]] = []
    for text in texts:
        path, equals, number = text.rpartition("=")
        if equals:
            spreads.append((path.strip(), number))
        else:
            spread = number
    try:
        return Neighbourhood(scenes=tuple(scenes), spread=spread, spreads=tuple(spreads))
    except ValidationError as error:
        raise InputError(*(line.removeprefix(": ") for line in validation_problems(error, ""))) from None
