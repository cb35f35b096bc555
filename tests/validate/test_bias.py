"""The tests over a whole data set: the estimators on rasters of known answers, and what is made of their values."""

import json

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import ttest_1samp

from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.bias import TESTS, PaintOffset, judge, mean_of, paint_offsets
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Bounded, Signed
from synth3dlanes.validate.report import ValidationReport
from synth3dlanes.world.world import resolve
from tests.scenes import changed, flat_road_depth, flat_road_places
from tests.validate.examining import seen
from tests.validate.examining import signed as signed_of

SOLID = changed(markings={"dash_fraction": 1.0})
LEVEL = changed(SOLID, camera={"pitch_rad": 0.0})


def instance_ids(scene: Scene, aside_m: float = 0.0, wider: float = 1.0) -> np.ndarray:
    """The ids of the lines of a flat road, drawn pixel by pixel: lines `aside_m` right of their places, lanes `wider`
    than the scene's."""
    x_m, y_m = flat_road_places(scene)
    road, markings = scene.road, scene.markings
    width_m = wider * road.lane_width_m
    ids = np.zeros(x_m.shape, np.uint16)
    station = scene.camera.y_m + y_m
    for j in range(road.n_lanes + 1):
        place_m = (j + 0.5 - scene.camera.lane) * width_m - scene.camera.offset_m + aside_m
        across_m = np.abs(x_m - place_m)
        if j == 0 and markings.left_double:
            across_m = np.abs(across_m - markings.width_m)
        is_inner = 0 < j < road.n_lanes
        on = np.mod(station, markings.dash_cycle_m) < markings.dash_fraction * markings.dash_cycle_m
        with np.errstate(invalid="ignore"):
            ids[(across_m < markings.width_m / 2) & (on | (not is_inner))] = instance_id("delimiter", j)
    return ids


def passes(scene: Scene, ids: np.ndarray) -> dict[str, np.ndarray]:
    """The passes of a flat road with these ids."""
    return {"instance": ids, "depth": flat_road_depth(scene)}


def offsets(scene: Scene, ids: np.ndarray) -> list[PaintOffset]:
    return list(paint_offsets(Evidence(resolve(scene), seen(ground_truth(scene)), None, passes(scene, ids))))


def mean_m(*lines: PaintOffset) -> float:
    return sum(line.moment_m.sum() for line in lines) / sum(line.weight.sum() for line in lines)


