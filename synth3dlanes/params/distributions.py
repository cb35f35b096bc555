"""The distributions of parameters, read from `[low, high]`, `{value: weight}` or a constant.

Each has one method, `draw(u)`. No side effects.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, Any, Generic, TypeVar

from pydantic import PlainSerializer, PlainValidator

from synth3dlanes.system.yaml_text import value_of

MAX_WEIGHT = 1e12
NUMBER = r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)"
SPREAD = re.compile(rf"\s*{NUMBER}\s*(?:\+-|\+/-|±)\s*{NUMBER}\s*")

Value = TypeVar("Value", bool, int, float, str)


@dataclass(frozen=True)
class Uniform:
    """Uniform over [low, high). Like all distributions it turns exactly one u in [0, 1) into a value, so that fixing
    one parameter never changes another draw."""

    low: float
    high: float

    def draw(self, u: float) -> float:
        """The value at u in [0, 1)."""
        return self.low + (self.high - self.low) * u


@dataclass(frozen=True)
class Integers:
    """Uniform over the integers from low to high, both included."""

    low: int
    high: int

    def draw(self, u: float) -> int:
        """The value at u in [0, 1)."""
        return self.low + math.floor(u * (self.high - self.low + 1))


@dataclass(frozen=True)
class Choice(Generic[Value]):
    """Values with positive weights; a constant is a choice of one value."""

    values: tuple[Value, ...]
    weights: tuple[float, ...]

    def draw(self, u: float) -> Value:
        """The value at u in [0, 1)."""
        limits = list(accumulate(self.weights))
        return next(
            (value for value, limit in zip(self.values, limits, strict=True) if u * limits[-1] < limit), self.values[-1]
        )

    def mapped(self, change: Callable[[Value], Value]) -> "Choice[Value]":
        """The distribution whose draw at u is `change(value)` of the draw here; several values may become equal."""
        return Choice(tuple(map(change, self.values)), self.weights)


Distribution = Uniform | Integers | Choice[Any]


def extent(distribution: Distribution) -> tuple[Any, Any]:
    """The least and the greatest value."""
    if isinstance(distribution, Choice):
        return min(distribution.values), max(distribution.values)
    return distribution.low, distribution.high


def at_least(distribution: Integers | Choice[int], low: int) -> Choice[int]:
    """The distribution of max(value, low)."""
    return as_choice(distribution).mapped(lambda value: max(value, low))


def at_most(distribution: Integers | Choice[int], high: int) -> Choice[int]:
    """The distribution of min(value, high)."""
    return as_choice(distribution).mapped(lambda value: min(value, high))


def as_choice(distribution: Integers | Choice[int]) -> Choice[int]:
    """The same distribution as a `Choice`."""
    if isinstance(distribution, Choice):
        return distribution
    values = tuple(range(distribution.low, distribution.high + 1))
    return Choice(values, (1.0,) * len(values))


def form(distribution: Distribution) -> Any:
    """The YAML form that the distribution was read from."""
    if not isinstance(distribution, Choice):
        return [distribution.low, distribution.high]
    if len(distribution.values) == 1:
        return distribution.values[0]
    return dict(zip(distribution.values, distribution.weights, strict=True))


Real = Annotated[Uniform | Choice[float], PlainSerializer(form)]
Integer = Annotated[Integers | Choice[int], PlainSerializer(form)]


def _is_real(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -math.inf < value < math.inf


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _choice(form: Any, is_legal: Callable[[Any], bool], legal: str) -> Choice[Any]:
    """Read `{value: weight}` or a constant."""
    if not isinstance(form, dict):
        form = {form: 1} if isinstance(form, bool | int | float | str) else {}
    # Keys are text if the parameters come from JSON.
    values = tuple(value_of(key) if isinstance(key, str) else key for key in form)
    if not values or not all(map(is_legal, values)):
        raise ValueError(f"expected {legal}")
    if not all(_is_real(weight) and 0 < weight <= MAX_WEIGHT for weight in form.values()):
        raise ValueError("expected positive weights in {value: weight}")
    return Choice(values, tuple(float(weight) for weight in form.values()))


def _between(low: float, high: float, is_number: Callable[[object], bool], above: bool) -> Callable[[Any], bool]:
    return lambda value: is_number(value) and (low < value if above else low <= value) and value <= high


def spread_as_pair(form: Any) -> Any:
    """`[low, high]` for the text `value +- spread`; whole numbers stay whole. Everything else as it is."""
    found = SPREAD.fullmatch(form) if isinstance(form, str) else None
    if found is None:
        return form
    try:
        value, by = (value_of(number) for number in found.groups())
        return [value - by, value + by]
    except TypeError:
        return form


def is_pair(form: object) -> bool:
    """Whether a value is written as a list: `[low, high]`."""
    return isinstance(form, list | tuple)


def reals(low: float, high: float, above: bool = False) -> PlainValidator:
    """Legal limits of a real parameter: low to high; with `above`, low itself is excluded."""
    is_legal = _between(low, high, _is_real, above)
    legal = f"numbers in {'(' if above else '['}{low:g}, {high:g}] as [low, high], {{value: weight}} or a constant"

    def parse(form: Any) -> Uniform | Choice[float]:
        if isinstance(form, Uniform | Choice):
            return form
        form = spread_as_pair(form)
        if not is_pair(form):
            choice = _choice(form, is_legal, legal)
            return Choice(tuple(map(float, choice.values)), choice.weights)
        low_value, high_value = _checked_pair(form, is_legal, legal)
        return Uniform(float(low_value), float(high_value))

    return PlainValidator(parse)


def integers(low: int, high: int) -> PlainValidator:
    """Legal limits of an integer parameter, both inclusive."""
    return PlainValidator(lambda form: parse_integers(form, low, high))


def parse_integers(form: Any, low: int, high: int) -> Integers | Choice[int]:
    """Read an integer parameter with these limits."""
    if isinstance(form, Integers | Choice):
        return form
    form = spread_as_pair(form)
    is_legal = _between(low, high, _is_integer, above=False)
    legal = f"integers from {low} to {high} as [low, high], {{value: weight}} or a constant"
    return Integers(*_checked_pair(form, is_legal, legal)) if is_pair(form) else _choice(form, is_legal, legal)


def _checked_pair(form: Sequence[Any], is_legal: Callable[[Any], bool], legal: str) -> tuple[Any, Any]:
    if len(form) != 2 or not all(map(is_legal, form)):
        raise ValueError(f"expected {legal}")
    if form[0] > form[1]:
        raise ValueError("expected [low, high] with low <= high")
    return form[0], form[1]


def _parse_flag(form: Any) -> Choice[bool]:
    if isinstance(form, Choice):
        return form
    return _choice(form, lambda value: isinstance(value, bool), "true, false or {true: weight, false: weight}")


def names(*legal: str) -> PlainValidator:
    """The legal names of a parameter that is a choice of names."""

    def parse(form: Any) -> Choice[str]:
        return form if isinstance(form, Choice) else _choice(form, legal.__contains__, f"one of {', '.join(legal)}")

    return PlainValidator(parse)


Named = Annotated[Choice[str], PlainSerializer(form)]
Flag = Annotated[Choice[bool], PlainSerializer(form), PlainValidator(_parse_flag)]
