"""The documentation says what the code does, its files for clusters work, and as a site it asks no other host."""

import functools
import importlib.util
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import click
import pytest
import yaml
from playwright.sync_api import Browser

import synth3dlanes
from synth3dlanes.formats.format import format_names
from tests.browser import browser as browser

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def generated() -> dict[str, str]:
    """The generated pages, by a process of its own: a command that has run keeps its help option."""
    code = "import json; from scripts.docs import pages; print(json.dumps(pages()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    pages: dict[str, str] = json.loads(done.stdout)
    return pages


GENERATED = [
    "cli.md", "params.md", "scene.schema.json", "labels.schema.json", "outputs.schema.json", "cluster.md",
    "validate.md", "benchmarks.md", "models.md", "assets.md", "exports.md", "format.md", "frames.md",
]  # fmt: skip


@pytest.mark.parametrize("name", GENERATED)
def test_a_generated_page_is_fresh(generated: dict[str, str], name: str) -> None:
    assert (DOCS / name).read_text() == generated[name], "run `make docs`"


def test_every_command_and_option_is_explained() -> None:
    from scripts.docs import commands

    readme = (ROOT / "README.md").read_text()
    for name, command in commands():
        assert command.help, name
        assert f"`{name}" in readme, f"{name} is missing in README.md"
        known = command.get_params(click.Context(command))
        options = [option for option in known if isinstance(option, click.Option)]
        assert not [option.opts for option in options if not option.help], f"{name}: these have no help"


def test_every_parameter_has_its_meaning_in_the_reference_preset() -> None:
    from scripts.docs import preset_comments
    from synth3dlanes.params.params import forms, load_params

    keys = {(group, key) for group, values in forms(load_params("appendix_i")).items() for key in values}
    assert set(preset_comments()) == keys


def test_every_guarantee_has_its_test() -> None:
    rows = re.findall(r"^\| (?!promise|---)(.+) \|$", (DOCS / "guarantees.md").read_text(), re.MULTILINE)
    for row in rows:
        named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", row)
        assert named, row
        for path, name in named:
            assert f"def {name}(" in (ROOT / path).read_text(), f"{path}::{name}"


def test_the_changelog_and_the_citation_know_this_version() -> None:
    from synth3dlanes import __version__

    assert f"## [{__version__}]" in (ROOT / "CHANGELOG.md").read_text()
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()


pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Dead links and anchors, and pages that are not in the index, fail it."""
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


def test_every_page_and_every_public_name_is_there(site: Path) -> None:
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"README"}
    assert pages | {"index", "contents", "reference", "notebook", "architecture"} <= {
        p.stem for p in site.glob("*.html")
    }
    assert {path.stem for path in (site / "formats").glob("*.html")} == set(format_names())
    reference = (site / "reference.html").read_text()
    assert {name for name in synth3dlanes.__all__ if f'id="synth3dlanes.{name}"' not in reference} == set()


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None: ...

    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.mark.parametrize("width", [390, 1440])
def test_pages_fit_any_screen_and_ask_no_other_host(browser: Browser, address: str, width: int) -> None:
    page = browser.new_page(viewport={"width": width, "height": 840})
    asked: list[str] = []
    said: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: said.append(message.text))
    for name in ("index", "params", "baseline", "reference", "gallery"):
        page.goto(f"{address}{name}.html")
        assert page.evaluate("document.documentElement.scrollWidth") == width, name
    assert said == []
    assert [url for url in asked if not url.startswith((address, "data:"))] == []
    page.close()


CLUSTER = ROOT / "docs/cluster"
N = 3
PROGRAM = f"""#!{sys.executable}
import functools
import sys
sys.path.insert(0, {str(ROOT)!r})
from synth3dlanes.production import plan
from synth3dlanes_cli.main import main
from tests import fake_samples
plan.Plan = functools.partial(plan.Plan, shard_size=1, maker=fake_samples.make)
if __name__ == "__main__":
    main([{str(N)!r} if word == "300000" else word for word in sys.argv[1:]])
