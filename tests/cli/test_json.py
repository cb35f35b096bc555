"""What every command prints with `--json` is what docs/outputs.schema.json says: by a schema library."""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import Result
from jsonschema import Draft202012Validator
from synth3dlanes_cli.main import main

from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from tests import fake_samples

Run = Callable[..., Result]
SCHEMA = json.loads((Path(__file__).parents[2] / "docs/outputs.schema.json").read_text())


def check(name: str, printed: str) -> dict[str, Any]:
    """The document, valid by its part of the schema, with no NaN in it."""
    document: dict[str, Any] = json.loads(printed, parse_constant=lambda text: pytest.fail(f"{name}: {text}"))
    part = {"$defs": SCHEMA["$defs"], **SCHEMA["properties"][name]}
    Draft202012Validator.check_schema(part)
    Draft202012Validator(part).validate(document)
    return document


def test_every_command_with_json_has_a_schema() -> None:
    def commands(group: click.Group, before: str = "") -> dict[str, click.Command]:
        found: dict[str, click.Command] = {}
        for name, command in group.commands.items():
            found |= commands(command, f"{name}_") if isinstance(command, click.Group) else {before + name: command}
        return found

    with_json = {name for name, command in commands(main).items() if any("--json" in p.opts for p in command.params)}
    assert with_json | {"generate_dry_run"} == set(SCHEMA["properties"])


def test_of_scenes_and_data_sets(run: Run, folder: Path) -> None:
    document = check("inspect", run("inspect", f"{folder}/train:3", "--json").stdout)
    assert document["columns"]["n_lanes"] in (2, 3, 4)
    ids = [lane["id"] for lane in document["lanes"]]
    assert "main_1" in ids
    assert all(lane["n_over_ground"] <= lane["n_in_image"] <= lane["n_points"] for lane in document["lanes"])
    assert document["summary"]["drawn from"]["index"] == "3"
    info = check("info", run("info", folder, "--json").stdout)
    assert (info["preset"], info["image_sizes"], info["frames_per_scene"]) == (
        "appendix_i with cars.n=3, trees.n=5",
        ["480x360"],
        1,
    )
    told = check("stats", run("stats", folder, "--json").stdout)
    assert {"terrain.n_gaussians", "camera.pitch_deg"} <= {row["key"] for row in told["parameters"]}
    check("stats", run("stats", "--params", "tiny", "--n", 3, "--json").stdout)
    assert check("params_show", run("params", "show", "--json").stdout)["light"]["exposure"] == [1.0, 3.0]


@pytest.mark.parametrize(
    ("kind", "command"),
    [
        ("presets", "sample --params NAME"),
        ("cameras", "sample --params tiny --camera NAME"),
        ("rigs", "sample --params tiny --rig NAME"),
        ("lidars", "generate --params tiny --n 1 --out d --dry-run --device cpu --lidar NAME"),
        ("formats", "export DIR --format NAME --out d/NAME"),
        ("models", None),
        ("benchmarks", None),
    ],
)
def test_of_names_that_commands_take(kind: str, command: str | None, run: Run, folder: Path, in_tmp_path: Path) -> None:
    """Each has a line, on the terminal too, and the command for it takes the first and the last."""
    rows = check("list", run("list", kind, "--json").stdout)
    names = [row["name"] for row in rows]
    assert len(names) == len({*names}) > 1
    printed = run("list", kind).stdout
    assert all(row["name"] in printed and row["about"][:40] in printed for row in rows)
    assert all(20 < len(row["about"]) < 120 and "\n" not in row["about"] for row in rows), rows
    for name in () if command is None else (names[0], names[-1]):
        done = run(*command.replace("NAME", name).replace("DIR", str(folder)).split())
        assert "expected one of" not in done.stderr, done.stderr
        assert done.exit_code == 0 or kind == "formats", done.stderr


def test_the_weights_that_are_listed_are_those_in_the_package(run: Run) -> None:
    listed = {row["name"] for row in json.loads(run("list", "models", "--json").stdout)}
    assert listed == {path.stem for path in (Path(__file__).parents[2] / "baseline_model/weights").glob("*.pt")}


def test_of_a_run(run: Run, in_tmp_path: Path) -> None:
    dry = run("generate", "--n", 3, "--params", "tiny", "--device", "cpu", "--out", "d", "--dry-run", "--json").stdout
    assert check("generate_dry_run", dry)["samples"] == 3
    report = generate(Plan("d", 2, fake_samples.recipe(), 1, maker=fake_samples.make), lambda event: None)
    assert check("generate", json.dumps(asdict(report)))["done"] == 2


def test_of_a_validation(run: Run, folder: Path, in_tmp_path: Path) -> None:
    shutil.copytree(folder, "d")
    Path("d/train/00001.tar").unlink()
    document = check("validate", run("validate", "d", "--workers", 1, "--limit", 2, "--json").stdout)
    assert document["samples"] == 2
    assert document["problems"]


def test_of_an_evaluation(run: Run, folder: Path) -> None:
    pytest.importorskip("torch")
    Path("none.jsonl").touch()
    document = check("evaluate", run("evaluate", folder, "--predictions", "none.jsonl", "--json").stdout)
    assert document["pose"]["pitch_median_deg"] is None
    assert len(document["samples"]) == 12
