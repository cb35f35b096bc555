"""Parameter files: every preset loads, each mistake names its file and key; one factor of a scene changed alone."""

import json
import math
from pathlib import Path

import pytest

from synth3dlanes.params.distributions import Choice, Distribution, Integers, Uniform
from synth3dlanes.params.params import Params, check_params, forms, load_params, preset_names, presets_folder
from synth3dlanes.params.params_text import changes_yaml, keys_left_out, params_yaml
from synth3dlanes.scene.assets.catalogue import CARS, Assets
from synth3dlanes.scene.change import change_scene
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Scene, Weather
from synth3dlanes.system.errors import InputError
from tests.map_scenes import FOUR_WAY, map_scene

APPENDIX_I = (presets_folder() / "appendix_i.yaml").read_text()


def problems(text: str, folder: Path, overrides: tuple[str, ...] = ()) -> list[str]:
    """What is wrong with a file of this text, without the file's name."""
    path = folder / "flat.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        load_params(str(path), overrides)
    assert all(line.startswith((f"{path}: ", "overrides ")) for line in error.value.problems)
    return [line.removeprefix(f"{path}: ") for line in error.value.problems]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "pitch_deg: [0, 5]",
            "pitch_deg: [5, 0]",
            "camera.pitch_deg: expected [low, high] with low <= high, got [5, 0]",
        ),
        ("pitch_deg: [0, 5]", "pitsch_deg: [0, 5]", "camera.pitsch_deg: unknown key; did you mean pitch_deg?"),
        ("  pitch_deg: [0, 5]", "  #", "camera.pitch_deg: missing key"),
        ("light:", "lihgt:", "lihgt: unknown key; did you mean light?"),
        ("exposure: [1, 3]", "exposure: [1, 3]\n  exposure: 2", "key 'exposure' is given twice"),
        ("exposure: [1, 3]", "exposure: [1, .inf]", "light.exposure: expected numbers in (0, 100]"),
        ("exposure: [1, 3]", "exposure: bright", "light.exposure: expected numbers in (0, 100]"),
        ("exposure: [1, 3]", "exposure: [1, 2, 3]", "light.exposure: expected numbers in (0, 100]"),
        ("exposure: [1, 3]", "exposure: 0", "light.exposure: expected numbers in (0, 100]"),
        ("exposure: [1, 3]", "exposure: true", "light.exposure: expected numbers in (0, 100]"),
        ("exposure: [1, 3]", "exposure:", "light.exposure: expected numbers in (0, 100]"),
        ("exposure: [1, 3]", "exposure: {1: 2, 2: -1}", "light.exposure: expected positive weights"),
        ("exposure: [1, 3]", "exposure: {}", "light.exposure: expected numbers"),
        ("exposure: [1, 3]", "exposure: [1, 3", "not YAML: "),
        ("exposure: [1, 3]", "exposure: !!python/object/apply:os.getcwd []", "expected plain values (null, true, "),
        ("n_lanes: [2, 4]", "n_lanes: [2, 9]", "road.n_lanes: expected integers from 1 to 8"),
        ("n_lanes: [2, 4]", "n_lanes: [2, 3.5]", "road.n_lanes: expected integers from 1 to 8"),
        ("dash_fraction: [0.3, 1]", "dash_fraction: [0, 1]", "markings.dash_fraction: expected numbers in (0, 1]"),
        ("flip_lateral: {true: 1, false: 1}", "flip_lateral: 1", "road.flip_lateral: expected true, false or {true:"),
    ],
)
def test_a_mistake_is_one_line_that_names_file_and_key(old: str, new: str, expected: str, tmp_path: Path) -> None:
    assert old in APPENDIX_I
    found = problems(APPENDIX_I.replace(old, new), tmp_path)
    assert any(expected in line for line in found), found
    assert all("\n" not in line for line in found)


OURS = """# Narrow lanes.
base: streets

road:
  lane_width_m: [3, 3.5]        # as in old towns
"""


def test_a_file_with_a_base_says_what_changes_of_its_base_say(tmp_path: Path) -> None:
    """Also through a further file in another folder, whose own values come first, and for what weather leaves alone."""
    (tmp_path / "below").mkdir()
    first, second = tmp_path / "first.yaml", tmp_path / "below" / "second.yaml"
    first.write_text(OURS + "light: {sun_zenith_deg: [20, 40], exposure: 2}\nkept: [air.overcast]\n")
    second.write_text("base: ../first.yaml\nlight: {exposure: 3}\nair: {visibility_m: [15000, 60000]}\n")
    own = ["road.lane_width_m=[3, 3.5]", "light.sun_zenith_deg=[20, 40]"]
    one = load_params("streets", [*own, "light.exposure=2"])
    assert load_params(str(first)) == one.keeping(["air.overcast"])
    two = load_params("streets", [*own, "light.exposure=3", "air.visibility_m=[15000, 60000]"])
    assert load_params(str(second)) == two.keeping(["air.overcast"])
    assert two.kept == ("air.visibility_m", "light.exposure", "light.sun_zenith_deg")
    assert load_params(str(second), ["light.exposure=2"]).light.exposure == Choice((2.0,), (1.0,))


