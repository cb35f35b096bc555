"""Formats of lines in the image: their points lie on the projected lanes, row by row from the bottom up; what public
loaders open in an export.
"""

import io
import json
from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from PIL import Image

from synth3dlanes.formats import culane, curvelanes, tusimple
from synth3dlanes.formats.culane import parse_entry, parse_lines
from synth3dlanes.formats.curvelanes import parse as parse_curvelanes
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.tusimple import FORMAT
from synth3dlanes.formats.writing import Pinhole
from synth3dlanes.system.errors import FormatError
from tests.formats import closed_form as cf
from tests.formats.closed_form import cameras, roads
from tests.formats.planting import problems


def of_file(parse, ending, annotation):
    """The lines of a frame's own file."""
    (text,) = [content for path, content in annotation.files.items() if path.endswith(ending)]
    return parse(text, "test")


def of_rows(annotation):
    """The lines of a frame of tuSimple, which has a column for each row, -2 where there is none."""
    frame = tusimple.parse(annotation.shared[0][0], "test")
    return [np.column_stack([u_px, frame.rows_px])[u_px != -2][::-1] for u_px in frame.lanes_u_px]


# The format, its camera (size, f, how far c is under the middle), the rounding of columns (px), the least and the most
# lines of a frame, and what reads these.
FORMATS = {
    "tusimple": (tusimple, (1280, 720, 2015 * 2 / 3, 0.0), 0.5, (1, 5), of_rows),
    "culane": (culane, (1640, 590, 1420.3, 69.0), 0.001, (1, 4), partial(of_file, culane.parse_lines, ".txt")),
    "curvelanes": (
        curvelanes,
        (2560, 1440, 2217.0, 114.0),
        0.006,
        (2, 99),
        partial(of_file, curvelanes.parse, ".json"),
    ),
}


@pytest.mark.parametrize("name", FORMATS)
@given(cameras, roads)
@settings(max_examples=25, deadline=None)
def test_points_lie_on_the_projected_lanes(name, camera, plan):
    foreign, (width_px, height_px, f_px, below_px), rounding_px, (least, most), lines_of = FORMATS[name]
    labels = cf.road(cf.camera_label(*camera), **plan)
    annotation = foreign.write(replace(cf.frame(Pinhole(width_px, height_px, f_px, below_px)), labels=labels))
    (ids,) = [json.loads(text)["lines_ids"] for text, files in annotation.shared if files == ("sidecar.jsonl",)]
    lines, by_id = lines_of(annotation), {lane.id: lane for lane in labels.lanes}
    assert least <= len(lines) == annotation.n_lines <= most
    for line, lane_id in zip(lines, ids, strict=True):
        right_m, ahead_m, up_m = by_id[lane_id].xyz_cam[by_id[lane_id].xyz_cam[:, 1] > 0.5].T
        u_px = width_px / 2 + f_px * right_m / ahead_m
        v_px = height_px / 2 + below_px - f_px * up_m / ahead_m
        # On the piece of the projected polyline that crosses the row.
        above = np.array([np.flatnonzero(v_px <= v)[0] for v in line[:, 1]])
        share = (line[:, 1] - v_px[above - 1]) / (v_px[above] - v_px[above - 1])
        expected_px = u_px[above - 1] + share * (u_px[above] - u_px[above - 1])
        assert np.abs(line[:, 0] - expected_px).max() <= rounding_px + 1e-6
        assert (np.diff(line[:, 1]) <= -10).all()
        assert set(line[:, 1] % 10) == {0}
        assert ((line[:, 0] >= 0) & (line[:, 0] < width_px)).all()


TUSIMPLE = cf.frame(Pinhole(1280, 720, 2015 * 2 / 3))


def test_tusimple_skips_frames_without_lines():
    assert tusimple.write(replace(TUSIMPLE, labels=cf.labels_of(cf.camera_label()))) is None


# What LaneATT, CLRNet and UFLD open: training on 0313 and 0601, with or without 0531; validation on 0531; test_label.
LABEL_FILES = {"label_data_0313.json", "label_data_0531.json", "label_data_0601.json", "test_label.json"}


def files_of(part, parts):
    frames = (replace(TUSIMPLE, part=part, parts=frozenset(parts), key=f"{key:08d}") for key in range(20))
    road = cf.road(cf.camera_label())
    return [tusimple.write(replace(frame, labels=road)).shared[0][1][0] for frame in frames]


