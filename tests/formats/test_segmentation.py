"""COCO and plain masks: what tools decode is what the passes hold."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image, ImageDraw

from synth3dlanes.dataset.read import Reader
from synth3dlanes.formats.coco import run_lengths
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.plan import open_reader
from synth3dlanes.formats.yolo import document as settings_of_yolo
from synth3dlanes.formats.yolo import outline
from synth3dlanes.scene.things import SEMANTIC_IDS
from tests.formats.planting import problems
from tests.thorough import first

CAR_BOX, TREE_BOX = (slice(200, 240), slice(100, 180)), (slice(40, 120), slice(300, 330))


def passes_of(labels):
    """Road below, sky above; delimiters as far as they are seen, a car over them, a tree, a line beyond the labels."""
    camera = labels.camera
    lines = Image.new("I", (camera.width_px, camera.height_px))
    draw = ImageDraw.Draw(lines)
    delimiters = [lane for lane in labels.lanes if lane.kind == "delimiter"]
    for index, lane in enumerate(delimiters):
        homogeneous = lane.xyz_cam[lane.visible] @ camera.img_from_cam.T
        points = homogeneous[:, :2] / homogeneous[:, 2:] - 0.5
        draw.line([tuple(point) for point in points], fill=200 + index, width=3)
    instance = np.array(lines).astype(np.uint16)
    semantic = np.where(np.arange(camera.height_px)[:, None] < 150, SEMANTIC_IDS["sky"], SEMANTIC_IDS["road"])
    semantic = np.where(instance > 0, SEMANTIC_IDS["marking"], semantic).astype(np.uint8)
    for box, number, name in ((CAR_BOX, 1, "car"), (TREE_BOX, 300, "tree")):
        instance[box], semantic[box] = number, SEMANTIC_IDS[name]
    beyond = (slice(150, 152), slice(240, 244))
    instance[beyond], semantic[beyond] = 200 + len(delimiters), SEMANTIC_IDS["marking"]
    return {"semantic": semantic, "instance": instance}


@pytest.fixture(scope="module")
def with_passes(tmp_path_factory, write_split):
    root = tmp_path_factory.mktemp("with_passes")
    write_split(root, "train", 3, ["camera.roll_deg=1"], passes_of)
    write_split(root, "test", 2, [], passes_of)
    return root


@pytest.fixture(scope="module")
def coco(with_passes, tmp_path_factory):
    return exported("coco", with_passes, tmp_path_factory)


@pytest.fixture(scope="module")
def masks(with_passes, tmp_path_factory):
    return exported("masks", with_passes, tmp_path_factory)


def exported(format_name, source, tmp_path_factory):
    out = tmp_path_factory.mktemp(format_name) / "out"
    summary = Export(str(source), out, format_name).write()
    assert summary.n_frames == {"train": 3, "test": 2}
    return out


def decode(runs):
    """COCO's run lengths: 0 and 1 in turn, down the columns, the first run is of 0."""
    height_px, width_px = runs["size"]
    flat, value = [], 0
    for count in runs["counts"]:
        flat += [value] * count
        value = 1 - value
    return np.array(flat).reshape(width_px, height_px).T == 1


def test_instances_and_segments_are_the_passes(coco, with_passes):
    reader = open_reader(f"{with_passes}/train")
    things = json.loads((coco / "annotations/instances_train.json").read_text())
    panoptic = json.loads((coco / "annotations/panoptic_train.json").read_text())
    names = {category["id"]: category["name"] for category in things["categories"]}
    assert names == {number + 1: name for name, number in SEMANTIC_IDS.items()}
    assert [instance["id"] for instance in things["annotations"]] == list(range(1, len(things["annotations"]) + 1))
    assert things["images"] == panoptic["images"]
    for index, (image, frame) in enumerate(zip(panoptic["images"], panoptic["annotations"], strict=True)):
        passes, labels = reader.passes(index), reader.labels(index)
        assert (coco / "images" / image["file_name"]).read_bytes() == reader.member(index, "jpg")
        red, green, blue = np.asarray(Image.open(coco / "panoptic" / frame["file_name"])).astype(int).transpose(2, 0, 1)
        segments = red + 256 * green + 65536 * blue
        assert {info["id"]: info["area"] for info in frame["segments_info"]} == dict(
            zip(*map(np.ndarray.tolist, np.unique(segments, return_counts=True)), strict=True)
        )
        for info in frame["segments_info"]:
            semantic, instance = (np.unique(passes[name][segments == info["id"]]) for name in ("semantic", "instance"))
            assert [names[info["category_id"]]] == [name for name, n in SEMANTIC_IDS.items() if n in semantic]
            assert len(instance) == 1
        mine = [thing for thing in things["annotations"] if thing["image_id"] == image["id"]]
        expected = {
            (int(i), int(s)) for i, s in zip(passes["instance"].flat, passes["semantic"].flat, strict=True) if i
        }
        delimiters = [lane for lane in labels.lanes if lane.kind == "delimiter"]
        for thing in mine:
            mask = decode(thing["segmentation"])
            (pair,) = {(int(passes["instance"][mask][0]), int(passes["semantic"][mask][0]))}
            expected.remove(pair)
            np.testing.assert_array_equal(mask, (passes["instance"] == pair[0]) & (passes["semantic"] == pair[1]))
            rows, columns = np.nonzero(mask)
            x, y, width, height = thing["bbox"]
            assert (x, y, x + width - 1, y + height - 1) == (columns.min(), rows.min(), columns.max(), rows.max())
            if 200 <= pair[0] < 200 + len(delimiters):
                assert thing["lane"]["id"] == delimiters[pair[0] - 200].id
            else:
                assert "lane" not in thing
        assert not expected, "every thing has its instance"


