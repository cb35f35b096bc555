"""One value says which data to make: in Python, as options, in a file, with the condition that scenes fit."""

import functools
import json
import os
import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.generate import FIELDS
from synth3dlanes_cli.main import main

import synth3dlanes as s3d
from synth3dlanes.dataset.columns import TEXTS, numbers_of
from synth3dlanes.dataset.description import updated_description
from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes, draw_world, sample_scene
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.production import job as jobs
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Condition, Recipe, fitting_world
from synth3dlanes.production.run import generate
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.validate.origin import read_origin
from tests import fake_samples
from tests.maps.files import opendrive, plan, road

SMALL = ("trees.n=2", "cars.n=1")


@pytest.fixture
def without_blender(monkeypatch: pytest.MonkeyPatch, in_tmp_path: Path) -> Path:
    monkeypatch.setattr(jobs, "Plan", functools.partial(Plan, maker=fake_samples.make))
    return in_tmp_path


def described(job: s3d.Job) -> dict[str, object]:
    """What decides every byte of the first split, as dataset.json has it."""
    document: dict[str, object] = json.loads(json.dumps(job.recipe().description()))
    return document


def test_every_field_is_an_option_and_every_option_says_what_its_field_does() -> None:
    assert sorted(FIELDS) == sorted(s3d.Job.model_fields)
    help_text = " ".join(CliRunner().invoke(main, ["generate", "--help"]).stdout.split())
    for field in s3d.Job.model_fields.values():
        assert field.description
        assert " ".join(field.description.split()) in help_text


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("n: -1", "n: expected at least 0, got -1"),
        ("n: '5'", "n: expected a whole number, got '5'"),
        ("sed: 1", "sed: unknown key; did you mean seed?"),
        ("seed: 1.5", "seed: expected a whole number, got 1.5"),
        ("{frames: 2, fps: .nan}", "fps: expected a finite number, got nan"),
        ("at: '1:2:-1'", "at: expected none without map"),
        ("tries: 5", "tries: expected none without where"),
        ("{n: 1, splits: {train: 1}}", "splits: expected none beside n"),
        ("splits: {a/b: 1}", "splits.a/b: expected text of the form ^[A-Za-z0-9_-]+$, got 'a/b'"),
        ("splits: {train: many}", "splits.train: expected a whole number, got 'many'"),
        ("part: [0, 2]", "part: expected i/n with 1 <= i <= n, such as 2/8, got [0, 2]"),
        ("workers: some", "workers: expected auto or a number of processes, got 'some'"),
        ("passes: [depth, deth]", "passes: expected one of depth, normal, semantic, instance, height, or all, got "),
        ("device: gpu", "device: expected 'auto', 'cpu', 'cuda', 'optix', 'hip', 'oneapi' or 'metal', got 'gpu'"),
        ("camera: 3", "camera: expected a name, a file, or keys of a camera, got 3"),
        ("camera: {width_px: 640}", "camera.height_px: missing"),
        ("params: [1]", "params: expected the name of a preset, a file, or groups of parameters, got [1]"),
        ("like: [5]", "like.0: expected a list, got 5"),
        ("set: [cars.n=1, cars.n=2]", "set cars.n: expected one value, got 2"),
        ("{camera: kitti, set: [camera.pitch_deg=1]}", "camera.pitch_deg=1: no effect with camera, whose file has it"),
        ("- n", "expected the fields of a job such as n, got ['n']"),
        ("{n: 1", "line 1: not YAML: "),
    ],
)
def test_a_bad_field_of_a_file_is_one_line(text: str, problem: str, in_tmp_path: Path) -> None:
    Path("job.yaml").write_text(text)
    result = CliRunner().invoke(main, ["generate", "job.yaml", "--out", "d"])
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1), result.output
    assert result.stderr.startswith(f"job.yaml: {problem}")
    with pytest.raises(s3d.InputError, match=re.escape(f"job.yaml: {problem}")):
        s3d.load_job("job.yaml")
    assert os.listdir() == ["job.yaml"]


def of_names() -> s3d.Job:
    return s3d.Job(n=3, out="d", params="tiny", set=SMALL, seed=3, rig="nuscenes", frames=2, fps=5, lidar="hdl_32e")


