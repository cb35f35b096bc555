"""People and riders: they touch nothing, stand on what is built, cross when they may, and change nothing else."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely

from synth3dlanes.draw.given_map import MapPlace
from synth3dlanes.draw.sample import Scenes, draw_world, world_in_shot
from synth3dlanes.params.params import load_params
from synth3dlanes.params.shots import Shots
from synth3dlanes.roads.maps.given_map import read_opendrive
from synth3dlanes.scene.assets.catalogue import THINGS
from synth3dlanes.scene.scene import Scene
from synth3dlanes.validate.faces import MeshFaces
from synth3dlanes.world.motion import host_speed
from synth3dlanes.world.world import World
from tests.golden.frozen import ROWS, scenes_of
from tests.maps.files import lane, opendrive, plan, road, section
from tests.thorough import first
from tests.town_checks import bodies, houses, thing_bodies

MANY = ("people.per_100_m=20", "people.crossing=4", "riders.cyclists=8", "riders.motorcyclists=3")
WALKWAYS = (
    "town.n_more=0", "trees.n=0", "town.walkway_m=2.6", "town.crosswalks=true", "town.host_place=before",
    "town.host_m=25",
)  # fmt: skip
CLIP = Shots(frames=25, fps=5.0)
SEEN = Scenes(load_params("town"), shots=CLIP)


@cache
def town(index: int, *overrides: str, shots: Shots | None = None) -> World:
    """A town full of people."""
    params = load_params("town", (*MANY, *WALKWAYS, *overrides))
    return draw_world(Scenes(params, 5, shots=shots) if shots else Scenes(params, 5), index)


def standing(scene: Scene) -> list[shapely.Geometry]:
    """Walls, poles and trunks from above."""
    poles = [shapely.Point(at.x_m, at.y_m).buffer(0.1) for at in scene.roadside.free_elements if at.has_pole]
    return [*houses(scene), *poles, *(shapely.Point(tree.x_m, tree.y_m).buffer(0.15) for tree in scene.trees)]


def overlaps(world: World) -> list[tuple[int, int]]:
    """Things that touch a body, by their numbers in one list: things, vehicles with the host, what stands."""
    things = thing_bodies(world)
    everything = [*things, *bodies(world), *standing(world.scene)]
    pairs = shapely.STRtree(everything).query(things, predicate="intersects").T.tolist()
    return [(i, j) for i, j in pairs if i != j]


CLIPS = (
    (0, ("town.junction=crossing", "town.control=signals")),
    (1, ("town.junction=t", "town.traffic=1", "town.parked=0.9")),
    (2, ("town.junction=roundabout",)),
    (3, ("town.junction=crossing", "town.n_lanes=2", "town.parking=true", "town.street_trees=0.7")),
)


@pytest.mark.parametrize(("index", "own"), first(1, CLIPS))
def test_nobody_is_in_a_body_at_any_instant_of_a_clip(index: int, own: tuple[str, ...]) -> None:
    world = town(index, *own, shots=CLIP)
    kinds = [thing.kind for thing in world.scene.things]
    assert kinds.count("pedestrian") > 15
    step = 8 if index == 0 else 1
    for frame in range(0, CLIP.frames, step):
        assert overlaps(world_in_shot(SEEN, world, CLIP.place(frame))) == []


def test_feet_are_on_the_mesh_of_walkways_or_crosswalks() -> None:
    world = town(1, "town.junction=crossing", "town.control=priority")
    scene = world.scene
    assert scene.map is not None
    raised = world.ground.paved.walkways(world.view.world_from_host[:2, 3], 90.0)
    crosswalks = shapely.union_all([shapely.Polygon(at.outline).buffer(1.0) for at in scene.map.paint if at.outline])
    people = [
        pose[:3, 3]
        for thing, pose in zip(scene.things, world.view.world_from_things, strict=True)
        if thing.kind == "pedestrian"
    ]
    raised = raised.buffer(0.02)  # strips beside each other
    on_walkway = [bool(raised.contains(shapely.Point(foot[:2]))) for foot in people]
    assert sum(on_walkway) > 20
    for foot, is_raised in zip(people, on_walkway, strict=True):
        assert is_raised or crosswalks.contains(shapely.Point(foot[:2]))
    feet = np.array(people)
    assert MeshFaces(world.site.surfaces.pavement).height(feet[:, :2]) == pytest.approx(feet[:, 2], abs=0.02)


@pytest.mark.parametrize("index", first(1, [4, 5, 0, 6, 7]))
def test_who_crosses_has_red_lights_for_traffic_and_no_vehicle_near(index: int) -> None:
    """People on the pavement of traffic, on crosswalks before signals, where many others wait."""
    own = "town.junction=crossing", "town.control=signals", "town.traffic=0.6", "people.per_100_m=0"
    world = town(index, *own, "riders.cyclists=0", "town.host_m=10", "town.n_lanes=1", "town.fronts=0")
    scene, lanes, crossed = world.scene, world.network.lanes, 0
    assert scene.map is not None
    areas = [shapely.Polygon(at.outline) for at in scene.map.paint if at.kind == "crosswalk"]
    governed = {name for signal in scene.roadside.signals for name in signal.lanes}
    found = {name: world.network.lane_lines(lanes[name], np.zeros(2), 200.0) for name in governed}
    lines = {name: shapely.LineString(at[0][:, :2]) for name, at in found.items() if at is not None}
    for body in thing_bodies(world):
        for area in (area for area in areas if area.buffer(-0.5).contains(body.centroid)):
            over = {name for name, line in lines.items() if line.intersects(area)}
            lights = [at.state_at(0.0) for at in scene.roadside.signals if over & {*at.lanes}]
            assert lights
            assert {*lights} == {"red"}
            assert min(body.distance(vehicle) for vehicle in bodies(world)) > 0.5
            crossed += 1
    assert crossed > 0


MEETING = ("town.junction=crossing", "town.control=priority", "town.traffic=0.8", "town.n_more=0", "town.host_m=10")


@pytest.mark.parametrize("index", first(1, [0, 1, 3]))
def test_cars_stop_for_who_crosses_in_a_clip(index: int) -> None:
    """Not on a crosswalk; and those who stood at the kerb when the clip began cross."""
    world = town(index, *MEETING, "people.crossing=3", shots=CLIP)
    alone = town(index, *MEETING, "people.crossing=0", shots=CLIP)
    assert world.scene.map is not None
    areas = [shapely.Polygon(at.outline) for at in world.scene.map.paint if at.kind == "crosswalk"]
    street = shapely.union_all(areas)
    stopped = sum(
        other.track[-1][1] - car.track[-1][1] > 3
        for car, other in zip(world.scene.cars, alone.scene.cars, strict=False)
        if car.track and other.track and (car.lane, car.s_m) == (other.lane, other.s_m)
    )
    assert stopped > 0
    n_on = []
    for frame in range(0, CLIP.frames, 6):
        now = world_in_shot(SEEN, world, CLIP.place(frame))
        people = [body.centroid for body in thing_bodies(now) if street.contains(body.centroid)]
        n_on.append(len(people))
        cars = [float(np.linalg.norm(item.velocity_world)) for item in now.view.objects if item.kind is None]
        speeds = [host_speed(now.scene.shot, now.scene.shot.time_s), *cars]
        for body, speed_m_s, (ahead, middle) in zip(bodies(now), speeds, headings(now), strict=True):
            assert speed_m_s > 0.3 or body.intersection(street).area < 0.1
            before = shapely.LineString([middle, middle + 6.0 * ahead]).buffer(1.0, cap_style="flat")
            assert speed_m_s < 4 or not any(before.contains(person) for person in people)
    assert n_on[-1] > 0
    feet = [
        [shapely.Point(pose[:2, 3]) for pose in world_in_shot(SEEN, world, CLIP.place(frame)).view.world_from_things]
        for frame in (0, CLIP.frames - 1)
    ]
    begun = sum(street.contains(last) and not street.contains(first) for first, last in zip(*feet, strict=True))
    assert begun > 0, "beside the crosswalks when the clip begins, and on one when it ends"


def headings(world: World) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where the host and the cars head to, and their middles, from above."""
    poses = (world.view.world_from_host, *world.view.world_from_cars)
    return [(pose[:2, 1], pose[:2, 3]) for pose in poses]


