"""A table of what must be where: points of pixels and of beams of the lidar, un-projected into the world, and of what
the scene sets on the ground must lie on the surface, in the body or in the paint that the world has for them.

A pass has one sample at each pixel's centre, so a pixel's point lies exactly on a mesh. A row says which points it is
about and how to compute, for each thing among them, how far they are from where it is; one function judges all rows. A
new kind of thing that has a body needs an entry of `bodies.BODIES` and a row.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Integer
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.scene.instance_ids import numbers_of, thing_of
from synth3dlanes.scene.roadside import Building, Crossing
from synth3dlanes.scene.things import KINDS as SEMANTIC_KINDS
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.system.arrays import Points2, Points3, Scalars
from synth3dlanes.validate.bodies import BODIES, OBJECTS, cores, inside, meet
from synth3dlanes.validate.evidence import Evidence, Seen
from synth3dlanes.validate.faces import MeshFaces, ground_of, pavement_of
from synth3dlanes.validate.findings import PROOF_M, Result, counted, judged
from synth3dlanes.validate.paint import END_M, is_single
from synth3dlanes.validate.passes import SINGLE, classes_of, disagreement
from synth3dlanes.world.grass import BESIDE_M, LEAN, RADIUS_M
from synth3dlanes.world.height_map import cells_road
from synth3dlanes.world.meshes import MEDIAN, ROAD, SHOULDER
from synth3dlanes.world.paint import PAINT_LIFT_AT_M, PAINT_LIFT_M
from synth3dlanes.world.placement import TREE_SINK_M
from synth3dlanes.world.solids import SURFACES, Body
from synth3dlanes.world.spans import PASSAGE_M
from synth3dlanes.world.world import World

# Range of pavement and terrain, and how far they may be from their faces: in 108 samples one point in 4,000 of a sample
# is farther, at the most.
RANGE_M, HILLS_M, MAX_OFF_M = 110.0, 120.0, 0.002
# How far a labelled point, or what depth has there, may be from the ground. Faults of labels affect whole lines: one
# fails if more than this share of its points, and more than two, are off; single ones may be at the foot of a car.
MAX_POINT_M, MAX_SHARE, MAX_SINGLE = 0.02, 0.1, 2
# On one surface a pixel is less than BEHIND times as far as those beside it. Normals of upright faces point up by less
# than UPRIGHT.
BEHIND, UPRIGHT = 1.5, 0.1
# Limit of the normals' median error, as a chord; they are smoothed over faces, in the median by up to 0.004.
MAX_TURN = 0.02
# The same of single points, of which smooth shading may turn some at edges: up to 0.002 of them in 20 pictures. Across
# the edges of kerbs it turned 0.05 to 0.2 of those of towns.
MAX_BENT = 0.3
# Terrain this far inside the pavement's edge penetrates the road.
THROUGH_RANGE_M, INSIDE_M = 80.0, 0.3
# In 60 random scenes of each preset no pixel of paint is this far outside its line.
MAX_BEYOND_M = 0.01
# Points of the labels are a metre apart: every pixel of a line's paint is this near to one of them.
BETWEEN_M = 0.9
# The steepest ground on which blades of grass lean.
STEEP = 0.5
# Pixels this close to an edge of a symbol may show either side of it; lines may lie this far over a gore's edges.
MARGIN_M, LINE_M = 0.04, 0.15
# The share of points of an object that may be outside its box: built-in models reach at most 2 cm beyond theirs.
IN_BOX = 0.002
# Pixels of a car reach its end that faces the camera, to MAX_GAP_M, if there are MIN_OF_CAR of them, the share WHOLE of
# the car is seen, and the camera is END_SEEN_M beyond that end.
MIN_OF_CAR, WHOLE, END_SEEN_M, MAX_GAP_M = 150, 0.99, 0.5, 0.035
# The number of beams that may be wrong.
BEAMS = 20
# Limits of visible gaps: a rigid car on the sharpest crests has a wheel up to 0.21 m off (1,350 scenes; mostly below
# 5 cm), and farther from the host the ground's faces are metres long. Structures reach 0.4 m into the ground, trees as
# deep from 0.2 m over it on, where these faces cut off the edge of a bank.
MAX_WHEEL_M, MAX_TREE_M, MAX_FOOT_M, STANDS_WITHIN_M = 0.25, 0.3, 0.4, 100.0
# Every eighth foot of a structure is checked.
FEET_STEP = 8
# Kerbs stand at the very edge. Edges of buildings this near to their lowest point are on the ground.
ROOM_M, LOW_M = 0.05, 0.5
# One in MAP_STEP cells of the height map is asked, of those off the ground with the ground FACE_M around them; in 26
# scenes with and without maps up to 0.0021 of all, at kerbs, were off without that.
MAP_STEP, MAX_MAP_M, MAP_SHARE, FACE_M = 7, 0.002, 0.005, 0.005

# Semantic ids of what stands on the ground.
OBJECTS_IDS = [kind.semantic_id for kind in SEMANTIC_KINDS if kind.series and not kind.is_ground]
PAVEMENT = ("road", "shoulder")
# Semantic ids of what the faces of the pavement are made of.
KINDS = np.zeros(3, dtype=int)
KINDS[[ROAD, SHOULDER, MEDIAN]] = [SEMANTIC_IDS[name] for name in (*PAVEMENT, "terrain")]
PAINTED = (*PAVEMENT, "marking", "symbol")
ANY_OF = {"delimiter": "a line", "symbol": "a symbol"}
_IDS_TOO = frozenset({"depth", "semantic", "instance"})


class PartSeen(NamedTuple):
    """Points of one thing: its words, how far each is from where the world has it, and the lane to name."""

    whose: str
    apart_m: Scalars
    lane: str = ""


class SeenRow(NamedTuple):
    """Points of some semantic classes (or of a kind of instance ids, where there are any) within a range, or, without
    classes, places that the row itself knows: of each thing among them all but `single` and a share must be within
    `most`, or, `in_median`, the median must. `expected` may have places for {what} is seen and {whose} it is; `layer`
    is the pass that findings name, or else that of ids. Beams are judged by rows with `of_beams`, which is the number
    of these that may be wrong."""

    check: str
    name: str
    classes: tuple[str, ...]
    parts: Callable[[Evidence, Any], Iterator[PartSeen]]
    expected: str
    most: float
    share: float = 0.0
    single: int = SINGLE
    in_median: bool = False
    kind: str = ""
    layer: str = ""
    needs: frozenset[str] = frozenset({"depth", "semantic"})
    within_m: float = np.inf
    least_n: int = 1
    n: int = 10_000
    of_beams: int | None = None


def check_seen(check: str, evidence: Evidence) -> Iterator[Result]:
    """Findings of the rows of a check about what the sample's pixels show."""
    passes, known = evidence.passes, {}
    for row in ROWS:
        # Instance ids say what semantic ids would, of kinds of things that have them.
        has = evidence.has | ({"semantic"} if row.kind and "instance" in evidence.has else set())
        if row.check != check or not row.needs <= has:
            continue
        if not row.classes:
            yield from _judge(row, evidence, None)
            continue
        # Rows about the same points share them, and what is computed of them.
        key = (row.classes, row.kind, row.within_m, row.n)
        if key not in known:
            which = _is_of(row, {name: passes[name] for name in ("semantic", "instance") if name in passes})
            known[key] = evidence.seen(which & (passes["depth"] < row.within_m), row.n)
        yield from _judge(row, evidence, known[key])


