"""Wrong shapes and types are errors wherever they pass under pytest."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float
from synth3dlanes_baseline.curves import cam_from_road

from synth3dlanes.dataset.format import key_of
from synth3dlanes.geometry.frames import invert
from tests.checked import begin_file, check

Vector = Float[np.ndarray, " n"]


@check
def joined(a: Vector, b: Vector, n: int, *, is_short: bool = False) -> Float[np.ndarray, "2 n"]:
    return np.stack([a, b])[:, : -1 if is_short else n]


@check
@dataclass(frozen=True)
class Line:
    xyz: Float[np.ndarray, "n 3"]
    is_seen: Vector


@check
def lengths(lines: list[Float[np.ndarray, "m 3"]], *others: Vector) -> Vector:
    return np.array([len(line) for line in lines], float)


@check
def sums(lines: Mapping[str, Vector], *more: Vector) -> Iterator[float]:
    yield from (float(line.sum()) for line in (*lines.values(), *more))


@check
def total(of: Iterator[float], lines: list[Vector]) -> float:
    return sum(of)


def around() -> object:
    def shaped(a: Vector) -> Vector:
        return a[None]

    return check(shaped)(np.zeros(3))


GOOD, LONGER, WHOLE = np.zeros(3), np.zeros(4), np.zeros(3, int)
WRONG = {
    "two sizes of one dimension": lambda: joined(np.zeros(7), np.ones(8), 7),
    "another size of the result": lambda: joined(LONGER, LONGER, 3),
    "the same by another argument": lambda: joined(LONGER, LONGER, 4, is_short=True),
    "more dimensions": lambda: joined(np.zeros((7, 1)), np.ones(7), 7),
    "whole numbers in an array": lambda: joined(np.zeros(4, int), np.ones(4), 4),
    "fields of two lengths": lambda: Line(np.zeros((4, 3)), np.zeros(3)),
    "a fixed size that is another": lambda: Line(np.zeros((7, 2)), np.zeros(7)),
    "an array in a list": lambda: lengths([np.zeros((3, 2))] * 3, GOOD),
    "a result of another length than an argument": lambda: lengths([np.zeros((2, 3))] * 2, GOOD),
    "one of further arguments": lambda: lengths([np.zeros((2, 3))] * 3, GOOD, WHOLE),
    "an array in a mapping, before a generator begins": lambda: sums({"a": WHOLE}),
    "lengths that differ in a generator": lambda: sums({"a": GOOD}, LONGER),
    "a matrix of ours": lambda: invert(np.eye(3)),
    "a key of ours": lambda: key_of("0"),
    "a pose of the networks": lambda: cam_from_road((0.0, 1.5)),
    "a function inside another": around,
}


@pytest.fixture(autouse=True)
def all_calls_are_checked() -> None:
    begin_file()


def test_what_is_right_passes_and_sizes_of_one_call_say_nothing_of_others():
    for n in (4, 5, 6, 2, 1):
        assert joined(np.zeros(n), b=np.ones(n), n=n).shape == (2, n)
        Line(np.zeros((n, 3)), np.zeros(n))
    assert total(sums({"a": GOOD, "b": GOOD}, GOOD), [LONGER]) == 0
    assert len(lengths([np.zeros((2, 3))] * 3, GOOD)) == 3


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_an_error(name):
    """Also after calls of other sizes that were right."""
    joined(LONGER, LONGER, 4)
    Line(np.zeros((4, 3)), LONGER)
    with pytest.raises(BeartypeCallHintViolation):
        WRONG[name]()
