"""Scenes near given ones: as near as their spread says, by the sampler's rules, recorded and drawn again."""

import dataclasses
import json
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.draw.like import near, read_like
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.given_scenes import drawn, given_scenes
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.production.twins import twin_recipes
from synth3dlanes.scene.assets.catalogue import BUILT_IN
from synth3dlanes.scene.scene import to_json
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from synth3dlanes.validate.origin import read_origin
from tests import fake_samples

PARAMS = load_params("appendix_i")
GIVEN = tuple((0, "test", index) for index in (3, 8, 11))


def like(index, *spreads):
    return sample_scene(Scenes(PARAMS, 7, "hard", like=read_like(GIVEN, spreads)), index)


@cache
def original(number):
    seed, split, index = GIVEN[number]
    return sample_scene(Scenes(PARAMS, seed, split), index)


@given(st.floats(0, 1, exclude_max=True), st.floats(0, 1), st.floats(0, 1, exclude_max=True))
def test_numbers_stay_in_a_window_around_the_given_one(u, spread, moved):
    found = near(u, spread, moved)
    assert 0 <= found <= 1
    assert abs(found - u) <= spread + 1e-12
    if spread / 2 < u < 1 - spread / 2:
        assert abs(found - u) <= spread / 2 + 1e-12


@pytest.mark.parametrize("index", range(5))
def test_without_spread_the_given_scenes_come_back_one_after_the_other(index):
    fields = {"seed": 7, "split": "hard", "index": index}
    assert like(index, "0") == original(index % 3).model_copy(update=fields)


def test_real_parameters_are_within_half_their_spread_and_all_others_as_given():
    def share(path, one, other):
        group, key = path.split(".")
        distribution = getattr(getattr(PARAMS, group), key)
        low, high = distribution.low, distribution.high
        if key.endswith("_deg"):
            low, high, key = *np.radians([low, high]), key.replace("_deg", "_rad")
        return (getattr(getattr(other, group), key) - getattr(getattr(one, group), key)) / (high - low)

    pitches, widths = [], []
    for index in range(15):
        one, other = original(index % 3), like(index, "0.1", "camera.pitch_deg=0.4")
        assert (other.road.topology, other.road.n_lanes) == (one.road.topology, one.road.n_lanes)
        for flip in ("flip_lateral", "flip_longitudinal"):
            assert getattr(other.road, flip) == getattr(one.road, flip)
        assert [car.model for car in other.cars] == [car.model for car in one.cars]
        assert len(other.trees) == len(one.trees)
        assert len(other.terrain.gaussians) == len(one.terrain.gaussians)
        pitches.append(share("camera.pitch_deg", one, other))
        widths.append(share("road.lane_width_m", one, other))
    # At the end of a range the window ends with it, and reaches as far on the other side.
    assert 0.03 < np.abs(widths).max() <= 0.1 + 1e-6
    assert 0.1 < np.abs(pitches).max() <= 0.4 + 1e-6
    assert len(set(widths)) == 15


def test_dataset_json_says_all_that_validate_needs_to_draw_them_again():
    recipe = Recipe(
        Scenes(PARAMS, 7, "hard", like=read_like(GIVEN, ["0.2", "road.lane_width_m=0"])), RenderSettings(), "jpg"
    )
    origin = read_origin(json.loads(json.dumps(recipe.description())))
    assert all(origin.fault(recipe.scene(index), "hard", index) == "" for index in range(4))
    assert "like" not in Recipe(Scenes(PARAMS, 7, "hard"), RenderSettings(), "jpg").description()
    changed = json.loads(json.dumps(recipe.description()))
    changed["like"]["spread"] = 0.3
    assert read_origin(changed).fault(recipe.scene(0), "hard", 0)


def test_files_name_scenes_by_their_text(tmp_path):
    path = tmp_path / "hard.jsonl"
    path.write_text("".join(f"{to_json(original(number))}\n" for number in range(3)))
    assert given_scenes(path, PARAMS, BUILT_IN.assets) == GIVEN
    with pytest.raises(InputError, match=r"hard\.jsonl: expected scenes as these parameters draw them"):
        given_scenes(path, load_params("appendix_i", ["camera.pitch_deg=3", "road.lane_width_m=3"]), BUILT_IN.assets)
    path.write_text("\n")
    with pytest.raises(InputError, match="expected 1 to 10000 scenes, got 0"):
        given_scenes(path, PARAMS, BUILT_IN.assets)


