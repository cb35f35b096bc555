"""Scenes on given maps: the part of a map that a scene keeps, places and routes of the host, what drives there."""

import pickle
from collections import Counter
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from synth3dlanes_cli.main import main

from synth3dlanes.draw.fitted_terrain import road_points, terrain_of
from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, sample_world, world_in_shot
from synth3dlanes.labels.labels import to_json as labels_text
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import clips
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.roads.from_map import bare_roads
from synth3dlanes.roads.line_forms import plan_points
from synth3dlanes.roads.maps.given_map import GivenMap, read_opendrive
from synth3dlanes.roads.maps.part import KEPT_M, MapStation, draw_place, part_around, read_place
from synth3dlanes.roads.terrain import gradient_at, height_at
from synth3dlanes.scene.scene import Gaussian, Terrain, to_json
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.world import World
from tests.maps.files import ON, PLAIN, lane, link, opendrive, plan, road, section
from tests.town_checks import bodies, touching

HILLY = '<elevationProfile><elevation s="0" a="12" b="0.03" c="-0.0001" d="0"/></elevationProfile>'
BENDS = plan(
    ("<line/>", 150.0), ('<arc curvature="0.01"/>', 120.0), ("<line/>", 200.0), ('<arc curvature="-0.02"/>', 60.0)
)


@cache
def file(profile: str = "") -> bytes:
    """A map of one road with two lanes in each direction."""
    lanes = section(*(lane(n, PLAIN, link=ON.format(n)) for n in (2, 1, -1, -2)))
    return opendrive(road(BENDS, lanes, "r 1", profile=profile))


def scenes(profile: str = "", frames: int = 1, **changes: str) -> Scenes:
    """Scenes on it."""
    given = read_opendrive(file(profile), "bends.xodr", "map bends.xodr")
    params = load_params("streets", tuple(f"{key}={value}" for key, value in changes.items()))
    return Scenes(params, 3, "train", shots=clips(frames, 5.0, ()), map=MapPlace(given))


@cache
def world(index: int) -> World:
    """A world of these."""
    return sample_world(scenes(HILLY), index)


def test_a_scene_does_not_depend_on_those_that_its_process_made_before() -> None:
    """Scenes, labels and meshes: of the first scene on a map that was just read, and of one after others."""
    alone, used = scenes(HILLY), scenes(HILLY)
    for index in (0, 1, 3):
        _made(used, index)
    assert _made(used, 2) == _made(alone, 2)


def _made(of: Scenes, index: int) -> list[bytes]:
    found = sample_world(of, index)
    meshes = [found.site.surfaces.terrain, *found.site.surfaces.pavement, *found.paint(found.view).values()]
    arrays = [mesh.vertices_world.tobytes() + mesh.faces.tobytes() for mesh in meshes]
    return [to_json(found.scene).encode(), labels_text(label(found, found.view)).encode(), *arrays]


@pytest.mark.parametrize("index", range(4))
def test_the_host_is_at_its_place_on_its_lane(index: int) -> None:
    """The world's origin is on the reference line beside the host."""
    found = world(index)
    foot = found.view.world_from_road[:3, 3]
    roads = found.scene.map
    assert roads is not None
    assert abs(foot[1]) < 0.02 * np.hypot(*foot[:2]) + 0.02
    number = abs(int(roads.route[0].rpartition(".")[2]))
    assert abs(foot[0]) == pytest.approx(3.5 * (number - 0.5), abs=1.3)
    assert abs(foot[2]) < 0.5
    assert found.view.world_from_road[1, 1] > 0.99


def test_cars_touch_neither_each_other_nor_the_host_in_any_frame() -> None:
    on_map = scenes(frames=8, **{"cars.n": "8"})
    found = sample_world(on_map, 0)
    assert len(found.scene.cars) >= 3
    assert found.scene.shot.speed_m_s > 0
    for frame in range(8):
        assert touching(bodies(world_in_shot(on_map, found, on_map.shots.place(frame)))) == []


def test_a_host_is_slower_in_bends() -> None:
    """In a clip nobody is pressed aside with more than 3 m/s2: the sharpest bend has a radius of 50 m."""
    fast = [
        sample_world(scenes(frames=10, **{"motion.host_speed_m_s": "30"}), i).scene.shot.speed_m_s for i in range(6)
    ]
    assert max(fast) <= 30.0
    assert min(fast) < 18.0
    assert all(speed > 5.0 for speed in fast)


