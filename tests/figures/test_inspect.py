"""The inspect figure and summary say what the scene is."""

import io

import numpy as np
import pytest
from rich.console import Console

from synth3dlanes.figures.inspect import draw_inspect, summary
from synth3dlanes.figures.passes import pass_picture
from synth3dlanes.figures.samples import ShownScene
from synth3dlanes.figures.scene_view import SceneView
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import ground_truth


def text_of(renderable: object) -> str:
    console = Console(file=io.StringIO(), width=80)
    console.print(renderable)
    return console.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.parametrize("with_image", [False, True])
def test_four_views_with_their_units(with_image, gray_image, exit_scene):
    scene = exit_scene
    figure = draw_inspect(ShownScene(scene, ground_truth(scene), gray_image if with_image else None))
    assert len(figure.axes) == 4
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
    text = text_of(summary(ShownScene(scene, ground_truth(scene))))
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
    car = SceneView(scene, ground_truth(scene)).objects[0]
    assert np.allclose(car.corners_road.mean(axis=0), [-3.5, 30.0, 0.0], atol=1e-6)
    assert np.allclose(np.ptp(car.corners_road, axis=0), [1.83, 4.75, 0.0], atol=1e-6)


def test_roads_reach_from_shoulder_to_shoulder(flat_scene):
    scene = flat_scene
    left, right = SceneView(scene, ground_truth(scene)).roads["main"]
    half_m = 1.5 * 3.5 + 0.4 * 3.5
    assert np.allclose(left[:, 0], -half_m)
    assert np.allclose(right[:, 0], half_m)


def test_the_legend_explains_every_kind_of_line_and_shape(exit_scene):
    figure = draw_inspect(ShownScene(exit_scene, ground_truth(exit_scene), None))
    words = " ".join(text.get_text() for text in figure.legends[0].get_texts())
    for kind in ("centre line", "solid", "dashed", "pale", "dotted", "field of view", "camera"):
        assert kind in words


def test_passes_are_shown_with_their_scales(exit_scene, gray_image):
    shape = gray_image.shape[:2]
    passes = {
        "depth": np.full(shape, 20, np.float32),
        "normal": np.zeros((*shape, 3), np.float32),
        "semantic": np.full(shape, SEMANTIC_IDS["road"], np.uint8),
    }
    figure = draw_inspect(ShownScene(exit_scene, ground_truth(exit_scene), gray_image, passes))
    named = {axes.get_title(): axes for axes in figure.axes}
    assert set(passes) <= set(named)
    assert "depth y_cam [m]" in {axes.get_ylabel() for axes in figure.axes}
    assert [text.get_text() for text in named["semantic"].get_legend().get_texts()] == ["road"]


def test_colours_of_passes_tell_what_they_should():
    depth = pass_picture("depth", np.array([[3.0, 30.0, 300.0, np.inf]], np.float32)).astype(int)
    assert (np.diff(depth[0, :3].sum(axis=-1)) < 0).all(), "darker with distance"
    assert np.ptp(depth[0, 3]) < 20, "gray sky"
    up, right, sky = pass_picture("normal", np.array([[[0, 0, 1], [1, 0, 0], [0, 0, 0]]], np.float32))[0].astype(int)
    assert up.argmax() == 2
    assert right.argmax() == 0
    assert np.ptp(sky) < 20
    ids = pass_picture("instance", np.array([[0, 1, 2, 200, 300, 301]], np.uint16))[0].astype(int)
    far = np.abs(ids[:, None] - ids).sum(axis=-1) + 999 * np.eye(6, dtype=int)
    assert far.min() > 60
    classes = pass_picture("semantic", np.array([list(SEMANTIC_IDS.values())], np.uint8))[0]
    assert len({tuple(color) for color in classes.tolist()}) == len(SEMANTIC_IDS)
    low, high = pass_picture("height", np.array([[-4.0, 4.0]], np.float32))[0].astype(int)
    assert low.argmax() == 2
    assert high.argmax() == 0
