"""Every example of docs/loaders.md runs on a dataset of ours and finds its last sample."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs/loaders.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_three_examples_of_at_most_fifteen_lines():
    assert len(EXAMPLES) == 3
    for example in EXAMPLES:
        assert len(example.strip().splitlines()) <= 15


def run(example, dataset, home):
    # In a process of its own: the foreign libraries' warnings are not ours.
    environment = {"HF_HOME": str(home), "HF_HUB_OFFLINE": "1", "PATH": "/usr/bin:/bin", "HOME": str(home)}
    command = [sys.executable, "-c", example.replace("DIR", str(dataset))]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=PAGE.parents[1], check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("example", EXAMPLES[:2], ids=["webdataset", "datasets"])
def test_streams_end_at_our_last_sample(example, dataset, tmp_path):
    from synth3dlanes.dataset.read import Reader

    last = Reader(f"{dataset}/train")[-1]
    assert run(example, dataset, tmp_path) == [f"{last.key} {last.image.shape} {len(last.labels.lanes)}"]


def test_torch_sees_every_sample_once(dataset, tmp_path):
    # Seven samples in batches of two.
    assert run(EXAMPLES[2], dataset, tmp_path) == ["(2, 360, 480, 3)"] * 3 + ["(1, 360, 480, 3)"]
