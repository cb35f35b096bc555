"""Shards: written in any order, joined, damaged, read."""

import errno
import json
import os
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from synth3dlanes.dataset import write
from synth3dlanes.dataset.columns import SCHEMA, index_row
from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.format import tar_bytes, tar_end
from synth3dlanes.dataset.index import ADDED, ADDED_SCHEMA
from synth3dlanes.dataset.query import rows_where
from synth3dlanes.dataset.read import Reader, find
from synth3dlanes.dataset.splits import one_reader, readers
from synth3dlanes.dataset.write import Shard, scan
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import open_regular
from tests import fake_samples


def a_shard(folder, image_format="png"):
    recipe = fake_samples.recipe(image_format=image_format)
    (folder / "train").mkdir(parents=True, exist_ok=True)
    with claim(folder, {**recipe.description(), "shard_size": 10}, "train", 4, [0]):
        return Shard(folder / "train", 0, 10, recipe.names)


def add(shard, *indices):
    for index in indices:
        shard.write_part(index, fake_samples.make(fake_samples.recipe(image_format=shard.names[0]), index).members)


def contents(shard):
    return shard.path("tar").read_bytes(), shard.path("parquet").read_bytes()


@pytest.fixture
def shard(tmp_path):
    shard = a_shard(tmp_path)
    add(shard, 0, 1, 2, 3)
    shard.join(4)
    return shard


@pytest.mark.parametrize("is_writing", [False, True])
def test_a_worker_that_outlives_its_run_adds_nothing_to_the_next(tmp_path, monkeypatch, is_writing):
    """Whether the next run claims the shard before the worker writes its sample, or in the middle of it."""
    old, next_run = a_shard(tmp_path).claimed(), []

    def claim_it(descriptor=0):
        next_run.append(a_shard(tmp_path).claimed())

    old.open()
    add(old, 0)
    if is_writing:
        monkeypatch.setattr(os, "fsync", claim_it)
    else:
        claim_it()
    with pytest.raises(FileNotFoundError):
        add(old, 1)
    assert [path.name for path in old.path("parts").iterdir()] == ["00000000.tar"]
    monkeypatch.undo()
    next_run[0].open()
    add(next_run[0], 1)
    next_run[0].close()
    assert sorted(path.name for path in old.path("parts").iterdir()) == ["00000000.tar", "00000001.tar"]


def test_a_join_killed_between_its_renames_is_repeated(tmp_path, shard):
    other = a_shard(tmp_path / "other")
    add(other, 0, 1)
    other.join(2)
    half = contents(other)
    add(other, 2, 3)
    other.join(4)
    for tar, parquet, parts in [
        (half[0], None, (2, 3)),
        (contents(shard)[0], None, (2, 3)),
        (contents(shard)[0], None, ()),
        (contents(shard)[0], contents(shard)[1], (2, 3)),
    ]:
        other.path("tar").write_bytes(tar)
        other.path("parquet").unlink(missing_ok=True)
        if parquet:
            other.path("parquet").write_bytes(parquet)
        add(other, *parts)
        other.path("parts").mkdir(exist_ok=True)
        for left in (".00000.tar.4711.tmp", ".00000.parquet.4711.tmp"):
            (other.path("parts") / left).write_bytes(b"rubbish")
        assert other.missing(4) == []
        assert other.needs_join(4)
        other.join(4)
        assert contents(other) == contents(shard)
        assert not other.needs_join(4)
        assert sorted(path.name for path in other.folder.iterdir()) == [".lock", "00000.parquet", "00000.tar"]


@pytest.mark.parametrize("keep", [0, 1, 511, 512, 700, 2048, -512])
def test_a_damaged_part_is_made_anew_and_the_others_stay(tmp_path, shard, keep):
    other = a_shard(tmp_path / "other")
    add(other, 0, 1, 2, 3)
    part = other.parts()[2]
    part.write_bytes(part.read_bytes()[:keep])
    other.join(4)
    assert other.missing(4) == [2]
    add(other, 2)
    other.join(4)
    assert contents(other) == contents(shard)


def test_a_tar_cut_short_without_index_keeps_its_whole_samples(tmp_path, shard):
    whole = contents(shard)
    places, problem = scan(shard.path("tar"), shard.names)
    assert (list(places), problem) == ([0, 1, 2, 3], "")
    shard.path("parquet").unlink()
    shard.path("tar").write_bytes(whole[0][: places[2].offset + 700])
    assert shard.missing(4) == [2, 3]
    add(shard, 2, 3)
    shard.join(4)
    assert contents(shard) == whole


