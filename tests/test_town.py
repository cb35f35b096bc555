"""Towns: lanes that go on, turns with room, bodies that never touch, traffic that obeys, values as declared."""

import itertools
from functools import cache

import numpy as np
import pytest
import shapely

from synth3dlanes.draw.sample import Scenes, draw_world, sample_scene, world_in_shot
from synth3dlanes.figures.stats import is_fine, scene_statistics
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import Shots
from synth3dlanes.scene.scene import Scene, from_json, to_json
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import ground_truth, label
from synth3dlanes.world.motion import car_at
from synth3dlanes.world.world import World
from tests.thorough import first
from tests.town_checks import SIDEWAYS, bodies, map_problems, order_problems, standing_problems, touching

TOWN = load_params("town")
CLIP = Shots(frames=16, fps=5.0)
SEEN = Scenes(TOWN, shots=CLIP)


@cache
def town(index: int, *overrides: str, shots: Shots | None = None) -> World:
    """A town of the preset."""
    params = load_params("town", overrides) if overrides else TOWN
    return draw_world(Scenes(params, 5, shots=shots) if shots else Scenes(params, 5), index)


@pytest.mark.parametrize("preset", first(1, ["tiny", "town"]))
def test_some_scenes_may_have_a_junction_and_others_the_road_of_the_paper(preset: str) -> None:
    few = ("cars.n=0", "trees.n=0", "town.traffic=0.1", "town.parked=0")
    mixed = load_params(preset, [*few, "town.junction={none: 1, t: 1}"])
    alone = {name: load_params(preset, [*few, f"town.junction={name}"]) for name in ("none", "t")}
    scenes = [sample_scene(Scenes(mixed, 4), index) for index in range(6)]
    kinds = ["none" if scene.town is None else scene.town.junction for scene in scenes]
    assert {*kinds} == {"none", "t"}
    for index, (scene, kind) in enumerate(zip(scenes, kinds, strict=True)):
        assert scene == sample_scene(Scenes(alone[kind], 4), index)
        assert (scene.road is None) == (kind != "none")
    rows = scene_statistics(scenes, mixed).parameters
    assert [row.key for row in rows if not is_fine(row)] == []
    assert [row.count for row in rows if row.key == "town.junction"] == [6]
    clip = sample_scene(Scenes(mixed, 4, shots=CLIP), 16 * kinds.index("none") + 3)
    assert (clip.town, clip.shot.frame) == (None, 3)


@pytest.mark.parametrize("junction", first(2, ["crossing", "roundabout", "t", "staggered", "roundabout_2"]))
def test_lanes_go_on_and_nothing_touches(junction: str) -> None:
    world = town(1, f"town.junction={junction}")
    assert world.scene.map is not None
    assert [*map_problems(world.scene.map), *standing_problems(world)] == []
    assert from_json(to_json(world.scene), "scene") == world.scene


@pytest.mark.parametrize(
    ("junction", "control", "index"),
    first(
        4,
        [
            ("t", "priority", 17), ("crossing", "priority", 6), ("crossing", "stop", 10),
            ("roundabout_2", "priority", 8), ("crossing", "signals", 14), ("staggered", "signals", 26),
            ("roundabout", "priority", 37), ("crossing", "equal", 3),
        ],
    ),
)  # fmt: skip
def test_every_two_ways_that_meet_have_one_order(junction: str, control: str, index: int) -> None:
    """A side street that goes on to a junction of its own is the main one there; opposite left turns that cross, and
    those who leave a roundabout across its outer lane, have an order too."""
    own = f"town.junction={junction}", f"town.control={control}", "town.n_more=2", "town.traffic=0", "town.parked=0"
    scene = sample_scene(Scenes(load_params("town", own), 7001), index)
    assert list(order_problems(scene)) == []


