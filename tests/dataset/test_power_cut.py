"""Data sets come to the same bytes after a power cut (tests/power_cut.py)."""

from collections.abc import Callable
from pathlib import Path

import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.system import files
from tests import fake_samples
from tests.power_cut import survive
from tests.thorough import first

SIZE = 3


def generated(root: Path, indices: range = range(8)) -> Path:
    return fake_samples.data_set(root, indices, 8, SIZE)


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two parts of a data set; each has a whole shard, and they share one."""
    root = tmp_path_factory.mktemp("parts")
    return generated(root / "a", range(5)), generated(root / "b", range(5, 8))


COMMANDS: dict[str, Callable[[Path, Path, Path], object]] = {
    "generate, then more": lambda a, b, out: [generated(out, range(5)), generated(out)],
    "merge": lambda a, b, out: merge([str(a), str(b)], str(out)),
    "split": lambda a, b, out: split_dataset(Reader(f"{a}/train"), {"train": 3, "val": 1}, 0, str(out)),
    "a named file": lambda a, b, out: files.write(out / "gallery.png", bytes(100_000)),
}


@pytest.mark.parametrize("n_cuts", first(1, [4, 20]))
@pytest.mark.parametrize("command", COMMANDS)
def test_a_data_set(parts: tuple[Path, Path], tmp_path: Path, command: str, n_cuts: int) -> None:
    survive(lambda out: COMMANDS[command](*parts, out), tmp_path, n_cuts)