@pytest.mark.parametrize("flat", ["0110", "1001", "1111", "0001", "1000", "010101"])
def test_run_lengths(flat):
    mask = np.array([int(c) for c in flat])
    lengths = run_lengths(np.flatnonzero(mask), len(mask))
    assert "".join(str(k % 2) * n for k, n in enumerate(lengths)) == flat


def test_masks_are_the_passes_and_lines_run_along_them(masks, with_passes):
    reader, n_checked = open_reader(f"{with_passes}/train"), 0
    assert json.loads((masks / "classes.json").read_text()) == SEMANTIC_IDS
    assert (masks / "lists/train.txt").read_text().split() == [f"train-{i:08d}.jpg" for i in range(3)]
    assert (masks / "lists/val.txt").read_text() == (masks / "lists/test.txt").read_text()
    for index in range(3):
        passes, delimiters = reader.passes(index), [x for x in reader.labels(index).lanes if x.kind == "delimiter"]
        for folder in ("semantic", "instance"):
            with Image.open(masks / f"{folder}/train-{index:08d}.png") as mask:
                assert mask.mode == {"semantic": "L", "instance": "I;16"}[folder]
                np.testing.assert_array_equal(np.asarray(mask), passes[folder])
        marks = np.asarray(Image.open(masks / f"lines/train-{index:08d}.png"))
        ids = np.where((passes["instance"] >= 200) & (passes["instance"] < 300), passes["instance"], 199)
        np.testing.assert_array_equal(marks, ids - 199)
        about = json.loads((masks / f"lines/train-{index:08d}.json").read_text())
        texts = (masks / f"lines/train-{index:08d}.lines.txt").read_text().splitlines()
        assert len(texts) == len(about) >= 2
        for line, text in zip(about, texts, strict=True):
            assert line["id"] == delimiters[line["number"] - 1].id
            points = np.array(text.split(), dtype=float).reshape(-1, 2)
            assert (points >= 0).all()
            assert (points <= [480, 360]).all()
            assert points[0, 1] > points[-1, 1], "from near to far"
            columns, rows = np.clip(points.astype(int).T, 0, [[479], [359]])
            near = [
                marks[np.clip(rows + i, 0, 359), np.clip(columns + j, 0, 479)] for i in (-1, 0, 1) for j in (-1, 0, 1)
            ]
            on_own = (np.array(near) == line["number"]).any(axis=0)
            hidden = passes["semantic"][rows, columns] == SEMANTIC_IDS["car"]
            # The drawn lines begin and end at samples of the labels, a metre apart, those of the export at the border.
            if len(points) > 6:
                assert np.mean((on_own | hidden)[1:-1]) > 0.7
                n_checked += 1
    assert n_checked >= 6


def test_lines_with_each_others_numbers_are_found(with_passes, masks, tmp_path):
    out = shutil.copytree(masks, tmp_path / "masks")
    path = out / "lines/train-00000000.json"
    about = json.loads(path.read_text())
    about[0]["number"], about[1]["number"] = about[1]["number"], about[0]["number"]
    path.write_text(json.dumps(about))
    assert any("line 0: expected 2 to be (" in problem for problem in problems(with_passes, out, "masks"))


