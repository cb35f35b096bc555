"""The marking page and the review page in a headless Chromium: what is done in them is in the files that they save."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from synth3dlanes.geometry.frames import transform
from synth3dlanes.recorded.drives.marks import read_marks, read_review
from synth3dlanes.recorded.drives.open import open_drive
from synth3dlanes.recorded.drives.pages import ReviewedFrame, ReviewedSplit, marking_page, review_page, top_view
from synth3dlanes.truth.ground_truth import ground_truth
from tests.drives import road as made
from tests.figures.test_browser import CONTRASTS
from tests.scenes import FLAT
from tests.thorough import first

ORIGIN_M = np.array([512_000.0, 5_402_000.0])


@pytest.fixture(scope="module")
def page_text(tmp_path_factory) -> str:
    """The marking page of a drive whose poses are in a map's zone; it has one line of three points."""
    folder = made.write_described(tmp_path_factory.mktemp("drive"), made.road(6))
    rows = np.loadtxt(folder / "poses.txt")
    rows[:, 1:3] += ORIGIN_M
    np.savetxt(folder / "poses.txt", rows, fmt="%.9f")
    document = json.loads((folder / "lanes.geojson").read_text())
    line = document["features"][0]["geometry"]
    line["coordinates"] = (np.array(line["coordinates"]) + ORIGIN_M).tolist()
    (folder / "lanes.geojson").write_text(json.dumps(document))
    drive = open_drive(str(folder))
    assert np.abs(np.array(drive.origin_m[:2]) - ORIGIN_M).max() < 1
    return marking_page(drive, top_view(drive))


def saved(page: Page, path: Path, button: str = "save as a file") -> Path:
    with page.expect_download() as download:
        page.get_by_role("button", name=button).click()
    download.value.save_as(path)
    return path


def screen(page: Page, x: float, y: float) -> tuple[float, float]:
    """Where a place in metres, in the frame of the drive's poses, is on the screen."""
    return tuple(
        page.evaluate(
            """([x, y]) => {
              const box = map.getBoundingClientRect(), scale = box.width / view.metres;
              return [box.left + box.width / 2 + (x - data.origin[0] - view.x) * scale,
                      box.top + box.height / 2 - (y - data.origin[1] - view.y) * scale];
            }""",
            [x, y],
        )
    )


BAD_FILES = {
    "{": "JSON",
    '{"type": "Feature"}': "expected a FeatureCollection",
    '{"type": "FeatureCollection", "features": [{"geometry": {"type": "Point"}}]}': "feature 0: expected a Line",
}


def test_lines_are_drawn_moved_deleted_saved_and_loaded(open_page, page_text, tmp_path):
    page = open_page(page_text, width=1200)
    told = page.locator("#told")
    expect(told).to_contain_text("1 line; marked1")

    # Drawn by the mouse.
    drawn = np.add(ORIGIN_M, [[2, -6], [9, -3.5], [16, 1]])
    page.get_by_role("button", name="new line").click()
    for x, y in drawn:
        page.mouse.click(*screen(page, x, y))
    page.get_by_role("button", name="finish line").click()
    expect(told).to_contain_text("2 lines; marked2")

    # A point is moved by the mouse, and the marking is chosen.
    page.mouse.move(*screen(page, *drawn[1]))
    page.mouse.down()
    page.mouse.move(*screen(page, *(drawn[1] + [0.5, 1.5])), steps=3)
    page.mouse.up()
    page.get_by_label("marking of marked2").select_option("dashed")
    page.get_by_label("direction of marked2").select_option("oncoming")

    lanes = read_marks(saved(page, tmp_path / "first.geojson"))
    pixel_m = page.evaluate("metresPerPx()")
    assert [lane.id for lane in lanes] == ["marked1", "marked2"]
    assert lanes[0].xy_world == pytest.approx(np.add(ORIGIN_M, [[0, 1], [10, 5.5], [20, 10]]), abs=1e-3)
    assert lanes[0].color == "yellow"
    assert np.abs(lanes[1].xy_world - np.add(drawn, [[0, 0], [0.5, 1.5], [0, 0]])).max() < 1.5 * pixel_m
    assert (lanes[1].marking, lanes[1].direction, lanes[1].color) == ("dashed", "oncoming", None)
    expect(told).not_to_contain_text("not saved")

    # Deleted: a point, then a line; undone; and the first file loaded again.
    page.get_by_role("button", name="marked1", exact=True).click()
    page.get_by_role("button", name="delete point").click()
    page.get_by_role("button", name="marked2", exact=True).click()
    page.get_by_role("button", name="delete line").click()
    expect(told).to_contain_text("1 line; marked1")
    expect(told).to_contain_text("not saved")
    second = read_marks(saved(page, tmp_path / "second.geojson"))
    assert [len(lane.xy_world) for lane in second] == [2]
    page.get_by_role("button", name="undo").click()
    expect(told).to_contain_text("2 lines")
    expect(told).to_contain_text("not saved")
    page.locator("#file").set_input_files(tmp_path / "first.geojson")
    expect(told).not_to_contain_text("not saved")
    third = read_marks(saved(page, tmp_path / "third.geojson"))
    assert (tmp_path / "third.geojson").read_text() == (tmp_path / "first.geojson").read_text()
    assert len(third) == 2

    # Bad files are told and change nothing.
    for number, (text, message) in enumerate(BAD_FILES.items()):
        bad = tmp_path / f"{number}.geojson"
        bad.write_text(text)
        page.locator("#file").set_input_files(bad)
        expect(told).to_contain_text(f"{bad.name}: ")
        expect(told).to_contain_text(message)
        assert page.evaluate("lines.length") == 2


