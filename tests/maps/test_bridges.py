"""Roads over roads of given maps: what is seen below a bridge, and the heights there."""

import numpy as np
import pytest

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.roads.maps.part import read_place
from synth3dlanes.scene.roadside import MAX_RAILS
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.faces import MeshFaces
from synth3dlanes.world.height_map import height_map
from synth3dlanes.world.spans import CEILING_M, COVER_M, DECK_M
from synth3dlanes.world.world import World
from tests.geometry.test_map_ground import gaps
from tests.maps.files import TWO, opendrive, plan, road

EAST, NORTH = plan(("<line/>", 400.0)), plan(("<line/>", 400.0), start=(200.0, -200.0, np.pi / 2))
# Up to 6 m over the other road, 40 m long, and down again.
OVER = ((0, 0, 0), (40, 0, 0.05), (160, 6, 0), (240, 6, -0.05), (360, 0, 0))
PROFILE = "".join(f'<elevation s="{s}" a="{a}" b="{b}" c="0" d="0"/>' for s, a, b in OVER)


# A road up to a bridge over another and down again, a level one 8 m over it, and a tunnel.
CLIMBING = road(NORTH, TWO, "2", profile=f"<elevationProfile>{PROFILE}</elevationProfile>")
LEVEL = '<elevationProfile><elevation s="0" a="8" b="0" c="0" d="0"/></elevationProfile>'
TUNNEL = '<objects><tunnel s="150" length="80" id="1"/></objects>'


def world_at(place: str, *roads: str) -> World:
    """A scene at a place of a file with these roads, without hills."""
    given = read_opendrive(opendrive(*roads), "t", "map t")
    params = load_params("streets", ("cars.n=0", "trees.n=0", "terrain.n_gaussians=1", "terrain.magnitude_m=0"))
    return sample_world(Scenes(params, 1, map=MapPlace(given, read_place(given, place))), 0)


@pytest.mark.parametrize(("place", "hidden"), [("1:160:-1", "2.0.-1"), ("2:180:-1", "1.0.-1")])
def test_a_deck_hides_the_other_road_at_the_crossing_alone(place: str, hidden: str) -> None:
    """From below and from above; the lower road is seen through below it."""
    world = world_at(place, road(EAST, TWO, "1"), CLIMBING)
    lanes = {lane.id: lane for lane in ground_truth(world.scene).lanes}
    crossing = np.abs(lanes[hidden].xyz_cam[:, 0]) < 2
    assert crossing.any()
    assert not lanes[hidden].terrain_visible[crossing].any()
    lower = lanes["1.0.-1"]
    if hidden != "1.0.-1":
        assert lower.xyz_cam[-1, 1] > 100
        assert lower.terrain_visible[:-2].all()
    assert world.view.world_from_road[2, 3] == pytest.approx(0.0, abs=0.01)
    # In the middle columns, from the host to 40 m ahead, the height map is that of its own road.
    heights_m = height_map(world.ground, world.view.world_from_road)
    assert np.abs(heights_m[100:, 48:52]).max() < 0.05


@pytest.fixture(scope="module")
def level() -> World:
    return world_at("1:165:-1", road(EAST, TWO, "1"), road(NORTH, TWO, "2", profile=LEVEL))