@pytest.mark.thorough
def test_people_climb_kerbs_smoothly() -> None:
    """From frame to frame, between the heights of the pavement and of the walkway."""
    shots = Shots(frames=61, fps=15.0)
    seen = Scenes(load_params("town"), shots=shots)
    world = town(1, *MEETING, "people.crossing=3", "people.per_100_m=0", shots=shots)
    views = [world_in_shot(seen, world, shots.place(frame)).view for frame in range(shots.frames)]
    feet = np.array([[pose[:3, 3] for pose in view.world_from_things] for view in views])
    built = world.ground.height(feet[:, :, :2])
    climbed = (np.ptp(built - feet[:, :, 2], axis=0) > 0.03) & (np.abs(built - feet[:, :, 2])[[0, -1]] < 0.005).all(
        axis=0
    )
    assert climbed.any()
    assert np.abs(np.diff(feet[:, climbed, 2], axis=0)).max() < 0.04
    assert np.ptp(feet[:, climbed, 2], axis=0).min() > 0.09


@pytest.mark.thorough
def test_umbrellas_are_for_rain() -> None:
    held = {}
    for kind in ("rain", "clear"):
        scene = town(2, f"weather.kind={kind}", "people.umbrella=1").scene
        models = [THINGS["pedestrian"][at.model - 1] for at in scene.things if at.kind == "pedestrian"]
        held[kind] = [("umbrella" in model.paints) for model in models]
    assert all(held["rain"])
    assert not any(held["clear"])
    assert min(map(len, held.values())) > 10


