"""Cases of one property, of which `make test` runs some and `make check` all."""

from collections.abc import Iterable
from typing import Any

import pytest

from synth3dlanes.params.params import preset_names


def first(n: int, cases: Iterable[Any]) -> list[Any]:
    """The cases as parameters of a test; those after the first `n` are thorough."""
    values = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*value, marks=[pytest.mark.thorough] * (i >= n)) for i, value in enumerate(values)]


def presets(*quick: str) -> list[Any]:
    """The names of all presets; those not in `quick`, or the slow ones `town` and `mountain`, are thorough."""
    names = quick or {*preset_names()} - {"town", "mountain"}
    return [pytest.param(name, marks=[pytest.mark.thorough] * (name not in names)) for name in preset_names()]
