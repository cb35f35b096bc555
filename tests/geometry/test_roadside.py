"""What stands and grows beside the road, and its signs: over no lane, on the ground, facing its traffic."""

from itertools import pairwise

import numpy as np
import pytest
from jaxtyping import Bool
from scipy.spatial import cKDTree

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.roadside import Building, Crossing, Post, Rail, Roadside
from synth3dlanes.scene.scene import Scene
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.validate.bodies import inside, structures
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world import grass
from synth3dlanes.world.placement import car_place
from synth3dlanes.world.sign_faces import FACES
from synth3dlanes.world.world import World, resolve
from tests.scenes import FLAT, changed
from tests.validate.examining import findings

GRAY = (0.3, 0.3, 0.3)
LAMP = Post(kind="lamp", road="main", side="right", s_m=0.0, aside_m=1.2, height_m=8.0)
DENSE = [
    "roadside.outer={guardrail: 1, concrete: 1, noise_wall: 1, kerb: 1, walkway: 1}",
    "roadside.inner=guardrail",
    "roadside.ramp_rail=true",
    "roadside.lamps=both",
    "roadside.n_signs=6",
    "roadside.n_gantries=2",
    "roadside.n_bridges={0: 1, 1: 1}",
    "roadside.n_houses=6",
    "roadside.n_halls=2",
    "roadside.n_blocks=2",
    "roadside.power_line={left: 1, right: 1}",
    "trees.n=150",
]


def with_roadside(scene: Scene, **parts) -> Scene:
    return scene.model_copy(update={"roadside": Roadside(**parts)})


@pytest.fixture(scope="module")
def worlds():
    """Scenes with much of everything, of all topologies and flips."""
    params = load_params("streets", DENSE)
    return [sample_world(Scenes(params, 0, "test"), index) for index in range(8)]


def test_scenes_have_every_kind_and_every_road(worlds):
    rails = [(r.kind, r.road, r.side) for world in worlds for r in world.scene.roadside.rails]
    assert {kind for kind, _, _ in rails} == {"guardrail", "concrete", "noise_wall", "kerb", "walkway", "power_line"}
    assert {(road, side) for _, road, side in rails} >= {("main", "left"), ("main", "right"), ("exit", "right")}
    kinds = {body.kind for world in worlds for body in world.site.structures}
    assert kinds >= {"lamp", "sign", "gantry", "bridge", "house", "hall", "block"}
    assert len({(len(w.network.roads), w.network.onwards, w.network.rightward) for w in worlds}) >= 5


def lane_points(world):
    """World points over all lanes of both roads: across them every half metre, and along them."""
    network, drawn = world.network, world.scene.road
    s = network.stations(world.scene.camera.y_m + np.arange(-20, 140, 1.0))
    low = -drawn.n_lanes / 2 * drawn.lane_width_m
    points = [network.main.xy(s, t) for t in np.arange(low, low + drawn.n_main_after * drawn.lane_width_m + 0.1, 0.5)]
    raised = [np.zeros(len(s))] * len(points)
    for branch in network.roads[1:]:
        beyond, half_m = s[s >= 0], drawn.n_exit_lanes * drawn.lane_width_m / 2
        offsets = np.arange(-half_m, half_m + 0.1, 0.5)
        points += [branch.xy(beyond, t) for t in offsets]
        raised += [branch.raised(beyond)] * len(offsets)
    xy = np.concatenate(points)
    return network.lift(xy, np.concatenate(raised))


