"""What the baseline is handed of our own data sets: rolled cameras turned upright, everything else as it is."""

import shutil
from pathlib import Path

import fsspec
import numpy as np
import pytest
from PIL import Image, ImageDraw
from synth3dlanes_baseline import sources
from synth3dlanes_baseline.data import annotation_of
from synth3dlanes_baseline.sources import image_at, key_at, labels_at, open_split, training_and_validation
from synth3dlanes_baseline.tusimple import TusimpleOnPlane

from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.format import Picture, encode, member_names
from synth3dlanes.dataset.write import Shard
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.formats.apollo import ApolloSplit
from synth3dlanes.formats.openlane import OpenLaneSplit
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.scene import scene as scene_format
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.truth.ground_truth import ground_truth
from tests import fake_samples

N = 3


@pytest.fixture(scope="module")
def split_of(tmp_path_factory):
    """Writes scenes of one seed to a split, their cameras rolled or not, and opens it as training does."""

    def write(*changes):
        root = tmp_path_factory.mktemp("sources") / "data"
        with claim(root, {**fake_samples.recipe().description(), "shard_size": 1000}, "train", N, [0]) as folder:
            shard = Shard(folder, 0, 1000, member_names("png", ()))
            for index in range(N):
                scene = sample_scene(Scenes(load_params("appendix_i", ["trees.n=0", *changes]), 4, "train"), index)
                labels = ground_truth(scene)
                shard.write_part(index, encode(Picture(_picture(labels), labels), scene_format.to_json(scene), "png"))
            shard.join(N)
        return open_split(root / "train")

    return write


def _picture(labels):
    """Bright discs on the lanes 8 to 20 m ahead."""
    image = Image.new("RGB", (labels.camera.width_px, labels.camera.height_px))
    draw = ImageDraw.Draw(image)
    for lane in labels.lanes:
        for point in lane.xyz_cam[8:20:6]:
            u, v, depth = labels.camera.img_from_cam @ point
            draw.circle((u / depth - 0.5, v / depth - 0.5), 4, fill=(255, 255, 255))
    return np.asarray(image)


def test_targets_of_a_rolled_image_are_those_of_the_same_scene_without_roll(split_of):
    shift = "camera.principal_offset_px=[-8, 8]"
    level, rolled = (split_of(shift, change) for change in ("camera.roll_deg=0", "camera.roll_deg=3"))
    for index in range(N):
        one, other = (annotation_of("", split.labels(index), (360, 480), "horizon") for split in (level, rolled))
        np.testing.assert_allclose(other.intrinsics, one.intrinsics)
        np.testing.assert_allclose(other.plane, one.plane)
        np.testing.assert_allclose(other.target, one.target, atol=1e-5)
        np.testing.assert_allclose(other.xyz_cam, one.xyz_cam, atol=2e-4)
        np.testing.assert_array_equal(other.visible, one.visible)
        a, b = (split.image(index)[20:-20, 20:-20].ravel() for split in (level, rolled))
        assert np.corrcoef(a, b)[0, 1] > 0.85, "the pictures show the lanes in the same places"
        np.testing.assert_array_equal(rolled.image(index), rolled[index].image)


def test_without_a_validation_split_every_tenth_sample_is_held_out(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "open_split", lambda place: list(range(25)) if place.endswith("train") else ["val"])
    train, val = sources.training_and_validation([str(tmp_path)], "train", "val", None)
    assert list(val.index) == [9, 19]
    assert sorted([*train.index, *val.index]) == list(range(25))
    (tmp_path / "val").mkdir()
    train, val = sources.training_and_validation([str(tmp_path)], "train", "val", 12)
    assert list(train.index) == list(range(12))
    assert val == ["val"]


