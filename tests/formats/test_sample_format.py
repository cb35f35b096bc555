"""Formats that take samples as they are: what reaches their writers, what happens to images, what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.formats.export import Export
from synth3dlanes.formats.format import SampleFormat, open_format
from synth3dlanes.formats.plan import open_reader
from synth3dlanes.formats.writing import FrameAnnotation
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.params.shots import clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import ground_truth
from tests import fake_samples
from tests.formats.drives import frame_of
from tests.scenes import FLAT


def unused(*arguments):
    raise AssertionError("nothing is read here")


def run(monkeypatch, dataset, out, annotate, **changes):
    foreign = SampleFormat(
        title="As it is", readme="As it is.", write=annotate, read=unused, verify=unused, tolerances={}, **changes
    )
    monkeypatch.setattr("synth3dlanes.formats.export.open_format", lambda name: foreign)
    return Export(str(dataset), out, "as_it_is").write()


def test_images_are_copied_byte_for_byte_or_encoded_anew_where_the_path_says_so(monkeypatch, dataset, tmp_path):
    def annotate(frame):
        suffix = "jpg" if int(frame.key) % 2 else "png"
        return FrameAnnotation(f"{frame.split}/{frame.key}.{suffix}", len(frame.labels.lanes))

    summary = run(monkeypatch, dataset, tmp_path / "out", annotate)
    reader = open_reader(f"{dataset}/train")
    assert sum(summary.n_frames.values()) == 11
    assert (tmp_path / "out/train/00000001.jpg").read_bytes() == reader.member(1, "jpg")
    with Image.open(tmp_path / "out/train/00000002.png") as image:
        assert image.format == "PNG"
        np.testing.assert_array_equal(np.asarray(image), reader.image(2))


def test_the_writer_gets_the_scene_and_the_labels_of_the_rolled_camera(monkeypatch, write_split, tmp_path):
    write_split(tmp_path / "data", "train", 1, ["camera.roll_deg=2"])
    frames = []

    def annotate(frame):
        frames.append(frame)
        return FrameAnnotation(None, 0, files={"a.txt": "a"})

    run(monkeypatch, tmp_path / "data", tmp_path / "out", annotate)
    (frame,) = frames
    assert frame.labels.camera.roll_rad == pytest.approx(np.radians(2), abs=1e-6)
    assert frame.scene.camera.roll_rad == frame.labels.camera.roll_rad
    assert (frame.passes, frame.image_format) == ({}, "jpg")
    assert not list((tmp_path / "out").rglob("*.jpg"))


def test_a_scene_is_written_once_where_the_format_says_so(monkeypatch, tmp_path):
    recipe = fake_samples.recipe(shots=clips(3, 10))
    generate(Plan(str(tmp_path / "data"), 8, recipe, workers=1, maker=fake_samples.make), lambda event: None)
    keys = []

    def annotate(frame):
        keys.append(frame.key)
        return FrameAnnotation(None, 1)

    summary = run(monkeypatch, tmp_path / "data", tmp_path / "out", annotate, is_per_scene=True)
    assert keys == ["00000000", "00000003", "00000006"]
    assert sum(summary.n_frames.values()) == 3


def test_data_sets_without_the_passes_are_refused_before_anything_is_written(monkeypatch, dataset, tmp_path):
    with pytest.raises(InputError) as error:
        run(monkeypatch, dataset, tmp_path / "out", lambda frame: None, passes=("semantic", "instance"))
    assert str(error.value) == (
        f"{dataset}/test: expected the passes semantic, instance (generate --passes) for as_it_is, got none"
    )
    assert not (tmp_path / "out").exists()


def test_of_a_refused_export_only_finished_chunks_stay(monkeypatch, dataset, tmp_path):
    refused, out = ["00000002"], tmp_path / "new/out"

    def annotate(frame):
        if frame.key in refused:
            raise InputError(f"{frame.where}: expected another frame")
        return FrameAnnotation(f"images/{frame.split}-{frame.key}.jpg", 1, files={f"labels/{frame.key}.txt": "a"})

    with pytest.raises(InputError, match="test:00000002: expected another frame"):
        run(monkeypatch, dataset, out, annotate)
    assert not out.parent.exists()
    monkeypatch.setattr("synth3dlanes.formats.plan.FRAMES_PER_CHUNK", 2)
    with pytest.raises(InputError):
        run(monkeypatch, dataset, out, annotate)
    assert {path.name for path in out.rglob("*.jpg")} == {"test-00000000.jpg", "test-00000001.jpg"}
    refused.clear()
    assert sum(run(monkeypatch, dataset, out, annotate).n_frames.values()) == 11


def test_shared_lines_become_one_document(monkeypatch, dataset, tmp_path):
    def annotate(frame):
        return FrameAnnotation(None, 1, shared=((json.dumps(frame.key), (f"{frame.split}.json",)),))

    def document(path, lines):
        yield json.dumps({"file": path, "keys": [json.loads(line) for line in lines.read_text().splitlines()]})

    for _ in range(2):
        run(monkeypatch, dataset, tmp_path / "out", annotate, document=document)
        found = json.loads((tmp_path / "out/test.json").read_text())
        assert found == {"file": "test.json", "keys": [f"{i:08d}" for i in range(4)]}
    assert not list((tmp_path / "out").glob("*.tmp*"))


def test_a_size_is_refused(monkeypatch, dataset, tmp_path):
    empty = SampleFormat(title="", readme="", write=lambda frame: None, read=unused, verify=unused, tolerances={})
    monkeypatch.setattr("synth3dlanes.formats.export.open_format", lambda name: empty)
    with pytest.raises(InputError, match=r"images \(`list formats` names those of any size"):
        Export(str(dataset), tmp_path / "out", "as_it_is", (96, 64)).write()


BENT = Lens(model="fisheye", coefficients=(0.02, 0, 0, 0))


@pytest.mark.parametrize("name", ["argoverse2", "kitti", "nuscenes", "openlane_v2"])
def test_lenses_are_refused_where_loaders_know_none_and_older_labels_where_boxes_are_written(name):
    labels, write = ground_truth(FLAT), open_format(name).write
    with pytest.raises(InputError, match=r"^test:00000007: expected a camera without distortion"):
        write(frame_of(replace(labels, camera=replace(labels.camera, lens=BENT)), number=7))
    if name != "openlane_v2":
        with pytest.raises(InputError, match=r"^test:00000007: expected labels with objects, got older ones"):
            write(frame_of(replace(labels, objects=None), number=7))
