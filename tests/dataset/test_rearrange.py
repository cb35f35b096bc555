"""Data sets cut and put together hold the very bytes of their sources, each sample once."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.info import dataset_info
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import assign, merge, split_dataset
from synth3dlanes.dataset.splits import evenly_spaced, readers
from synth3dlanes.dataset.write import Shard
from synth3dlanes.scene.scene import from_json
from synth3dlanes.system.errors import FormatError, InputError
from tests import fake_samples

SIZE = 3


def make(root: Path, indices: list[int], n: int = 8, split: str = "train", seed: int = 7) -> Path:
    recipe = fake_samples.recipe(seed=seed, split=split)
    numbers = sorted({index // SIZE for index in indices})
    with claim(root, {**recipe.description(), "shard_size": SIZE}, split, n, numbers) as folder:
        for number in numbers:
            shard = Shard(folder, number, SIZE, recipe.names)
            for index in indices:
                if index // SIZE == number:
                    shard.write_part(index, fake_samples.make(recipe, index).members)
            shard.join(n)
    return root


def files(root: Path) -> dict[str, bytes]:
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


@given(st.integers(0, 200), st.lists(st.floats(0.01, 10), min_size=1, max_size=5), st.integers(0, 9))
def test_everybody_is_dealt_once_and_in_proportion(n: int, weights: list[float], seed: int) -> None:
    shares = {f"s{i}": weight for i, weight in enumerate(weights)}
    dealt = assign(n, shares, seed)
    assert sorted(i for part in dealt.values() for i in part) == list(range(n))
    assert all(part == sorted(part) for part in dealt.values())
    for name, share in shares.items():
        assert abs(len(dealt[name]) - n * share / sum(weights)) <= 1
    assert dealt == assign(n, shares, seed)


def test_a_cut_split_is_a_data_set(tmp_path):
    source = Reader(f"{make(tmp_path / 'a', list(range(8)))}/train")
    counts = split_dataset(source, {"train": 3, "val": 1}, 0, str(tmp_path / "b"))
    assert counts == {"train": 6, "val": 2}
    came = {}
    for name, count in counts.items():
        reader = Reader(f"{tmp_path / 'b'}/{name}")
        assert [reader.key(i) for i in range(len(reader))] == [f"{i:08d}" for i in range(count)]
        for i in range(count):
            index = from_json(reader.raw(i)["scene.json"], "").index
            assert reader.raw(i) == source.raw(index)
            came[index] = name
    assert sorted(came) == list(range(8))
    info = dataset_info(str(tmp_path / "b"))
    assert [(split.name, split.asked, split.complete) for split in info.splits] == [
        ("train", 6, True),
        ("val", 2, True),
    ]
    assert info.recipe["derived"]["cut"] == source.url


def test_a_cut_is_continued_and_another_one_refused(tmp_path):
    source = Reader(f"{make(tmp_path / 'a', list(range(8)))}/train")
    split_dataset(source, {"x": 1, "y": 1}, 0, str(tmp_path / "b"))
    before = files(tmp_path / "b")
    (tmp_path / "b/x/00001.parquet").unlink()
    (tmp_path / "b/x/00001.tar").unlink()
    split_dataset(source, {"x": 1, "y": 1}, 0, str(tmp_path / "b"))
    assert files(tmp_path / "b") == before
    with pytest.raises(InputError, match=r"derived\.seed: expected 0 as in this dataset, got 1"):
        split_dataset(source, {"x": 1, "y": 1}, 1, str(tmp_path / "b"))
    with pytest.raises(InputError, match="got none of 8 for y"):
        split_dataset(source, {"x": 1, "y": 0.001}, 0, str(tmp_path / "c"))
    assert not (tmp_path / "c").exists()
    recipe = fake_samples.recipe(split="x")
    with (
        pytest.raises(InputError, match="expected samples derived from other data"),
        claim(tmp_path / "b", {**recipe.description(), "shard_size": SIZE}, "x", 9, [0]),
    ):
        pass


@pytest.mark.parametrize("linked", [True, False])
def test_merged_parts_are_what_one_run_makes(tmp_path, monkeypatch, linked):
    if not linked:
        monkeypatch.setattr("os.link", lambda *paths, **folders: (_ for _ in ()).throw(OSError("no links here")))
    whole = make(tmp_path / "whole", list(range(8)))
    first = make(tmp_path / "a", [0, 1, 2, 6, 7])
    second = make(tmp_path / "b", [3, 4, 5])
    assert merge([str(first), str(second)], str(tmp_path / "c")) == {"train": 8}
    assert files(tmp_path / "c") == files(whole)
    tar = tmp_path / "c/train/00001.tar"
    assert tar.samefile(second / "train/00001.tar") is linked
    assert merge([str(first), str(second)], str(tmp_path / "c")) == {"train": 8}
    assert files(tmp_path / "c") == files(whole)


@pytest.mark.parametrize("garbage", ["zeros", "a cut", "a pipe"])
def test_a_tar_that_is_not_what_its_index_says_is_not_taken_over(tmp_path, garbage):
    tar = make(tmp_path / "a", list(range(4))) / "train/00000.tar"
    whole = tar.read_bytes()
    tar.unlink()
    if garbage == "a pipe":
        os.mkfifo(tar)
    else:
        tar.write_bytes(bytes(len(whole)) if garbage == "zeros" else whole[:2000] + bytes(len(whole) - 2000))
    with pytest.raises(FormatError, match=r"00000\.tar"):
        merge([str(tmp_path / "a")], str(tmp_path / "c"))
    assert not list((tmp_path / "c").glob("train/*.tar"))


def test_shards_that_several_share_are_joined_anew(tmp_path):
    whole = make(tmp_path / "whole", list(range(8)))
    parts = [make(tmp_path / name, indices) for name, indices in {"a": [0, 4, 7], "b": [1, 2, 3], "c": [5, 6]}.items()]
    before = [files(part) for part in parts]
    merge([str(part) for part in parts], str(tmp_path / "d"))
    assert files(tmp_path / "d") == files(whole)
    assert [files(part) for part in parts] == before


def test_splits_are_merged_by_name(tmp_path):
    train, val = make(tmp_path / "a", [0, 1]), make(tmp_path / "b", [0, 1], split="val")
    assert merge([str(train), str(val)], str(tmp_path / "c")) == {"train": 2, "val": 2}
    assert [reader.url.rpartition("/")[2] for reader in readers(str(tmp_path / "c"))] == ["train", "val"]


def test_what_does_not_go_together(tmp_path):
    one, same, other = (
        make(tmp_path / "one", [0, 1]),
        make(tmp_path / "same", [1, 2]),
        make(tmp_path / "other", [3], seed=8),
    )
    with pytest.raises(InputError, match=r"sample 00000001 is also in .*one/train"):
        merge([str(one), str(same)], str(tmp_path / "c"))
    with pytest.raises(InputError, match=r"one/train: seed: expected 7 as in this dataset, got 8 in .*other/train"):
        merge([str(one), str(other)], str(tmp_path / "c"))
    with pytest.raises(FormatError, match="expected a data set or one of its splits"):
        merge([str(one), str(tmp_path / "none")], str(tmp_path / "c"))
    assert not (tmp_path / "c").exists()


def test_info_counts_what_is_there(tmp_path):
    root = make(tmp_path / "a", [0, 1, 2, 3])
    recipe = fake_samples.recipe()
    Shard(root / "train", 2, SIZE, recipe.names).write_part(6, fake_samples.make(recipe, 6).members)
    (root / "failed/train/00000005").mkdir(parents=True)
    (split,) = dataset_info(str(root)).splits
    counts = (split.asked, split.joined, split.waiting, split.set_aside, split.shards, split.complete)
    assert counts == (8, 4, 1, 1, 2, False)
    assert split.bytes == sum(path.stat().st_size for path in (root / "train").rglob("*") if path.is_file())


def test_samples_are_spread_over_all_splits(tmp_path):
    make(tmp_path / "a", [0, 1, 2, 3, 4, 5])
    make(tmp_path / "a", [0, 1], n=2, split="val")
    found = readers(str(tmp_path / "a"))
    assert [(one.url[-5:], i) for one, i in evenly_spaced(found, 4)] == [
        ("train", 0),
        ("train", 2),
        ("train", 4),
        ("a/val", 0),
    ]
    assert len(evenly_spaced(found, 100)) == 8
