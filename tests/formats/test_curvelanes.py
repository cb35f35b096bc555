"""CurveLanes: all lines as points, and what public loaders open in an export."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.formats import curvelanes
from synth3dlanes.formats.curvelanes import parse
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.writing import Pinhole
from synth3dlanes.system.errors import FormatError
from tests.formats import closed_form as cf

FRAME = cf.frame(Pinhole(2560, 1440, 2217.0, 114.0))


def test_curvelanes_of_half_the_size_are_the_same_lines():
    labels = cf.road(cf.camera_label(), curvature=0.002)
    half = replace(FRAME, pinhole=Pinhole(1280, 720, 2217.0 / 2, 57.0))
    assert FRAME.pinhole.resized(1280, 720) == half.pinhole
    made = (curvelanes.write(replace(frame, labels=labels)) for frame in (FRAME, half))
    (whole_text,), (half_text,) = (annotation.files.values() for annotation in made)
    for line, other in zip(parse(whole_text, "test"), parse(half_text, "test"), strict=True):
        found = 2 * other[(2 * other[:, 1] <= line[0, 1]) & (2 * other[:, 1] >= line[-1, 1])]
        assert len(found) > 10
        np.testing.assert_allclose(found[:, 0], np.interp(found[:, 1], *line[::-1, ::-1].T), atol=0.05)


def test_curvelanes_has_all_lines():
    camera = cf.camera_label()
    lanes = [cf.lane(camera, cf.curve(x), f"d{x}") for x in (-9, -5.4, -1.8, 1.8, 5.4, 9)]
    assert curvelanes.write(replace(FRAME, labels=cf.labels_of(camera, *lanes))).n_lines == 6


def test_keys_that_many_points_lack_are_told_by_their_places():
    with pytest.raises(FormatError, match=r"^some/file.json: Lines\.0\.0\.y: missing"):
        parse(json.dumps({"Lines": [[{"x": "1"}] * 3]}), "some/file.json")


@pytest.mark.parametrize(
    ("part", "parts", "folder"),
    [
        ("train", {"train", "val", "test"}, "train"),
        ("val", {"train", "val", "test"}, "valid"),
        ("test", {"train", "val", "test"}, "test"),
        ("test", {"train", "test"}, "valid"),
    ],
)
def test_frames_are_in_the_folder_of_their_part(part, parts, folder):
    annotation = curvelanes.write(replace(FRAME, part=part, parts=frozenset(parts), labels=cf.road(cf.camera_label())))
    assert annotation.image == f"{folder}/images/train_00000017.jpg"
    assert annotation.files.keys() == {f"{folder}/labels/train_00000017.lines.json"}
    assert annotation.shared[0] == ("images/train_00000017.jpg", (f"{folder}/{folder}.txt",))


@pytest.fixture(scope="module", params=[None, (1280, 720)])
def root(request, dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("curvelanes")
    Export(str(dataset), out, "curvelanes", request.param).write()
    return out


def test_what_condlanenet_opens(root):
    # A script writes images/NAME.lines.txt from the name of every JSON below labels; the loader joins the list's folder
    # with each line of the list, and replaces ".jpg". It takes images of three sizes.
    for part in ("train", "valid"):
        made = {path.name.removesuffix(".json") + ".txt" for path in (root / part / "labels").rglob("*.json")}
        names = (root / part / f"{part}.txt").read_text().splitlines()
        assert names
        for name in names:
            folder, _, base = name.partition("/")
            assert folder == "images"
            assert base.replace(".jpg", ".lines.txt") in made
            with Image.open(root / part / name) as image:
                assert image.size in {(2560, 1440), (1570, 660), (1280, 720)}
    for path in (root / "train/labels").glob("*.json"):
        for line in json.loads(path.read_text())["Lines"]:
            assert len(line) >= 2
            for point in line:
                assert point.keys() == {"x", "y"}
                assert all(
                    isinstance(value, str) and " " not in value and float(value) >= 0 for value in point.values()
                )


def test_what_ufld_v2_opens(root):
    # Whatever lies in train/images, with "jpg" replaced; and for validation "images" in every line of the list.
    for path in (root / "train/images").iterdir():
        json.loads((root / "train/labels" / path.name.replace("jpg", "lines.json")).read_text())
    for name in (root / "valid/valid.txt").read_text().splitlines():
        json.loads((root / "valid" / name.replace("images", "labels").replace(".jpg", ".lines.json")).read_text())
