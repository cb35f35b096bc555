"""What a map costs: as much as its file says, not as its roads are long; what is far from the host costs nothing."""

import math
import time
from collections.abc import Sequence
from functools import partial

import numpy as np
import pytest

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.cubics import times, value, values
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.scene.road_map import PlanPiece, Polynomial
from tests.maps.files import lane, opendrive, road, section

LENGTH_M = 99_000.0
WIDTH = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
BANKED = (
    '<elevationProfile><elevation s="0" a="0" b="0.01" c="0" d="0"/></elevationProfile>'
    '<lateralProfile><superelevation s="0" a="0.05" b="1e-6" c="0" d="0"/></lateralProfile>'
)


def far(name: int, form: str = "<line/>") -> str:
    """A banked road of 99 km with 20 lanes."""
    pieces = (
        f'<planView><geometry s="0" x="0" y="{300 * name}" hdg="0" length="{LENGTH_M}">{form}</geometry></planView>'
    )
    lanes = section(*(lane(n, WIDTH) for n in range(-10, 11) if n))
    return road(pieces, lanes, str(name), profile=BANKED)


def test_roads_of_a_hundred_kilometres_cost_what_their_file_says() -> None:
    start = time.process_time()
    given = read_opendrive(opendrive(*(far(i) for i in range(20))), "x.xodr", "map x.xodr")
    assert not given.broken
    params = load_params("tiny", ("cars.n=1", "trees.n=0"))
    world = sample_world(Scenes(params, 1, "train", map=MapPlace(given)), 0)
    assert time.process_time() - start < 10.0
    assert max(at.length_m for at in world.scene.map.roads) < 2500
    assert len(world.scene.model_dump_json()) < 100_000


@pytest.mark.parametrize(
    "form",
    ["<line/>", '<arc curvature="1e-4"/>', '<spiral curvStart="-1e-4" curvEnd="2e-4"/>'],
    ids=["line", "arc", "spiral"],
)
def test_the_parts_of_a_long_piece_are_the_piece(form: str) -> None:
    pieces = f'<planView><geometry s="0" x="5" y="7" hdg="0.3" length="{{}}">{form}</geometry></planView>'
    short, whole = _plan(pieces.format(999.0)), _plan(pieces.format(5700.0))
    assert len(short) == 1
    assert len(whole) == 10
    one = whole[0].model_copy(update={"length_m": 5700.0, "curvature_end": whole[-1].curvature_end})
    s = np.linspace(0, 5700, 400)
    assert plan_points(whole, s) == pytest.approx(plan_points([one], s), abs=1e-6)


def _plan(pieces: str) -> tuple[PlanPiece, ...]:
    (only,) = read_opendrive(opendrive(road(pieces)), "x.xodr", "map x.xodr").roads.values()
    return only.plan


def _cosine(bank: Sequence[Polynomial], s_m: float, end_m: float) -> float:
    return math.cos(value(bank, s_m, end_m))


def test_products_are_as_exact_with_few_pieces_as_with_many() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        starts = [0.0, *np.sort(rng.uniform(10, 900, 3)).tolist()]
        one = [
            Polynomial(s_m=s, a=a, b=b)
            for s, a, b in zip(starts, rng.uniform(-4, 4, 4), rng.normal(0, 0.01, 4), strict=True)
        ]
        bank = [Polynomial(s_m=0.0, a=0.1, b=float(rng.normal(0, 1e-3)), c=float(rng.normal(0, 1e-6)))]
        found = times(one, partial(_cosine, bank), 1000.0)
        s = np.linspace(0, 1000, 3001)
        assert values(found, s) == pytest.approx(values(one, s) * np.cos(values(bank, s)), abs=5e-5)
        assert len(found) < 150


def test_values_at_many_stations_are_those_at_each() -> None:
    pieces = [Polynomial(s_m=s, a=s, b=0.1, c=0.01, d=-0.001) for s in (1.0, 4.0, 9.0)]
    s = np.linspace(-2, 12, 57) + 0.01
    assert values(pieces, s).tolist() == pytest.approx([value(pieces, x) for x in s.tolist()])
    assert values((), s).tolist() == [0.0] * 57
