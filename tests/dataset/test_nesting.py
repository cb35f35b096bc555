"""No data set lies in another: writers refuse, and readers say which folder is both."""

from collections.abc import Callable
from pathlib import Path

import pytest

from synth3dlanes import open_dataset
from synth3dlanes.dataset.destination import Destination
from synth3dlanes.dataset.info import dataset_info
from synth3dlanes.dataset.rearrange import merge, split_dataset
from synth3dlanes.dataset.splits import one_reader, readers
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.validate.run import validate
from tests import fake_samples

RECIPE = fake_samples.recipe()
DESCRIPTION = {**RECIPE.description(), "shard_size": 4}


def make(root: Path, split: str = "train") -> Path:
    with Destination(root).claim(DESCRIPTION, split, 4, [0]):
        pass
    return fake_samples.data_set(root, range(4), 4, 4, split)


@pytest.fixture
def nested(tmp_path: Path) -> Path:
    """A data set whose split train is a data set too, as older versions have made them."""
    inner = make(tmp_path / "aside")
    outer = make(tmp_path / "d")
    for path in inner.iterdir():
        path.rename(outer / "train" / path.name)
    return outer


@pytest.mark.parametrize("inside", ["d/train", "d/val", "d/train/deeper", "d/train/"])
@pytest.mark.parametrize("is_store", [False, True])
def test_every_writer_refuses_a_place_in_a_data_set(tmp_path: Path, inside: str, is_store: bool) -> None:
    outer = make(tmp_path / "d")
    before = sorted(tmp_path.rglob("*"))
    out = f"{tmp_path.as_uri() if is_store else tmp_path}/{inside}"
    writers: list[Callable[[], object]] = [
        lambda: Destination(out).check_recipe(DESCRIPTION, "train", 4),
        lambda: Destination(out).claim(DESCRIPTION, "train", 4, [0]).__enter__(),
        lambda: merge([str(outer)], out),
        lambda: split_dataset(one_reader(str(outer)), {"a": 0.5, "b": 0.5}, 0, out),
    ]
    for write in writers:
        with pytest.raises(
            InputError, match=r"out .*: expected a folder outside of every data set, got .* of the data"
        ):
            write()
    assert sorted(tmp_path.rglob("*")) == before


def test_a_split_is_not_made_in_the_folder_of_a_data_set(tmp_path: Path) -> None:
    make(tmp_path / "d/val")
    with pytest.raises(InputError, match=r"out .*d/val: expected a data set or a split, got both"):
        make(tmp_path / "d", "val")


def test_beside_and_above_other_folders_data_sets_are_made(tmp_path: Path) -> None:
    make(tmp_path / "sets/one")
    make(tmp_path / "sets/two")
    (tmp_path / "dataset.json").write_text('{"title": "of another program"}')
    assert len(one_reader(str(make(tmp_path / "sets/one")))) == 4


def test_every_reader_says_which_folder_is_both(nested: Path) -> None:
    train = str(nested / "train")
    readings: list[Callable[[], object]] = [
        lambda: open_dataset(nested, "train"),
        lambda: readers(str(nested)),
        lambda: readers(train),
        lambda: one_reader(train),
        lambda: dataset_info(str(nested)),
        lambda: dataset_info(train),
    ]
    for read in readings:
        with pytest.raises(FormatError, match=f"{train}: expected a data set or a split, got both"):
            read()
    for place in (str(nested), train):
        report = validate(place, 1, 0, lambda done, total: None)
        assert any("expected a data set or a split, got both" in problem.reason for problem in report.problems)
