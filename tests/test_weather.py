"""Weather and time of day: what is drawn together, and what stays as it was drawn without them."""

import numpy as np
import pytest

from synth3dlanes.figures.stats import is_fine, scene_statistics
from synth3dlanes.host import Host
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.params import load_params
from synth3dlanes.sample import Scenes, sample_scene
from synth3dlanes.scene import Weather, from_json, to_json

FEW = ["cars.n=2", "trees.n=3"]


def drawn(*overrides, n=12, preset="diverse"):
    params = load_params(preset, [*FEW, *overrides])
    return [sample_scene(Scenes(params, 0, "weather"), index) for index in range(n)]


def film(scene):
    return daylight(scene, scene.camera.height_m).film


def test_fog_is_under_a_closed_sky_and_rain_wets_the_road():
    for scene in drawn("weather.kind=fog"):
        assert scene.air.overcast == 1
        assert scene.air.visibility_m <= 800
    for scene in drawn("weather.kind=rain"):
        assert scene.air.overcast >= 0.9
        assert scene.surface.wetness >= 0.6
        assert scene.air.visibility_m <= 6000
        assert scene.weather.rain > 0
    for scene in drawn("weather.kind=snow"):
        assert scene.air.overcast >= 0.8
        assert scene.weather.snow >= 0.4
        assert scene.weather.rain == 0
    for kind in ("clear", "cloudy"):
        for scene in drawn(f"weather.kind={kind}"):
            weather = scene.weather
            assert (weather.rain, weather.snowfall, weather.snow, weather.snow_on_road) == (0, 0, 0, 0)
            assert (scene.air.overcast < 0.5) == (kind == "clear")


def test_at_night_the_sun_is_down_the_lamps_are_on_and_the_camera_works_harder():
    day, night = drawn("weather.daytime=day"), drawn("weather.daytime=night")
    for scene in night:
        assert np.degrees(scene.light.sun_zenith_rad) > 96, "after civil twilight"
        assert scene.weather.headlights
        assert scene.sensor.noise >= 2
        assert scene.sensor.motion_blur_m >= 0.3
    assert all(np.degrees(scene.light.sun_zenith_rad) < 90 and not scene.weather.headlights for scene in day)
    assert min(map(film, night)) > 50 * np.median([film(scene) for scene in day])


def test_weather_changes_nothing_but_what_it_names():
    for plain, rainy in zip(drawn(n=6), drawn("weather.kind=rain", "weather.daytime=night", n=6), strict=True):
        for part in ("terrain", "road", "markings", "cars", "trees", "camera", "host", "assets"):
            assert getattr(plain, part) == getattr(rainy, part)
        assert plain.light.sun_azimuth_rad == rainy.light.sun_azimuth_rad
        assert plain.surface.model_copy(update={"wetness": rainy.surface.wetness}) == rainy.surface


def test_a_scene_without_weather_has_none_in_its_file():
    plain = drawn(n=1, preset="appendix_i")[0]
    assert (plain.weather, plain.host) == (Weather(), Host())
    assert from_json(to_json(plain), "scene.json") == plain
    scene = drawn("weather.rain=0.5", n=1)[0]
    assert (scene.weather.kind, scene.weather.rain) == ("any", 0.5)


@pytest.mark.parametrize("of", ["weather.daytime={day: 1, night: 1}", "weather.kind={any: 1, fog: 1}"])
def test_statistics_compare_with_what_the_weather_makes_of_the_parameters(of):
    params = load_params("diverse", [*FEW, of])
    scenes = [sample_scene(Scenes(params, 3, "weather"), index) for index in range(50)]
    rows = {row.key: row for row in scene_statistics(scenes, params).parameters}
    assert [row.key for row in rows.values() if not is_fine(row)] == []
    replaced = "light.sun_zenith_deg" if "daytime" in of else "air.visibility_m"
    assert rows[replaced].count == 50
    other = {"daytime": "day"} if "daytime" in of else {"kind": "any"}
    lying = [scene.model_copy(update={"weather": scene.weather.model_copy(update=other)}) for scene in scenes]
    assert not is_fine({row.key: row for row in scene_statistics(lying, params).parameters}[replaced])
    assert rows["light.sun_azimuth_deg"].count == 50
