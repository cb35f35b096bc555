"""What a run says it will take."""

from dataclasses import replace
from pathlib import Path

from synth3dlanes.production.forecast import forecast, patience_s, seconds_per_sample
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples

LARGE = ("camera.width_px=7680", "camera.height_px=4320")


def test_large_images_may_take_longer():
    small, large = (fake_samples.recipe(overrides=changes) for changes in ((), LARGE))
    assert patience_s(small) == 120
    assert seconds_per_sample(large) > 80, "8K with 4 samples per pixel, at a second for 480x360"
    assert patience_s(large) > 20 * seconds_per_sample(large)


def test_the_time_has_blenders_start_once_and_falls_with_workers():
    recipe = fake_samples.recipe()
    seconds = {n: forecast(recipe, n, 1).seconds for n in (0, 1, 2, 102)}
    per_image = (seconds[102] - seconds[2]) / 100
    start = seconds[1] - per_image
    assert seconds[0] == 0
    assert 1 < start < 10, "importing bpy and loading the first scene takes seconds"
    assert abs(seconds[2] - (start + 2 * per_image)) < 1e-9
    assert abs(forecast(recipe, 102, 2).seconds - (start + 51 * per_image)) < 1e-9


def test_a_forecast_follows_what_the_last_run_measured(tmp_path: Path) -> None:
    """By its log, whatever is odd in that."""
    recipe = fake_samples.recipe()
    plan = Plan(tmp_path / "d", 8, recipe, workers=2, maker=fake_samples.make_slowly)
    assert not plan.expected().is_measured
    generate(plan, lambda event: None)
    more = replace(plan, n=1008).expected()
    assert more.is_measured
    assert "as the samples before took" in more.text()
    assert more.samples == 1000
    assert 0.15 < (more.seconds - 3) * 2 / 1000 < 1.5, "what make_slowly takes, far from what rendering takes"
    sizes = [path.stat().st_size for path in (tmp_path / "d/train").glob("*.tar")]
    assert 0.5 < more.bytes_kept / 1000 / (sum(sizes) / 8) < 1.5
    (log,) = (tmp_path / "d/logs").glob("train-*.jsonl")
    whole = log.read_text()
    log.write_text(whole + '{"kind": "sample", "details": {"seconds": "x"}}\n{"kind"\n[1]\n')
    assert replace(plan, n=1008).expected() == more
    log.write_text("".join(line for line in whole.splitlines(True) if '"sample"' not in line))
    assert not replace(plan, n=1008).expected().is_measured
    assert (
        not Plan(tmp_path / "d", 8, replace(recipe, scenes=replace(recipe.scenes, split="val"))).expected().is_measured
    )