def test_tusimple_label_files_are_those_that_loaders_open():
    assert set(files_of("test", {"train", "test"})) == {"test_label.json"}
    assert set(files_of("val", {"train", "val"})) == {"test_label.json"}, "no training file may hold a test frame"
    assert set(files_of("val", {"train", "val", "test"})) == {"label_data_0531.json"}
    assert set(files_of("train", {"train", "val", "test"})) == LABEL_FILES - {"test_label.json", "label_data_0531.json"}
    dealt = files_of("train", {"train", "test"})
    assert set(dealt) == LABEL_FILES - {"test_label.json"}
    assert dealt.count("label_data_0313.json") == 16
    assert (dealt[2], dealt[7]) == ("label_data_0601.json", "label_data_0531.json")
    assert set(FORMAT.lists) >= LABEL_FILES, "they are there even when empty"


def test_the_list_of_test_images_has_no_lanes():
    # UFLD opens test_tasks_0627.json for the names of the test images, with these three keys.
    frame = replace(TUSIMPLE, part="test")
    text, files = tusimple.write(replace(frame, labels=cf.road(cf.camera_label()))).shared[2]
    assert files == ("test_tasks_0627.json",)
    document = json.loads(text)
    assert document.keys() == {"raw_file", "h_samples", "lanes"}
    assert document["raw_file"] == "clips/train/00000017/20.jpg"
    assert document["lanes"] == []
    assert tusimple.write(replace(TUSIMPLE, labels=cf.road(cf.camera_label()))).shared[2][1] == ()


CULANE = cf.frame(Pinhole(1640, 590, 1420.3, 69.0))


def culane_lines(annotation):
    (text,) = [content for path, content in annotation.files.items() if path.endswith(".lines.txt")]
    return parse_lines(text, "test")


def mask_of(annotation):
    (data,) = [content for path, content in annotation.files.items() if path.endswith(".png")]
    return np.asarray(Image.open(io.BytesIO(data)))