def of_values() -> s3d.Job:
    """The same, of what the library has read."""
    params, rig, lidar = s3d.load_params("tiny", SMALL), s3d.load_rig("nuscenes"), load_lidar("hdl_32e")
    return s3d.Job(n=3, out="d", params=params, seed=3, rig=rig, frames=2, fps=5, lidar=lidar)


def near_others() -> s3d.Job:
    params = s3d.load_params("tiny", (*SMALL, "weather.kind={any: 1, fog: 1}"))
    like = [s3d.sample_scene(params, seed=5, index=index) for index in (4, 1)]
    return s3d.Job(n=2, out="d", params=params, seed=9, like=like, spreads=("0.2", "camera.pitch_deg=0.4"))


def on_a_map() -> s3d.Job:
    Path("maps").mkdir(exist_ok=True)
    path = Path("maps/x.xodr")
    path.write_bytes(opendrive(road(plan(("<line/>", 400.0)))))
    return s3d.Job(n=1, out="d", params="tiny", map=path, at="1:30.5:-1", passes="depth,height", quality="train")


def that_fit() -> s3d.Job:
    return s3d.Job(splits={"train": 2, "1e3": 1}, out="d", params="tiny", where="n_lanes > 2", image_format="png")


def of_keys() -> s3d.Job:
    params = {"base": "tiny", "cars": {"n": 1}, "light": {"exposure": [1, 2]}}
    return s3d.Job(n=1, out="d", params=params, camera=s3d.load_camera("kitti"), samples=2, device="cpu")


JOBS = (of_names, of_values, near_others, on_a_map, that_fit, of_keys)


@pytest.mark.parametrize("made", JOBS)
def test_a_job_that_is_written_and_read_makes_the_same(made: Callable[[], s3d.Job], in_tmp_path: Path) -> None:
    """Also from another folder, to which its relative paths are written anew."""
    job = made()
    Path("jobs").mkdir()
    for path in ("job.yaml", "jobs/job.yaml"):
        s3d.save_job(job, path)
        read = s3d.load_job(path)
        assert described(read) == described(job)
        assert read.asked == job.asked
        assert os.path.normpath(str(read.out)) == "d"
    assert described(of_names()) == described(of_values())


@pytest.mark.parametrize("made", JOBS)
def test_dataset_json_holds_the_job(made: Callable[[], s3d.Job], in_tmp_path: Path) -> None:
    """A map is looked for beside it: a data set keeps its name, its digest and the host's place."""
    job, written = made(), None
    for each in job.plans():
        written = updated_description(written, each.description(), each.recipe.scenes.split, each.n, "d")
    Path("maps").mkdir(exist_ok=True)
    Path("maps/dataset.json").write_bytes(written or b"")
    again = s3d.load_job("maps/dataset.json")
    assert described(again) == described(job)
    assert (again.asked, again.settings) == (job.asked, job.settings)


def test_keywords_options_and_a_file_are_the_same_request(without_blender: Path) -> None:
    """The bytes, of several splits too; an option comes before what a file says."""
    report = s3d.generate_dataset(s3d.load_params("tiny", SMALL), "a", n=3, seed=4, workers=1)
    assert s3d.generate_dataset(s3d.load_params("tiny", SMALL), "a", n=2, seed=4, split="val").done == 2
    assert report.done == 3
    s3d.save_job(s3d.Job(splits={"train": 3, "val": 2}, params="tiny", set=SMALL, seed=4, out="b"), "job.yaml")
    words = ["generate", "job.yaml", "--out", "c", "--workers", "1", "--quiet"]
    result = CliRunner().invoke(main, [*words, "--save-job", "other.yaml"])
    assert result.exit_code == 0, result.output
    assert [line.split(",")[0] for line in result.stdout.splitlines()] == [
        "c/train: 3 of 3 samples", "c/val: 2 of 2 samples"
    ]  # fmt: skip
    assert s3d.load_job("other.yaml").document() == {
        "out": "c", "splits": {"train": 3, "val": 2}, "seed": 4, "params": "tiny", "set": list(SMALL), "workers": 1
    }  # fmt: skip
    for path in ("dataset.json", "train/00000.tar", "val/00000.tar"):
        assert Path("a", path).read_bytes() == Path("c", path).read_bytes()
    assert not Path("b").exists()
    result = CliRunner().invoke(main, ["generate", "c/dataset.json", "--out", "f"])
    assert result.exit_code == 0, result.output
    for path in ("dataset.json", "train/00000.tar", "val/00000.tar"):
        assert Path("f", path).read_bytes() == Path("c", path).read_bytes()
    assert "made by version" not in result.stderr
    older = Path("f/dataset.json").read_text().replace(s3d.__version__, "0.2.0")
    Path("older.json").write_text(older)
    result = CliRunner().invoke(main, ["generate", "older.json", "--out", "g", "--dry-run"])
    assert result.stderr.startswith("older.json: made by version 0.2.0; version ")
    fewer = CliRunner().invoke(main, ["generate", "job.yaml", "--n", "1", "--split", "test", "--out", "b", "--json"])
    assert json.loads(fewer.stdout)["asked"] == 1
    assert list(json.loads(Path("b/dataset.json").read_text())["splits"]) == ["test"]


