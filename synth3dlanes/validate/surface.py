"""Check depth, ids and normals of the pavement and the terrain: pixels, unprojected by depth, must lie on the scene's.

A pass has one sample at each pixel's centre, so a pixel's point lies exactly on the road's mesh, which follows the
formulas to millimetres, or on the terrain's. Larger differences mean another road, other hills or another lens.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.roads.terrain import gradient_at, height_at
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import Ids, Passes, Points3, Scalars
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Bounded, Finding, Measure, Result
from synth3dlanes.validate.pixels import some_pixels
from synth3dlanes.validate.places import AnyPlaces, places
from synth3dlanes.validate.standing import mesh_height, terrain_height
from synth3dlanes.world.ground import EMBANKMENT_SLOPE, VERGE_M
from synth3dlanes.world.world import World

# At most about this many evenly spread pixels are used.
MAX_PIXELS = 45_000
RANGE_M = 110.0
# In 2,000 random scenes the meshes are within 8 mm of the formulas up to RANGE_M, and their edges within 2 mm.
MAX_GAP_M, MAX_ASIDE_M = 0.015, 0.01
# Limit of |1 - median(depth / expected depth)|: at most 0.0039 in 1,350 rendered scenes, whose faces are flat. Smaller
# errors are found by the test `depth_scale` over the whole set.
MAX_SCALE = 0.0045
# Limit of the normals' median error, as a chord; correct ones are off by at most 0.02 degrees (half floats).
MAX_TURN = 0.005
# Number and share of pixels that may be off, and least number of pixels to judge.
MAX_SINGLE, MAX_SHARE, MIN_PIXELS = 3, 0.02, 100
# The near road, seen in pixels of its mesh: in 86 images, of 96 to 560 columns, depth is at most 0.00015 m off in the
# median. Points farther from the mesh than SAME_M are not on it.
NEAR_ROAD_M, MAX_NEAR, SAME_M, MAX_NEAR_M = 12.0, 1_500, 0.5, 0.002
# Of the terrain: pixels, range, and verge widths from the embankment's foot within which verges cover it.
MAX_HILLS, MIN_HILLS, HILLS_M, VERGES = 2_000, 20, 120.0, 1.1
# The median over a sample is at most 1 mm in 400 rendered samples.
MAX_MEDIAN_M = 0.005
# Tolerance of a normal's length (half floats are accurate to 0.0004).
LENGTH = 0.005
# With smooth shading, normals at outlines may point away from the camera: in 200 rendered scenes, up to 6 % of the
# pixels of a small car and 0.8 % of all others. Leaves and far hills are not checked.
AWAY, MAX_AWAY, MIN_OF_KIND = 0.02, 0.25, 50
PAVEMENT = [SEMANTIC_IDS[name] for name in ("road", "shoulder")]
KINDS = ("road", "shoulder", "marking", "car")


class Pavement(NamedTuple):
    """Points where road or shoulder was seen: their ranges, semantic ids, places on the road and its normals, and their
    distances along the normal above the road (`gap_m`) and below the eye."""

    range_m: Scalars
    semantic: Ids
    places: AnyPlaces
    up_world: Points3
    gap_m: Scalars
    below_eye_m: Scalars

    def at(self, which: Bool[np.ndarray, " n"]) -> "Pavement":
        """The selected points."""
        range_m, semantic, place, *others = self
        return Pavement(range_m[which], semantic[which], place.at(which), *(values[which] for values in others))


def pavement_at(
    world: World,
    eye_world: Float[np.ndarray, "3"],
    points: Points3,
    range_m: Scalars,
    semantic: Ids,
) -> Pavement:
    """Points of pavement, seen from the eye, beside the scene's."""
    terrain, place = world.scene.terrain, places(world.ground, points[:, :2])
    slope = place.slope()
    up = np.column_stack([-slope, np.ones(len(points))])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    gap_m = (points[:, 2] - height_at(terrain, points[:, :2]) - place.raised()) * up[:, 2]
    return Pavement(range_m, semantic, place, up, gap_m, ((eye_world - points) * up).sum(axis=1))


def check_pavement(evidence: Evidence) -> Iterator[Result]:
    """Findings about depth, semantic ids and normals on the road, and measure `pavement_m`: distances from the road."""
    passes = evidence.passes
    rows, columns = _pixels_of_pavement(evidence)
    y_m = passes["depth"][rows, columns].astype(float)
    eye_world, points = evidence.camera.world_from_cam[:3, 3], evidence.points_world(rows, columns)
    firm = places(evidence.world.ground, points[:, :2]).is_firm()
    rows, columns, y_m, points = rows[firm], columns[firm], y_m[firm], points[firm]
    pavement = pavement_at(evidence.world, eye_world, points, y_m, passes["semantic"][rows, columns])
    yield from _sky(passes)
    yield from _depth(pavement)
    yield from _exactly(evidence.world, points, pavement)
    yield from misplaced("semantic", pavement)
    if "normal" in passes:
        yield from _normals(pavement, evidence.camera, passes["normal"][rows, columns])
    yield Measure("pavement_m", pavement.range_m, np.abs(pavement.gap_m))