def test_the_ground_goes_on_below_a_deck(level: World) -> None:
    ground, lower, upper = level.ground, level.network.road("1"), level.network.road("2")
    (deck,) = ground.paved.spans
    assert deck.road.id == "2"
    assert not len(gaps(level.site.surfaces.terrain))
    assert deck.to_m - deck.from_m == pytest.approx(2 * (3.5 + 2.5 + 1.5 * 8), abs=3)
    s = np.linspace(deck.from_m + 0.3, deck.to_m - 0.3, 120)
    for t in (-3.0, 0.0, 3.0):
        top, xy = upper.points(s, np.full(len(s), t)), upper.xy(s, np.full(len(s), t))
        terrain_m = MeshFaces([level.site.surfaces.terrain]).height(xy)
        assert np.isfinite(terrain_m).all()
        # At the very ends it is on its way down.
        inner = (s > deck.from_m + 2) & (s < deck.to_m - 2)
        assert (terrain_m[inner] < top[inner, 2] - DECK_M).all(), "below the slab"
        below = ground.clearance(xy) < 0
        assert below.all()
        on, across = lower.line.project(xy)
        beside = np.abs(np.abs(across) - 4.0) < 0.4
        assert beside.any()
        np.testing.assert_allclose(terrain_m[beside], lower.points(on[beside], across[beside])[:, 2], atol=0.15)
        slope = np.abs(np.diff(terrain_m) / np.diff(s))
        assert slope[inner[1:]].max() < 1.1, "slopes of about 1 in 1.5, and no walls"


def test_a_deck_has_parapets_piers_and_abutments(level: World) -> None:
    (deck,) = level.ground.paved.spans
    (body,) = level.site.surfaces.bodies
    assert any(at is body for at in level.site.structures)
    upper, lower = deck.road, level.network.road("1")
    corners = body.corners_world.reshape(-1, 3)
    s, t = upper.line.project(corners[:, :2])
    over_m = corners[:, 2] - upper.base_points(np.clip(s, 0, upper.end_m), np.clip(t, -3.5, 3.5))[:, 2]
    assert over_m.max() == pytest.approx(0.95, abs=0.01)
    assert (np.abs(t[over_m > 0.5]) > 3.5).all(), "parapets stand beside the pavement"
    low = over_m < -4
    _, across = lower.line.project(corners[low, :2])
    assert low.any()
    assert (np.abs(across) > 3.5 + 1.0 - 0.64).all(), "piers stand beside the lower road"
    for end_m in (deck.from_m, deck.to_m):
        assert ((np.abs(s - end_m) < 0.2) & (over_m < -0.9)).any(), "an abutment"


def test_slopes_that_would_cross_lead_from_one_road_to_the_other() -> None:
    beside = plan(("<line/>", 400.0), start=(0.0, 12.0, 0.0))
    world = world_at("1:165:-1", road(EAST, TWO, "1"), road(beside, TWO, "2", profile=LEVEL))
    assert not world.ground.paved.spans
    y = np.linspace(3.6, 8.4, 30)
    lower = world.network.road("1")
    z = world.ground.height(lower.xy(np.full(30, 200.0), -y))
    assert (np.diff(z) > 0).all()
    assert np.abs(np.diff(z)).max() < 0.5
    assert z[0] - z[-1] == pytest.approx(-8, abs=0.5)


def test_a_tunnel_is_below_the_ground_and_open_at_both_ends() -> None:
    world = world_at("1:130:-1", road(EAST, TWO, "1", after=TUNNEL))
    ground, own = world.ground, world.network.road("1")
    (tunnel,) = ground.paved.spans
    assert (tunnel.from_m, tunnel.to_m) == (150, 230)
    s = np.linspace(151, 229, 60)
    xyz = own.points(s, np.zeros(60))
    up = np.array([0.0, 0.0, 1.0])
    assert not ground.is_in(xyz + 1.5 * up).any()
    assert ground.is_in(xyz + 6.0 * up).all()
    assert not ground.is_in(xyz + 8.0 * up).any()
    terrain_m = MeshFaces([world.site.surfaces.terrain]).height(xyz[:, :2])
    np.testing.assert_allclose(terrain_m - xyz[:, 2], CEILING_M + COVER_M, atol=0.1)
    # Just before and behind the portals the road is free.
    for s_m in (149.0, 149.9, 230.1, 231.0):
        t = np.linspace(-3.3, 3.3, 12)
        points = own.points(np.full(12, s_m), t)
        over_m = MeshFaces([world.site.surfaces.terrain]).height(points[:, :2]) - points[:, 2]
        assert np.nanmax(over_m) < 0, s_m
    labels = ground_truth(world.scene)
    middle = next(lane for lane in labels.lanes if lane.id == "1.0.-1")
    assert middle.terrain_visible[:-2].all(), "seen through the tunnel"
    (body,) = world.site.surfaces.bodies
    assert body.kind == "tunnel"


