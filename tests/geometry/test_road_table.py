"""Roads as arrays: many places asked together are those asked one by one; places near roads are all that are near."""

from collections.abc import Iterator

import numpy as np
import pytest

from synth3dlanes.roads.network import Network
from synth3dlanes.roads.road_table import RoadTable
from synth3dlanes.scene.road_map import MapShape, MapSpan, Polynomial, RoadMap
from synth3dlanes.world.graded import EMBANKMENT_M, GradedGround
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.world import World, resolve
from tests.map_scenes import FOUR_WAY, HILLS, map_scene, sections_road


def _hilly(roads: RoadMap) -> RoadMap:
    """The map at heights of its own that rise over the hills, banked, and with a bump."""
    heights = (Polynomial(s_m=0.0, a=4.0, b=0.02), Polynomial(s_m=30.0, a=4.6, b=0.02, c=-1e-4))
    shapes = tuple(MapShape(s_m=s, t_m=-6.0, a=a, b=0.001) for s, a in ((0.0, 0.0), (20.0, 0.3), (40.0, 0.0)))
    changed = (
        road.model_copy(
            update={
                "heights": heights,
                "banks": (Polynomial(s_m=0.0, a=0.03, b=-1e-3),),
                "shapes": shapes if i % 2 else (),
            }
        )
        for i, road in enumerate(roads.roads)
    )
    return roads.model_copy(update={"roads": tuple(changed)})


WORLDS = {"crossing": (FOUR_WAY, 95.0), "hilly": (_hilly(FOUR_WAY), 95.0), "sections": (sections_road(), 40.0)}


@pytest.fixture(scope="module", params=sorted(WORLDS))
def world(request: pytest.FixtureRequest) -> World:
    roads, at_m = WORLDS[request.param]
    return resolve(map_scene(roads, at_m, terrain=HILLS.model_dump()))


@pytest.fixture
def network(world: World) -> Network:
    return world.network


def test_places_of_many_roads_are_those_of_each(network: Network, rng: np.random.Generator) -> None:
    table = RoadTable(network.roads, network.terrain)
    road = rng.integers(0, len(network.roads), 400)
    share = rng.uniform(-0.1, 1.1, 400)
    share[:40] = rng.integers(0, 2, 40)
    s, t = share * table.end_m[road], rng.uniform(-9, 9, 400)
    starts = np.array([at.start_m for one in network.roads for at in one.sections])
    s[40:80] = rng.choice(starts, 40)
    lefts, rights = table.edges(road, s)
    points = table.base_points(road, s, t)
    for i, one in enumerate(network.roads):
        at = road == i
        np.testing.assert_array_equal(lefts[at], one.left(s[at]))
        np.testing.assert_array_equal(rights[at], one.right(s[at]))
        np.testing.assert_allclose(points[at], one.base_points(s[at], t[at]), rtol=0, atol=1e-12)


@pytest.mark.parametrize("reach_m", [0.0, 3.0, 25.0])
def test_all_roads_near_a_point_are_found_and_the_points_are_there(
    network: Network, reach_m: float, rng: np.random.Generator
) -> None:
    xy = rng.uniform(-70, 70, (120, 2))
    places = network.index.places(xy, reach_m)
    np.testing.assert_allclose(
        network.index.table.xy(places.road, places.s, places.t), xy[places.point], rtol=0, atol=2e-3
    )
    found = set(zip(places.point.tolist(), places.road.tolist(), strict=True))
    for i, road in enumerate(network.roads):
        s = np.linspace(road.start_m, road.end_m, 400)
        share = np.linspace(0, 1, 8)[:, None]
        pavement = road.xy(np.tile(s, 8), (road.left(s) + share * (road.right(s) - road.left(s))).ravel())
        away_m = np.array([np.hypot(*(pavement - place).T).min() for place in xy])
        missed = [k for k in np.flatnonzero(away_m < reach_m - 0.5).tolist() if (k, i) not in found]
        # Past the middle of a bend there is no foot.
        assert all(not _has_foot(road, xy[k : k + 1]) for k in missed), missed


def _has_foot(road, xy: np.ndarray) -> bool:
    s = np.linspace(road.start_m, road.end_m, 4000)
    points, normals, _, _ = road.line.frames(s)
    along = np.cross(normals, xy - points)
    return bool((np.diff(np.sign(along)) != 0).any())


def test_no_point_is_on_a_road_whose_pavement_is_far_from_it(network: Network, rng: np.random.Generator) -> None:
    """Inside a tight bend Newton's method may end on the road's other side."""
    xy = rng.uniform(-40, 40, (3000, 2))
    places = network.index.places(xy, EMBANKMENT_M)
    left, right = network.index.table.edges(places.road, places.s)
    on = (places.t > left) & (places.t < right) & (places.s > 0) & (places.s < network.index.table.end_m[places.road])
    there = network.index.table.xy(places.road, places.s, places.t)
    assert on.any()
    np.testing.assert_allclose(there[on], xy[places.point[on]], rtol=0, atol=2e-3)


# -- the ground


def _grounds() -> Iterator[tuple[str, Ground]]:
    spans = {"bridges": (MapSpan(from_m=30.0, to_m=60.0),), "tunnels": (MapSpan(from_m=80.0, to_m=110.0),)}
    hilly = _hilly(FOUR_WAY)
    changed = tuple(road.model_copy(update=spans) if road.id == "east" else road for road in hilly.roads)
    for name, roads in (("hilly", hilly), ("spans", hilly.model_copy(update={"roads": changed}))):
        yield name, resolve(map_scene(roads, 95.0, terrain=HILLS.model_dump())).ground


GROUNDS = dict(_grounds())


@pytest.mark.parametrize("name", sorted(GROUNDS))
def test_heights_of_many_places_are_those_of_each(name: str, rng: np.random.Generator) -> None:
    ground = GROUNDS[name]
    xy = rng.uniform(-130, 130, (40, 2))
    asked = ground.height, ground.paved.graded, ground.paved.bed_height
    together = [height(xy) for height in asked]
    for k, place in enumerate(xy):
        assert [height(place[None])[0] for height in asked] == pytest.approx([at[k] for at in together], abs=1e-9)


@pytest.mark.parametrize("name", sorted(GROUNDS))
def test_the_ground_is_nowhere_beyond_its_limits_and_points_are_in_it_below_its_height(
    name: str, rng: np.random.Generator
) -> None:
    ground = GROUNDS[name]
    xy = rng.uniform(-130, 130, (3000, 2))
    graded: GradedGround = ground.paved.graded_ground
    least_m, most_m = graded.limits(xy)
    above = graded.above(xy, np.zeros(len(xy), dtype=bool))
    assert (above <= most_m).all()
    assert (above >= least_m).all()
    assert (most_m[np.hypot(*xy.T) < 10] < 8).all(), "limits that say something"
    z = ground.height(xy) + rng.uniform(-3, 3, len(xy))
    clear = ~ground.is_stacked(xy)
    points = np.column_stack([xy, z])
    np.testing.assert_array_equal(ground.is_in(points)[clear], (ground.height(xy) > z)[clear])
