"""CULane: lines by row, the four beside the camera, and what public loaders open in an export."""

import io
import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.formats import culane
from synth3dlanes.formats.culane import parse_entry, parse_lines
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.writing import Pinhole
from synth3dlanes.system.errors import FormatError
from tests.formats import closed_form as cf
from tests.formats.problems import problems

FRAME = cf.frame(Pinhole(1640, 590, 1420.3, 69.0))


def lines_of(annotation):
    (text,) = [content for path, content in annotation.files.items() if path.endswith(".lines.txt")]
    return parse_lines(text, "test")


def mask_of(annotation):
    (data,) = [content for path, content in annotation.files.items() if path.endswith(".png")]
    return np.asarray(Image.open(io.BytesIO(data)))


def test_culane_line_by_hand():
    camera = cf.camera_label(1.5, 0.0)
    (line,) = lines_of(culane.write(replace(FRAME, labels=cf.labels_of(camera, cf.lane(camera, cf.curve(1.5))))))
    # On level ground 1.5 m below and 1.5 m right of the camera: u - 820 = v - 364. At 110 m, v - 364 is 19 px.
    np.testing.assert_allclose(line[:, 0], line[:, 1] + 456, atol=0.001)
    assert line[:, 1].tolist() == list(range(590, 380, -10))


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
    annotation = culane.write(replace(FRAME, labels=cf.labels_of(camera, *lanes[::-1])))
    image, mask, *found = annotation.shared[1][0].split()
    assert found == flags.split()
    assert annotation.files.keys() == {image[1:-3] + "lines.txt", mask[1:]}
    lines = lines_of(annotation)
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
    annotation = culane.write(replace(FRAME, labels=cf.labels_of(camera, *lanes)))
    assert json.loads(annotation.shared[2][0])["lines_ids"] == ["near"]
    assert sum(annotation.dropped.values()) == 1


def test_a_wrong_line_or_list_is_a_format_error_that_names_it():
    for text in ("1 2 3", "1 a"):
        with pytest.raises(FormatError, match=r"^some/file.txt:1: "):
            parse_lines(text, "some/file.txt")
    for text in ("", "/a.jpg /b.png 1 1 1", "/a.jpg /b.png 1 1 1 2"):
        with pytest.raises(FormatError, match=r"^some/list.txt: "):
            parse_entry(text, "some/list.txt")


@pytest.mark.parametrize(
    ("part", "parts", "lists"),
    [
        ("train", {"train", "val", "test"}, {"train", "train_gt"}),
        ("val", {"train", "val", "test"}, {"val", "val_gt"}),
        ("test", {"train", "val", "test"}, {"test", "test0_normal"}),
        ("test", {"train", "test"}, {"test", "test0_normal", "val", "val_gt"}),
    ],
)
def test_frames_are_in_the_lists_of_their_part(part, parts, lists):
    frame = replace(FRAME, part=part, parts=frozenset(parts))
    annotation = culane.write(replace(frame, labels=cf.road(cf.camera_label())))
    listed = {path.rpartition("/")[2] for _, paths in annotation.shared for path in paths}
    assert listed == {f"{name}.txt" for name in lists} | {"sidecar.jsonl"}
    bent = culane.write(replace(replace(frame, tags=frozenset({"curve"})), labels=cf.road(cf.camera_label())))
    assert ("list/test_split/test6_curve.txt" in bent.shared[0][1]) == ("test" in lists)


