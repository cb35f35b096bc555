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
from synth3dlanes.labels import CameraLabel
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
from synth3dlanes.validate.bodies import ahead, covers
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Bounded, Finding, Measure, Result
from synth3dlanes.validate.pixels import some_pixels
from synth3dlanes.validate.places import on_road, places
from synth3dlanes.world import World

# Number of pixels, and share of a body's pixels, that may be wrong: with a wrong id nearly all of them are.
MAX_SINGLE, MAX_SHARE = 3, 0.05
# Share of a line's paint pixels that may lie more than MAX_BEYOND_M outside its edges; in 60 random scenes of each
# preset none does.
MAX_BEYOND_M, MAX_SHARE_BEYOND, MIN_OF_LINE = 0.01, 0.02, 150
# Margins: cars fit their nominal boxes to 1 %, but for mirrors; twigs reach 10 % beyond a tree's.
CAR_ROOM, MIRROR_ROOM, TREE_ROOM = 1.05, 1.2, 1.15
# Room around the box of a structure's faces of one kind, for depth far away.
FACE_M = 0.1
# Of the image's height that the bonnet fills.
MAX_BONNET = 0.03
# Share of a car's projected bounding box that the car fills: 0.52 to 0.93 for all built-in cars; up to 1 for a user's.
FILL, OWN_FILL = (0.5, 0.95), (0.2, 1.0)
# Labels measure shares with at least so many rays, passes with pixel centres.
RAYS, SIGMAS, MAX_SHARE_OFF, SLACK_PX, EDGE_PX = 60, 4.0, 0.03, 6, 1.0
# Boxes that reach farther aside than this cosine of the angle from the viewing axis say less: pixels are stretched.
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


def check_ids(evidence: Evidence) -> Iterator[Result]:
    """Findings about ids, and measure `beyond_paint_m`: how far pixels of paint lie outside the scene's paint."""
    passes = evidence.passes
    if {"semantic", "instance"} <= set(passes):
        yield from disagreement("instance", passes["semantic"], passes["instance"])
    if "instance" in passes:
        yield from _shares(evidence)
    if {"depth", "semantic", "instance"} <= set(passes):
        yield from _surfaces(evidence)
    if "depth" in passes and {"semantic", "instance"} & set(passes):
        yield from _paint(evidence)
        yield from _bodies(evidence)


def kind_of(instance: Integer[np.ndarray, "*n"]) -> Integer[np.ndarray, "*n"]:
    """Kinds that follow from instance ids; 0 for pixels without one."""
    kinds = np.array([0, *(SEMANTIC_IDS[name] for _, name, _ in KINDS)], dtype=np.uint8)
    return kinds[np.searchsorted([first for first, _, _ in KINDS], instance, side="right")]


def _folded(semantic: Integer[np.ndarray, "*n"]) -> Integer[np.ndarray, "*n"]:
    """Semantic ids with those of all structures as one kind."""
    return np.where(np.isin(semantic, STRUCTURES), SEMANTIC_IDS[STRUCTURE], semantic)


