"""The columns of a shard's index: the bytes of each sample, the parameters of its scene, a summary of its labels.

Columns have the names of `scene.json`; columns of markings and of the camera begin with `marking_` and `camera_`. So a
query reads `flip_lateral and n_lanes = 4`, or `junction = 'merge' and max_grade > 0.1`.
"""

import json
from collections import Counter
from typing import Any, Literal, get_args, get_origin

import numpy as np
import pyarrow as pa
import pyarrow.json as pj
from pydantic import BaseModel

from synth3dlanes.dataset.format import COLUMN_OF_MEMBER, LIDAR
from synth3dlanes.dataset.index import ADDED, ADDED_SCHEMA, ARROW_TYPES, RECIPE, SHOT_COLUMNS, place_columns
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.scene.scene import Air, Light, Markings, PaperRoad, Scene, Sensor, Surface, Weather
from synth3dlanes.scene.things import ThingKind
from synth3dlanes.scene.works import RoadWorks, WorksKind

PREFIXES = {"markings": "marking_", "camera": "camera_", "weather": "weather_", "host": "host_"}
PARTS: dict[str, type[BaseModel]] = {
    "road": PaperRoad,
    "markings": Markings,
    "surface": Surface,
    "camera": HostCamera,
    "light": Light,
    "air": Air,
    "sensor": Sensor,
}
ADDED_PARTS = ("weather", "host", "vegetation")
NAMED_PARTS: dict[str, type[BaseModel]] = {**PARTS, "weather": Weather}
ROADSIDE = ("rails", "posts", "crossings", "buildings")
PLACE_COLUMNS = list(dict.fromkeys(place_columns([name for name in COLUMN_OF_MEMBER if name != LIDAR])))


SCHEMA = pa.schema(
    [("key", pa.string()), ("index", pa.int64()), ("sha256", pa.string())]
    + [(name, pa.int64()) for name in PLACE_COLUMNS]
    + [(name, pa.int64()) for name in ("n_gaussians", "n_cars", "n_trees")]
    + [
        (PREFIXES.get(group, "") + name, ARROW_TYPES[field.annotation])
        for group, part in PARTS.items()
        for name, field in part.model_fields.items()
        if field.annotation in ARROW_TYPES and PREFIXES.get(group, "") + name not in ADDED
    ]
    + [("junction", pa.string()), ("exit_side", pa.string()), ("ramp_used", pa.bool_()), ("max_grade", pa.float64())]
    + [(f"n_{seen}{kind}", pa.int64()) for kind in ("centerlines", "delimiters") for seen in ("", "visible_")]
    + [("terrain_hidden_fraction", pa.float64()), ("object_hidden_fraction", pa.float64())]
)
# The texts that these columns may hold. Names of cameras are the user's.
TEXTS: dict[str, tuple[str, ...]] = {
    PREFIXES.get(group, "") + name: get_args(field.annotation)
    for group, part in NAMED_PARTS.items()
    for name, field in part.model_fields.items()
    if get_origin(field.annotation) is Literal
} | {
    "junction": ("none", "split", "merge", "crossing"),
    "exit_side": ("none", "left", "right"),
    "works": get_args(WorksKind),
    "works_lines": ("none", *get_args(RoadWorks.model_fields["lines"].annotation)),
}
# Only where scenes have several pictures or a lidar, so that the shards of other data sets keep their columns.
SHOT_SCHEMA = pa.schema([(name, pa.int64()) for name in SHOT_COLUMNS])
LIDAR_SCHEMA = pa.schema([(name, pa.int64()) for name in place_columns([LIDAR])])


def index_row(
    key: str,
    places: dict[str, tuple[int, int]],
    sha256: str,
    scene: Scene | None,
    labels: Labels,
    numbers: tuple[int, int, int] | None = None,
) -> dict[str, Any]:
    """One row of the index. `places` maps the name of each member to its offset and size in the tar. `sha256` is the
    digest of all bytes of the sample in the tar, from its first header to its last block. `numbers` are the numbers of
    the clip, the frame and the camera, for a sample without a scene."""
    row: dict[str, Any] = {"key": key, "index": int(key), "sha256": sha256}
    if scene is not None and scene.shot.n_frames * scene.shot.n_cameras * scene.shot.n_views > 1:
        # Views of a world are counted as frames are.
        numbers = scene.index, scene.shot.frame + scene.shot.view, scene.shot.camera
    row |= dict(zip(SHOT_COLUMNS, numbers, strict=True)) if numbers else {}
    for member, (offset, size) in places.items():
        column = COLUMN_OF_MEMBER[member]
        row |= {f"{column}_offset": offset, f"{column}_size": size}
    return row | numbers_of(scene, labels)


