"""The pages in a headless Chromium: they load in silence, every switch works, and space is turned by the mouse."""

import io
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, sync_playwright

from synth3dlanes.figures.page import report_page, scene_page
from synth3dlanes.figures.stats import label_statistics, scene_statistics
from synth3dlanes.ground_truth import ground_truth
from synth3dlanes.labels import Labels
from synth3dlanes.params import load_params
from synth3dlanes.sample import sample_scene

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# WebGL without a graphics card; root has no sandbox.
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
AFTER_DRAWING = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
IS_OFF = (
    "box => [...document.querySelectorAll(box.dataset.shows)].map(part => getComputedStyle(part).display == 'none')"
)
# Pixels of the canvas: the lines are a few wide, and a polyline of the image has a vertex every metre.
REACH_PX = 3


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
    context = browser.new_context(viewport={"width": 920, "height": 800})
    said, asked = [], []

    def open_(text: str) -> Page:
        path = tmp_path / "page.html"
        path.write_text(text, encoding="utf-8")
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        return page

    yield open_
    context.close()
    assert said == []
    assert [url for url in asked if not url.startswith("data:")] == [(tmp_path / "page.html").as_uri()]


def some_behind_cars(labels: Labels) -> Labels:
    """The labels of a rendered scene: every fifth point is behind a car."""
    lanes = [replace(lane, object_visible=np.arange(len(lane.xyz_cam)) % 5 > 0) for lane in labels.lanes]
    return replace(labels, lanes=tuple(lanes))


def picture(part: Locator) -> np.ndarray:
    part.page.evaluate(AFTER_DRAWING)
    return np.asarray(Image.open(io.BytesIO(part.screenshot())).convert("RGB")).astype(int)


def differ(a: np.ndarray, b: np.ndarray) -> int:
    """The number of pixels that a person would see change."""
    return int(np.count_nonzero(np.abs(a - b).max(axis=-1) > 24))


def check_switches(page: Page, shown: Locator, names: list[str]) -> None:
    """Every check box hides what it names and nothing else, and brings it back."""
    boxes = page.locator("input[data-shows]").all()
    assert [label.strip() for label in page.locator("label:has([data-shows])").all_inner_texts()] == names
    start, at_first = picture(shown), [box.is_checked() for box in boxes]
    for number, (box, name) in enumerate(zip(boxes, names, strict=True)):
        assert set(box.evaluate(IS_OFF)) == {not at_first[number]}, name
        box.click()
        assert set(box.evaluate(IS_OFF)) == {at_first[number]}, name
        assert differ(start, picture(shown)) > 20, name
        box.click()
        assert [other.is_checked() for other in boxes] == at_first
    assert differ(start, picture(shown)) < 20


def test_the_page_of_a_scene(open_page, exit_scene, gray_image):
    page = open_page(scene_page(exit_scene, some_behind_cars(ground_truth(exit_scene)), gray_image))
    masks = [f"points {name}" for name in ("seen", "hidden by the ground", "hidden by objects")]
    check_switches(page, page.locator("svg"), ["centre lines", "delimiters", "hidden parts", *masks])
    canvas = page.locator("#space")
    groups = page.locator("#space-bar label").all()
    assert len(groups) == 8
    start = picture(canvas)
    for group in groups:
        group.click()
        assert differ(start, picture(canvas)) > 20, group.inner_text()
        group.click()
    assert differ(start, picture(canvas)) < 20


def test_the_mouse_turns_moves_and_zooms_space(open_page, exit_scene):
    page = open_page(scene_page(exit_scene, ground_truth(exit_scene), None))
    canvas = page.locator("#space")
    box = canvas.bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    def drag(right: float, down: float) -> np.ndarray:
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + right, middle[1] + down)
        page.mouse.up()
        return picture(canvas)

    start = picture(canvas)
    assert differ(start, drag(120, 0)) > 0.05 * start[..., 0].size
    assert differ(start, drag(-120, 0)) < 20, "back where it was"
    assert differ(start, drag(0, 60)) > 0.05 * start[..., 0].size
    drag(0, -60)
    page.keyboard.down("Shift")
    assert differ(start, drag(80, 40)) > 0.05 * start[..., 0].size
    page.keyboard.up("Shift")
    page.get_by_role("button", name="behind").click()
    assert differ(start, picture(canvas)) < 20
    page.mouse.move(*middle)
    page.mouse.wheel(0, -400)
    assert differ(start, picture(canvas)) > 0.05 * start[..., 0].size


def test_the_driver_sees_the_lanes_where_the_image_has_them(open_page, hilly_scene):
    page = open_page(scene_page(hilly_scene, ground_truth(hilly_scene), None))
    for group in page.locator("#space-bar label").all():
        if group.inner_text().strip() != "delimiters":
            group.click()
    page.get_by_role("button", name="driver").click()
    shown = picture(page.locator("#space"))
    is_line = np.abs(shown - shown[1, 1]).max(axis=-1) > 40
    points = page.eval_on_selector_all(
        ".lane.delimiter .seen polyline", "lines => lines.flatMap(line => [...line.points].map(at => [at.x, at.y]))"
    )
    width_px, height_px = hilly_scene.camera.width_px, hilly_scene.camera.height_px
    points_img = np.array([(u, v) for u, v in points if 5 < u < width_px - 5 and 0.55 * height_px < v < height_px - 5])
    assert len(points_img) > 10
    columns, rows = (points_img * is_line.shape[1] / width_px).astype(int).T
    hits = [is_line[max(0, v - REACH_PX) : v + REACH_PX + 1, max(0, u - REACH_PX) : u + REACH_PX + 1].any()
            for u, v in zip(columns, rows, strict=True)]  # fmt: skip
    assert np.mean(hits) > 0.95
    assert is_line.mean() < 0.1, "lines, and not a screen full of them"


def test_the_page_of_a_data_set(open_page, gray_image):
    params = load_params("appendix_i", ["trees.n=5", "cars.n=3"])
    scenes = [sample_scene(params, 1, "train", index) for index in range(2)]
    labels = [some_behind_cars(ground_truth(scene)) for scene in scenes]
    samples = [(f"{scene.index:08d}", gray_image, one) for scene, one in zip(scenes, labels, strict=True)]
    page = open_page(report_page("a set", samples, scene_statistics(scenes, params), label_statistics(labels)))
    masks = [f"points {name}" for name in ("seen", "hidden by the ground", "hidden by objects")]
    check_switches(page, page.locator(".cards"), ["centre lines", "delimiters", "hidden parts", *masks])
    assert all(page.locator("img").evaluate_all("images => images.map(one => one.naturalWidth > 400)"))
