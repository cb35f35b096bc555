"""A small real dataset, rendered once, and a way to change copies of it and seal them again."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from synth3dlanes import labels as labels_module
from synth3dlanes.dataset.format import HEIGHT, LABELS, PASSES, key_of
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.write import Shard
from synth3dlanes.labels import Labels
from synth3dlanes.validate.report import Report

N, SHARD_SIZE = 4, 1000
# Bright paint, so that every line shows in the image; objects enough to hide something.
CHANGES = ["markings.grayscale=0.9", "cars.n=16", "trees.n=80"]
# What the labels must hold against beyond the paper.
CHANGES += ["camera.roll_deg=[-2, 2]", "camera.principal_offset_px=[-8, 8]", "markings.left_double={true: 1, false: 1}"]
CHANGES += ["markings.left_yellow={true: 1, false: 1}", "markings.wear=[0, 0.5]", "surface.wetness={0: 1, 0.8: 1}"]

Members = dict[str, bytes]
Change = Callable[[dict[int, Members]], None]


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from synth3dlanes.generate import Recipe
    from synth3dlanes.params import load_params
    from synth3dlanes.run import Plan, generate
    from synth3dlanes.settings import RenderSettings

    root = tmp_path_factory.mktemp("validate") / "data"
    settings = RenderSettings(samples=2, passes=("depth", "semantic", "instance", "height"), device="cpu")
    plan = Plan(root, N, Recipe(load_params("appendix_i", CHANGES), 4, "train", settings, "jpg"), workers=2)
    assert generate(plan, lambda event: None).exit_code == 0
    return root


@pytest.fixture
def dataset(rendered: Path, tmp_path: Path) -> Path:
    """A copy of the dataset, free to be spoilt."""
    return Path(shutil.copytree(rendered, tmp_path / "data"))


def seal(root: Path, change: Change, split: str = "train") -> None:
    """Rewrite a split with its samples changed, the digests in its index being those of what is there now."""
    reader = Reader(f"{root}/{split}")
    samples = {int(reader.key(i)): reader.raw(i) for i in range(len(reader))}
    change(samples)
    names = tuple(next(iter(samples.values())))
    for path in (root / split).glob("00000.*"):
        path.unlink()
    shard = Shard(root / split, 0, SHARD_SIZE, names)
    for index, members in samples.items():
        shard.write_part(index, members)
    shard.join(SHARD_SIZE)


def drop_passes(root: Path) -> None:
    """The same dataset as if made without passes."""

    def change(samples: dict[int, Members]) -> None:
        for members in samples.values():
            del members[PASSES], members[HEIGHT]

    seal(root, change)
    path = root / "dataset.json"
    document = json.loads(path.read_text())
    document["render"]["passes"] = []
    path.write_text(json.dumps(document))


def relabel(index: int, change: Callable[[Labels], Labels]) -> Change:
    """A change of one sample's labels."""

    def apply(samples: dict[int, Members]) -> None:
        labels = labels_module.from_json(samples[index][LABELS], key_of(index))
        samples[index][LABELS] = labels_module.to_json(change(labels)).encode()

    return apply


def check(root: Path, workers: int = 1) -> Report:
    from synth3dlanes.validate.run import validate

    return validate(root, workers, None, lambda done, total: None)
