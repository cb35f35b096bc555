"""The inspect figure and summary say what the scene is."""

import io

import numpy as np
import pytest
from rich.console import Console

from synth3dlanes.figures.inspect import draw_inspect, summary
from synth3dlanes.figures.scene_view import SceneView
from synth3dlanes.ground_truth import ground_truth


def text_of(renderable: object) -> str:
    console = Console(file=io.StringIO(), width=80)
    console.print(renderable)
    return console.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.parametrize("with_image", [False, True])
def test_four_views_with_their_units(with_image, gray_image, exit_scene):
    scene = exit_scene
    figure = draw_inspect(scene, ground_truth(scene), gray_image if with_image else None)
    units = [{axes.get_xlabel(), axes.get_ylabel()} for axes in figure.axes]
    assert units == [
        {"u [px]", "v [px]"},
        {"x right [m]", "y forward [m]"},
        {"x right [m]", "y forward [m]"},
        {"y forward [m]", "z up [m]"},
    ]
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=40)
    assert buffer.getvalue().startswith(b"\x89PNG")


def test_the_summary_names_what_a_reader_looks_for_on_80_columns(exit_scene):
    scene = exit_scene
    text = text_of(summary(scene, ground_truth(scene)))
    for words in (
        "merge from the left",
        "two-lane exit",
        "1 sedan, 1 truck",
        "1.600 m",
        "2.86°",
        "main_line_0",
        "exit_1",
    ):
        assert words in text
    assert "…" not in text


def test_cars_stand_at_their_size_where_the_scene_puts_them(flat_scene):
    """The host is at y = -50 in lane 2 of 3: the sedan is 30 m ahead and one lane to the left."""
    scene = flat_scene
    car = SceneView(scene, ground_truth(scene)).cars[0]
    assert np.allclose(car.corners_road.mean(axis=0), [-3.5, 30.0, 0.0], atol=1e-6)
    assert np.allclose(np.ptp(car.corners_road, axis=0), [1.83, 4.75, 0.0], atol=1e-6)


def test_roads_reach_from_shoulder_to_shoulder(flat_scene):
    scene = flat_scene
    left, right = SceneView(scene, ground_truth(scene)).roads["main"]
    half_m = 1.5 * 3.5 + 0.4 * 3.5
    assert np.allclose(left[:, 0], -half_m)
    assert np.allclose(right[:, 0], half_m)
