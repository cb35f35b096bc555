"""The bench's numbers add up, its yardsticks measure what they say."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from synth3dlanes.production.bench import psnr, ssim


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


@pytest.mark.render
def test_the_bench_adds_up_and_compares(tmp_path):
    from synth3dlanes_cli.main import main

    command = ["bench", "--n", "3", "--params", "tiny", "--workers", "1", "--device", "cpu", "--samples", "1", "--json"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["ratio"] == pytest.approx(found["seconds_per_image"] / found["floor_seconds_per_image"])
    assert found["images_per_hour"] == pytest.approx(3600 / found["seconds_per_image"])
    assert found["floor_seconds_per_image"] == pytest.approx(
        found["stages"]["path tracing"] + found["stages"]["denoise"]
    )
    assert all(seconds >= 0 for seconds in found["stages"].values())
    assert sum(found["stages"].values()) == pytest.approx(found["seconds_per_image"], rel=0.3)
    assert {"sample", "labels", "build", "sync", "bvh", "passes", "encode", "write"} <= set(found["stages"])
    (tmp_path / "stored.json").write_text(result.stdout)
    again = CliRunner().invoke(main, [*command[:-1], "--against", str(tmp_path / "stored.json")])
    assert again.exit_code == 0, again.output
    assert "now / stored" in again.stdout
    assert "end to end" in again.stdout


@pytest.mark.render
def test_more_samples_come_closer_to_the_reference_and_naive_is_slower():
    from synth3dlanes.params import load_params
    from synth3dlanes.production.bench import measure_naive, measure_quality
    from synth3dlanes.production.recipe import Recipe
    from synth3dlanes.settings import RenderSettings

    recipes = [Recipe(load_params("tiny"), 0, "bench", RenderSettings(samples), "jpg") for samples in (1, 8)]
    rough, fine = (measure_quality(recipe, lambda _: None, samples=64) for recipe in recipes)
    assert all(a < b for a, b in zip(rough.psnr_db + rough.ssim, fine.psnr_db + fine.ssim, strict=True))
    assert min(fine.psnr_db) > 28
    naive = measure_naive(recipes[0], lambda _: None)
    assert naive.seconds > naive.seconds_same_samples > 0


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.timeout(3600)
def test_memory_stays_flat():
    """A thousand small scenes in one worker."""
    from synth3dlanes.params import load_params
    from synth3dlanes.production.bench import bench
    from synth3dlanes.production.recipe import Recipe
    from synth3dlanes.settings import RenderSettings

    size = ("camera.width_px=96", "camera.height_px=72")
    recipe = Recipe(load_params("appendix_i", size), 0, "bench", RenderSettings(1), "jpg")
    third, fourth = bench(recipe, 1000, 1, [{}], lambda _: None).memory_mib[2:]
    assert fourth < 1.02 * third
