"""Wrong shapes and types are errors wherever they pass under pytest."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float

from tests.checked import check

Vector = Float[np.ndarray, " n"]


@check
def joined(a: Vector, b: Vector, n: int, *, is_short: bool = False) -> Float[np.ndarray, "2 n"]:
    return np.stack([a, b])[:, : -1 if is_short else n]


@check
@dataclass(frozen=True)
class Line:
    xyz: Float[np.ndarray, "n 3"]
    is_seen: Vector


def test_a_dimension_has_one_size_in_arguments_and_result():
    assert joined(np.zeros(4), np.ones(4), 4).shape == (2, 4)
    assert joined(np.zeros(5), b=np.ones(5), n=5).shape == (2, 5)
    Line(np.zeros((4, 3)), np.zeros(4))
    for call in (
        lambda: joined(np.zeros(4), np.ones(5), 4),
        lambda: joined(np.zeros(4), np.ones(4), 3),
        lambda: joined(np.zeros(4), np.ones(4), 4, is_short=True),
        lambda: joined(np.zeros(4, int), np.ones(4), 4),
        lambda: joined(np.zeros(4), np.ones(4), "4"),
        lambda: Line(np.zeros((4, 3)), np.zeros(3)),
        lambda: Line(np.zeros((3, 4)), np.zeros(3)),
    ):
        with pytest.raises(BeartypeCallHintViolation):
            call()


def test_sizes_that_came_before_say_nothing_of_others():
    """Those of 4 and 5 were right; so are any two equal ones, but not 3 where 2 is asked for, nor two that differ."""
    for n in (4, 5, 6, 2, 1):
        assert joined(np.zeros(n), np.ones(n), n).shape == (2, n)
        Line(np.zeros((n, 3)), np.zeros(n))
    for call in (
        lambda: joined(np.zeros(7), np.ones(8), 7),
        lambda: joined(np.zeros(7), np.ones(7), 6),
        lambda: joined(np.zeros((7, 1)), np.ones(7), 7),
        lambda: joined(np.zeros(7, int), np.ones(7), 7),
        lambda: Line(np.zeros((7, 7)), np.zeros(7)),
        lambda: Line(np.zeros((7, 2)), np.zeros(7)),
        lambda: Line(np.zeros((7, 3)), np.zeros(3)),
        lambda: Line(np.zeros((7, 3)), np.zeros((7, 1))),
    ):
        with pytest.raises(BeartypeCallHintViolation):
            call()


@check
def moved(a: Vector, by: Vector | float = 0.0, *, n: int | None = None) -> tuple[Vector, float]:
    return (a + by)[:n], 1.0


@check
def lengths(lines: list[Float[np.ndarray, "m 3"]], *others: Vector) -> Vector:
    return np.array([len(line) for line in lines], float)


@check
def sums(lines: Mapping[str, Vector], *more: Vector) -> Iterator[float]:
    yield from (float(line.sum()) for line in (*lines.values(), *more))


@check
def total(of: Iterator[float], lines: list[Vector]) -> float:
    return sum(of)


def test_arguments_of_generators_are_checked_when_made_and_their_sizes_stay_their_own():
    good, longer = np.zeros(3), np.zeros(4)
    assert total(sums({"a": good, "b": good}, good), [longer]) == 0
    for call in (
        lambda: sums({"a": np.zeros(3, int)}),
        lambda: sums({"a": good}, longer),
        lambda: sums([good]),
    ):
        with pytest.raises(BeartypeCallHintViolation):
            call()


def test_arrays_within_other_types_and_by_any_name():
    good, bad = np.zeros(3), np.zeros(3, int)
    assert moved(good, good)[1] == moved(by=2, a=good)[1] == moved(good, n=3)[1]
    assert len(lengths([np.zeros((2, 3))] * 3, good)) == 3
    for call in (
        lambda: moved(bad),
        lambda: moved(good, by=bad),
        lambda: moved(good, by=np.zeros(1)),
        lambda: moved(good, by="1"),
        lambda: moved(good, n=2),
        lambda: moved(a=good[None]),
        lambda: lengths([np.zeros((3, 2))] * 3, good),
        lambda: lengths([np.zeros((2, 3))] * 2, good),
        lambda: lengths([np.zeros((2, 3))] * 3, good, bad),
    ):
        with pytest.raises(BeartypeCallHintViolation):
            call()


def test_all_of_our_packages_are_checked():
    from synth3dlanes_baseline.poses import cam_from_road

    from synth3dlanes.dataset.format import key_of
    from synth3dlanes.geometry.frames import invert
    from synth3dlanes.labels.labels import CameraLabel

    matrix = np.eye(4)
    for call in (
        lambda: invert(np.eye(3)),
        lambda: key_of("0"),
        lambda: cam_from_road((0.0, 1.5)),
        lambda: CameraLabel(480, 360, matrix, 1.5, 0.02, matrix, matrix),
    ):
        with pytest.raises(BeartypeCallHintViolation):
            call()


def test_functions_inside_others_are_checked_where_they_name_shapes():
    def plain(n: int) -> int:
        return n

    def shaped(a: Vector) -> Vector:
        return a[None]

    assert check(plain) is plain
    with pytest.raises(BeartypeCallHintViolation):
        check(shaped)(np.zeros(3))
