"""Check instance ids, or else semantic ids, against the scene: paint must lie on its line, pixels of cars, trees
and structures in their bodies, and the visible share of each car must fit its label.

Pixels are unprojected into the scene by their depth.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from scipy.spatial import ConvexHull, cKDTree

from synth3dlanes.frames import invert, transform
from synth3dlanes.geometry.solids import SURFACES
from synth3dlanes.geometry.terrain import gradient_at, height_at
from synth3dlanes.labels import CameraLabel, Labels
from synth3dlanes.settings import (
    FIRST_CAR_ID,
    FIRST_DELIMITER_ID,
    FIRST_STRUCTURE_ID,
    FIRST_SYMBOL_ID,
    FIRST_TREE_ID,
    HOST_ID,
    SEMANTIC_IDS,
)
from synth3dlanes.validate import boxes
from synth3dlanes.validate.findings import PROOF_M, Finding, Measure
from synth3dlanes.validate.paint import Paint
from synth3dlanes.validate.passes_proof import Passes
from synth3dlanes.validate.pavement import unproject
from synth3dlanes.validate.places import places
from synth3dlanes.world import World

# At most this many pixels of a kind are used, evenly spread over the image.
MAX_PIXELS = 10_000
# Number of pixels, and share of a body's pixels, that may be wrong: with a wrong id nearly all of them are.
MAX_SINGLE, MAX_SHARE = 3, 0.05
# Share of a line's paint pixels that may lie more than MAX_BEYOND_M outside its edges. Only pixels whose paint floats
# at most MAX_FLOAT_M over the road, along the line of sight, are used; in 60 random scenes of each preset none is
# outside.
MAX_BEYOND_M, MAX_FLOAT_M, MAX_SHARE_BEYOND = 0.01, 0.05, 0.02
# Margins: cars fit their nominal boxes to 1 %; twigs reach 10 % beyond a tree's.
CAR_ROOM, TREE_ROOM = 1.05, 1.15
# Share of a car's projected bounding box that the car fills: 0.52 to 0.93 for all built-in cars; up to 1 for a user's.
FILL, OWN_FILL = (0.5, 0.95), (0.2, 1.0)
# Labels measure shares with about 60 rays, passes with pixel centres; the worst of 2,300 cars differs by 0.16.
MAX_SHARE_OFF, SLACK_PX = 0.25, 6
# A car with a corner nearer than this is too close for an estimate from its box.
MIN_CORNER_M = 0.5
# So are those that reach farther aside than this cosine of the angle from the viewing axis: pixels there are stretched.
WIDE = 0.4

# All structures count as one kind here, the first of SURFACES.
STRUCTURE, STRUCTURES = SURFACES[0], [SEMANTIC_IDS[name] for name in SURFACES]
# First instance id, semantic name and what to call it, by instance id.
KINDS = (
    (FIRST_CAR_ID, "car", "car"),
    (FIRST_DELIMITER_ID, "marking", "marking"),
    (FIRST_TREE_ID, "tree", "tree"),
    (FIRST_STRUCTURE_ID, STRUCTURE, "structure"),
    (FIRST_SYMBOL_ID, "symbol", "symbol"),
    (HOST_ID, "host", "host"),
)

Values = Float[np.ndarray, " n"]
Points = Float[np.ndarray, "n 3"]
Ids = Integer[np.ndarray, "h w"]


def prove_ids(paint: Paint, labels: Labels, passes: Passes) -> tuple[list[Finding], list[Measure]]:
    """Findings about ids, and measure `beyond_paint_m`: how far pixels of paint lie outside the scene's paint."""
    world = paint.world
    findings: list[Finding] = []
    measures: list[Measure] = []
    if {"semantic", "instance"} <= set(passes):
        findings += _agreement(passes["semantic"], passes["instance"])
    if "instance" in passes:
        findings += _shares(world, labels, passes["instance"])
    if "depth" in passes and {"semantic", "instance"} & set(passes):
        found, measure = _paint(paint, labels, passes)
        findings += [*found, *_bodies(world, labels.camera, passes)]
        measures.append(measure)
    return findings, measures


def _kind(instance: Ids) -> Ids:
    """Kinds that follow from instance ids; 0 for pixels without one."""
    kinds = np.array([0, *(SEMANTIC_IDS[name] for _, name, _ in KINDS)], dtype=np.uint8)
    return kinds[np.searchsorted([first for first, _, _ in KINDS], instance, side="right")]


def _folded(semantic: Ids) -> Ids:
    """Semantic ids with those of all structures as one kind."""
    return np.where(np.isin(semantic, STRUCTURES), SEMANTIC_IDS[STRUCTURE], semantic)