SCENES = {
    "solid": SOLID,
    "dashed": changed(markings={"dash_cycle_m": 3.0, "dash_fraction": 0.5}),
    "thin": changed(SOLID, markings={"width_m": 0.06}),
    "rolled, double, aside": changed(
        SOLID, markings={"left_double": True}, camera={"roll_rad": 0.04, "cx_px": 251.3, "offset_m": 0.3, "lane": 1}
    ),
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("aside_m", [-0.08, -0.004, 0.0, 0.011, 0.15])
def test_paint_drawn_at_pixels_centres_is_found_within_a_millimetre_of_its_place(scene, aside_m):
    lines = offsets(scene, instance_ids(scene, aside_m))
    assert len(lines) >= 3
    assert mean_m(*lines) == pytest.approx(aside_m, abs=1e-3 if aside_m else 3e-4)
    for line in lines:
        n_px = line.weight.sum()
        assert mean_m(line) == pytest.approx(aside_m, abs=3e-3 if n_px > 300 else 1e-2 if n_px > 50 else 2e-2)


def test_lines_near_cars_and_on_the_image_border_are_not_asked_there():
    ids = instance_ids(SOLID, 0.02)
    whole = {line.lane.id: line for line in offsets(SOLID, ids)}
    x_m, _ = flat_road_places(SOLID)
    # A car stands over the right half of the line that is left of the host.
    left_m = -SOLID.road.lane_width_m / 2
    with np.errstate(invalid="ignore"):
        hidden = (x_m > left_m + 0.02) & (x_m < left_m + 1) & (np.arange(360)[:, None] > 250)
    ids[hidden] = instance_id("car", 0)
    half = {line.lane.id: line for line in offsets(SOLID, ids)}
    assert half["main_line_1"].weight.sum() < 0.8 * whole["main_line_1"].weight.sum()
    assert mean_m(half["main_line_1"]) == pytest.approx(0.02, abs=4e-3)
    assert mean_m(half["main_line_2"]) == mean_m(whole["main_line_2"])


def signed(scene: Scene, image: np.ndarray, passes: dict[str, np.ndarray]) -> dict[str, float]:
    """The signed values of a sample with these pixels, by name."""
    return signed_of(Evidence(resolve(scene), seen(ground_truth(scene)), image, passes))


def words(values: dict[str, float]) -> dict[str, str]:
    """What is said of a data set of twelve samples, all about so."""
    report = ValidationReport()
    for i in range(12):
        report.sample(f"train:{i:08d}", "", [Signed(name, value * (1 + i / 50)) for name, value in values.items()])
    report.judge()
    return {problem.reason.split(":")[0]: problem.reason for problem in report.problems}


GRAY = np.full((360, 480, 3), 90, np.uint8)


@pytest.mark.parametrize(("wider", "side"), [(1.01, "outward"), (0.99, "inward")])
def test_lanes_of_another_width_are_outward_or_inward_and_said_so(wider, side):
    values = signed(SOLID, GRAY, passes(SOLID, instance_ids(SOLID, wider=wider)))
    # Lines stand 1.75 and 5.25 m aside; the near ones show more pixels.
    assert 0.0175 < (wider - 1) / 0.01 * values["paint_outward_m"] < 0.035
    assert abs(values["paint_right_m"]) < 1e-3
    assert "image_outward_m" not in values
    (reason,) = words(values).values()
    assert f"cm {side} on average" in reason
    assert "lane width" in reason


@pytest.mark.parametrize(("aside_m", "side"), [(0.02, "to the right"), (-0.02, "to the left")])
def test_paint_aside_is_to_the_right_or_to_the_left_in_ids_and_in_the_image(aside_m, side):
    ids = instance_ids(SOLID, aside_m)
    image = np.where(ids > 0, 200, 90)[..., None].repeat(3, axis=2).astype(np.uint8)
    values = signed(SOLID, image, passes(SOLID, ids))
    assert values["paint_right_m"] == pytest.approx(aside_m, abs=1e-3)
    assert values["image_right_m"] == pytest.approx(aside_m, abs=4e-3)
    assert abs(values["paint_outward_m"]) < 2e-3
    found = words(values)
    assert set(found) == {"paint_right_m", "image_right_m"}
    assert all(f"cm {side} on average" in reason for reason in found.values())
    assert "image_right_m" in words(signed(SOLID, image, {})), "also without passes"


def test_dark_paint_and_a_shadow_across_leave_lines_of_the_image_in_place():
    ids = instance_ids(SOLID)
    for paint in (40, 230):
        image = np.where(ids > 0, paint, 110)[..., None].repeat(3, axis=2).astype(float)
        image[250:270] *= 0.4
        values = signed(SOLID, image.astype(np.uint8), {})
        assert abs(values["image_right_m"]) < 4e-3
        assert abs(values["image_outward_m"]) < 4e-3


@pytest.mark.parametrize(("factor", "side"), [(1.005, "below"), (0.995, "above")])
def test_depth_too_far_or_too_near_leaves_the_road_below_or_above(factor, side):
    depth_m = flat_road_depth(LEVEL) * np.float32(factor)
    semantic = np.full(depth_m.shape, SEMANTIC_IDS["road"], np.uint8)
    values = signed(LEVEL, GRAY, {"depth": depth_m, "semantic": semantic})
    assert set(values) == {"surface_above_m"}
    assert values["surface_above_m"] == pytest.approx((1 - factor) * LEVEL.camera.height_m, rel=0.02)
    assert f"cm {side} on average" in words(values)["surface_above_m"]


# -- what is made of the values


def test_a_mean_is_that_of_all_values(rng):
    values = rng.normal(0.003, 0.02, 500)
    found, expected = mean_of(values.tolist()), ttest_1samp(values, 0)
    assert (found.n, found.mean, found.t) == (500, pytest.approx(values.mean()), pytest.approx(expected.statistic))
    assert found.standard_error == pytest.approx(found.mean / found.t)
    assert mean_of([0.1]).standard_error == 0


def verdict(values: np.ndarray, name: str = "paint_outward_m") -> str:
    return "".join(problem.line() for problem in judge({name: mean_of(values.tolist())}))


def test_a_mean_must_be_both_large_and_sure(rng):
    least = TESTS["paint_outward_m"].least
    assert "data set: paint_outward_m" in verdict(rng.normal(5 * least, 3 * least, 12))
    assert verdict(rng.normal(0.5 * least, least, 100_000)) == "", "micrometres are nobody's fault"
    assert verdict(np.append(rng.normal(0, 0.1 * least, 11), 200 * least)) == "", "one sample alone is no bias"
    assert verdict(np.full(3, 10 * least)) == "", "three samples say nothing"


def test_chance_alone_is_no_fault(rng):
    """Values as scattered as the least mean that matters, and much more: 3,000 clean data sets of each size."""
    for n, scatter in ((4, 10), (12, 30), (60, 30)):
        failed = sum(
            verdict(rng.normal(0, scatter * TESTS["image_right_m"].least, n), "image_right_m") != ""
            for _ in range(3000)
        )
        assert failed <= 3


def test_means_are_told_in_the_text_and_in_json():
    report = ValidationReport()
    for i in range(8):
        report.sample(f"train:{i:08d}", "", [Signed("paint_outward_m", 0.018 + 0.001 * (i % 3))])
    report.sample("train:00000008", "", [Signed("image_right_m", 0.0)])
    report.judge()
    document = json.loads(json.dumps(report.document(), allow_nan=False))
    found = document["means"]["paint_outward_m"]
    assert (found["n"], found["fails"]) == (8, True)
    assert found["mean"] == pytest.approx(0.018875)
    assert found["t"] == pytest.approx(found["mean"] / found["standard_error"])
    assert document["failed"] == ["data set"]
    assert document["means"]["image_right_m"]["fails"] is False
    console = Console(width=200, record=True)
    console.print(report.text())
    text = console.export_text()
    assert "paint_outward_m: expected paint under its labels, got 1.9 cm outward on average" in text
    assert "lane width" in text


def test_numbers_are_told_by_how_near_they_are_to_their_limits():
    report = ValidationReport()
    for name, value in (("train:00000000", 0.5), ("train:00000001", 1.9), ("train:00000002", -1.0)):
        of_one = [Bounded("gap_m", value, most=2.0), Bounded("share", 1 - value / 4, least=0.4)]
        report.sample(name, "", [*of_one, Bounded("blue", -0.05, -0.1, 0.1), Signed("image_right_m", 0.1)])
    found = json.loads(json.dumps(report.document(), allow_nan=False))["numbers"]
    common = {"n": 3, "sample": "train:00000001"}
    assert found["gap_m"] == common | {"least": None, "most": 2.0, "worst": 1.9, "verdict": "tight"}
    assert found["share"]["sample"] == "train:00000001"
    assert found["blue"]["verdict"] == ""
    console = Console(width=100, record=True)
    console.print(report.text())
    rows = [line.split() for line in console.export_text().splitlines()]
    shown = [row for row in rows if row and row[0] in found]
    assert shown[0] == ["gap_m", "<=", "2", "1.9", "3", "train:00000001"]
    assert {row[0] for row in shown} == {*found}
    assert "image_right_m" not in {row[0] for row in rows if row}, "one sample is no mean"


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
