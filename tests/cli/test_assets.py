"""`--assets DIR` on the command line: checked once, recorded, asked for again."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

Run = Callable[..., Result]

pytestmark = pytest.mark.render


@pytest.mark.thorough
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


def test_a_folder_that_is_none(run: Run) -> None:
    result = run("sample", "--assets", "none")
    assert (result.exit_code, result.stderr) == (2, "--assets none: expected a folder, found none\n")