def test_bridges_of_a_file_are_decks_over_a_valley() -> None:
    objects = '<objects><bridge s="150" length="40" id="1" type="concrete"/></objects>'
    world = world_at("1:130:-1", road(EAST, TWO, "1", after=objects))
    (deck,) = world.ground.paved.spans
    assert (deck.from_m, deck.to_m, deck.is_given) == (150, 190, True)
    middle = deck.road.points(np.array([170.0]), np.zeros(1))
    assert MeshFaces([world.site.surfaces.terrain]).height(middle[:, :2])[0] < middle[0, 2] - DECK_M - 3


def rails_of(at: str, *objects: str, length_m: float = 300.0) -> list[tuple[str, float, float, float]]:
    """The rails of a scene on a long road with these objects: kind, from, to, aside."""
    long = plan(*[("<line/>", length_m)] * 10)
    world = world_at(at, road(long, TWO, "1", after=f"<objects>{''.join(objects)}</objects>"))
    return [(rail.kind, rail.from_m, rail.to_m, rail.aside_m) for rail in world.scene.roadside.rails]


def test_barriers_of_a_file_are_rails_as_long_as_their_road_but_not_far_beside_it() -> None:
    """The part of a road that a scene keeps may be longer than a kilometre."""
    assert rails_of(
        "1:130:-1",
        '<object type="barrier" subtype="guardRail" s="140" t="5" length="60" width="0.3" id="1"/>',
        '<object type="barrier" subtype="jerseyBarrier" s="0" t="0" length="5" id="2">'
        '<repeat s="120" length="90" distance="0" tStart="-5" tEnd="-5"/></object>',
        '<object type="barrier" s="150" t="20" length="80" width="10" id="3"/>',
        length_m=40.0,
    ) == [("concrete", 120, 210, 5), ("guardrail", 140, 200, -5)]
    both = (f'<object type="barrier" s="0" t="{t}" length="3000" id="{i}"/>' for i, t in enumerate((5, 1200)))
    assert [at[1:] for at in rails_of("1:1500:-1", *both)] == [(0, 1200, -5)]


def test_of_many_barriers_the_nearest_are_kept_and_none_on_roads_too_far_to_be_there() -> None:
    """A part of a map has roads that are farther from the host than those of its scene."""
    many = "".join(
        f'<object type="barrier" s="{4 * i}" t="5" length="4" id="{i}"/>' for i in range(99, -1, -1) for _ in range(2)
    )
    near = road(EAST, TWO, "1", after=f"<objects>{many}</objects>")
    objects = '<objects><object type="barrier" s="0" t="5" length="9" id="900"/></objects>'
    far = road(plan(("<line/>", 10.0), start=(330.0 + 480.0, 0.0, 0.0)), TWO, "2", after=objects)
    rails = world_at("1:330:-1", far, near).scene.roadside.rails
    assert len(rails) == MAX_RAILS
    assert {rail.road for rail in rails} == {"1"}
    assert min(rail.from_m for rail in rails) > 150


def test_a_rail_below_a_deck_stays_on_the_ground() -> None:
    objects = '<objects><object type="barrier" s="150" t="5" length="100" height="0.8" id="1"/></objects>'
    world = world_at("1:165:-1", road(EAST, TWO, "1", after=objects), road(NORTH, TWO, "2", profile=LEVEL))
    (rail,) = world.scene.roadside.rails
    corners = world.site.structures[0].corners_world
    assert rail.kind == "guardrail"
    assert corners[..., 2].max() - world.view.world_from_road[2, 3] < 3