FEW = ["cars.n=2", "trees.n=2", "roadside.delineators=true", "roadside.outer=none"]
FEW += [f"roadside.n_{name}=0" for name in ("houses", "halls", "blocks")]

# A parameter of each group that a scene of single pictures uses, otherwise than in `streets`, and the part that tells.
OTHER = {
    "terrain.magnitude_m=1": "terrain", "road.lane_width_m=3": "road", "markings.wear=1": "markings",
    "surface.tar=1": "surface", "cars.gloss=0": "cars", "trees.scale=0.5": "trees", "camera.pitch_deg=9": "camera",
    "camera.offset_m=1": "camera", "light.exposure=9": "light", "air.overcast=0.33": "air",
    "sensor.dirt=1": "sensor", "symbols.crosswalks=9": "symbols", "weather.snow=1": "weather",
    "host.bonnet=0.3": "host", "vegetation.translucency=0": "vegetation",
    "roadside.delineator_spacing_m=11": "roadside",
}  # fmt: skip


@pytest.mark.parametrize("other", OTHER)
def test_scenes_of_other_parameters_are_refused_whatever_differs(other):
    scene = sample_scene(Scenes(load_params("streets", FEW), 1), 0)
    expected = rf"expected scenes as these parameters draw them, got other .*\b{OTHER[other]}\b"
    with pytest.raises(InputError, match=expected):
        drawn([scene], load_params("streets", [*FEW, other]), BUILT_IN.assets, "like")


def test_a_camera_of_ones_own_has_the_place_of_the_parameters():
    shots = Shots(frames=4, cameras=load_rig("nuscenes"), lidar=load_lidar("vlp_32c"))
    params = load_params("appendix_i", ["cars.n=2", "trees.n=2"])
    scene = sample_scene(Scenes(params, 3, "hard", shots=shots), 6 * 4 * 2 + 6 * 1 + 2)
    assert drawn([scene], params, BUILT_IN.assets, "like", own_camera=True) == ((3, "hard", 2),)
    with pytest.raises(InputError, match=r"got other camera in scene 2 of hard"):
        drawn([scene], params, BUILT_IN.assets, "like")
    elsewhere = load_params("appendix_i", ["cars.n=2", "trees.n=2", "camera.offset_m=0.3"])
    with pytest.raises(InputError, match=r"got other .*camera in scene 2 of hard"):
        drawn([scene], elsewhere, BUILT_IN.assets, "like", own_camera=True)
    slower = load_params("appendix_i", ["cars.n=2", "trees.n=2", "motion.host_speed_m_s=9"])
    with pytest.raises(InputError, match=r"got other .*shot in scene 2 of hard"):
        drawn([scene], slower, BUILT_IN.assets, "like", own_camera=True)


@pytest.mark.parametrize("spread", ["2", "x", "camera.pitch=0.1", "camera.pitch_deg=-1", "lanes=0.1"])
def test_spreads_that_are_none_are_refused(spread):
    with pytest.raises(InputError, match="spread"):
        read_like(GIVEN, [spread])


def test_twins_and_splits_of_such_data_know_what_they_are_near(tmp_path):
    recipe = fake_samples.recipe()
    recipe = dataclasses.replace(recipe, scenes=dataclasses.replace(recipe.scenes, like=read_like(GIVEN, ["0.2"])))
    generate(Plan(tmp_path / "d", 1, recipe, workers=1, maker=fake_samples.make), lambda event: None)
    (twin,) = twin_recipes(f"{tmp_path}/d/train", "light.exposure=2", "cpu")
    assert twin.description()["like"] == recipe.description()["like"]
    recipe = Recipe(Scenes(PARAMS, 7, "hard", like=read_like(GIVEN, ["0.2"])), RenderSettings(), "jpg")
    cut = read_origin({**json.loads(json.dumps(recipe.description())), "derived": {"cut": "DIR/hard"}})
    assert all(cut.fault(recipe.scene(index), "part", 90 + index) == "" for index in range(4))