def _is_of(row: SeenRow, ids: Mapping[str, Integer[np.ndarray, "*n"]]) -> Bool[np.ndarray, "*n"]:
    if not row.classes:
        return np.ones(ids["semantic"].shape, dtype=bool)
    if row.kind and "instance" in ids:
        return np.asarray(numbers_of(row.kind, ids["instance"]) >= 0)
    return np.isin(ids["semantic"], [SEMANTIC_IDS[name] for name in row.classes])


def _judge(row: SeenRow, evidence: Evidence, seen: Seen | None) -> Iterator[Result]:
    is_lidar = seen is not None and seen.is_lidar
    what = "places" if seen is None else "points" if is_lidar else "pixels"
    source = "lidar" if is_lidar else row.layer or ("instance" if "instance" in evidence.passes else "semantic")
    for part in row.parts(evidence, seen):
        n, off_m = len(part.apart_m), np.abs(part.apart_m)
        if n < row.least_n:
            continue
        expected = f"{source}: expected {row.expected.format(what=what, whose=part.whose)}, got"
        if row.in_median:
            median = float(np.median(off_m))
            found = f"{expected} them {median:.4f} off in the median, at {n} {what}"
            yield from judged(row.name, median, found, most=row.most, lane=part.lane)
            continue
        wrong = ~(off_m <= row.most)
        far_m = part.apart_m[wrong & np.isfinite(off_m)]
        by = f", by {np.median(far_m):+.3f} m in the median" if len(far_m) else ""
        single = row.of_beams if is_lidar and row.of_beams is not None else row.single
        found = f"{expected} {{wrong}} of {{n}} {what} elsewhere{by}"
        yield from counted(row.name, wrong, found, single, row.share, part.lane)


