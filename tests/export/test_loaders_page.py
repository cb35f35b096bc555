"""Every example of docs/loaders.md runs on a dataset of ours and finds its last sample."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs/loaders.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
LAST_KEY, LAST_IMAGE = "00000006", "(360, 480, 3)"


def test_three_examples_of_at_most_fifteen_lines():
    assert len(EXAMPLES) == 3
    for example in EXAMPLES:
        assert len(example.strip().splitlines()) <= 15


@pytest.mark.parametrize("example", EXAMPLES, ids=["webdataset", "datasets", "torch"])
def test_example_runs(example, dataset, tmp_path):
    # In a process of its own: the foreign libraries' warnings are not ours.
    code = example.replace("DIR", str(dataset))
    if "torch" in example:
        code += "\nprint('00000006', tuple(batch.shape[1:]), len(Lanes('%s/train')))" % dataset
    environment = {"HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1", "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=PAGE.parents[1], check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{LAST_KEY} {LAST_IMAGE} ")
    assert int(done.stdout.split()[-1]) > 2