@pytest.mark.parametrize(
    ("x_m", "flags"),
    [
        ([-9, -5.4, -1.8, 1.8, 5.4, 9], "1 1 1 1"),
        ([-1.8, 1.8], "0 1 1 0"),
        ([-5.4, -1.8, 1.8], "1 1 1 0"),
        ([1.8, 5.4, 9], "0 0 1 1"),
        ([-5.4, -1.8], "1 1 0 0"),
        ([], "0 0 0 0"),
    ],
)
def test_culane_has_the_two_nearest_lines_on_either_side_of_the_camera(x_m, flags):
    camera = cf.camera_label()
    lanes = [cf.lane(camera, cf.curve(x), f"d{i}") for i, x in enumerate(x_m)]
    annotation = culane.write(replace(CULANE, labels=cf.labels_of(camera, *lanes[::-1])))
    image, mask, *found = annotation.shared[1][0].split()
    assert found == flags.split()
    assert annotation.files.keys() == {image[1:-3] + "lines.txt", mask[1:]}
    lines = culane_lines(annotation)
    nearest = sorted(sorted([x for x in x_m if x < 0])[-2:] + sorted([x for x in x_m if x > 0])[:2])
    assert len(lines) == annotation.n_lines == len(nearest)
    # From left to right, and in the mask under the numbers of the flags.
    numbers = [number for number, flag in enumerate(flags.split(), 1) if flag == "1"]
    pixels = mask_of(annotation)
    for line, number, x in zip(lines, numbers, nearest, strict=True):
        assert np.sign(line[0, 0] - 820) == np.sign(x)
        u, v = line[len(line) // 2]
        assert pixels[int(v), int(u)] == number
        # 16 pixels across the line.
        across = np.flatnonzero(pixels[int(v)] == number)
        slope = (line[0, 0] - line[-1, 0]) / (line[0, 1] - line[-1, 1])
        assert len(across) == pytest.approx(16 * np.hypot(1, slope), abs=3)
        assert across.mean() + 0.5 == pytest.approx(u + 0.5 * slope, abs=1)
    assert sorted(set(pixels.ravel()) - {0}) == numbers


def test_a_line_that_begins_far_ahead_is_not_beside_the_camera():
    camera = cf.camera_label()
    lanes = [cf.lane(camera, cf.curve(1.8), "near"), cf.lane(camera, cf.curve(0.5, start_m=40), "far")]
    annotation = culane.write(replace(CULANE, labels=cf.labels_of(camera, *lanes)))
    assert json.loads(annotation.shared[2][0])["lines_ids"] == ["near"]
    assert sum(annotation.dropped.values()) == 1


def test_a_wrong_line_or_list_is_a_format_error_that_names_it():
    for text in ("1 2 3", "1 a"):
        with pytest.raises(FormatError, match=r"^some/file.txt:1: "):
            parse_lines(text, "some/file.txt")
    for text in ("", "/a.jpg /b.png 1 1 1", "/a.jpg /b.png 1 1 1 2"):
        with pytest.raises(FormatError, match=r"^some/list.txt: "):
            parse_entry(text, "some/list.txt")


@pytest.fixture(scope="module")
def of_culane(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("culane")
    Export(str(dataset), out, "culane").write()
    return out


def listed(of_culane, name):
    return (of_culane / "list" / name).read_text().splitlines(keepends=True)


def lanes_beside(image):
    """Points of every line, by the file's name with its last three letters replaced, negative ones left out."""
    text = image.with_name(image.name[:-3] + "lines.txt").read_text()
    numbers = [list(map(float, line.split())) for line in text.splitlines()]
    return [[(x, y) for x, y in zip(line[::2], line[1::2], strict=True) if x >= 0 and y >= 0] for line in numbers]


def test_what_clrnet_and_laneatt_open(of_culane):
    # CLRNet trains on train_gt.txt, validates on val.txt, tests on test.txt; LaneATT has train.txt. One slash goes.
    assert [line.split()[0] for line in listed(of_culane, "train_gt.txt")] == [
        line.rstrip() for line in listed(of_culane, "train.txt")
    ]
    for line in listed(of_culane, "train_gt.txt"):
        image, mask, *flags = line.split()
        assert image[0] == mask[0] == "/"
        lanes = lanes_beside(of_culane / image[1:])
        # CLRNet drops lines of two points; both take them by y, which must not repeat.
        assert all(len(lane) > 2 and len({y for _, y in lane}) == len(lane) for lane in lanes)
        assert sum(map(int, flags)) == len(lanes) <= 4
        pixels = np.asarray(Image.open(of_culane / mask[1:]))
        assert pixels.shape == (590, 1640), "one channel of the image's size"
        assert set(np.unique(pixels)) - {0} == {i for i, flag in enumerate(flags, 1) if flag == "1"}
    for name in ("val.txt", "test.txt"):
        assert listed(of_culane, name)
        for line in listed(of_culane, name):
            lanes_beside(of_culane / line.rstrip()[1:])
            with Image.open(of_culane / line.split()[0][1:]) as image:
                assert image.size == (1640, 590)
    # LaneATT and evaluators replace ".jpg" anywhere in a path.
    assert all(line.count("jpg") == 1 for line in listed(of_culane, "train.txt"))


def test_what_ufld_reads_in_the_masks(of_culane):
    # Rows of the mask at these shares of 288, and in each of them the mean column of the numbers 1 to 4.
    anchors = [121, 131, 141, 150, 160, 170, 180, 189, 199, 209, 219, 228, 238, 248, 258, 267, 277, 287]
    gaps_px = []
    for line in listed(of_culane, "train_gt.txt"):
        image, mask, *flags = line.split()
        pixels = np.asarray(Image.open(of_culane / mask[1:]))
        numbers = [number for number, flag in enumerate(flags, 1) if flag == "1"]
        for number, lane in zip(numbers, lanes_beside(of_culane / image[1:]), strict=True):
            x, y = np.array(lane)[::-1].T
            for row in (int(anchor / 288 * 590) for anchor in anchors):
                columns = np.flatnonzero(pixels[row] == number)
                # Where another line does not cover it, nor the image's border.
                if y[0] + 20 < row < y[-1] - 20 and columns.size > 14 and 30 < columns[0] < columns[-1] < 1610:
                    gaps_px.append(abs(columns.mean() + 0.5 - np.interp(row + 0.5, y, x)))
    assert len(gaps_px) > 50
    assert np.median(gaps_px) < 0.5
    assert np.percentile(gaps_px, 90) < 3, "beside the middle in sharp bends and under other lines only"


def test_what_ufld_v2_caches(of_culane):
    # Its script cuts the first letter of both paths, takes rows as whole numbers from 250 on, every 10 up to 590, and
    # the line's number from the mask at the middle of its points, which it may not find empty.
    for line in listed(of_culane, "train_gt.txt"):
        image, mask, *_ = line.split(" ")
        pixels = np.asarray(Image.open(of_culane / mask[1:]))
        found = []
        for text in (of_culane / image[1:].replace("jpg", "lines.txt")).read_text().splitlines():
            fields = text.strip().split(" ")
            rows = [(int(y) - 250) / 10 for y in fields[1::2]]
            assert set(rows) <= set(range(35))
            middle = len(fields) // 2 // 2
            found.append(pixels[int(float(fields[1::2][middle])) - 1, int(float(fields[::2][middle])) - 1])
        assert found == sorted(set(found) - {0}), "one number a line, from left to right"
        assert len(image) - 1 <= 46, "its names have 46 letters at most"


def test_what_the_evaluators_open(of_culane):
    names = ("normal", "crowd", "hlight", "shadow", "noline", "arrow", "curve", "cross", "night")
    cases = [line for i, name in enumerate(names) for line in listed(of_culane, f"test_split/test{i}_{name}.txt")]
    assert Counter(line.rstrip() for line in cases) == Counter(line.rstrip() for line in listed(of_culane, "test.txt"))
    for line in listed(of_culane, "train_gt.txt"):
        # SCNN takes the video's name by cutting ten letters.
        assert line.split()[0][:-10].endswith(".MP4")


def test_a_problem_in_lines_or_masks_is_found(dataset, of_culane, tmp_path):
    assert problems(dataset, of_culane, "culane") == []
    _, mask, *_ = listed(of_culane, "train_gt.txt")[0].split()
    path = of_culane / mask[1:]
    good = path.read_bytes()
    Image.new("L", (1640, 590)).save(path)
    assert any("points without it" in problem for problem in problems(dataset, of_culane, "culane"))
    path.write_bytes(good)


CURVELANES = cf.frame(Pinhole(2560, 1440, 2217.0, 114.0))


def test_curvelanes_of_half_the_size_are_the_same_lines():
    labels = cf.road(cf.camera_label(), curvature=0.002)
    half = replace(CURVELANES, pinhole=Pinhole(1280, 720, 2217.0 / 2, 57.0))
    assert CURVELANES.pinhole.resized(1280, 720) == half.pinhole
    made = (curvelanes.write(replace(frame, labels=labels)) for frame in (CURVELANES, half))
    (whole_text,), (half_text,) = (annotation.files.values() for annotation in made)
    for line, other in zip(parse_curvelanes(whole_text, "test"), parse_curvelanes(half_text, "test"), strict=True):
        found = 2 * other[(2 * other[:, 1] <= line[0, 1]) & (2 * other[:, 1] >= line[-1, 1])]
        assert len(found) > 10
        np.testing.assert_allclose(found[:, 0], np.interp(found[:, 1], *line[::-1, ::-1].T), atol=0.05)


def test_curvelanes_has_all_lines():
    camera = cf.camera_label()
    lanes = [cf.lane(camera, cf.curve(x), f"d{x}") for x in (-9, -5.4, -1.8, 1.8, 5.4, 9)]
    assert curvelanes.write(replace(CURVELANES, labels=cf.labels_of(camera, *lanes))).n_lines == 6


def test_keys_that_many_points_lack_are_told_by_their_places():
    with pytest.raises(FormatError, match=r"^some/file.json: Lines\.0\.0\.y: missing"):
        parse_curvelanes(json.dumps({"Lines": [[{"x": "1"}] * 3]}), "some/file.json")


@pytest.fixture(scope="module", params=[None, (1280, 720)])
def of_curvelanes(request, dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("curvelanes")
    Export(str(dataset), out, "curvelanes", request.param).write()
    return out


def test_what_condlanenet_opens(of_curvelanes):
    # A script writes images/NAME.lines.txt from the name of every JSON below labels; the loader joins the list's folder
    # with each line of the list, and replaces ".jpg". It takes images of three sizes.
    for part in ("train", "valid"):
        made = {path.name.removesuffix(".json") + ".txt" for path in (of_curvelanes / part / "labels").rglob("*.json")}
        names = (of_curvelanes / part / f"{part}.txt").read_text().splitlines()
        assert names
        for name in names:
            folder, _, base = name.partition("/")
            assert folder == "images"
            assert base.replace(".jpg", ".lines.txt") in made
            with Image.open(of_curvelanes / part / name) as image:
                assert image.size in {(2560, 1440), (1570, 660), (1280, 720)}
    for path in (of_curvelanes / "train/labels").glob("*.json"):
        for line in json.loads(path.read_text())["Lines"]:
            assert len(line) >= 2
            for point in line:
                assert point.keys() == {"x", "y"}
                assert all(
                    isinstance(value, str) and " " not in value and float(value) >= 0 for value in point.values()
                )


def test_what_ufld_v2_opens(of_curvelanes):
    # Whatever lies in train/images, with "jpg" replaced; and for validation "images" in every line of the list.
    for path in (of_curvelanes / "train/images").iterdir():
        json.loads((of_curvelanes / "train/labels" / path.name.replace("jpg", "lines.json")).read_text())
    for name in (of_curvelanes / "valid/valid.txt").read_text().splitlines():
        json.loads(
            (of_curvelanes / "valid" / name.replace("images", "labels").replace(".jpg", ".lines.json")).read_text()
        )
