"""What each command prints and writes."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from PIL import Image
from synth3dlanes_cli.main import main

from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples

Run = Callable[..., Result]


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.array(image)


def test_sample_prints_the_scene_of_its_index(run: Run) -> None:
    many = run("sample", "--n", 3, "--index", 16, "--params", "tiny").stdout.splitlines()
    assert [json.loads(line)["index"] for line in many] == [16, 17, 18]
    assert run("sample", "--index", 17, "--params", "tiny").stdout.splitlines() == many[1:2]
    assert run("sample", "--index", 17, "--params", "tiny", "--seed", 1).stdout.splitlines() != many[1:2]


def test_params_show_prints_what_a_file_changes_or_every_key(run: Run, in_tmp_path: Path) -> None:
    text = run("params", "show", "--set", "road.n_lanes=3").stdout
    (in_tmp_path / "mine.yaml").write_text(text)
    assert re.search(r"^base: appendix_i\n\nroad: .*\n  n_lanes: 3  +#.*\n\Z", text, re.M), "with its comment"
    assert run("params", "check", "mine.yaml", "tiny").stdout.splitlines() == ["mine.yaml: ok", "tiny: ok"]
    assert run("params", "show", "mine.yaml").stdout == text
    whole = run("params", "show", "mine.yaml", "--full").stdout
    assert whole.splitlines() == [
        "  n_lanes: 3                    # lanes of the main road, before the split"
        if "  n_lanes: [2, 4]" in line
        else line
        for line in run("params", "show").stdout.split("\n\n", 1)[1].splitlines()
    ]
    assert json.loads(run("params", "show", "--json").stdout)["light"]["exposure"] == [1, 3]


def test_inspect_explains_a_scene_that_was_never_rendered(run: Run, in_tmp_path: Path) -> None:
    (in_tmp_path / "7.scene.json").write_text(run("sample", "--index", 7, "--params", "tiny").stdout)
    result = run("inspect", "7.scene.json")
    assert result.exit_code == 0
    assert "Figure: 7.inspect.png" in result.stdout
    assert pixels(in_tmp_path / "7.inspect.png").shape[1] > 1000
    facts = json.loads(run("inspect", "7.scene.json", "--json").stdout)
    assert facts["figure"] == "7.inspect.png"
    assert facts["summary"]["drawn from"] == {"seed": "0", "split": "train", "index": "7"}


@pytest.mark.render
def test_from_nothing_to_pictures(run: Run, in_tmp_path: Path) -> None:
    made = run(
        "generate", "--n", 2, "--out", "d", "--params", "tiny", "--workers", 1, "--image-format", "png", "--json"
    )
    assert made.exit_code == 0, made.stderr
    assert json.loads(made.stdout)["done"] == 2
    again = run("generate", "--n", 2, "--out", "d", "--params", "tiny", "--workers", 1, "--image-format", "png")
    assert again.stdout == "d/train: 2 of 2 samples, 0 made now\n"

    assert run("gallery", "d", "--out", "g.png", "--columns", 2).exit_code == 0
    assert pixels(in_tmp_path / "g.png").shape[1] > 2 * 96
    inspected = run("inspect", "d/train:1")
    assert "Figure: 00000001.inspect.png" in inspected.stdout
    missing = run("inspect", "d/train:2")
    assert (missing.exit_code, missing.stdout) == (2, "")

    from synth3dlanes.dataset.read import Reader

    sample = Reader("d/train")[1]
    (in_tmp_path / "scene.json").write_bytes(sample.scene_json)
    rendered = run("render", "scene.json", "--passes", "depth")
    assert rendered.stdout.split() == ["scene.png", "scene.labels.json", "scene.passes.exr"]
    np.testing.assert_array_equal(pixels(in_tmp_path / "scene.png"), sample.image)
    changed = run("render", "scene.json", "--set", "light.exposure=3", "--out", "new/bright.jpg")
    assert changed.stdout.split() == ["new/bright.jpg", "new/bright.scene.json", "new/bright.labels.json"]
    assert json.loads((in_tmp_path / "new/bright.scene.json").read_text())["light"]["exposure"] == 3


@pytest.mark.thorough
@pytest.mark.render
def test_render_makes_the_very_bytes_that_the_data_set_has(in_tmp_path: Path) -> None:
    """A worker has one core, a user's process all of them; at full size every rounding shows."""
    program = [sys.executable, "-m", "synth3dlanes_cli.main"]
    passes = ["--passes", "depth,normal,semantic,instance"]
    subprocess.run([*program, "generate", "--n", "1", "--out", "d", *passes], check=True, capture_output=True)

    from synth3dlanes.dataset.read import Reader

    members = Reader("d/train").raw(0)
    subprocess.run([*program, "render", "d/train:0", "--out", "a.jpg", *passes], check=True, capture_output=True)
    for name in ("jpg", "labels.json", "passes.exr"):
        assert (in_tmp_path / f"a.{name}").read_bytes() == members[name], name


