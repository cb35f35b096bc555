"""World: a scene resolved once into its site, with roads, trees and buildings. View: a camera at an instant in it.

World frame, metres. Labels, meshes, masks and light are all computed from a world and a view.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import road_from_cam, turned
from synth3dlanes.roads.from_map import bare_roads, map_network
from synth3dlanes.roads.from_paper import paper_network
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.host import HostCamera, Lidar
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.road_map import RoadMap
from synth3dlanes.scene.roadside import Roadside
from synth3dlanes.scene.scene import Car, PaperRoad, Scene, Tree
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.world import roadside
from synth3dlanes.world.bonnet import cam_from_bonnet
from synth3dlanes.world.camera import Sector, img_from_cam, project, sector, world_from_host
from synth3dlanes.world.elements import TrafficElement, traffic_elements
from synth3dlanes.world.grass import Blades, blades
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.horizon import FarHills
from synth3dlanes.world.host_way import HostWay
from synth3dlanes.world.meshes import Mesh
from synth3dlanes.world.motion import car_at, host_at, host_driven, host_station
from synth3dlanes.world.paint import paint_meshes
from synth3dlanes.world.paved_areas import PavedAreas
from synth3dlanes.world.placement import PlacedObject, placed_cars, placed_things, tree_poses, tree_positions
from synth3dlanes.world.seams import ghost_mesh, removed_mesh, tar_mesh
from synth3dlanes.world.solids import Body
from synth3dlanes.world.surfaces import Surfaces
from synth3dlanes.world.symbols import SymbolShape, symbol_meshes, symbol_shapes
from synth3dlanes.world.verges import Verges

# Greatest distance from the host's middle, along it, of cameras that look over the bonnet.
BEHIND_WINDSCREEN_M = 1.0


@dataclass(frozen=True, eq=False)
class View:
    """A camera at the instant of a scene's shot, with the host's place then; the ground; the host's road frame; and the
    share of the image that the host's bonnet fills."""

    scene: Scene
    ground: Ground
    camera: HostCamera
    world_from_host: Matrix4
    bonnet: float = 0.0

    @property
    def network(self) -> Network:
        """The roads."""
        return self.ground.network

    @cached_property
    def cars(self) -> tuple[Car, ...]:
        """All cars at that instant, with their places and speeds then. Raises InputError for one off its lanes."""
        time_s = self.scene.shot.time_s
        return tuple(car_at(self.network, car, time_s, f"cars.{i}") for i, car in enumerate(self.scene.cars))

    @cached_property
    def objects(self) -> tuple[PlacedObject, ...]:
        """All that has a box in labels, at that instant: the cars, then the things, each in the scene's order."""
        return (
            *placed_cars(self.scene, self.network, self.cars),
            *placed_things(self.scene, self.ground),
        )

    @cached_property
    def world_from_cars(self) -> tuple[Matrix4, ...]:
        """The poses of all cars at that instant, without their scale."""
        return tuple(item.world_from_object for item in self.objects[: len(self.cars)])

    @cached_property
    def world_from_things(self) -> tuple[Matrix4, ...]:
        """The poses of all things at that instant, without their scale."""
        return tuple(item.world_from_object for item in self.objects[len(self.cars) :])

    @property
    def lidar(self) -> Lidar | None:
        """The host's lidar, if it has one."""
        return self.scene.lidar

    @cached_property
    def world_from_road(self) -> Matrix4:
        """The camera's road frame: the host's, moved in its plane to the camera's foot."""
        right_m, forward_m = self.camera.right_m, self.camera.forward_m
        return self.world_from_host @ turned(0.0, right_m, forward_m) if right_m or forward_m else self.world_from_host

    @cached_property
    def road_from_cam(self) -> Matrix4:
        """The camera's pose in the road frame below it."""
        camera = self.camera
        return road_from_cam(camera.height_m, camera.pitch_rad, camera.roll_rad, camera.yaw_rad)

    @cached_property
    def world_from_cam(self) -> Matrix4:
        """The camera's pose in the world."""
        return np.asarray(self.world_from_road @ self.road_from_cam)

    @cached_property
    def world_from_bonnet(self) -> Matrix4 | None:
        """The pose of the host's bonnet, None where the picture has none."""
        if not self.bonnet:
            return None
        return np.asarray(self.world_from_cam @ cam_from_bonnet(self.camera, self.bonnet))

    @cached_property
    def world_from_lidar(self) -> Matrix4:
        """The pose of the host's lidar in the world: x right, y forward, z up of the lidar."""
        lidar = self.lidar
        assert lidar is not None, "asked only of views with a lidar"
        pose = road_from_cam(lidar.height_m, lidar.pitch_rad, lidar.roll_rad, lidar.yaw_rad)
        return np.asarray(self.world_from_host @ turned(0.0, lidar.right_m, lidar.forward_m) @ pose)

    @property
    def eye_world(self) -> Float[np.ndarray, "3"]:
        """The optical centre."""
        return np.asarray(self.world_from_cam[:3, 3])

    @cached_property
    def sector(self) -> Sector | None:
        """What of the plan its camera may see; None with a lidar, and where the camera sees on all sides."""
        return None if self.lidar is not None else sector(self.camera, self.world_from_cam)

    @cached_property
    def img_from_cam(self) -> Float[np.ndarray, "3 3"]:
        """The camera's projection matrix, without its lens."""
        return img_from_cam(self.camera)

    def project(self, points_cam: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Pixels (u, v) of points through the lens; NaN for those that are not in its field."""
        return project(self.camera, points_cam)


@dataclass(frozen=True, eq=False)
class Site:
    """What does not move: the ground as built, and what is drawn, grows and is built on it. It knows no camera and no
    instant, so all views of a world share it. Values are computed on first access and kept."""

    surfaces: Surfaces
    trees: tuple[Tree, ...]
    roadside: Roadside

    @property
    def ground(self) -> Ground:
        """The ground as built."""
        return self.surfaces.ground

    @property
    def lines(self) -> tuple[LaneCurve, ...]:
        """All centre lines and delimiters."""
        return self.ground.network.curves

    @cached_property
    def world_from_trees(self) -> dict[int, Matrix4]:
        """The poses of all trees by instance id, without their scale."""
        return tree_poses(self.trees, self.trees_world)

    @cached_property
    def trees_world(self) -> Float[np.ndarray, "n 3"]:
        """The base points of all trees."""
        return tree_positions(self.ground, self.trees)

    @cached_property
    def structures(self) -> list[Body]:
        """What stands beside and over the road, in the order of instance ids; traffic elements come last."""
        own = (*roadside.bodies(self.ground, self.roadside), *self.surfaces.bodies)
        return [*own, *(element.body for element in self.elements)]

    @cached_property
    def elements(self) -> list[TrafficElement]:
        """The traffic elements: heads of signals and faces of signs."""
        return traffic_elements(self.ground, self.roadside)

    @cached_property
    def bodies(self) -> dict[int, Body]:
        """The structures by instance id."""
        return {instance_id("structure", number): body for number, body in enumerate(self.structures)}

    @cached_property
    def elements_by_id(self) -> dict[int, TrafficElement]:
        """The traffic elements by instance id."""
        last = list(self.bodies)[len(self.structures) - len(self.elements) :]
        return dict(zip(last, self.elements, strict=True))

    def lights(self, time_s: float) -> dict[int, Body]:
        """What shines of signals at a time of a clip, by instance id."""
        lit = ((id_, element.light(time_s)) for id_, element in self.elements_by_id.items())
        return {id_: body for id_, body in lit if body is not None}

    @cached_property
    def street_lamps(self) -> Float[np.ndarray, "n 3"]:
        """Where the lamps beside the road have their light: the middles of the lower sides of their heads."""
        return roadside.lamp_heads(self.ground, self.roadside)


@dataclass(frozen=True, eq=False)
class World:
    """A scene and its site. All pictures of a site have a world each."""

    scene: Scene
    site: Site

    @property
    def ground(self) -> Ground:
        """The ground as built."""
        return self.site.ground

    @property
    def network(self) -> Network:
        """The roads."""
        return self.ground.network

    @cached_property
    def view(self) -> View:
        """The view of the scene's camera at the instant of its shot."""
        scene, shot = self.scene, self.scene.shot
        camera = host_at(self.network, scene.camera, host_driven(shot, shot.time_s))
        sees_bonnet = camera.looks_ahead and abs(camera.forward_m) <= BEHIND_WINDSCREEN_M
        bonnet = scene.host.bonnet if sees_bonnet else 0.0
        return View(scene, self.ground, camera, world_from_host(self.network, camera), bonnet)

    def seen_in(self, scene: Scene) -> "World":
        """Another picture of the same site: the scene differs in camera, shot, lidar, light and sky alone."""
        return World(scene, self.site)

    def paint(self, view: View, all_round: bool = True) -> dict[str, Mesh]:
        """The paint of every delimiter by id, corrected for parallax so that it looks in place from a view. Without
        `all_round`, meshes of lines that the view's camera cannot have in its image may be empty."""
        seen = None if all_round else view.sector
        return paint_meshes(self.ground, self.site.lines, view.eye_world, self.scene.stream, seen)

    def symbols(self, view: View, all_round: bool = True) -> list[Mesh]:
        """The paint of every symbol as `paint` has that of lines."""
        seen = None if all_round else view.sector
        return symbol_meshes(self.ground, self.symbol_shapes, view.eye_world, seen)

    @property
    def symbol_ids(self) -> list[int]:
        """The instance ids of all symbols."""
        return [instance_id("symbol", number) for number in range(len(self.symbol_shapes))]

    @cached_property
    def symbol_shapes(self) -> list[SymbolShape]:
        """The shapes of all symbols on the road, in the order of their labels."""
        return symbol_shapes(self.ground, self.scene)

    def tar(self, view: View) -> Mesh | None:
        """Cracks filled with tar, raised less than paint; None without any."""
        amount = self.scene.surface.tar
        return tar_mesh(self.ground, amount, view.eye_world, self.scene.stream) if amount else None

    def ghost_lines(self, view: View) -> Mesh | None:
        """Removed lines, raised less than paint; None without any."""
        if not self.scene.surface.ghost_lines:
            return None
        return ghost_mesh(self.ground, self.scene.markings, view.eye_world, self.scene.stream)

    def removed_lines(self, view: View) -> Mesh | None:
        """Lines in whose place road works have others, raised less than paint; None without any."""
        works = self.scene.roads.works
        if works is None or not works.removed:
            return None
        return removed_mesh(self.ground, self.scene.markings, view.eye_world)

    def grass(self, view: View) -> Blades | None:
        """The grass beside the road as a view sees it, if any grows there."""
        grass_m = self.scene.vegetation.grass_m
        if not grass_m:
            return None
        found = blades(self.ground, view.eye_world, grass_m, self.scene.stream("grass"))
        return found if len(found.shade) else None


def resolve(scene: Scene) -> World:
    """Resolve a scene into its world."""
    return world_on(surfaces_of(scene, scene_network(scene)), scene)


def world_on(surfaces: Surfaces, scene: Scene) -> World:
    """The world of a scene whose surfaces are known."""
    return World(scene, Site(surfaces, scene.trees, scene.roadside))


def surfaces_of(scene: Scene, network: Network) -> Surfaces:
    """The surfaces of a scene around its host, whatever stands and drives there."""
    shot, camera = scene.shot, scene.start
    driven_m = host_station(network, camera, host_driven(shot, shot.duration_s)) - camera.y_m
    driven_m = driven_m if shot.views is None else shot.views.reach_m
    kind = KINDS[type(scene.roads)]
    middle = network.host_points(camera, np.zeros(1))[0, :2] if kind.is_anywhere else np.zeros(2)
    hills = FarHills.draw(scene.stream("far_hills"), middle)
    way = HostWay(network, camera.y_m, driven_m, shot.behind_m > 0)
    return Surfaces(Ground(kind.paved(way, scene.markings, hills)))


def scene_network(scene: Scene) -> Network:
    """The roads of a scene."""
    return KINDS[type(scene.roads)].network(scene)


class RoadKind(NamedTuple):
    """What differs between scenes by what says where their roads are: how the network is made, what is paved, and
    whether the host may be anywhere in the world; elsewhere its road leads through the world's origin."""

    network: Callable[[Scene], Network]
    paved: type[PavedAreas]
    is_anywhere: bool


def _map_network(scene: Scene) -> Network:
    assert scene.map is not None, "asked only of scenes with a map"
    return map_network(scene.map, bare_roads(scene.map, scene.terrain), scene.terrain, scene.start.y_m)


# The only place that asks for the kind of roads.
KINDS = {
    PaperRoad: RoadKind(lambda scene: paper_network(scene.paper_road, scene.terrain), Verges, is_anywhere=False),
    RoadMap: RoadKind(_map_network, PavedAreas, is_anywhere=True),
}