def test_nothing_is_over_or_on_a_lane_below_the_clearance(worlds):
    """Sampled quads of all bodies, against an independent set of points on the lanes: nothing within 4.7 m above any,
    arms of lamps included."""
    for world in worlds:
        lanes = lane_points(world)
        tree = cKDTree(lanes[:, :2])
        for i, body in enumerate(world.site.structures):
            a, b, c, d = body.corners_world.transpose(1, 0, 2)
            mesh = np.concatenate(
                [
                    (1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d
                    for u in np.linspace(0, 1, 5)
                    for v in np.linspace(0, 1, 5)
                ]
            )
            apart_m, nearest = tree.query(mesh[:, :2], distance_upper_bound=0.3)
            over = np.isfinite(apart_m)
            height_m = mesh[over, 2] - lanes[nearest[over], 2]
            assert not (height_m < 4.7).any(), (world.scene.index, i, body.kind, height_m.min())


def test_feet_are_on_the_ground_and_bodies_reach_into_it(worlds):
    for world in worlds:
        for body in world.site.structures:
            if body.kind in ("face", "head"):
                continue
            xy, z = body.feet_world[:, :2], body.feet_world[:, 2]
            assert np.abs(world.ground.height(xy) - z).max() < 0.02
            if body.kind in ("lamp", "sign", "delineator"):
                corners = body.corners_world.reshape(-1, 3)
                assert corners[:, 2].min() < z[0] - 0.3
                assert np.hypot(*(corners[corners[:, 2] < z[0]][:, :2] - xy[0]).T).max() < 2.0


def test_lamp_heads_are_over_the_road_and_on_both_sides_of_a_median():
    world = resolve(
        with_roadside(FLAT, posts=(LAMP, LAMP.model_copy(update={"side": "median", "aside_m": 0.0, "s_m": 20.0})))
    )
    one, left, right = world.site.street_lamps[
        np.argsort(world.site.street_lamps[:, 1] * 1000 + world.site.street_lamps[:, 0])
    ]
    edge_m = world.network.main.right.base_m
    assert one[0] == pytest.approx(edge_m + 1.2 - 2.18, abs=0.05)
    assert one[2] == pytest.approx(world.ground.height(np.array([[edge_m + 1.2, 0.0]]))[0] + 8.2, abs=0.1)
    assert left[0] == pytest.approx(-right[0])
    assert right[0] > 2
    corners = world.site.structures[0].corners_world.reshape(-1, 3)
    assert np.abs(corners - one).max(axis=1).min() < 0.4


def test_faces_are_in_their_boxes_and_the_check_finds_what_stands_on_a_road(worlds):
    for world in worlds:
        assert findings(Evidence(world, label(world, world.view)), "roadside") == []
        owned = structures(world)
        for i, body in enumerate(world.site.structures):
            middles = body.corners_world.mean(axis=1)
            assert inside(owned, middles, np.full(len(middles), i)).all(), (world.scene.index, i, body.kind)
    on_road = with_roadside(
        changed(FLAT, road={"topology": 2}),
        rails=(
            Rail(
                kind="guardrail",
                road="main",
                side="right",
                from_m=-50.0,
                to_m=60.0,
                aside_m=0.5,
                height_m=0.8,
                color=GRAY,
            ),
        ),
        posts=(LAMP.model_copy(update={"aside_m": -2.0}),),
        buildings=(
            Building(kind="house", x_m=2, y_m=0, yaw_rad=0, width_m=8, length_m=9, height_m=4, color=GRAY, roof=GRAY),
        ),
    )
    sample = Evidence(resolve(on_road), ground_truth(on_road))
    found = [finding.reason.partition(" beside")[0] for finding in findings(sample, "roadside")]
    structures_on_it = ("structure 0 (guardrail)", "structure 1 (lamp)", "structure 2 (house)")
    assert found == [f"scene: expected {whose}" for whose in structures_on_it]


def test_trees_keep_clear(worlds):
    """No trunk within half a metre of a face's middle."""
    for world in worlds:
        trunks = cKDTree(world.site.trees_world[:, :2])
        for body in world.site.structures:
            low = body.corners_world.min(axis=1)[:, 2] < world.ground.height(body.corners_world.mean(axis=1)[:, :2]) + 2
            middles = body.corners_world.mean(axis=1)[low, :2]
            assert trunks.query(middles)[0].min(initial=1) > 0.5, (world.scene.index, body.kind)


@pytest.mark.parametrize(("kind", "n"), [("sign", "n_signs=20"), ("gantry", "n_gantries=3")])
def test_things_keep_the_distance_that_they_are_told(kind, n):
    key = "signs_apart_m" if kind == "sign" else "crossings_apart_m"
    nearest = {}
    for apart_m in (12, 60):
        params = load_params("streets", [f"roadside.{n}", "roadside.n_bridges=0", f"structures.{key}={apart_m}"])
        gaps = []
        for index in range(3):
            roadside = sample_world(Scenes(params, 0, "apart"), index).scene.roadside
            things = [post for post in roadside.posts if post.kind == "sign"] if kind == "sign" else roadside.crossings
            gaps += np.diff(sorted(thing.s_m for thing in things)).tolist()
        nearest[apart_m] = min(gaps)
    assert 12 <= nearest[12] < 60 <= nearest[60]


NO_ENTRY, TO_THE_ROAD = 6, {12, 15}
ONLY_SIGNS = [
    "trees.n=0", "cars.n=0", "roadside.n_signs=20", "roadside.lamps=none", "roadside.delineators=false",
    "roadside.n_houses=0", "roadside.n_halls=0", "roadside.n_blocks=0", "roadside.n_gantries=0",
    "roadside.n_bridges=0",
]  # fmt: skip


@pytest.fixture(scope="module")
def signs():
    """(world, post, its element, its foot) of many signs, at roads of all kinds."""
    found = []
    params = load_params("streets", ONLY_SIGNS)
    for index in range(14):
        world = sample_world(Scenes(params, 3, "test"), index)
        roadside = world.scene.roadside
        first = len(roadside.rails)
        feet = [world.site.structures[first + i].feet_world[0] for i in range(len(roadside.posts))]
        places = zip(roadside.posts, world.site.elements, feet, strict=False)
        found += [(world, post, element, foot) for post, element, foot in places if post.kind == "sign"]
    assert {post.face for _, post, _, _ in found} == set(range(1, len(FACES) + 1))
    return found


def facing(body):
    """Where the front of a sign's board looks."""
    a, b, _, d = body.corners_world[-1]
    normal = np.cross(b - a, d - a)
    return normal[:2] / np.linalg.norm(normal[:2])


def nearest_traffic(world, post, foot):
    """The id of the lane segment nearest to a sign, the middle of the lane there, and the way of its traffic."""
    s_m = post.s_m * world.network.onwards
    road = world.scene.road
    places = []
    for lane in (*road.segments_at(s_m), *road.oncoming_segments):
        xy, heading = (np.asarray(part)[..., :2].reshape(-1, 2)[0] for part in car_place(world.network, lane, s_m, 0.0))
        places.append((np.linalg.norm(foot[:2] - xy), lane, xy, heading))
    return min(places, key=lambda place: place[0])[1:]


def test_a_sign_faces_the_traffic_beside_it_and_no_entry_that_which_would_come_the_wrong_way(signs):
    oncoming = set()
    for world, post, element, foot in signs:
        lane, _, way = nearest_traffic(world, post, foot)
        towards = -float(facing(element.body) @ way)
        np.testing.assert_allclose(facing(element.body), -element.place.world_from_face[:2, 1], atol=1e-6)
        assert (lane in element.lanes) == (post.face != NO_ENTRY)
        assert all(name.startswith("oncoming") == lane.startswith("oncoming") for name in element.lanes)
        assert abs(towards) > 0.8
        assert (towards < 0) == (post.face == NO_ENTRY), (post, lane)
        if post.face == NO_ENTRY:
            assert element.lanes == ()
            assert facing(element.body)[1] > 0, "the host sees its back"
        oncoming.add(lane.startswith("oncoming"))
    assert oncoming == {True, False}


def pointing(face):
    """-1 or 1 where the arrow of a face points to the left or right, 0 where it points up or down or is none."""
    layers = [layer.outline for layer in FACES[face - 1]]
    for shaft, head in pairwise(layers):
        if (len(shaft), len(head)) == (4, 3):
            return int(np.sign(np.round(head.mean(axis=0) - shaft.mean(axis=0), 3)[0]))
    return 0


def test_arrows_point_to_where_the_sign_stands_but_for_those_that_lead_back_to_the_road(signs):
    seen = set()
    for world, post, _, foot in signs:
        _, xy, way = nearest_traffic(world, post, foot)
        if post.face == NO_ENTRY or not pointing(post.face):
            continue
        out = foot[:2] - xy
        is_right = way[1] * out[0] - way[0] * out[1] > 0
        assert (pointing(post.face) > 0) == (is_right != (post.face in TO_THE_ROAD)), post
        seen.add(post.face)
    assert seen == {3, 8, 9, 12, 13, 14, 15, 16}


@pytest.mark.parametrize("flip", [False, True])
def test_boards_of_a_gantry_face_the_traffic_below_them(flip):
    road = {"n_lanes": 2, "n_oncoming": 2, "median_m": 4.0, "flip_longitudinal": flip}
    gantry = Crossing(kind="gantry", s_m=0.0, clearance_m=5.5, width_m=0.9, color=(0.0, 0.1, 0.3))
    world = resolve(changed(FLAT, road=road).model_copy(update={"roadside": Roadside(crossings=(gantry,))}))
    ways = set()
    for board in world.site.elements:
        way = np.sign(-board.place.world_from_face[1, 1])
        assert way == np.sign(facing(board.body)[1])
        right_of_median_m = board.place.world_from_face[0, 3] * (-1 if flip else 1) + 5.5
        if abs(right_of_median_m) > 4.0:  # the board in the middle spans both ways
            assert way == (-1 if right_of_median_m > 0 else 1)
            ways.add(way)
        for name in board.lanes:
            lane = world.network.lanes[name]
            x, _ = world.network.road(lane.road).xy(np.zeros(1), lane.middle(np.zeros(1)))[0]
            assert abs(x - board.place.world_from_face[0, 3]) < 5
            assert (lane.direction == "same") == (way < 0)
    assert ways == {-1, 1}


HIGH = ["vegetation.grass_m=0.6", "trees.n=0", "cars.n=0"]


def grown(n: int, *overrides: str, preset: str = "appendix_i") -> list[World]:
    params = load_params(preset, [*HIGH, *overrides])
    return [sample_world(Scenes(params, 2, "train"), index) for index in range(n)]


def hidden(world: World, blades: grass.Blades) -> Bool[np.ndarray, " p"]:
    """Which labelled points a blade hides, by Blender's rays against every blade."""
    pytest.importorskip("bpy")
    from mathutils import Vector
    from mathutils.bvhtree import BVHTree

    corners = blades.corners_world.reshape(-1, 3)
    tree = BVHTree.FromPolygons(corners.tolist(), np.arange(len(corners)).reshape(-1, 3).tolist())
    points_cam = np.concatenate([lane.xyz_cam for lane in label(world, world.view).lanes])
    eye = world.view.eye_world
    to = transform(world.view.world_from_cam, points_cam) - eye
    hits = [tree.ray_cast(Vector(eye), Vector(ray), float(np.linalg.norm(ray)))[0] for ray in to]
    return np.array([hit is not None for hit in hits])


def test_no_blade_hides_a_labelled_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the rule, blades do hide points in the bends of these scenes."""
    some = grown(2, "road.offset_p100_m=10", "road.offset_p50_m=-10", "road.shoulder_factor=0.2")
    some += grown(1, preset="town")
    for world in some:
        blades = world.grass(world.view)
        assert blades is not None
        assert len(blades.shade) > 5000
        assert not hidden(world, blades).any()
    monkeypatch.setattr(grass, "_in_sight", lambda feet, *_: np.zeros(len(feet), dtype=bool))
    free = [world.grass(world.view) for world in some]
    assert sum(hidden(world, blades).sum() for world, blades in zip(some, free, strict=True) if blades) > 10


@pytest.mark.parametrize("preset", ["1", "2", "4", "town", "mountain"])
def test_grass_stands_on_the_verge(preset: str) -> None:
    """Feet lie within a tuft's radius of the verge, a little below the ground; blades are no higher than asked for."""
    for world in grown(3, f"road.topology={preset}") if preset.isdigit() else grown(1, preset=preset):
        blades = world.grass(world.view)
        assert blades is not None
        feet, tips = blades.corners_world[:, :2].mean(axis=1), blades.corners_world[:, 2]
        from_edge_m = world.ground.clearance(feet[:, :2])
        assert from_edge_m.min() > grass.BESIDE_M[0] - grass.RADIUS_M
        assert from_edge_m.max() < grass.BESIDE_M[1] + grass.RADIUS_M
        assert np.abs(feet[:, 2] - world.ground.height(feet[:, :2])).mean() < 0.1
        rise_m = tips[:, 2] - feet[:, 2] - grass.SINK_M
        assert 0 < rise_m.min() < 0.1 < rise_m.max() <= 0.6
        ahead_m = transform(invert(world.view.world_from_road), feet)[:, 1]
        assert np.quantile(ahead_m, 0.999) < 60
        assert np.median(ahead_m) < 20, "dense near the host"