@pytest.mark.parametrize("member", ["png", "scene.json", "labels.json"])
def test_an_empty_member_of_an_unfinished_tar_is_made_anew_and_one_of_a_finished_tar_is_named(tmp_path, shard, member):
    whole = contents(shard)
    samples = [fake_samples.make(fake_samples.recipe(), index).members for index in range(4)]
    pieces = b"".join(
        tar_bytes(f"{i:08d}", {**members, member: b""} if i == 2 else members) for i, members in enumerate(samples)
    )
    shard.path("tar").write_bytes(pieces + tar_end(len(pieces)))
    finished = shard.path("parquet").read_bytes()
    shard.path("parquet").unlink()
    shard.join(4)
    assert shard.missing(4) == [2]
    add(shard, 2)
    shard.join(4)
    assert contents(shard) == whole
    shard.path("tar").write_bytes(pieces + tar_end(len(pieces)) + bytes(10240))
    shard.path("parquet").write_bytes(finished)
    add(shard, 4)
    with pytest.raises(FormatError, match=rf"00000002\.{member}: expected .*; remove this shard's"):
        shard.join(5)


def test_a_finished_tar_cut_short_is_an_error_and_stays_as_it_is(shard):
    data = contents(shard)[0]
    shard.path("tar").write_bytes(data[:-12000])
    with pytest.raises(FormatError, match=r"00000\.tar: expected at least \d+ bytes, got"):
        shard.missing(4)
    shard.path("parquet").write_bytes(b"PAR1 rubbish")
    with pytest.raises(FormatError, match=r"00000\.parquet: expected the index"):
        shard.missing(4)


def test_a_shard_of_another_recipe_is_not_called_damaged(tmp_path):
    """However it came here: its `dataset.json` says otherwise."""
    recipe = fake_samples.recipe()
    texts = [recipe_text({**recipe.description(), "seed": seed}) for seed in (7, 8)]
    theirs = replace(a_shard(tmp_path), recipe=texts[1])
    add(theirs, 0, 1)
    theirs.join(2)
    whole = contents(theirs)
    ours = replace(theirs, recipe=texts[0], names=(*theirs.names, "passes.exr"))
    with pytest.raises(InputError, match=r"00000\.parquet: seed: expected 8 as in this shard, got 7$"):
        ours.missing(2)
    assert contents(theirs) == whole


def test_a_tar_that_cannot_be_read_is_not_called_damaged(shard, monkeypatch):
    """Of a fault of the disk nothing follows for the samples, so nothing is made anew, nor is removing advised."""
    add(shard, 4)
    shard.path("parquet").unlink()
    whole = shard.path("tar").read_bytes()

    def refuse(path):
        if path == shard.path("tar"):
            raise OSError(errno.EIO, "Input/output error")
        return open_regular(path)

    monkeypatch.setattr(write, "open_regular", refuse)
    for ask in (shard.missing, shard.join):
        with pytest.raises(OSError, match=r"Input/output error$"):
            ask(5)
    monkeypatch.undo()
    assert shard.path("tar").read_bytes() == whole
    assert shard.missing(5) == []


def test_pipes_in_the_place_of_files_are_not_waited_for(tmp_path, shard):
    """A part that is a pipe is made anew; a tar and an index that are pipes are named."""
    unfinished = a_shard(tmp_path / "unfinished")
    add(unfinished, 1)
    os.mkfifo(unfinished.path("parts") / "00000000.tar")
    unfinished.join(2)
    assert unfinished.missing(2) == [0]
    for suffix in ("tar", "parquet"):
        other = a_shard(tmp_path / suffix)
        add(other, 0)
        other.join(1)
        other.path(suffix).unlink()
        os.mkfifo(other.path(suffix))
        with pytest.raises((FormatError, InputError), match=rf"00000\.{suffix}: expected "):
            other.missing(2) and other.join(2)


def test_parts_beyond_n_stay_for_a_larger_n(tmp_path, shard):
    other = a_shard(tmp_path / "other")
    add(other, 0, 1, 3)
    other.join(2)
    assert (other.joined(), set(other.parts())) == ({0, 1}, {3})


def test_samples_come_back(tmp_path, shard):
    reader = Reader(str(shard.folder))
    assert len(reader) == 4
    for i, sample in enumerate(reader):
        assert sample.key == f"{i:08d}"
        np.testing.assert_array_equal(sample.image, fake_samples.image(i))
        np.testing.assert_array_equal(reader.image(i), sample.image)
        text = labels_module.to_json(fake_samples.labels(i))
        assert labels_module.to_json(sample.labels) == text == labels_module.to_json(reader.labels(i))
        assert json.loads(sample.scene_json)["index"] == i
        assert list(reader.raw(i)) == ["png", "scene.json", "labels.json"]
    assert reader[-1].key == "00000003"
    with pytest.raises(IndexError):
        reader[4]
    reader, position = find(f"{shard.folder}:00000002")
    assert reader[position].key == "00000002"
    with pytest.raises(FormatError, match="expected a sample up to 00000003, got 00000009"):
        find(f"{shard.folder}:00000009")
    assert pickle.loads(pickle.dumps(reader)).key(1) == "00000001"


