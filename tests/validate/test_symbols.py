"""Symbols that are somewhere else than the scene says, or missing, are found; dots, tar and removed lines are no
fault."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from synth3dlanes.labels.labels import Labels
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.scene import Scene, Symbol
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.world import resolve
from tests.scenes import changed, hill
from tests.validate.examining import findings

pytestmark = pytest.mark.render

SETTINGS = RenderSettings(samples=2, passes=("depth", "semantic", "instance"))
# An arrow, a crosswalk and a stop line ahead of a host on a hilly bend.
SYMBOLS = (
    Symbol(kind="arrow_straight_right", lane="stem_2", s_m=-42),
    Symbol(kind="crosswalk", lane=None, s_m=-30),
    Symbol(kind="stop_line", lane=None, s_m=-36),
)


class Shot(NamedTuple):
    scene: Scene
    image: np.ndarray
    labels: Labels
    passes: dict[str, np.ndarray]


def shot(scene: Scene) -> Shot:
    picture = take_picture(resolve(scene), SETTINGS)
    return Shot(scene, picture.image, picture.labels, picture.passes)


def scene_with(symbols: tuple[Symbol, ...], **parts: dict) -> Scene:
    scene = changed(terrain={"gaussians": (hill(10, -20, 4, 60),)}, **parts)
    return scene.model_copy(update={"symbols": symbols})


def texts(of: Shot, scene: Scene | None = None) -> list[str]:
    """What the checks of symbols and paint say, by another scene if one is given."""
    sample = Evidence(resolve(scene or of.scene), of.labels, of.image, of.passes)
    found = findings(sample, "symbols", "ids", "points", "pavement", "ridges")
    return [f"{finding.lane} {finding.reason}".strip() for finding in found]


@pytest.fixture(scope="module")
def crossing() -> Shot:
    road = {"topology": 2, "offset_m50_m": 2.0, "offset_p50_m": -3.0, "flip_longitudinal": True}
    return shot(scene_with(SYMBOLS, road=road))


@pytest.fixture(scope="module")
def gore() -> Shot:
    road = {"topology": 2, "shoulder_factor": 0.8, "exit_angle_rad": 0.08, "flip_lateral": True}
    symbols = (Symbol(kind="gore", lane=None, s_m=-45),)
    camera = {"y_m": -65, "lane": 3, "height_m": 3.0, "pitch_rad": 0.12}
    return shot(scene_with(symbols, road=road, camera=camera, surface={"shoulder_texture": 2}))


@pytest.mark.parametrize("name", ["crossing", "gore"])
def test_symbols_in_place_are_right(name: str, request: pytest.FixtureRequest) -> None:
    clean = request.getfixturevalue(name)
    assert not texts(clean)
    numbers = np.unique(clean.passes["instance"][clean.passes["semantic"] == SEMANTIC_IDS["symbol"]])
    assert numbers.tolist() == [instance_id("symbol", i) for i in range(len(clean.scene.symbols))]


@pytest.mark.parametrize("without", [(), ("instance",)])
@pytest.mark.parametrize(("number", "by_m"), [(0, 0.3), (1, 1.0), (2, 0.3)])
def test_a_symbol_elsewhere_is_found(crossing: Shot, number: int, by_m: float, without: tuple[str, ...]) -> None:
    symbols = list(SYMBOLS)
    symbols[number] = SYMBOLS[number].model_copy(update={"s_m": SYMBOLS[number].s_m + by_m})
    moved = crossing.scene.model_copy(update={"symbols": tuple(symbols)})
    passes = {name: pixels for name, pixels in crossing.passes.items() if name not in without}
    name = "a symbol" if without else f"symbol {number}"
    assert any(f"pixels of {name} within" in text for text in texts(crossing._replace(passes=passes), moved))


def test_a_gore_elsewhere_is_found(gore: Shot) -> None:
    (symbol,) = gore.scene.symbols
    moved = gore.scene.model_copy(update={"symbols": (symbol.model_copy(update={"s_m": symbol.s_m - 0.6}),)})
    assert any("pixels of symbol 0 within its paint" in text for text in texts(gore, moved))


def test_a_symbol_of_another_lane_or_kind_is_found(crossing: Shot) -> None:
    for change in ({"lane": "stem_3"}, {"kind": "arrow_straight_left"}):
        symbols = (SYMBOLS[0].model_copy(update=change), *SYMBOLS[1:])
        found = texts(crossing, crossing.scene.model_copy(update={"symbols": symbols}))
        assert any("pixels of symbol 0 within its paint" in text for text in found)


def test_pixels_of_a_symbol_that_is_missing_or_not_in_the_scene_are_found(crossing: Shot) -> None:
    bare = crossing.scene.model_copy(update={"symbols": ()})
    assert any("pixels of a symbol within its paint" in text for text in texts(crossing, bare))
    is_first = crossing.passes["instance"] == instance_id("symbol", 0)
    ids = {
        "semantic": np.where(is_first, SEMANTIC_IDS["road"], crossing.passes["semantic"]),
        "instance": np.where(is_first, 0, crossing.passes["instance"]),
    }
    found = texts(crossing._replace(passes=crossing.passes | ids))
    assert any("pixels of symbol 0 in all of its paint" in text for text in found)


def test_labels_of_symbols_are_compared_with_the_scene(crossing: Shot) -> None:
    symbols = crossing.labels.symbols
    moved = replace(
        crossing.labels, symbols=tuple(replace(symbol, xyz_cam=symbol.xyz_cam + 0.01) for symbol in symbols)
    )
    world = resolve(crossing.scene)
    assert [found.lane for found in findings(Evidence(world, moved), "labels")] == ["symbol 0", "symbol 1", "symbol 2"]
    none = findings(Evidence(world, replace(crossing.labels, symbols=())), "labels")
    assert [finding.reason.partition(":")[0] for finding in none] == ["symbols"]


def test_dots_and_seams_pass_as_what_they_are() -> None:
    surface = {"tar": 1.0, "joint": 1.0, "ghost_lines": 1.0}
    dotted = shot(scene_with((), markings={"dots": True, "dash_cycle_m": 8.0}, surface=surface))
    assert not texts(dotted)
    plain = shot(scene_with(()))
    for name in ("depth", "semantic"):
        assert dotted.passes[name].shape == plain.passes[name].shape
    is_paint = dotted.passes["semantic"] == SEMANTIC_IDS["marking"]
    assert 0 < is_paint.sum() < (plain.passes["semantic"] == SEMANTIC_IDS["marking"]).sum()
    assert np.abs(dotted.image.astype(int) - plain.image)[~is_paint & (plain.passes["semantic"] == 2)].mean() > 2
    assert set(np.unique(dotted.passes["instance"])) == set(np.unique(plain.passes["instance"])) | {201, 202}