def test_a_derived_data_set_is_none_of_generate(without_blender: Path) -> None:
    s3d.generate_dataset(params="tiny", out="a", n=3, workers=1)
    s3d.split_dataset("a/train", "b", {"x": 0.5, "y": 0.5})
    with pytest.raises(s3d.InputError, match=r"b/dataset\.json: expected a data set that generate made"):
        s3d.load_job("b/dataset.json")
    with pytest.raises(s3d.InputError, match="seed: expected none beside job"):
        s3d.generate_dataset(s3d.Job(n=1, out="c"), seed=3)


def test_passes_settings_and_parts_as_people_write_them() -> None:
    job = s3d.Job(passes="height, depth", quality="high", lidar="hdl_32e", part="2/3", workers="auto")
    assert job.settings == RenderSettings(8, ("depth", "height", "lidar"), "auto")
    assert (job.part, job.workers) == ((2, 3), 0)
    assert s3d.Job(passes="all").passes == ("depth", "normal", "semantic", "instance", "height")


FEW = ("cars.n=1", "trees.n=4")
QUERY = "max_grade > 0.05 and junction = 'merge'"
OF_ONE = 100_000


def recipe(query: str | None = QUERY, frames: int = 1, tries: int = 100) -> Recipe:
    motion = () if frames == 1 else ("motion.host_speed_m_s=10",)
    scenes = Scenes(load_params("tiny", [*FEW, *motion]), 5, "train", shots=clips(frames, 5.0))
    condition = Condition(query, tries) if query else None
    return Recipe(scenes, RenderSettings(), "png", where=condition)


def is_steep_merge(scene: Scene) -> bool:
    """The same condition from the scene and the points of its labels, without the index."""
    labels = ground_truth(scene)
    up_cam = labels.camera.world_from_cam[2, :3]
    grades = [0.0]
    for lane in labels.lanes:
        if lane.kind == "centerline" and lane.road == "main":
            steps = np.diff(lane.xyz_cam, axis=0)
            rises = steps @ up_cam
            grades.append(np.abs(rises / np.sqrt((steps**2).sum(axis=1) - rises**2)).max())
    assert scene.road is not None
    return scene.road.topology > 1 and scene.road.flip_lateral and max(grades) > 0.05


def test_a_sample_shows_the_first_of_its_scenes_that_fits() -> None:
    """And no other: all scenes before it are drawn here, and judged without the index."""
    made = recipe()
    for n in range(3):
        shown = made.scene(n)
        tried = (sample_scene(made.scenes, number) for number in range(n * OF_ONE, n * OF_ONE + 100))
        first = next(scene for scene in tried if is_steep_merge(scene))
        assert shown == first
        assert first.index // OF_ONE == n
    assert any(made.scene(n).index % OF_ONE for n in range(3)), "not only first scenes fit"


def test_while_none_fits_a_line_says_so_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("synth3dlanes.production.recipe.TELL_EVERY_S", 0.0)
    told = list[str]()
    with pytest.raises(InputError, match="expected a scene that fits, got none in 3 tries for sample 0"):
        jobs.Job(n=1, out="none", params="tiny", where="max_grade > 99", tries=3).plans(told.append)
    assert told == [f"where max_grade > 99: 0 of {n} scenes drawn fit; at most 3 are drawn" for n in (1, 2, 3)]


