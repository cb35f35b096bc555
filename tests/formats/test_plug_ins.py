"""Formats of other packages: real packages with entry points on the path."""

import json
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from synth3dlanes.formats.format import _entries, format_names, open_format
from synth3dlanes.system.errors import InputError
from tests.formats.planting import problems

NEWCOMER = Path(__file__).parents[2] / "examples/own_format"
CODE = (NEWCOMER / "acme_lanes.py").read_text()
ENTRY_POINTS = tomllib.loads((NEWCOMER / "pyproject.toml").read_text())["project"]["entry-points"]


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Puts packages on the path as pip does: a module, and beside it metadata with entry points."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    look_again()

    def put(package, code, **entries):
        monkeypatch.delitem(sys.modules, package, raising=False)
        (site / f"{package}.py").write_text(code)
        about = site / f"{package}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        lines = "".join(f"{name} = {value}\n" for name, value in entries.items())
        (about / "entry_points.txt").write_text(f"[synth3dlanes.formats]\n{lines}")
        look_again()

    yield put
    look_again()


def look_again():
    """Forget which formats there are; a process looks once."""
    for known in (_entries, open_format):
        known.cache_clear()


def listed():
    """What `list formats` says of each; the last line of names that several packages use."""
    from cli.main import main

    document = json.loads(CliRunner().invoke(main, ["list", "formats", "--json"]).stdout)
    return {row["name"]: row["about"] for row in document}


def command(*options):
    from cli.main import main

    return CliRunner().invoke(main, ["export", *map(str, options)])


def test_a_format_of_another_package_is_listed_written_and_verified(install, dataset, tmp_path):
    install("acme_lanes", CODE, **ENTRY_POINTS["synth3dlanes.formats"])
    assert sum(len(path.read_text().splitlines()) for path in NEWCOMER.iterdir() if path.is_file()) < 60
    assert format_names()[-1] == "acme"
    shown = listed()
    assert shown["acme"] == "Acme: lane lines before the camera"
    assert shown["apollo"].startswith("Apollo Sim-3D")
    out = tmp_path / "out"
    done = command(dataset, "--format", "acme", "--out", out, "--verify", "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["frames"] == {"train": 7, "val": 0, "test": 4}
    (verified,) = document["verified"]
    assert verified["compared"] == {"lines": {"n": document["lines"], "n_matched": document["lines"], "n_outside": 0}}
    assert document["lines"] > 30
    assert verified["measures"]["m"]["worst"] < 1e-3
    path = out / "train-00000003.json"
    written = json.loads(path.read_text())
    moved = [[[x + 0.3, y, z] for x, y, z in lane] for lane in written["lanes"]]
    path.write_text(json.dumps({**written, "lanes": moved}))
    told = problems(dataset, out, "acme")
    assert all(problem.startswith("train-00000003: line ") for problem in told)
    assert any("within 0.001 m of the labels, got it 0.3" in problem for problem in told)


@pytest.mark.parametrize(
    ("code", "value", "expected"),
    [
        ("import no_such_module", "acme_broken:FORMAT", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("1 / 0", "acme_broken:FORMAT", "ZeroDivisionError: division by zero"),
        ("raise SystemExit(3)", "acme_broken:FORMAT", "SystemExit: 3"),
        ("", "acme_broken:FORMAT", "AttributeError: module 'acme_broken' has no attribute 'FORMAT'"),
        ("FORMAT = 3", "acme_broken:FORMAT", "to be a Format, got a int"),
    ],
)
def test_a_broken_format_is_a_line_that_names_its_package(install, dataset, tmp_path, code, value, expected):
    install("acme_broken", code, acme=value)
    install("acme_lanes", CODE, other="acme_lanes:FORMAT")
    shown = listed()
    assert shown["acme"].startswith("cannot be used: format acme: ")
    assert shown["other"] == "Acme: lane lines before the camera"
    assert shown["yolo"].startswith("YOLO segmentation")
    refused = command(dataset, "--format", "acme", "--out", tmp_path / "out")
    assert refused.exit_code == 2
    assert refused.output.count("\n") == 1
    assert "acme_broken" in refused.output
    assert expected in refused.output
    assert not (tmp_path / "out").exists()
    assert open_format("other").title.startswith("Acme")


def test_names_that_two_packages_use(install):
    install("acme_lanes", CODE, acme="acme_lanes:FORMAT", apollo="acme_lanes:FORMAT")
    install("acme_maps", CODE, acme="acme_maps:FORMAT")
    with pytest.raises(InputError, match=r"format acme: expected it of one package, got it of acme_\w+, acme_\w+$"):
        open_format("acme")
    assert open_format("apollo").title.startswith("Apollo")
    assert listed()["apollo"] == "of the package acme_lanes: hidden by ours"


def test_an_unknown_format_is_a_line_with_all_names(dataset, tmp_path):
    refused = command(dataset, "--format", "acme", "--out", tmp_path / "out")
    assert refused.exit_code == 2
    assert refused.output.startswith("--format: expected one of apollo, ")
    assert refused.output.endswith("got 'acme'\n")
