"""The bench's numbers add up, its yardsticks measure what they say."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

from synth3dlanes.draw.sample import Scenes
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
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import FormatError


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
    now = Bench(
        "tiny",
        1,
        3,
        1,
        "cpu",
        4,
        (96, 72),
        7200,
        7200,
        0.5,
        0.5,
        0.4,
        1.25,
        stages,
        0,
        [],
        None,
        DefaultTiming(0.6, 128, 5.0),
    )
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
    assert {"sample", "labels", "build", "sync", "bvh", "passes", "encode", "write"} <= set(found["stages"])
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
