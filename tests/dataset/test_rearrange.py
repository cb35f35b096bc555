"""Data sets cut, put together, asked and made of clips hold the very bytes of their sources, each sample once."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.dataset.columns import SCHEMA
from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.index import ADDED
from synth3dlanes.dataset.info import dataset_info
from synth3dlanes.dataset.query import rows_where
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import assign, merge, split_dataset
from synth3dlanes.dataset.splits import evenly_spaced, readers
from synth3dlanes.dataset.write import Shard
from synth3dlanes.params.shots import clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.scene.scene import from_json
from synth3dlanes.system.errors import FormatError, InputError
from tests import fake_samples
from tests.power_cut import contents

SIZE = 3


def make(root: Path, indices: list[int], n: int = 8, split: str = "train", seed: int = 7) -> Path:
    return fake_samples.data_set(root, indices, n, SIZE, split, seed)


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
    before = contents(tmp_path / "b")
    (tmp_path / "b/x/00001.parquet").unlink()
    (tmp_path / "b/x/00001.tar").unlink()
    split_dataset(source, {"x": 1, "y": 1}, 0, str(tmp_path / "b"))
    assert contents(tmp_path / "b") == before
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
    assert contents(tmp_path / "c") == contents(whole)
    tar = tmp_path / "c/train/00001.tar"
    assert tar.samefile(second / "train/00001.tar") is linked
    assert merge([str(first), str(second)], str(tmp_path / "c")) == {"train": 8}
    assert contents(tmp_path / "c") == contents(whole)
    # Splits are merged by their names.
    val = make(tmp_path / "val", [0, 1], split="val")
    # A name is no pattern.
    both = str(tmp_path / "d[1]*?")
    assert merge([str(whole), str(val)], both) == {"train": 8, "val": 2}
    assert [reader.url.rpartition("/")[2] for reader in readers(both)] == ["train", "val"]
    assert merge([both], str(tmp_path / "e")) == {"train": 8, "val": 2}
    with pytest.raises(FormatError, match=r"; there is .*/d\[1\]\*\?/train, .*/val$"):
        readers(f"{both}/test")


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
    spread = [("train", 0), ("train", 2), ("train", 4), ("a/val", 0)]
    assert [(one.url[-5:], i) for one, i in evenly_spaced(found, 4)] == spread
    assert len(evenly_spaced(found, 100)) == 8


N_LANES = [2, 3, 4, 4, 3, 2]
GRADES = [0.0, 0.05, 0.1, 0.15, 0.2, -0.1]
FLIPS = [True, False, True, False, True, False]
JUNCTIONS = ["merge", "split", "none", "merge", "a = b and c", "none"]
INDEX = pa.table({"n_lanes": N_LANES, "max_grade": GRADES, "flip_lateral": FLIPS, "junction": JUNCTIONS})


queries = st.recursive(
    st.sampled_from(["flip_lateral", "n_lanes = 3", "max_grade > 0.07", "junction != 'none'"]),
    lambda inner: st.one_of(
        st.builds("not ({})".format, inner),
        st.builds("({}) {} ({})".format, inner, st.sampled_from(["and", "or"]), inner),
    ),
    max_leaves=8,
)


@given(queries)
def test_any_query_means_what_python_means(query: str) -> None:
    """But for a missing value, which fits nothing."""
    rows = [dict(zip(INDEX.column_names, row, strict=True)) for row in zip(*INDEX.to_pydict().values(), strict=True)]
    plain = query.replace(" = ", " == ")
    expected = [i for i, row in enumerate(rows) if eval(plain, {"__builtins__": {}}, row)]
    assert rows_where(INDEX, query).tolist() == expected
    gap = pa.table({"size": pa.array([1, None, 3])})
    assert (rows_where(gap, "size = 1").tolist(), rows_where(gap, "size != 1").tolist()) == ([0], [2])


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        ("n_lane = 4", "where n_lane = 4: unknown column n_lane; did you mean n_lanes?"),
        ("n_lanes", "expected a truth value, got a number: n_lanes"),
        ("n_lanes = 'four'", "expected a number, got text"),
        ("flip_lateral = 1", "expected a truth value, got a number"),
        ("__import__('os').system('touch pwned')", "expected columns, numbers"),
        ("n_lanes + 1 = 4", "expected columns, numbers"),
        ("n_lanes in (2, 3)", "expected columns, numbers"),
        ("(n_lanes = 2", "expected columns, numbers"),
        (
            "'merges' != junction",
            "junction to be one of none, split, merge, crossing, got 'merges'; did you mean merge?",
        ),
        ("'open", "expected columns, numbers"),
        ("", "expected columns, numbers"),
        ("n_lanes = 1" + "0" * 40, "expected columns, numbers"),
        ("not " * 5000 + "flip_lateral", "expected columns, numbers"),
    ],
)
def test_what_is_no_query(where: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        rows_where(INDEX, where)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


FRAMES = 6
SHOT_COLUMNS = ["scene", "frame", "camera"]


def plan(out, n, frames=FRAMES, split="train", part=(1, 1), workers=1):
    recipe = fake_samples.recipe(split=split, shots=clips(frames, 10))
    return Plan(str(out), n, recipe, workers, part=part, shard_size=10, maker=fake_samples.make)


def made(out, n, **how):
    assert not generate(plan(out, n, **how), lambda event: None).problem
    return Reader(f"{out}/{how.get('split', 'train')}")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Five clips and a half, in shards of ten samples."""
    folder = tmp_path_factory.mktemp("clips") / "data"
    made(folder, 33)
    return folder


