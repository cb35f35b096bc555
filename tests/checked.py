"""What verifies the shapes and types of all calls under pytest: `--jaxtyping-packages` in pyproject.toml names it."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any, get_args

import jaxtyping
from beartype import BeartypeConf, beartype
from beartype.door import die_if_unbearable
from jaxtyping import AbstractArray, jaxtyped

# To mypy an int is a float; so it is to beartype here.
CONF = BeartypeConf(is_pep484_tower=True)
_check_types = beartype(conf=CONF)

# Each file of tests checks this many calls of a function. With all calls, tests of drawn scenes took a half more CPU
# time, with ten of each test a third.
CALLS_OF_A_FILE = 30
_renewed: list[Callable[[], None]] = []


def begin_file() -> None:
    """Check calls of all functions again."""
    while _renewed:
        _renewed.pop()()


def check(function: Any) -> Any:
    """A function, or a dataclass with its constructor, that raises an error for a call or a result of other types or
    shapes than its annotations name. A dimension has one size in all arrays of a call. In each file of tests, the first
    calls are checked."""
    if inspect.isclass(function):
        if is_dataclass(function):
            function.__init__ = check(function.__init__)
        return function
    if "<locals>" in function.__qualname__ and not any(map(_names_shapes, inspect.get_annotations(function).values())):
        # Such a function would be compiled anew with every call of the one around it.
        return function
    checked: Callable[..., Any] | None = None
    left = CALLS_OF_A_FILE

    def renew() -> None:
        nonlocal left
        left = CALLS_OF_A_FILE

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked, left
        if not left:
            return function(*args, **kwargs)
        if left == CALLS_OF_A_FILE:
            _renewed.append(renew)
        left -= 1
        if checked is None:
            checked = _checked(function)
        return checked(*args, **kwargs)

    return call


def _checked(function: Any) -> Any:
    """The function with checks of every call."""
    hints = inspect.get_annotations(function)
    if not any(map(_names_shapes, hints.values())):
        return _check_types(function)
    if inspect.isgeneratorfunction(function):
        return _before_it_starts(function, hints)
    return _in_a_scope_of_its_own(_check_types(function))


def _names_shapes(hint: Any) -> bool:
    """Whether arrays are in a type hint; a hint that is text may be anything."""
    if isinstance(hint, str) or _is_array(hint):
        return True
    return any(map(_names_shapes, get_args(hint)))


def _is_array(hint: Any) -> bool:
    return inspect.isclass(hint) and issubclass(hint, AbstractArray)


def _in_a_scope_of_its_own(checked: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(checked)
    def call(*args: Any, **kwargs: Any) -> Any:
        with jaxtyped("context"):
            return checked(*args, **kwargs)

    return call


def _before_it_starts(function: Callable[..., Any], hints: dict[str, Any]) -> Callable[..., Any]:
    """A generator whose arguments are checked when it is made: its first value may be asked for in another scope."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with jaxtyped("context"):
            for name, value in signature.bind(*args, **kwargs).arguments.items():
                is_more = signature.parameters[name].kind is inspect.Parameter.VAR_POSITIONAL
                hint = hints.get(name, Any)
                die_if_unbearable(value, tuple[hint, ...] if is_more else hint, conf=CONF)
        return function(*args, **kwargs)

    return call


# jaxtyping's import hook decorates everything with this. Its own decorator checks each argument twice and binds each
# call's signature anew, which took half the time of the tests.
jaxtyping.jaxtyped = lambda typechecker: typechecker
