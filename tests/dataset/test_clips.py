"""Data sets of clips: columns, clips by scene, splits that keep clips whole, resuming, extending, merging."""

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from synth3dlanes.dataset.columns import SCHEMA
from synth3dlanes.dataset.index import ADDED
from synth3dlanes.dataset.info import dataset_info
from synth3dlanes.dataset.query import rows_where
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.dataset.splits import evenly_spaced
from synth3dlanes.params.shots import clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.system.errors import FormatError, InputError
from tests import fake_samples

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


def test_the_index_says_what_a_sample_shows(data):
    index = Reader(f"{data}/train").index
    assert index.schema.names == [*SCHEMA.names, *SHOT_COLUMNS, *ADDED]
    numbers = np.arange(33)
    assert index["scene"].to_pylist() == (numbers // FRAMES).tolist()
    assert index["frame"].to_pylist() == (numbers % FRAMES).tolist()
    assert set(index["camera"].to_pylist()) == {0}
    assert rows_where(index, "frame = 0 and scene > 3").tolist() == [24, 30]


def test_a_clip_is_found_by_its_scene(data):
    reader = Reader(f"{data}/train", columns=())
    assert reader.scenes == list(range(6))
    assert reader.clip(2) == reader.clip(2, camera=0) == list(range(12, 18))
    assert reader.clip(5) == [30, 31, 32]
    assert [reader.labels(i).time_s for i in reader.clip(2)] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    for scene, camera in ((6, None), (2, 1)):
        with pytest.raises(FormatError, match=f"expected pictures of scene {scene}"):
            reader.clip(scene, camera)


def test_single_pictures_are_clips_of_one_and_keep_their_columns(tmp_path):
    reader = made(tmp_path / "data", 4, frames=1)
    assert reader.index.schema.names == [*SCHEMA.names, *ADDED]
    assert reader.clip(3) == [3]
    assert reader.scenes == [0, 1, 2, 3]
    assert "shots" not in reader.description
    assert reader.labels(0).time_s is None


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


def test_more_samples_finish_the_last_clip_and_other_frames_do_not_mix(data, tmp_path):
    folder = tmp_path / "data"
    made(folder, 33)
    assert len(made(folder, 42).clip(5)) == FRAMES
    with pytest.raises(InputError, match=r"shots.frames: expected 6 as in this dataset, got 7"):
        generate(plan(folder, 42, frames=7), lambda event: None)
    with pytest.raises(InputError, match="shots: expected"):
        generate(plan(folder, 42, frames=1), lambda event: None)


def test_parts_of_clips_are_merged_to_what_one_run_makes(data, tmp_path):
    for part in (1, 2):
        made(tmp_path / str(part), 33, part=(part, 2))
    merge([str(tmp_path / "1"), str(tmp_path / "2")], str(tmp_path / "whole"))
    for name in ("train/00001.tar", "train/00001.parquet", "dataset.json"):
        assert (tmp_path / "whole" / name).read_bytes() == (data / name).read_bytes()


def test_info_and_the_start_line_count_clips(data):
    assert dataset_info(str(data)).recipe["shots"] == {"frames": FRAMES, "fps": 10.0, "cameras": []}
    assert "33 samples, 6 clips of 6 frames, 10 a second, the last of 3 frames" in plan(data, 33).text()


def test_shards_of_single_pictures_made_before_are_continued(tmp_path):
    """Columns of shards in a data set of single pictures are those that they always had."""
    made(tmp_path / "data", 12, frames=1)
    before = pq.read_schema(tmp_path / "data/train/00000.parquet")
    assert made(tmp_path / "data", 25, frames=1).index.schema.equals(before)


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
        replace(plan(tmp_path / "data", 36, workers=2), maker=fake_samples.sign), lambda event: None
    ).problem
    makers = dict(map(int, path.name.split("-")) for path in marks.iterdir())
    assert len(makers) == 36
    assert len(set(makers.values())) == 2
    shared = [scene for scene in range(6) if len({makers[FRAMES * scene + frame] for frame in range(FRAMES)}) > 1]
    # At the end a worker without a scene of its own helps the other.
    assert shared in ([], [4], [5])
