"""The sampler: declared distributions, streams that do not touch each other, objects that have room, hosts in lanes."""

import itertools

import numpy as np
import pytest
from scipy import stats

from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world, world_in_shot
from synth3dlanes.geometry.frames import invert, transform, turned
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import Shots, clips
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.world import World, resolve
from tests.scenes import changed
from tests.thorough import presets
from tests.town_checks import bodies, thing_bodies, touching

N = 150
# With some 40 tests of uniformity, a true null falls below this once in 250 runs; the draws are fixed, so never here.
P_VALUE = 1e-4


@pytest.fixture(scope="module")
def params():
    return load_params("appendix_i")


@pytest.fixture(scope="module")
def scenes(params):
    return [sample_scene(Scenes(params), index) for index in range(N)]


def uniform(values, low, high):
    return stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue


# The paper's Appendix I, read again here: part of the scene, field, range.
RANGES = [
    ("road", "lane_width_m", 3.2, 4.0), ("road", "shoulder_factor", 0.2, 0.6), ("road", "offset_m100_m", -10, 10),
    ("road", "offset_m50_m", -10, 10), ("road", "offset_p50_m", -10, 10), ("road", "offset_p100_m", -10, 10),
    ("road", "exit_angle_rad", np.radians(1), np.radians(5)), ("road", "exit_offset_m", 0, 10),
    ("road", "ramp_height_m", 2, 6), ("road", "ramp_slope", 0.5, 4.5), ("markings", "dash_cycle_m", 0.5, 4.5),
    ("markings", "dash_fraction", 0.3, 1), ("markings", "width_m", 0.1, 0.15), ("markings", "grayscale", 0.2, 1),
    ("markings", "gloss", 0.5, 1), ("surface", "road_texture_scale", 10, 30), ("surface", "road_gloss", 0, 0.2),
    ("surface", "terrain_texture_scale", 5, 15), ("surface", "texture_orientation_rad", 0, np.pi / 2),
    ("camera", "y_m", -80, -20), ("camera", "offset_m", -0.4, 0.4), ("camera", "height_m", 1.4, 1.9),
    ("camera", "pitch_rad", 0, np.radians(5)), ("light", "sun_zenith_rad", 0, np.pi / 4),
    ("light", "sun_azimuth_rad", 0, 2 * np.pi), ("light", "exposure", 1, 3),
]  # fmt: skip


def test_scalars_are_uniform_over_appendix_i(scenes):
    gaussians = [g for scene in scenes for g in scene.terrain.gaussians]
    cars = [car for scene in scenes for car in scene.cars]
    drawn = [([getattr(getattr(scene, part), field) for scene in scenes], *ends) for part, field, *ends in RANGES]
    drawn += [
        ([x for g in gaussians for x in g.center_m], -150, 150),
        ([g.magnitude_m for g in gaussians], -50, 50),
        ([x for g in gaussians for x in g.sd_m], 25, 250),
        ([g.orientation_rad for g in gaussians], 0, np.pi / 2),
        ([car.scale for car in cars], 0.9, 1.1),
        ([car.gloss for car in cars], 0.3, 1),
        *(([car.color[channel] for car in cars], 0, 1) for channel in range(3)),
    ]
    assert [row for row, (values, *ends) in enumerate(drawn) if uniform(values, *ends) <= P_VALUE] == []


def test_counts_types_and_flips_are_evenly_drawn(scenes):
    counts = {
        "gaussians": ([len(s.terrain.gaussians) for s in scenes], range(1, 8)),
        "topology": ([s.road.topology for s in scenes], range(1, 5)),
        "lanes": ([s.road.n_lanes for s in scenes], range(2, 5)),
        "flip x": ([s.road.flip_longitudinal for s in scenes], (False, True)),
        "flip y": ([s.road.flip_lateral for s in scenes], (False, True)),
        "road texture": ([s.surface.road_texture for s in scenes], range(1, 4)),
        "terrain texture": ([s.surface.terrain_texture for s in scenes], range(1, 3)),
        "cars": ([len(s.cars) for s in scenes], range(1, 25)),
        "car models": ([car.model for s in scenes for car in s.cars], range(1, 7)),
        "tree models": ([tree.model for s in scenes[:100] for tree in s.trees], range(1, 7)),
    }
    for name, (values, legal) in counts.items():
        found = [sum(value == x for value in values) for x in legal]
        assert sum(found) == len(values), name
        assert stats.chisquare(found).pvalue > P_VALUE, name
    assert uniform([len(s.trees) for s in scenes], 39.5, 800.5) > P_VALUE


def test_the_host_stands_in_every_lane_present_alike(scenes):
    places = [(s.camera.lane - 0.5) / s.road.lanes_present(s.camera.y_m) for s in scenes]
    assert min(places) > 0
    assert max(places) < 1
    assert np.mean(places) == pytest.approx(0.5, abs=0.05)


