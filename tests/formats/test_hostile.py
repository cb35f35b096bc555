"""Label files of others, mutated or wrong: each is read, or refused by a FormatError whose lines name it."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from synth3dlanes.formats import apollo, curvelanes, once, openlane, openlane_v2, tusimple
from synth3dlanes.formats.apollo import CAMERA
from synth3dlanes.formats.apollo import parse as parse_apollo
from synth3dlanes.formats.lines import scene_tags
from synth3dlanes.formats.openlane import parse as parse_openlane
from synth3dlanes.formats.reading import image_size, read_image
from synth3dlanes.formats.tusimple import TusimpleSplit, find_labels
from synth3dlanes.formats.tusimple import parse as parse_tusimple
from synth3dlanes.system.errors import FormatError
from tests.formats import closed_form as cf
from tests.hostile import WHERE, damaged, files, mutated, refused_or_read

TUSIMPLE = {"raw_file": "clips/1/20.jpg", "lanes": [[-2, 630, 620]], "h_samples": [240, 250, 260]}
APOLLO = {
    "raw_file": "images/00/1.jpg",
    "cam_height": 1.5,
    "cam_pitch": 0.05,
    "laneLines": [[[0.5, 5, 0.1], [0.6, 9, 0.2]]],
    "laneLines_visibility": [[1.0, 0.0]],
    "centerLines": [[[2.5, 5, 0.1], [2.6, 9, 0.2]]],
    "centerLines_visibility": [[1.0, 1.0]],
}
OPENLANE = {
    "file_path": "validation/seg/1.jpg",
    "intrinsic": [[2000, 0, 960], [0, 2000, 640], [0, 0, 1]],
    "extrinsic": [[1, 0, 0, 1.5], [0, 1, 0, 0], [0, 0, 1, 2.1], [0, 0, 0, 1]],
    "lane_lines": [
        {
            "xyz": [[5, 9, 20], [1, 1, 1], [-2, -2, -2]],
            "uv": [[3, 4], [5, 6]],
            "visibility": [1.0, 1.0, 0.0],
            "category": 2,
            "attribute": 1,
            "track_id": 4,
        }
    ],
}


@given(mutated(json.dumps(TUSIMPLE).encode(), is_json=True))
def test_tusimple(data):
    frame = refused_or_read(lambda: parse_tusimple(data, WHERE))
    if frame:
        assert frame.lanes_u_px.shape[1] == len(frame.rows_px)
        assert np.isfinite(frame.lanes_u_px).all()


@given(mutated(json.dumps(APOLLO).encode(), is_json=True))
def test_apollo(data):
    labels = refused_or_read(lambda: parse_apollo(data, WHERE).labels())
    assert labels is None or all(np.isfinite(lane.xyz_cam).all() for lane in labels.lanes)


@given(mutated(json.dumps(OPENLANE).encode(), is_json=True))
def test_openlane(data):
    labels = refused_or_read(lambda: parse_openlane(data, WHERE).labels((1920, 1280)))
    if labels:
        assert all(np.isfinite(lane.xyz_cam).all() for lane in labels.lanes)
        assert np.isfinite([labels.camera.pitch_rad, labels.camera.height_m]).all()


@pytest.mark.parametrize("path", ["/etc/passwd", "../x.jpg", "a/../../x.jpg", "a\0.jpg", ""])
def test_a_label_file_names_no_image_elsewhere(path):
    for parse, document, key in (
        (parse_tusimple, TUSIMPLE, "raw_file"),
        (parse_apollo, APOLLO, "raw_file"),
        (parse_openlane, OPENLANE, "file_path"),
    ):
        with pytest.raises(FormatError, match=f"^{WHERE}: {key}: expected "):
            parse(json.dumps({**document, key: path}), WHERE)


def test_what_is_no_text_is_no_label_file_of_tusimple(tmp_path):
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe{")
    assert find_labels(tmp_path / "bytes.json") is None
    with pytest.raises(FormatError, match="expected JSON"):
        TusimpleSplit(tmp_path / "bytes.json").frame(0)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    for suffix in ("jpg", "png", "bmp", "webp"):
        Image.new("RGB", (24, 16), (200, 10, 10)).save(folder / f"a.{suffix}")
    return folder


def test_pictures_of_each_kind_are_read(pictures):
    for path in sorted(pictures.iterdir()):
        assert np.abs(read_image(path).astype(int) - (200, 10, 10)).max() < 8, path.suffix


def test_a_picture_of_16_bits_keeps_its_grays(tmp_path):
    grays = np.arange(0, 65536, 256, dtype=np.uint16).reshape(16, 16)
    Image.fromarray(grays).save(tmp_path / "a.png")
    assert (read_image(tmp_path / "a.png") == (grays >> 8)[..., None]).all()


def test_a_picture_is_turned_as_its_file_says(tmp_path):
    exif, pixels = Image.Exif(), np.zeros((16, 24, 3), np.uint8)
    exif[0x0112], pixels[:, :12] = 6, (200, 10, 10)
    Image.fromarray(pixels).save(tmp_path / "a.png", exif=exif)
    # 6: to be shown turned by 90 degrees clockwise, so that what is left is above.
    assert (read_image(tmp_path / "a.png") == np.rot90(pixels, -1)).all()


@given(st.data())
@files
def test_pictures(tmp_path_factory, pictures, data):
    whole = data.draw(st.sampled_from(sorted(pictures.iterdir())))
    path = tmp_path_factory.getbasetemp() / f"damaged{whole.suffix}"
    path.write_bytes(data.draw(damaged(whole.read_bytes())))
    refused_or_read(lambda: read_image(path), str(path))


def test_a_picture_of_too_many_pixels_is_refused(tmp_path):
    Image.new("1", (20_000, 20_000)).save(tmp_path / "bomb.png")
    with pytest.raises(FormatError, match=r"bomb\.png: expected at most 8192x8192 pixels, got"):
        read_image(tmp_path / "bomb.png")
    with pytest.raises(FormatError, match=r"bomb\.png: expected an image, got "):
        image_size(tmp_path / "bomb.png")


@pytest.mark.parametrize("foreign", [apollo, curvelanes, once, openlane, openlane_v2, tusimple])
@pytest.mark.parametrize("text", ["", "[]", "{}", '{"lanes": 3}', '{"Lines": [[{"x": "1"}]]}'])
def test_a_wrong_file_is_a_format_error_that_names_it(foreign, text):
    with pytest.raises(FormatError, match=r"^some/file.json: "):
        foreign.parse(text, "some/file.json")


def test_scene_tags():
    camera = cf.camera_label()
    assert scene_tags(cf.road(camera), CAMERA) == set()
    assert scene_tags(cf.road(camera, curvature=0.004), CAMERA) == {"curve"}
    assert scene_tags(cf.road(camera, slope=0.001), CAMERA) == {"up_down", "steep"}
    leaving = cf.lane(camera, cf.curve(3.0), "exit", "centerline", road="exit")
    assert scene_tags(cf.labels_of(camera, leaving), CAMERA) == {"merge_split"}
