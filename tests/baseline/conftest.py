"""What several of the baseline's tests share."""

import pytest


@pytest.fixture
def behind_splits(monkeypatch):
    """`behind_splits(samples)`: whatever split is opened has these samples; a dictionary has those of each name."""
    from synth3dlanes_baseline import ablation, evaluate, sources, statistics

    def put(samples):
        def opened(path):
            return samples[str(path).rpartition("/")[2]] if isinstance(samples, dict) else samples

        for module in (ablation, evaluate, sources, statistics):
            monkeypatch.setattr(module, "open_split", opened)
        monkeypatch.setattr(sources, "has_split", lambda folder, split: True)
        monkeypatch.setattr(sources, "only_split", lambda place: place)
        return samples

    return put