@pytest.mark.parametrize(
    ("base", "expected"),
    [
        ("steets", "mine.yaml: base: steets: expected one of apollo_camera, appendix_i, "),
        ("steets", "; did you mean streets?"),
        ("none.yaml", "mine.yaml: base: none.yaml: cannot read: No such file or directory"),
        ("nuscenes", "; nuscenes is for --camera"),
        (
            "[streets]",
            "mine.yaml: base: expected the name of a preset or the path of a parameter file, got ['streets']",
        ),
        ("mine.yaml", "mine.yaml: base: expected a file that is not based on this one, got mine.yaml -> mine.yaml"),
        ("other.yaml", "got mine.yaml -> other.yaml -> mine.yaml"),
        ("wrong.yaml", "wrong.yaml: road.lane_with_m: unknown key; did you mean lane_width_m?"),
        ("list.yaml", "list.yaml: expected groups of parameters, got ['road']"),
        ("empty.yaml", "empty.yaml: expected groups of parameters, got None"),
        ("binary.yaml", "binary.yaml: cannot read: "),
        ("folder.yaml", "folder.yaml: expected a file, got a folder"),
        (
            "short.yaml",
            "mine.yaml: 12 missing keys: terrain, road, markings, ...; a file that changes a preset begins with",
        ),
    ],
)
def test_a_base_that_is_none_is_one_line(base: str, expected: str, in_tmp_path: Path) -> None:
    Path("mine.yaml").write_text(f"base: {base}\nlight: {{exposure: 2}}\n")
    Path("other.yaml").write_text("base: mine.yaml\n")
    Path("wrong.yaml").write_text("base: streets\nroad: {lane_with_m: 3}\n")
    Path("list.yaml").write_text("[road]\n")
    Path("short.yaml").write_text("{}\n")
    Path("empty.yaml").touch()
    Path("binary.yaml").write_bytes(b"\xff\xfe\x00\xd8")
    Path("folder.yaml").mkdir()
    with pytest.raises(InputError) as error:
        load_params("mine.yaml")
    (line,) = error.value.problems
    assert expected in line


def test_a_mistake_is_told_with_the_file_that_has_it(in_tmp_path: Path) -> None:
    Path("first.yaml").write_text("base: tiny\ncars: {n: -1, scale: 99}\nroads: {}\n")
    Path("second.yaml").write_text("base: first.yaml\ncars: {scale: 98, modle: 1}\nroad: 3\n")
    with pytest.raises(InputError) as error:
        load_params("second.yaml", ["light.exposure=-2", "light"])
    assert {line.partition(": expected")[0].partition(";")[0] for line in error.value.problems} == {
        "first.yaml: cars.n", "first.yaml: roads: unknown key", "second.yaml: cars.scale",
        "second.yaml: cars.modle: unknown key", "second.yaml: road", "overrides light.exposure",
        "overrides light",
    }  # fmt: skip


@pytest.mark.parametrize("changes", [(), ("road.lane_width_m=[3, 3.25]", "weather.headlights=false")])
@pytest.mark.parametrize("name", ["streets", "tiny"])
def test_what_is_shown_of_a_file_is_short_and_equal(name: str, changes: tuple[str, ...], in_tmp_path: Path) -> None:
    """Of a file with a base, and of today's complete files, which say the same."""
    Path("ours.yaml").write_text(OURS.replace("streets", name))
    Path("complete.yaml").write_text(params_yaml(load_params("ours.yaml"), "ours.yaml"))
    for source in ("ours.yaml", "complete.yaml"):
        params = load_params(source, changes)
        shown = changes_yaml(params, source)
        Path("shown.yaml").write_text(shown)
        assert load_params("shown.yaml") == params
        assert shown.startswith(f"# Narrow lanes.\nbase: {name}\n\nroad:")
        assert shown.count(": [3") == shown.count("# as in old towns") == 1
        assert len(shown.splitlines()) == 5 + 2 * ("kept" in shown)


def test_what_is_shown_of_a_preset_is_all_of_it_or_its_changes() -> None:
    assert changes_yaml(load_params("town"), "town") == params_yaml(load_params("town"), "town")
    changed = load_params("tiny", ["cars.n=3"])
    assert changes_yaml(changed, "tiny") == f'base: tiny\n\n{"cars:":<30}  # Table "Objects"\n  n: 3\n'