def check_lidar(evidence: Evidence) -> Iterator[Result]:
    """Findings of the rows about what beams see, and where beams pass through cars."""
    swept = evidence.swept
    yield from disagreement("lidar", evidence.scene, swept.ids["semantic"], swept.ids["instance"])
    for row in ROWS:
        if row.of_beams is not None:
            within_m = np.inf if row.kind in BODIES or not row.classes else PROOF_M
            yield from _judge(row, evidence, swept.at(_is_of(row, swept.ids) & (swept.range_m < within_m)))


# -- parts: how far points are from where the world has them


def _on_ground(evidence: Evidence, _: None) -> Iterator[PartSeen]:
    """The visible points of lines near the camera; the end of a map's road, on which an outer line lies, may be a
    kerb."""
    lanes, world_from_cam = evidence.labels.lanes, evidence.camera.world_from_cam
    asked = [
        evidence.near(lane)
        & (lane.connector is None or lane.kind == "centerline" or None not in (lane.left, lane.right))
        for lane in lanes
    ]
    points_cam = np.concatenate([lane.xyz_cam[at] for lane, at in zip(lanes, asked, strict=True)])
    above_m = ground_of(evidence.world).nearest(transform(world_from_cam, points_cam)).above_m
    for lane, of in zip(lanes, np.split(above_m, np.cumsum([at.sum() for at in asked])[:-1]), strict=True):
        yield PartSeen("", of[np.isfinite(of)], lane.id)


def _at_lines(evidence: Evidence, _: None) -> Iterator[PartSeen]:
    """What depth has at the visible points of centre lines, which have no paint, but for objects before them."""
    camera, passes = evidence.camera, evidence.passes
    at = np.zeros(passes["depth"].shape, dtype=bool)
    for lane in evidence.labels.lanes:
        if lane.kind == "centerline":
            uv = camera.project(lane.xyz_cam[evidence.near(lane)])
            at[tuple(np.clip(uv.astype(int), 0, [camera.width_px - 1, camera.height_px - 1]).T[::-1])] = True
    if "semantic" in passes:
        at &= ~np.isin(passes["semantic"], OBJECTS_IDS)
    # At a crest the pixel of a point may be of what lies behind.
    nearest_m, farthest_m = (of(passes["depth"].astype(float), 3) for of in (minimum_filter, maximum_filter))
    at &= farthest_m < BEHIND * nearest_m
    yield PartSeen("", ground_of(evidence.world).nearest(evidence.seen(at).points_world).above_m)


