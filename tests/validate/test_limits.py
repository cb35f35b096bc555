"""The command that measures limits anew: a number that its limits no longer hold, or hardly, is said."""

from synth3dlanes.validate.findings import Bounded
from tests.validate.limits import Range, use


def test_a_limit_fits_is_tight_or_no_longer_fits() -> None:
    def verdict(*values: float) -> str:
        return Range([Bounded("x_m", value, most=2.0) for value in values], ["a"] * len(values)).verdict()

    assert verdict(0.1, 1.5) == ""
    assert verdict(0.1, 1.9) == "tight"
    assert verdict(0.1, 2.1) == "no longer fits"


def test_the_worst_value_is_the_one_nearest_to_its_limit() -> None:
    assert use(Bounded("share", 0.5, least=0.4)) == 0.8
    assert use(Bounded("share", 0.3, least=0.4)) > 1
    assert use(Bounded("blue", -0.05, -0.1, 0.1)) == 0.5
    row = Range([Bounded("n", 1.0, most=4.0), Bounded("n", 3.0, most=4.0)], ["a:0", "a:1"]).row("n")
    assert row == "| n | -inf | 4 | 2 | 1 | 3 | a:1 |  |"