def numbers_of(scene: Scene | None, labels: Labels) -> dict[str, Any]:
    """The columns that follow from a scene and its labels alone, wherever these are stored; without a scene, the
    columns of the camera and the lanes."""
    if scene is None:
        camera, k = labels.camera, labels.camera.img_from_cam
        known = {
            name: value for name, value in vars(camera).items() if name in HostCamera.model_fields and name != "lens"
        }
        known |= {"fx_px": float(k[0, 0]), "fy_px": -float(k[1, 2]), "cx_px": float(k[0, 1]), "cy_px": float(k[1, 1])}
        return {PREFIXES["camera"] + name: value for name, value in known.items()} | _summary(labels)
    row = {"n_gaussians": len(scene.terrain.gaussians), "n_cars": len(scene.cars), "n_trees": len(scene.trees)}
    for group in (*PARTS, *ADDED_PARTS):
        prefix = PREFIXES.get(group, "")
        part = getattr(scene, group)
        row |= {prefix + name: value for name, value in (vars(part) if part else {}).items() if name != "lens"}
    row |= {"n_symbols": len(labels.symbols)} | {f"n_{name}": len(getattr(scene.roadside, name)) for name in ROADSIDE}
    row |= {"n_traffic_elements": len(labels.traffic_elements or ())}
    counts = Counter(thing.kind for thing in scene.things)
    row |= {f"n_{kind}s": counts[kind] for kind in get_args(ThingKind)}
    works = scene.roads.works
    named = (works.kind, works.lines) if works is not None else ("none", "none")
    return row | dict(zip(("works", "works_lines"), named, strict=True)) | _topology(scene, labels) | _summary(labels)


def table(rows: list[dict[str, Any]], recipe: str = "") -> pa.Table:
    """The index of a shard. All shards of a data set have the same columns. `recipe` is the recipe of the rows, "" if
    unknown."""
    added = [SHOT_SCHEMA] if rows and "scene" in rows[0] else []
    added += [LIDAR_SCHEMA] if rows and LIDAR_SCHEMA.names[0] in rows[0] else []
    schema = pa.unify_schemas([SCHEMA, *added, ADDED_SCHEMA])
    schema = schema.with_metadata({RECIPE: recipe}) if recipe else schema
    if not rows:
        return schema.empty_table()
    # As JSON, because Table.from_pylist imports pandas wherever it is installed: a second, for nothing.
    lines = "\n".join(map(json.dumps, rows)).encode()
    wanted = pj.ParseOptions(explicit_schema=schema, unexpected_field_behavior="ignore")
    return pj.read_json(pa.BufferReader(lines), parse_options=wanted).cast(schema).combine_chunks()


def _topology(scene: Scene, labels: Labels) -> dict[str, Any]:
    roads, is_crossing = scene.roads, any(lane.connector for lane in labels.lanes)
    junction = roads.junction_kind if not is_crossing else "crossing"
    return {"junction": junction, "exit_side": roads.exit_side, "ramp_used": labels.graph.ramp_start_s_m is not None}


def _summary(labels: Labels) -> dict[str, Any]:
    in_image = np.concatenate([lane.in_image for lane in labels.lanes] or [np.zeros(0, bool)])
    terrain_visible = np.concatenate([lane.terrain_visible for lane in labels.lanes] or [np.zeros(0, bool)])
    visible = np.concatenate([lane.visible for lane in labels.lanes] or [np.zeros(0, bool)])
    count = max(int(in_image.sum()), 1)
    over_ground = in_image & terrain_visible
    summary: dict[str, Any] = {
        "max_grade": max_grade(labels),
        "terrain_hidden_fraction": int((in_image & ~terrain_visible).sum()) / count,
        "object_hidden_fraction": int((over_ground & ~visible).sum()) / count,
    }
    for kind in ("centerline", "delimiter"):
        lanes = [lane for lane in labels.lanes if lane.kind == kind]
        summary[f"n_{kind}s"] = len(lanes)
        summary[f"n_visible_{kind}s"] = sum(bool(lane.visible.any()) for lane in lanes)
    return summary


def max_grade(labels: Labels) -> float:
    """The steepest grade (rise over run, up or down) of the main road's centre lines ahead, on a map of all;
    0.1 is 10 %."""
    rotation = labels.camera.world_from_cam[:3, :3]

    def steepest(lane: Lane) -> float:
        steps_world = np.diff(lane.xyz_cam, axis=0) @ rotation.T
        runs_m = np.hypot(steps_world[:, 0], steps_world[:, 1])
        steps_world, runs_m = steps_world[runs_m > 0], runs_m[runs_m > 0]
        return float(np.abs(steps_world[:, 2] / runs_m).max(initial=0.0))

    main = [
        steepest(lane)
        for lane in labels.lanes
        if lane.kind == "centerline" and (lane.road == "main" or lane.connector is not None)
    ]
    return round(max(main, default=0.0), 4)