@pytest.mark.parametrize(
    ("change", "words"),
    first(
        1,
        [
            (lambda box: box["center_cam"].__setitem__(0, box["center_cam"][0] + 0.1), "expected the 3D box of"),
            (lambda box: box.update(id=2), "expected the 3D box of"),
            (lambda box: box.update(category="bus"), "expected the 3D box of"),
            (None, "got none"),
        ],
    ),
)
def test_3d_boxes_are_those_of_the_labels_and_others_are_found(change, words, with_passes, coco, tmp_path):
    out = shutil.copytree(coco, tmp_path / "coco")
    path = out / "annotations/instances_train.json"
    document, reader = json.loads(path.read_text()), Reader(str(with_passes / "train"))
    cars = [item for item in document["annotations"] if item["category_id"] == SEMANTIC_IDS["car"] + 1]
    assert len(cars) == 3
    for car, labels in zip(cars, map(reader.labels, range(3)), strict=True):
        own = labels.objects[0]
        assert (car["object"]["id"], car["object"]["category"]) == (1, own.category)
        np.testing.assert_allclose(car["object"]["center_cam"], own.center_cam, atol=1e-4)
    if change is None:
        del cars[0]["object"]
    else:
        change(cars[0]["object"])
    path.write_text(json.dumps(document))
    assert any(words in problem for problem in problems(with_passes, out, "coco"))


def test_segments_a_pixel_aside_are_found(with_passes, coco, tmp_path):
    out = shutil.copytree(coco, tmp_path / "coco")
    path = out / "panoptic/train-00000000.png"
    Image.fromarray(np.roll(np.asarray(Image.open(path)), 1, axis=1)).save(path)
    assert any("pixels of others" in problem for problem in problems(with_passes, out, "coco"))


def fill(corners, shape):
    """The pixels inside a polygon with upright and level sides: each upright side switches all pixels right of it."""
    switches = np.zeros((shape[0], shape[1] + 1), dtype=int)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        assert x0 == x1 or y0 == y1
        switches[min(y0, y1) : max(y0, y1), x0] ^= x0 == x1
    return np.cumsum(switches, axis=1)[:, :-1] % 2 == 1


@pytest.mark.parametrize(
    "rows",
    [
        ["#"],
        ["##", "##"],
        ["#..", "###", "#.#"],
        [".#.", "###", ".#."],
        ["#.#", "###"],
        ["###", "..#", "###", "#..", "###"],
    ],
)
def test_an_outline_encloses_its_pixels(rows):
    piece = np.array([[c == "#" for c in row] for row in rows])
    corners = outline(piece)
    np.testing.assert_array_equal(fill(corners, piece.shape), piece)
    x, y = corners.T
    assert np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)) == 2 * piece.sum(), "clockwise, y down"


def test_yolo_outlines_fill_the_pixels_of_their_class(with_passes, tmp_path, monkeypatch):
    Export(str(with_passes), tmp_path, "yolo").write()
    settings = yaml.safe_load((tmp_path / "data.yaml").read_text())
    assert [settings.get(key) for key in ("path", "train", "val", "test")] == [
        None,  # tools take it from the working directory; without it, they look beside the file
        "train.txt",
        "val.txt",
        "test.txt",
    ]
    # From any folder: without `path`, tools take the settings' folder, and the list's for what begins with "./".
    monkeypatch.chdir("/")
    root = Path(settings.get("path") or (tmp_path / "data.yaml").parent)
    for part in ("train", "val", "test"):
        images = (root / settings[part]).read_text().strip().splitlines()
        assert images
        assert all((root / image.removeprefix("./")).is_file() for image in images)
    assert (tmp_path / "train.txt").read_text().splitlines() == [f"./images/train-{i:08d}.jpg" for i in range(3)]
    reader = open_reader(f"{with_passes}/train")
    for index in range(3):
        semantic = reader.passes(index)["semantic"]
        filled = np.full(semantic.shape, -1)
        for text in (tmp_path / f"labels/train-{index:08d}.txt").read_text().splitlines():
            number, *shares = text.split()
            corners = np.array(shares, dtype=float).reshape(-1, 2) * [480, 360]
            np.testing.assert_allclose(corners, corners.round(), atol=1e-3)
            filled[fill(corners.round().astype(int), semantic.shape)] = SEMANTIC_IDS[settings["names"][int(number)]]
        for name in ("car", "tree", "marking"):
            of_class, found = semantic == SEMANTIC_IDS[name], filled == SEMANTIC_IDS[name]
            # Pieces of a few pixels are left out.
            assert (of_class & found).sum() > 0.97 * (of_class | found).sum()
    assert problems(with_passes, tmp_path, "yolo") == []


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        (("train",), {"train": "train.txt", "val": "train.txt"}),
        (("val", "test"), {"train": "val.txt", "val": "val.txt", "test": "test.txt"}),
        (("train", "val", "test"), {part: f"{part}.txt" for part in ("train", "val", "test")}),
    ],
)
def test_settings_of_yolo_name_training_and_val_images_always(tmp_path, parts, expected):
    lines = tmp_path / "lines"
    lines.write_text("".join(f"{part}\n" for part in parts))
    found = yaml.safe_load("".join(settings_of_yolo("data.yaml", lines)))
    assert found.pop("names")[0]
    assert found == expected