def test_the_ground_meets_the_roads_and_goes_on_as_hills() -> None:
    roads = world(1).scene.map
    assert roads is not None
    hills = Terrain(
        gaussians=tuple(
            Gaussian(center_m=(x, y), magnitude_m=h, sd_m=(50.0, 70.0), orientation_rad=0.4)
            for x, y, h in ((60.0, 40.0, 8.0), (-50.0, -60.0, -6.0))
        )
    )
    bare = bare_roads(roads, hills)
    ground, points = terrain_of(bare, hills), road_points(bare, hills)
    apart = points[:, 2] - height_at(ground, points[:, :2])
    assert np.abs(apart).max() < 0.25
    # Between the roads and the ends of the grid the hills are there.
    grid = np.stack(np.meshgrid(np.linspace(-150, 150, 25), np.linspace(-150, 150, 25)), -1).reshape(-1, 2)
    far = np.min(np.linalg.norm(grid[:, None] - points[None, ::8, :2], axis=2), axis=1) > 60
    assert np.ptp(height_at(ground, grid)[far]) > 3.0
    e = 1e-3
    numeric = np.stack(
        [(height_at(ground, grid + d) - height_at(ground, grid - d)) / (2 * e) for d in np.eye(2) * e], -1
    )
    assert np.abs(gradient_at(ground, grid) - numeric).max() < 1e-6


def test_a_recipe_names_the_file_and_its_digest() -> None:
    recipe = Recipe(scenes(), RenderSettings(), "jpg")
    assert recipe.description()["map"] == {"file": "bends.xodr", "digest": scenes().map.map.digest}  # type: ignore[union-attr]
    other = Recipe(scenes(HILLY), RenderSettings(), "jpg")
    assert other.description() != recipe.description()
    assert "map" not in Recipe(replace(scenes(), map=None), RenderSettings(), "jpg").description()


def run(tmp_path: Path, *args: str) -> tuple[int, str]:
    """Exit code and output of `generate --dry-run`."""
    (tmp_path / "m.xodr").write_bytes(file())
    given = ["generate", "--n", "2", "--out", str(tmp_path / "out"), "--dry-run", *args]
    result = CliRunner().invoke(main, [text.replace("M.xodr", str(tmp_path / "m.xodr")) for text in given])
    return result.exit_code, result.output


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--at", "r 1:3:-1"], "--at: expected none without --map"),
        (["--map", "M.xodr", "--set", "road.n_lanes=3"], "road.n_lanes=3: no effect with --map"),
        (["--map", "M.xodr", "--set", "camera.y_m=-20"], "camera.y_m=-20: no effect with --map"),
        (["--map", "M.xodr", "--at", "r 2:3:-1"], "expected a road of m.xodr, got 'r 2'; did you mean r 1?"),
        (["--map", "M.xodr", "--at", "r 1:3:7"], "expected a driving lane of road r 1 there (2, 1, -1, -2), got 7"),
    ],
)
def test_what_has_no_effect_or_is_not_there_is_refused(tmp_path: Path, args: list[str], message: str) -> None:
    code, output = run(tmp_path, *args)
    assert code == 2
    assert message in " ".join(output.split())


def test_the_plan_says_what_is_left_out(tmp_path: Path) -> None:
    code, output = run(tmp_path, "--map", "M.xodr")
    assert code == 0, output
    assert "map m.xodr: 1 road, 0 junctions, 2.1 km of driving lanes; left out: nothing" in output


def long_map() -> GivenMap:
    """A road of 2.4 km with bends, and one of 300 m that goes on from it, in UTM-like coordinates."""
    pieces = [
        ("<line/>", 800.0),
        ('<arc curvature="0.001"/>', 800.0),
        ('<spiral curvStart="0.001" curvEnd="0"/>', 800.0),
    ]
    on = [section(lane(1, link=ON.format(1)), lane(-1, link=ON.format(-1)), s=s) for s in (0.0, 700.0)]
    start = (4_500_120.0, 5_400_340.0, 0.6)
    first = road(plan(*pieces, start=start), "".join(on), "7", link=link(after="8:start"), profile=HILLY)
    only = read_opendrive(opendrive(first), "a.xodr", "map a.xodr")
    x, y, heading = plan_points(only.roads["7"].plan, np.array([2400.0]))[0]
    end = (x + only.origin[0], y + only.origin[1], heading)
    second = road(plan(("<line/>", 300.0), start=end), on[0], "8", link=link(before="7:end"))
    return read_opendrive(opendrive(first, second), "a.xodr", "map a.xodr")


LONG = long_map()


def test_a_route_follows_links_behind_and_ahead() -> None:
    part, number, s_m, *_ = part_around(LONG, MapStation("7.1.-1", 2390.0), np.random.default_rng(1))
    assert (part.route, number) == (("7.0.-1", "8.0.-1"), 0)
    cut = part.roads[0]
    assert (s_m + cut.given_from_m, cut.given_from_m, cut.given_section) == (pytest.approx(2390), 1600, 1)
    against, number, *_ = part_around(LONG, MapStation("8.0.1", 290.0), np.random.default_rng(1))
    assert (against.route, number) == (("8.0.1", "7.0.1"), 0)
    behind, number, *_ = part_around(LONG, MapStation("8.0.-1", 10.0), np.random.default_rng(1))
    assert (behind.route, number) == (("7.0.-1", "8.0.-1"), 1)