def _agreement(semantic: Ids, instance: Ids) -> Iterator[Finding]:
    """Findings where semantic and instance ids disagree about the kind of object."""
    kind, semantic = _kind(instance), _folded(semantic)
    for _, name, thing in KINDS:
        is_semantic, is_instance = semantic == SEMANTIC_IDS[name], kind == SEMANTIC_IDS[name]
        wrong = int((is_semantic != is_instance).sum())
        if wrong > MAX_SINGLE:
            yield Finding(
                "",
                f"instance: expected ids of the kind {thing} at the {is_semantic.sum()} pixels of this kind in "
                f"semantic, got them at {(is_semantic & is_instance).sum()} of these and at "
                f"{(is_instance & ~is_semantic).sum()} others",
            )


def _paint(paint: Paint, labels: Labels, passes: Passes) -> tuple[list[Finding], Measure]:
    """Compare pixels of paint with the scene's paint of their line, or of any line without instance ids."""
    world, camera = paint.world, labels.camera
    name = "instance" if "instance" in passes else "semantic"
    kind = _kind(passes["instance"]) if name == "instance" else passes["semantic"]
    rows, columns = some_pixels((kind == SEMANTIC_IDS["marking"]) & np.isfinite(passes["depth"]))
    points_cam = unproject(camera, passes["depth"], rows, columns)
    points, used = on_road(world, camera, points_cam)
    used &= points_cam[:, 1] < PROOF_M
    points, rows, columns, y_m = points[used], rows[used], columns[used], points_cam[used, 1]
    place = places(world.ground, points[:, :2])
    labelled = [lane.id for lane in labels.lanes if lane.kind == "delimiter"]
    ids = [*labelled, *(id_ for id_ in paint.ids if id_ not in labelled)]
    beyond_m = np.full(len(points), np.inf)
    number = passes[name][rows, columns].astype(int) - FIRST_DELIMITER_ID
    for i, id_ in enumerate(ids):
        own = number == i if name == "instance" else np.ones(len(points), dtype=bool)
        beyond_m[own] = np.minimum(beyond_m[own], paint.beyond_m(id_, place.at(own)))
    findings = []
    for i, id_ in enumerate([*labelled, ""] if name == "instance" else [""]):
        own = number == i if id_ else (number < 0) | (number >= len(labelled))
        wrong = beyond_m[own] > MAX_BEYOND_M
        if wrong.sum() > max(MAX_SINGLE, MAX_SHARE_BEYOND * len(wrong)):
            outside = f"{wrong.sum()} of {len(wrong)} pixels up to {min(beyond_m[own].max(), 99):.2f} m outside"
            findings.append(Finding(id_, f"{name}: expected paint where the line is painted, got {outside}"))
    return findings, Measure("beyond_paint_m", y_m, np.clip(beyond_m, 0, 99))


def on_road(world: World, camera: CameraLabel, points_cam: Points) -> tuple[Points, Bool[np.ndarray, " n"]]:
    """Move points that float over the road along the line of sight onto it; also return where this is reliable."""
    terrain, points = world.scene.terrain, transform(camera.world_from_cam, points_cam)
    place = places(world.ground, points[:, :2])
    sight = points - camera.world_from_cam[:3, 3]
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    falls = (sight[:, :2] * gradient_at(terrain, points[:, :2])).sum(axis=1) - sight[:, 2]
    over_m = points[:, 2] - height_at(terrain, points[:, :2]) - place.raised()
    with np.errstate(divide="ignore", invalid="ignore"):
        way_m = np.clip(np.where(falls > 0, over_m / falls, np.inf), -1, 1)
    return points + way_m[:, None] * sight, (np.abs(way_m) < MAX_FLOAT_M) & ~place.on_slope()


def _bodies(world: World, camera: CameraLabel, passes: Passes) -> Iterator[Finding]:
    """Compare pixels of cars, trees and structures with their bodies, or with all bodies without instance ids."""
    kind = _kind(passes["instance"]) if "instance" in passes else _folded(passes["semantic"])
    name = "instance" if "instance" in passes else "semantic"
    things = (
        ("car", "car", FIRST_CAR_ID, _in_car),
        ("tree", "tree", FIRST_TREE_ID, _in_tree),
        (STRUCTURE, "structure", FIRST_STRUCTURE_ID, _in_structure),
    )
    for key, thing, first, inside in things:
        rows, columns = some_pixels((kind == SEMANTIC_IDS[key]) & np.isfinite(passes["depth"]))
        points = transform(camera.world_from_cam, unproject(camera, passes["depth"], rows, columns))
        own = passes[name][rows, columns].astype(int) - first if name == "instance" else np.full(len(rows), -1)
        wrong = ~inside(world, points, own)
        for i in np.unique(own[wrong]):
            n, n_wrong = int((own == i).sum()), int(wrong[own == i].sum())
            if n_wrong > max(MAX_SINGLE, MAX_SHARE * n):
                whose = f"{thing} {i}" if i >= 0 else f"a {thing}"
                yield Finding("", f"{name}: expected pixels of {whose} within its body, got {n_wrong} of {n} outside")


