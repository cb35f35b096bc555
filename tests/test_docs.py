"""The documentation says what the code does; as a site it builds without a warning and asks no other host."""

import functools
import json
import os
import re
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import click
import pytest
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
    "cli.md",
    "params.md",
    "scene.schema.json",
    "labels.schema.json",
    "outputs.schema.json",
    "cluster.md",
    "validate.md",
    "benchmarks.md",
    "models.md",
]


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


def test_every_column_pass_and_id_is_in_the_format_page() -> None:
    from synth3dlanes.dataset.columns import SCHEMA
    from synth3dlanes.dataset.index import ADDED
    from synth3dlanes.scene.settings import PASSES
    from synth3dlanes.scene.things import SEMANTIC_IDS

    text = re.sub(r"```.*?```", "", (DOCS / "format.md").read_text(), flags=re.DOTALL)
    named = set(re.findall(r"`([^`]+)`", text))
    assert set(SCHEMA.names) | set(ADDED) | set(PASSES) | set(SEMANTIC_IDS) <= named


def test_every_package_is_installed() -> None:
    """A folder with code that pyproject.toml forgets would be missing from the wheel alone."""
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {tool["package-dir"].get(name, name.replace(".", "/")) for name in tool["packages"]}
    for top in ("synth3dlanes", "cli", "baseline_model", "params", "blender_assets"):
        found = {path.parent.relative_to(ROOT).as_posix() for path in (ROOT / top).rglob("*.py")}
        assert found <= folders
    beside_code = {path for path in (ROOT / "synth3dlanes").rglob("*.*") if path.suffix not in (".py", ".pyc")}
    data = {name: patterns for name, patterns in tool["package-data"].items() if name not in tool["package-dir"]}
    folders_of = {name: ROOT / name.replace(".", "/") for name in data}
    assert beside_code == {
        p for name, patterns in data.items() for glob in patterns for p in folders_of[name].glob(glob)
    }


def anchors(page: Path) -> set[str]:
    """Where links into a page may lead: its headings as GitHub spells them."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_between_pages_lead_somewhere() -> None:
    for page in [*ROOT.glob("*.md"), *DOCS.glob("*.md")]:
        for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)]+))?\)", page.read_text()):
            place = page.parent / target if target else page
            assert "://" in target or place.exists(), f"{page.name}: {target}"
            assert not anchor or "://" in target or anchor in anchors(place), f"{page.name}: {target}#{anchor}"


def test_the_index_has_every_page() -> None:
    linked = set(re.findall(r"\]\(([^)#/]+)\)", (DOCS / "README.md").read_text()))
    assert {path.name for pattern in ("*.md", "*.schema.json") for path in DOCS.glob(pattern)} - {"README.md"} <= linked


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


# The stages of the columns of the table of speed; older rows have meshes in build, and textures in bvh.
COLUMNS = (
    *(("path tracing",), ("denoise",), ("meshes", "build"), ("textures", "bvh")),
    *(("sync",), ("develop",), ("occlusion",), ("sample", "labels")),
)


def seconds_of(stages: dict[str, float], *names: str) -> float:
    return sum(stages.get(name, 0.0) for name in names)


def test_the_table_of_speed_has_the_rows_of_the_bench() -> None:
    """Each row by its order: images an hour to ten, the rest to a hundredth."""
    found = re.findall(
        r"^\| `(\w+)`, (\d) samples?(.*?) \| ([\d,]+) \| (.+) \|$", (DOCS / "speed.md").read_text(), re.M
    )
    rows = json.loads((DOCS / "bench.json").read_text())["rows"]
    assert len(found) == 9
    for (params, samples, what, rate, rest), row in zip(found, rows, strict=False):
        stages = row["stages"]
        told = params, int(samples), "clips" in what, "on a map" in what
        assert told == (row["params"], row["samples"], row["frames"] > 1, bool(row.get("map")))
        assert rate == f"{round(row['images_per_hour'], -1):,.0f}"
        seconds = [row["core_seconds_per_image"], row["ratio"], *(seconds_of(stages, *names) for names in COLUMNS)]
        assert rest.split(" | ") == [f"{value:.2f}" for value in seconds]
    for params in ("appendix_i", "town"):
        views = {row["views"]: row for row in rows[9:] if row["params"] == params}
        assert list(views) == [1, 2, 4, 8]
        for what, key in (("core-seconds", "core_seconds_per_image"), ("ratio", "ratio")):
            cells = " | ".join(f"{row[key]:.2f}" for row in views.values())
            assert f"| `{params}`, {what} | {cells} |" in (DOCS / "speed.md").read_text()
    told = f"With `--quality train` they make {round(rows[1]['images_per_hour'], -2):,.0f}."
    assert told in (ROOT / "README.md").read_text()


pytestmark = pytest.mark.thorough


def build(source: Path, out: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(source), "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=source, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    done = build(ROOT, out)
    assert done.returncode == 0, done.stderr
    return out


def test_every_page_and_every_public_name_is_there(site: Path) -> None:
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"README"}
    assert pages | {"index", "contents", "reference", "notebook", "architecture"} <= {
        p.stem for p in site.glob("*.html")
    }
    assert {path.stem for path in (site / "formats").glob("*.html")} == set(format_names())
    assert "lane3d_1000" in (site / "formats/openlane.html").read_text()
    reference = (site / "reference.html").read_text()
    assert {name for name in synth3dlanes.__all__ if f'id="synth3dlanes.{name}"' not in reference} == set()
    assert "the image's border" in (site / "format.html").read_text()


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


def test_pages_quote_the_stored_bench() -> None:
    """README, questions and the page on speed say what the row of appendix_i with 4 samples says."""
    (row,) = (
        row
        for row in json.loads((DOCS / "bench.json").read_text())["rows"]
        if (row["params"], row["samples"], row["frames"]) == ("appendix_i", 4, 1) and not row.get("map")
    )
    seconds, stages = f"{row['core_seconds_per_image']:.1f} core-seconds", row["stages"]
    quotes = {
        ROOT / "README.md": [seconds, f"{round(row['images_per_hour'], -1):,.0f} images", f"{row['ratio']:.2f} times"],
        DOCS / "faq.md": [seconds],
        DOCS / "speed.md": [seconds, *(f"{seconds_of(stages, *names):.2f}" for names in COLUMNS[:4])],
    }
    for page, texts in quotes.items():
        assert [text for text in texts if text not in page.read_text()] == [], page.name


def test_the_times_of_the_faq_follow_from_the_bench() -> None:
    """The table gives the hours of (images x core-seconds / cores), rounded."""
    cost_s = json.loads((DOCS / "bench.json").read_text())["rows"][0]["core_seconds_per_image"]
    unit_s = {"min": 60, "h": 3600}
    rows = re.findall(r"^\| ([\d,]+) \| (.+?) \| (.+?) \| (.+?) \|$", (DOCS / "faq.md").read_text(), re.MULTILINE)
    assert [row[0] for row in rows] == ["10,000", "100,000", "300,000"]
    for images, *times in rows:
        for cores, time in zip((8, 64, 512), times, strict=True):
            number, unit = time.split()
            assert float(number) * unit_s[unit] == pytest.approx(
                int(images.replace(",", "")) * cost_s / cores, rel=0.04, abs=30
            )
