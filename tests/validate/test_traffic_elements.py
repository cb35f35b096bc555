"""Traffic elements that are not what pixels show are found, and those of another scene."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import resolve
from tests.signals import signals_scene
from tests.validate.examining import findings, reasons

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def sample() -> Evidence:
    world = resolve(signals_scene())
    picture = take_picture(world, RenderSettings(samples=1, passes=("depth", "semantic", "instance")))
    return Evidence(world, picture.labels, picture.image, picture.passes)


def with_elements(sample: Evidence, items: list[ObjectLabel]) -> Evidence:
    labels = replace(sample.labels, traffic_elements=tuple(items))
    return Evidence(sample.world, labels, sample.image, dict(sample.passes))


def item_of(sample: Evidence, category: str, **other: object) -> ObjectLabel:
    return next(
        item
        for item in sample.labels.traffic_elements
        if item.category == category and all(getattr(item, name) == value for name, value in other.items())
    )


def test_a_right_sample_has_no_findings(sample):
    items = sample.labels.traffic_elements
    assert len(items) == 9
    assert [item.visible_fraction for item in items if item.kind != "information"] == pytest.approx([1] * 8, abs=0.01)
    assert findings(sample, "labels", "ids") == []


def move(*by_m: float) -> Callable[[ObjectLabel], ObjectLabel]:
    return lambda item: replace(item, center_cam=item.center_cam + item.cam_from_object[:3, :3] @ np.array(by_m))


@pytest.mark.parametrize("group", ["signs", "signals"])
@pytest.mark.parametrize("step", [{"x_m": 0.15}, {"height_m": 0.15}, {"y_m": -0.15}])
def test_pixels_tell_that_the_scene_has_them_elsewhere(sample, group, step):
    roadside = sample.scene.roadside
    (name, by_m), (item, *others) = *step.items(), getattr(roadside, group)
    moved = item.model_copy(update={name: getattr(item, name) + by_m})
    scene = sample.scene.model_copy(update={"roadside": roadside.model_copy(update={group: (moved, *others)})})
    assert "pixels of structure" in reasons(replace(sample, known_world=resolve(scene)), "ids")


def test_pixels_alone_tell_a_wrong_share(sample):
    items = sample.labels.traffic_elements
    wrong = [replace(item, visible_fraction=item.visible_fraction - 0.01) for item in items]
    found = [finding.reason for finding in findings(with_elements(sample, wrong), "labels")]
    expected = [f"traffic_elements.{item.id}: visible_fraction: expected {item.visible_fraction}" for item in items]
    assert [reason.partition(", got")[0] for reason in found] == expected


def test_lights_shine_as_their_states_say(sample):
    def levels(category: str, state: str) -> np.ndarray:
        """Red and green of the brightest tenth of the pixels of each third of a head, from the top."""
        item = item_of(sample, category, state=state)
        own = sample.passes["instance"] == item.id
        rows = np.array_split(np.flatnonzero(own.any(axis=1)), 3)
        thirds = [sample.picture[part][own[part]].astype(float) for part in rows]
        chosen = [pixels[pixels.max(axis=1) >= np.quantile(pixels.max(axis=1), 0.9)] for pixels in thirds]
        return np.array([pixels[:, :2].mean(axis=0) for pixels in chosen])

    for state, lit in (("red", 0), ("green", 2)):
        bright = levels("traffic_light", state).max(axis=1)
        assert bright.argmax() == lit
        assert np.sort(bright)[-2] < bright[lit] - 50
    assert np.subtract(*levels("lane_signal", "red_cross")[1]) > 12
    assert np.subtract(*levels("lane_signal", "green_arrow")[1]) < -12


def test_elements_that_are_not_those_of_the_scene_are_found(sample):
    items = list(sample.labels.traffic_elements)
    stop = next(number for number, item in enumerate(items) if item.kind == "stop")

    def told(changed: ObjectLabel) -> str:
        return reasons(with_elements(sample, [*items[:stop], changed, *items[stop + 1 :]]), "labels")

    assert "kind: expected" in told(replace(items[stop], kind="give_way"))
    assert "category: expected" in told(replace(items[stop], category="traffic_light"))
    assert "lanes.0: expected" in told(replace(items[stop], lanes=("main_1",)))
    assert "center_cam" in told(move(0.01, 0, 0)(items[stop]))
    assert "seen_box_px" in told(replace(items[stop], seen_box_px=items[stop].seen_box_px + 1))


def test_a_dropped_element_is_found_by_the_scene_and_one_that_the_scene_has_not_by_its_pixels(sample):
    items = list(sample.labels.traffic_elements)
    assert "as in the scene" in reasons(with_elements(sample, items[1:]), "labels")
    roadside = sample.scene.roadside
    bare = resolve(
        sample.scene.model_copy(update={"roadside": roadside.model_copy(update={"signals": (), "signs": ()})})
    )
    assert "pixels of structure" in reasons(replace(sample, known_world=bare), "ids")
