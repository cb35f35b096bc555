"""What verifies the shapes and types of all calls under pytest: `--jaxtyping-packages` in pyproject.toml names it."""

import functools
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import jaxtyping
import numpy as np
from beartype import BeartypeConf, beartype
from beartype.door import die_if_unbearable
from jaxtyping import AbstractArray, jaxtyped

# To mypy an int is a float; so it is to beartype here.
CONF = BeartypeConf(is_pep484_tower=True)
_check_types = beartype(conf=CONF)
LEFT_OUT = inspect.Parameter.empty
PLAIN = {float, int, bool, NoneType, np.float64}
VARIABLE = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)

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
    shaped = {name: hint for name, hint in hints.items() if _names_shapes(hint)}
    if not shaped:
        return _check_types(function)
    has_more = any(
        part.kind in VARIABLE for name, part in inspect.signature(function).parameters.items() if name in shaped
    )
    if all(map(_is_told_by_form, shaped.values())) and not has_more:
        return _with_known_forms(function, hints, shaped)
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


def _is_told_by_form(hint: Any) -> bool:
    """Whether `_form` says all that decides if a value fits a type hint."""
    if _is_array(hint) or hint in (float, int, bool, NoneType, np.ndarray):
        return True
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _is_told_by_form(args[0])
    return origin in (Union, UnionType, tuple) and Ellipsis not in args and all(map(_is_told_by_form, args))


def _form(value: Any) -> Any:
    """Shape and numbers of an array, with its type if it is not numpy's; forms of a tuple's items; the type of all
    else."""
    kind = type(value)
    if kind is np.ndarray:
        return (value.shape, value.dtype)
    if kind in PLAIN:
        return kind
    if isinstance(value, tuple):
        return (kind, *map(_form, value))
    return (kind, value.shape, value.dtype) if hasattr(value, "dtype") else kind


def _kind_of(form: Any, known: frozenset[int], sizes: dict[int, str]) -> Any:
    """A form with names in the place of sizes, but for `known` ones; equal sizes have one name, by `sizes`."""
    if not isinstance(form, tuple):
        return sizes.setdefault(form, f"d{len(sizes)}") if type(form) is int and form not in known else form
    return tuple(_kind_of(part, known, sizes) for part in form)


def _sizes_told(hint: Any) -> Iterator[str]:
    """What type hints say of the sizes of arrays, dimension by dimension."""
    if _is_array(hint):
        yield from hint.dim_str.split()
    for part in get_args(hint):
        yield from _sizes_told(part)


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


def _with_known_forms(function: Callable[..., Any], hints: dict[str, Any], shaped: dict[str, Any]) -> Any:
    """The same, faster: forms that were right once are right again, and so are those of other sizes that are equal
    where theirs are."""
    places = [(i, name) for i, name in enumerate(inspect.signature(function).parameters) if name in shaped]
    function.__annotations__ = {name: hint for name, hint in hints.items() if name not in shaped}
    checked = _check_types(function)
    function.__annotations__ = hints
    told = [size for hint in shaped.values() for size in _sizes_told(hint)]
    known = frozenset({1, *(int(number) for size in told for number in re.findall(r"\d+", size))})
    is_by_equality = all(re.fullmatch(r"[\w#*=.]+", size) for size in told)
    has_result = "return" in shaped
    # Of arguments, with those of the results that came of them.
    right_forms: dict[Any, set[Any]] = {}
    right_kinds = set()

    def verify(forms: tuple[Any, ...], values: list[Any]) -> None:
        kinds = _kind_of(forms, known, {}) if is_by_equality else forms
        if kinds in right_kinds:
            return
        with jaxtyped("context"):
            for (_, name), value in zip([*places, (0, "return")], values, strict=False):
                if value is not LEFT_OUT:
                    die_if_unbearable(value, shaped.get(name, Any), conf=CONF)
        right_kinds.add(kinds)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        n = len(args)
        values = [args[i] if i < n else kwargs.get(name, LEFT_OUT) for i, name in places]
        # Every function of ours passes here: _form would double the time of its most frequent case.
        forms = tuple([(v.shape, v.dtype) if type(v) is np.ndarray else _form(v) for v in values])
        try:
            right_results = right_forms.get(forms)
        except TypeError:  # sizes that a compiler leaves open have no hash, and cannot be checked
            return checked(*args, **kwargs)
        if right_results is None:
            verify(forms, values)
            right_results = right_forms[forms] = set()
        result = checked(*args, **kwargs)
        if has_result:
            form = _form(result)
            try:
                is_right = form in right_results
            except TypeError:
                return result
            if not is_right:
                verify((*forms, form), [*values, result])
                right_results.add(form)
        return result

    return call


# jaxtyping's import hook decorates everything with this. Its own decorator checks each argument twice and binds each
# call's signature anew, which took half the time of the tests.
jaxtyping.jaxtyped = lambda typechecker: typechecker
