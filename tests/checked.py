"""What verifies the shapes and types of all calls under pytest: `--jaxtyping-packages` in pyproject.toml names it."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any, get_args

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, jaxtyped

# To mypy an int is a float; so it is to beartype here.
_check_types = beartype(conf=BeartypeConf(is_pep484_tower=True))


def check(function: Any) -> Any:
    """A function, or a dataclass with its constructor, that raises an error for a call or a result of other types or
    shapes than its annotations name. A dimension has one size in all arrays of a call."""
    if inspect.isclass(function):
        if is_dataclass(function):
            function.__init__ = check(function.__init__)
        return function
    has_shapes = any(_names_shapes(hint) for hint in inspect.get_annotations(function).values())
    if not has_shapes and "<locals>" in function.__qualname__:
        # Such a function would be compiled anew with every call of the one around it.
        return function
    checked = _check_types(function)
    return _in_a_scope_of_its_own(checked) if has_shapes else checked


def _names_shapes(hint: Any) -> bool:
    """Whether arrays are in a type hint; a hint that is text may be anything."""
    if isinstance(hint, str) or (inspect.isclass(hint) and issubclass(hint, AbstractArray)):
        return True
    return any(map(_names_shapes, get_args(hint)))


def _in_a_scope_of_its_own(checked: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(checked)
    def call(*args: Any, **kwargs: Any) -> Any:
        with jaxtyped("context"):
            return checked(*args, **kwargs)

    return call


# jaxtyping's import hook decorates everything with this. Its own decorator checks each argument twice and binds each
# call's signature anew, which took half the time of the tests.
jaxtyping.jaxtyped = lambda typechecker: typechecker
