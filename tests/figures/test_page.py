"""Pages stand alone: nothing in them leads outside."""

import base64
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from synth3dlanes.figures.page import scene_page
from synth3dlanes.figures.samples import ShownScene
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.world.horizon import MAX_CELL_SCALE
from synth3dlanes.world.paved_areas import UNDER_FALL_M
from synth3dlanes.world.surfaces import SKIRT_M

VOID = {"meta", "link", "input", "img"}


class Wellformed(HTMLParser):
    """Checks that tags nest, and collects every address."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def check(page: str) -> Wellformed:
    parser = Wellformed()
    parser.feed(page)
    assert parser.open == []
    assert all(address.startswith(("data:", "#")) for address in parser.addresses)
    assert not re.search(r"https?://|//cdn|@import|fetch\(|XMLHttpRequest|import\(", page)
    return parser


@pytest.mark.parametrize("with_image", [False, True])
def test_a_scene_page_loads_nothing(with_image, gray_image, exit_scene):
    scene = exit_scene
    parser = check(scene_page(ShownScene(scene, ground_truth(scene), gray_image if with_image else None)))
    assert len(parser.addresses) == 1 + with_image


def space_of(scene, name):
    """Vertices, their colours and faces of a group of the page's 3D view."""
    page = scene_page(ShownScene(scene, ground_truth(scene), None))
    found = re.search(r'id="space-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    (group,) = (group for group in json.loads(found[1])["groups"] if group["name"] == name)
    types = {"vertices": "<f4", "colors": "u1", "faces": "<u4"}
    return [np.frombuffer(base64.b64decode(group[key]), dtype).reshape(-1, 3) for key, dtype in types.items()]


def test_the_space_holds_the_road_of_the_scene(flat_scene):
    vertices, _, faces = space_of(flat_scene, "road")
    half_m = 1.5 * 3.5 + 0.4 * 3.5
    assert np.allclose([vertices[:, 0].min(), vertices[:, 0].max()], [-half_m, half_m], atol=1e-3)
    # With upright faces at its edges, which reach below the terrain's bed, deeper where its cells are large.
    assert -SKIRT_M - MAX_CELL_SCALE * UNDER_FALL_M < vertices[:, 2].min() < -SKIRT_M - UNDER_FALL_M
    assert vertices[:, 2].max() == pytest.approx(0.0, abs=1e-3)
    assert faces.max() == len(vertices) - 1


@pytest.mark.parametrize("is_yellow", [False, True])
def test_only_the_left_edge_is_yellow_where_the_scene_says_so(flat_scene, is_yellow):
    markings = flat_scene.markings.model_copy(update={"left_yellow": is_yellow})
    vertices, colors, _ = space_of(flat_scene.model_copy(update={"markings": markings}), "paint")
    looks_yellow = colors[:, 0].astype(int) - colors[:, 2] > 60
    left_edge_m = vertices[:, 0].min()
    assert np.array_equal(looks_yellow, is_yellow & (vertices[:, 0] < left_edge_m + 0.5))


def test_a_report_shows_samples_and_distributions(report):
    addresses = check(report).addresses
    assert "a &lt;set&gt;" in report
    assert [address for address in addresses if address.startswith("#train")] == [f"#train:{i:08d}" for i in range(2)]
    assert report.count('<figure id="train:') == 2
    assert "road.lane_width_m: 2 values from 3.2 to 4" in report
