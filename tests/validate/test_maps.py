"""Validate on rendered scenes of maps: nothing is found in clean ones, and faults that are planted are."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from synth3dlanes.dataset.format import read_passes
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels import labels as label_file
from synth3dlanes.production.recipe import make_image
from synth3dlanes.scene.assets.catalogue import BUILT_IN
from synth3dlanes.scene.road_map import RoadMap
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.validate.checks import CHECKS
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding
from synth3dlanes.world.world import resolve
from tests.map_scenes import FOUR_WAY, HILLS, LEFT_TURN, map_scene, sections_road

pytestmark = [pytest.mark.render, pytest.mark.thorough]
SETTINGS = RenderSettings(samples=2, passes=("depth", "normal", "semantic", "instance", "height"))
CARS = tuple(
    {"model": 1 + i, "scale": 1.0, "color": (0.7, 0.1, 0.1), "gloss": 0.5, "lane": lane, "s_m": s_m}
    for i, (lane, s_m) in enumerate((("east.0.1", 14.0), ("south_north.0.-1", 14.0), ("north.0.1", 30.0)))
)


def raised() -> RoadMap:
    """The road with sections on a bank above the plain."""
    values = sections_road().model_dump()
    values["roads"][0]["heights"] = ({"s_m": 0.0, "a": 2.0, "b": 0.03}, {"s_m": 80.0, "a": 4.4, "b": -0.04})
    return RoadMap.model_validate(values)


SCENES = {
    "before": map_scene(FOUR_WAY, 95.0, cars=CARS, terrain=HILLS.model_dump()),
    "turning": map_scene(LEFT_TURN, 128.0, cars=CARS[2:], terrain=HILLS.model_dump()),
    "raised": map_scene(raised(), 20.0),
}


def evidence_of(scene: Scene) -> Evidence:
    members = make_image(resolve(scene), SETTINGS, "png", BUILT_IN).members
    image = np.asarray(Image.open(io.BytesIO(members["png"])).convert("RGB"))
    passes = dict(read_passes(members["passes.exr"], "")) | dict(read_passes(members["height.exr"], ""))
    return Evidence(resolve(scene), label_file.from_json(members["labels.json"], ""), image, passes)


def found_by(evidence: Evidence) -> dict[str, list[str]]:
    found = {
        check.name: [str(result) for result in check.of(evidence) if isinstance(result, Finding)]
        for check in CHECKS
        if check.needs <= evidence.has
    }
    return {name: texts for name, texts in found.items() if texts}


@pytest.fixture(scope="module")
def made() -> dict[str, Evidence]:
    return {name: evidence_of(scene) for name, scene in SCENES.items()}


@pytest.mark.parametrize("name", SCENES)
def test_nothing_is_found_in_clean_pictures_of_maps(made, name):
    assert found_by(made[name]) == {}


def test_a_connector_that_is_moved_or_renamed_is_found(made):
    clean = made["before"]

    def with_lanes(change) -> Evidence:
        lanes = tuple(change(lane) if lane.id == "south_west.0.-1" else lane for lane in clean.labels.lanes)
        return replace(clean, labels=replace(clean.labels, lanes=lanes))

    aside = np.array([0.3, 0.0, 0.0])
    assert "labels" in found_by(with_lanes(lambda lane: replace(lane, xyz_cam=lane.xyz_cam + aside)))
    assert "labels" in found_by(with_lanes(lambda lane: replace(lane, connector=False)))
    assert "labels" in found_by(with_lanes(lambda lane: replace(lane, direction="same")))
    yields = clean.labels.graph.yields[1:]
    graph = replace(clean.labels.graph, yields=yields)
    assert "labels" in found_by(replace(clean, labels=replace(clean.labels, graph=graph)))


def test_a_stop_line_elsewhere_than_the_map_has_it_is_found(made):
    values = SCENES["before"].model_dump()
    paint = values["map"]["paint"]
    values["map"]["paint"] = tuple(dict(item, s_m=item["s_m"] + 0.7) if item["lane"] else item for item in paint)
    assert {"labels", "symbols"} <= set(
        found_by(replace(made["before"], known_world=resolve(Scene.model_validate(values))))
    )


def test_an_arm_that_is_turned_or_wider_is_found(made):
    values = SCENES["before"].model_dump()
    north = next(road for road in values["map"]["roads"] if road["id"] == "north")
    north["plan"][0]["heading_rad"] += 0.02
    found = set(found_by(replace(made["before"], known_world=resolve(Scene.model_validate(values)))))
    assert "labels" in found


def test_the_pictures_show_terrain_road_and_walkway_where_the_map_has_them(made):
    """By polygons of the test's own, without the program's ground."""
    evidence = made["before"]
    semantic, depth = evidence.passes["semantic"], evidence.passes["depth"]
    rows, columns = np.nonzero(
        (depth < 60) & np.isin(semantic, [SEMANTIC_IDS[k] for k in ("terrain", "road", "shoulder")])
    )
    rows, columns = rows[::7], columns[::7]
    x, y, _ = evidence.points_world(rows, columns).T
    on_arm = (y < -13) & (y > -130)
    aside = np.abs(x)
    expected = np.where(aside < 3.5, "road", np.where(aside < 5.9, "shoulder", "terrain"))
    clear = on_arm & (np.abs(aside - 3.5) > 0.1) & (np.abs(aside - 3.9) > 0.1) & (np.abs(aside - 5.9) > 0.2)
    ids = np.array([SEMANTIC_IDS[name] for name in expected])
    assert clear.sum() > 500
    assert (ids == semantic[rows, columns])[clear].mean() > 0.995


def test_a_crossing_line_is_seen_where_its_points_say(made):
    evidence = made["before"]
    stop = evidence.labels.symbols[0]
    points = transform(evidence.camera.world_from_cam, stop.xyz_cam)
    assert stop.kind == "stop_line"
    np.testing.assert_allclose(points[:, 0].min(), 0.1, atol=0.01)
    np.testing.assert_allclose([points[:, 1].min(), points[:, 1].max()], [-13.25, -12.75], atol=0.01)
