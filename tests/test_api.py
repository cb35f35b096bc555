"""What 'import synth3dlanes' offers is typed, documented, lazy, checks its arguments, and equals the commands."""

import ast
import hashlib
import inspect
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import synth3dlanes
import synth3dlanes as s3d
from synth3dlanes import renderer as of_renderer
from synth3dlanes.draw.given_map import place_on_map
from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples
from tests.maps.files import opendrive, plan, road


def test_every_name_has_a_type_and_a_home() -> None:
    """A type checker reads the imports under TYPE_CHECKING; they must name what a program gets."""
    tree = ast.parse(Path(synth3dlanes.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    declared = {alias.name: node.module for node in block.body for alias in node.names}
    assert sorted(declared) == synth3dlanes.__all__
    for name, module in declared.items():
        assert getattr(synth3dlanes, name) is getattr(sys.modules[module], name)
    assert set(synth3dlanes.__all__) < set(dir(synth3dlanes))
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = synth3dlanes.no_such_name


def test_importing_it_loads_nothing_of_it() -> None:
    command = [sys.executable, "-c", "import sys, synth3dlanes; print(*sys.modules)"]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True, timeout=240).stdout.split()
    assert [name for name in loaded if name.startswith(("synth3dlanes", "numpy", "pydantic"))] == ["synth3dlanes"]


def test_a_scene_is_that_of_the_data_set(tmp_path: Path) -> None:
    from click.testing import CliRunner
    from synth3dlanes_cli.main import main

    params = synth3dlanes.load_params("appendix_i", "cars.n=3")
    scene = synth3dlanes.sample_scene(params, seed=2, split="val", index=5)
    words = ["sample", "--seed", "2", "--split", "val", "--index", "5", "--set", "cars.n=3"]
    assert json.loads(CliRunner().invoke(main, words).stdout) == scene.model_dump(mode="json")
    synth3dlanes.save_scene(scene, tmp_path / "scene.json")
    assert synth3dlanes.load_scene(str(tmp_path / "scene.json")) == scene


def a_map(folder: Path) -> Path:
    """An OpenDRIVE file with one road of two lanes."""
    path = folder / "x.xodr"
    path.write_bytes(opendrive(road(plan(("<line/>", 400.0)))))
    return path


def test_a_scene_on_a_map_is_that_of_the_recipe(tmp_path: Path) -> None:
    params, path = synth3dlanes.load_params("tiny", "trees.n=0"), a_map(tmp_path)
    scene = synth3dlanes.sample_scene(params, seed=2, index=5, map=path)
    assert scene == sample_scene(Scenes(params, 2, "train", map=place_on_map(path)), 5)
    assert (scene.map.source, scene.map.digest) == ("x.xodr", hashlib.sha256(path.read_bytes()).hexdigest())
    there = synth3dlanes.sample_scene(params, map=str(path), at="1:30.5:-1")
    assert (there.map.route, there.camera.y_m) == (("1.0.-1",), 30.5)
    with pytest.raises(synth3dlanes.InputError, match="map: expected none beside like"):
        synth3dlanes.generate_dataset(params, tmp_path / "out", n=2, like=[scene], map=path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"map": "x.xodr", "at": "1:30"}, "at: expected ROAD:s:lane"),
        ({"map": "none.xodr"}, "map none.xodr: cannot read"),
        ({"map": "bad.xodr"}, "map bad.xodr: expected XML"),
    ],
)
def test_maps_that_are_none_are_refused(
    options: dict[str, str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    a_map(tmp_path)
    Path("bad.xodr").write_text("no")
    params = synth3dlanes.load_params("tiny")
    for draw in (synth3dlanes.sample_scene, partial(synth3dlanes.generate_dataset, out=tmp_path / "out", n=1)):
        with pytest.raises((synth3dlanes.InputError, synth3dlanes.FormatError), match=re.escape(message)):
            draw(params, **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.render
def test_a_render_is_what_a_data_set_has(tmp_path: Path) -> None:
    """To the byte, once it is saved."""
    names = ("height", "depth", "instance")
    params = synth3dlanes.load_params("tiny", "trees.n=3")
    report = synth3dlanes.generate_dataset(params, tmp_path, n=1, seed=4, passes=names, image_format="png", workers=1)
    assert (report.done, report.problem) == (1, "")
    reader = synth3dlanes.open_dataset(tmp_path)
    scene = synth3dlanes.read_scene(reader, 0)
    assert scene == synth3dlanes.sample_scene(params, seed=4)
    rendered = synth3dlanes.render(scene, passes=names)
    assert list(rendered.passes) == list(reader.passes(0))
    saved = {path.name.removeprefix("saved."): path.read_bytes() for path in rendered.save(tmp_path / "saved.png")}
    assert saved == reader.raw(0)


@pytest.mark.parametrize(
    ("function", "arguments", "problem"),
    [
        ("render", {"passes": "colour"}, "passes: expected one of depth, normal, semantic, instance, height"),
        ("render", {"samples": 0}, "samples: expected 1 or more, got 0"),
        ("render", {"device": "gpu"}, "device: expected one of auto, cpu"),
        ("generate_dataset", {"out": "o", "n": 1, "image_format": "bmp"}, "image_format: expected 'jpg' or 'png'"),
        ("export_dataset", {"source": "d", "out": "o", "format_name": "kitty"}, "format_name: expected one of apollo"),
    ],
)
def test_a_wrong_argument_is_named(
    function: str, arguments: dict[str, Any], problem: str, flat_scene: Any, in_tmp_path: Path
) -> None:
    params = {"params": synth3dlanes.load_params("tiny")}
    first = {"render": {"scene": flat_scene}, "generate_dataset": params}
    with pytest.raises(synth3dlanes.InputError) as caught:
        getattr(synth3dlanes, function)(**first.get(function, {}), **arguments)
    assert caught.value.problems[0].startswith(problem)
    assert not list(in_tmp_path.iterdir())


def test_an_image_is_saved_as_png_or_jpg_alone(flat_scene: Any, in_tmp_path: Path) -> None:
    from synth3dlanes.renderer import Rendered

    rendered = Rendered(flat_scene, np.zeros((2, 3, 3), np.uint8), synth3dlanes.label(flat_scene), {})
    with pytest.raises(synth3dlanes.InputError, match="path: expected one of jpg, png, got 'gif'"):
        rendered.save("scene.gif")
    assert not list(in_tmp_path.iterdir())


def test_a_lanes_visible_parts_are_unbroken(flat_scene: Any) -> None:
    from dataclasses import replace

    whole = synth3dlanes.label(flat_scene).lanes[0]
    n = len(whole.xyz_cam)
    seen = np.zeros(n, bool)
    seen[[0, 5, 6, 7, n - 2, n - 1]] = True
    lane = replace(whole, in_image=seen, terrain_visible=np.ones(n, bool), object_visible=None)
    parts = lane.visible_parts()
    assert [len(part) for part in parts] == [1, 3, 2]
    np.testing.assert_array_equal(np.concatenate(parts), lane.xyz_cam[lane.visible])
    np.testing.assert_array_equal(parts[1], lane.xyz_cam[5:8])
    assert replace(lane, in_image=np.zeros(n, bool)).visible_parts() == []


@pytest.mark.render
def test_a_renderer_keeps_its_process_and_makes_the_same_pictures() -> None:
    params = synth3dlanes.load_params("tiny")
    scenes = [synth3dlanes.sample_scene(params, index=index) for index in range(2)]
    with synth3dlanes.Renderer(passes="all", samples=1, device="cpu") as renderer:
        with ThreadPoolExecutor(2) as threads:
            first, second = threads.map(renderer.render, scenes)
        pids = renderer._pool.pids
        assert len(pids) == 1
        renderer.render(scenes[1])
        assert renderer._pool.pids == pids
        assert set(second.passes) == {"depth", "normal", "semantic", "instance", "height"}
    assert renderer._pool.pids == []
    of_renderer._kept.cache_clear()
    with ThreadPoolExecutor(1) as thread:
        alone = thread.submit(synth3dlanes.render, scenes[1], passes="all", samples=1, device="cpu").result()
    # The thread that asked first has ended, but not the process that it asked for.
    (process,) = of_renderer._kept(os.getpid())[0].pids
    synth3dlanes.render(scenes[1], samples=1)
    assert of_renderer._kept(os.getpid())[0].pids == [process]
    np.testing.assert_array_equal(second.image, alone.image)
    assert not np.array_equal(first.image, second.image)
    again = renderer.render(scenes[0])
    np.testing.assert_array_equal(again.image, first.image)
    renderer.close()
    renderer.close()


FUNCTIONS = {name: found for name in s3d.__all__ if inspect.isfunction(found := getattr(s3d, name))}
READER = ("__getitem__", "image", "labels", "objects", "key", "raw", "member", "position", "clip", "taken_by")
METHODS = {
    "Reader": s3d.Reader,
    "Renderer": s3d.Renderer,
    **{f"Reader.{name}": getattr(s3d.Reader, name) for name in READER},
    "Renderer.render": s3d.Renderer.render,
    "Rendered.save": s3d.Rendered.save,
}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A data set of three samples without real images."""
    out = tmp_path_factory.mktemp("arguments") / "d"
    generate(Plan(out, 3, fake_samples.recipe(), workers=1, maker=fake_samples.make), lambda event: None)
    return str(out)


@pytest.mark.parametrize("name", [*FUNCTIONS, *METHODS])
def test_an_argument_of_another_type_is_named(name: str) -> None:
    function: Callable[..., Any] = (FUNCTIONS | METHODS)[name]
    known = inspect.signature(function).parameters.values()
    parameters = [each.name for each in known if each.name != "self" and each.kind != each.VAR_KEYWORD]
    of_object = {"self": None} if "." in name else {}
    with pytest.raises(s3d.InputError) as caught:
        function(**of_object, **dict.fromkeys(parameters, object()))
    assert [line.partition(": expected ")[0] for line in caught.value.problems] == parameters


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("seed", (1.5, True, "1", float("nan"), -1, 2**128 + 1)), ("index", (1.5, "0", -1, 10**13)),
        ("split", ("a/b", "", "a b", "\0", 3)), ("frames", (0, 1.5, "2", 10**9)),
        ("fps", (0.0, -1, float("nan"), float("inf"), "10")), ("rig", (3, "", {})), ("params", (3, "", [])),
        ("views_per_scene", (0, 65, 2)),
    ],
)  # fmt: skip
def test_values_that_no_scene_has(kind: str, wrong: tuple[object, ...]) -> None:
    """Nor has a scene both views and frames."""
    arguments = {"params": s3d.load_params("tiny"), "frames": 2}
    for value in wrong:
        with pytest.raises(s3d.InputError, match=f"^{kind}: expected "):
            s3d.sample_scene(**{**arguments, kind: value})


def test_numbers_of_numpy_are_numbers() -> None:
    params = s3d.load_params("tiny")
    assert s3d.sample_scene(params, seed=np.int64(3), frames=np.uint8(2), fps=np.float32(5)) == s3d.sample_scene(
        params, seed=3, frames=2, fps=5
    )


def test_nothing_to_split_or_merge_and_no_single_sample(source: str, tmp_path: Path) -> None:
    for shares in ({}, {"a": 0.0}, {"a": -1.0, "b": 2.0}, {"a/b": 1.0}, {"": 1.0}, {"a": float("nan")}):
        with pytest.raises(s3d.InputError, match=r"^shares: expected "):
            s3d.split_dataset(source, tmp_path / "out", shares)
    with pytest.raises(s3d.InputError, match=r"^sources: expected the data sets to merge, got none"):
        s3d.merge_datasets([], tmp_path / "out")
    with pytest.raises(s3d.InputError, match=r"^sources: expected a sequence of "):
        s3d.merge_datasets(source, tmp_path / "out")
    reader = s3d.open_dataset(source)
    for wrong in (slice(0, 2), 1.5, "0", None, True):
        with pytest.raises(s3d.InputError, match=r"^i: expected a whole number, got "):
            reader[wrong]
    assert reader[np.int64(-1)].key == reader[2].key == "00000002"
    with pytest.raises(s3d.InputError, match=r"^path: expected the path of a file, got ''"):
        s3d.save_scene(s3d.sample_scene(s3d.load_params("tiny")), "")
    assert not (tmp_path / "out").exists()
