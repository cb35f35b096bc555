"""What a run says it will take."""

from synth3dlanes.production.forecast import forecast, patience_s, seconds_per_sample
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
