"""Named models and overrides; wrong ones are refused with every problem named."""

import pytest
from synth3dlanes_baseline.config import (
    ABLATIONS,
    MODELS,
    TrainConfig,
    overrides_from,
    parse,
    train_config,
)
from synth3dlanes_baseline.model import LaneNet

from synth3dlanes.system.errors import InputError


def test_every_model_and_row_makes_a_run_that_survives_json():
    for model in MODELS:
        config = train_config(model)
        assert parse(TrainConfig, config.model_dump_json(), "x") == config
    for row in ABLATIONS:
        assert train_config("compact", {"batch": 8}, row).batch == 8
    assert train_config("compact", ablation="improved") == train_config("improved")


def test_overrides_name_every_problem():
    config = train_config("nano", overrides_from(["model.grid.rows=104", 'loss.kinds=["delimiter"]', "device=cpu"]))
    assert (config.model.grid.rows, config.loss.kinds, config.device) == (104, ("delimiter",), "cpu")
    with pytest.raises(InputError) as caught:
        train_config("nano", overrides_from(["model.foo=1", "batch=many"]))
    assert len(caught.value.problems) == 2
    with pytest.raises(InputError, match="expected KEY=VALUE"):
        overrides_from(["batch"])
    with pytest.raises(InputError, match="model: expected one of paper"):
        train_config("huge")


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            {"model.grid.columns": 100},
            "train.model.grid: expected a multiple of 8 columns, .* got 100 columns of 0.16 m",
        ),
        ({"model.grid.cell_x_m": 0.2}, "20.48 m wide .* got 128 columns of 0.2 m"),
        ({"model.grid.rows": 7}, "train.model.grid.rows: expected at least 8, .* got 7"),
        ({"model.image_height_px": 8}, "train.model.image: expected at least 16 x 16 px, .* got 480 x 8"),
        ({"model.knots_y_m": [5, 40, 20]}, r"train.model.knots_y_m: expected .* increasing .* got \[5.0, 40.0, 20.0\]"),
        ({"model.knots_y_m": [2, 20]}, "distances from 5 to 110 m"),
        ({"model.knots_y_m": [20]}, "two or more"),
        ({"model.types": ["c1", "c1"]}, "each once"),
        ({"loss.knot_sigma_m": [0.1, 0.2]}, "train.loss.knot_sigma_m: expected 6 lengths, .* got 2"),
        ({"loss.knot_sigma_m": [0, 1, 1, 1, 1, 1]}, "train.loss.knot_sigma_m.0: expected more than 0, got 0"),
        ({"model.variant": "image_view"}, "train.augmentation: expected no moves of the top view"),
    ],
)
def test_settings_that_do_not_fit_each_other_are_refused_in_one_line(changes, problem):
    with pytest.raises(InputError, match=problem) as caught:
        train_config("nano", changes)
    (line,) = caught.value.problems
    assert "\n" not in line
    assert "Value error" not in line


def test_settings_that_fit_are_taken():
    finer = {"model.grid.columns": 256, "model.grid.cell_x_m": 0.08, "model.grid.rows": 90, "model.knots_y_m": [6, 110]}
    assert LaneNet(train_config("nano", finer).model).anchors_m.shape == (32,)