def test_a_clip_is_found_by_its_scene(data, tmp_path):
    index = Reader(f"{data}/train").index
    assert index.schema.names == [*SCHEMA.names, *SHOT_COLUMNS, *ADDED]
    shown = zip(*(index[name].to_pylist() for name in SHOT_COLUMNS), strict=True)
    assert list(shown) == [(number // FRAMES, number % FRAMES, 0) for number in range(33)]
    assert rows_where(index, "frame = 0 and scene > 3").tolist() == [24, 30]
    reader = Reader(f"{data}/train", columns=())
    assert reader.scenes == list(range(6))
    assert reader.clip(2) == reader.clip(2, camera=0) == list(range(12, 18))
    assert reader.clip(5) == [30, 31, 32]
    assert [reader.labels(i).time_s for i in reader.clip(2)] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    for scene, camera in ((6, None), (2, 1)):
        with pytest.raises(FormatError, match=f"expected pictures of scene {scene}"):
            reader.clip(scene, camera)
    # Single pictures are clips of one, and keep their columns.
    single = made(tmp_path / "data", 4, frames=1)
    assert single.index.schema.names == [*SCHEMA.names, *ADDED]
    assert (single.clip(3), single.scenes) == ([3], [0, 1, 2, 3])
    assert "shots" not in single.description
    assert single.labels(0).time_s is None


def test_a_clip_lies_in_one_split(data, tmp_path):
    source = Reader(f"{data}/train")
    counts = split_dataset(source, {"train": 4, "val": 1, "test": 1}, 0, str(tmp_path / "cut"))
    readers = {name: Reader(f"{tmp_path}/cut/{name}") for name in counts}
    scenes = {name: set(reader.scenes) for name, reader in readers.items()}
    assert sorted(scene for found in scenes.values() for scene in found) == source.scenes
    assert sum(counts.values()) == 33
    for reader in readers.values():
        for scene in reader.scenes:
            positions, theirs = reader.clip(scene), source.clip(scene)
            assert [reader.raw(i) for i in positions] == [source.raw(i) for i in theirs]
            assert np.diff(positions).tolist() == [1] * (len(theirs) - 1)


def test_more_samples_finish_the_last_clip_and_single_pictures_do_not_mix(data, tmp_path):
    folder = tmp_path / "data"
    made(folder, 33)
    assert len(made(folder, 42).clip(5)) == FRAMES
    with pytest.raises(InputError, match="shots: expected"):
        generate(plan(folder, 42, frames=1), lambda event: None)


def test_statistics_of_scenes_count_each_once(data):
    reader = Reader(f"{data}/train")
    assert [i for _, i in evenly_spaced([reader], 100, is_once_a_scene=True)] == [0, 6, 12, 18, 24, 30]
    assert [i for _, i in evenly_spaced([reader], 3, is_once_a_scene=True)] == [0, 12, 24]
    assert len(evenly_spaced([reader], 100)) == 33


def test_the_pictures_of_a_scene_are_made_by_one_worker(tmp_path, monkeypatch):
    marks = tmp_path / "marks"
    marks.mkdir()
    monkeypatch.setenv("SYNTH3DLANES_TEST_MARK", str(marks))
    assert not generate(
        replace(plan(tmp_path / "data", 24, workers=2), maker=fake_samples.sign), lambda event: None
    ).problem
    makers = dict(map(int, path.name.split("-")) for path in marks.iterdir())
    assert len(makers) == 24
    assert len(set(makers.values())) == 2
    shared = [scene for scene in range(4) if len({makers[FRAMES * scene + frame] for frame in range(FRAMES)}) > 1]
    # At the end a worker without a scene of its own helps the other.
    assert shared in ([], [2], [3])
