"""A user's own network in the place of ours, as docs/own_network.md shows it; and training that starts from weights."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from synth3dlanes_baseline import checkpoint as checkpoints
from synth3dlanes_baseline.config import train_config
from synth3dlanes_baseline.evaluate import score
from synth3dlanes_baseline.train import plan_on, train_on

from synth3dlanes.system.errors import InputError
from tests.baseline import roads

PAGE = Path(__file__).parents[2] / "docs/own_network.md"
CPU = torch.device("cpu")
OWN = "host_lane:build"


@pytest.fixture
def host_lane(tmp_path, monkeypatch):
    """The page's example as a module in the current folder."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 40
    (tmp_path / "host_lane.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    yield
    sys.modules.pop("host_lane", None)
    sys.path[:] = [place for place in sys.path if place != str(tmp_path)]


@pytest.fixture
def samples():
    return roads.samples(np.random.default_rng(2), 4, (160, 120))


def _config(**overrides):
    size = {"model.image_height_px": 120, "model.image_width_px": 160}
    settings = {"batch": 4, "epochs": 60.0, "validate_every_epochs": 60.0, "device": "cpu", "workers": 0, **size}
    return train_config(OWN, settings | overrides)


@pytest.mark.thorough
def test_the_documented_network_learns_resumes_and_is_scored(host_lane, samples, tmp_path):
    still = {"augmentation.flip": 0.0, "augmentation.noise": 0.0, "ema_decay": 0.9, "learning_rate": 5e-3}
    config = _config(**still, **{"model.arguments.width": 8})
    best = train_on(config, samples, samples, tmp_path / "run")
    for line in (tmp_path / "run/history.jsonl").read_text().splitlines():
        last = json.loads(line)
    assert last["val"]["settings"]["n_images"] == 4
    detector = checkpoints.detector(best, CPU, OWN)
    errors_m = []
    for labels, prediction in detector.in_samples(samples, workers=0):
        (lane,) = prediction.lanes
        centres = [lane for lane in labels.lanes if lane.kind == "centerline"]
        at_10_m = [np.interp(10.0, centre.xyz_cam[:, 1], centre.xyz_cam[:, 0]) for centre in centres]
        host = centres[int(np.argmin(np.abs(at_10_m)))].xyz_cam
        errors_m.append(abs(np.interp(lane.xyz_cam[:, 1], host[:, 1], host[:, 0]) - lane.xyz_cam[:, 0]).mean())
    assert np.mean(errors_m) < 0.25
    assert score(detector.in_samples(samples, workers=0)).n_images == len(samples)
    with pytest.raises(InputError, match=r"expected host_lane:build, whose network .*best\.pt holds, got none"):
        checkpoints.detector(best, CPU)


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("", "expected a function host_lane:build, got module 'host_lane' has no attribute 'build'"),
        ("def build(): return 3", "to return an nn.Module with loss.. and detect.., got int"),
        (
            "import torch\nclass build(torch.nn.Linear):\n  def __init__(self): super().__init__(1, 1)\n"
            "  def loss(self, batch): return {'total': self.weight.sum()}\n  def detect(self, image, intrinsics): ...",
            "expected loss.. to return a dict with a `total` per image, got shape ..$",
        ),
    ],
)
def test_networks_that_do_not_follow_the_protocol_are_refused_in_words(
    host_lane, samples, tmp_path, monkeypatch, code, problem
):
    (tmp_path / "host_lane.py").write_text(code)
    with pytest.raises(InputError, match=problem):
        train_on(_config(), samples, samples, tmp_path / "run")


def _tiny(**overrides):
    settings = {"batch": 2, "epochs": 1.0, "device": "cpu", "workers": 0}
    return train_config("tiny", settings | overrides)


GROWN = {"model.has_close_look": True, "loss.image": 0.1}


@pytest.mark.parametrize(
    ("changes", "new"), [pytest.param({}, set(), marks=pytest.mark.thorough), (GROWN, {"close_look"})]
)
def test_training_starts_from_the_weights_it_is_given(samples, tmp_path, changes, new):
    """A step of no length leaves the network where it began; a close look may be added to one that has none."""
    given, first = _tiny(), tmp_path / "first.pt"
    before = checkpoints.network_of(given.model).state_dict()
    checkpoints.save(first, checkpoints.Checkpoint(given, {"train": {"n_images": 4}}, before, None))
    still = {"learning_rate": 1e-30, "min_learning_rate": 1e-30, "weight_decay": 0.0, "ema_decay": 0.0}
    config = checkpoints.fine_tuning(str(first), {**still, **changes})
    assert config.model == _tiny(**changes).model
    after = checkpoints.load(train_on(config, samples, samples, tmp_path / "tuned"))
    assert {name.partition(".")[0] for name in after.model.keys() - before.keys()} == new
    names = [name for name, value in before.items() if value.is_floating_point() and "running" not in name]
    assert all(torch.allclose(before[name], after.model[name], atol=1e-12) for name in names)
    assert after.about["init"] == f"{first}, trained on 4 images"
    first.unlink()
    longer = config.model_copy(update={"epochs": 2.0})
    train_on(longer, samples, samples, tmp_path / "tuned")
    assert checkpoints.load(tmp_path / "tuned/last.pt").about["init"] == after.about["init"], "resumed without the file"


@pytest.mark.thorough
def test_a_finished_run_is_extended_with_another_batch(samples, tmp_path):
    train_on(_tiny(epochs=2.0), samples, samples, tmp_path)
    longer = _tiny(epochs=5.0, batch=4)
    assert plan_on(longer, samples, samples, tmp_path)[-1] == "5 steps of 4 images, 5 epochs, from step 2"
    train_on(longer, samples, samples, tmp_path)
    found = checkpoints.load(tmp_path / "last.pt")
    assert found.resume["step"] == 5
    assert found.config == longer


def test_a_plan_writes_nothing(samples, tmp_path):
    lines = plan_on(_tiny(), samples, samples, tmp_path / "run")
    assert lines[0].startswith("tiny (0.4 M parameters) on cpu, seed 0")
    assert not (tmp_path / "run").exists()
