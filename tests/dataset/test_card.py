"""What lies beside `dataset.json`, and its licence: the card that the Hugging Face hub reads, and mlcroissant."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from synth3dlanes.dataset.card import card
from synth3dlanes.dataset.croissant import MARK, croissant
from synth3dlanes.dataset.description import recipe_text, updated_description
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.scene.assets.catalogue import Assets, Library, Texture
from synth3dlanes.system.errors import InputError
from tests import fake_samples

RECIPE = fake_samples.recipe()
DESCRIPTION = {**RECIPE.description(), "shard_size": 2}
SILENT = {**os.environ, "PYTHONWARNINGS": "ignore", "HF_HUB_OFFLINE": "1"}


def make(root: Path, numbers: list[int], n: int, split: str = "train") -> Path:
    """These shards of two samples."""
    return fake_samples.data_set(root, [index for index in range(n) if index // 2 in numbers], n, 2, split)


def header(text: str) -> dict[str, Any]:
    """The YAML between the first two lines of three hyphens."""
    return yaml.safe_load(text.split("---\n", 2)[1])


def loaded(code: str, *arguments: object, **environment: str) -> Any:
    """What a program prints as JSON; in a process of its own, because the warnings of libraries are not ours."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=SILENT | environment, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_hub_finds_licence_task_size_and_splits_and_a_reader_the_parameters(tmp_path):
    make(tmp_path, [0], 2)
    make(tmp_path, [0], 2, "val-night")
    text = (tmp_path / "README.md").read_text()
    found = header(text)
    assert document(tmp_path)["license"] == "CC0-1.0"
    assert yaml.safe_load(text.split("```yaml\n")[1].split("```")[0]) == document(tmp_path)["params"]
    assert all(f"| `.{name}` |" in text for name in RECIPE.names)
    assert found["license"] == "cc0-1.0"
    assert found["task_categories"]
    assert found["size_categories"] == ["n<1K"]
    assert found["configs"][0]["data_files"] == [
        {"split": "train", "path": "train/*.tar"},
        {"split": "val_night", "path": "val-night/*.tar"},
    ]


@pytest.mark.parametrize(("n", "size"), [(999, "n<1K"), (1000, "1K<n<10K"), (300_000, "100K<n<1M")])
def test_the_size_is_a_category_of_the_hub_and_no_licence_is_claimed_where_none_is_known(n, size):
    library = Library("mine", Assets(roads=(Texture("asphalt", "0" * 64),)))
    description = {**replace(RECIPE, library=library).description(), "shard_size": 2}
    of_own_assets = json.loads(updated_description(None, description, "train", n, "dataset.json"))
    text = card(of_own_assets).decode()
    assert size in header(text)["size_categories"]
    assert "license" not in {*of_own_assets, *header(text)}
    assert "CC0" not in text


def test_both_files_grow_with_the_data_set_until_a_user_writes_their_own(tmp_path):
    path, table = make(tmp_path, [0], 2) / "README.md", tmp_path / "croissant.json"
    assert "| train | 2 |" in path.read_text()
    for is_gone in (False, True):  # as after a run that was killed before it wrote them
        if is_gone:
            path.unlink()
            table.unlink()
        make(tmp_path, [1], 4)
        assert "| train | 4 |" in path.read_text()
        found = json.loads(table.read_text())
        files = [part["contentUrl"] for part in found["distribution"] if part["@type"] == "cr:FileObject"]
        assert files == ["train/00000.tar", "train/00001.tar"]
    assert found.pop("creativeWorkStatus") == MARK
    own = {path: "Mine.\n", table: json.dumps({**found, "datePublished": "2026-11-25"})}
    for file, text in own.items():
        file.write_text(text)
    make(tmp_path, [2], 6)
    assert {file: file.read_text() for file in own} == own