def test_a_line_is_drawn_and_moved_by_the_keyboard_alone(open_page, page_text, tmp_path):
    page = open_page(page_text, width=1200)
    page.locator("#map").focus()

    def press(*keys: str) -> None:
        for key in keys:
            page.keyboard.press(key)

    start = page.evaluate("cross.map((value, i) => value + data.origin[i])")
    press("n", "Space", *["Shift+ArrowRight"] * 3, "Space", *["ArrowUp"] * 4, "Shift+ArrowRight", "Space", "Enter")
    # The middle point is taken, moved and dropped; another inserted and deleted; the line reversed twice.
    press(",", "Space", "ArrowDown", "ArrowDown", "Space", "ArrowLeft", "i", "Delete", "r", "r")
    # A line begun and given up leaves nothing.
    press("n", "Space", "Escape")
    lanes = read_marks(saved(page, tmp_path / "keys.geojson"))
    assert [lane.id for lane in lanes] == ["marked1", "marked2"]
    expected = start + np.array([[0, 0], [6, -0.2], [8, 0.4]])
    assert lanes[1].xy_world == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize(
    ("kind", "width", "scheme"),
    first(1, [("marking", 700, "dark"), ("marking", 1400, "light"), ("review", 1400, "light")]),
)
def test_pages_fit_their_screen_and_can_be_read_and_operated_by_everybody(open_page, page_text, kind, width, scheme):
    frames = [ReviewedFrame("00000000", "", ground_truth(FLAT), None)]
    page = open_page(page_text if kind == "marking" else review_page(ReviewedSplit("monday"), frames), width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert [text for ratio, text in page.evaluate(CONTRASTS) if ratio < 4.5] == []
    found = Axe().run(page).response
    assert len(found["passes"]) > 15, "rules that apply and hold"
    assert [(rule["id"], rule["impact"], len(rule["nodes"])) for rule in found["violations"]] == []


def test_frames_are_accepted_and_rejected(open_page, tmp_path):
    labels = ground_truth(FLAT)
    frames = [ReviewedFrame(f"{number:08d}", f"{number} s", labels, None) for number in range(4)]
    page = open_page(review_page(ReviewedSplit("drives/monday"), frames))
    told = page.locator("#told")
    expect(told).to_contain_text("00000000: no verdict; 0 accepted, 0 rejected of 4")
    for key in "ara":
        page.keyboard.press(key)
    expect(told).to_contain_text("00000003: no verdict; 2 accepted, 1 rejected of 4; not saved")
    assert page.locator(".reviewed").evaluate_all("all => all.map(one => one.checkVisibility())") == [False] * 3 + [
        True
    ]
    page.get_by_role("button", name="00000002").click()
    page.get_by_role("button", name="reject", exact=True).click()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("c")
    review = read_review(saved(page, tmp_path / "review.json"))
    assert review.source == "drives/monday"
    said = [(frame.name, frame.verdict) for frame in review.frames]
    assert said == [("00000000", "accepted"), ("00000002", "rejected")]
    # Loaded into a new page it gives the same file.
    other = open_page(review_page(ReviewedSplit("drives/monday"), frames))
    other.locator("#file").set_input_files(tmp_path / "review.json")
    expect(other.locator("#told")).to_contain_text("1 accepted, 1 rejected of 4")
    again = saved(other, tmp_path / "again.json")
    assert again.read_text() == (tmp_path / "review.json").read_text()


def test_lanes_are_rejected_and_known_again_by_their_places(open_page, tmp_path):
    """Verdicts of a file are taken by time and place, whatever ids are now; those on other frames are kept."""
    labels = ground_truth(FLAT)
    split = ReviewedSplit("lifted/train", "monday", (500.0, 100.0, 0.0))
    frames = [ReviewedFrame(f"{number:08d}", "", replace(labels, time_s=0.1 * number), None) for number in range(3)]
    page = open_page(review_page(split, frames))
    lane = next(lane for lane in labels.lanes if lane.kind == "delimiter")
    button = page.locator(f".reviewed:not(.off) [data-lane={lane.id}]")
    button.click()
    expect(button).to_have_attribute("aria-label", f"{lane.id} rejected")
    page.keyboard.press("r")
    review = read_review(saved(page, tmp_path / "review.json"))
    assert [(one.name, one.time_s, one.verdict) for one in review.frames] == [("00000000", 0.0, "rejected")]
    (rejected,) = review.lanes
    assert (rejected.id, rejected.verdict) == (lane.id, "rejected")
    xy = transform(labels.camera.world_from_cam, lane.xyz_cam)[:, :2] + [500.0, 100.0]
    gaps = np.linalg.norm(np.array(rejected.xy)[:, None] - xy[None], axis=2).min(axis=1)
    assert gaps.max() < 0.01
    # The first frame is gone, and the lane has another id.
    renamed = replace(labels, lanes=tuple(replace(own, id=f"new_{own.id}") for own in labels.lanes))
    later = [frame._replace(labels=replace(renamed, time_s=frame.labels.time_s)) for frame in frames[1:]]
    other = open_page(review_page(split, later, review))
    expect(other.locator("#told")).to_contain_text("0 accepted, 0 rejected of 2; 1 of")
    expect(other.locator("#told")).to_contain_text("1 verdict on what is not on this page")
    again = read_review(saved(other, tmp_path / "again.json"))
    assert again.frames == review.frames
    assert [(one.id, one.verdict) for one in again.lanes] == [(f"new_{lane.id}", "rejected")]
