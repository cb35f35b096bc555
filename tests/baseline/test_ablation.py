"""Rows trained alike and the learning curve: equal steps, resumable, the paper's numbers beside ours."""

import json

import numpy as np
import pytest
from synth3dlanes_baseline import checkpoint, evaluate, sources
from synth3dlanes_baseline.ablation import learning_curve

from synth3dlanes.system.errors import InputError

SIZES = {"train": 4, "val": 2, "test": 3}
FEW = {"batch": 2, "epochs": 1.0, "device": "cpu"}


@pytest.fixture
def drawn_splits(roads, monkeypatch):
    """`DIR/train` and its like, drawn in memory."""
    from synth3dlanes_baseline import ablation

    splits = {name: roads.samples(np.random.default_rng(n), n, (160, 120)) for name, n in SIZES.items()}
    monkeypatch.setattr(sources, "has_split", lambda folder, split: True)
    for module in (ablation, evaluate, sources):
        monkeypatch.setattr(module, "open_split", lambda path: splits[str(path).rpartition("/")[2]])


def _steps(folder):
    return checkpoint.load(folder / "best.pt").about["step"]


@pytest.mark.thorough
def test_rows_stand_beside_the_papers_and_are_trained_once(drawn_splits, tmp_path):
    from synth3dlanes_baseline.ablation import ablation

    reports = ablation("d", tmp_path, "tiny", ("full", "top_view"), FEW)
    assert set(reports) == {"full", "flat_ground:plane", "flat_ground:horizon", "top_view"}
    table = (tmp_path / "table.txt").read_text()
    assert all(number in table for number in ("0.952", "0.929", "0.566"))
    assert set(json.loads((tmp_path / "table.json").read_text())) == set(reports)
    written = (tmp_path / "table.json").read_text()
    trained_at = (tmp_path / "full" / "best.pt").stat().st_mtime_ns
    ablation("d", tmp_path, "tiny", ("full", "top_view"), FEW)
    assert (tmp_path / "full" / "best.pt").stat().st_mtime_ns == trained_at
    assert (tmp_path / "table.json").read_text() == written


def test_sizes_of_the_learning_curve_train_for_equally_many_steps(drawn_splits, tmp_path):
    learning_curve("d", tmp_path, [2, 4], "tiny", FEW)
    assert _steps(tmp_path / "2") == _steps(tmp_path / "4") == 2
    assert (tmp_path / "curve.png").exists()
    with pytest.raises(InputError, match="d/train: expected at least 5 images, got 4"):
        learning_curve("d", tmp_path, [5], "tiny", FEW)
