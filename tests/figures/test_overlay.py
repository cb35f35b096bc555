"""Lines, boxes, contact sheets, animations and the inspect figure show what the camera sees, where it sees it."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.figures.colors import ELEMENT, KINDS, OBJECT
from synth3dlanes.figures.gallery import draw_clip, draw_gallery
from synth3dlanes.figures.inspect import draw_inspect
from synth3dlanes.figures.overlay import draw_overlay, lines_img, objects_in_image, stretches_img
from synth3dlanes.figures.page import MAX_FRAMES, scene_page
from synth3dlanes.figures.passes import pass_picture
from synth3dlanes.figures.samples import ShownSample, ShownScene
from synth3dlanes.figures.scene_view import SceneView
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.truth.ground_truth import ground_truth
from tests.scenes import FLAT, changed
from tests.signals import signals_scene


@pytest.fixture
def straight_labels() -> Labels:
    """A flat road: a centre line straight ahead, and a delimiter half a lane to its right."""
    labels = ground_truth(FLAT)
    lanes = {lane.id: lane for lane in labels.lanes}
    return replace(labels, lanes=(lanes["main_2"], lanes["main_line_2"]), objects=())


@pytest.mark.parametrize("row", [210, 260, 330])
@pytest.mark.parametrize(("number", "x_m"), [(0, 0.0), (1, 1.75)])
def test_a_line_ahead_or_beside_it_is_drawn_where_the_pinhole_puts_it(number, x_m, row, straight_labels, gray_image):
    """On a flat road, a pixel row v lies at one distance; solve the pinhole for it."""
    line = straight_labels.lanes[number]
    drawn = draw_overlay(gray_image, replace(straight_labels, lanes=(line,)))[row] - 120.0
    color = np.array(KINDS[line.kind]) - 120.0
    weight = np.clip(drawn @ color / (color @ color), 0, 1)
    below_horizon_rad = np.arctan((row + 0.5 - 180) / 415.7) + 0.05
    depth_m = 1.6 / np.sin(below_horizon_rad) * np.cos(below_horizon_rad - 0.05)
    middle = (weight * (np.arange(len(weight)) + 0.5)).sum() / weight.sum()
    assert middle == pytest.approx(240 + 415.7 * x_m / depth_m, abs=0.25)


def test_hidden_points_are_dotted_and_seen_ones_solid(straight_labels, gray_image):
    lane = straight_labels.lanes[0]
    # Seen up to 7 m, so that the hidden stretch is long in the image.
    half = replace(lane, terrain_visible=lane.xyz_cam[:, 1] < 7.5)
    stretches = list(stretches_img(straight_labels.camera, half))
    assert [is_seen for is_seen, _ in stretches] == [True, False]
    assert np.allclose(stretches[0][1][-1], stretches[1][1][0])
    drawn = draw_overlay(gray_image, replace(straight_labels, lanes=(half,)))
    is_line = (drawn != gray_image).any(axis=(1, 2))
    horizon, border, foot = 159, round(180 + 415.7 * (1.6 / 7 - 0.05)), 300
    assert is_line[border + 4 : foot].all(), "solid up to the border"
    beyond = is_line[horizon + 15 : border - 4]
    assert beyond.any()
    assert not beyond.all(), "dots with gaps beyond it"


def test_points_behind_the_camera_are_never_drawn(straight_labels, gray_image):
    lanes = tuple(replace(lane, xyz_cam=lane.xyz_cam * [1, -1, 1]) for lane in straight_labels.lanes)
    assert (draw_overlay(gray_image, replace(straight_labels, lanes=lanes)) == gray_image).all()


def test_lines_connect_the_projected_corners(flat_scene):
    labels = ground_truth(flat_scene)
    ((item, lines), _) = objects_in_image(labels)
    corners = labels.camera.project(item.corners_cam)
    ends = np.concatenate([line[[0, -1]] for line in lines[:12]])
    for corner in corners:
        assert (np.abs(ends - corner).max(axis=1) < 1e-6).sum() == 3
    middle, front = labels.camera.project(item.corners_cam[[[2, 3, 6, 7], [2, 3, 2, 3]]].mean(axis=1))
    np.testing.assert_allclose(lines[12], [middle, front], atol=2)


def test_a_box_beside_the_camera_is_drawn_as_far_as_it_is_ahead(flat_scene):
    long = flat_scene.cars[0].model_copy(update={"model": 10, "s_m": -47.0})
    labels = ground_truth(flat_scene.model_copy(update={"cars": (long,)}))
    lines = list(lines_img(labels.camera, labels.objects[0]))
    assert 5 <= len(lines) < 13
    assert all(np.isfinite(line).all() for line in lines)


def test_a_lens_bends_the_lines(flat_scene):
    camera = {"lens": Lens(model="fisheye", coefficients=(0.02, 0, 0, 0)), "fx_px": 90, "fy_px": 90}
    labels = ground_truth(changed(flat_scene, camera=camera))
    assert all(len(line) > 2 for _, lines in objects_in_image(labels) for line in lines)


def test_the_overlay_shows_seen_objects_and_no_hidden_ones(flat_scene, gray_image):
    labels = ground_truth(flat_scene)
    empty = draw_overlay(gray_image, replace(labels, objects=(), lanes=()))
    drawn = draw_overlay(gray_image, replace(labels, lanes=()))
    changed_px = (drawn != empty).any(axis=2)
    left, top, right, bottom = labels.objects[0].box_px.astype(int)
    assert changed_px[top : bottom + 1, left : right + 1].sum() > 50
    assert (np.abs(drawn.astype(int) - OBJECT).max(axis=2) < 60).sum() > 20
    hidden = draw_overlay(gray_image, replace(labels, lanes=()).with_seen_shares((0.0, 0.0)))
    assert (hidden == empty).all()


def test_faces_of_traffic_elements_are_drawn_where_their_corners_are_but_for_hidden_ones():
    labels = replace(ground_truth(signals_scene()), lanes=())
    drawn = [found for found in objects_in_image(labels) if found[0].is_element]
    assert len(drawn) == 9
    for item, lines in drawn:
        corners = labels.camera.project(item.corners_cam[4:])
        ends = np.concatenate([line[[0, -1]] for line in lines])
        for corner in corners:
            assert (np.abs(ends - corner).max(axis=1) < 1e-6).sum() == 2
    gray = np.full((labels.camera.height_px, labels.camera.width_px, 3), 90, np.uint8)
    overlay = draw_overlay(gray, labels)
    assert (np.abs(overlay.astype(int) - ELEMENT).max(axis=2) < 60).sum() > 20
    hidden = tuple(replace(item, visible_fraction=0.0) for item in labels.traffic_elements)
    assert (draw_overlay(gray, replace(labels, traffic_elements=hidden)) == gray).all()


def test_every_image_has_its_cell_in_reading_order():
    images = [np.full((36, 48, 3), 10 * i, dtype=np.uint8) for i in range(5)]
    sheet = np.asarray(draw_gallery([ShownSample("", image) for image in images], 3))
    assert sheet.shape == (2 * (18 + 36) + 3 * 4, 3 * 48 + 4 * 4, 3)
    assert [int(sheet[22 + 18 + 58 * (i // 3), 4 + 24 + 52 * (i % 3), 0]) for i in range(5)] == [0, 10, 20, 30, 40]
    assert (sheet[-10, -10] == 255).all()


@pytest.mark.parametrize("width_px", [None, 300])
def test_each_cell_carries_its_own_key_above_its_picture_at_a_size_that_can_be_read(gray_image, width_px):
    """The keys are drawn after the images are shrunk: each cell begins with the same picture of its key."""
    names = ["00000007", "00000017", "00000007" + 100 * "x"]
    sheet = np.asarray(draw_gallery([ShownSample(name, gray_image) for name in names], 3, width_px))
    assert sheet.shape[1] <= (width_px or sheet.shape[1])
    pitch = (sheet.shape[1] - 4) // 3
    first, second, third = (sheet[4:22, 4 + i * pitch : 4 + i * pitch + 56] for i in range(3))
    np.testing.assert_array_equal(first, third)
    assert (first != second).any()
    assert (first < 110).all(axis=-1).sum() > 40, "dark strokes of a font of a fixed size"
    assert (sheet[22:-4, 4 : pitch - 1] == 120).all(), "nothing covers a picture"
    assert (sheet[:, -4:] == 255).all(), "a long key ends with its cell"


@pytest.mark.parametrize("fps", [10.0, 12.0, 7.0])
@pytest.mark.parametrize("kind", ["webp", "gif", "png"])
def test_an_animation_has_all_frames_in_order_and_lasts_as_long_as_the_clip(fps, kind):
    frames = [np.full((48, 64, 3), 20 * i, dtype=np.uint8) for i in range(9)]
    animation = Image.open(io.BytesIO(draw_clip(frames, fps, 32, kind)))
    assert (animation.format, animation.size, animation.n_frames) == (kind.upper(), (32, 24), 9)
    assert animation.info["loop"] == 0
    lasts_ms, grays = 0, []
    for number in range(animation.n_frames):
        animation.seek(number)
        animation.load()
        lasts_ms += animation.info["duration"]
        grays.append(int(np.asarray(animation.convert("L")).mean()))
    assert lasts_ms == pytest.approx(9000 / fps, abs=5 if kind == "gif" else 0.5)
    assert grays == pytest.approx(range(0, 180, 20), abs=3)


@pytest.mark.parametrize("is_rendered", [False, True])
def test_views_and_passes_with_their_units(is_rendered, gray_image, exit_scene):
    shape = gray_image.shape[:2]
    passes = {
        "depth": np.full(shape, 20, np.float32),
        "normal": np.zeros((*shape, 3), np.float32),
        "semantic": np.full(shape, SEMANTIC_IDS["road"], np.uint8),
    }
    given = (gray_image, passes) if is_rendered else (None,)
    figure = draw_inspect(ShownScene(exit_scene, ground_truth(exit_scene), *given))
    units = [{axes.get_xlabel(), axes.get_ylabel()} for axes in figure.axes]
    views = ({"x right [m]", "y forward [m]"}, {"y forward [m]", "z up [m]"}, {"u [px]", "v [px]"})
    assert [units.count(view) for view in views] == [2, 1, 4 if is_rendered else 1]
    named = {axes.get_title(): axes for axes in figure.axes}
    assert (set(passes) <= set(named)) == is_rendered
    if is_rendered:
        assert "depth y_cam [m]" in {axes.get_ylabel() for axes in figure.axes}
        assert [text.get_text() for text in named["semantic"].get_legend().get_texts()] == ["road"]
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=40)
    assert buffer.getvalue().startswith(b"\x89PNG")


def test_cars_stand_at_their_size_where_the_scene_puts_them(flat_scene):
    """The host is at y = -50 in lane 2 of 3: the sedan is 30 m ahead and one lane to the left."""
    scene = flat_scene
    car = SceneView(scene, ground_truth(scene)).objects[0]
    assert np.allclose(car.corners_road.mean(axis=0), [-3.5, 30.0, 0.0], atol=1e-6)
    assert np.allclose(np.ptp(car.corners_road, axis=0), [1.83, 4.75, 0.0], atol=1e-6)


def test_roads_reach_from_shoulder_to_shoulder(flat_scene):
    scene = flat_scene
    ((left, right),) = SceneView(scene, ground_truth(scene)).roads
    half_m = 1.5 * 3.5 + 0.4 * 3.5
    assert np.allclose(left[:, 0], -half_m)
    assert np.allclose(right[:, 0], half_m)


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


def test_a_page_of_a_long_clip_has_some_of_its_frames(flat_scene, gray_image):
    n_frames = 2 * MAX_FRAMES + 1
    shot = Shot(frame=100, n_frames=n_frames, fps=4, speed_m_s=20)
    labels = ground_truth(flat_scene)
    clip = [(labels, gray_image)] * n_frames
    page = scene_page(ShownScene(flat_scene.model_copy(update={"shot": shot}), labels, gray_image, clip=clip))
    words = [int(number) for number in re.findall(r'data-words="frame (\d+),', page)]
    assert words == list(range(0, n_frames, 3))
    assert re.search(r'value="33"', page)
