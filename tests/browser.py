"""A headless Chromium for the tests of pages, and a page in it that must be silent and load nothing."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# WebGL without a graphics card, and nothing else by its stand-in, which takes twice the time; root has no sandbox.
ARGUMENTS = ["--no-sandbox", "--enable-unsafe-swiftshader"]
# What the browser, and not the page, says of pixels that are read back.
OF_DRIVER = "GL Driver Message"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.fail(f"expected one of {', '.join(BROWSERS)} on the PATH, got none: sudo apt-get install chromium")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield started
        started.close()


@pytest.fixture
def open_page(browser: Browser, tmp_path: Path):
    """Opens the text of a page; in the end it must have said nothing and asked for nothing."""
    context = browser.new_context(accept_downloads=True)
    said, asked = [], []

    def open_(text: str, width: int = 920, scheme: Literal["light", "dark"] = "light") -> Page:
        path = tmp_path / "page.html"
        path.write_text(text, encoding="utf-8")
        page = context.new_page()
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 800})
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        return page

    yield open_
    context.close()
    assert [text for text in said if OF_DRIVER not in text] == []
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {(tmp_path / "page.html").as_uri()}
