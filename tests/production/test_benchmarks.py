"""The bench's numbers add up; named benchmarks give everybody the same data."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from synth3dlanes_cli.main import main

from synth3dlanes.dataset.format import LABELS
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.labels import labels as label_file
from synth3dlanes.params.params import load_params
from synth3dlanes.production import bench
from synth3dlanes.production.bench import (
    Bench,
    DefaultTiming,
    SampleTiming,
    StoredBench,
    _seconds_between,
    compare,
    psnr,
    ssim,
)
from synth3dlanes.production.benchmarks import BenchmarkSplit, benchmark_names, labels_digest, load_benchmark
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import FormatError, InputError
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
    return CliRunner().invoke(main, ["benchmark", *words])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a benchmark, its digests among it, and its data."""
    folder = tmp_path_factory.mktemp("benchmark")
    path = folder / "small.yaml"
    path.write_text(SMALL)
    drawn = {split: load_benchmark(str(path)).drawn_digest(split) for split in ("train", "test")}
    path.write_text(
        SMALL.replace("n: 2}", f"n: 2, labels: {drawn['train']}}}").replace("n: 4}", f"n: 4, labels: {drawn['test']}}}")
    )
    result = command(str(path), "--out", str(folder / "data"), "--train", "--workers", "1", "--json")
    assert result.exit_code == 0, result.output
    splits = json.loads(result.stdout)["splits"]
    assert {name: split["n"] for name, split in splits.items()} == {"train": 2, "test": 4}
    assert splits["test"]["labels"] == load_benchmark(str(path)).splits["test"].labels
    return folder


@pytest.mark.render
def test_a_network_is_scored_as_by_evaluate(made):
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
    reread = [label_file.from_json(label_file.to_json(labels), "") for labels in drawn]
    assert labels_digest(drawn) == labels_digest(reread) == hills.drawn_digest("test")


@pytest.mark.slow
@pytest.mark.parametrize("name", benchmark_names())
def test_the_digests_are_those_of_this_version(name):
    found = load_benchmark(name)
    assert found.drawn_digest("test") == found.splits["test"].labels, "python -m scripts.benchmarks"


def test_a_bad_file_is_told_in_a_line(tmp_path):
    (tmp_path / "bad.yaml").write_text(f"{SMALL}x: 1")
    with pytest.raises(InputError, match=r"bad\.yaml: x: unknown key"):
        load_benchmark(str(tmp_path / "bad.yaml"))


def test_psnr_and_ssim_of_known_differences(rng):
    image = rng.integers(0, 200, (40, 50, 3), dtype=np.uint8)
    assert ssim(image, image) == pytest.approx(1)
    assert psnr(image, image) == float("inf")
    assert psnr(image, image + np.uint8(16)) == pytest.approx(20 * np.log10(255 / 16))
    noises = [np.clip(image + rng.normal(0, sigma, image.shape), 0, 255).astype(np.uint8) for sigma in (2, 8, 32)]
    assert 1 > ssim(image, noises[0]) > ssim(image, noises[1]) > ssim(image, noises[2]) > 0
    # Two flat pictures have no structure; what is left of the index is its first factor.
    a, b = np.full((30, 30, 3), 100, np.uint8), np.full((30, 30, 3), 110, np.uint8)
    assert ssim(a, b) == pytest.approx((2 * 100 * 110 + 6.5025) / (100**2 + 110**2 + 6.5025))


def timed(worker, ended):
    return SampleTiming(worker, ended, 0.0, {}, 0, 0)


def test_time_between_samples_is_that_of_each_worker():
    """Two workers, one twice as slow as the other: 2 + 2 and 4 seconds for three samples, whatever their order."""
    samples = [timed(1, 10), timed(2, 11), timed(1, 12), timed(1, 14), timed(2, 15)]
    assert _seconds_between(samples) == pytest.approx(8 / 3)
    assert _seconds_between(samples[::-1]) == pytest.approx(8 / 3)


def test_a_comparison_is_free_of_the_machines_speed():
    """Against itself on a machine that is three times slower, and with one stage twice as long."""
    stages = {"build": 0.1, "path tracing": 0.3, "denoise": 0.1}
    sizes, rates, seconds = ((96, 72), 7200, 7200), (0.5, 0.5, 0.4, 1.25), DefaultTiming(0.6, 128, 5.0)
    now = Bench("tiny", 1, 3, 1, "cpu", 4, *sizes, *rates, stages, 0, [], None, seconds)
    slower = json.loads(json.dumps(now.document()))
    for group in (slower, slower["stages"], slower["naive"]):
        group.update({name: 3 * group[name] for name in group if name in stages or "seconds" in name})
    slower["stages"]["build"] *= 2
    found = {name: (ours, theirs) for name, ours, theirs in compare(now, StoredBench.model_validate(slower))}
    assert found.pop("build") == pytest.approx((0.25, 0.5))
    assert found["end to end"] == (1.25, 1.25)
    assert found["naive seconds"] == pytest.approx((10, 10))
    for name, (ours, theirs) in found.items():
        assert ours == pytest.approx(theirs), name


@pytest.mark.thorough
@pytest.mark.render
def test_the_bench_adds_up_and_compares(tmp_path):
    command = ["bench", "--n", "3", "--params", "tiny", "--workers", "1", "--device", "cpu", "--samples", "1", "--json"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    floor = found["stages"]["path tracing"] + found["stages"]["denoise"]
    assert found["floor_seconds_per_image"] == pytest.approx(floor)
    # What no stage accounts for is "waiting": a stage that is counted twice makes the sum too large.
    assert sum(found["stages"].values()) == pytest.approx(found["seconds_per_image"], rel=1e-3)
    within = ("sample", "labels", "meshes", "build", "sync", "textures", "bvh", "occlusion", "encode", "write")
    assert [name for name in within if not found["stages"][name] > 0] == []
    (tmp_path / "stored.json").write_text(result.stdout)
    again = CliRunner().invoke(main, [*command[:-1], "--n", "1", "--against", str(tmp_path / "stored.json")])
    assert again.exit_code == 0, again.output
    assert "now / stored" in again.stdout
    assert "end to end" in again.stdout


def test_of_stored_rows_the_one_of_the_same_recipe_is_compared(tmp_path):
    row = {"ratio": 1.5, "seconds_per_image": 3.0, "floor_seconds_per_image": 2.0, "stages": {}}
    names = ("params", "samples", "frames", "views", "map")
    keys = [
        ("streets", 4, 1),
        ("streets", 1, 1),
        ("streets", 1, 12),
        ("streets", 1, 1, 1, "a.xodr"),
        ("streets", 1, 1, 4),
    ]
    rows = [{**row, **dict(zip(names, key, strict=False)), "ratio": 1.0 + k} for k, key in enumerate(keys)]
    path = tmp_path / "rows.json"
    path.write_text(json.dumps({"rows": rows}))
    assert [bench.read_bench(path, *key).ratio for key in keys] == [1.0, 2.0, 3.0, 4.0, 5.0]
    with pytest.raises(FormatError, match="expected a row of tiny, 1 sample, frames 1, found streets, 4 samples"):
        bench.read_bench(path, "tiny", 1, 1)


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.timeout(3600)
def test_memory_stays_flat():
    """A thousand small scenes in one worker."""
    size = ("camera.width_px=96", "camera.height_px=72")
    recipe = Recipe(Scenes(load_params("appendix_i", size), 0, "bench"), RenderSettings(1), "jpg")
    third, fourth = bench.bench("appendix_i", recipe, 1000, 1, [{}], lambda _: None).memory_mib[2:]
    assert fourth < 1.02 * third
