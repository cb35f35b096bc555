"""The pages in a headless Chromium: they load in silence, every switch works, and space is turned by the mouse."""

import io
from dataclasses import replace

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Locator, Page, expect

from synth3dlanes.figures.page import scene_page
from synth3dlanes.figures.samples import ShownScene
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.host import Shot
from synth3dlanes.scene.scene import Scene
from synth3dlanes.truth.ground_truth import ground_truth
from tests.thorough import first

AFTER_DRAWING = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
IS_OFF = (
    "box => [...document.querySelectorAll(box.dataset.shows)].map(part => getComputedStyle(part).display == 'none')"
)
# The contrast of every text with what lies behind it, after WCAG 2: [ratio, text].
CONTRASTS = """() => {
  const rgba = color => { const v = color.match(/[\\d.]+/g).map(Number); return v.length > 3 ? v : [...v, 1]; };
  const luminance = color => {
    const [r, g, b] = color.map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = part => {
    for (; part; part = part.parentElement) {
      const color = rgba(getComputedStyle(part).backgroundColor);
      if (color[3] === 1) return color;
    }
    return [255, 255, 255, 1];
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
  while (walker.nextNode()) {
    const part = walker.currentNode.parentElement, text = walker.currentNode.data.trim();
    if (!text || !part.getClientRects().length || part.closest("script, title, style")) continue;
    const style = getComputedStyle(part);
    const a = luminance(rgba(part.closest("svg") ? style.fill : style.color)), b = luminance(behind(part));
    found.push([(Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), text]);
  }
  return found;
}"""
# How often the canvas is drawn when its wheel turns twenty times within a frame.
DRAWN_ONCE_TURNED = """async canvas => {
  const gl = canvas.getContext("webgl2"), clear = gl.clear.bind(gl);
  let drawn = 0;
  gl.clear = (mask) => { drawn += 1; clear(mask); };
  for (let i = 0; i < 20; i++) canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: 5 }));
  for (let i = 0; i < 3; i++) await new Promise(requestAnimationFrame);
  return drawn;
}"""
# Pixels of the canvas: the lines are a few wide, and a polyline of the image has a vertex every metre.
REACH_PX = 3


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


@pytest.mark.thorough
def test_the_page_of_a_scene(open_page, exit_scene, gray_image):
    page = open_page(scene_page(ShownScene(exit_scene, some_behind_cars(ground_truth(exit_scene)), gray_image)))
    masks = [f"points {name}" for name in ("seen", "hidden by the ground", "hidden by objects")]
    check_switches(page, page.locator("svg"), ["centre lines", "delimiters", "hidden parts", "objects", *masks])
    canvas = page.locator("#space")
    groups = page.locator("#space-bar label").all()
    assert len(groups) == 8
    start = picture(canvas)
    for group in groups:
        group.click()
        assert differ(start, picture(canvas)) > 20, group.inner_text()
        group.click()
    assert differ(start, picture(canvas)) < 20


@pytest.mark.thorough
def test_the_mouse_turns_moves_and_zooms_space(open_page, exit_scene):
    page = open_page(scene_page(ShownScene(exit_scene, ground_truth(exit_scene), None)))
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
    assert canvas.evaluate(DRAWN_ONCE_TURNED) == 1
    assert differ(start, picture(canvas)) > 0.05 * start[..., 0].size
    page.mouse.move(*middle)
    page.mouse.wheel(0, -400)
    assert differ(start, picture(canvas)) > 0.05 * start[..., 0].size


def test_the_driver_sees_the_lanes_where_the_image_has_them(open_page, hilly_scene):
    bare = hilly_scene.model_copy(update={"trees": (), "cars": ()})
    page = open_page(scene_page(ShownScene(bare, ground_truth(bare), None)))
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


def clip_of(scene: Scene, image: np.ndarray) -> str:
    """The page of the second of three frames."""
    shots = [Shot(frame=frame, n_frames=3, fps=10, speed_m_s=30) for frame in range(3)]
    scenes = [scene.model_copy(update={"shot": shot}) for shot in shots]
    clip = [(ground_truth(one), image) for one in scenes]
    return scene_page(ShownScene(scenes[1], clip[1][0], image, clip=clip))


def test_the_keyboard_turns_moves_and_zooms_space_lights_lanes_up_and_goes_through_a_clip(
    open_page, exit_scene, gray_image
):
    page = open_page(clip_of(exit_scene, gray_image))
    canvas = page.locator("#space")
    canvas.focus()
    start = picture(canvas)
    for key, back in (("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown"), ("Shift+ArrowUp", "Shift+ArrowDown"),
                      ("+", "-")):  # fmt: skip
        page.keyboard.press(key)
        assert differ(start, picture(canvas)) > 0.02 * start[..., 0].size, key
        page.keyboard.press(back)
        assert differ(start, picture(canvas)) < 20, back

    image = page.locator("svg:visible")
    start = picture(image)
    page.locator("svg:visible .lane").first.focus()
    assert differ(start, picture(image)) > 100

    slider, frames = page.locator("#frames"), page.locator(".frame")

    def shown() -> list[bool]:
        """At one instant: the clip may be playing."""
        return frames.evaluate_all("frames => frames.map(frame => frame.checkVisibility())")

    assert shown() == [False, True, False]
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert shown() == [False, False, True]
    assert page.locator("output[for=frames]").inner_text() == "frame 2, 0.20 s"
    assert slider.get_attribute("aria-valuetext") == "frame 2, 0.20 s"
    page.locator("#play").click()
    expect(page.locator("output[for=frames]")).not_to_have_text("frame 2, 0.20 s")
    assert sum(shown()) == 1


QUICK_FITS = [("clip", 390, "dark"), ("report", 1400, "light")]
FITS = [(kind, width, scheme) for kind in ("clip", "report") for width in (390, 1400) for scheme in ("light", "dark")]


@pytest.mark.parametrize(("kind", "width", "scheme"), first(2, sorted(FITS, key=lambda fit: fit not in QUICK_FITS)))
def test_pages_fit_their_screen_and_can_be_read_and_operated_by_everybody(
    open_page, exit_scene, gray_image, report, kind, width, scheme
):
    page = open_page(report if kind == "report" else clip_of(exit_scene, gray_image), width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") == width
    found = Axe().run(page).response
    assert len(found["passes"]) > 15, "rules that apply and hold"
    assert [(rule["id"], rule["impact"], len(rule["nodes"])) for rule in found["violations"]] == []
    page.locator("details").evaluate_all("all => all.forEach(one => one.open = true)")
    contrasts = page.evaluate(CONTRASTS)
    assert len(contrasts) > 60
    assert [found for found in contrasts if found[0] < 4.5] == []
    background = picture(page.locator("h1"))[0, 0]
    assert (background > 200).all() if scheme == "light" else (background < 60).all()
    pictures = page.locator("svg, canvas").all()
    for one in pictures:
        assert one.get_attribute("role") in ("img", "group", "application")
        assert one.get_attribute("aria-label")
    operated = page.locator("canvas, .lane" if kind == "clip" else "figure a[href^='#train']")
    assert operated.count() >= 2
    assert all(operated.evaluate_all("all => all.map(one => one.tabIndex == 0)"))
