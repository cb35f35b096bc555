"""Weather and time of day: what is drawn together, and what stays as it was drawn without them."""

import re

import numpy as np
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

from synth3dlanes import api
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.figures.stats import is_fine, scene_statistics
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.params.groups import REPLACED
from synth3dlanes.params.params import Params, load_params
from synth3dlanes.params.params_text import params_yaml
from synth3dlanes.system.errors import InputError

FEW = ["cars.n=2", "trees.n=3"]


def drawn(*overrides, n=6, preset="diverse"):
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


# A value of each key that weather or time of day replaces, which neither of them gives.
OWN = {
    "air.visibility_m": 55, "air.overcast": 0.5, "surface.wetness": 0.1, "weather.rain": 0.05,
    "weather.snowfall": 0.9, "weather.snow": 0.1, "weather.snow_on_road": 0.9, "weather.headlights": False,
    "sensor.drops": 0.9, "sensor.noise": 30, "sensor.flare": 0.9, "sensor.motion_blur_m": 0.95,
    "light.sun_zenith_deg": 96, "light.metering": 0.5, "light.exposure": 9,
}  # fmt: skip
ALL_WEATHER = [
    "weather.kind={clear: 1, cloudy: 1, fog: 1, rain: 1, snow: 1}",
    "weather.daytime={day: 1, dusk: 1, night: 1}",
]


def value_of(scene, path):
    group, key = path.split(".")
    part = getattr(scene, group)
    return np.degrees(getattr(part, key.replace("_deg", "_rad"))) if key.endswith("_deg") else getattr(part, key)


@pytest.mark.parametrize(("preset", "n"), [("diverse", 9), ("streets", 3)])
def test_the_users_own_value_comes_before_the_weather_and_changes_nothing_else(preset, n):
    assert OWN.keys() == {*REPLACED.values()}
    own = drawn(*ALL_WEATHER, *(f"{path}={str(value).lower()}" for path, value in OWN.items()), n=n, preset=preset)
    for scene, left_open in zip(own, drawn(*ALL_WEATHER, n=n, preset=preset), strict=True):
        document = left_open.model_dump()
        for path, value in OWN.items():
            assert value_of(scene, path) == pytest.approx(value), path
            group, key = path.replace("_deg", "_rad").split(".")
            document[group][key] = getattr(getattr(scene, group), key)
        assert document == scene.model_dump()


def test_an_own_value_counts_in_a_file_and_by_set_alike(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(params_yaml(load_params("streets")))
    assert load_params(str(path)) == load_params("streets"), "a copy of a preset leaves open what the preset does"
    text = path.read_text()
    for line, other in (("wetness: {0", "wetness: {0.05"), ("  rain: 0 ", "  rain: [0.8, 1] ")):
        assert line in text
        text = text.replace(line, other, 1)
    path.write_text(text)
    own = load_params(str(path))
    assert own.kept == ("surface.wetness", "weather.rain")
    assert own == load_params("streets", ["surface.wetness={0.05: 3, 0.3: 1, 0.6: 1, 0.9: 1}", "weather.rain=[0.8, 1]"])
    # One that equals the preset's is the user's own by --set, and stays so in a file.
    same = load_params("streets", ["weather.headlights=false"])
    assert same.kept == ("weather.headlights",)
    path.write_text(params_yaml(same))
    assert load_params(str(path)) == same
    assert Params.model_validate(same.model_dump(mode="json")) == same
    path.write_text(params_yaml(same).replace("kept: [weather.headlights]", "kept: [weather.headlight]"))
    with pytest.raises(InputError, match="kept: expected a list of keys that follow from the weather"):
        load_params(str(path))


def test_what_a_weather_replaces_is_a_parameter_and_changes_nothing_else(tmp_path):
    """In a file with a base, and by --set; a group that a file has in part has the rest as the reference preset."""
    path = tmp_path / "mine.yaml"
    path.write_text("base: diverse\nfog: {visibility_m: [40, 60], wetness: 1}\nnight: {sun_zenith_deg: 103}\n")
    own = load_params(str(path), [*FEW, *ALL_WEATHER])
    assert own == load_params(
        "diverse", [*FEW, *ALL_WEATHER, "fog.visibility_m=[40, 60]", "fog.wetness=1", "night.sun_zenith_deg=103"]
    )
    assert own.kept == ()
    usual = load_params("diverse", [*FEW, *ALL_WEATHER])
    n_fog = n_night = 0
    for index in range(30):
        ours, theirs = (sample_scene(Scenes(params, 0, "weather"), index) for params in (own, usual))
        document = theirs.model_dump()
        if ours.weather.kind == "fog":
            n_fog += 1
            assert 40 <= ours.air.visibility_m <= 60
            assert ours.surface.wetness == 1
            document["air"]["visibility_m"], document["surface"]["wetness"] = ours.air.visibility_m, 1
        if ours.weather.daytime == "night":
            n_night += 1
            document["light"]["sun_zenith_rad"] = pytest.approx(np.radians(103), abs=1e-6)
        assert ours.model_dump() == document
    assert n_fog > 2
    assert n_night > 2


def test_what_weather_replaces_is_recorded_where_it_is_not_as_usual():
    """So that descriptions of earlier versions and of today's presets are the same."""
    document = load_params("streets", ["fog.visibility_m=50"]).model_dump(mode="json")
    assert document["fog"] == {"visibility_m": 50.0, "overcast": 1.0, "wetness": {"0.0": 2.0, "0.3": 2.0, "0.6": 1.0}}
    plain = load_params("streets").model_dump(mode="json")
    assert plain == {name: group for name, group in document.items() if name != "fog"}
    assert Params.model_validate(document) == load_params("streets", ["fog.visibility_m=50"])
    assert Params.model_validate(plain) == load_params("streets")


@pytest.mark.parametrize(
    ("own", "told"),
    [
        ("light.sun_zenith_deg=40", "own 40 is kept; left open, it would be [86, 95] with weather.daytime dusk"),
        ("surface.wetness=0", "own 0 is kept; left open, it would be [0.6, 1] with weather.kind rain"),
        ("weather.rain=[0.8, 1]", None),
        ("cars.n=3", None),
    ],
)
def test_what_does_not_fit_the_weather_is_said_in_one_line(own, told):
    errors = CliRunner().invoke(main, ["sample", "--params", "streets", "--set", own]).stderr
    assert (told is None and not errors) or (told in errors and errors.count("\n") == 1)
    if told:
        with pytest.warns(UserWarning, match=re.escape(told)):
            api.load_params("streets", own)


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