# Changes, and the parts of a scene that differ by them; all else is drawn as without them.
TOWN = ("town.traffic=0.1", "people.per_100_m=9", "riders.cyclists=2")
ALONE = (
    ("appendix_i", ("terrain.n_gaussians=5", "light.exposure=1", "trees.n=50"), "terrain light trees"),
    ("appendix_i", ("vegetation.translucency=1", "vegetation.grass_m=0.2"), "vegetation"),
    ("diverse", ("weather.kind=rain", "weather.daytime=night"), "air light sensor surface weather"),
    (
        "streets",
        ("roadside.outer=none", "roadside.lamps=both", "roadside.n_signs=9", "roadside.n_houses=9"),
        "roadside trees",
    ),
    ("streets", ("works.present=true",), "cars road symbols things"),
    ("town", ("people.per_100_m=0", "people.crossing=0", "riders.cyclists=0", "riders.motorcyclists=0"), "things"),
)


@pytest.mark.parametrize(("preset", "changes", "parts"), ALONE)
def test_groups_have_streams_of_their_own(preset, changes, parts):
    """Changing one group leaves every other as it was, unless it depends on it by its meaning."""
    always = TOWN if preset == "town" else ("road.topology=1", "works.present=false")
    one, other = (sample_scene(Scenes(load_params(preset, (*always, *own))), 3) for own in ((), changes))
    differ = {part for part in type(one).model_fields if getattr(one, part) != getattr(other, part)}
    assert differ == {*parts.split()}


def test_scenes_differ_by_seed_split_and_index(params):
    texts = {
        sample_scene(Scenes(params, seed, split), index).road
        for seed, split, index in ((0, "train", 0), (1, "train", 0), (0, "test", 0), (0, "train", 1))
    }
    assert len(texts) == 4


@pytest.mark.parametrize(
    ("preset", "shots", "n", "changes"),
    [
        ("appendix_i", clips(6, 2.5), 6, ["trees.n=40"]),
        ("streets", clips(6, 2.5), 6, ["trees.n=40", "riders.motorcyclists=6", "cars.n=12"]),
        ("appendix_i", Shots(views=8), 2, ["cars.n=40", "trees.n=0"]),
    ],
)
def test_no_two_cars_ever_touch(preset, shots, n, changes):
    """At any instant of a clip, and at any place of the host in a world of views; host and motorcyclists included."""
    scenes = Scenes(load_params(preset, changes), shots=shots)
    for index in range(n):
        world = sample_world(scenes, shots.per_scene * index)
        assert world.scene.cars
        for picture in range(shots.per_scene):
            now = world_in_shot(scenes, world, shots.place(picture))
            assert touching([*bodies(now), *thing_bodies(now)]) == [], (index, picture)


SOLD = ["cars.palette=sold", "cars.model={2: 3, 11: 1}", "cars.n=10", "trees.n=0"]


