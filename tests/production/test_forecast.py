"""What a run says it will take."""

from synth3dlanes.production.forecast import forecast
from tests import fake_samples


def test_the_time_has_blenders_start_once_and_falls_with_workers():
    recipe = fake_samples.recipe()
    seconds = {n: forecast(recipe, n, 1).seconds for n in (0, 1, 2, 102)}
    per_image = (seconds[102] - seconds[2]) / 100
    start = seconds[1] - per_image
    assert seconds[0] == 0
    assert 1 < start < 10, "importing bpy and loading the first scene takes seconds"
    assert abs(seconds[2] - (start + 2 * per_image)) < 1e-9
    assert abs(forecast(recipe, 102, 2).seconds - (start + 51 * per_image)) < 1e-9
