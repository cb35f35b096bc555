"""A disk that fills up in the middle of a file, for commands that write figures and data sets."""

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from tests.small_files import withstands
from tests.thorough import first

COMMANDS = [
    "gallery DIR --n 4 --out OUT/it.jpg",
    "inspect DIR/train:3 --out OUT/it.png",
    "split DIR/train --into train=0.5,val=0.5 --out OUT",
    "gallery DIR --n 4 --out OUT/it.png",
    "inspect DIR/train:3 --html OUT/it.html",
    "stats DIR --out OUT/it.png",
    "report DIR --n 4 --html OUT/it.html",
    "merge DIR --out OUT",
]


@pytest.mark.parametrize("command", first(1, COMMANDS))
def test_a_full_disk(command: str, run: Callable[..., Result], folder: Path, in_tmp_path: Path) -> None:
    (in_tmp_path / "out").mkdir()
    words = command.replace("DIR", str(folder)).replace("OUT", str(in_tmp_path / "out")).split()
    withstands(lambda: run(*words), in_tmp_path / "out")
