"""The documentation site: it builds without a warning, and it asks no other host for anything."""

import functools
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

import synth3dlanes
from synth3dlanes.formats.format import format_names

pytestmark = pytest.mark.thorough


ROOT = Path(__file__).parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


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


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.fail(f"expected one of {', '.join(BROWSERS)} on the PATH, got none: sudo apt-get install chromium")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield started
        started.close()


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