@pytest.fixture(scope="module")
def root(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("culane")
    Export(str(dataset), out, "culane").write()
    return out


def listed(root, name):
    return (root / "list" / name).read_text().splitlines(keepends=True)


def lanes_beside(image):
    """Points of every line, by the file's name with its last three letters replaced, negative ones left out."""
    text = image.with_name(image.name[:-3] + "lines.txt").read_text()
    numbers = [list(map(float, line.split())) for line in text.splitlines()]
    return [[(x, y) for x, y in zip(line[::2], line[1::2], strict=True) if x >= 0 and y >= 0] for line in numbers]


def test_what_clrnet_and_laneatt_open(root):
    # CLRNet trains on train_gt.txt, validates on val.txt, tests on test.txt; LaneATT has train.txt. One slash goes.
    assert [line.split()[0] for line in listed(root, "train_gt.txt")] == [
        line.rstrip() for line in listed(root, "train.txt")
    ]
    for line in listed(root, "train_gt.txt"):
        image, mask, *flags = line.split()
        assert image[0] == mask[0] == "/"
        lanes = lanes_beside(root / image[1:])
        # CLRNet drops lines of two points; both take them by y, which must not repeat.
        assert all(len(lane) > 2 and len({y for _, y in lane}) == len(lane) for lane in lanes)
        assert sum(map(int, flags)) == len(lanes) <= 4
        pixels = np.asarray(Image.open(root / mask[1:]))
        assert pixels.shape == (590, 1640), "one channel of the image's size"
        assert set(np.unique(pixels)) - {0} == {i for i, flag in enumerate(flags, 1) if flag == "1"}
    for name in ("val.txt", "test.txt"):
        assert listed(root, name)
        for line in listed(root, name):
            lanes_beside(root / line.rstrip()[1:])
            with Image.open(root / line.split()[0][1:]) as image:
                assert image.size == (1640, 590)
    # LaneATT and evaluators replace ".jpg" anywhere in a path.
    assert all(line.count("jpg") == 1 for line in listed(root, "train.txt"))


def test_what_ufld_reads_in_the_masks(root):
    # Rows of the mask at these shares of 288, and in each of them the mean column of the numbers 1 to 4.
    anchors = [121, 131, 141, 150, 160, 170, 180, 189, 199, 209, 219, 228, 238, 248, 258, 267, 277, 287]
    gaps_px = []
    for line in listed(root, "train_gt.txt"):
        image, mask, *flags = line.split()
        pixels = np.asarray(Image.open(root / mask[1:]))
        numbers = [number for number, flag in enumerate(flags, 1) if flag == "1"]
        for number, lane in zip(numbers, lanes_beside(root / image[1:]), strict=True):
            x, y = np.array(lane)[::-1].T
            for row in (int(anchor / 288 * 590) for anchor in anchors):
                columns = np.flatnonzero(pixels[row] == number)
                # Where another line does not cover it, nor the image's border.
                if y[0] + 20 < row < y[-1] - 20 and columns.size > 14 and 30 < columns[0] < columns[-1] < 1610:
                    gaps_px.append(abs(columns.mean() + 0.5 - np.interp(row + 0.5, y, x)))
    assert len(gaps_px) > 50
    assert np.median(gaps_px) < 0.5
    assert np.percentile(gaps_px, 90) < 3, "beside the middle in sharp bends and under other lines only"


def test_what_ufld_v2_caches(root):
    # Its script cuts the first letter of both paths, takes rows as whole numbers from 250 on, every 10 up to 590, and
    # the line's number from the mask at the middle of its points, which it may not find empty.
    for line in listed(root, "train_gt.txt"):
        image, mask, *_ = line.split(" ")
        pixels = np.asarray(Image.open(root / mask[1:]))
        found = []
        for text in (root / image[1:].replace("jpg", "lines.txt")).read_text().splitlines():
            fields = text.strip().split(" ")
            rows = [(int(y) - 250) / 10 for y in fields[1::2]]
            assert set(rows) <= set(range(35))
            middle = len(fields) // 2 // 2
            found.append(pixels[int(float(fields[1::2][middle])) - 1, int(float(fields[::2][middle])) - 1])
        assert found == sorted(set(found) - {0}), "one number a line, from left to right"
        assert len(image) - 1 <= 46, "its names have 46 letters at most"


def test_what_the_evaluators_open(root):
    names = ("normal", "crowd", "hlight", "shadow", "noline", "arrow", "curve", "cross", "night")
    cases = [line for i, name in enumerate(names) for line in listed(root, f"test_split/test{i}_{name}.txt")]
    assert Counter(line.rstrip() for line in cases) == Counter(line.rstrip() for line in listed(root, "test.txt"))
    for line in listed(root, "train_gt.txt"):
        # SCNN takes the video's name by cutting ten letters.
        assert line.split()[0][:-10].endswith(".MP4")


def test_a_problem_in_lines_or_masks_is_found(dataset, root, tmp_path):
    assert problems(dataset, root, "culane") == []
    _, mask, *_ = listed(root, "train_gt.txt")[0].split()
    path = root / mask[1:]
    good = path.read_bytes()
    Image.new("L", (1640, 590)).save(path)
    assert any("points without it" in problem for problem in problems(dataset, root, "culane"))
    path.write_bytes(good)
