"""Whole exports of a small dataset: layout, parts, self-check, resuming, what narrow frames and paint become."""

import itertools
import json
import os
import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from synth3dlanes.formats.export import Export
from synth3dlanes.formats.format import PinholeFormat, format_names, open_format
from synth3dlanes.formats.plan import assign, open_reader, parts_of
from synth3dlanes.formats.verify import verify
from synth3dlanes.system import files
from synth3dlanes.system.errors import ClaimedError, FormatError, InputError
from tests.formats import closed_form as cf
from tests.power_cut import survive
from tests.small_files import withstands
from tests.thorough import first

N_TRAIN, N_TEST = 7, 4
FORMATS = {name: open_format(name) for name in format_names()}
PINHOLE = [name for name, foreign in FORMATS.items() if isinstance(foreign, PinholeFormat)]
# A folder for each frame, and lines of many frames in one file; the others have files of their own for tests.
QUICK = ("openlane", "tusimple")


@pytest.fixture(scope="module", params=first(len(QUICK), sorted(PINHOLE, key=lambda name: name not in QUICK)))
def exported(request, dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("exports") / request.param
    seen = []
    summary = Export(str(dataset), out, request.param).write(progress=lambda done, total: seen.append((done, total)))
    assert seen[0] == (0, N_TRAIN + N_TEST)
    assert seen[-1] == (N_TRAIN + N_TEST, N_TRAIN + N_TEST)
    return request.param, out, summary


def files_of(out):
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


def assert_every_line_ends(out):
    texts = [path for path in out.rglob("*") if path.suffix in (".txt", ".json", ".jsonl", ".yaml", ".xodr")]
    texts = [path for path in texts if ".parts" not in path.parts and path.name != "export.json"]
    assert texts
    for path in texts:
        text = path.read_text()
        assert not text or (text.endswith("\n") and not text.endswith("\n\n") and not text.startswith("\n")), path


def test_leftovers_of_a_kill_go(few, tmp_path, monkeypatch):
    """A kill as any of the files is about to get its name."""
    Export(str(few), tmp_path / "whole", "tusimple").write()
    kept, out = files._removed, tmp_path / "out"
    monkeypatch.setattr(files, "_removed", lambda folder, name: None if name.endswith(".tmp") else kept(folder, name))
    for at in itertools.count():
        calls = itertools.count()

        def killed(*names, calls=calls, at=at, **folders):
            if next(calls) == at:
                raise KeyboardInterrupt
            os.rename(*names, **folders)

        with monkeypatch.context() as patch, suppress(KeyboardInterrupt):
            patch.setattr(os, "replace", killed)
            Export(str(few), out, "tusimple").write()
            break
        left = list(out.rglob("*.tmp"))
        assert left
        assert {path.parent.name for path in left} == {".parts"}
    assert at > 4
    assert files_of(out) == files_of(tmp_path / "whole")


def test_of_two_exports_the_second_says_so(few, tmp_path, monkeypatch):
    """However far the first has come: before its `export.json` has its name, and while it writes."""
    told, rename = [], os.replace

    def refused(*_):
        with pytest.raises(ClaimedError, match="expected no other export at work here, got one; wait until"):
            Export(str(few), tmp_path, "tusimple").write()

    def meanwhile(*names, **folders):
        monkeypatch.setattr(os, "replace", rename)
        refused()
        told.append(names)
        rename(*names, **folders)

    monkeypatch.setattr(os, "replace", meanwhile)
    first = Export(str(few), tmp_path, "tusimple").write(progress=refused)
    assert [str(name) for _, name in told] == ["export.json"]
    assert Export(str(few), tmp_path, "tusimple").write() == first


def test_counts_add_up_and_the_readme_names_every_reason(exported):
    _, out, summary = exported
    assert sum((summary.n_frames + summary.left_out).values()) == N_TRAIN + N_TEST
    readme = (out / "README.md").read_text()
    for reason, count in summary.dropped.items():
        assert f"| lane: {reason} | {count} |" in readme


def test_images_have_the_formats_size_and_every_line_of_text_ends(exported):
    format_name, out, summary = exported
    camera = FORMATS[format_name].camera
    images = [path for path in out.rglob("*.jpg") if path.is_file()]
    assert len(images) == sum(summary.n_frames.values())
    for path in images:
        with Image.open(path) as image:
            assert image.size == (camera.width_px, camera.height_px)
    assert_every_line_ends(out)


def test_running_again_and_running_in_parallel_give_the_same_bytes(exported, dataset, tmp_path):
    format_name, out, _ = exported
    before = files_of(out)
    Export(str(dataset), out, format_name).write()
    assert files_of(out) == before
    if format_name == "tusimple":
        Export(str(dataset), tmp_path / "parallel", format_name).write(2)
        assert files_of(tmp_path / "parallel") == before


def test_a_sample_is_exported_as_with_all_others(dataset, tmp_path):
    for name, source in (("all", f"{dataset}/train"), ("one", f"{dataset}/train:2")):
        Export(source, tmp_path / name, "openlane").write()
    one, every = files_of(tmp_path / "one"), files_of(tmp_path / "all")
    of_frames = {path for path in one if "00000002" in path and not path.startswith(".parts/")}
    assert {path.rpartition(".")[2] for path in of_frames} >= {"jpg", "json"}
    assert all(one[path] == every[path] for path in of_frames)
    assert not any("00000001" in path or "00000003" in path for path in one)
    assert any("00000001" in path for path in every)


def test_an_interrupted_export_continues_and_a_grown_dataset_is_added(write_split, tmp_path, monkeypatch):
    monkeypatch.setattr("synth3dlanes.formats.plan.FRAMES_PER_CHUNK", 2)
    root, out = tmp_path / "data", tmp_path / "out"
    write_split(root, "train", 5)

    def stop_after_three(done, total):
        if done > 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Export(str(root), out, "openlane").write(progress=stop_after_three)
    assert not (out / "lists").exists(), "an unfinished export has no list"
    progress = []
    Export(str(root), out, "openlane").write(progress=lambda done, total: progress.append(done))
    assert progress[0] == 4, "two chunks were kept"
    write_split(root, "train", 6)
    summary = Export(str(root), out, "openlane").write()
    assert summary.n_frames == {"train": 5, "test": 1}
    fresh = tmp_path / "fresh"
    Export(str(root), fresh, "openlane").write()
    assert files_of(out) == files_of(fresh)


def test_frames_without_lanes_come_last(dataset, tmp_path, monkeypatch):
    foreign = FORMATS["apollo"]

    def first_frame_is_bare(frame):
        bare = replace(frame, labels=cf.labels_of(frame.labels.camera))
        return foreign.write(bare if frame.key == "00000000" else frame)

    bare_once = replace(foreign, write=first_frame_is_bare)
    monkeypatch.setattr("synth3dlanes.formats.export.open_format", lambda name: bare_once)
    Export(str(dataset), tmp_path / "out", "apollo").write()
    lines = (tmp_path / "out/data_splits/standard/train.json").read_text().splitlines()
    assert [bool(json.loads(line)["laneLines"]) for line in lines] == [True] * (N_TRAIN - 1) + [False]


def test_a_folder_of_something_else_is_refused(few, tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(InputError, match="expected an empty folder"):
        Export(str(few), tmp_path, "once").write()
    out = tmp_path / "out"
    Export(str(few), out, "once").write()
    with pytest.raises(InputError, match="got that of"):
        Export(str(few), out, "tusimple").write()
    with pytest.raises(FormatError, match="expected a split of a data set"):
        Export(str(tmp_path / "out"), tmp_path / "other", "once").write()


def test_the_command_exports_and_verifies(few, tmp_path):
    from cli.export import export as command

    result = CliRunner().invoke(
        command, [str(few), "--format", "once", "--out", str(tmp_path / "out"), "--verify"], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    assert "3 train, 0 val, 1 test frames" in result.output
    assert "worst 0.0000 m, median 0.0000 m (at most 0.001 m)" in result.output


def test_narrow_frames_get_their_own_intrinsics_or_are_left_out_and_counted(write_split, tmp_path):
    root = tmp_path / "data"
    write_split(root, "train", 3, ["camera.horizontal_fov_deg={30: 1, 60: 1}"])
    own_f_px = [
        camera.img_from_cam[0, 0] for camera in (open_reader(f"{root}/train").labels(i).camera for i in range(3))
    ]
    narrow = [f_px for f_px in own_f_px if f_px > 500]
    assert 0 < len(narrow) < 3, "some frames are narrow and some are not"
    summaries = {name: Export(str(root), tmp_path / name, name).write() for name in PINHOLE}
    for name in ("openlane", "once", "tusimple"):
        assert sum(summaries[name].n_frames.values()) == 3
    assert list(summaries["apollo"].left_out.values()) == [len(narrow)]
    assert f"narrower than the format's one camera | {len(narrow)} |" in (tmp_path / "apollo/README.md").read_text()
    found = [json.loads(path.read_text())["intrinsic"][0][0] for path in tmp_path.glob("openlane/lane3d_1000/*/seg*/*")]
    assert sorted(found) == pytest.approx([2015.0] * (3 - len(narrow)) + [4 * f_px for f_px in narrow], abs=0.2)
    beside = [
        json.loads(line)["img_from_cv"][0][0] for line in (tmp_path / "tusimple/sidecar.jsonl").read_text().splitlines()
    ]
    own = [1280 / 480 * f_px for f_px in narrow]
    assert sorted(beside) == pytest.approx([2015 * 2 / 3] * (3 - len(narrow)) + own, abs=0.2)
    assert [
        result.problems
        for name in PINHOLE
        for result in verify(Export(str(root), tmp_path / name, name), 9)
        if result.problems
    ] == []
    write_split(tmp_path / "narrow", "train", 1, ["camera.horizontal_fov_deg=30"])
    job = Export(str(tmp_path / "narrow"), tmp_path / "nothing", "apollo")
    job.write()
    assert [result.problems for result in verify(job)] == [(f"{job.out}: expected lane lines to compare, found none",)]


@pytest.mark.parametrize(
    ("format_name", "width_px", "height_px"),
    first(2, [("openlane", 480, 320), ("once", 560, 280), ("openlane", 560, 280), ("once", 480, 320)]),
)
def test_images_of_another_size_have_pixels_and_intrinsics_to_match(
    write_split, tmp_path, format_name, width_px, height_px
):
    root, out = tmp_path / "data", tmp_path / "out"
    write_split(root, "train", 2, ["camera.roll_deg={-1: 1, 1: 1}"])
    job = Export(str(root), out, format_name, (width_px, height_px))
    summary = job.write()
    assert replace(job, out=Path("/elsewhere")).warnings(summary) == ()
    assert [result.problems for result in verify(job, 9) if result.problems] == []
    paths = sorted([*out.glob("lane3d_1000/training/seg*/*.json"), *out.glob("ONCE_3DLanes/train/*/cam01/*.json")])
    for index, path in enumerate(paths):
        document = json.loads(path.read_text())
        k = np.array(document.get("intrinsic", document.get("calibration")))
        original_f_px = {"openlane": 2015, "once": 958}[format_name]
        assert k[0, 0] >= original_f_px * width_px / 1920 - 1e-9
        np.testing.assert_allclose(k[:3, :3], [[k[0, 0], 0, width_px / 2], [0, k[0, 0], height_px / 2], [0, 0, 1]])
        name = path.relative_to(out).with_suffix(".jpg").as_posix()
        name = name.replace("lane3d_1000", "images").replace("ONCE_3DLanes/train", "ONCE_3DLanes/data")
        with Image.open(out / name) as image:
            assert image.size == (width_px, height_px)
            gray = np.asarray(image.convert("L")).astype(float)
        # The image shows lanes in white where an upright camera of these intrinsics sees those of our labels.
        labels = open_reader(f"{root}/train").labels(index)
        near_cam = [lane.xyz_cam[lane.visible & (lane.xyz_cam[:, 1] < 30)] for lane in labels.lanes]
        x_m, y_m, z_m = labels.camera.road_from_cam[:3, :3] @ np.concatenate(near_cam).T
        c, s = np.cos(labels.camera.pitch_rad), np.sin(labels.camera.pitch_rad)
        depth_m, down_m = c * y_m - s * z_m, -s * y_m - c * z_m
        u_px = k[0, 0] * x_m / depth_m + width_px / 2
        v_px = k[0, 0] * down_m / depth_m + height_px / 2
        inside = (u_px > 9) & (u_px < width_px - 9) & (v_px > 2) & (v_px < height_px - 2)
        assert inside.sum() > 20
        column, row = u_px[inside].astype(int), v_px[inside].astype(int)
        for aside_px, is_white in ((0, True), (7, False)):
            around = [gray[row + i, column + j + aside_px] for i in (-1, 0, 1) for j in (-1, 0, 1)]
            share = np.mean(np.max(around, axis=0) > 150)
            assert share > 0.95 if is_white else share < 0.5


@pytest.mark.parametrize("format_name", ["apollo", "tusimple"])
def test_formats_of_one_size_refuse_another(few, tmp_path, format_name):
    with pytest.raises(InputError, match=r"size: expected \d+x\d+, which the tools of"):
        Export(str(few), tmp_path / "out", format_name, (960, 640)).write()
    assert not (tmp_path / "out").exists()


def test_categories_are_those_of_the_scenes_paint(write_split, tmp_path):
    # The leftmost line of the road, and no other, is yellow and double.
    changes = ["markings.left_yellow=true", "markings.left_double=true", "road.topology=1", "camera.roll_deg=0"]
    write_split(tmp_path / "data", "train", 2, changes)
    Export(str(tmp_path / "data"), tmp_path / "out", "openlane").write()
    labels = open_reader(f"{tmp_path}/data/train").labels(0)
    leftmost = min((lane for lane in labels.lanes if lane.kind == "delimiter"), key=lambda lane: lane.xyz_cam[0, 0])
    (path,) = (tmp_path / "out/lane3d_1000/training").glob("*/train-00000000.json")
    seen = 0
    for line in json.loads(path.read_text())["lane_lines"]:
        gap_m = np.abs(-np.array(line["xyz"][1])[0] - np.interp(line["xyz"][0][0], *leftmost.xyz_cam[:, [1, 0]].T))
        is_leftmost = gap_m < 0.2
        seen += is_leftmost
        assert line["category"] in ((9, 10) if is_leftmost else (1, 2))
    assert seen == 1


@pytest.mark.parametrize(
    ("names", "parts", "dealt"),
    [
        (["test", "train"], ["test", "train"], False),
        (["test", "train", "val"], ["test", "train", "val"], False),
        (["test"], ["test"], False),
        (["validation"], ["val"], False),
        (["day", "night"], ["train", "train"], True),
        (["train"], ["train"], True),
    ],
)
def test_splits_keep_the_part_that_their_name_says(names, parts, dealt):
    splits = assign(names)
    assert [split.part for split in splits] == parts
    assert {split.part_of(4) for split in splits} == ({"test"} if dealt else set(parts))
    assert {split.part_of(3) for split in splits} == set(parts)
    assert parts_of(splits, has_test=True) == set(parts) | ({"test"} if dealt else set())
    assert parts_of(splits, has_test=False) == set(parts)


def test_an_unfinished_data_set_says_to_go_on(write_split, tmp_path):
    write_split(tmp_path / "data", "train", 1)
    (tmp_path / "data/train/00000.parquet").unlink()
    with pytest.raises(FormatError, match=r"expected finished shards .*, got none; run generate again$"):
        Export(str(tmp_path / "data"), tmp_path / "out", "once").write()


def test_a_set_for_tests_alone_gives_no_training_frames(write_split, tmp_path):
    write_split(tmp_path / "data", "test", 6)
    for name in PINHOLE:
        summary = Export(str(tmp_path / "data"), tmp_path / name, name).write()
        assert set(summary.n_frames) == {"test"}
        assert "tools that open val find the test frames" in (tmp_path / name / "README.md").read_text()
    assert not (tmp_path / "apollo/data_splits/standard/train.json").exists()
    assert not (tmp_path / "openlane/images/training").exists()
    assert not (tmp_path / "once/ONCE_3DLanes/train").exists()
    assert (tmp_path / "tusimple/label_data_0313.json").read_text() == ""
    lists = {path.name for path in (tmp_path / "openlane/lane3d_1000/test").glob("*.txt")}
    assert lists == {  # what public evaluation scripts of OpenLane open
        "1000_curve.txt",
        "1000_extreme_weather.txt",
        "1000_intersection.txt",
        "1000_merge_split_case.txt",
        "1000_night.txt",
        "1000_updown.txt",
    }


@pytest.mark.parametrize("format_name", first(1, ["apollo", "openlane"]))
def test_frames_that_were_made_again_are_exported_again(format_name, write_split, tmp_path):
    root, out, fresh = tmp_path / "data", tmp_path / "out", tmp_path / "fresh"
    write_split(root, "train", 5)
    Export(str(root), out, format_name).write()
    before = files_of(out)
    shutil.rmtree(root)
    write_split(root, "train", 2, ["camera.height_m=1.77"])
    for folder in (out, fresh):
        Export(str(root), folder, format_name).write()
    assert files_of(out) == files_of(fresh)
    assert before.keys() - files_of(out).keys(), "images and lists of the frames that are gone"


def test_warnings_of_replaced_words_and_of_enlarged_images(write_split, tmp_path, monkeypatch):
    write_split(tmp_path / "data", "train", 2)
    monkeypatch.chdir(tmp_path)
    for out, n_words in (("evaluation", 1), ("plain", 0)):
        summary = Export("data", Path(out), "once").write()
        # 480 px become 1920 px.
        assert summary.enlarged == pytest.approx(4, abs=0.01)
        found = Export("data", Path("/elsewhere") / out, "once").warnings(summary)
        assert len([line for line in found if line.endswith("replace val in the whole path: move it")]) == n_words
        assert [line for line in found if "enlarged 4.0 times to 1920x1020" in line]


@pytest.mark.parametrize("place", ["files", "shared"])
def test_marks_of_an_export_name_no_file_elsewhere(few, tmp_path, place):
    """Of a chunk that is not wanted any more, the files are removed: only those of the export."""
    out, mine = tmp_path / "out", tmp_path / "mine.txt"
    mine.write_text("mine")
    Export(str(few), out, "apollo").write()
    record = {"left_out": None, "n_lines": 0, "files": [], "shared": []}
    for path in ("../mine.txt", str(mine)):
        named = {"files": [path]} if place == "files" else {"shared": [["text", [path]]]}
        (out / ".parts/stale").write_text(json.dumps(record | named))
        with pytest.raises(FormatError, match=r"stale:1: .*expected a path below the folder, got "):
            Export(str(few), out, "apollo").write()
        assert mine.read_text() == "mine"
    (out / "export.json").write_text("[" * 10_000)
    with pytest.raises(FormatError, match=r"export\.json: expected a JSON document"):
        Export(str(few), out, "apollo").write()


# Cosmos has clips: its writer is that of the others.
@pytest.mark.parametrize(
    "format_name",
    first(2, sorted({*format_names()} - {"cosmos"}, key=lambda name: (name not in ("tusimple", "masks"), name))),
)
def test_a_full_disk(two_frames, tmp_path, format_name):
    from synth3dlanes_cli.main import main

    words = ["export", str(two_frames), "--format", format_name, "--out", str(tmp_path / "out")]
    (tmp_path / "out").mkdir()
    withstands(lambda: CliRunner().invoke(main, words), tmp_path / "out")


OTHERS = ["tusimple", "openlane", "once", "culane", "curvelanes", "opendrive", "lanelet2"]


@pytest.mark.parametrize(("format_name", "n_cuts"), first(1, [("tusimple", 5), *((name, 8) for name in OTHERS)]))
def test_an_export(few, tmp_path, monkeypatch, format_name, n_cuts):
    # Several chunks, each with its mark.
    monkeypatch.setattr("synth3dlanes.formats.plan.FRAMES_PER_CHUNK", 2)
    survive(lambda out: Export(str(few), out, format_name).write(), tmp_path, n_cuts)
