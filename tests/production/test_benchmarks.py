"""Named benchmarks: everybody gets the same data, and whoever has other data is told."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from synth3dlanes.dataset.format import LABELS
from synth3dlanes.draw.sample import sample_scene
from synth3dlanes.labels import labels as label_file
from synth3dlanes.labels.labels import Labels
from synth3dlanes.production.benchmarks import BenchmarkSplit, benchmark_names, labels_digest, load_benchmark
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import ground_truth
from tests.validate.sealing import Members, seal

SMALL = """
title: Small
about: Two scenes and a clip of two frames.
params: tiny
changes: ["trees.n=2", "cars.n=1"]
seed: 5
frames: 2
splits:
  train: {n: 2}
  test: {n: 4}
"""


def command(*words: str) -> Result:
    from synth3dlanes_cli.main import main

    return CliRunner().invoke(main, ["benchmark", *words])


def written(folder: Path) -> Path:
    """A benchmark with its digests."""
    path = folder / "small.yaml"
    path.write_text(SMALL)
    drawn = {split: load_benchmark(str(path)).drawn_digest(split) for split in ("train", "test")}
    path.write_text(
        SMALL.replace("n: 2}", f"n: 2, labels: {drawn['train']}}}").replace("n: 4}", f"n: 4, labels: {drawn['test']}}}")
    )
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a benchmark and its data."""
    folder = tmp_path_factory.mktemp("benchmark")
    path = written(folder)
    result = command(str(path), "--out", str(folder / "data"), "--train", "--workers", "1", "--json")
    assert result.exit_code == 0, result.output
    splits = json.loads(result.stdout)["splits"]
    assert {name: split["n"] for name, split in splits.items()} == {"train": 2, "test": 4}
    assert splits["test"]["labels"] == load_benchmark(str(path)).splits["test"].labels
    return folder


@pytest.mark.render
def test_a_network_is_scored_as_by_evaluate(made):
    from synth3dlanes_cli.main import main

    path, data = str(made / "small.yaml"), str(made / "data")
    score = json.loads(command(path, "--out", data, "--checkpoint", "nano", "--json").stdout)["score"]
    found = CliRunner().invoke(main, ["evaluate", f"{data}/test", "--checkpoint", "nano", "--json"])
    assert score.items() <= json.loads(found.stdout).items()
    assert score["settings"]["n_images"] == 4


@pytest.mark.render
@pytest.mark.parametrize("by_m", [0.01, 0.0004])
def test_other_labels_are_told(made, tmp_path, by_m):
    """Of a centimetre, but not of half a millimetre: machines differ in the last digits."""
    shutil.copytree(made / "data", tmp_path / "data")

    def move(samples: dict[int, Members]) -> None:
        labels = label_file.from_json(samples[1][LABELS], "")
        first, *others = labels.lanes
        moved = replace(first, xyz_cam=first.xyz_cam + by_m * is_inside(first.xyz_cam))
        samples[1][LABELS] = label_file.to_json(replace(labels, lanes=(moved, *others))).encode()

    seal(tmp_path / "data", move, "test")
    result = command(str(made / "small.yaml"), "--out", str(tmp_path / "data"), "--workers", "1")
    assert result.exit_code == (by_m > 0.001)
    assert ("expected labels of digest" in result.stderr) is (by_m > 0.001)


def is_inside(values_m: np.ndarray) -> np.ndarray:
    """Which values stay the same centimetre when they grow by less than a millimetre."""
    return np.abs(values_m * 100 - np.rint(values_m * 100)) < 0.4


@pytest.mark.render
def test_another_recipe_in_the_folder_is_refused(made):
    path = made / "other.yaml"
    path.write_text((made / "small.yaml").read_text().replace("seed: 5", "seed: 6"))
    result = command(str(path), "--out", str(made / "data"), "--workers", "1")
    assert result.exit_code == 2
    assert "seed: expected 5 as in this dataset, got 6" in result.stderr


def test_every_benchmark_of_the_package_is_whole():
    assert benchmark_names() == ["clips", "exits", "hills", "weather"]
    for name in benchmark_names():
        found = load_benchmark(name)
        assert list(found.splits) == ["train", "val", "test"]
        assert all(split.labels for split in found.splits.values()), "python -m scripts.benchmarks"
        assert found.splits["test"].n % found.frames == 0


def test_two_draws_have_one_digest_and_other_scenes_another():
    hills = load_benchmark("hills").model_copy(
        update={"splits": {name: BenchmarkSplit(n=2) for name in ("val", "test")}}
    )
    assert hills.drawn_digest("test") == hills.drawn_digest("test") != hills.drawn_digest("val")
    scenes = hills.job("test").recipe().scenes
    drawn = [ground_truth(sample_scene(scenes, index)) for index in range(2)]
    assert labels_digest(drawn) == hills.drawn_digest("test")
    assert labels_digest(reread(one) for one in drawn) == hills.drawn_digest("test")


def reread(labels: Labels) -> Labels:
    return label_file.from_json(label_file.to_json(labels), "")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clips", "exits", "hills", "weather"])
def test_the_digests_are_those_of_this_version(name):
    found = load_benchmark(name)
    assert found.drawn_digest("test") == found.splits["test"].labels, "python -m scripts.benchmarks"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("splits:", "splits: expected an object"),
        ("x: 1", "x: unknown key"),
        ("- 1", "expected the keys of a benchmark"),
    ],
)
def test_a_bad_file_is_told_in_lines(tmp_path, text, problem):
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=problem):
        load_benchmark(str(path))
