"""Textures are read from uncompressed copies where workers share a folder, and look the same."""

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.blender.quick_copy import quick_copy
from synth3dlanes.scene.settings import SCRATCH


@pytest.fixture
def jpeg(tmp_path, rng):
    path = tmp_path / "stone.jpg"
    Image.fromarray(rng.integers(0, 255, (32, 48, 3), dtype=np.uint8)).save(path)
    return path


def test_a_copy_holds_the_very_pixels_and_is_made_once(jpeg, tmp_path, monkeypatch):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setenv(SCRATCH, str(scratch))
    copy = quick_copy(jpeg)
    assert copy.parent == scratch
    assert np.array_equal(np.asarray(Image.open(copy)), np.asarray(Image.open(jpeg)))
    made_at = copy.stat().st_mtime_ns
    assert quick_copy(jpeg) == copy
    assert copy.stat().st_mtime_ns == made_at
    assert list(scratch.iterdir()) == [copy]


def test_without_a_folder_or_room_the_file_itself_serves(jpeg, tmp_path, monkeypatch):
    monkeypatch.delenv(SCRATCH, raising=False)
    assert quick_copy(jpeg) == jpeg
    monkeypatch.setenv(SCRATCH, str(tmp_path / "gone"))
    assert quick_copy(jpeg) == jpeg