@pytest.mark.thorough
def test_cars_have_the_colours_that_are_sold():
    """Axalta's report of 2020: 38 % of new cars are white, 19 % black, 81 % white, black, gray or silver."""
    params = load_params("appendix_i", SOLD)
    cars = [car for index in range(N // 2) for car in sample_scene(Scenes(params), index).cars]
    colors = np.array([car.color for car in cars if car.model == 2])
    is_plain, brightness = np.ptp(colors, axis=1) < 0.05, colors.mean(axis=1)
    for is_kind, share in ((is_plain, 0.81), (is_plain & (brightness > 0.8), 0.38), (brightness < 0.14, 0.19)):
        assert stats.binomtest(int(is_kind.sum()), len(colors), share).pvalue > P_VALUE
    buses = np.array([car.color for car in cars if car.model == 11])
    assert (buses.min(axis=1) > 0.8).mean() > 0.5, "most buses are white"
    assert all(car.saturation == 1 for car in cars), "the colour is shown as it is"


def test_the_palette_changes_colours_alone():
    """The same draws of everything else, and mixed palettes leave each car its own colour of either."""
    worlds = {}
    for palette in ("rgb", "sold", "{rgb: 1, sold: 1}"):
        params = load_params("appendix_i", [*SOLD, f"cars.palette={palette}"])
        worlds[palette] = sample_scene(Scenes(params), 3)
    rgb, sold, mixed = (scene.cars for scene in worlds.values())
    for one, other, either in zip(rgb, sold, mixed, strict=True):
        plain = other.model_copy(update={"color": one.color, "saturation": one.saturation})
        assert plain == one
        assert either in (one, other)
    assert rgb not in (sold, mixed)
    assert sold != mixed


def test_no_room_is_an_error_that_names_the_parameters():
    with pytest.raises(InputError, match=r"trees\.x_m, trees\.y_m: no room"):
        sample_scene(Scenes(load_params("appendix_i", ["trees.x_m=0", "trees.y_m=0"])), 0)
    with pytest.raises(InputError, match=r"cars\.n: no room for car"):
        sample_scene(Scenes(load_params("appendix_i", ["cars.n=90", "cars.s_m=[0, 10]"])), 0)


def test_cars_for_which_there_is_no_room_are_left_out_where_fewer_are_allowed():
    """A jam: one lane of 60 m; the shortest car is 3.5 m long."""
    jam = ["cars.n=[2, 90]", "cars.s_m=[0, 60]", "cars.parked=0", "road.n_lanes=1", "road.topology=1"]
    counts = []
    for index in range(10):
        scene = sample_scene(Scenes(load_params("appendix_i", jam)), index)
        ends = sorted((car.s_m, scene.assets.car_models[car.model - 1].length_m * car.scale) for car in scene.cars)
        assert min(b - a - (of_a + of_b) / 2 for (a, of_a), (b, of_b) in itertools.pairwise(ends)) > 0.5
        counts.append(len(scene.cars))
    assert 5 <= min(counts) <= max(counts) <= 60 / 3.5


# Distance of a chord's middle from a sharp bend, and the end of a lane without points: those of maps are 1 m apart.
LAW_M, CHORD_M, REST_M = 0.001, 0.03, 2.0


def off_its_lane_m(world: World) -> float:
    """How far the host is from the scene's offset, to the right."""
    labels, camera = label(world, world.view), world.view.camera
    on_host = turned(0.0, camera.right_m, camera.forward_m)
    host = labels.camera.world_from_cam @ invert(labels.camera.road_from_cam) @ invert(on_host)
    ends = [world.network.host_lane(camera.lane, camera.y_m + ahead_m).id for ahead_m in (0.0, REST_M)]
    paths = {path for part in labels.graph.segments if part.id in ends for path in part.centerlines}
    points = {lane.id: transform(labels.camera.world_from_cam, lane.xyz_cam)[:, :2] for lane in labels.lanes}
    off_m = [aside - camera.offset_m for path in paths & points.keys() for aside in asides_m(points[path], host[:2, 3])]
    return min(off_m, key=abs)


def asides_m(points: np.ndarray, foot: np.ndarray) -> tuple[float, ...]:
    """Estimates of how far right of a lane a place beside it is: the distance to the line through the lane's point
    nearest to it and the next one, the signed distance to that point (for a lane that opens, which is not parallel to
    the road), and the distance to the parabola through three points there (for a bend that begins there)."""
    nearest = min(int(np.hypot(*(points - foot).T).argmin()), len(points) - 2)
    first, second = points[nearest : nearest + 2]
    (dx, dy), (x, y) = (second - first) / np.linalg.norm(second - first), foot - first
    across_m = float(x * dy - y * dx)
    three = points[max(min(nearest - 1, len(points) - 3), 0) :][:3] - first
    along, aside = three @ [dx, dy], three @ [dy, -dx]
    bent_m = float(np.polyval(np.polyfit(along, aside, len(three) - 1), x * dx + y * dy))
    return across_m, float(np.copysign(np.hypot(x, y), across_m)), across_m - bent_m


@pytest.mark.parametrize("preset", presets("appendix_i", "streets"))
def test_every_drawn_host_is_in_its_lane_and_clear_of_cars(preset: str) -> None:
    for index in range(3):
        world = sample_world(Scenes(load_params(preset)), index)
        law_m = CHORD_M if world.scene.map else LAW_M
        assert abs(off_its_lane_m(world)) < law_m
        assert touching(bodies(world)) == []


def test_so_it_is_where_a_lane_through_a_junction_ends() -> None:
    """Where its own lane has less than two points left, the next one is a host's."""
    params = load_params("town", ["town.host_place=in", "town.host_m=59.9", "town.junction=crossing", "town.traffic=0"])
    assert abs(off_its_lane_m(sample_world(Scenes(params), 1))) < CHORD_M


@pytest.mark.parametrize("flipped", [False, True])
def test_an_offset_is_to_the_right_whatever_the_cameras_angles(flipped: bool) -> None:
    camera = {"offset_m": 0.3, "pitch_rad": 0.1, "roll_rad": 0.2}
    world = resolve(changed(road={"flip_longitudinal": flipped}, camera=camera))
    assert abs(off_its_lane_m(world)) < LAW_M
    middle = resolve(changed(world.scene, camera={"offset_m": 0.0}))
    right = middle.view.world_from_host[:2, 0]
    assert (world.view.eye_world - middle.view.eye_world)[:2] @ right == pytest.approx(0.3, abs=0.02)
