"""World and View -> Labels: every lane curve and symbol in camera coordinates with its masks, except `object_visible`
(None)."""

from collections.abc import Sequence

import numpy as np

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.polylines import parted
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LidarLabel, RoadPlane, SymbolLabel
from synth3dlanes.roads.lane_curves import LaneCurve
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Scalars
from synth3dlanes.truth.object_truth import label_elements, label_objects
from synth3dlanes.world.motion import host_driven, host_stations
from synth3dlanes.world.paint import is_double, paint_color, pair_of
from synth3dlanes.world.symbols import symbol_points
from synth3dlanes.world.visibility import seen_over_ground
from synth3dlanes.world.world import View, World, resolve

POINTS_STEP_M = 1.0
RANGE_M = 110.0


def ground_truth(scene: Scene) -> Labels:
    """The labels of a scene: curves sampled every metre of road from the host, or as far behind it as its shot says,
    to 110 m ahead."""
    world = resolve(scene)
    return label(world, world.view)


def label(world: World, view: View) -> Labels:
    """The labels of a world for one view."""
    network, lens, shot = world.network, view.camera, world.scene.shot
    camera = CameraLabel(
        width_px=lens.width_px,
        height_px=lens.height_px,
        img_from_cam=view.img_from_cam,
        height_m=lens.height_m,
        pitch_rad=lens.pitch_rad,
        road_from_cam=view.road_from_cam,
        world_from_cam=view.world_from_cam,
        roll_rad=lens.roll_rad,
        yaw_rad=lens.yaw_rad,
        name=lens.name,
        lens=lens.lens,
    )
    stations = _stations(world, lens)
    sampled = dict(zip(stations, network.points_along(stations), strict=True))
    known = _known(world, stations)
    forms = world.symbol_shapes
    outlines = symbol_points(forms, [form.outline for form in forms])
    points_world = np.concatenate([np.zeros((0, 3)), *sampled.values(), *outlines])
    points_cam = transform(invert(view.world_from_cam), points_world)
    in_image = camera.shows(points_cam)
    seen = seen_over_ground(world.ground, view.eye_world, points_world)
    counts = [len(points) for points in (*sampled.values(), *outlines)]
    parts = list(zip(*(parted(values, counts) for values in (points_cam, in_image, seen)), strict=True))
    lanes = tuple(
        Lane(
            id=curve.id,
            kind=curve.kind,
            road=curve.road,
            marking=curve.marking,
            left=curve.beside(False, float(stations[curve][0]), known),
            right=curve.beside(True, float(stations[curve][0]), known),
            xyz_cam=xyz,
            in_image=inside,
            terrain_visible=visible,
            object_visible=None,
            color=paint_color(curve, world.scene.markings),
            double=is_double(curve, world.scene.markings),
            direction=curve.direction,
            pair=pair_of(curve, world.scene.markings),
            connector=curve.connector,
            junction=curve.junction,
        )
        for curve, (xyz, inside, visible) in zip(sampled, parts[: len(sampled)], strict=True)
    )
    symbols = tuple(
        SymbolLabel(form.kind, xyz, inside, visible, object_visible=None)
        for form, (xyz, inside, visible) in zip(forms, parts[len(sampled) :], strict=True)
    )
    named = {lane.id: lane for lane in lanes}
    hosts = [named[name] for name in network.paths_ahead(lens) if name in named]
    centerlines = [curve.id for curve in world.site.lines if curve.kind == "centerline" and curve.id in known]
    graph = network.graph(centerlines)
    return Labels(
        camera,
        lanes,
        graph,
        horizon_plane(camera, hosts) if lens.looks_ahead else None,
        symbols=symbols,
        time_s=round(shot.time_s, 9) if shot.n_frames > 1 else None,
        lidar=_lidar(view),
        objects=label_objects(view, camera),
        traffic_elements=label_elements(world.site, view, camera, graph),
    )


def _stations(world: World, host: HostCamera) -> dict[LaneCurve, Scalars]:
    """The stations of the points of every line that is in range of a host."""
    found = world.network.in_range(host, _lengths(world))
    return {curve: s for curve, s in found.items() if len(s) > 1}


def _known(world: World, stations: dict[LaneCurve, Scalars]) -> set[str]:
    """The ids of the lines that a picture has, or that any frame of its clip has, so that lines name the same
    neighbours in every frame."""
    known, camera, shot = {curve.id for curve in stations}, world.scene.camera, world.scene.shot
    if shot.n_frames > 1:
        driven_m = np.linspace(0.0, host_driven(shot, shot.duration_s), shot.n_frames)
        places_m = host_stations(world.network, camera, driven_m)
        known |= world.network.known(camera, places_m, _lengths(world))
    return known


def _lengths(world: World) -> Scalars:
    """The lengths ahead of the host at which lines are sampled."""
    return np.arange(-world.scene.shot.behind_m, RANGE_M + POINTS_STEP_M / 2, POINTS_STEP_M)


def _lidar(view: View) -> LidarLabel | None:
    if view.lidar is None:
        return None
    fields = ("name", "elevations_rad", "azimuths", "min_range_m", "max_range_m")
    cam_from_lidar = invert(view.world_from_cam) @ view.world_from_lidar
    return LidarLabel(**{name: getattr(view.lidar, name) for name in fields}, cam_from_lidar=cam_from_lidar)


def horizon_plane(camera: CameraLabel, ways: Sequence[Lane]) -> RoadPlane | None:
    """The plane through the camera's foot and the farthest point of the host's way that the ground does not hide; the
    way is one centre line after the other."""
    for lane in reversed(ways):
        seen = np.flatnonzero(lane.in_image & lane.terrain_visible)
        if seen.size:
            _, y, z = transform(camera.road_from_cam, lane.xyz_cam[seen[-1]])
            slope_rad, height_m = float(np.arctan2(z, y)), camera.height_m
            return RoadPlane(
                pitch_rad=round(camera.pitch_rad + slope_rad, 9), height_m=round(height_m * float(np.cos(slope_rad)), 9)
            )
    return None
