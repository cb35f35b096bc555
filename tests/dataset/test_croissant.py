"""`croissant.json` beside `dataset.json`: what mlcroissant loads by it, and when it is written."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from synth3dlanes.dataset.croissant import MARK, croissant
from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.dataset.write import Shard
from tests import fake_samples

RECIPE = fake_samples.recipe()
DESCRIPTION = {**RECIPE.description(), "shard_size": 2}
# In a process of its own: the library's warnings are not ours.
LOAD = """
import hashlib, json, sys
import mlcroissant
loaded = mlcroissant.Dataset(sys.argv[1])
found = {}
for split in sys.argv[2:]:
    for image, labels in zip(loaded.records(f"{split}/image"), loaded.records(f"{split}/labels"), strict=True):
        assert image[f"{split}/image/key"] == labels[f"{split}/labels/key"]
        document = json.loads(labels[f"{split}/labels/labels"])
        shape = [image[f"{split}/image/image"].size, [len(lane["xyz_cam"]) for lane in document["lanes"]]]
        found[f"{split}/{image[f'{split}/image/key'].decode()}"] = shape
print(json.dumps({"warnings": sorted(loaded.metadata.ctx.issues.warnings), "found": found}))
"""


def make(root: Path, numbers: list[int], n: int, split: str = "train") -> Path:
    with claim(root, DESCRIPTION, split, n, numbers) as folder:
        for number in numbers:
            shard = Shard(folder, number, 2, RECIPE.names, recipe_text(DESCRIPTION))
            for index in shard.missing(n):
                shard.write_part(index, fake_samples.make(RECIPE, index).members)
            shard.join(n)
    return root


def load(root: Path, *splits: str) -> dict[str, Any]:
    """What mlcroissant finds, with a cache of its own: it unpacks tars by their relative names."""
    environment = {**os.environ, "CROISSANT_CACHE": str(root.parent / f"cache-{root.name}"), "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-c", LOAD, str(root / "croissant.json"), *splits]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def expected(root: Path, *splits: str) -> dict[str, Any]:
    readers = {split: Reader(f"{root}/{split}") for split in splits}
    return {
        f"{split}/{sample.key}": [
            [sample.image.shape[1], sample.image.shape[0]],
            [len(lane.xyz_cam) for lane in sample.labels.lanes],
        ]
        for split, reader in readers.items()
        for sample in reader
    }


def test_mlcroissant_loads_images_and_lanes(tmp_path):
    root = make(make(tmp_path / "set", [0, 1], 3), [0], 2, "val-night")
    loaded = load(root, "train", "val-night")
    assert loaded["found"] == expected(root, "train", "val-night")
    assert len(loaded["found"]) == 5
    (warning,) = loaded["warnings"]
    assert "datePublished" in warning, "when a data set is published is known to those who publish it"


@pytest.mark.thorough
def test_it_stays_true_when_a_data_set_grows_is_split_or_merged(tmp_path):
    whole = make(make(tmp_path / "whole", [0], 2), [1], 4)
    first, second = make(tmp_path / "a", [0], 4), make(tmp_path / "b", [1], 4)
    merge([str(first), str(second)], str(tmp_path / "merged"))
    assert (tmp_path / "merged/croissant.json").read_bytes() == (whole / "croissant.json").read_bytes()
    assert load(whole, "train")["found"] == expected(whole, "train")
    split_dataset(Reader(f"{whole}/train"), {"train": 0.5, "val": 0.5}, 0, str(tmp_path / "dealt"))
    assert load(tmp_path / "dealt", "train", "val")["found"] == expected(tmp_path / "dealt", "train", "val")
    assert str(tmp_path) not in (tmp_path / "dealt/croissant.json").read_text()


def test_it_grows_until_a_user_writes_their_own(tmp_path):
    path = make(tmp_path, [0], 2) / "croissant.json"
    path.unlink()
    make(tmp_path, [1], 4)
    document = json.loads(path.read_text())
    files = [part["contentUrl"] for part in document["distribution"] if part["@type"] == "cr:FileObject"]
    assert files == ["train/00000.tar", "train/00001.tar"]
    assert document.pop("creativeWorkStatus") == MARK
    path.write_text(json.dumps({**document, "datePublished": "2026-11-25"}))
    before = path.read_bytes()
    make(tmp_path, [2], 6)
    assert path.read_bytes() == before


def test_a_data_set_of_very_many_shards_names_their_form_alone():
    splits = {f"s{number}": {"n": 100_000_000} for number in range(1000)}
    document = json.loads(croissant({**DESCRIPTION, "splits": splits, "shard_size": 1}))
    assert [part["includes"] for part in document["distribution"]] == [f"{name}/*.tar" for name in splits]
    assert document["recordSet"] == []


@pytest.mark.parametrize("passes", [(), ("depth", "height", "lidar")])
def test_equal_descriptions_give_equal_bytes_and_every_member_its_files(passes):
    description = {**DESCRIPTION, "splits": {"train": {"n": 3}}, "render": {**DESCRIPTION["render"], "passes": passes}}
    assert croissant(description) == croissant(json.loads(json.dumps(description)))
    sets = [p for p in json.loads(croissant(description))["distribution"] if p["@type"] == "cr:FileSet"]
    exr = {"passes.exr", "height.exr", "lidar.exr"} if passes else set()
    assert {part["includes"].removeprefix("*.") for part in sets} == {"png", "scene.json", "labels.json"} | exr