@pytest.mark.parametrize("column", sorted(TEXTS))
def test_a_text_that_no_scene_has_is_refused_before_any_second_one_is_drawn(column: str) -> None:
    told = list[str]()
    query = f"n_lanes > 0 and {column} = 'nobody'"
    with pytest.raises(InputError, match=f"^where .*: expected {column} to be one of .*, got 'nobody'"):
        recipe(query).where.probe(recipe(query).scenes, told.append)  # type: ignore[union-attr]
    assert not told


def test_texts_of_columns_are_all_that_scenes_have() -> None:
    found = defaultdict[str, set[str]](set)
    for preset in ("streets", "town"):
        for number in range(3):
            world = draw_world(Scenes(load_params(preset), 3, "train"), number)
            row = numbers_of(world.scene, label(world, world.view))
            for column in TEXTS:
                found[column].add(row[column])
    assert {column for column, texts in found.items() if not texts <= set(TEXTS[column])} == set()
    names = {name for name, value in row.items() if isinstance(value, str)}
    assert names == {*TEXTS, "camera_name"}


def test_all_frames_of_a_clip_show_the_scene_that_its_first_one_fits() -> None:
    made = recipe(frames=3)
    scenes = [made.scene(index) for index in range(3, 6)]
    assert {scene.index for scene in scenes} == {fitting_world(made.scenes, made.where, 1).scene.index}  # type: ignore[arg-type]
    assert [scene.shot.frame for scene in scenes] == [0, 1, 2]
    assert is_steep_merge(scenes[0])


@pytest.mark.thorough
def test_a_set_is_the_same_for_other_workers_and_after_a_stop(tmp_path: Path) -> None:
    plan = Plan(tmp_path / "whole", 5, recipe(), 1, maker=fake_samples.make_labelled)
    generate(plan, lambda event: None)
    for n in (2, 5):
        generate(replace(plan, out=tmp_path / "more", n=n, workers=2), lambda event: None)
    whole, more = ((tmp_path / name / "train/00000.tar").read_bytes() for name in ("whole", "more"))
    assert whole == more
    description = json.loads((tmp_path / "whole/dataset.json").read_text())
    assert description["where"] == QUERY
    reader = Reader(tmp_path / "whole/train")
    assert reader.index["junction"].to_pylist() == ["merge"] * 5
    assert min(reader.index["max_grade"].to_pylist()) > 0.05
    with pytest.raises(InputError, match="where"):
        generate(replace(plan, recipe=recipe(None)), lambda event: None)


def test_the_scene_of_a_sample_is_checked_against_the_condition() -> None:
    made = recipe()
    origin = read_origin(json.loads(json.dumps(made.description())))
    shown = [made.scene(n) for n in range(2)]
    assert [origin.fault(scene, "train", n) for n, scene in enumerate(shown)] == ["", ""]
    assert "index: expected one of the scenes of sample 0, got " in origin.fault(shown[1], "train", 0)
    unfit = next(
        scene for scene in (sample_scene(made.scenes, number) for number in range(100)) if not is_steep_merge(scene)
    )
    assert f"expected a scene where {QUERY}, got another" in origin.fault(unfit, "train", 0)
    edited = shown[0].model_copy(update={"air": shown[0].air.model_copy(update={"overcast": 0.5})})
    assert "overcast" in origin.fault(edited, "train", 0)


def test_the_share_that_fits_is_said(in_tmp_path: Path) -> None:
    command = ["generate", "--n", "2", "--params", "tiny", "--out", "d", "--device", "cpu", "--dry-run"]
    scenes = Scenes(load_params("tiny"), 0, "train")
    n_lanes = [sample_scene(scenes, number).paper_road.n_lanes for number in range(30)]
    told = CliRunner().invoke(main, [*command, "--where", "n_lanes = 3"]).stdout
    assert f"where n_lanes = 3 ({n_lanes.count(3)} of the first 30 scenes drawn fit)" in told
