"""A scene and its labels as groups of (name, value), in readable words and units. Grade and curvature of lanes
are measured over lengths at which rounding does not matter."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.figures.samples import ShownScene
from synth3dlanes.geometry.frames import transform
from synth3dlanes.geometry.lens import Lens, width_rad
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.host import Bonnet, HostCamera
from synth3dlanes.scene.scene import Scene, Weather
from synth3dlanes.system.schema import DocumentPart
from synth3dlanes.system.words import counted
from synth3dlanes.world.motion import host_driven, host_speed

Facts = dict[str, str]

LANE_COLUMNS = ("lane", "kind", "road", "marking", "points", "image", "ground", "objects", "seen")
OBJECT_COLUMNS = (
    "object",
    "class",
    "centre x, y, z [m]",
    "width, length, height [m]",
    "speed",
    "seen",
    "truncated",
    "lidar",
)
ELEMENT_COLUMNS = (
    "element", "class", "shows", "governs", "centre x, y, z [m]", "width, height [m]", "seen"
)  # fmt: skip


def shown_title(shown: ShownScene) -> str:
    """What is shown, in a line."""
    scene = shown.scene
    if scene is None:
        return f"sample {shown.name}, lifted from a real drive"
    lanes = f"{counted(scene.roads.n_lanes, 'lane')}, " if scene.roads.n_lanes else ""
    return f"seed {scene.seed}, {scene.split} {scene.index}: {lanes}{scene.roads.words}"


def describe(shown: ShownScene) -> dict[str, Facts]:
    """A summary by group: source, road, shape, camera, light, air, sensor, weather, objects, paint and surface; of a
    sample that was lifted from a real drive, what is known of it."""
    scene, labels = shown.scene, shown.labels
    if scene is None:
        return {"lifted": {"sample": shown.name}, "shape": _shape(labels), "camera": _camera(shown)}
    return {
        "drawn from": {"seed": str(scene.seed), "split": scene.split, "index": str(scene.index)},
        "road": _road(scene, labels),
        "shape": {**_shape(labels), "hills and hollows": str(len(scene.terrain.gaussians))},
        "camera": _camera(shown),
        "light": {
            "sun": f"{90 - math.degrees(scene.light.sun_zenith_rad):.0f}° above the horizon, "
            f"azimuth {math.degrees(scene.light.sun_azimuth_rad) % 360:.0f}°",
            "exposure": f"{scene.light.exposure:.2f}, metering {scene.light.metering:.2f}",
        },
        "air": {
            "visibility": f"{scene.air.visibility_m / 1000:.1f} km",
            "overcast": f"{100 * scene.air.overcast:.0f} % of the sun hidden",
        },
        "sensor": {
            "motion blur": f"{scene.sensor.motion_blur_m:.2f} m",
            "noise": f"{scene.sensor.noise:.1f} levels at middle gray",
            **_changed(scene.sensor, besides=("motion_blur_m", "noise")),
        },
        **({} if (scene.weather, scene.host) == (Weather(), Bonnet()) else {"weather": _weather(scene)}),
        "objects": {
            "cars": _counted([scene.assets.car_models[car.model - 1].name for car in scene.cars]),
            **({"people, riders, works": _counted([thing.kind for thing in scene.things])} if scene.things else {}),
            "trees": _counted([scene.assets.tree_models[tree.model - 1].name for tree in scene.trees]),
            "roadside": _counted([item.kind for name, items in scene.roadside if name != "signals" for item in items]),
            **({"traffic elements": _elements(labels.traffic_elements)} if labels.traffic_elements else {}),
        },
        "paint": {
            "dots"
            if scene.markings.dots
            else "dashes": f"{scene.markings.dash_cycle_m * scene.markings.dash_fraction:.2f} m painted every "
            f"{scene.markings.dash_cycle_m:.2f} m",
            "width": f"{100 * scene.markings.width_m:.1f} cm",
            "gray, gloss": f"{scene.markings.grayscale:.2f}, {scene.markings.gloss:.2f}",
            "inner line"
            if scene.roads.n_oncoming
            else "leftmost line": f"{'double' if scene.markings.left_double else 'single'}, "
            f"{'yellow' if scene.markings.left_yellow else 'white'}",
            "rubbed off, missing": f"{100 * scene.markings.wear:.0f} %, {100 * scene.markings.missing:.0f} %",
            "symbols": _counted([*(at.kind for at in scene.symbols), *(at.kind for at in scene.roads.paint)]),
        },
        "surface": {
            "road": f"texture {scene.surface.road_texture}, scale {scene.surface.road_texture_scale:.1f}, "
            f"gloss {scene.surface.road_gloss:.2f}, wetness {scene.surface.wetness:.2f}",
            "terrain": f"texture {scene.surface.terrain_texture}, scale {scene.surface.terrain_texture_scale:.1f}, "
            f"turned {math.degrees(scene.surface.texture_orientation_rad):.0f}°",
        },
    }


def _elements(items: Sequence[ObjectLabel]) -> str:
    """What the labelled signals show and signs say."""
    return _counted([f"{item.category} {item.state or item.kind}".replace("_", " ") for item in items])


def _changed(part: DocumentPart, besides: tuple[str, ...]) -> Facts:
    """The values of a part of a scene that are not those of scenes without them; `besides` are told in other words."""
    defaults = {name: field.default for name, field in type(part).model_fields.items() if name not in besides}
    values = {name: getattr(part, name) for name, default in defaults.items() if getattr(part, name) != default}
    return {name.replace("_", " "): f"{value:.4g}" for name, value in values.items()}


def _weather(scene: Scene) -> Facts:
    weather, host = scene.weather, scene.host
    shares = {"rain": weather.rain, "snowfall": weather.snowfall}
    shares |= {"snow on the ground": weather.snow, "snow on the road": weather.snow_on_road}
    falls = [f"{name} {100 * share:.0f} %" for name, share in shares.items() if share]
    return {
        "drawn as": f"{weather.kind}, {weather.daytime}",
        "rain and snow": ", ".join(falls) or "none",
        "headlights": "on" if weather.headlights else "off",
        "host's bonnet": f"{100 * host.bonnet:.0f} % of the image's height" if host.bonnet else "not seen",
    }


def lane_row(lane: Lane) -> tuple[str, ...]:
    """A lane's row in `LANE_COLUMNS`. Four counts of points: all; in the image; of these, not hidden by the ground; of
    these, not hidden by an object ("-" before rendering). Then the farthest visible distance."""
    objects = "-" if lane.object_visible is None else str(int(lane.visible.sum()))
    reach = f"{lane.xyz_cam[lane.visible, 1].max():.0f} m" if lane.visible.any() else "-"
    in_image, over_ground = int(lane.in_image.sum()), int((lane.in_image & lane.terrain_visible).sum())
    counts = (str(len(lane.xyz_cam)), str(in_image), str(over_ground), objects, reach)
    return (lane.id, lane.kind, lane.road, lane.marking, *counts)


class ObjectTable(NamedTuple):
    """A list of labels as a table; columns from `numbers_from` on are numbers."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]]
    numbers_from: int


