"""The card beside `dataset.json`: what the Hugging Face hub reads of it, and when it is written."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from synth3dlanes.dataset.card import card
from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.dataset.write import Shard
from tests import fake_samples

RECIPE = fake_samples.recipe()
DESCRIPTION = {**RECIPE.description(), "shard_size": 2}


def make(root: Path, numbers: list[int], n: int, split: str = "train") -> Path:
    with claim(root, DESCRIPTION, split, n, numbers) as folder:
        for number in numbers:
            shard = Shard(folder, number, 2, RECIPE.names, recipe_text(DESCRIPTION))
            for index in shard.missing(n):
                shard.write_part(index, fake_samples.make(RECIPE, index).members)
            shard.join(n)
    return root


def header(root: Path) -> dict[str, Any]:
    """The YAML between the first two lines of three hyphens."""
    _, text, _ = (root / "README.md").read_text().split("---\n", 2)
    return yaml.safe_load(text)


def test_the_hub_finds_licence_task_size_and_splits(tmp_path):
    make(tmp_path, [0], 2)
    make(tmp_path, [0], 2, "val-night")
    found = header(tmp_path)
    assert found["license"] == "cc0-1.0"
    assert found["task_categories"]
    assert found["size_categories"] == ["n<1K"]
    assert found["configs"][0]["data_files"] == [
        {"split": "train", "path": "train/*.tar"},
        {"split": "val_night", "path": "val-night/*.tar"},
    ]


@pytest.mark.parametrize(("n", "size"), [(999, "n<1K"), (1000, "1K<n<10K"), (300_000, "100K<n<1M")])
def test_the_size_is_a_category_of_the_hub(n, size):
    description = {**DESCRIPTION, "license": "CC0-1.0", "splits": {"train": {"n": n}}}
    assert size in yaml.safe_load(card(description).decode().split("---\n")[1])["size_categories"]


def test_no_licence_is_claimed_where_none_is_known():
    text = card({**DESCRIPTION, "splits": {"train": {"n": 1}}}).decode()
    assert "license" not in yaml.safe_load(text.split("---\n")[1])
    assert "CC0" not in text


def test_the_parameters_of_the_card_are_those_of_the_data_set(tmp_path):
    text = (make(tmp_path, [0], 2) / "README.md").read_text()
    params = yaml.safe_load(text.split("```yaml\n")[1].split("```")[0])
    assert params == json.loads((tmp_path / "dataset.json").read_text())["params"]
    assert all(f"| `.{name}` |" in text for name in RECIPE.names)


def test_it_grows_with_the_data_set_until_a_user_writes_their_own(tmp_path):
    path = make(tmp_path, [0], 2) / "README.md"
    assert "| train | 2 |" in path.read_text()
    make(tmp_path, [1], 4)
    assert "| train | 4 |" in path.read_text()
    path.unlink()
    make(tmp_path, [1], 4)
    assert "| train | 4 |" in path.read_text(), "as after a run that was killed before it wrote the card"
    path.write_text("Mine.\n")
    make(tmp_path, [2], 6)
    assert path.read_text() == "Mine.\n"


@pytest.mark.parametrize("is_store", [False, True])
def test_data_sets_made_of_others_have_one_too(tmp_path, is_store):
    def place(name: str) -> str:
        return (tmp_path / name).as_uri() if is_store else str(tmp_path / name)

    whole, first, second = (
        make(tmp_path / "whole", [0, 1], 4),
        make(tmp_path / "a", [0], 4),
        make(tmp_path / "b", [1], 4),
    )
    merge([str(first), str(second)], place("merged"))
    assert (tmp_path / "merged/README.md").read_bytes() == (whole / "README.md").read_bytes()
    split_dataset(Reader(f"{whole}/train"), {"train": 0.5, "val": 0.5}, 0, place("dealt"))
    text = (tmp_path / "dealt/README.md").read_text()
    assert "| val | 2 |" in text
    assert "another data set" in text
    assert str(tmp_path) not in text, "paths of this machine are nobody's business"


def test_a_store_gets_the_card_whole(tmp_path, monkeypatch):
    """The card appears by renaming, as `dataset.json` does."""
    moved = []
    from fsspec.implementations.local import LocalFileSystem

    move = LocalFileSystem.mv
    monkeypatch.setattr(
        LocalFileSystem, "mv", lambda self, a, b, **kwargs: (moved.append((a, b)), move(self, a, b, **kwargs))
    )
    with Destination(tmp_path.as_uri()).claim(DESCRIPTION, "train", 2, [0]):
        pass
    assert [Path(b).name for _, b in moved] == ["dataset.json", "README.md", "croissant.json"]
    assert all(re.fullmatch(rf"\.{Path(b).name}\.[0-9a-f]{{16}}\.tmp", Path(a).name) for a, b in moved)


@pytest.mark.thorough
def test_the_hugging_face_library_loads_the_folder_by_its_card(tmp_path):
    make(tmp_path / "set", [0, 1], 4)
    make(tmp_path / "set", [0], 2, "val")
    code = (
        "import json, sys; from datasets import load_dataset\n"
        "loaded = load_dataset(sys.argv[1], streaming=True)\n"
        "print(json.dumps({name: [sample['__key__'] for sample in split] for name, split in loaded.items()}))"
    )
    # In a process of its own: the library's warnings are not ours.
    environment = {"HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1", "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    command = [sys.executable, "-c", code, str(tmp_path / "set")]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"train": [f"{i:08d}" for i in range(4)], "val": [f"{i:08d}" for i in range(2)]}