def test_check_names_the_problems_of_every_file() -> None:
    with pytest.raises(InputError) as error:
        check_params(["one.yaml", "tiny", "two.yaml"])
    assert [line.split(":")[0] for line in error.value.problems] == ["one.yaml", "two.yaml"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("road.n_lanes=3", Choice((3,), (1,))),
        ("camera.pitch_deg=[1, 2]", Uniform(1, 2)),
        ("cars.n={2: 1, 5: 3}", Choice((2, 5), (1, 3))),
        ("terrain.sd_m=1e2", Choice((100.0,), (1,))),
        ("road.flip_lateral=true", Choice((True,), (1,))),
        ("camera.pitch_deg=2 +- 0.5", Uniform(1.5, 2.5)),
        ("cars.n=5+-2", Integers(3, 7)),
        ("light.exposure=2 ± 1e-1", Uniform(1.9, 2.1)),
    ],
)
def test_an_override_takes_every_form(change: str, expected: Distribution) -> None:
    group, key = change.partition("=")[0].split(".")
    assert getattr(getattr(load_params("tiny", [change]), group), key) == expected


WHOLE_CARS = ("[1, 6]", "[1, 11]", "{1: 2, 2: 1, 3: 1, 4: 1, 5: 1, 6: 1, 7: 1, 8: 1, 9: 1, 10: 1, 11: 1}")


@pytest.mark.parametrize("form", WHOLE_CARS)
def test_all_built_in_models_mean_all_of_a_users(form: str) -> None:
    """Those of the paper's presets as well as all there are; the built-in ones themselves stay as they are written."""
    own = Assets(cars=(CARS[0], CARS[2], CARS[5]))
    overrides = [f"cars.model={form}"]
    assert load_params("appendix_i", overrides, own).cars.model == Integers(1, 3)
    written = {"[1, 6]": Integers(1, 6), "[1, 11]": Integers(1, 11)}
    ours = load_params("appendix_i", overrides).cars.model
    assert ours == written.get(form, ours)
    assert ours != Integers(1, 3)
    with pytest.raises(InputError, match=r"cars\.model: expected integers from 1 to 3"):
        load_params("appendix_i", ["cars.model=[1, 7]"], Assets(cars=CARS[:3]))


@pytest.mark.parametrize("name", preset_names())
def test_a_shown_preset_is_complete_equal_and_explained(name: str, tmp_path: Path) -> None:
    """Also where a value was changed, and when it is shown again."""
    overrides = ["light.exposure=2", "camera.pitch_deg=1 +- 0.5"]
    changed = load_params(name, overrides)
    path = tmp_path / "mine.yaml"
    path.write_text(params_yaml(changed, name))
    assert load_params(str(path)) == changed
    assert keys_left_out(str(path)) == []
    plain = load_params(name)
    assert plain.kept == (), "what a preset changes of its base is not kept from the weather"
    assert Params.model_validate_json(json.dumps(forms(plain))) == plain
    shown = params_yaml(changed, str(path))
    assert shown == path.read_text()
    lines = shown.splitlines()
    meaning = {line.split(":")[0].strip(): line.partition("#")[2] for line in lines if line.startswith("  ")}
    assert "number of Gaussians" in meaning["n_gaussians"]
    preset = (presets_folder() / f"{name}.yaml").read_text()
    assert shown.startswith(preset[: preset.index("\n\n")])
    assert len([line for line in lines if "#" in line]) > 90


def test_the_order_of_choices_stays() -> None:
    """Draws depend on it."""
    params = load_params("tiny", ["road.n_lanes={4: 1, 2: 3}", "road.flip_lateral={true: 1, false: 2}"])
    assert "  n_lanes: {4: 1, 2: 3} " in params_yaml(params)
    assert "  flip_lateral: {true: 1, false: 2} " in params_yaml(params)


def test_what_a_file_leaves_out_is_told(tmp_path: Path) -> None:
    from click.testing import CliRunner
    from synth3dlanes_cli.main import main

    path = tmp_path / "mine.yaml"
    text = params_yaml(load_params("streets"), "streets")
    start, end = text.index("\nhost:"), text.index("\nvegetation:")
    path.write_text((text[:start] + text[end:]).replace("  dots:", "  #dots:"))
    assert keys_left_out(str(path)) == ["markings.dots", "host.*"]
    told = CliRunner().invoke(main, ["params", "check", str(path), "streets"])
    assert (told.exit_code, told.stdout) == (
        0,
        f"{path}: ok; left out, so as they are by default: markings.dots, host.*\nstreets: ok\n",
    )