"""


@pytest.fixture
def run_script(tmp_path: Path):
    """`run_script(text, **environment)` in a shell where our program is the small one and `srun` runs what it gets."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in (("synth3dlanes", PROGRAM), ("srun", '#!/bin/sh\nexec "$@"\n')):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)

    def run(text: str, **environment: str) -> str:
        path = {"PATH": f"{programs}:{os.environ['PATH']}", "SCRATCH": str(tmp_path), "HOME": str(tmp_path)}
        done = subprocess.run(
            ["bash", "-c", text], env={**path, **environment}, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def assert_whole(out: Path, run_script) -> None:
    from synth3dlanes.dataset.read import Reader

    assert [sample.key for sample in Reader(str(out / "train"))] == [f"{i:08d}" for i in range(N)]
    again = json.loads(run_script(f"synth3dlanes generate --n 300000 --out {out} --json"))
    assert (again["made"], again["done"], again["asked"]) == (0, N, N)


def test_the_slurm_array_makes_a_whole_data_set(tmp_path, run_script):
    script = (CLUSTER / "lanes.sbatch").read_text()
    assert re.search(r"^#SBATCH --array=1-(\d+)$", script, re.MULTILINE)
    for part in range(1, N + 1):
        array = {"SLURM_ARRAY_TASK_ID": str(part), "SLURM_ARRAY_TASK_COUNT": str(N)}
        assert "1 of 1 sample, 1 made now" in run_script(script, **array)
    assert_whole(tmp_path / "lanes", run_script)


def test_the_kubernetes_job_makes_a_whole_data_set(tmp_path, run_script):
    job = yaml.safe_load((CLUSTER / "job.yaml").read_text())["spec"]
    (container,) = job["template"]["spec"]["containers"]
    (command,) = container["args"]
    assert container["command"] == ["bash", "-c"]
    assert command.endswith(f'/{job["completions"]}"')
    assert container["volumeMounts"][0]["mountPath"] == "/shared"
    command = command.replace(f"/{job['completions']}", f"/{N}").replace("/shared", str(tmp_path))
    for index in range(N):
        run_script(command, JOB_COMPLETION_INDEX=str(index))
    assert_whole(tmp_path / "lanes", run_script)


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="the extra `cluster` is not installed")
def test_ray_accepts_its_cluster_file():
    # Ray's code warns of its own.
    check = """
import sys, yaml
from ray.autoscaler._private.util import prepare_config, validate_config
config = prepare_config(yaml.safe_load(open(sys.argv[1])))
validate_config(config)
print(config["available_node_types"]["maker"]["min_workers"], config["docker"]["image"])
"""
    command = [sys.executable, "-c", check, str(CLUSTER / "ray.yaml")]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[0] == "16"


def test_the_container_has_what_blender_and_we_need():
    from synth3dlanes.system.system_libraries import PACKAGES

    text = (CLUSTER / "Containerfile").read_text().replace("\\\n", " ")
    instructions = [line for line in text.splitlines() if line and not line.startswith("#")]
    assert [line.split()[0] for line in instructions] == ["FROM", "RUN", "COPY", "RUN"]
    packages = instructions[1].split("--no-install-recommends")[1].split("&&")[0].split()
    assert set(packages) == {"rsync", *PACKAGES.values()}
    for line in instructions:
        if line.startswith("RUN"):
            subprocess.run(["bash", "-n", "-c", line.removeprefix("RUN ")], check=True)


def test_the_container_gets_every_file_that_pip_needs():
    ignored = (CLUSTER / "Containerfile.dockerignore").read_text().split()
    kept = {name.removeprefix("!") for name in ignored if name.startswith("!")}
    project = (ROOT / "pyproject.toml").read_text()
    folders = {"synth3dlanes", *re.findall(r'_?\w+"? = "(baseline_model|cli|params|blender_assets)"', project)}
    assert kept == folders | {"LICENSE", "README.md", "constraints.txt", "pyproject.toml"}
    assert all((ROOT / name).exists() for name in kept)