@pytest.mark.parametrize("is_store", [False, pytest.param(True, marks=pytest.mark.thorough)])
def test_data_sets_made_of_others_have_both_too(tmp_path, is_store):
    def place(name: str) -> str:
        return (tmp_path / name).as_uri() if is_store else str(tmp_path / name)

    whole = make(make(tmp_path / "whole", [0], 2), [1], 4)
    merge([str(make(tmp_path / name, [number], 4)) for number, name in enumerate("ab")], place("merged"))
    split_dataset(Reader(f"{whole}/train"), {"train": 0.5, "val": 0.5}, 0, place("dealt"))
    text = (tmp_path / "dealt/README.md").read_text()
    assert "| val | 2 |" in text
    assert "another data set" in text
    for name in ("README.md", "croissant.json"):
        assert (tmp_path / "merged" / name).read_bytes() == (whole / name).read_bytes()
        assert str(tmp_path) not in (tmp_path / "dealt" / name).read_text(), (
            "paths of this machine are nobody's business"
        )
    if is_store:
        assert by_croissant(tmp_path / "dealt", "train", "val")["found"] == expected(tmp_path / "dealt", "train", "val")


@pytest.mark.thorough
def test_the_hugging_face_library_loads_the_folder_by_its_card(tmp_path):
    make(tmp_path / "set", [0, 1], 4)
    make(tmp_path / "set", [0], 2, "val")
    code = (
        "import json, sys; from datasets import load_dataset\n"
        "loaded = load_dataset(sys.argv[1], streaming=True)\n"
        "print(json.dumps({name: [sample['__key__'] for sample in split] for name, split in loaded.items()}))"
    )
    keys = loaded(code, tmp_path / "set", HF_HOME=str(tmp_path), HOME=str(tmp_path))
    assert keys == {"train": [f"{i:08d}" for i in range(4)], "val": [f"{i:08d}" for i in range(2)]}


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


def by_croissant(root: Path, *splits: str) -> Any:
    """What mlcroissant finds, with a cache of its own: it unpacks tars by their relative names."""
    return loaded(LOAD, root / "croissant.json", *splits, CROISSANT_CACHE=str(root.parent / f"cache-{root.name}"))


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
    by = by_croissant(root, "train", "val-night")
    assert by["found"] == expected(root, "train", "val-night")
    assert len(by["found"]) == 5
    (warning,) = by["warnings"]
    assert "datePublished" in warning, "when a data set is published is known to those who publish it"


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


def document(root: Path) -> dict[str, Any]:
    return json.loads((root / "dataset.json").read_text())


def license_as(root: Path, licence: str | None) -> Path:
    """The data set with another licence in `dataset.json`; with None as it was before there was one."""
    found = {key: value for key, value in document(root).items() if key != "license"}
    found |= {} if licence is None else {"license": licence}
    (root / "dataset.json").write_text(json.dumps(found, indent=1) + "\n")
    return root


@pytest.mark.parametrize("licence", [None, "CC-BY-4.0"])
def test_an_older_or_edited_one_is_extended_and_keeps_its_licence(tmp_path, licence):
    before = document(license_as(make(tmp_path, [0], 2), licence))
    after = document(make(tmp_path, [1], 4))
    assert after == {**before, "splits": {"train": {"n": 4}}}
    reader = Reader(f"{tmp_path}/train")
    assert [reader.key(i) for i in range(4)] == [f"{i:08d}" for i in range(4)]
    assert reader.recipes == {recipe_text(after)}


def test_a_licence_survives_a_merge_and_two_do_not_mix(tmp_path):
    theirs, older = license_as(make(tmp_path / "a", [0], 4), "CC-BY-4.0"), make(tmp_path / "b", [1], 4)
    with pytest.raises(InputError, match=r'license: expected "CC-BY-4\.0" as in this dataset, got "CC0-1\.0"'):
        merge([str(theirs), str(older)], str(tmp_path / "c"))
    merge([str(license_as(older, None)), str(theirs)], str(tmp_path / "c"))
    assert document(tmp_path / "c")["license"] == "CC-BY-4.0"
