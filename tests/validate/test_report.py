"""What a report makes of the numbers that checks hold against limits."""

import json

import pytest

from synth3dlanes.validate.findings import Bounded
from synth3dlanes.validate.report import ValidationReport


def test_numbers_are_told_by_how_near_they_are_to_their_limits():
    report = ValidationReport()
    for name, value in (("train:00000000", 0.5), ("train:00000001", 1.9), ("train:00000002", -1.0)):
        of_one = [Bounded("gap_m", value, most=2.0), Bounded("share", 1 - value / 4, least=0.4)]
        report.sample(name, [*of_one, Bounded("blue", -0.05, -0.1, 0.1)])
    found = json.loads(json.dumps(report.document(), allow_nan=False))["numbers"]
    common = {"n": 3, "sample": "train:00000001"}
    assert found["gap_m"] == common | {"least": None, "most": 2.0, "worst": 1.9, "verdict": "tight"}
    assert found["share"]["sample"] == "train:00000001"
    assert found["blue"]["verdict"] == ""


@pytest.mark.parametrize(
    ("number", "use"),
    [
        (Bounded("x", 1.5, most=2.0), 0.75),
        (Bounded("x", 0.5, least=0.4), 0.8),
        (Bounded("x", 0.3, least=0.4), 4 / 3),
        (Bounded("x", -0.05, -0.1, 0.1), 0.5),
        (Bounded("x", 0.02, -0.1, 0.0), 1.4),
        (Bounded("x", 0.5, most=0.0), 1.5),
        (Bounded("x", 0.5, least=0.0), 0.5),
    ],
)
def test_the_use_of_a_limit_is_above_1_beyond_it_alone(number, use):
    assert number.use == pytest.approx(use)
    assert number.is_beyond == (use > 1)