def check_hills(evidence: Evidence) -> Iterator[Result]:
    """Finding if the terrain's height differs from the scene's."""
    passes, ground = evidence.passes, evidence.world.ground
    is_terrain = (passes["semantic"] == SEMANTIC_IDS["terrain"]) & (passes["depth"] < HILLS_M) & evidence.has_points
    points = evidence.points_world(*some_pixels(is_terrain, MAX_HILLS))
    raised_m = EMBANKMENT_SLOPE * max([road.ramp.height_m for road in ground.network.roads if road.ramp], default=0.0)
    beside_m = VERGES * VERGE_M * ground.cell_scale(points[:, :2]) + raised_m
    points = points[ground.clearance(points[:, :2]) > beside_m]
    if len(points) < MIN_HILLS:
        return
    slope = gradient_at(evidence.scene.terrain, points[:, :2])
    above_m = (points[:, 2] - terrain_height(ground, points[:, :2])) / np.sqrt(1 + (slope**2).sum(axis=1))
    median_m = float(np.median(np.abs(above_m)))
    yield Bounded("surface.hills_m", median_m, most=MAX_MEDIAN_M)
    if median_m > MAX_MEDIAN_M:
        yield Finding(
            "",
            f"depth: expected terrain within {MAX_MEDIAN_M} m of the scene's in the median, got {median_m:.3f} m, "
            f"at {len(points)} pixels",
        )


def check_holes(evidence: Evidence) -> Iterator[Result]:
    """Finding where the sky shows through the ground: at pixels that look down and whose line of sight is below the
    terrain where this ends, by a pixel or more, so that it must meet ground before."""
    rows, columns = np.nonzero(evidence.passes["semantic"] == SEMANTIC_IDS["sky"])
    rays = evidence.camera.rays(np.column_stack([columns, rows]) + 0.5) @ evidence.camera.world_from_cam[:3, :3].T
    down = rays[:, 2] < 0
    rows, columns, rays = rows[down], columns[down], rays[down]
    xs, ys = evidence.world.ground.mesh_axes
    eye_world, last = evidence.camera.world_from_cam[:3, 3], np.array([[xs[0], ys[0]], [xs[-1], ys[-1]]])
    with np.errstate(divide="ignore"):
        way_m = np.abs((last[(rays[:, :2] > 0).astype(int), [0, 1]] - eye_world[:2]) / rays[:, :2]).min(axis=1)
    ends = eye_world + way_m[:, None] * rays
    pixel_m = way_m / evidence.camera.img_from_cam[0, 0]
    is_hole = ends[:, 2] < terrain_height(evidence.world.ground, ends[:, :2]) - pixel_m
    n = int(is_hole.sum())
    yield Bounded("surface.holes", n, most=0)
    if n:
        u, v = columns[is_hole], rows[is_hole]
        place = f"u {u.min()}-{u.max()}, v {v.min()}-{v.max()}"
        yield Finding("", f"semantic: expected ground below the horizon, got sky at {n} pixels ({place})")