@pytest.mark.parametrize(
    ("line", "expected"),
    [("synth3dlanes gen", "generate"), ("synth3dlanes generate --dev", "--device"), ("synth3dlanes params sh", "show")],
)
def test_the_shell_completes(line: str, expected: str) -> None:
    """As the lines of docs/cli.md have it do."""
    asked = {"_SYNTH3DLANES_COMPLETE": "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    assert CliRunner().invoke(main, [], prog_name="synth3dlanes", env=asked).stdout == f"plain,{expected}\n"


def test_stats_of_a_data_set(run: Run, folder: Path, in_tmp_path: Path) -> None:
    result = run("stats", folder, "--out", "plots.png")
    assert result.exit_code == 0, result.stderr
    assert "12 scenes" in result.stdout
    assert "labels of 12 images" in result.stdout
    assert re.search(r"\n(\d+) of \1 parameters as declared\nPlots: plots.png\n$", result.stdout)
    assert "…" not in result.stdout
    with Image.open("plots.png") as plots:
        assert plots.width > 1000
    document = json.loads(run("stats", f"{folder}/train", "--n", 5, "--json").stdout)
    assert document["n_scenes"] == 5
    assert {"grade [%]", "curvature [1/km]"} <= {row["name"] for row in document["labels"]}


def test_gallery_shows_what_a_query_selects(run: Run, folder: Path, in_tmp_path: Path) -> None:
    from synth3dlanes.dataset.read import Reader

    wanted = Reader(f"{folder}/train").index.to_pylist()
    wanted = [row["index"] for row in wanted if row["n_lanes"] == 3 and row["junction"] != "none"]
    query = "n_lanes = 3 and junction != 'none'"
    assert len(wanted) > 1
    result = run("gallery", folder, "--where", query, "--no-lanes", "--columns", len(wanted), "--out", "g.png")
    assert result.exit_code == 0, result.stderr
    with Image.open("g.png") as sheet:
        row = np.array(sheet)[180, :, 0]
    assert [int(row[4 + 240 + 484 * k]) for k in range(len(wanted))] == [20 * index for index in wanted]


def test_pages(run: Run, folder: Path, in_tmp_path: Path) -> None:
    result = run("report", folder, "--samples", 3)
    assert (result.exit_code, result.stdout) == (0, "Page: report.html\n"), result.stderr
    page = Path("report.html").read_text()
    assert page.count('<figure id="train:') == 3
    assert f"<h1>{folder.name}</h1>" in page
    assert str(folder.parent) not in page, "where it lies on this machine is nobody's business"
    result = run("inspect", f"{folder}/train:3", "--html", "page.html")
    assert "Page: page.html" in result.stdout
    assert "data:image/jpeg" in Path("page.html").read_text()
    assert {path.name for path in in_tmp_path.iterdir()} == {"report.html", "page.html"}
    both = json.loads(run("inspect", f"{folder}/train:3", "--html", "b.html", "--out", "b.png", "--json").stdout)
    assert (both["page"], both["figure"]) == ("b.html", "b.png")


def test_split_info_and_merge(run: Run, folder: Path, in_tmp_path: Path) -> None:
    assert "complete" in run("info", folder).stdout
    result = run("split", f"{folder}/train", "--into", "train=3,val=1", "--out", "s")
    assert result.stdout == "s/train: 9 samples\ns/val: 3 samples\n", result.stderr
    told = json.loads(run("info", "s", "--json").stdout)
    assert [(one["name"], one["joined"], one["complete"]) for one in told["splits"]] == [
        ("train", 9, True),
        ("val", 3, True),
    ]
    assert "derived" in run("info", "s").stdout
    # Plain images fail the proof of pixels; where the samples came from is no fault.
    assert "scene.json: index" not in run("validate", "s", "--workers", 1).output
    assert run("merge", folder, "--out", "m").stdout == "m/train: 12 samples\n"
    again = run("merge", folder, folder, "--out", "n")
    assert (again.exit_code, again.stderr.count("\n")) == (2, 1)


def test_an_export_of_no_frame_fails(run: Callable[..., Result], in_tmp_path: Path) -> None:
    narrow = fake_samples.recipe(overrides=("camera.horizontal_fov_deg=20",))
    generate(Plan("d", 2, narrow, workers=1, maker=fake_samples.make_labelled), lambda event: None)
    for more in ((), ("--verify",)):
        result = run("export", "d", "--format", "apollo", "--out", "e", *more)
        assert (result.exit_code, result.stdout) == (2, ""), result.output
        line = result.stderr.splitlines()[-1]
        assert line.startswith("e: expected a frame to export, got none: 2 its field of view is narrower than")
        assert "generate with a wider camera (--camera, docs/camera.md)" in line
    other = run("export", "d", "--format", "culane", "--out", "e")
    assert other.exit_code == 2
    assert "expected an empty folder or the export of format culane" in other.stderr
    assert "{" not in other.stderr


@pytest.mark.thorough
@pytest.mark.render
def test_a_folder_of_own_assets_from_check_to_picture(run: Run, in_tmp_path: Path) -> None:
    table = run("assets", "mine", "--example")
    assert table.exit_code == 0, table.output
    assert "box" in table.stdout
    refused = run("assets", "mine", "--example")
    assert (refused.exit_code, refused.stderr) == (2, "mine: already exists\n")

    (in_tmp_path / "mine" / "notes.txt").touch()
    drawn = run("sample", "--params", "tiny", "--set", "cars.n=1", "--assets", "mine")
    assert drawn.stderr == "assets mine: notes.txt: not used: unknown name or suffix\n"
    scene = json.loads(drawn.stdout)
    assert [car["name"] for car in scene["assets"]["cars"]] == ["box"]
    (in_tmp_path / "scene.json").write_text(drawn.stdout)
    explained = json.loads(run("inspect", "scene.json", "--json").stdout)
    assert explained["summary"]["objects"]["cars"] == "1: 1 box"

    forgotten = run("render", "scene.json")
    assert (forgotten.exit_code, forgotten.stdout) == (2, "")
    assert "scene.json: cars: expected 'box' with digest" in forgotten.stderr
    assert run("render", "scene.json", "--assets", "mine").exit_code == 0

    (in_tmp_path / "mine" / "cars" / "box.glb").write_text("")
    spoilt = run("assets", "mine", "--json")
    assert spoilt.exit_code == 1
    assert json.loads(spoilt.stdout)["problems"][0].startswith("cars/box.glb: cannot read it")
    stopped = run("generate", "--n", 1, "--out", "d", "--assets", "mine")
    assert stopped.exit_code == 2
    assert stopped.stderr.startswith("--assets mine: cars/box.glb: cannot read it")
    assert not (in_tmp_path / "d").exists()
