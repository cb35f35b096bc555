"""Clips as animations and as pages with a slider."""

import io
import re

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.figures.gallery import draw_clip
from synth3dlanes.figures.page import MAX_FRAMES, scene_page
from synth3dlanes.figures.samples import ShownScene
from synth3dlanes.scene.host import Shot
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.world import resolve


def shown_in(scene, frame, n_frames=3):
    shot = Shot(frame=frame, n_frames=n_frames, fps=4, speed_m_s=20)
    return scene.model_copy(update={"shot": shot})


def labelled(scene):
    world = resolve(scene)
    return label(world, world.view)


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


def test_a_page_of_a_clip_has_each_frame_and_begins_with_its_own(flat_scene, gray_image):
    clip = [(labelled(shown_in(flat_scene, frame)), gray_image) for frame in range(3)]
    scene = shown_in(flat_scene, 1)
    page = scene_page(ShownScene(scene, clip[1][0], gray_image, clip=clip))
    words = re.findall(r'data-words="([^"]*)"', page)
    assert words == ["frame 0, 0.00 s", "frame 1, 0.25 s", "frame 2, 0.50 s"]
    assert re.search(r'max="2" value="1"', page)
    assert 'data-pause-ms="250"' in page
    assert "show frame 1, 0.25 s." in page
    assert 'id="frames"' not in scene_page(ShownScene(flat_scene, clip[0][0], gray_image))


def test_a_page_of_a_long_clip_has_some_of_its_frames(flat_scene, gray_image):
    n_frames = 2 * MAX_FRAMES + 1
    labels = labelled(shown_in(flat_scene, 0, n_frames))
    page = scene_page(
        ShownScene(shown_in(flat_scene, 100, n_frames), labels, gray_image, clip=[(labels, gray_image)] * n_frames)
    )
    words = [int(number) for number in re.findall(r'data-words="frame (\d+),', page)]
    assert words == list(range(0, n_frames, 3))
    assert re.search(r'value="33"', page)
