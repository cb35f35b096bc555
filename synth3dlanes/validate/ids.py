"""Check instance ids, or else semantic ids, against the scene: paint must lie on its line, pixels of cars, trees
and structures in their bodies, and those of structures on faces of their kind.

Pixels are unprojected into the scene by their depth.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from scipy.spatial import cKDTree

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.scene.instance_ids import KINDS, kind_indices, numbers_of
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.scene.things import FIRST_OF
from synth3dlanes.scene.things import KINDS as SEMANTIC_KINDS
from synth3dlanes.system.arrays import Points3
from synth3dlanes.validate import boxes
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Bounded, Finding, Measure, Result
from synth3dlanes.validate.pixels import some_pixels
from synth3dlanes.validate.places import on_road, places
from synth3dlanes.world.solids import SURFACES
from synth3dlanes.world.world import World

# Number of pixels, and share of a body's pixels, that may be wrong: with a wrong id nearly all of them are.
MAX_SINGLE, MAX_SHARE = 3, 0.05
# Share of a line's paint pixels that may lie more than MAX_BEYOND_M outside its edges; in 60 random scenes of each
# preset none does.
MAX_BEYOND_M, MAX_SHARE_BEYOND, MIN_OF_LINE = 0.01, 0.02, 150
# Margins: cars fit their nominal boxes to 1 %; twigs reach 10 % beyond a tree's.
CAR_ROOM, TREE_ROOM = 1.05, 1.15
# Room around the box of a structure's faces of one kind, for depth far away.
FACE_M = 0.1
# Of the image's height that the bonnet fills.
MAX_BONNET = 0.03

STRUCTURE, STRUCTURES = SURFACES[0], [SEMANTIC_IDS[name] for name in SURFACES]
# All kinds of a series of instance ids count as its first one here.
NAMES = {series: FIRST_OF[series].name for series in KINDS}
FOLDED = np.arange(256, dtype=np.uint8)
for _kind in SEMANTIC_KINDS:
    if _kind.series:
        FOLDED[_kind.semantic_id] = FIRST_OF[_kind.series].semantic_id


def check_ids(evidence: Evidence) -> Iterator[Result]:
    """Findings about ids, and measure `beyond_paint_m`: how far pixels of paint lie outside the scene's paint."""
    passes = evidence.passes
    if {"semantic", "instance"} <= set(passes):
        yield from disagreement("instance", passes["semantic"], passes["instance"])
    if "depth" in passes and {"semantic", "instance"} & set(passes):
        yield from _paint(evidence)
        yield from _bodies(evidence)
    # After bodies: faces of another body are of another kind, too.
    if {"depth", "semantic", "instance"} <= set(passes):
        yield from _surfaces(evidence)


def kind_of(instance: Integer[np.ndarray, "*n"]) -> Integer[np.ndarray, "*n"]:
    """Kinds that follow from instance ids; 0 for pixels without one."""
    kinds = np.array([0, *(SEMANTIC_IDS[name] for name in NAMES.values())], dtype=np.uint8)
    return kinds[kind_indices(instance) + 1]


def _folded(semantic: Integer[np.ndarray, "*n"]) -> Integer[np.ndarray, "*n"]:
    """Semantic ids with those of all kinds of a series of instance ids as one kind."""
    return FOLDED[semantic]