def _in_car(world: World, points: Points, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which points are in the box of car `own`, -1 for any car."""
    inside = np.zeros(len(points), dtype=bool)
    for i, (car, pose) in enumerate(zip(world.scene.cars, world.view.world_from_cars, strict=True)):
        at = np.flatnonzero((own == i) | (own < 0))
        if at.size:
            low, high = _box(world, i)
            body = transform(invert(pose), points[at]) / car.scale
            inside[at] |= ((body > low) & (body < high)).all(axis=1)
    return inside


def _box(world: World, car: int) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """The bounding box of a car with its margin, at scale 1."""
    model = world.scene.assets.car_models[world.scene.cars[car].model - 1]
    half = np.array([model.width_m, model.length_m, 0.0]) / 2 * CAR_ROOM
    rest_m = (CAR_ROOM - 1) * model.height_m
    return -half - np.array([0, 0, rest_m]), half + np.array([0, 0, model.height_m + rest_m])


def _in_tree(world: World, points: Points, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which points are in the cylinder of tree `own`, -1 for the nearest tree."""
    trees = world.scene.trees
    if not trees:
        return np.zeros(len(points), dtype=bool)
    models = [world.scene.assets.tree_models[tree.model - 1] for tree in trees]
    radius, height = (
        np.array(
            [
                [model.crown_radius_m * tree.scale, model.height_m * tree.scale]
                for tree, model in zip(trees, models, strict=True)
            ]
        ).T
        * TREE_ROOM
    )
    if (own < 0).any():
        distance, _ = cKDTree(world.site.trees_world[:, :2]).query(points[:, :2])
        return np.asarray(distance < radius.max())
    known = own < len(trees)
    tree = np.where(known, own, 0)
    up = points - world.site.trees_world[tree]
    rest = (TREE_ROOM - 1) * height[tree]
    return known & (np.hypot(up[:, 0], up[:, 1]) < radius[tree]) & (up[:, 2] > -rest) & (up[:, 2] < height[tree])


def _in_structure(world: World, points: Points, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which points are in a box of structure `own`, -1 for any."""
    return boxes.inside(boxes.structure_boxes(world), points, own)


def _shares(world: World, labels: Labels, instance: Ids) -> Iterator[Finding]:
    """Compare the visible share of each car with its number of pixels."""
    assert labels.car_visible_fraction is not None
    counts = np.bincount(instance.ravel(), minlength=FIRST_DELIMITER_ID)[FIRST_CAR_ID:]
    for i, share in enumerate(labels.car_visible_fraction):
        low, high = _seen_share(world, labels.camera, i, int(counts[i]))
        if not low - MAX_SHARE_OFF <= share <= high + MAX_SHARE_OFF:
            yield Finding(
                "",
                f"car_visible_fraction: expected {low:.2f} to {high:.2f} of car {i} by its {counts[i]} pixels, "
                f"got {share:.2f}",
            )


def _seen_share(world: World, camera: CameraLabel, car: int, n_px: int) -> tuple[float, float]:
    """Limits of the visible share of a car's silhouette, from its number of pixels and its box in the image."""
    low, high = (corner / CAR_ROOM * world.scene.cars[car].scale for corner in _box(world, car))
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    corners_cam = transform(invert(camera.world_from_cam), transform(world.view.world_from_cars[car], corners))
    is_wide = corners_cam[:, 1] < WIDE * np.linalg.norm(corners_cam, axis=1)
    uv = camera.project(corners_cam)
    if corners_cam[:, 1].min() < MIN_CORNER_M or is_wide.any() or np.isnan(uv).any():
        return 0.0, float(n_px > 0)
    box_px = float(ConvexHull(uv).volume)
    least, most = OWN_FILL if world.scene.assets.cars else FILL
    return max(n_px - SLACK_PX, 0) / (most * box_px), min((n_px + SLACK_PX) / (least * box_px), 1.0)


def some_pixels(of: Bool[np.ndarray, "h w"]) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Rows and columns of at most MAX_PIXELS of the selected pixels."""
    rows, columns = np.nonzero(of)
    step = 1 + len(rows) // MAX_PIXELS
    return rows[::step], columns[::step]