def test_people_walk_ahead_at_their_speed() -> None:
    """Not sideways or backwards, and each as fast in all frames."""
    shots = Shots(frames=4, fps=5.0)
    own = "people.standing=0.3", "people.speed_m_s=[1.2, 1.3]", "people.crossing=0"
    scenes, world = Scenes(load_params("town"), shots=shots), town(0, *own, shots=shots)
    views = [world_in_shot(scenes, world, shots.place(frame)).view for frame in (1, 2)]
    stood = walked = 0
    for thing, before, after in zip(world.scene.things, *(view.world_from_things for view in views), strict=True):
        if thing.kind == "pedestrian":
            step = (after - before)[:2, 3] * shots.fps
            if not thing.track:
                assert not step.any()
                stood += 1
                continue
            walked += 1
            assert np.linalg.norm(step) == pytest.approx(1.25, abs=0.12)
            assert step @ before[:2, 1] > 0.9 * np.linalg.norm(step)
    assert stood > 3
    assert walked > 10


def test_cyclists_keep_right_of_cars_and_motorcyclists_in_lanes() -> None:
    """By the lanes of the map: a cyclist is right of the middle of its lane, and rides as its traffic does."""
    found = {"cyclist": 0, "motorcyclist": 0}
    for index in range(3):
        world = town(index, "people.per_100_m=0", "town.junction=t", "town.n_lanes=1", "town.traffic=0.1")
        network = world.network
        for thing, pose in zip(world.scene.things, world.view.world_from_things, strict=True):
            if thing.kind == "pedestrian":
                continue
            lanes = [network.lane_lines(lane, pose[:2, 3], 30.0) for lane in network.lanes.values()]
            middles = [at[0][:, :2] for at in lanes if at is not None]
            middle = min(middles, key=lambda line: shapely.LineString(line).distance(shapely.Point(pose[:2, 3])))
            i = int(np.linalg.norm(middle[:-1] - pose[:2, 3], axis=1).argmin())
            ahead = (middle[i + 1] - middle[i]) / np.linalg.norm(middle[i + 1] - middle[i])
            assert ahead @ pose[:2, 1] > 0.98
            right_m = float((pose[:2, 3] - middle[i]) @ [ahead[1], -ahead[0]])
            assert (0.6 < right_m < 1.9) if thing.kind == "cyclist" else abs(right_m) < 0.5
            found[thing.kind] += 1
    assert min(found.values()) > 1


