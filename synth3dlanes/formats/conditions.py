"""Kinds of frames, after the test cases of OpenLane and CULane, from the scene and its labels; docs/exports.md has the
rules. What only the lines of a frame tell (bends, hills, exits) is in `lines.scene_tags`.
The kerbs of a scene as lanes of the labels, for formats that have them: the foot of their front, on the road.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, SymbolLabel
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import DRIVEN
from synth3dlanes.truth.ground_truth import POINTS_STEP_M, RANGE_M
from synth3dlanes.world.rails import KERBS, foot_of_front
from synth3dlanes.world.visibility import seen_over_ground
from synth3dlanes.world.world import resolve

LEAST_POINTS = 2


def kerb_lanes(scene: Scene, camera: CameraLabel) -> tuple[Lane, ...]:
    """Kerbs up to as far ahead as lanes are labelled, a point every metre, as this camera sees them; `kerb_0` and so on
    by their numbers among the scene's rails. They have no paint."""
    kerbs = {i: rail for i, rail in enumerate(scene.roadside.rails) if rail.kind in KERBS}
    if not kerbs:
        return ()
    world, lanes = resolve(scene), []
    host_m = float(camera.world_from_cam[1, 3])
    for i, rail in kerbs.items():
        s = np.arange(min(rail.from_m, rail.to_m), max(rail.from_m, rail.to_m), POINTS_STEP_M)
        ahead_m = world.network.stations(s) - host_m
        s = s[(ahead_m > 0) & (ahead_m < RANGE_M)][:: int(world.network.onwards)]
        if len(s) < LEAST_POINTS:
            continue
        points_world = foot_of_front(world.ground, rail, s)
        xyz_cam = transform(invert(camera.world_from_cam), points_world)
        seen = seen_over_ground(world.ground, camera.world_from_cam[:3, 3], points_world)
        masks = camera.shows(xyz_cam), seen, None
        lanes.append(Lane(f"kerb_{i}", "delimiter", rail.road, "none", None, None, xyz_cam, *masks))
    return tuple(lanes)


AHEAD_M = 60.0
NIGHT_RAD = np.radians(96.0)  # the sun 6 degrees below the horizon: the end of civil twilight
FOG_M = 1000.0  # by which meteorology calls haze fog
CROWD = 5  # cars ahead, of which a quarter is seen
SEEN = 0.25
DAZZLE_RAD, DAZZLE_ASIDE_RAD = np.radians(60.0), np.radians(35.0)
MOST_OVERCAST = 0.5
FAINT_PAINT, SNOW_COVER = 0.2, 0.4
SHADED = 0.1  # of the centre lines up to SHADE_M ahead
SHADE_M = 40.0


def conditions(scene: Scene, labels: Labels) -> frozenset[str]:
    """The names of those that hold: night, extreme_weather, intersection, arrow, crowd, hlight, shadow, noline."""
    return frozenset(_conditions(scene, labels))


def _conditions(scene: Scene, labels: Labels) -> Iterator[str]:
    weather, markings, light = scene.weather, scene.markings, scene.light
    is_night = weather.daytime == "night" or light.sun_zenith_rad > NIGHT_RAD
    if is_night:
        yield "night"
    if max(weather.rain, weather.snowfall, weather.snow) > 0 or scene.air.visibility_m < FOG_M:
        yield "extreme_weather"
    kinds = {symbol.kind for symbol in labels.symbols if _is_seen(symbol)}
    if kinds & {"crosswalk", "stop_line"} or any(lane.connector and _is_seen(lane) for lane in labels.lanes):
        yield "intersection"
    if any(kind.startswith("arrow") for kind in kinds):
        yield "arrow"
    if _cars_ahead(labels) >= CROWD:
        yield "crowd"
    paint = markings.grayscale * (1 - markings.wear) * (1 - markings.missing)
    if paint < FAINT_PAINT or weather.snow_on_road >= SNOW_COVER:
        yield "noline"
    if scene.air.overcast < MOST_OVERCAST and light.sun_zenith_rad < np.pi / 2:
        if light.sun_zenith_rad > DAZZLE_RAD and _sun_aside_rad(scene, labels) < DAZZLE_ASIDE_RAD:
            yield "hlight"
        if _shaded_share(scene, labels) > SHADED:
            yield "shadow"


def _is_seen(item: SymbolLabel | Lane) -> bool:
    is_near = item.xyz_cam[:, 1] < AHEAD_M
    return np.count_nonzero(item.in_image & item.terrain_visible & is_near) >= 2


def _cars_ahead(labels: Labels) -> int:
    cars = (item for item in labels.objects or () if item.category in DRIVEN)
    ahead = (item for item in cars if 0 < item.center_cam[1] < AHEAD_M)
    return sum(item.visible_fraction is None or item.visible_fraction >= SEEN for item in ahead)


def _sun_aside_rad(scene: Scene, labels: Labels) -> float:
    """The angle between the sun and the camera's viewing direction, seen from above."""
    x, y = labels.camera.world_from_cam[:2, 1]
    turn_rad = scene.light.sun_azimuth_rad - np.arctan2(y, x)
    return float(abs((turn_rad + np.pi) % (2 * np.pi) - np.pi))


def _shaded_share(scene: Scene, labels: Labels) -> float:
    """The share of the centre lines ahead that lies in the shadow of a tree, a building or a bridge, as on flat ground:
    a strip as wide as what casts it and as long as its height by the sun."""
    xy_world = _centres_ahead(labels)
    if not len(xy_world):
        return 0.0
    azimuth_rad, length = scene.light.sun_azimuth_rad, np.tan(scene.light.sun_zenith_rad)
    away = -np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
    shaded: Bool[np.ndarray, " n"] = np.zeros(len(xy_world), dtype=bool)
    for x_m, y_m, radius_m, height_m in _casters(scene):
        along_m, aside_m = ((xy_world - [x_m, y_m]) @ np.column_stack([away, [-away[1], away[0]]])).T
        shaded |= (along_m > 0) & (along_m < height_m * length) & (np.abs(aside_m) < radius_m)
    onwards = -1 if scene.roads.flip_lateral else 1
    for crossing in scene.roadside.crossings:
        if crossing.kind == "bridge":
            shaded |= np.abs(xy_world[:, 1] - onwards * crossing.s_m) < crossing.width_m / 2
    return float(shaded.mean())


def _centres_ahead(labels: Labels) -> Float[np.ndarray, "n 2"]:
    lanes = [lane.xyz_cam for lane in labels.lanes if lane.kind == "centerline"]
    points_cam = np.concatenate([np.zeros((0, 3)), *lanes])
    near = (points_cam[:, 1] > 0) & (points_cam[:, 1] < SHADE_M)
    return transform(labels.camera.world_from_cam, points_cam[near])[:, :2]


def _casters(scene: Scene) -> Iterator[tuple[float, float, float, float]]:
    """Place, half width and height of what casts shadows."""
    models = scene.assets.tree_models
    for tree in scene.trees:
        model = models[tree.model - 1]
        yield tree.x_m, tree.y_m, tree.scale * model.crown_radius_m, tree.scale * model.height_m
    for building in scene.roadside.buildings:
        yield building.x_m, building.y_m, min(building.width_m, building.length_m) / 2, building.height_m
