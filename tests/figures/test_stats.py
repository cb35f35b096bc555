"""Statistics find what is wrong and pass what is right."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from synth3dlanes.draw.draws import draws_of
from synth3dlanes.draw.paper import draw_road
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.figures.stats import Statistics, declared_shares, is_fine, label_statistics, scene_statistics
from synth3dlanes.figures.stats_views import statistics_table
from synth3dlanes.params.distributions import Choice, Integers, Uniform
from synth3dlanes.params.groups import DAYTIMES, KINDS
from synth3dlanes.params.params import forms, load_params, preset_names
from synth3dlanes.truth.ground_truth import ground_truth

# Groups of roads that are not the paper's.
ROADS = ("town", "town_streets", "mountain")


@pytest.fixture(scope="module")
def scenes():
    params = load_params("appendix_i", ["trees.n=5", "cars.n=3"])
    return params, [sample_scene(Scenes(params, 5, "train"), index) for index in range(150)]


def test_drawn_scenes_agree_with_what_was_declared(scenes):
    params, drawn = scenes
    statistics = scene_statistics(drawn, params)
    assert statistics.n_scenes == sum(statistics.topologies.values()) == 150
    texts = {
        f"{name}.{key}" for name, keys in forms(params).items() for key, value in keys.items() if isinstance(value, str)
    }
    assert {"weather.kind", "weather.daytime"} <= texts
    assert {row.key for row in statistics.parameters} == {
        f"{name}.{key}"
        for name, group in params.groups.items()
        if name
        not in ("symbols", "roadside", "structures", "motion", "people", "riders", "works", *ROADS, *KINDS, *DAYTIMES)
        for key in type(group).model_fields
    } - texts
    assert [row.key for row in statistics.parameters if not is_fine(row)] == []
    assert [row.key for row in statistics.parameters if row.count == 0] == ["cars.parked"], "nobody parks by default"


def test_the_routes_of_cars_in_clips_are_no_numbers(scenes):
    params, (first, *_) = scenes
    cars = tuple(car.model_copy(update={"route": ("s0.0.1",)}) for car in first.cars)
    statistics = scene_statistics([first.model_copy(update={"cars": cars})], params)
    assert statistics.parameters == scene_statistics([first], params).parameters


@pytest.mark.parametrize("declared", ["road.lane_width_m=[3.2, 3.5]", "camera.height_m=[1.0, 3.0]", "road.n_lanes=3"])
def test_another_declaration_is_found_out(scenes, declared):
    statistics = scene_statistics(scenes[1], load_params("appendix_i", [declared]))
    rows = {row.key: row for row in statistics.parameters}
    assert not is_fine(rows[declared.split("=")[0]])


FEW = {
    "streets": ["trees.n=0", "roadside.n_signs=0", "roadside.n_houses=0", "roadside.n_halls=0", "roadside.n_blocks=0"]
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", [name for name in preset_names() if name != "appendix_i"])
def test_every_preset_draws_what_it_declares(name):
    params = load_params(name, FEW.get(name, ["trees.n=0"]))
    statistics = scene_statistics([sample_scene(Scenes(params, 11, "train"), index) for index in range(60)], params)
    assert [row for row in statistics.parameters if not is_fine(row)] == []
    varied = {row.key for row in statistics.parameters if row.p_value is not None}
    of_road = {"road.n_lanes", "road.median_m", "road.n_oncoming", "camera.lane"}
    of_town = {"town.lane_width_m", "town.bend_deg", "town.corner_m", "town.angle_deg"}
    of = set() if name == "mountain" else of_town if params.is_town else of_road
    assert {"air.visibility_m", *of} <= varied


@pytest.mark.thorough
def test_three_per_cent_of_the_roads_with_other_lanes_are_found():
    """Topology and bends change lanes and medians: the rest must be as declared."""
    params = load_params("streets", ["cars.n=0", *FEW["streets"]])
    scene = sample_scene(Scenes(params), 0)
    bare = scene.model_copy(update={"camera": scene.camera.model_copy(update={"lane": 1}), "cars": ()})
    drawn = (draw_road(draws_of(params, "road", (2, "train", index), None)) for index in range(6000))
    scenes = [bare.model_copy(update={"road": road}) for road in drawn]
    fine = {row.key: is_fine(row) for row in scene_statistics(scenes, params).parameters}
    assert [fine[f"road.{key}"] for key in ("n_lanes", "n_oncoming", "median_m")] == [True] * 3
    moved = load_params("streets", ["road.n_lanes={1: 2, 2: 4.33, 3: 2.67, 4: 2}"])
    assert not {row.key: is_fine(row) for row in scene_statistics(scenes, moved).parameters}["road.n_lanes"]


def test_labels_of_a_climb_show_its_grade(exit_scene):
    labels = ground_truth(exit_scene)
    grade = label_statistics([labels]).summaries[0]
    assert grade.name == "grade [%]"
    steepest = -np.inf
    for lane in labels.lanes:
        if lane.kind == "centerline":
            x, y, z = (lane.xyz_cam @ labels.camera.world_from_cam[:3, :3].T).T
            steepest = max(steepest, (np.diff(z) / np.hypot(np.diff(x), np.diff(y))).max())
    assert 100 * steepest > 2
    assert grade.maximum == pytest.approx(100 * steepest, abs=1), "over a baseline of metres"


def test_text_json_and_plots(scenes):
    statistics = scene_statistics(scenes[1], scenes[0])
    labels = label_statistics(ground_truth(scene) for scene in scenes[1][:5])
    document = json.loads(json.dumps(Statistics(statistics, labels).document(), allow_nan=False))
    assert document["n_scenes"] == 150
    assert len(document["labels"]) == len(labels.summaries)
    console = Console(file=io.StringIO(), width=200)
    console.print(statistics_table(statistics, labels))
    table = console.file.getvalue()
    assert "150 scenes" in table
    assert "labels of 5 images" in table
    assert all(f"{row.key} " in table for row in statistics.parameters)
    assert all(f"{row.name} " in table for row in labels.summaries)


def test_colours_as_sold_are_not_held_against_color_and_saturation():
    params = load_params("appendix_i", ["cars.palette=sold", "cars.saturation=0.5"])
    drawn = scene_statistics([sample_scene(Scenes(params), index) for index in range(20)], params)
    rows = {row.key: row for row in drawn.parameters}
    assert rows["cars.color"].test == rows["cars.saturation"].test == "none drawn"
    assert all(is_fine(row) for row in drawn.parameters)
    assert "cars.palette" not in rows


@pytest.mark.parametrize(
    ("declared", "edges", "shares"),
    [
        (Uniform(1.0, 3.0), [0.0, 1.0, 1.5, 3.0, 4.0], [0.0, 0.25, 0.75, 0.0]),
        (Integers(2, 4), [0.5, 1.5, 2.5, 3.5, 4.5], [0, 1 / 3, 1 / 3, 1 / 3]),
        (Choice((True, False), (3.0, 1.0)), [-0.5, 0.5, 1.5], [0.25, 0.75]),
        (Choice((2.5,), (1.0,)), [2.0, 2.4, 3.0], [0.0, 1.0]),
    ],
)
def test_the_declared_line_is_the_probability_of_each_bin(declared, edges, shares):
    assert declared_shares(declared, np.array(edges)) == pytest.approx(shares)
