"""Check passes by themselves and against each other: the sky, normals, the bonnet, and kinds of ids."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Integer

from synth3dlanes.scene.instance_ids import KINDS, kind_indices, numbers_of
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import KINDS as SEMANTIC_KINDS
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.validate.evidence import Evidence, some_pixels
from synth3dlanes.validate.findings import Result, counted, judged

# Number of pixels that may be wrong, and at most about this many are asked for their normals.
SINGLE, MAX_NORMALS = 3, 45_000
# Tolerance of a normal's length (half floats are accurate to 0.0004).
LENGTH = 0.005
# With smooth shading, normals at outlines may point away from the camera: in 200 rendered scenes, up to 6 % of the
# pixels of a small car and 0.8 % of all others. Leaves and far hills are not checked.
AWAY, MAX_AWAY, MIN_FACING = 0.02, 0.25, 50
FACING = tuple(kind.name for kind in SEMANTIC_KINDS if kind.name not in ("sky", "terrain", "tree"))
# Tolerance of the share of the image's height that the bonnet fills.
MAX_BONNET = 0.03


def classes_of(series: str) -> tuple[str, ...]:
    """The names of the semantic ids that things of a series of instance ids have."""
    return tuple(kind.name for kind in SEMANTIC_KINDS if kind.series == series)


def disagreement(
    source: str, scene: Scene, semantic: Integer[np.ndarray, "*n"], instance: Integer[np.ndarray, "*n"]
) -> Iterator[Result]:
    """Findings where semantic and instance ids disagree about the kind of thing: the series that ids have, and of
    people, riders and road works, which share one, their own kinds."""
    what, found = "points" if source == "lidar" else "pixels", kind_indices(instance)
    for i, kind in enumerate(KINDS):
        asked, got = np.isin(semantic, [SEMANTIC_IDS[name] for name in classes_of(kind)]), found == i
        expected = f"ids of the kind {kind} at the {asked.sum()} {what} of this kind in semantic"
        reason = f"{expected}, got them at {(asked & got).sum()} of these and at {(got & ~asked).sum()} others"
        yield from judged("ids.kind", int((asked != got).sum()), f"{source}: expected {reason}", most=SINGLE)
    of_things, numbers = np.array([SEMANTIC_IDS[item.kind] for item in scene.things]), numbers_of("thing", instance)
    known = (numbers >= 0) & (numbers < len(of_things))
    if known.any():
        wrong = semantic[known] != of_things[numbers[known]]
        reason = f"{source}: expected things of their kinds in semantic, got others at {{wrong}} of {{n}} {what}"
        yield from counted("ids.kind_of_thing", wrong, reason, SINGLE)


def check_bonnet(evidence: Evidence) -> Iterator[Result]:
    """Finding if the host's bonnet is not in the picture, or should not be."""
    share, middle = evidence.world.view.bonnet, evidence.camera.width_px // 2
    found = float((evidence.passes["semantic"][:, middle] == SEMANTIC_IDS["host"]).mean())
    # A wide lens sees more of it than the share that it fills at least.
    off = abs(found - share) if evidence.camera.lens.is_pinhole or not share else max(share - found, 0.0)
    expected = f"the bonnet in the lowest {100 * share:.0f} % of the picture"
    yield from judged("bonnet", off, f"host: expected {expected}, got {100 * found:.0f} %", most=MAX_BONNET)


def check_sky(evidence: Evidence) -> Iterator[Result]:
    """Findings unless depth is infinite in the sky and only there, and where the sky shows through the ground: at
    pixels that look down and whose line of sight is below the terrain where this ends, by a pixel or more, so that it
    must meet ground before."""
    is_sky = evidence.passes["semantic"] == SEMANTIC_IDS["sky"]
    if "depth" in evidence.passes:
        wrong = (np.isfinite(evidence.passes["depth"]) == is_sky).ravel()
        reason = "depth: expected infinity in the sky and only there, got otherwise at {wrong} pixels"
        yield from counted("sky.depth", wrong, reason, SINGLE)
    rows, columns = np.nonzero(is_sky)
    rays = evidence.rays_world(rows, columns)
    down = rays[:, 2] < 0
    rows, columns, rays = rows[down], columns[down], rays[down]
    xs, ys = evidence.world.ground.paved.grid.axes
    eye_world, last = evidence.camera.world_from_cam[:3, 3], np.array([[xs[0], ys[0]], [xs[-1], ys[-1]]])
    with np.errstate(divide="ignore"):
        way_m = np.abs((last[(rays[:, :2] > 0).astype(int), [0, 1]] - eye_world[:2]) / rays[:, :2]).min(axis=1)
    ends = eye_world + way_m[:, None] * rays
    pixel_m = way_m / evidence.camera.img_from_cam[0, 0]
    is_hole = ends[:, 2] < evidence.world.ground.mesh_heights(ends[:, :2]) - pixel_m
    u, v = columns[is_hole], rows[is_hole]
    place = f" (u {u.min()}-{u.max()}, v {v.min()}-{v.max()})" if len(u) else ""
    reason = f"semantic: expected ground below the horizon, got sky at {{wrong}} pixels{place}"
    yield from counted("sky.holes", is_hole, reason, single=0)


def check_normals(evidence: Evidence) -> Iterator[Result]:
    """Findings about the normal pass; depth or semantic ids give the sky, semantic ids what must face the camera."""
    passes = evidence.passes
    rows, columns = some_pixels(np.ones(passes["normal"].shape[:2], dtype=bool), MAX_NORMALS)
    some = {name: passes[name][rows, columns] for name in ("normal", "depth", "semantic") if name in passes}
    length = np.linalg.norm(some["normal"], axis=1)
    is_hit = np.isfinite(some["depth"]) if "depth" in some else length > 0
    if "depth" not in some and "semantic" in some:
        is_hit = some["semantic"] != SEMANTIC_IDS["sky"]
    reason = "normal: expected unit length, and zero in the sky and only there, got otherwise at {wrong} pixels"
    yield from counted("normal.length", ~(np.abs(length - is_hit) < LENGTH), reason, SINGLE)
    for name in FACING if "semantic" in some else ():
        at = some["semantic"] == SEMANTIC_IDS[name]
        if np.count_nonzero(at) >= MIN_FACING:
            rays_cam = evidence.camera.rays(np.column_stack([columns, rows])[at] + 0.5)
            share = float(((rays_cam * some["normal"][at]).sum(axis=1) > AWAY).mean())
            reason = f"normal: expected it to face the camera, got {100 * share:.0f} % of {name} turned away"
            yield from judged("normal.away", share, reason, most=MAX_AWAY)