def check_normals(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the normal pass; depth or semantic ids give the sky, semantic ids the kinds to check."""
    passes = evidence.passes
    step = int(np.ceil(np.sqrt(passes["normal"][..., 0].size / MAX_PIXELS)))
    some = {name: values[::step, ::step] for name, values in passes.items() if name != "height"}
    length = np.linalg.norm(some["normal"], axis=2)
    has_none = length == 0
    wrong = int((~has_none & ~(np.abs(length - 1) < LENGTH)).sum())
    if wrong > MAX_SINGLE:
        yield Finding("", f"normal: expected unit length or none, got another at {wrong} of {length.size} pixels")
    if {"depth", "semantic"} & set(some):
        is_sky = ~np.isfinite(some["depth"]) if "depth" in some else some["semantic"] == SEMANTIC_IDS["sky"]
        wrong = int((has_none != is_sky).sum())
        if wrong > MAX_SINGLE:
            yield Finding("", f"normal: expected zero in the sky and only there, got otherwise at {wrong} pixels")
    if "semantic" in some:
        rows, columns = step * np.indices(length.shape) + 0.5
        away = (evidence.camera.rays(np.stack([columns, rows], axis=-1)) * some["normal"]).sum(axis=2) > AWAY
        for name in KINDS:
            of_kind = away[some["semantic"] == SEMANTIC_IDS[name]]
            if len(of_kind) >= MIN_OF_KIND and of_kind.mean() > MAX_AWAY:
                share = f"{100 * of_kind.mean():.0f} % of {name}"
                yield Finding("", f"normal: expected it to face the camera, got {share} turned away")


def _pixels_of_pavement(evidence: Evidence) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Rows and columns of pixels that show road or shoulder."""
    semantic, depth = evidence.passes["semantic"], evidence.passes["depth"]
    step = int(np.ceil(np.sqrt(semantic.size / MAX_PIXELS)))
    first = step // 2
    some = np.s_[first::step, first::step]
    paved = np.isin(semantic[some], PAVEMENT) & (depth[some] < RANGE_M) & evidence.has_points[some]
    rows, columns = (first + step * index for index in np.nonzero(paved))
    return rows, columns


def _sky(passes: Passes) -> Iterator[Finding]:
    """Finding unless depth is infinite in the sky and only there."""
    wrong = int((np.isfinite(passes["depth"]) == (passes["semantic"] == SEMANTIC_IDS["sky"])).sum())
    if wrong > MAX_SINGLE:
        yield Finding("", f"depth: expected infinity in the sky and only there, got otherwise at {wrong} pixels")


def _depth(pavement: Pavement) -> Iterator[Result]:
    """Findings about the road's depth. The ramp, which may have few pixels, is judged separately."""
    off = np.abs(pavement.gap_m) > MAX_GAP_M
    on_ramp = pavement.places.raised() > 0
    for name, part in (("road", ~on_ramp), ("ramp", on_ramp)):
        if part.sum() >= MIN_PIXELS:
            yield Bounded(f"surface.{name}_off", float(off[part].mean()), most=MAX_SHARE)
        if _are_many(off[part]):
            median_m = np.median(pavement.gap_m[part & off])
            yield Finding(
                "",
                f"depth: expected the {name} within {MAX_GAP_M} m of the scene's, got {(off & part).sum()} of "
                f"{part.sum()} pixels off, by {median_m:+.3f} m in the median",
            )
    near = pavement.range_m < PROOF_M
    if near.sum() >= MIN_PIXELS:
        scale = 1 - float(np.median(pavement.gap_m[near] / pavement.below_eye_m[near]))
        yield Bounded("surface.scale", abs(scale - 1), most=MAX_SCALE)
        if abs(scale - 1) > MAX_SCALE:
            yield Finding("", f"depth: expected the road at the scene's distance, got it {scale:.4f} times as far")


def _exactly(world: World, points: Points3, pavement: Pavement) -> Iterator[Result]:
    """Finding if depth is not exactly, along the pixels' rays, that of the mesh that is rendered."""
    near = np.flatnonzero((pavement.range_m > 0) & (pavement.range_m < NEAR_ROAD_M))
    near = near[:: 1 + len(near) // MAX_NEAR]
    above_m = points[near, 2] - mesh_height(world.site.surfaces.pavement, points[near, :2], points[near, 2] + SAME_M)
    slant = pavement.up_world[near, 2] * pavement.range_m[near] / pavement.below_eye_m[near]
    off_m = (above_m * slant)[np.abs(above_m) < SAME_M]
    if len(off_m) < MIN_PIXELS:
        return
    near_m = Bounded("surface.near_m", float(np.median(np.abs(off_m))), most=MAX_NEAR_M)
    yield near_m
    if near_m.is_beyond:
        found = f"{np.median(np.abs(off_m)):.4f} m off in the median ({-np.median(off_m):+.4f} m with its sign)"
        yield Finding("", f"depth: expected the near road within {MAX_NEAR_M} m of the scene's mesh, got it {found}")


def misplaced(source: str, pavement: Pavement) -> Iterator[Finding]:
    """Findings where road and shoulder are not where the scene has them."""
    what, beyond_m = "points" if source == "lidar" else "pixels", pavement.places.outside()
    off = beyond_m > MAX_ASIDE_M
    if off.sum() > MAX_SINGLE:
        yield Finding(
            "",
            f"{source}: expected pavement within its edges, got {off.sum()} of {len(off)} {what} up to "
            f"{beyond_m.max():.2f} m outside",
        )
    found, expected = pavement.semantic, pavement.places.surface(MAX_ASIDE_M)
    for name in ("road", "shoulder"):
        wrong = (expected == SEMANTIC_IDS[name]) & (found != expected)
        if wrong.sum() > MAX_SINGLE:
            yield Finding("", f"{source}: expected {name} by the plan, got another at {wrong.sum()} {what}")


def _normals(pavement: Pavement, camera: CameraLabel, normals_cam: Points3) -> Iterator[Result]:
    """Finding if the normals differ from the road's, in the median: they are smoothed where the exit leaves it. A ramp
    has others."""
    level = ~pavement.places.on_slope()
    if level.sum() < MIN_PIXELS:
        return
    found = normals_cam[level] @ camera.world_from_cam[:3, :3].T
    turn = float(np.median(np.linalg.norm(found - pavement.up_world[level], axis=1)))
    yield Bounded("surface.turn", turn, most=MAX_TURN)
    if not turn <= MAX_TURN:
        yield Finding("", f"normal: expected the road's in the camera frame, got them {turn:.3f} off in the median")


def _are_many(off: Bool[np.ndarray, " n"]) -> bool:
    return bool(off.sum() > max(MAX_SINGLE, MAX_SHARE * len(off)))
