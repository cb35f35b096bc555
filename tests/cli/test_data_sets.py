"""Commands about whole data sets, on one of Appendix I scenes with plain images."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from PIL import Image

from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples

Run = Callable[..., Result]


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


@pytest.mark.parametrize("arguments", [[], ["d", "--params", "tiny"], ["d", "--seed", "3"], ["d", "--set", "cars.n=1"]])
def test_stats_is_of_one_thing(run: Run, arguments: list[str]) -> None:
    result = run("stats", *arguments)
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1)


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


def test_passes_that_are_not_there(run: Run, folder: Path, in_tmp_path: Path) -> None:
    for arguments, expected in (
        (("gallery", folder, "--show", "depth"), f"--show depth: {folder}/train was made without this pass"),
        (("inspect", f"{folder}/train:3", "--passes"), f"--passes: expected {folder}/train:3 to have passes, got none"),
    ):
        result = run(*arguments)
        assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1)
        assert expected in result.stderr
    assert list(in_tmp_path.iterdir()) == []


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


@pytest.mark.parametrize("shares", ["", "train", "train=0", "a=1,a=1", "../up=1", "a=-1"])
def test_shares_that_are_none(run: Run, folder: Path, in_tmp_path: Path, shares: str) -> None:
    result = run("split", f"{folder}/train", "--out", "s", "--into", shares)
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1)
    assert list(in_tmp_path.iterdir()) == []


def test_an_export_of_no_frame_fails(run: Callable[..., Result], in_tmp_path: Path) -> None:
    narrow = fake_samples.recipe(overrides=("camera.horizontal_fov_deg=20",))
    generate(Plan("d", 2, narrow, workers=1, maker=fake_samples.make_labelled), lambda event: None)
    for more in ((), ("--verify",)):
        result = run("export", "d", "--format", "apollo", "--out", "e", *more)
        assert (result.exit_code, result.stdout) == (1, ""), result.output
        line = result.stderr.splitlines()[-1]
        assert "e: expected a frame to export, got none: 2 its field of view is narrower than" in line
        assert "generate with a wider camera (--camera, docs/camera.md)" in line
    other = run("export", "d", "--format", "culane", "--out", "e")
    assert other.exit_code == 2
    assert "expected an empty folder or the export of format culane" in other.stderr
    assert "{" not in other.stderr