def test_labels_are_read_without_the_image(shard):
    data = bytearray(contents(shard)[0])
    places, _ = scan(shard.path("tar"), shard.names)
    start, size = places[1].members["png"]
    data[start : start + size] = bytes(size)
    shard.path("tar").write_bytes(data)
    reader = Reader(str(shard.folder))
    assert reader.labels(1).lanes[0].id == "c1"
    with pytest.raises(FormatError, match=r"00000\.tar: 00000001\.png: expected a JPEG or PNG"):
        reader[1]


def test_index_has_scene_and_label_columns(shard):
    table = Reader(str(shard.folder)).index
    assert table.schema.equals(pa.unify_schemas([SCHEMA, ADDED_SCHEMA]))
    row = table.to_pylist()[1]
    expected = {"n_lanes": 3, "flip_lateral": False, "marking_width_m": 0.12, "camera_height_m": 1.6, "exposure": 2.0}
    expected |= {"junction": "none", "max_grade": 0.1, "n_centerlines": 1, "n_visible_centerlines": 1, "n_cars": 0}
    assert {name: row[name] for name in expected} == expected
    assert row["object_hidden_fraction"] == pytest.approx(2 / 54)


def test_columns_that_were_added_later_are_the_keys_that_scenes_may_leave_out(flat_scene):
    """With these defaults: an older shard's row is that of the scene without them."""
    row = index_row(
        "00000000",
        {},
        "",
        flat_scene,
        labels_module.Labels(fake_samples.labels(0).camera, (), fake_samples.labels(0).graph),
    )
    assert {name: row[name] for name in ADDED} == ADDED
    assert {name: type(value) for name, value in ADDED.items()} == {name: type(row[name]) for name in ADDED}
    assert set(row) <= {*SCHEMA.names, *ADDED}
    assert len(SCHEMA) == 77, "a column that older shards lack has its default in ADDED (dataset/index.py)"


def test_older_shards_have_the_defaults_of_columns_that_were_added(shard):
    table = pq.read_table(shard.path("parquet"))
    changed = table.set_column(table.schema.get_field_index("weather_kind"), "weather_kind", [["rain"] * len(table)])
    pq.write_table(changed, shard.path("parquet"))
    assert rows_where(Reader(str(shard.folder)).index, "weather_kind = 'rain'").tolist() == list(range(len(table)))
    pq.write_table(table.drop_columns(list(ADDED)), shard.path("parquet"))
    for columns in (None, ["weather_kind", "n_oncoming"]):
        index = Reader(str(shard.folder), columns=columns).index
        assert index["weather_kind"].to_pylist() == ["any"] * len(table)
        assert index["n_oncoming"].to_pylist() == [0] * len(table)
    assert Reader(str(shard.folder)).index.equals(table)


def test_reader_names_what_is_wrong(tmp_path, shard):
    for place in (tmp_path / "nowhere" / "train", shard.folder.parent):
        with pytest.raises(FormatError, match=r"expected a split of a data set, as DIR/train, got no .*/dataset\.json"):
            Reader(str(place))
    with pytest.raises(FormatError, match=r"expected a split of a data set, got no folder; there is .*/train$"):
        Reader(str(tmp_path / "val"))
    empty = tmp_path / "empty"
    empty.mkdir()
    shutil.copyfile(tmp_path / "dataset.json", empty / "dataset.json")
    for reads in (readers, one_reader):
        with pytest.raises(FormatError, match=r"empty: expected finished shards .*, got none; run generate again$"):
            reads(str(empty))
    reader = Reader(str(shard.folder))
    data = contents(shard)[0]
    shard.path("tar").write_bytes(data[:3000])
    with pytest.raises(FormatError, match=r"00000\.tar: expected \d+ bytes from byte \d+, got 0"):
        reader[3]
    shard.path("tar").write_bytes(data[512:])
    with pytest.raises(FormatError, match=r"expected 00000001\.labels\.json at byte"):
        reader.labels(1)
    shard.path("tar").unlink()
    with pytest.raises(FormatError, match=r"00000\.tar: cannot be read"):
        reader.labels(1)
    table = pq.read_table(shard.path("parquet"))
    pq.write_table(table.drop_columns(["labels_offset"]), shard.path("parquet"))
    with pytest.raises(FormatError, match=r"00000\.parquet: expected a column labels_offset"):
        Reader(str(shard.folder))
    shard.path("parquet").write_bytes(b"rubbish")
    with pytest.raises(FormatError, match=r"00000\.parquet: expected the index"):
        Reader(str(shard.folder))


def enter(root, shards=(0,), split="train", n=4, **changes):
    return claim(root, {**fake_samples.recipe().description(), "shard_size": 10, **changes}, split, n, shards)


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, shard):
    (tmp_path / "file").touch()
    for root in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="cannot write to this folder"), enter(root):
            pass
    shutil.copytree(shard.folder, tmp_path / "orphan" / "train")
    with pytest.raises(InputError, match="shards beside it"), enter(tmp_path / "orphan"):
        pass
    (tmp_path / "dataset.json").write_text("{")
    with pytest.raises(FormatError, match=r"dataset\.json: expected JSON"), enter(tmp_path):
        pass
