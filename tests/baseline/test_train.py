"""The training loop: it learns, resumes exactly, names bad samples; checkpoints are safe; results travel in files."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from synth3dlanes_baseline import checkpoint, train
from synth3dlanes_baseline.checkpoint import detector
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.data import annotation_of, intrinsics_of, resize, scale
from synth3dlanes_baseline.devices import Process
from synth3dlanes_baseline.loading import batch_index, sample_order
from synth3dlanes_baseline.run_state import Schedule
from synth3dlanes_baseline.train import DivergenceError, train_on

from synth3dlanes.system.errors import FormatError, InputError

PLAIN = {"augmentation": {"flip": 0.0, "noise": 0.0, "brightness": 0.0, "contrast": 0.0}}
SMALL_PX = (160, 120)


def _config(**overrides):
    return train_config("tiny", {"batch": 2, "epochs": 3.0, "validate_every_epochs": 3.0, "device": "cpu", **overrides})


def _samples(roads, n=4, seed=0):
    return roads.samples(np.random.default_rng(seed), n, SMALL_PX)


def test_a_killed_run_continues_as_if_nothing_had_happened(roads, tmp_path, monkeypatch):
    samples, config = _samples(roads), _config()
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


def test_a_damaged_state_of_a_run_is_refused_in_a_line(roads, tmp_path):
    samples = _samples(roads)
    train_on(_config(epochs=1.0), samples, samples, tmp_path)
    whole = torch.load(tmp_path / "last.pt", weights_only=True)
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


def test_another_configuration_does_not_continue_a_run(roads, tmp_path):
    samples = _samples(roads)
    train_on(_config(epochs=1.0), samples, samples, tmp_path)
    with pytest.raises(InputError, match=r"other settings \(learning_rate\)"):
        train_on(_config(epochs=1.0, learning_rate=1e-2), samples, samples, tmp_path)


def test_nan_stops_the_run_and_names_the_sample(roads, tmp_path):
    samples = _samples(roads)
    bad = samples[2]
    lane = bad.labels.lanes[0]
    far = np.arange(len(lane.xyz_cam))[:, None] > 60
    broken = dataclasses.replace(lane, xyz_cam=np.where(far & [[True, False, False]], 3.3e38, lane.xyz_cam))
    samples[2] = dataclasses.replace(bad, labels=dataclasses.replace(bad.labels, lanes=(broken,)))
    with pytest.raises(DivergenceError, match=r"step \d+: .*from sample 00000002$"):
        train_on(_config(**PLAIN), samples, samples[:1], tmp_path)


def test_labels_that_are_not_numbers_are_refused_by_name(roads):
    (sample,) = _samples(roads, n=1)
    lane = sample.labels.lanes[0]
    broken = dataclasses.replace(lane, xyz_cam=lane.xyz_cam * np.nan)
    sample = dataclasses.replace(sample, labels=dataclasses.replace(sample.labels, lanes=(broken,)))
    with pytest.raises(FormatError, match="sample 00000000: expected finite"):
        annotation_of(sample.key, sample.labels, (120, 160), "plane")


def test_order_is_a_permutation_of_seed_and_epoch():
    cpu = torch.device("cpu")
    assert sorted(sample_order(10, 0, 0).tolist()) == list(range(10))
    assert sample_order(10, 0, 0).equal(sample_order(10, 0, 0))
    assert not sample_order(10, 0, 0).equal(sample_order(10, 0, 1))
    config = _config(batch=4)
    alone = [batch_index(10, step, config, Process(0, 1, cpu)) for step in range(3)]
    assert set(torch.cat(alone).tolist()) == set(range(10))
    both = [batch_index(10, 1, config, Process(rank, 2, cpu)) for rank in range(2)]
    assert sorted(torch.cat(both).tolist()) == sorted(alone[1].tolist()), "two processes share one process's batch"


def test_schedules(roads):
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


def test_checkpoints_execute_nothing_and_describe_themselves(roads, tmp_path):
    samples = _samples(roads)
    config = _config(epochs=1.0)
    best = train_on(config, samples, samples, tmp_path)
    assert torch.load(best, weights_only=True)["format"] == "synth3dlanes.baseline"
    loaded = checkpoint.load(best)
    assert loaded.config == config
    assert loaded.about["train"]["n_images"] == 4
    fx = samples[0].labels.camera.img_from_cam[0, 0]
    assert loaded.about["train"]["focal_px"] == pytest.approx([fx, fx, 1.0]), "images of the network's size, one camera"
    assert checkpoint.build(loaded, torch.device("cpu")).config == config.model
    lines = (tmp_path / "history.jsonl").read_text().splitlines()
    assert json.loads(lines[-1])["val"]["settings"]["n_images"] == 4
    for content in (b"not a checkpoint", b""):
        (tmp_path / "x.pt").write_bytes(content)
        with pytest.raises(FormatError, match=r"x\.pt: expected a baseline checkpoint"):
            checkpoint.load(tmp_path / "x.pt")
    torch.save({"format": "other"}, tmp_path / "x.pt")
    with pytest.raises(FormatError, match=r"expected synth3dlanes\.baseline version 1"):
        checkpoint.load(tmp_path / "x.pt")


def test_resizing_scales_the_intrinsics_so_that_projections_scale(roads):
    labels = roads.labels([lambda y: (1.0, 0 * y)])
    image = resize(np.zeros((360, 480, 3), dtype=np.uint8), (90, 160))
    fx, fy, cx, cy = scale(intrinsics_of(labels), (360, 480), (90, 160))
    x, y, z = labels.lanes[0].xyz_cam[30]
    matrix = labels.camera.img_from_cam @ [x, y, z]
    assert image.shape == (90, 160, 3)
    assert cx + fx * x / y == pytest.approx(matrix[0] / matrix[2] / 3)
    assert cy - fy * z / y == pytest.approx(matrix[1] / matrix[2] / 4)


def test_it_overfits_a_few_images(roads, tmp_path):
    """The whole chain at once: any slip in grid, targets, decoding or frames keeps AP from rising."""
    from synth3dlanes_baseline.evaluate import score

    samples = _samples(roads, n=2, seed=1)
    # The label's pose drives the warp in training, the predicted one in the end.
    exact_pose = {"label_pose_fraction": 1.0, "label_pose_noise_deg": 0.0, "label_pose_noise_m": 0.0}
    settings = {"batch": 2, "epochs": 100.0, "validate_every_epochs": 100.0, "learning_rate": 4e-3, **exact_pose}
    config = _config(**settings, weight_decay=0.0, ema_decay=0.9, **PLAIN)
    best = train_on(config, samples, samples, tmp_path)
    report = score(detector(best, torch.device("cpu")).in_samples(samples))
    for kind in report.kinds.values():
        assert kind.ap > 0.98
        assert kind.at_threshold.near_1sigma_cm < 20
    assert report.pitch_median_deg < 0.1