def test_several_data_sets_follow_one_another_each_with_its_own_validation(split_of, tmp_path):
    level, rolled = (Path(split_of(*changes).reader.url).parent for changes in ((), ("camera.roll_deg=2",)))
    shutil.copytree(level / "train", level / "val")
    parts = [open_split(root / "train") for root in (level, rolled)]
    train, val = training_and_validation([str(level), f"{rolled}/"], "train", "val", None)
    assert (len(train), len(val)) == (2 * N, 2 * N)
    for at in range(2 * N):
        source, index = divmod(at, N)
        sample, alone = train[at], parts[source][index]
        assert sample.key == key_at(train, at) == f"{(level, rolled)[source]}/train:0000000{index}"
        for labels in (sample.labels, labels_at(train, at)):
            np.testing.assert_array_equal(labels.lanes[0].xyz_cam, alone.labels.lanes[0].xyz_cam)
        np.testing.assert_array_equal(sample.image, alone.image)
        np.testing.assert_array_equal(image_at(train, at), alone.image)
    assert sources.describe(val) == (
        f"{level}/val: 3 images; {rolled}/val: 3 images of the training split, as there is no validation split"
    )
    again, fewer = (training_and_validation([str(level), str(rolled)], "train", "val", most)[0] for most in (None, 1))
    assert again.digest() == train.digest() != fewer.digest()
    assert len(fewer) == 2
    alone, _ = training_and_validation(str(level), "train", "val", None)
    assert alone.digest() == training_and_validation([str(level)], "train", "val", None)[0].digest()
    with pytest.raises(InputError, match=f"data sets: expected each once, got {level}, {rolled}, {level}"):
        training_and_validation([str(level), str(rolled), f"{level}/"], "train", "val", None)


def test_held_out_clips_are_whole(tmp_path):
    def held_out(n):
        recipe = fake_samples.recipe(shots=clips(3, 10))
        plan = Plan(tmp_path / "data", n, recipe, workers=1, maker=fake_samples.make)
        assert not generate(plan, lambda event: None).problem
        return [list(part.index) for part in training_and_validation([str(tmp_path / "data")], "train", "val", None)]

    assert held_out(27) == [list(range(27))] * 2  # nine scenes
    train, val = held_out(32)
    assert val == [27, 28, 29]
    assert sorted(train + val) == list(range(32))


def test_a_validation_split_that_is_damaged_is_an_error_and_not_missing(split_of):
    root = Path(split_of().reader.url).parent
    shutil.copytree(root / "train", root / "val")
    (root / "val" / "00000.parquet").write_bytes(b"rubbish")
    with pytest.raises(FormatError, match=r"val/00000\.parquet: expected the index"):
        training_and_validation([str(root)], "train", "val", None)


def test_foreign_splits_are_known_by_their_files(tmp_path):
    (tmp_path / "train.json").write_text('{"raw_file": "images/00/1.jpg", "laneLines": []}\n')
    (tmp_path / "label_data_0313.json").write_text('{"raw_file": "clips/1/20.jpg", "lanes": [], "h_samples": [240]}\n')
    (tmp_path / "validation/segment-1").mkdir(parents=True)
    (tmp_path / "validation/segment-1/1.json").write_text("{}")
    assert isinstance(open_split(tmp_path / "train.json"), ApolloSplit)
    assert isinstance(open_split(tmp_path / "label_data_0313.json"), TusimpleOnPlane)
    assert isinstance(open_split(tmp_path / "validation"), OpenLaneSplit)
    places = [str(tmp_path / name) for name in ("train.json", "label_data_0313.json", "validation")]
    assert [sources.split_of(place) for place in places] == places


def test_both_splits_are_read_from_a_store(split_of):
    root = Path(split_of().reader.url).parent
    store = fsspec.filesystem("memory")
    for path in root.rglob("*.*"):
        store.pipe_file(f"/lanes/{path.relative_to(root).as_posix()}", path.read_bytes())
        store.pipe_file(f"/lanes/{path.relative_to(root).as_posix().replace('train/', 'val/')}", path.read_bytes())
    here, _ = training_and_validation([str(root)], "train", "val", None)
    train, val = training_and_validation(["memory://lanes/"], "train", "val", 2)
    assert (len(here), len(train), len(val)) == (N, 2, N)
    for there in (train, val):
        assert there[1].key == "00000001"
        np.testing.assert_array_equal(there[1].image, here[1].image)
    store.rm("/lanes", recursive=True)