def object_tables(labels: Labels) -> list[ObjectTable]:
    """The objects and the traffic elements, a table each where there are any."""
    objects = [object_row(item) for item in labels.objects or ()]
    elements = [element_row(item) for item in labels.traffic_elements or ()]
    tables = (
        ObjectTable("objects", OBJECT_COLUMNS, objects, 2),
        ObjectTable("traffic elements", ELEMENT_COLUMNS, elements, 4),
    )
    return [table for table in tables if table.rows]


def object_row(item: ObjectLabel) -> tuple[str, ...]:
    """An object's row in `OBJECT_COLUMNS`; "-" for what is not known."""
    speed = "-" if item.velocity_cam is None else f"{3.6 * np.linalg.norm(item.velocity_cam):.0f} km/h"
    points = "-" if item.lidar_points is None else str(item.lidar_points)
    places = (", ".join(f"{value:.2f}" for value in values) for values in (item.center_cam, item.size_m))
    return (
        str(item.id),
        item.category,
        *places,
        speed,
        _percent(item.visible_fraction),
        _percent(item.truncation),
        points,
    )


def element_row(item: ObjectLabel) -> tuple[str, ...]:
    """A traffic element's row in `ELEMENT_COLUMNS`; "-" for what is not known."""
    center, size = (", ".join(f"{value:.2f}" for value in values) for values in (item.center_cam, item.size_m[[0, 2]]))
    category = item.category.replace("_", " ")
    lanes = ", ".join(item.lanes) or "-"
    return (str(item.id), category, shows(item), lanes, center, size, _percent(item.visible_fraction))