def test_a_centre_line_names_the_lines_beside_its_near_end() -> None:
    """Also beside a turn lane that has opened between it and the line of most of its way."""
    own = "town.junction=crossing", "town.n_lanes=2", "town.turn_lanes=both", "town.traffic=0", "town.control=signals"
    world = town(3, *own, "town.host_place=before", "town.host_m=8")
    lanes = {lane.id: lane for lane in label(world, world.view).lanes}
    named = 0
    for lane in lanes.values():
        for other in (lane.left, lane.right) if lane.kind == "centerline" else ():
            if other is not None:
                line, points = shapely.LineString(lanes[other].xyz_cam[:, :2]), shapely.points(lane.xyz_cam[:, :2])
                along_m = shapely.line_locate_point(line, points)
                beside = np.flatnonzero((along_m > 0) & (along_m < line.length))
                away_m = shapely.distance(line, points[beside])
                assert (away_m[:1] < 2.4).all(), (lane.id, other, away_m)
                named += len(beside) > 0
    assert named >= 8


def test_the_labels_have_who_yields_of_the_lanes_that_they_list() -> None:
    own = "town.junction=crossing", "town.control=equal", "town.traffic=0", "town.parked=0"
    network = town(3, *own).network
    paths = [path.id for path in network.paths]
    for listed in (paths[::2], paths[: len(paths) // 2], paths):
        graph = network.graph(listed)
        lanes = {segment.id for segment in graph.segments}
        expected = {pair for pair in network.yields or () if lanes.issuperset(pair)}
        assert set(graph.yields or ()) == expected != set()
    assert len(expected) == len(network.yields or ()) > 20


def test_parked_cars_keep_off_long_vehicles_in_bends() -> None:
    """Their ends swing out of narrow lanes."""
    wide = "cars.model={1: 1, 11: 1}", "cars.scale=1.2", "town.lane_width_m=2.9", "town.bend_deg=30"
    full = "town.parking=true", "town.parked=1", "town.traffic=1", "town.n_more=0", "town.fronts=0"
    world = town(2, "town.junction=crossing", *wide, *full)
    assert sum(car.offset_m > 1 for car in world.scene.cars) > 10
    assert touching(bodies(world)) == []


STREETS = {
    "open_street_m": "[280, 300]", "link_street_m": "[140, 150]", "edge_lines": "true", "four_arms": "false",
    "further": "t", "green_major_s": "[40, 41]", "green_major_left_s": "[30, 31]", "green_minor_s": "[50, 51]",
    "far_signals": "true", "speed_limit": "speed_30", "building": "house", "alike": "1", "gap_m": "[20, 21]",
    "trees_apart_m": "19", "bay_m": "13", "speed_m_s": "[4, 5]", "turn": "left",
}  # fmt: skip
MUCH = ("town.parking=true", "town.parked=1", "town.traffic=1", "town.fronts=0.95", "town.street_trees=1", "trees.n=0")


@pytest.mark.parametrize("junction", first(1, ["crossing", "roundabout"]))
def test_what_stands_and_drives_along_streets_is_that_of_the_parameters(junction: str) -> None:
    """In one town; the same town of houses with the usual ranges has other values."""
    fixed = (*MUCH, f"town.junction={junction}", "town.control=signals", "town.n_more=1", "town.bend_deg=0")
    fixed = (*fixed, "town.turn_lanes=none", "town.angle_deg=0", "town.walkway_m=2.6")
    told = town(1, *fixed, *(f"town_streets.{key}={value}" for key, value in STREETS.items())).scene
    usual = town(1, *fixed, "town_streets.building=house", "town_streets.alike=1").scene
    scenes = {"told": told, "usual": usual}
    lengths = {name: [road.length_m for road in roads_of(scene)] for name, scene in scenes.items()}
    assert sum(140 <= length_m <= 150 for length_m in lengths["told"]) == 1, "the street to the further junction"
    assert all(280 <= length_m <= 300 for length_m in lengths["told"] if length_m > 150)
    assert all(75 <= length_m <= 230 for length_m in lengths["usual"])
    assert len(lengths["told"]) == (6 if junction == "crossing" else 5), "three arms of a ring, and a T behind one"
    kinds = {building.kind for building in told.roadside.buildings}
    assert kinds == {"house"}
    per_m = {name: len(scene.roadside.buildings) / sum(lengths[name]) for name, scene in scenes.items()}
    assert per_m["told"] < per_m["usual"], "wider gaps"
    limits = {sign.kind for sign in told.roadside.signs if sign.kind.startswith("speed")}
    assert limits == {"speed_30"}
    assert max(car.speed_m_s for car in told.cars) < 5 * 1.08 + 1e-6 < max(car.speed_m_s for car in usual.cars)
    assert (round(row_step_m(told)), round(row_step_m(usual))) == (19, 11)
    if junction == "crossing":
        greens = {
            phase.seconds for signal in told.roadside.signals for phase in signal.phases if phase.state == "green"
        }
        assert greens
        assert all(any(low <= green_s <= low + 1 for low in (30, 40, 50)) for green_s in greens)


def roads_of(scene: Scene):  # type: ignore[no-untyped-def]
    """The streets of a town."""
    assert scene.map is not None
    return [road for road in scene.map.roads if road.junction is None and road.id.startswith("s")]


def row_step_m(scene: Scene) -> float:
    """The usual distance of a tree from the nearest one."""
    xy = np.array([(tree.x_m, tree.y_m) for tree in scene.trees])
    away_m = np.linalg.norm(xy[:, None] - xy[None], axis=-1) + np.diag(np.full(len(xy), np.inf))
    return float(np.median(away_m.min(axis=1)))


@pytest.mark.thorough
def test_traffic_of_a_clip_obeys() -> None:
    """At every frame no bodies touch; nobody drives through a red light; sideways nobody is faster than the law."""
    busy = "town.traffic=0.8", "town.parking=false", "town.n_more=0"
    world = town(0, "town.control=signals", "town.junction=crossing", *busy, shots=CLIP)
    assert list(clip_problems(world)) == []


def clip_problems(world: World):  # type: ignore[no-untyped-def]
    """What is wrong in the frames of a clip."""
    scene = world.scene
    places, headings, lanes = [], [], []
    for frame in range(CLIP.frames):
        now = world_in_shot(SEEN, world, CLIP.place(frame))
        shapes = bodies(now)
        yield from (f"frame {frame}: bodies {i} and {j} touch" for i, j in touching(shapes))
        places.append([shape.centroid.coords[0] for shape in shapes])
        fronts = [np.subtract(shape.exterior.coords[2], shape.exterior.coords[1]) for shape in shapes]
        headings.append([float(np.arctan2(y, x)) for x, y in fronts])
        lanes.append(_lanes(now))
    yield from _reds(scene, lanes)
    xy = np.array(places)
    turned = np.diff(np.unwrap(np.array(headings), axis=0), axis=0) * CLIP.fps
    speed = np.linalg.norm(np.diff(xy, axis=0), axis=-1) * CLIP.fps
    # Over half a second: the frames' own differences are noisy.
    sideways = np.abs(np.array([np.convolve(row, np.ones(3) / 3, "valid") for row in (turned * speed).T]))
    yield from (
        f"body {i}: {row.max():.1f} m/s2 sideways" for i, row in enumerate(sideways) if row.max() > SIDEWAYS + 0.3
    )


def _lanes(world: World) -> list[tuple[str, float, float]]:
    """The lane and the station of each car, and its length."""
    scene, found = world.scene, []
    for car in scene.cars:
        now = car_at(world.network, car, scene.shot.time_s)
        found.append((now.lane, now.s_m, scene.assets.car_models[car.model - 1].length_m * car.scale))
    return found


def _reds(scene: Scene, lanes: list[list[tuple[str, float, float]]]):  # type: ignore[no-untyped-def]
    assert scene.map is not None
    signals = {lane: signal for signal in scene.roadside.signals for lane in signal.lanes}
    lines = {at.lane: at.s_m for at in scene.map.paint if at.lane in signals and at.kind == "stop_line"}
    for frame, (before, now) in enumerate(itertools.pairwise(lanes)):
        for i, ((lane, s_m, length_m), (after, now_m, _)) in enumerate(zip(before, now, strict=True)):
            if lane not in lines or after != lane:
                continue
            # Positive before the line, for the front.
            sign = np.sign(s_m - now_m)
            left, right = ((s - lines[lane]) * sign - length_m / 2 for s in (s_m, now_m))
            state = signals[lane].state_at((frame + 1) / CLIP.fps)
            if left > 0 >= right and state in ("red", "red_amber"):
                yield f"car {i} passes the line of {lane} at {state}, frame {frame + 1}"


def test_the_host_brakes_before_its_way_ends() -> None:
    shots = Shots(frames=3, fps=0.05)
    few = ("town.traffic=0.02", "town.parked=0", "trees.n=0", "people.per_100_m=0", "town.junction=t")
    world = town(0, *few, shots=shots)
    times_s, driven_m = np.array(world.scene.shot.track).T
    speeds = np.diff(driven_m) / np.diff(times_s)
    # It stands at last, and no driver brakes harder than this on a free street.
    assert (driven_m[-1] == driven_m[-5], driven_m[-1] > 60) == (True, True)
    assert np.diff(speeds).min() > -3 * np.diff(times_s)[0]
    last = world_in_shot(Scenes(TOWN, shots=shots), world, shots.place(2))
    labels = label(last, last.view)
    assert np.isfinite(labels.camera.world_from_cam).all()
    assert any(lane.in_image.sum() > 2 for lane in labels.lanes if lane.kind == "centerline")


EMPTY = ("town.traffic=0.02", "town.parked=0", "trees.n=0", "people.per_100_m=0")


@pytest.mark.parametrize(("y_m", "driven"), [(-1.0, ()), (2000.0, ()), (40.0, ((0.0, 0.0), (1.0, 2000.0)))])
def test_a_host_off_its_way_is_refused(y_m: float, driven: tuple[tuple[float, float], ...]) -> None:
    world = town(0, *EMPTY)
    camera = world.scene.camera.model_copy(update={"y_m": y_m})
    shot = world.scene.shot.model_copy(update={"track": driven, "n_frames": 2, "frame": 1, "fps": 1.0})
    scene = world.scene.model_copy(update={"camera": camera, "shot": shot if driven else world.scene.shot})
    with pytest.raises(InputError, match=r"camera\.y_m: expected the host on its way, from 0 to \d+\.\d m, got"):
        ground_truth(scene)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"s_m": 5000.0}, r"cars\.0\.s_m: expected \S+ to \S+ m in lane \S+, got 5000"),
        ({"s_m": -3.0}, r"cars\.0\.s_m: expected \S+ to .*, got -3"),
        ({"track": ((0.0, 0.0), (1.0, 2000.0))}, r"cars\.0: expected lanes .* 2000 m, which it drives in 1 s, got"),
        ({"speed_m_s": 99.0}, r"cars\.0: expected lanes that go on for 99 m, which it drives in 1 s, got"),
    ],
)
def test_a_car_off_its_lanes_is_refused(changes: dict[str, object], told: str) -> None:
    scene = town(0, "town.parked=0", "trees.n=0", "people.per_100_m=0").scene
    shot = scene.shot.model_copy(update={"n_frames": 2, "frame": 1, "fps": 1.0})
    cars = (scene.cars[0].model_copy(update=changes), *scene.cars[1:])
    with pytest.raises(InputError, match=told):
        ground_truth(scene.model_copy(update={"cars": cars, "shot": shot}))


def test_a_picture_without_any_line_has_no_lanes() -> None:
    world = town(0, *EMPTY)
    camera = world.scene.camera.model_copy(update={"offset_m": 5000.0})
    assert ground_truth(world.scene.model_copy(update={"camera": camera})).lanes == ()
