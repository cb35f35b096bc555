"""Named models and overrides; wrong ones are refused with every problem named."""

import pytest


def test_every_model_and_row_makes_a_run_that_survives_json():
    from synth3dlanes_baseline.config import ABLATIONS, MODELS, TrainConfig, parse, train_config

    for model in MODELS:
        config = train_config(model)
        assert parse(TrainConfig, config.model_dump_json(), "x") == config
    for row in ABLATIONS:
        assert train_config("compact", {"batch": 8}, row).batch == 8
    assert train_config("compact", ablation="improved") == train_config("improved")


def test_paper_keeps_the_papers_recipe():
    from synth3dlanes_baseline.config import PAPER_KNOTS_M, train_config

    config = train_config("paper")
    assert (config.optimizer, config.schedule) == ("adam", "cyclic")
    assert (config.learning_rate, config.min_learning_rate) == (5e-4, 1e-6)
    assert (config.loss.detection, config.loss.geometry, config.loss.pose) == (1.0, 1.0, 1.0)
    assert config.model.knots_y_m == PAPER_KNOTS_M == (5.0, 20.0, 40.0, 60.0, 80.0, 100.0)
    failed = train_config("paper", ablation="no_supervision")
    assert failed.model.grid_gradient
    assert failed.loss.pose == 0


def test_overrides_name_every_problem():
    from synth3dlanes_baseline.config import overrides_from, train_config

    from synth3dlanes.errors import InputError

    config = train_config("nano", overrides_from(["model.grid.rows=104", 'loss.kinds=["delimiter"]', "device=cpu"]))
    assert (config.model.grid.rows, config.loss.kinds, config.device) == (104, ("delimiter",), "cpu")
    with pytest.raises(InputError) as caught:
        train_config("nano", overrides_from(["model.foo=1", "batch=many"]))
    assert len(caught.value.problems) == 2
    with pytest.raises(InputError, match="expected KEY=VALUE"):
        overrides_from(["batch"])
    with pytest.raises(InputError, match="model: expected one of paper"):
        train_config("huge")