def shows(item: ObjectLabel) -> str:
    """What a traffic element shows, in words."""
    return f"{item.kind}: {item.state}".removesuffix(": None").replace("_", " ")


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f} %"


def scene_document(shown: ShownScene) -> dict[str, Any]:
    """The lanes of a scene and its summary in words, for JSON."""
    return {"lanes": [lane_document(lane) for lane in shown.labels.lanes], "summary": describe(shown)}


def lane_document(lane: Lane) -> dict[str, Any]:
    """A lane's row for JSON, with numbers as such; None for what is not known before rendering."""
    in_image, seen = lane.in_image, lane.visible
    return {
        **{"id": lane.id, "kind": lane.kind, "road": lane.road, "marking": lane.marking},
        "n_points": len(lane.xyz_cam),
        "n_in_image": int(in_image.sum()),
        "n_over_ground": int((in_image & lane.terrain_visible).sum()),
        "n_visible": None if lane.object_visible is None else int(seen.sum()),
        "seen_to_m": round(float(lane.xyz_cam[seen, 1].max()), 3) if seen.any() else None,
    }


def heights_over_road_plane(labels: Labels) -> tuple[float, float]:
    """The least and the greatest height of a lane point over the plane of the road at the host."""
    points_cam = np.concatenate([np.zeros((0, 3)), *(lane.xyz_cam for lane in labels.lanes)])
    if not len(points_cam):
        return 0.0, 0.0
    heights_m = transform(labels.camera.road_from_cam, points_cam)[:, 2]
    return round(float(heights_m.min()), 3) + 0.0, round(float(heights_m.max()), 3) + 0.0


def _road(scene: Scene, labels: Labels) -> Facts:
    facts, start_m = dict(scene.roads.facts), labels.graph.ramp_start_s_m
    if "ramp" in facts:
        is_used = start_m is not None
        facts["ramp"] = f"{facts['ramp']} from y = {start_m:.0f} m" if is_used else "unused: the roads part too late"
    connectors = [lane.connector for lane in labels.lanes if lane.connector is not None]
    return facts | ({"connectors in range": str(sum(connectors))} if connectors else {})


def _shape(labels: Labels) -> Facts:
    centerlines = [lane for lane in labels.lanes if lane.kind == "centerline"]
    bend = _extreme([bends(lane, labels) for lane in centerlines])
    grade = _extreme([grades(lane, labels) for lane in centerlines])
    low_m, high_m = heights_over_road_plane(labels)
    radius = f"{1 / abs(bend):.0f} m to the {'right' if bend > 0 else 'left'}" if abs(bend) > 1e-4 else "straight"
    return {
        "sharpest bend": radius,
        "steepest grade": f"{100 * abs(grade):.1f} % {'up' if grade > 0 else 'down'}",
        "lanes over the road plane": f"{low_m:+.1f} to {high_m:+.1f} m",
    }


def _extreme(values: list[Float[np.ndarray, " _"]]) -> float:
    """The value farthest from 0; 0 if there is none."""
    return float(max(np.concatenate([np.zeros(0), *values]), key=abs, default=0.0))