def is_of(name: str, ids: Integer[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
    """Which semantic ids are those of a name."""
    return np.asarray(ids == SEMANTIC_IDS[name])


def disagreement(
    source: str, semantic: Integer[np.ndarray, "*n"], instance: Integer[np.ndarray, "*n"]
) -> Iterator[Finding]:
    """Findings where semantic and instance ids disagree about the kind of object."""
    kind, semantic = kind_of(instance), _folded(semantic)
    wrong = {(int((is_of(name, semantic) != is_of(name, kind)).sum()), name, thing) for _, name, thing in KINDS}
    for n_wrong, name, thing in sorted(wrong, reverse=True):
        is_semantic, is_instance = is_of(name, semantic), is_of(name, kind)
        if n_wrong > MAX_SINGLE:
            yield Finding(
                "",
                f"{source}: expected ids of the kind {thing} at the {is_semantic.sum()} pixels of this kind in "
                f"semantic, got them at {(is_semantic & is_instance).sum()} of these and at "
                f"{(is_instance & ~is_semantic).sum()} others",
            )


def _paint(evidence: Evidence) -> Iterator[Result]:
    """Compare pixels of paint with the scene's paint of their line, or of any line without instance ids."""
    world, paint, passes = evidence.world, evidence.paint, evidence.passes
    name = "instance" if "instance" in passes else "semantic"
    kind = kind_of(passes["instance"]) if name == "instance" else passes["semantic"]
    rows, columns = some_pixels((kind == SEMANTIC_IDS["marking"]) & np.isfinite(passes["depth"]))
    points_cam = evidence.points_cam(rows, columns)
    points, used = on_road(world, evidence.camera, points_cam)
    used &= points_cam[:, 1] < PROOF_M
    points, rows, columns, y_m = points[used], rows[used], columns[used], points_cam[used, 1]
    place = places(world.ground, points[:, :2])
    labelled = [lane.id for lane in evidence.labels.lanes if lane.kind == "delimiter"]
    ids = [*labelled, *(id_ for id_ in paint.ids if id_ not in labelled)]
    beyond_m = np.full(len(points), np.inf)
    number = passes[name][rows, columns].astype(int) - FIRST_DELIMITER_ID
    for i, id_ in enumerate(ids):
        own = number == i if name == "instance" else np.ones(len(points), dtype=bool)
        beyond_m[own] = np.minimum(beyond_m[own], paint.beyond_m(id_, place.at(own)))
    for i, id_ in enumerate([*labelled, ""] if name == "instance" else [""]):
        own = number == i if id_ else (number < 0) | (number >= len(labelled))
        wrong = beyond_m[own] > MAX_BEYOND_M
        if len(wrong) >= MIN_OF_LINE:
            yield Bounded("ids.beyond_paint", float(wrong.mean()), most=MAX_SHARE_BEYOND)
        if wrong.sum() > max(MAX_SINGLE, MAX_SHARE_BEYOND * len(wrong)):
            outside = f"{wrong.sum()} of {len(wrong)} pixels up to {min(beyond_m[own].max(), 99):.2f} m outside"
            yield Finding(id_, f"{name}: expected paint where the line is painted, got {outside}")
    yield Measure("beyond_paint_m", y_m, np.clip(beyond_m, 0, 99))


def _bodies(evidence: Evidence) -> Iterator[Finding]:
    """Compare pixels of cars, trees and structures with their bodies, or with all bodies without instance ids."""
    passes = evidence.passes
    kind = kind_of(passes["instance"]) if "instance" in passes else _folded(passes["semantic"])
    name = "instance" if "instance" in passes else "semantic"
    for key in THINGS:
        rows, columns = some_pixels((kind == SEMANTIC_IDS[key]) & np.isfinite(passes["depth"]))
        numbers = passes[name][rows, columns].astype(int) if name == "instance" else None
        yield from outside_bodies(evidence, name, key, evidence.points_world(rows, columns), numbers)


def outside_bodies(
    evidence: Evidence, source: str, key: str, points_world: Points, ids: Int[np.ndarray, " n"] | None
) -> Iterator[Finding]:
    """Findings about points seen on cars, trees or structures (keys of THINGS) that are not in the body of their
    instance id, or of none."""
    thing, first, inside = THINGS[key]
    own = np.full(len(points_world), -1) if ids is None else ids - first
    wrong = ~inside(evidence, points_world, own)
    for i in np.unique(own[wrong]):
        n, n_wrong = int((own == i).sum()), int(wrong[own == i].sum())
        if n_wrong > max(MAX_SINGLE, MAX_SHARE * n):
            whose = f"{thing} {i}" if i >= 0 else f"a {thing}"
            what = "points" if source == "lidar" else "pixels"
            yield Finding("", f"{source}: expected {what} of {whose} within its body, got {n_wrong} of {n} outside")


def _in_car(evidence: Evidence, points: Points, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which points are in the box of car `own`, -1 for any car."""
    world, inside = evidence.world, np.zeros(len(points), dtype=bool)
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


def _in_tree(evidence: Evidence, points: Points, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which points are in the cylinder of tree `own`, -1 for the nearest tree."""
    world, trees = evidence.world, evidence.scene.trees
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
        distance, _ = cKDTree(world.trees_world[:, :2]).query(points[:, :2])
        return np.asarray(distance < radius.max())
    known = own < len(trees)
    tree = np.where(known, own, 0)
    up = points - world.trees_world[tree]
    rest = (TREE_ROOM - 1) * height[tree]
    return known & (np.hypot(up[:, 0], up[:, 1]) < radius[tree]) & (up[:, 2] > -rest) & (up[:, 2] < height[tree])


def _in_structure(evidence: Evidence, points: Points, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which points are in a box of structure `own`, -1 for any."""
    return boxes.inside(evidence.structures, points, own)


# What has a body: what to call it, its first instance id, and which points are in it.
THINGS = {
    "car": ("car", FIRST_CAR_ID, _in_car),
    "tree": ("tree", FIRST_TREE_ID, _in_tree),
    STRUCTURE: ("structure", FIRST_STRUCTURE_ID, _in_structure),
}


def check_bonnet(evidence: Evidence) -> Iterator[Result]:
    """Finding if the host's bonnet is not in the picture, or should not be."""
    share, middle = evidence.world.view.bonnet, evidence.camera.width_px // 2
    found = float(is_of("host", evidence.passes["semantic"][:, middle]).mean())
    yield Bounded("ids.bonnet", abs(found - share), most=MAX_BONNET)
    if abs(found - share) > MAX_BONNET:
        yield Finding(
            "", f"host: expected the bonnet in the lowest {100 * share:.0f} % of the picture, got {100 * found:.0f} %"
        )


def _surfaces(evidence: Evidence) -> Iterator[Finding]:
    """Compare the semantic ids of structures with the faces that these have: a pole's is not a sign's."""
    passes = evidence.passes
    rows, columns = some_pixels(np.isin(passes["semantic"], STRUCTURES) & np.isfinite(passes["depth"]))
    points, semantic = evidence.points_world(rows, columns), passes["semantic"][rows, columns]
    number = passes["instance"][rows, columns].astype(int) - FIRST_STRUCTURE_ID
    wrong = np.zeros(len(points), dtype=bool)
    for i in np.unique(number[(number >= 0) & (number < len(evidence.world.structures))]):
        body = evidence.world.structures[i]
        for name in SURFACES:
            at = np.flatnonzero((number == i) & is_of(name, semantic))
            corners = body.corners_world[body.surface == SURFACES.index(name)].reshape(-1, 3)
            if at.size and len(corners):
                low, high = corners.min(axis=0) - FACE_M, corners.max(axis=0) + FACE_M
                wrong[at] = ~((points[at] > low) & (points[at] < high)).all(axis=1)
            else:
                wrong[at] = True
    for name in SURFACES:
        n, n_wrong = int(is_of(name, semantic).sum()), int(wrong[is_of(name, semantic)].sum())
        if n_wrong > max(MAX_SINGLE, MAX_SHARE * n):
            yield Finding("", f"semantic: expected {name} on faces of {name}, got {n_wrong} of {n} pixels elsewhere")


def _shares(evidence: Evidence) -> Iterator[Result]:
    """Compare the visible share of each car with its number of pixels."""
    shares = evidence.labels.car_visible_fraction
    assert shares is not None
    counts = np.bincount(evidence.passes["instance"].ravel(), minlength=FIRST_DELIMITER_ID)[FIRST_CAR_ID:]
    for i, share in enumerate(shares):
        low, high = _seen_share(evidence, i, int(counts[i]))
        off, near = max(low - share, share - high, 0.0), low if share < low else high
        seen = Bounded("ids.seen_share", off, most=_error(near))
        yield seen
        if seen.is_beyond:
            yield Finding(
                "",
                f"car_visible_fraction: expected {low:.2f} to {high:.2f} of car {i} by its {counts[i]} pixels, "
                f"got {share:.2f}",
            )


def _seen_share(evidence: Evidence, car: int, n_px: int) -> tuple[float, float]:
    """Limits of the share of a car's pixels that is seen, from their number and the car's box in the image."""
    world, camera = evidence.world, evidence.camera
    low, high = (corner / CAR_ROOM * world.scene.cars[car].scale for corner in _box(world, car))
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    cam_from_car = invert(camera.world_from_cam) @ world.view.world_from_cars[car]
    corners_cam = transform(cam_from_car, corners)
    uv, outer = (camera.project(ahead(transform(cam_from_car, room * corners))) for room in (1.0, MIRROR_ROOM))
    if np.isnan(outer).any():
        # Out of the lens's field.
        return 0.0, 1.0
    if not _n_pixels(outer, camera):
        return 0.0, float(n_px > 0)
    box_px = _n_pixels(uv, camera)
    if not box_px:
        return 0.0, 1.0
    is_wide = corners_cam[:, 1] < WIDE * np.linalg.norm(corners_cam, axis=1)
    is_whole = ((uv > 0) & (uv < [camera.width_px, camera.height_px])).all() and not is_wide.any()
    least, most = OWN_FILL if world.scene.assets.cars else FILL
    if not is_whole:
        # It may show a sliver only, whose pixels are fewer than its rays.
        return max(n_px - SLACK_PX, 0) / box_px, 1.0
    hull_px = float(ConvexHull(uv).volume)
    return max(n_px - SLACK_PX, 0) / (most * box_px), min((n_px + SLACK_PX) / (least * hull_px), 1.0)


def _n_pixels(outline: Float[np.ndarray, "n 2"], camera: CameraLabel) -> int:
    """The number of the image's pixels whose centres, or whose neighbours', are inside the hull of an outline."""
    if not len(outline):
        return 0
    size = np.array([camera.width_px, camera.height_px])
    low, high = (np.clip(edge, 0, size).astype(int) for edge in (outline.min(axis=0) - 1, outline.max(axis=0) + 2))
    uv = np.stack(np.meshgrid(*(np.arange(*ends) for ends in zip(low, high, strict=True))), axis=-1).reshape(-1, 2)
    return int(covers(outline, uv + 0.5, EDGE_PX).sum())


def _error(share: float) -> float:
    """How far a label may be from this share: it is the mean of some rays that are seen or not."""
    share = min(max(share, 0.0), 1.0)
    return MAX_SHARE_OFF + SIGMAS * float(np.sqrt(share * (1 - share) / RAYS))
