"""The training loop: it learns, resumes exactly, names bad samples; checkpoints are safe; results travel in files."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from synth3dlanes_baseline import checkpoint, train
from synth3dlanes_baseline.checkpoint import detector
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.data import annotation_of
from synth3dlanes_baseline.run_state import Schedule
from synth3dlanes_baseline.train import DivergenceError, train_on

from synth3dlanes.system.errors import FormatError, InputError
from tests.baseline import roads

PLAIN = {"augmentation": {"flip": 0.0, "noise": 0.0, "brightness": 0.0, "contrast": 0.0}}
SMALL_PX = (160, 120)


def _config(**overrides):
    return train_config("tiny", {"batch": 2, "epochs": 3.0, "validate_every_epochs": 3.0, "device": "cpu", **overrides})


def _samples(n=4, seed=0):
    return roads.samples(np.random.default_rng(seed), n, SMALL_PX)


def test_a_killed_run_continues_as_if_nothing_had_happened(tmp_path, monkeypatch):
    samples, config = _samples(), _config()
    whole = train.train_on(config, samples, samples, tmp_path / "whole")
    monkeypatch.setattr(train, "SAVE_EVERY_S", 0.0)
    real_step, n_calls = train._step, []

    def killed(*arguments):
        n_calls.append(1)
        if len(n_calls) == 4:
            raise KeyboardInterrupt
        return real_step(*arguments)

    monkeypatch.setattr(train, "_step", killed)
    with pytest.raises(KeyboardInterrupt):
        train.train_on(config, samples, samples, tmp_path / "killed")
    resumed = train.train_on(config, samples, samples, tmp_path / "killed")
    assert len(n_calls) == 4 + 3, "three steps, the kill, the other three"
    first, second = checkpoint.load(whole), checkpoint.load(resumed)
    assert first.model.keys() == second.model.keys()
    assert all(first.model[name].equal(second.model[name]) for name in first.model)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The samples and the folder of a run of one epoch."""
    samples, out = _samples(), tmp_path_factory.mktemp("finished")
    train_on(_config(epochs=1.0), samples, samples, out)
    return samples, out


def test_a_damaged_state_of_a_run_is_refused_in_a_line(finished, tmp_path):
    samples, out = finished
    whole = torch.load(out / "last.pt", weights_only=True)
    for changes in (
        None,
        {},
        {"model": {}},
        {"optimizer": {}},
        {"optimizer": {"state": {}, "param_groups": []}},
        {"schedule": {"unknown": 1}},
        {"step": "x"},
        {"best": []},
        {"history": None},
    ):
        resume = {**whole["resume"], **changes} if changes else changes
        torch.save({**whole, "resume": resume}, tmp_path / "last.pt")
        with pytest.raises(FormatError, match=r"^\S+last\.pt: expected the state of a run, got damaged: .+$"):
            train_on(_config(epochs=2.0), samples, samples, tmp_path)


def test_another_configuration_does_not_continue_a_run(finished):
    samples, out = finished
    with pytest.raises(InputError, match=r"other settings \(learning_rate\)"):
        train_on(_config(epochs=1.0, learning_rate=1e-2), samples, samples, out)


def test_nan_stops_the_run_and_names_the_sample(tmp_path):
    samples = _samples()
    bad = samples[2]
    lane = bad.labels.lanes[0]
    far = np.arange(len(lane.xyz_cam))[:, None] > 60
    broken = dataclasses.replace(lane, xyz_cam=np.where(far & [[True, False, False]], 3.3e38, lane.xyz_cam))
    samples[2] = dataclasses.replace(bad, labels=dataclasses.replace(bad.labels, lanes=(broken,)))
    with pytest.raises(DivergenceError, match=r"step \d+: .*from sample 00000002$"):
        train_on(_config(**PLAIN), samples, samples[:1], tmp_path)


def test_labels_that_are_not_numbers_are_refused_by_name():
    (sample,) = _samples(n=1)
    lane = sample.labels.lanes[0]
    broken = dataclasses.replace(lane, xyz_cam=lane.xyz_cam * np.nan)
    sample = dataclasses.replace(sample, labels=dataclasses.replace(sample.labels, lanes=(broken,)))
    with pytest.raises(FormatError, match="sample 00000000: expected finite"):
        annotation_of(sample.key, sample.labels, (120, 160), "plane")


def test_schedules():
    cosine = _config(learning_rate=1e-3)
    rates = [Schedule().rate(step, 1000, 100, cosine) for step in range(1000)]
    assert rates[0] == pytest.approx(1e-3 / 40)
    assert max(rates) == pytest.approx(1e-3)
    assert rates[-1] < 1e-5
    assert np.argmax(rates) in (39, 40)
    cyclic = _config(schedule="cyclic", learning_rate=5e-4, cycle_epochs=2.0)
    schedule = Schedule()
    assert schedule.rate(0, 1000, 100, cyclic) == schedule.rate(200, 1000, 100, cyclic) == pytest.approx(5e-4)
    assert schedule.rate(199, 1000, 100, cyclic) == pytest.approx(1e-6, abs=1e-7)
    for step, score in ((100, 0.5), (200, 0.6), (300, 0.4), (400, 0.55)):
        schedule.validated(score, step, 100, cyclic)
    assert schedule.rate(400, 1000, 100, cyclic) == pytest.approx(2.5e-4), "a cycle without progress halves the peak"


def test_checkpoints_describe_themselves(finished):
    samples, out = finished
    assert torch.load(out / "best.pt", weights_only=True)["format"] == "synth3dlanes.baseline"
    loaded = checkpoint.load(out / "best.pt")
    assert loaded.config == (config := _config(epochs=1.0))
    assert loaded.about["train"]["n_images"] == 4
    fx = samples[0].labels.camera.img_from_cam[0, 0]
    assert loaded.about["train"]["focal_px"] == pytest.approx([fx, fx, 1.0]), "images of the network's size, one camera"
    assert checkpoint.build(loaded, torch.device("cpu")).config == config.model
    lines = (out / "history.jsonl").read_text().splitlines()
    assert json.loads(lines[-1])["val"]["settings"]["n_images"] == 4


def test_it_overfits_a_few_images(tmp_path):
    """The whole chain at once: any slip in grid, targets, decoding or frames keeps AP from rising."""
    from synth3dlanes_baseline.evaluate import score

    samples = _samples(n=2, seed=1)
    # The label's pose drives the warp in training, the predicted one in the end.
    exact_pose = {"label_pose_fraction": 1.0, "label_pose_noise_deg": 0.0, "label_pose_noise_m": 0.0}
    settings = {"batch": 2, "epochs": 70.0, "validate_every_epochs": 70.0, "learning_rate": 4e-3, **exact_pose}
    config = _config(**settings, weight_decay=0.0, ema_decay=0.9, **PLAIN)
    best = train_on(config, samples, samples, tmp_path)
    report = score(detector(best, torch.device("cpu")).in_samples(samples))
    for kind in report.kinds.values():
        assert kind.ap > 0.98
        assert kind.at_threshold.near_1sigma_cm < 20
    assert report.pitch_median_deg < 0.1