def _through_cars(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    through = meet(cores(evidence.world), seen.eye_world, seen.points_world)
    yield PartSeen("", np.where(through, np.inf, 0))


def _surface(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """Tar and the places of removed lines float over the pavement, less than paint does."""
    above_m, tar_m = seen.pavement.above_m, np.interp(seen.range_m, PAINT_LIFT_AT_M, PAINT_LIFT_M)
    yield PartSeen("the pavement", np.where((above_m > 0) & (above_m < tar_m), 0, above_m)[seen.is_near])


def _kind(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """Upright faces of two surfaces may be in one plane: of these either kind of pavement is right."""
    expected, found = (
        np.where(np.isfinite(seen.pavement.above_m), KINDS[seen.pavement.material], 0),
        seen.ids["semantic"],
    )
    is_upright = np.abs(seen.pavement.up_world[:, 2]) < UPRIGHT
    is_right = (found == expected) | (is_upright & np.isin(found, [SEMANTIC_IDS[name] for name in PAVEMENT]))
    for name in (*PAVEMENT, "terrain"):
        yield PartSeen(name, np.where(is_right, 0, np.inf)[expected == SEMANTIC_IDS[name]])


def _turn(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    assert seen.pixels is not None, "beams have no normals"
    found = evidence.passes["normal"][tuple(seen.pixels.T)] @ evidence.camera.world_from_cam[:3, :3].T
    on = np.isfinite(seen.pavement.above_m)
    yield PartSeen("the road", np.linalg.norm(found - seen.pavement.up_world, axis=1)[on])


def _bent(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    for part in _turn(evidence, seen):
        yield part._replace(apart_m=np.where(part.apart_m <= MAX_BENT, 0, np.inf))


def _hills(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """Beside the pavement blades of grass stand on it, which lean."""
    ground, grass_m = ground_of(evidence.world), evidence.scene.vegetation.grass_m
    off_m = ground.nearest(seen.points_world).above_m
    if grass_m:
        rest = np.flatnonzero(~(np.abs(off_m) <= MAX_OFF_M))
        points, reach_m = seen.points_world[rest], LEAN * grass_m + RADIUS_M
        over_m = points[:, 2] - ground.height(points[:, :2], points[:, 2])
        is_grass = evidence.world.ground.clearance(points[:, :2]) < BESIDE_M[1] + reach_m
        off_m[rest[is_grass & (over_m > 0) & (over_m < grass_m + STEEP * reach_m)]] = 0
    yield PartSeen("terrain", off_m[seen.is_near])


def _through(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """Below a deck, and over a tunnel, the ground goes on."""
    ground, xy = evidence.world.ground, seen.xy_world
    may_be = ground.paved.is_grass(xy, INSIDE_M) | ground.is_stacked(xy)
    yield PartSeen("terrain", np.where(may_be, 0, np.maximum(-ground.clearance(xy), 0)))


def _body(kind: str, evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    own = seen.number(kind)
    apart_m = np.where(inside(evidence.bodies[kind], seen.points_world, own), 0, np.inf)
    for i in np.unique(own).tolist():
        yield PartSeen(f"{kind} {i}" if i >= 0 else f"a {kind}", apart_m[own == i])


def _ends(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """How far the pixels of a car that is near and seen as a whole are from the end that looks at the camera."""
    shares = {item.id: item.visible_fraction for item in evidence.labels.objects or () if item.truncation == 0}
    for item in evidence.world.view.objects:
        at, (kind, number) = seen.ids["instance"] == item.id, thing_of(item.id)
        if kind != "car" or (shares.get(item.id) or 0) < WHOLE or at.sum() < MIN_OF_CAR:
            continue
        object_from_world, half_m = invert(item.world_from_object), item.size_m[1] / 2
        along_m = transform(object_from_world, np.vstack([seen.eye_world, seen.points_world[at]]))[:, 1]
        apart_m = seen.range_m[at].max() / evidence.camera.img_from_cam[0, 0]
        if abs(along_m[0]) > half_m + END_SEEN_M and seen.range_m[at].max() < PROOF_M:
            gap_m = half_m - (np.sign(along_m[0]) * along_m[1:]).max() - apart_m
            yield PartSeen(f"car {number}", np.array([max(gap_m, 0.0)]))


def _faces(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """A pole's is not a sign's."""
    boxes, own = evidence.bodies["structure"], seen.number("structure")
    bodies = evidence.world.site.structures
    surface = np.array([body.surface for body in bodies for _ in body.corners_world], dtype=str)
    for name in SURFACES:
        at = (seen.ids["semantic"] == SEMANTIC_IDS[name]) & (own >= 0)
        found = inside(boxes.at(surface == name), seen.points_world[at], own[at])
        yield PartSeen(name, np.where(found, 0, np.inf))


def _strays(kind: str, evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """Outside the paint of their line or symbol, or of any of the kind where ids tell none that labels name."""
    on, painted = seen.on_road, evidence.painted[kind]
    n_named = sum(lane.kind == kind for lane in evidence.labels.lanes) if kind == "delimiter" else len(painted)
    own = on.number(kind)
    own[own >= n_named] = -1
    for i in np.unique(own).tolist():
        some, xy_world = painted if i < 0 else painted[i : i + 1], on.xy_world[own == i]
        beyond_m = np.full(len(xy_world), np.inf)
        for item in some:
            beyond_m = np.minimum(beyond_m, item.beyond_m(xy_world))
        whose, lane = (ANY_OF[kind], "") if i < 0 else some[0][:2]
        yield PartSeen(whose, np.maximum(beyond_m, 0), lane)


def _bare(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """Ground inside a line's paint that shows none, of any line, where it is seen. Below another road, or a kerb, paint
    may be hidden."""
    on = seen.on_road
    single = is_single(evidence.world.ground, on.xy_world)
    near, is_bare = cKDTree(on.points_world), np.isin(on.ids["semantic"], [SEMANTIC_IDS[name] for name in PAVEMENT])
    for lane in evidence.labels.lanes:
        if lane.id in evidence.paint.ids and len(on):
            line_world = transform(evidence.camera.world_from_cam, lane.xyz_cam[lane.visible])
            beside = near.query_ball_point(line_world, BETWEEN_M)
            at = np.zeros(len(on), dtype=bool)
            at[np.concatenate([[], *beside]).astype(int)] = True
            at &= single
            beyond_m = evidence.paint.beyond_m(lane.id, on.xy_world[at], -END_M)
            yield PartSeen("the line", np.where(is_bare[at], np.inf, 0)[beyond_m < -MAX_BEYOND_M], lane.id)


def _gaps(evidence: Evidence, seen: Seen) -> Iterator[PartSeen]:
    """Ground inside a symbol that does not show it."""
    on = seen.on_road
    margin_m = np.where(on.ids["semantic"] == SEMANTIC_IDS["marking"], LINE_M, MARGIN_M)
    is_symbol = on.ids["semantic"] == SEMANTIC_IDS["symbol"]
    for i, (whose, _, beyond) in enumerate(evidence.painted["symbol"]):
        beyond_m = beyond(on.xy_world)
        shown = on.number("symbol") == i if "instance" in on.ids else is_symbol
        yield PartSeen(whose, np.where(shown | (beyond_m > -margin_m), 0, np.inf)[beyond_m < -MARGIN_M])


def _stands(
    points_of: Callable[[World], Points3], faces_of: Callable[[World], MeshFaces], evidence: Evidence, _: None
) -> Iterator[PartSeen]:
    """How far what stands near the host ahead of the camera is over the meshes that are rendered, which are flat
    between their rows; what is below a deck stands on the road there."""
    world, points = evidence.world, points_of(evidence.world)
    of_host, of_cam = (
        transform(invert(pose), points) for pose in (world.view.world_from_host, evidence.camera.world_from_cam)
    )
    points = points[(np.hypot(*of_host[:, :2].T) < STANDS_WITHIN_M) & (of_cam[:, 1] > 0)]
    gap_m = points[:, 2] - faces_of(world).height(points[:, :2], points[:, 2] + PASSAGE_M)
    yield PartSeen("", gap_m[np.isfinite(gap_m)])


def wheels(world: World) -> Points3:
    """The contact points of all cars' tyres."""
    found = []
    for car, world_from_car in zip(world.scene.cars, world.view.world_from_cars, strict=True):
        model = world.scene.assets.car_models[car.model - 1]
        x, y = model.track_m / 2 * car.scale, model.wheelbase_m / 2 * car.scale
        found.append(transform(world_from_car, np.array([[-x, y, 0], [x, y, 0], [-x, -y, 0], [x, -y, 0]])))
    return _joined(found)


def _joined(parts: Iterable[np.ndarray]) -> Points3:
    return np.concatenate([np.zeros((0, 3)), *parts])


def _on_pavement(evidence: Evidence, _: None) -> Iterator[PartSeen]:
    """Poles may stand on the walkways of a map, and below its decks. What stands on a median is left to the road's own
    checks, and what has no pole hangs."""
    world, roadside = evidence.world, evidence.scene.roadside
    poles = [item for item in roadside.free_elements if item.has_pole]
    items = (*roadside.rails, *roadside.posts, *roadside.crossings, *roadside.buildings, *poles)
    # Bodies of decks, heads and faces follow.
    asked = [
        (number, _outline(body) if isinstance(item, Building) else body.feet_world[:, :2], isinstance(item, Building))
        for number, (item, body) in enumerate(zip(items, world.site.structures, strict=False))
        if not isinstance(item, Crossing) and getattr(item, "side", "") != "median"
    ]
    if not asked:
        return
    n_places = [len(places_xy) for _, places_xy, _ in asked]
    feet = np.concatenate([places_xy for _, places_xy, _ in asked])
    numbers, is_building = (np.repeat([row[i] for row in asked], n_places) for i in (0, 2))
    inside_m = -np.where(is_building, world.ground.clearance(feet), world.ground.paved.off_carriageways(feet))
    inside_m[world.ground.is_stacked(feet)] = 0
    for number in np.unique(numbers).tolist():
        whose = f"structure {number} ({world.site.structures[number].kind})"
        yield PartSeen(whose, np.maximum(inside_m[numbers == number], 0))


def _outline(body: Body) -> Points2:
    """Places along the lower edges of a body's faces."""
    corners = body.corners_world
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    low = ends[(ends[..., 2] < corners[..., 2].min() + LOW_M).all(axis=1)]
    share = np.linspace(0, 1, 9)[:, None, None]
    return np.asarray(((1 - share) * low[:, 0, :2] + share * low[:, 1, :2]).reshape(-1, 2))


def _cells(evidence: Evidence, _: None) -> Iterator[PartSeen]:
    """Cells of the height map, some of which are on the upright face of a kerb, between the heights around them."""
    points_road = cells_road(evidence.passes["height"].astype(float))[::MAP_STEP]
    points_world = transform(evidence.world.view.world_from_road, points_road)
    height_near = evidence.world.ground.height_near
    over_m = points_world[:, 2] - height_near(points_world)
    off = np.abs(over_m) > MAX_MAP_M
    around = [(x, y, 0) for x in (-FACE_M, 0, FACE_M) for y in (-FACE_M, 0, FACE_M)]
    each_m = points_world[off, 2] - [height_near(points_world[off] + by) for by in around]
    over_m[off] = np.maximum(each_m.min(axis=0), 0) + np.minimum(each_m.max(axis=0), 0)
    yield PartSeen("", over_m)


ROWS = (
    *(
        SeenRow(
            "standing", f"standing.{name}_gap_m", (), partial(_stands, points, faces),
            f"{name}s within {limit_m} m of the ground", most=limit_m, single=0, layer="scene", needs=frozenset(),
        )
        for name, points, faces, limit_m in (
            ("wheel", wheels, pavement_of, MAX_WHEEL_M),
            ("tree", lambda world: np.add(world.site.trees_world, (0, 0, TREE_SINK_M)), ground_of, MAX_TREE_M),
            ("structure", lambda world: _joined(body.feet_world[::FEET_STEP] for body in world.site.structures),
             ground_of, MAX_FOOT_M),
        )
    ),
    SeenRow(
        "roadside", "roadside", (), _on_pavement, "{whose} beside the pavement",
        most=ROOM_M, single=0, layer="scene", needs=frozenset(),
    ),
    SeenRow(
        "height", "height", (), _cells, "cells on the scene's ground",
        most=MAX_MAP_M, share=MAP_SHARE, layer="height", needs=frozenset({"height"}),
    ),
    SeenRow(
        "lidar", "lidar.through", (), _through_cars, "beams to end at cars", most=0, of_beams=SINGLE,
    ),
    SeenRow(
        "points", "points.ground_m", (), _on_ground, f"points within {MAX_POINT_M} m of the ground",
        most=MAX_POINT_M, share=MAX_SHARE, single=MAX_SINGLE, layer="labels", needs=frozenset(),
    ),
    SeenRow(
        "points", "points.depth_m", (), _at_lines, f"pixels at lines within {MAX_POINT_M} m of the ground",
        most=MAX_POINT_M, share=MAX_SHARE, single=MAX_SINGLE, layer="depth", needs=frozenset({"depth"}),
    ),
    SeenRow(
        "pavement", "pavement.surface", PAVEMENT, _surface, f"{{whose}} within {MAX_OFF_M} m of the scene's",
        most=MAX_OFF_M, share=0.001, layer="passes", within_m=RANGE_M, n=15_000, of_beams=BEAMS,
    ),
    SeenRow(
        "pavement", "pavement.kind", PAVEMENT, _kind, "{whose} by the plan",
        most=0, share=0.001, layer="semantic", within_m=RANGE_M, n=15_000, of_beams=BEAMS,
    ),
    SeenRow(
        "pavement", "pavement.normal", PAVEMENT, _turn, "{whose}'s in the camera frame",
        most=MAX_TURN, in_median=True, layer="normal", within_m=RANGE_M, least_n=100, n=15_000,
        needs=frozenset({"depth", "semantic", "normal"}),
    ),
    SeenRow(
        "pavement", "pavement.shading", PAVEMENT, _bent, "{whose}'s as its faces are turned",
        most=0, share=0.02, layer="normal", within_m=RANGE_M, least_n=100, n=15_000,
        needs=frozenset({"depth", "semantic", "normal"}),
    ),
    SeenRow(
        "terrain", "terrain.hills", ("terrain",), _hills, f"{{whose}} within {MAX_OFF_M} m of the scene's",
        most=MAX_OFF_M, share=0.001, layer="depth", within_m=HILLS_M, n=2_000, of_beams=BEAMS,
    ),
    SeenRow(
        "terrain", "terrain.through", ("terrain",), _through, "pavement on the road and not {whose}",
        most=INSIDE_M, layer="passes", within_m=THROUGH_RANGE_M, n=15_000,
    ),
    SeenRow(
        "ids", "ids.paint", ("marking",), partial(_strays, "delimiter"), "paint where {whose} is painted",
        most=MAX_BEYOND_M, share=0.02, kind="delimiter", within_m=PROOF_M, of_beams=SINGLE,
    ),
    SeenRow(
        "ids", "ids.bare", PAINTED, _bare, "{what} of {whose} in all of its paint",
        most=0, share=0.05, layer="semantic", within_m=PROOF_M, n=15_000, of_beams=SINGLE,
    ),
    *(
        SeenRow(
            "ids", f"ids.{kind}", classes_of(kind), partial(_body, kind), "{what} of {whose} within its body",
            most=0, share=IN_BOX if kind in OBJECTS else 0.05, kind=kind, of_beams=SINGLE, n=40_000,
        )
        for kind in BODIES
    ),
    SeenRow(
        "ids", "ids.ends", classes_of("car"), _ends, "{what} of {whose} up to its nearer end",
        most=MAX_GAP_M, single=0, kind="car", needs=_IDS_TOO, n=40_000,
    ),
    SeenRow(
        "ids", "ids.faces", SURFACES, _faces, "{whose} on faces of {whose}",
        most=0, share=0.05, layer="semantic", needs=_IDS_TOO, of_beams=SINGLE,
    ),
    SeenRow(
        "symbols", "symbols.strays", ("symbol",), partial(_strays, "symbol"), "{what} of {whose} within its paint",
        most=MARGIN_M, share=0.05, kind="symbol", within_m=PROOF_M, of_beams=SINGLE,
    ),
    SeenRow(
        "symbols", "symbols.gaps", PAINTED, _gaps, "{what} of {whose} in all of its paint",
        most=0, share=0.05, within_m=PROOF_M, of_beams=SINGLE,
    ),
)  # fmt: skip
