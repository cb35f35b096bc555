"""A data set says under which licence it is; those from before it was written down are none the worse."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from synth3dlanes.dataset.description import recipe_text, updated_description
from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.dataset.write import Shard
from synth3dlanes.scene.assets.catalogue import Assets, Library, Texture
from synth3dlanes.system.errors import InputError
from tests import fake_samples

SIZE = 2
RECIPE = fake_samples.recipe()
DESCRIPTION = {**RECIPE.description(), "shard_size": SIZE}


def make(root: Path, numbers: list[int], n: int) -> Path:
    """The shards of these numbers, as `generate` makes them."""
    with claim(root, DESCRIPTION, "train", n, numbers) as folder:
        for number in numbers:
            shard = Shard(folder, number, SIZE, RECIPE.names, recipe_text(DESCRIPTION))
            for index in shard.missing(n):
                shard.write_part(index, fake_samples.make(RECIPE, index).members)
            shard.join(n)
    return root


def document(root: Path) -> dict[str, Any]:
    return json.loads((root / "dataset.json").read_text())


def license_as(root: Path, licence: str | None) -> Path:
    """The data set with another licence in `dataset.json`; with None as it was before there was one."""
    found = {key: value for key, value in document(root).items() if key != "license"}
    found |= {} if licence is None else {"license": licence}
    (root / "dataset.json").write_text(json.dumps(found, indent=1) + "\n")
    return root


def test_a_new_data_set_is_free_for_all(tmp_path):
    assert document(make(tmp_path, [0], 2))["license"] == "CC0-1.0"


def test_whose_assets_are_the_users_own_has_the_licence_that_they_choose():
    library = Library("mine", Assets(roads=(Texture("asphalt", "0" * 64),)))
    description = {**replace(RECIPE, library=library).description(), "shard_size": SIZE}
    assert "license" not in json.loads(updated_description(None, description, "train", 2, "dataset.json"))


@pytest.mark.parametrize("licence", [None, "CC-BY-4.0"])
def test_an_older_or_edited_one_is_extended_and_keeps_its_licence(tmp_path, licence):
    before = document(license_as(make(tmp_path, [0], 2), licence))
    after = document(make(tmp_path, [1], 4))
    assert after == {**before, "splits": {"train": {"n": 4}}}
    reader = Reader(f"{tmp_path}/train")
    assert [reader.key(i) for i in range(4)] == [f"{i:08d}" for i in range(4)]
    assert reader.recipes == {recipe_text(after)}


def test_an_older_one_is_merged_and_cut(tmp_path):
    older, newer = license_as(make(tmp_path / "a", [0], 4), None), make(tmp_path / "b", [1], 4)
    assert merge([str(older), str(newer)], str(tmp_path / "c")) == {"train": 4}
    assert document(tmp_path / "c") == document(newer)
    assert Reader(f"{tmp_path}/c/train").recipes == {recipe_text(DESCRIPTION)}
    assert split_dataset(Reader(f"{older}/train"), {"x": 1}, 0, str(tmp_path / "d")) == {"x": 2}
    assert document(tmp_path / "d")["license"] == "CC0-1.0"


def test_a_licence_survives_a_merge_and_two_do_not_mix(tmp_path):
    theirs, older = license_as(make(tmp_path / "a", [0], 4), "CC-BY-4.0"), make(tmp_path / "b", [1], 4)
    with pytest.raises(InputError, match=r'license: expected "CC-BY-4\.0" as in this dataset, got "CC0-1\.0"'):
        merge([str(theirs), str(older)], str(tmp_path / "c"))
    merge([str(license_as(older, None)), str(theirs)], str(tmp_path / "c"))
    assert document(tmp_path / "c")["license"] == "CC-BY-4.0"