def test_motorcyclists_of_streets_ride_in_the_middle_of_lanes() -> None:
    params = load_params("streets", ("riders.motorcyclists=6", "cars.n=12", "trees.n=0"))
    for index in range(2):
        world = draw_world(Scenes(params, 8), index)
        middles = [curve for curve in world.network.curves if curve.kind == "centerline"]
        along = shapely.multilinestrings([curve.xy_world(np.arange(-250.0, 250.0, 0.5)) for curve in middles])
        away_m = [along.distance(shapely.Point(pose[:2, 3])) for pose in world.view.world_from_things]
        assert 0 < max(away_m) < 0.41


def test_riders_keep_off_roads_below_others() -> None:
    """On a map with a bridge, where the height of the ground is that of the deck."""
    own = load_params("streets", ("riders.cyclists=30", "riders.motorcyclists=10", "cars.n=0"))
    world = draw_world(replace(scenes_of(ROWS["map of bridge"]), params=own), 0)
    places = np.array([(thing.x_m, thing.y_m) for thing in world.scene.things])
    lanes = world.network.lanes.values()
    middles = np.concatenate([world.network.lane_lines(lane, np.zeros(2), 900.0)[0][:, :2] for lane in lanes])  # type: ignore[index]
    assert world.ground.is_stacked(middles).any()
    assert len(places) > 10
    assert not world.ground.is_stacked(places).any()


@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_cyclists_ride_on_the_cycle_lanes_of_maps_as_their_traffic_drives(rule: str) -> None:
    """One is beside the driving lane, one beyond a lane for parking; offsets are to the right along the road."""
    width = '<width sOffset="0" a="{}" b="0" c="0" d="0"/>'
    lanes = section(
        lane(2, width.format(1.8), "biking"),
        lane(1, width.format(3.5)),
        lane(-1, width.format(3.5)),
        lane(-2, width.format(2.0), "parking"),
        lane(-3, width.format(1.8), "biking"),
    )
    text = opendrive(road(plan(("<line/>", 100.0), ('<arc curvature="0.005"/>', 200.0)), lanes, more=f'rule="{rule}"'))
    given = read_opendrive(text, "cycles.xodr", "map cycles.xodr")
    own = load_params("streets", ("riders.cyclists=8", "riders.motorcyclists=0", "cars.n=0"))
    shots, along = Shots(frames=5, fps=2.0), list[bool]()
    for index in range(3):
        scenes = Scenes(own, 5, shots=shots, map=MapPlace(given))
        world = draw_world(scenes, index)
        line = world.network.roads[0].line
        for frame in (0, 4):
            poses = world_in_shot(scenes, world, shots.place(frame)).view.world_from_things
            s, t = line.project(np.array([pose[:2, 3] for pose in poses]).reshape(-1, 2))
            ahead = np.array([pose[:2, 1] for pose in poses]).reshape(-1, 2)
            right = line.frames(s).normals
            onwards = right[:, 0] * ahead[:, 1] - right[:, 1] * ahead[:, 0] > 0
            assert np.abs(t - np.where(onwards == (rule == "RHT"), 6.4, -4.4)).max(initial=0.0) < 0.05
            along += onwards.tolist()
    assert 0.2 < np.mean(along) < 0.8
