"""The one rule of instance ids, and a scene with more delimiters than their first ids and 8 bits have numbers."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.verify import verify
from synth3dlanes.params.params import load_params
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene.instance_ids import END, KINDS, RANGES, instance_id, kind_indices, most_of, numbers_of, thing_of
from synth3dlanes.scene.road_map import MapLane, MapMark, MapRoad, MapSection, PlanPiece, RoadMap
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import World, resolve
from tests.map_scenes import constant, map_scene
from tests.validate.examining import findings

# Data sets on disk have these.
KNOWN = [("car", 0, 1), ("car", 198, 199), ("delimiter", 0, 200), ("delimiter", 99, 299), ("delimiter", 100, 20_100)]
KNOWN += [("tree", 0, 300), ("tree", 5699, 5999), ("structure", 0, 6000), ("structure", 2999, 8999)]
KNOWN += [("symbol", 0, 9000), ("symbol", 999, 9999), ("bonnet", 0, 10_000)]
KNOWN += [("thing", 0, 10_001), ("thing", 998, 10_999)]
# Those of a scene at most, and delimiters of a map of hundreds of roads.
LEAST = {"car": 1000, "tree": 10_000, "symbol": 1000, "bonnet": 1, "structure": 8000, "delimiter": 20_000, "thing": 900}
N_ROADS, N_LANES, LANE_M = 7, 20, 0.7


def test_every_thing_has_an_id_of_its_own_that_gives_it_back():
    numbered = [(kind, number) for kind in KINDS for number in range(most_of(kind))]
    ids = np.array([instance_id(*thing) for thing in numbered])
    assert len(np.unique(ids)) == len(ids)
    assert ids.min() == 1
    assert ids.max() == END - 1
    assert [thing_of(id_) for id_ in ids.tolist()] == numbered
    for kind in KINDS:
        expected = [number if of == kind else -1 for of, number in numbered]
        np.testing.assert_array_equal(numbers_of(kind, ids.astype(np.uint16)), expected)
    np.testing.assert_array_equal(kind_indices(ids), [KINDS.index(kind) for kind, _ in numbered])
    assert thing_of(0) == ("nothing", 0)
    assert kind_indices(np.array([0])) == numbers_of("car", np.array([0])) == -1


def test_ids_of_data_sets_on_disk_stay_what_they_are():
    assert [instance_id(kind, number) for kind, number, _ in KNOWN] == [id_ for *_, id_ in KNOWN]
    assert {kind: most_of(kind) for kind, least in LEAST.items() if most_of(kind) < least} == {}
    with pytest.raises(InputError, match="at most 1000 of the kind symbol, got 1001"):
        instance_id("symbol", 1000)


def test_the_table_of_the_page_is_the_rule():
    page = (Path(__file__).parent.parent / "docs/format.md").read_text()
    told = [f"{ids.first_id - ids.first_number:,} + i" for ids in RANGES if ids.kind != "bonnet"]
    assert [text for text in told if f" {text} " not in page] == []


def parallel_roads() -> RoadMap:
    """Roads of many narrow lanes side by side; the host's is in the middle, and the last one."""
    lanes = tuple(
        MapLane(number=n, kind="driving" if n else "none", marks=(MapMark(kind="solid"),))
        if n == 0
        else MapLane(number=n, kind="driving", widths=constant(LANE_M), marks=(MapMark(kind="solid"),))
        for n in range(-N_LANES, N_LANES + 1)
    )
    places = sorted(range(N_ROADS), key=lambda i: -abs(i - N_ROADS // 2))
    roads = tuple(
        MapRoad(
            id=f"r{i}",
            plan=(PlanPiece(x_m=(i - N_ROADS // 2) * (2 * N_LANES * LANE_M + 4), y_m=-20, heading_rad=np.pi / 2,
                            length_m=140),),
            sections=(MapSection(s_m=0.0, lanes=lanes),),
        )
        for i in places
    )  # fmt: skip
    return RoadMap(roads=roads, links=(), route=(f"r{places[-1]}.0.-1",))


@dataclass(frozen=True)
class Parallel(Recipe):
    """A sample on these roads."""

    def world(self, index: int) -> World:
        return resolve(map_scene(parallel_roads(), 10.0, cars=(), trees=()))


@pytest.mark.thorough
@pytest.mark.render
def test_hundreds_of_delimiters_are_told_apart_by_all_readers(tmp_path):
    passes = ("depth", "semantic", "instance")
    recipe = Parallel(Scenes(load_params("tiny"), 0), RenderSettings(1, passes), "png")
    generate(Plan(tmp_path / "data", 1, recipe, workers=1), lambda event: None)
    reader = Reader(str(tmp_path / "data/train"))
    sample, ids = reader[0], reader.passes(0)
    names = [lane.id for lane in sample.labels.lanes if lane.kind == "delimiter"]
    assert len(names) > 256

    evidence = Evidence(recipe.world(0), sample.labels, sample.image, ids)
    assert findings(evidence, "ids", "points", "cars", "appearance", "bias") == []

    numbers = numbers_of("delimiter", ids["instance"])
    seen = {names[number] for number in np.unique(numbers[numbers >= 0]).tolist()}
    assert len([name for name in seen if name.startswith(evidence.scene.map.roads[-1].id)]) > 10
    for name in ("masks", "coco"):
        export = Export(str(tmp_path / "data"), tmp_path / name, name)
        export.write()
        assert [problem for result in verify(export, 9) for problem in result.problems] == []
    coco = json.loads((tmp_path / "coco/annotations/instances_train.json").read_text())
    assert {item["lane"]["id"] for item in coco["annotations"] if "lane" in item} == seen