def _place(scene: Scene) -> Facts:
    """Where the host is, and which of its pictures this is."""
    camera, shot, facts = scene.camera, scene.shot, Facts()
    side = "right" if camera.offset_m > 0 else "left"
    if shot.n_cameras > 1:
        facts["camera"] = f"{camera.name}, number {shot.camera} of 0 to {shot.n_cameras - 1}, {_mount(camera)}"
    if shot.views is not None:
        facts["view"] = f"{shot.view} of 0 to {shot.n_views - 1} of its world"
    if shot.n_frames > 1:
        facts["frame"] = (
            f"{shot.frame} of 0 to {shot.n_frames - 1}, {shot.time_s:.2f} s and {host_driven(shot, shot.time_s):.1f} m "
            f"from the clip's start, at {3.6 * host_speed(shot, shot.time_s):.0f} km/h"
        )
    at = f"lane {camera.lane} at y = {camera.y_m:.1f} m, {abs(camera.offset_m):.2f} m {side} of its centre"
    return {**facts, f"place{' at the start' * (shot.n_frames > 1)}": at}


def _camera(shown: ShownScene) -> Facts:
    labels, shot = shown.labels, shown.shot
    camera, k = labels.camera, labels.camera.img_from_cam
    if shown.scene is not None:
        place = _place(shown.scene)
    else:
        place = {"frame": f"{shot.frame} of 0 to {shot.n_frames - 1}"} if shot.n_frames > 1 else {}
    return {
        **place,
        "height, pitch, roll": f"{camera.height_m:.3f} m, {_turn('pitch', camera.pitch_rad, 'down', 'up')}, "
        f"{_turn('roll', camera.roll_rad, 'clockwise', 'counter-clockwise')}"
        + (f", turned {_turn('yaw', camera.yaw_rad, 'to the left', 'to the right')}" if camera.yaw_rad else ""),
        "image": f"{camera.width_px} x {camera.height_px} px, "
        f"{math.degrees(width_rad(k, camera.lens, camera.width_px)):.0f}° wide (fx = {k[0, 0]:.1f}), "
        f"centre at ({k[0, 1]:.1f}, {k[1, 1]:.1f}){_lens(camera.lens)}",
        "lanes in labels": _counted([_sort_of(lane) for lane in labels.lanes]),
    }


def _turn(name: str, angle_rad: float, positive: str, negative: str) -> str:
    """An angle in words, such as "0.93° counter-clockwise" or "no roll"."""
    angle_deg = round(math.degrees(angle_rad), 2)
    return f"{abs(angle_deg):.2f}° {positive if angle_deg > 0 else negative}" if angle_deg else f"no {name}"


def _mount(camera: HostCamera) -> str:
    aside, along = camera.right_m, camera.forward_m
    sides = "right of" if aside > 0 else "left of", "ahead of" if along > 0 else "behind"
    return f"{abs(aside):.2f} m {sides[0]} and {abs(along):.2f} m {sides[1]} the host's middle"


def _lens(lens: Lens) -> str:
    if lens.is_pinhole:
        return ""
    return f"; {lens.model} lens, " + " ".join(f"{name} {value:g}" for name, value in lens.named.items() if value)


def _sort_of(lane: Lane) -> str:
    """What a line of the labels is: by its road, or on a map by its direction."""
    if lane.connector is None:
        return f"{lane.kind} {lane.road}"
    return "connector" if lane.connector else f"{lane.kind} {lane.direction}"


def _counted(names: list[str]) -> str:
    counts = ", ".join(f"{count} {name}" for name, count in sorted(Counter(names).items()))
    return f"{len(names)}: {counts}" if names else "none"


_BASELINE_POINTS = 5


def grades(lane: Lane, labels: Labels) -> Float[np.ndarray, " n"]:
    """Rise over run along the lane, relative to true vertical; up is positive. Empty for a lane that is too short."""
    steps = _steps_world(lane, labels)
    return np.asarray(steps[:, 2] / np.hypot(steps[:, 0], steps[:, 1]))


def bends(lane: Lane, labels: Labels) -> Float[np.ndarray, " n"]:
    """Curvature seen from above in 1/m; to the right is positive. Empty for a lane that is too short."""
    steps = _steps_world(lane, labels)
    headings = np.unwrap(np.arctan2(steps[:, 0], steps[:, 1]))
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    return np.asarray(2 * np.diff(headings) / (lengths[1:] + lengths[:-1]))


def _steps_world(lane: Lane, labels: Labels) -> Float[np.ndarray, "n 3"]:
    return np.diff(transform(labels.camera.world_from_cam, lane.xyz_cam)[::_BASELINE_POINTS], axis=0)
