"""Signs face the traffic that they are for, and point where they should."""

from itertools import pairwise

import numpy as np
import pytest

from synth3dlanes.draw.sample import Scenes, sample_world
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.roadside import Crossing, Roadside
from synth3dlanes.world.placement import car_place
from synth3dlanes.world.sign_faces import FACES, SIGNS
from synth3dlanes.world.solids import SURFACES
from synth3dlanes.world.world import resolve
from tests.scenes import FLAT, changed

NO_ENTRY, TO_THE_ROAD = 6, {12, 15}
ONLY_SIGNS = [
    "trees.n=0",
    "cars.n=0",
    "roadside.n_signs=20",
    "roadside.lamps=none",
    "roadside.delineators=false",
    "roadside.n_houses=0",
    "roadside.n_halls=0",
    "roadside.n_blocks=0",
    "roadside.n_gantries=0",
    "roadside.n_bridges=0",
]


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
    a, b, _, d = body.corners_world[np.array(body.surface) == SURFACES.index("sign")][-1]
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


def test_the_faces_of_a_sign_differ_in_their_arrows_alone():
    used = [number for sign in SIGNS for number in {sign.left, sign.right}]
    assert sorted(used) == list(range(1, len(FACES) + 1))
    for sign in SIGNS:
        left, right = FACES[sign.left - 1], FACES[sign.right - 1]
        assert [layer.color for layer in left] == [layer.color for layer in right]
        np.testing.assert_array_equal(left[0].outline, right[0].outline)
        assert pointing(sign.left) == -pointing(sign.right)


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
