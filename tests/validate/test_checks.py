"""The list of checks: each has a name of its own and says what it finds; what a check lacks it is not asked without."""

from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.checks import CHECKS
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT
from tests.validate.examining import examine, seen

PARTS = {"scene", "row", "image", "aim", "lidar", "depth", "normal", "semantic", "instance", "height"}


def test_checks_have_names_of_their_own_and_need_what_evidence_may_have() -> None:
    assert len({check.name for check in CHECKS}) == len(CHECKS)
    assert all(check.finds and check.needs <= PARTS for check in CHECKS)


def test_evidence_without_pixels_is_checked_as_far_as_it_goes() -> None:
    evidence = Evidence(resolve(FLAT), seen(ground_truth(FLAT)))
    assert evidence.has == {"scene", "aim"}
    asked = {check.name for check in CHECKS if check.needs <= evidence.has}
    assert asked >= {"labels", "roadside", "standing", "points"}
    assert not asked & {"index", "frame", "lidar", "pavement", "alignment"}
    assert examine(evidence)


def test_what_is_computed_is_computed_once_and_is_the_evidences_own() -> None:
    one, other = (Evidence(resolve(FLAT), seen(ground_truth(FLAT))) for _ in range(2))
    assert one.truth is one.truth
    assert one.paint is one.paint
    assert one.bodies is one.bodies
    assert one.truth is not other.truth
    assert one.paint is not other.paint
