"""Whole exports of a small dataset: layout, self-check, resuming, and the image's change of intrinsics."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from synth3dlanes.errors import InputError
from synth3dlanes.formats.export import FORMATS, export
from synth3dlanes.formats.resample import resample, source_pixels
from synth3dlanes.formats.verify import verify
from synth3dlanes.formats.writing import Pinhole
from tests.formats import closed_form as cf

N_TRAIN, N_TEST = 7, 4
SIZE_PX = {"apollo": (1920, 1080), "openlane": (1920, 1280), "once": (1920, 1020), "tusimple": (1280, 720)}
APOLLO, OPENLANE = (FORMATS[name].camera for name in ("apollo", "openlane"))


@pytest.fixture(scope="module", params=FORMATS)
def exported(request, dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("exports") / request.param
    seen = []
    summary = export(str(dataset), out, request.param, 1, lambda done, total: seen.append((done, total)))
    assert seen[0] == (0, N_TRAIN + N_TEST)
    assert seen[-1] == (N_TRAIN + N_TEST, N_TRAIN + N_TEST)
    return request.param, out, summary


def files_of(out):
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


def test_every_list_scores_perfectly_and_moved_aside_not_at_all(exported):
    format_name, out, summary = exported
    results = verify(out, format_name, most_frames=100)
    assert sum(result.n_lines for result in results) >= summary.n_lines > 20
    assert [result.problems for result in results] == [()] * len(results)


def test_counts_add_up_and_the_readme_names_every_reason(exported):
    _, out, summary = exported
    assert (summary.n_train + summary.n_test + summary.n_left_out) == N_TRAIN + N_TEST
    readme = (out / "README.md").read_text()
    for reason, count in summary.dropped.items():
        assert f"| {reason} | {count} |" in readme


def test_images_have_the_formats_size_and_no_list_ends_in_a_blank_line(exported):
    format_name, out, summary = exported
    size_px = SIZE_PX[format_name]
    images = [path for path in out.rglob("*.jpg") if path.is_file()]
    assert len(images) == summary.n_train + summary.n_test
    for path in images:
        with Image.open(path) as image:
            assert image.size == size_px
    for path in [*out.glob("data_splits/*/*.json"), *out.rglob("*.txt"), *out.glob("*label*.json")]:
        assert path.read_text().strip("\n") == path.read_text() != ""


def test_a_problem_is_found_when_there_is_one(exported, tmp_path):
    format_name, out, _ = exported
    if format_name != "apollo":
        image = next(path for path in out.rglob("*.jpg"))
        image.rename(tmp_path / "moved.jpg")
        assert any(result.problems for result in verify(out, format_name, 100))
        (tmp_path / "moved.jpg").rename(image)
    else:
        path = out / "data_splits/standard/test.json"
        good = path.read_text()
        document = json.loads(good.splitlines()[0])
        # Another line beyond the band that the evaluator looks at.
        document["laneLines"].append([[15.0, y, 0.0] for y in range(1, 100)])
        document["laneLines_visibility"].append([1.0] * 99)
        path.write_text(json.dumps(document))
        assert any(result.problems for result in verify(out, format_name, 100))
        path.write_text(good)


def test_running_again_and_running_in_parallel_give_the_same_bytes(exported, dataset, tmp_path):
    format_name, out, _ = exported
    before = files_of(out)
    export(str(dataset), out, format_name, 1, lambda done, total: None)
    assert files_of(out) == before
    if format_name == "tusimple":
        export(str(dataset), tmp_path / "parallel", format_name, 2, lambda done, total: None)
        assert files_of(tmp_path / "parallel") == before


def test_an_interrupted_export_continues_and_a_grown_dataset_is_added(write_split, tmp_path, monkeypatch):
    monkeypatch.setattr("synth3dlanes.formats.export.FRAMES_PER_CHUNK", 2)
    root, out = tmp_path / "data", tmp_path / "out"
    write_split(root, "train", 5)

    def stop_after_three(done, total):
        if done > 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(str(root), out, "openlane", 1, stop_after_three)
    assert not (out / "lists").exists(), "an unfinished export has no list"
    progress = []
    export(str(root), out, "openlane", 1, lambda done, total: progress.append(done))
    assert progress[0] == 4, "two chunks were kept"
    write_split(root, "train", 6)
    from synth3dlanes.formats.export import _reader

    _reader.cache_clear()
    summary = export(str(root), out, "openlane", 1, lambda done, total: None)
    assert (summary.n_train, summary.n_test) == (5, 1)
    fresh = tmp_path / "fresh"
    export(str(root), fresh, "openlane", 1, lambda done, total: None)
    assert files_of(out) == files_of(fresh)


def test_frames_without_lanes_come_last(dataset, tmp_path, monkeypatch):
    foreign = FORMATS["apollo"]

    def first_frame_is_bare(labels, frame):
        bare = cf.labels_of(labels.camera)
        return foreign.annotate(bare if frame.key == "00000000" else labels, frame)

    monkeypatch.setitem(FORMATS, "apollo", replace(foreign, annotate=first_frame_is_bare))
    export(str(dataset), tmp_path / "out", "apollo", 1, lambda done, total: None)
    lines = (tmp_path / "out/data_splits/standard/train.json").read_text().splitlines()
    assert [bool(json.loads(line)["laneLines"]) for line in lines] == [True] * (N_TRAIN - 1) + [False]


def test_a_folder_of_something_else_is_refused(dataset, tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(InputError, match="expected an empty folder"):
        export(str(dataset), tmp_path, "once", 1, lambda done, total: None)
    out = tmp_path / "out"
    export(str(dataset), out, "once", 1, lambda done, total: None)
    with pytest.raises(InputError, match="got the export"):
        export(str(dataset), out, "tusimple", 1, lambda done, total: None)
    with pytest.raises(InputError, match="expected a dataset"):
        export(str(tmp_path / "out"), tmp_path / "other", "once", 1, lambda done, total: None)


def test_the_command_exports_and_verifies(dataset, tmp_path):
    from cli.export import export as command

    result = CliRunner().invoke(
        command, [str(dataset), "--format", "once", "--out", str(tmp_path / "out"), "--verify"], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    assert f"{N_TRAIN} training and {N_TEST} test frames" in result.output
    assert "ground truth: f_score 1.0000" in result.output


def test_a_rolled_camera_exports_the_labels_of_one_without_roll(write_split, tmp_path):
    shift = "camera.principal_offset_px=[-8, 8]"
    write_split(tmp_path / "level", "train", 2, [shift])
    write_split(tmp_path / "rolled", "train", 2, [shift, "camera.roll_deg={-2: 1, 2: 1}"])
    files = {}
    for name in ("level", "rolled"):
        for format_name in FORMATS:
            out = tmp_path / f"{name}-{format_name}"
            export(str(tmp_path / name), out, format_name, 1, lambda done, total: None)
            assert [result.problems for result in verify(out, format_name, 10) if result.problems] == []
            texts = {path.relative_to(out): path.read_text() for path in sorted(out.rglob("*.json"))}
            files[name, format_name] = {path: text for path, text in texts.items() if path.name != "export.json"}
    # OpenLane's lines begin at the image's border, where the labels' rounding decides on a point.
    for format_name in FORMATS.keys() - {"openlane"}:
        level, rolled = files["level", format_name], files["rolled", format_name]
        assert level.keys() == rolled.keys()
        for path in level:
            a, b = (np.array(re.findall(r"-?\d+\.\d+", text), dtype=float) for text in (level[path], rolled[path]))
            np.testing.assert_allclose(a, b, atol=2e-3, err_msg=str(path))


# ---- images


@pytest.mark.parametrize("view", [foreign.camera for foreign in FORMATS.values()])
@pytest.mark.parametrize(("size_px", "roll_rad"), [((480, 360), 0), ((960, 640), 0.02), ((1920, 1280), 0)])
def test_a_mark_lands_where_the_foreign_camera_sees_it(view, size_px, roll_rad):
    f_px = 0.86 * size_px[0]
    camera = cf.camera_label(size_px=size_px, f_px=f_px, roll_rad=roll_rad)
    points_img = np.array([[view.width_px * 0.3, view.height_px * 0.7], [view.width_px * 0.8, view.height_px * 0.4]])
    rows, columns = np.mgrid[0 : size_px[1], 0 : size_px[0]] + 0.5
    for point_img in points_img:
        u_px, v_px = source_pixels(camera, view, point_img[None])[0]
        spread_px = 3 * f_px / view.f_px + 2
        spot = np.exp(-((columns - u_px) ** 2 + (rows - v_px) ** 2) / (2 * spread_px**2))
        image = np.repeat((200 * spot)[..., None].astype(np.uint8), 3, axis=2)
        found = np.asarray(resample(image, camera, view, "test"))[..., 0].astype(float)
        v_grid, u_grid = np.mgrid[0 : view.height_px, 0 : view.width_px] + 0.5
        centroid = np.array([(found * u_grid).sum(), (found * v_grid).sum()]) / found.sum()
        np.testing.assert_allclose(centroid, point_img, atol=0.15)


@pytest.mark.parametrize("roll_rad", [0.0, 0.03])
def test_source_pixels_are_the_same_rays(roll_rad):
    camera, level = (cf.camera_label(size_px=(480, 360), f_px=415.7, roll_rad=roll) for roll in (roll_rad, 0.0))
    points_cv = np.array([[1.0, 0.5, 8.0], [-3.0, 1.2, 20.0]])
    points_road = (points_cv[:, [0, 2, 1]] * [1, 1, -1]) @ level.road_from_cam[:3, :3].T
    homogeneous = points_road @ camera.road_from_cam[:3, :3] @ camera.img_from_cam.T
    ours_img = homogeneous[:, :2] / homogeneous[:, 2:]
    np.testing.assert_allclose(source_pixels(camera, APOLLO, APOLLO.project(points_cv)), ours_img, atol=1e-9)


def test_a_native_image_is_not_touched_and_a_narrow_one_is_refused():
    pixels = np.random.default_rng(0).integers(0, 255, (1280, 1920, 3), dtype=np.uint8)
    native = cf.camera_label(size_px=(1920, 1280), f_px=2014.9991)
    np.testing.assert_array_equal(np.asarray(resample(pixels, native, OPENLANE, "test")), pixels)
    cropped = np.asarray(resample(pixels, cf.camera_label(), APOLLO, "test"))
    np.testing.assert_array_equal(cropped, pixels[100:1180])
    narrow = cf.camera_label(size_px=(1920, 1280), f_px=2100.0)
    with pytest.raises(InputError, match=r"^DIR/train:00000000: expected an image that covers 1920x1280"):
        resample(pixels, narrow, OPENLANE, "DIR/train:00000000")
    with pytest.raises(InputError, match="expected an image of 1920x1280 as in its labels, got 640x480"):
        resample(np.zeros((480, 640, 3), dtype=np.uint8), cf.camera_label(), Pinhole(100, 100, 2015.0), "x")


@pytest.mark.parametrize("name", ["apollo", "openlane"])
def test_camera_presets_render_natively_and_change_nothing_else(name):
    from synth3dlanes.ground_truth import ground_truth
    from synth3dlanes.params import load_params
    from synth3dlanes.sample import sample_scene

    params, base = load_params(f"{name}_camera"), load_params("appendix_i")
    view = FORMATS[name].camera
    camera = ground_truth(sample_scene(params, 0, "train", 0)).camera
    pixels = np.random.default_rng(0).integers(0, 255, (view.height_px, view.width_px, 3), dtype=np.uint8)
    np.testing.assert_array_equal(np.asarray(resample(pixels, camera, view, "test")), pixels)
    changed = {"width_px", "height_px", "horizontal_fov_deg"}
    for group in type(params).model_fields:
        for key, value in getattr(params, group):
            assert value == getattr(getattr(base, group), key) or key in changed