def fork() -> GivenMap:
    """A road that goes on to a short one without an end of its own, and to a long one."""
    on = section(lane(-1, link='<predecessor id="-1"/>'))
    stem = section(lane(-1))
    parts = [
        road(plan(("<line/>", 100.0)), stem, "1", link=link(after="9")),
        road(plan(("<line/>", 30.0), start=(100.0, 0.0, 0.0)), on, "2", link=link(before="1:end")),
        road(plan(("<line/>", 400.0), start=(100.0, 0.0, 0.3)), on, "3", link=link(before="1:end")),
        road(plan(("<line/>", 500.0), start=(100.0, 0.0, 0.6)), on, "4", link=link(before="1:end")),
    ]
    return read_opendrive(opendrive(*parts), "fork.xodr", "map fork.xodr")


def test_where_ways_part_each_that_goes_on_far_enough_is_taken() -> None:
    given = fork()
    taken = Counter(
        part_around(given, MapStation("1.0.-1", 40.0), np.random.default_rng(seed)).map.route[-1] for seed in range(60)
    )
    assert set(taken) == {"3.0.-1", "4.0.-1"}
    assert min(taken.values()) > 15


def test_places_are_drawn_by_length_where_the_way_goes_on() -> None:
    given, rng = fork(), np.random.default_rng(3)
    drawn = [draw_place(given, rng) for _ in range(600)]
    by_road = Counter(at.lane[0] for at in drawn)
    # Of the places from which 250 m are left: 100 m of road 1, 150 m of road 3, 250 m of road 4.
    assert {name: by_road[name] / 600 for name in "134"} == pytest.approx({"1": 0.2, "3": 0.3, "4": 0.5}, abs=0.07)
    assert "2" not in by_road
    short = read_opendrive(opendrive(road(plan(("<line/>", 60.0)))), "s.xodr", "map s.xodr")
    assert {draw_place(short, rng).lane for _ in range(20)} == {"1.0.1", "1.0.-1"}


def test_a_ring_goes_on_and_ends() -> None:
    ring = road(
        plan(('<arc curvature="0.05"/>', 40 * np.pi)),
        section(lane(-1, link=ON.format(-1))),
        link=link("1:end", "1:start"),
    )
    given = read_opendrive(opendrive(ring), "ring.xodr", "map ring.xodr")
    part, *_ = part_around(given, MapStation("1.0.-1", 3.0), np.random.default_rng(1))
    assert 4 <= len(part.route) < 12
    assert all(pair == ("1.0.-1", "1.0.-1") for pair in pairwise(part.route))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("7", "expected ROAD:s:lane"),
        ("7:x:-1", "expected ROAD:s:lane"),
        ("70:5:-1", "expected a road of a.xodr, got '70'"),
        ("7:nan:-1", "expected a station of road 7 from 0 to 2400.00, got nan"),
        ("7:2401:-1", "expected a station of road 7 from 0 to 2400.00, got 2401"),
        ("7:20:-2", r"expected a driving lane of road 7 there \(1, -1\), got -2"),
        ("7:20:0", "expected a driving lane"),
    ],
)
def test_a_place_that_is_not_there(text: str, message: str) -> None:
    assert read_place(LONG, "7:900.5:-1") == MapStation("7.1.-1", 900.5)
    with pytest.raises(InputError, match=f"^at: {message}"):
        read_place(LONG, text)


def test_far_roads_are_left_out() -> None:
    far = road(plan(("<line/>", 90.0), start=(0.0, KEPT_M + 50, 0.0)), name="far")
    near = road(plan(("<line/>", 90.0), start=(0.0, KEPT_M - 50, 0.0)), name="near")
    given = read_opendrive(opendrive(road(plan(("<line/>", 90.0))), far, near), "x.xodr", "map x.xodr")
    part, *_ = part_around(given, MapStation("1.0.-1", 45.0), np.random.default_rng(1))
    assert {found.id for found in part.roads} == {"1", "near"}


def test_a_process_reads_a_map_once_however_often_it_is_sent_to_it() -> None:
    given = long_map()
    sent = pickle.dumps(given)
    assert len(sent) < 3000
    here, again = pickle.loads(sent), pickle.loads(sent)
    assert here is again
    assert (here.text(), here.digest, here.roads, here.links) == (given.text(), given.digest, given.roads, given.links)
    assert pickle.loads(pickle.dumps(here)) is here