def is_of(name: str, ids: Integer[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
    """Which semantic ids are those of a name."""
    return np.asarray(ids == SEMANTIC_IDS[name])


def disagreement(
    source: str, semantic: Integer[np.ndarray, "*n"], instance: Integer[np.ndarray, "*n"]
) -> Iterator[Finding]:
    """Findings where semantic and instance ids disagree about the kind of object."""
    kind, semantic = kind_of(instance), _folded(semantic)
    wrong = {(int((is_of(name, semantic) != is_of(name, kind)).sum()), name, thing) for thing, name in NAMES.items()}
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
    rows, columns = some_pixels((kind == SEMANTIC_IDS["marking"]) & evidence.has_points)
    points_cam = evidence.points_cam(rows, columns)
    points, used = on_road(world, evidence.camera, points_cam)
    used &= points_cam[:, 1] < PROOF_M
    points, rows, columns, y_m = points[used], rows[used], columns[used], points_cam[used, 1]
    place = places(world.ground, points[:, :2])
    labelled = [lane.id for lane in evidence.labels.lanes if lane.kind == "delimiter"]
    ids = [*labelled, *(id_ for id_ in paint.ids if id_ not in labelled)]
    beyond_m = np.full(len(points), np.inf)
    number = numbers_of("delimiter", passes[name][rows, columns])
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
        rows, columns = some_pixels((kind == SEMANTIC_IDS[key]) & evidence.has_points)
        numbers = passes[name][rows, columns].astype(int) if name == "instance" else None
        yield from outside_bodies(evidence, name, key, evidence.points_world(rows, columns), numbers)


def outside_bodies(
    evidence: Evidence, source: str, key: str, points_world: Points3, ids: Int[np.ndarray, " n"] | None
) -> Iterator[Finding]:
    """Findings about points seen on cars, trees or structures (keys of THINGS) that are not in the body of their
    instance id, or of none."""
    thing, inside = THINGS[key]
    own = np.full(len(points_world), -1) if ids is None else numbers_of(thing, ids)
    wrong = ~inside(evidence, points_world, own)
    for i in np.unique(own[wrong]):
        n, n_wrong = int((own == i).sum()), int(wrong[own == i].sum())
        if n_wrong > max(MAX_SINGLE, MAX_SHARE * n):
            whose = f"{thing} {i}" if i >= 0 else f"a {thing}"
            what = "points" if source == "lidar" else "pixels"
            yield Finding("", f"{source}: expected {what} of {whose} within its body, got {n_wrong} of {n} outside")


def _in_car(evidence: Evidence, points: Points3, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
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


def _in_tree(evidence: Evidence, points: Points3, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
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
        distance, _ = cKDTree(world.site.trees_world[:, :2]).query(points[:, :2])
        return np.asarray(distance < radius.max())
    known = own < len(trees)
    tree = np.where(known, own, 0)
    up = points - world.site.trees_world[tree]
    rest = (TREE_ROOM - 1) * height[tree]
    return known & (np.hypot(up[:, 0], up[:, 1]) < radius[tree]) & (up[:, 2] > -rest) & (up[:, 2] < height[tree])


def _in_structure(evidence: Evidence, points: Points3, own: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which points are in a box of structure `own`, -1 for any."""
    return boxes.inside(evidence.structures, points, own)


# What has a body: the kind of its instance ids, and which points are in it.
THINGS = {
    "car": ("car", _in_car),
    "tree": ("tree", _in_tree),
    STRUCTURE: ("structure", _in_structure),
}


def check_bonnet(evidence: Evidence) -> Iterator[Result]:
    """Finding if the host's bonnet is not in the picture, or should not be."""
    share, middle = evidence.world.view.bonnet, evidence.camera.width_px // 2
    found = float(is_of("host", evidence.passes["semantic"][:, middle]).mean())
    # A wide lens sees more of it than the share that it fills at least.
    off = abs(found - share) if evidence.camera.lens.is_pinhole or not share else max(share - found, 0.0)
    yield Bounded("ids.bonnet", off, most=MAX_BONNET)
    if off > MAX_BONNET:
        yield Finding(
            "", f"host: expected the bonnet in the lowest {100 * share:.0f} % of the picture, got {100 * found:.0f} %"
        )


def _surfaces(evidence: Evidence) -> Iterator[Finding]:
    """Compare the semantic ids of structures with the faces that these have: a pole's is not a sign's."""
    passes = evidence.passes
    rows, columns = some_pixels(np.isin(passes["semantic"], STRUCTURES) & evidence.has_points)
    points, semantic = evidence.points_world(rows, columns), passes["semantic"][rows, columns]
    number = numbers_of("structure", passes["instance"][rows, columns])
    wrong = np.zeros(len(points), dtype=bool)
    for i in np.unique(number[(number >= 0) & (number < len(evidence.world.site.structures))]):
        body = evidence.world.site.structures[i]
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