def test_a_spread_out_of_bounds_or_of_no_numbers_is_named() -> None:
    for change in ("camera.pitch_deg=59 +- 2", "cars.n=5 +- 0.5", "light.exposure=1..2 +- 1", "light.exposure=2 +- -1"):
        with pytest.raises(InputError, match="expected"):
            load_params("tiny", [change])


def test_what_is_named_is_changed_and_nothing_else(hilly_scene: Scene) -> None:
    """Degrees become radians; lists take indices, and can be emptied."""
    changes = ["light.exposure=3", "camera.pitch_deg=3", "cars.1.color=[1, 0, 0]", "trees=[]"]
    first, second, *others = hilly_scene.cars
    expected = {
        "light": hilly_scene.light.model_copy(update={"exposure": 3}),
        "camera": hilly_scene.camera.model_copy(update={"pitch_rad": math.radians(3)}),
        "cars": (first, second.model_copy(update={"color": (1, 0, 0)}), *others),
        "trees": (),
    }
    assert change_scene(hilly_scene, changes) == hilly_scene.model_copy(update=expected)
    assert change_scene(hilly_scene, []) == hilly_scene


# A value that differs, by what a scene was drawn by: alone it would say what is not so.
DRAWN_BY = {"split": "any", "index": "7", "weather.kind": "rain", "weather.daytime": "night", "weather": "{kind: fog}"}


@pytest.mark.parametrize("path", DRAWN_BY)
def test_a_value_from_which_others_follow_is_refused(path: str, hilly_scene: Scene) -> None:
    with pytest.raises(InputError, match=rf"changes {path}[\w.]*: the scene was drawn by it, and other values follow"):
        change_scene(hilly_scene, [f"{path}={DRAWN_BY[path]}"])


def test_a_scene_may_be_of_any_weather(hilly_scene: Scene) -> None:
    rainy = hilly_scene.model_copy(update={"weather": Weather(kind="rain", rain=0.5)})
    assert change_scene(rainy, ["weather.kind=any", "weather.rain=1"]).weather == Weather(rain=1)
    assert change_scene(rainy, ["weather.rain=1"]).weather.kind == "rain"


def test_a_speed_that_follows_from_a_track_is_refused() -> None:
    """Of the host, and of what walks beside it."""
    shot = Shot(n_frames=2, fps=1, speed_m_s=5.0, track=((0.0, 0.0), (1.0, 5.0)))
    places = [{"time_s": time_s, "x_m": 20.0, "y_m": time_s, "yaw_rad": 0.0} for time_s in (0.0, 1.0)]
    cone = {"kind": "cone", "model": 1, "x_m": 20.0, "y_m": 0.0, "yaw_rad": 0.0, "track": places}
    driving = map_scene(FOUR_WAY, 20.0, shot=shot, things=(cone,))
    for path in ("shot", "things.0"):
        with pytest.raises(InputError, match=rf"changes {path}\.speed_m_s: follows from {path}\.track"):
            change_scene(driving, [f"{path}.speed_m_s=9"])
    assert change_scene(driving, ["shot.speed_m_s=9", "shot.track=[[0, 0], [1, 9]]"]).shot.speed_m_s == 9


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("light.exposur=3", "changes light.exposur: unknown key exposur; did you mean exposure?"),
        ("lihgt.exposure=3", "changes lihgt.exposure: unknown key lihgt; did you mean light?"),
        ("cars.99.gloss=1", "changes cars.99.gloss: unknown key 99"),
        ("light.exposure", "changes light.exposure: expected path=value"),
        ("light.exposure=-1", "changes light.exposure: expected more than 0, got -1"),
        ("light.exposure=[1", "changes light.exposure: line 1: not YAML: "),
        ("camera.pitch_deg=flat", "changes camera.pitch_deg: expected degrees, got 'flat'"),
    ],
)
def test_a_mistake_is_one_line(change: str, expected: str, hilly_scene: Scene) -> None:
    with pytest.raises(InputError) as error:
        change_scene(hilly_scene, [change])
    assert str(error.value).startswith(expected)
    assert "\n" not in str(error.value)


def test_groups_that_no_scene_uses_are_told_from_those_that_some_do() -> None:
    weather = {"clear", "cloudy", "fog", "rain", "snow", "day", "dusk", "night"}
    town = {"town", "town_streets"}
    for preset, changes, idle in (
        ("appendix_i", [], {*weather, *town, "mountain", "works"}),
        ("streets", [], {*town, "mountain"}),
        ("town", [], {"mountain", "works"}),
        (
            "streets",
            ["weather.kind={fog: 1, any: 2}", "works.present=false"],
            {*(weather - {"fog", "day", "dusk", "night"}), *town, "mountain", "works"},
        ),
        ("mountain", ["town.junction={none: 1, t: 1}"], {*weather, "works"}),
    ):
        assert load_params(preset, changes).idle().keys() == idle
