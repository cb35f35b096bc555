"""Scenes and labels of somebody else's making that cannot be are refused in a line that names the place."""

import json
from typing import Any

import pytest

from synth3dlanes.labels import labels as label_file
from synth3dlanes.scene import scene as scene_file
from synth3dlanes.scene.roadside import Crossing
from synth3dlanes.scene.scene import Car, Scene, Symbol, Thing
from synth3dlanes.scene.traffic_elements import LaneSignal
from synth3dlanes.system.errors import FormatError
from synth3dlanes.truth.ground_truth import ground_truth
from tests.map_scenes import FOUR_WAY, map_scene
from tests.scenes import FLAT
from tests.signals import sign
from tests.test_works import CLOSED, NARROWED, SHIFTED, SHOULDER

CAR = Car(model=2, scale=1.0, color=(1, 0, 0), gloss=0.5, lane="main_2", s_m=-20.0)
CONE = Thing(kind="cone", model=1, x_m=2.0, y_m=-30.0, yaw_rad=0.0)
AT_ONCE = [{"time_s": t, "x_m": 0, "y_m": 0, "yaw_rad": 0} for t in (1, 1)]
GANTRY = Crossing(kind="gantry", s_m=0, clearance_m=5, width_m=1, color=(0, 0, 0),
                  signals=(LaneSignal(lane="exit_1", state="off"),))  # fmt: skip
ON_MAP = map_scene(FOUR_WAY, 60.0)
PIECE = FOUR_WAY.roads[0].plan[0].model_dump()
FAR = {**PIECE, "x_m": 1e5}


def works(of: Any, **changes: Any) -> dict[str, Any]:
    return {**of.model_dump(mode="json"), **changes}


# Of a scene: the place, its new value, and what is said.
SCENES: list[tuple[Scene, str, Any, str]] = [
    (FLAT, "things", [CONE.model_dump() | {"model": 3}], "things.0.model: expected at most 2, got 3"),
    (FLAT, "things", [CONE.model_dump() | {"colors": [(1, 1, 1)]}], "things.0.colors: expected 0 (none), got 1"),
    (FLAT, "things", [CONE.model_dump() | {"kind": "barrier"}], "things.0.kind: expected 'pedestrian', 'cyclist'"),
    (FLAT, "things", [CONE.model_dump() | {"track": AT_ONCE}], "in order, got 1 s"),
    (FLAT, "roadside.signs", [sign("stop", 9.0, lanes=("main_4",)).model_dump()], "expected lanes such as main_1, "),
    (FLAT, "roadside.crossings", [GANTRY.model_dump()], "roadside.crossings.0.signals: expected lanes such as"),
    (FLAT, "symbols", [Symbol(kind="arrow_left", lane="main_7", s_m=-20).model_dump()],
     "symbols.0.lane: expected one of main_1, main_2, main_3, got main_7"),
    (FLAT, "symbols", [Symbol(kind="gore", lane=None, s_m=20).model_dump()], "expected a road with an exit"),
    (FLAT, "road", {"n_lanes": 1, "topology": 3}, "at least 2 with topology 3"),
    (FLAT, "road", {"median_m": 0.4}, "expected 0 or at least 1"),
    (ON_MAP, "map.route", ["south.0.1", "north.0.-1"], "route: expected linked lanes, got south.0.1 and north.0.-1"),
    (ON_MAP, "cars", [{**CAR.model_dump(), "lane": "south.0.-3"}], "expected driving lanes of the map, got south.0.-3"),
    (ON_MAP, "map.roads.0.plan", [PIECE, FAR], "plan: expected"),
    (ON_MAP, "map.roads.0.plan", [FAR], "links: expected"),
    (FLAT, "road", {"works": works(CLOSED), "topology": 2}, "works: expected none on a road with an exit"),
    (FLAT, "road", {"works": works(CLOSED), "n_lanes": 1}, "expected open lanes, each of 2.2 m or more, got 0"),
    (FLAT, "road", {"works": works(NARROWED, taken_m=4.2)}, "expected open lanes, each of 2.2 m or more, got 3"),
    (FLAT, "road", {"works": works(CLOSED, inner=True), "n_oncoming": 1}, "expected the line between both directions"),
    (FLAT, "road", {"works": works(SHIFTED), "n_oncoming": 1}, "expected the line between both directions"),
    (FLAT, "road", {"works": works(SHIFTED, shift_m=1.5)}, "expected at most the shoulder's 1.4 m, got 1.5"),
    (FLAT, "road", {"works": works(CLOSED, end_m=5.0)}, "end_m: expected room for both tapers behind -30 m, got 5"),
    (FLAT, "road", {"works": works(CLOSED, lines="as_before")}, "expected as_before where no line moves, and only"),
    (FLAT, "road", {"works": works(SHOULDER, lines="white")}, "expected as_before where no line moves, and only there"),
    (FLAT, "road", {"works": works(CLOSED, lines="red")}, "expected 'as_before', 'white' or 'yellow'"),
]  # fmt: skip


def edited(document: Any, path: str, value: Any) -> str:
    """A document with a value, or with keys of a mapping, replaced."""
    *above, last = path.split(".")
    at = document
    for step in above:
        at = at[int(step) if step.isdigit() else step]
    at[last] = at[last] | value if isinstance(value, dict) else value
    return json.dumps(document)


@pytest.mark.parametrize(("scene", "path", "value", "words"), SCENES)
def test_a_scene_that_cannot_be(scene: Scene, path: str, value: Any, words: str) -> None:
    document = json.loads(scene_file.to_json(scene))
    document.setdefault("roadside", {})
    with pytest.raises(FormatError) as told:
        scene_file.from_json(edited(document, path, value), "scene.json")
    assert words in str(told.value)
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("category", "truncation", "words"),
    [("road_sign", 0.5, "a kind and no truncation of a road_sign"), ("van", None, "a truncation and no kind of a van")],
)
def test_an_object_has_what_its_category_has(category: str, truncation: float | None, words: str) -> None:
    document = json.loads(label_file.to_json(ground_truth(FLAT.model_copy(update={"cars": (CAR,)}))))
    changes = {"category": category, "truncation": truncation}
    with pytest.raises(FormatError, match=f"objects.0: category: expected {words}"):
        label_file.from_json(edited(document, "objects", [document["objects"][0] | changes]), "labels.json")


def test_older_labels_are_read() -> None:
    """Those without objects keep their shares; those without traffic elements have none."""
    labels = ground_truth(FLAT.model_copy(update={"cars": (CAR,)})).with_seen_shares((0.25,))
    document = json.loads(label_file.to_json(labels))
    for name in ("objects", "traffic_elements"):
        document.pop(name, None)
    older = label_file.from_json(json.dumps(document), "")
    assert (older.objects, older.traffic_elements, older.car_visible_fraction) == (None, None, (0.25,))
