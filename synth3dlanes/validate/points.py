"""Check the passes against the labels: the surface at points, and occlusion.

A pixel's pass value is one sample at its centre. So depth at a point is interpolated from the four pixels around it,
and its visibility is judged from sixteen: where these disagree, an edge is less than two pixels away and the point is
skipped.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from synth3dlanes.labels.labels import CameraLabel, Lane
from synth3dlanes.scene.things import KINDS, SEMANTIC_IDS
from synth3dlanes.system.arrays import Passes, Points2, Scalars
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Bounded, Finding, Measure, Result, Signed, counted
from synth3dlanes.validate.paint import Strip
from synth3dlanes.validate.pixels import Squares, around, depth_between

# Label faults affect whole lines: a line fails if more than this share of its points, and more than two
# points, are off.
# Single points, such as at the foot of a car, only appear in the distributions.
MAX_SHARE, MAX_SINGLE = 0.1, 2
# Masks may differ from the passes where a line of sight grazes a crest or a twig: at up to 5 points of a line in 1,350
# scenes.
MAX_GRAZING = 5
# Limits within PROOF_M.
LIMITS = {
    "surface_m": (0.02, "m of the rendered surface"),
}
MASKS = ("terrain_visible", "object_visible")
OBJECTS = [kind.semantic_id for kind in KINDS if kind.series and not kind.is_ground]
# A mask moved along its line by one point must have MIN_MOVED more wrong points and MOVED times as many as unmoved.
MIN_MOVED, MOVED = 3, 2
# Range ahead for the test of the surface's height over the data set, and the least number of points in it.
HEIGHT_WITHIN_M, MIN_NEAR = 25.0, 10
# Pixels whose depths differ by a larger factor show two surfaces, or one at too flat an angle to interpolate.
SMOOTH = 1.2
# How much nearer than a point, in depth, a shoulder must be to be taken for a kerb before it.
KERB_NEARER_M = 0.3
# Distance beyond which a kerb is thinner than a pixel: a constant, and metres for each pixel of the focal length.
KERBS_M, KERBS_M_A_PX = 80.0, 0.24
# Pixels of an object whose depths differ by a smaller factor show one surface without a gap.
ONE_SURFACE = 1.05
# Depth is interpolated between pixels as on a plane. A point is left out if pixels are too large to judge it: if the
# surface bends so much that the interpolation errs by more metres, or if the rows next to the point look at less than
# this share of its distance.
MAX_BEND_M, MIN_NEXT = 0.004, 0.6
# A surface nearer than a point by this factor and distance hides it; the point's own surface differs by less in depth
# from pixel to pixel.
NEARER, NEARER_M = 0.985, 0.05
# Objects with narrower boxes, whose upper parts may be narrower than a pixel, tell nothing of what is behind them.
NARROW_PX = 5.0


class SurfaceErrors(NamedTuple):
    """What pixels show at points: the points' distances, and how far the rendered surface is beyond them in depth and
    below them along its normal."""

    y_m: Scalars
    deeper_m: Scalars
    below_m: Scalars


class Sight(NamedTuple):
    """Of points: which the passes clearly show, which as hidden by the ground, and which as hidden by an object."""

    clear: Bool[np.ndarray, " n"]
    by_ground: Bool[np.ndarray, " n"]
    by_object: Bool[np.ndarray, " n"]


def check_points(evidence: Evidence) -> Iterator[Result]:
    """Findings about lines from the available passes (depth, semantic), and all measured values."""
    passes, camera = evidence.passes, evidence.camera
    measures: list[Measure] = []
    above_m = [np.zeros(0)]
    moved = np.zeros(3, dtype=int)
    for lane in evidence.labels.lanes:
        uv = camera.project(lane.xyz_cam)
        strip = evidence.paint.strip(camera, lane, lane.xyz_cam)
        found = []
        if "depth" in passes:
            surface = _surface(lane, strip, uv, passes, evidence.is_single[lane.id])
            # Only along the normal is there a limit: at a crest one pixel spans metres of depth.
            found.append(Measure("depth_m", surface.y_m, np.abs(surface.deeper_m)))
            found.append(Measure("surface_m", surface.y_m, np.abs(surface.below_m)))
            # Paint floats over the road.
            if lane.kind == "centerline":
                above_m.append(-surface.below_m[surface.y_m < HEIGHT_WITHIN_M])
        if "depth" in passes and "semantic" in passes:
            sight = _sight(camera, lane, strip, uv, passes)
            # The deck of a bridge is as thin as its road: from below its points are at their depths, too.
            asked = evidence.is_single[lane.id] & ~_behind_narrow(evidence, lane, uv)
            sight = Sight(*(of & asked for of in sight))
            found += _against_masks(lane, sight)
            moved += _wrong_if_moved(lane, sight)
        measures += found
        for measure in found:
            yield from judge(lane.id, measure)
    yield from _judge_moved(moved)
    near_m = np.concatenate(above_m)
    if len(near_m) >= MIN_NEAR and not evidence.scene.shot.frame:
        yield Signed("surface_above_m", float(np.median(near_m)))
    yield from joined(measures)


def judge(lane_id: str, measure: Measure) -> Iterator[Result]:
    """A finding if too many of a line's values are too large."""
    is_flag = measure.name in MASKS
    if not is_flag and measure.name not in LIMITS:
        return
    values = measure.values if is_flag else measure.values[measure.y_m < PROOF_M]
    limit, words = (0.0, "") if is_flag else LIMITS[measure.name]
    reason = f"{measure.name}: expected what the passes show, got another at {{wrong}} of {{n}}"
    if not is_flag:
        off = f"{np.median(values) if len(values) else 0:.3g} in the median"
        reason = f"passes: expected points within {limit} {words}, got {{wrong}} of {{n}} off, by {off}"
    single = MAX_GRAZING if is_flag else MAX_SINGLE
    yield from counted(f"points.{measure.name}", values > limit, reason, single, MAX_SHARE, lane_id)


def _surface(lane: Lane, strip: Strip, uv: Points2, passes: Passes, is_single: Bool[np.ndarray, " n"]) -> SurfaceErrors:
    """How far the rendered surface is beyond each visible point, as far as pixels tell."""
    between, y_m = depth_between(passes["depth"], uv), lane.xyz_cam[:, 1]
    across_m = np.abs((strip.points_cam * strip.normal_cam).sum(axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        error = between.depth_m / y_m - 1
        is_plane = between.bend * y_m / between.depth_m * across_m < MAX_BEND_M
        smooth = lane.visible & is_single & is_plane & (between.spread < SMOOTH)
    if "semantic" in passes:
        semantic = passes["semantic"][around(uv, passes["depth"].shape, 1)]
        smooth &= ~_of_objects(semantic).any(axis=0)
        if lane.connector is not None:
            # On a map the edge of a shoulder or walkway may be a kerb, and grass an island that a line of sight grazes.
            raised = semantic == SEMANTIC_IDS["shoulder"]
            smooth &= raised.all(axis=0) | ~raised.any(axis=0)
            smooth &= ~(semantic == SEMANTIC_IDS["terrain"]).any(axis=0)
    smooth &= np.isfinite(error)
    return SurfaceErrors(y_m[smooth], error[smooth] * y_m[smooth], error[smooth] * across_m[smooth])


def _behind_narrow(evidence: Evidence, lane: Lane, uv: Points2) -> Bool[np.ndarray, " n"]:
    """Which points of a lane may be behind an object that is narrower than pixels tell, as a far cone beside a line is:
    it may hide a point and be at no pixel's centre."""
    found = np.zeros(len(uv), dtype=bool)
    for item in evidence.labels.objects or ():
        box = item.box_px
        if box is not None and box[2] - box[0] < NARROW_PX:
            is_inside = ((uv > box[:2] - 1) & (uv < box[2:] + 1)).all(axis=1)
            found |= is_inside & (lane.xyz_cam[:, 1] > item.center_cam[1])
    return found


def _sight(camera: CameraLabel, lane: Lane, strip: Strip, uv: Points2, passes: Passes) -> Sight:
    """What the passes show of a lane's points. A point counts as visible only if a pixel shows a surface at its depth:
    a crest may hide it between two rows."""
    rows, columns = around(uv, passes["depth"].shape, 2)
    depth = passes["depth"][rows, columns]
    own_depth = _own_depth(camera, strip, rows, columns)
    nearer = depth < NEARER * own_depth - NEARER_M
    objects = _of_objects(passes["semantic"][rows, columns])
    y_m, away_m = strip.points_cam[:, 1], np.linalg.norm(strip.points_cam, axis=1)
    shows_kerbs = (y_m < KERBS_M) & (away_m < KERBS_M_A_PX * camera.img_from_cam[0, 0])
    shown = ((depth < SMOOTH * y_m) & (depth > y_m / SMOOTH)).any(axis=0)
    if lane.connector is not None:
        # On a map a kerb may hide what is close behind it.
        kerb = (passes["semantic"][rows, columns] == SEMANTIC_IDS["shoulder"]) & (depth < own_depth - KERB_NEARER_M)
        shown &= ~kerb.any(axis=0) & shows_kerbs
    elif (passes["semantic"] == SEMANTIC_IDS["kerb"]).any():
        shown &= shows_kerbs
    asked = lane.in_image & (own_depth.min(axis=0) > MIN_NEXT * y_m)
    # Pixels of several bodies, or of several parts of one, may have a slit between them that shows the point.
    is_one = depth.max(axis=0) < ONE_SURFACE * depth.min(axis=0)
    return Sight(
        asked & ~nearer.any(axis=0) & shown,
        asked & (nearer & ~objects).all(axis=0),
        asked & (nearer & objects).all(axis=0) & is_one,
    )


def _against_masks(lane: Lane, sight: Sight) -> list[Measure]:
    """Compare the masks with the passes, where these are clear."""
    return [
        Measure(name, lane.xyz_cam[at, 1], np.not_equal(np.asarray(mask), sight.clear)[at].astype(float))
        for name, mask, at in (
            ("terrain_visible", lane.terrain_visible, sight.clear | sight.by_ground),
            ("object_visible", lane.object_visible, sight.clear | sight.by_object),
        )
    ]


def _wrong_if_moved(lane: Lane, sight: Sight) -> Int[np.ndarray, "3"]:
    """At how many points `object_visible` is not what the passes show: if it is moved back by a point, as it is, and if
    it is moved on."""
    at, mask = (sight.clear | sight.by_object)[1:-1], np.asarray(lane.object_visible)
    moved = (mask[1 + by : len(mask) - 1 + by] for by in (-1, 0, 1))
    return np.array([np.count_nonzero(np.not_equal(of, sight.clear[1:-1])[at]) for of in moved])


def _judge_moved(wrong: Int[np.ndarray, "3"]) -> Iterator[Result]:
    """Finding if `object_visible` of all lanes is clearly nearer to what the passes show if it is moved by a point."""
    here, best = int(wrong[1]), int(wrong.min())
    yield Bounded("points.moved_mask", float(here - best), most=MIN_MOVED - 1)
    if here - best >= MIN_MOVED and best * MOVED < here:
        yield Finding(
            "",
            f"object_visible: expected what the passes show, got another at {here} points, and at {best} if every mask "
            "is moved by a point",
        )


def _own_depth(camera: CameraLabel, strip: Strip, rows: Squares, columns: Squares) -> Float[np.ndarray, "k n"]:
    """The depth that pixels around points would have without occlusion: that of the surface's tangent plane at the
    point, but at most the point's own depth."""
    pixels = np.stack([columns, rows], axis=-1) + 0.5
    rays_cam = camera.points(pixels, np.ones(rows.shape))
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (strip.points_cam * strip.normal_cam).sum(axis=1) / (rays_cam * strip.normal_cam).sum(axis=2)
    y_m = strip.points_cam[:, 1]
    return np.where((depth > 0) & (depth < y_m), depth, y_m)


def _of_objects(semantic: Integer[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
    return np.isin(semantic, OBJECTS)


def joined(measures: Sequence[Measure]) -> list[Measure]:
    names = dict.fromkeys(measure.name for measure in measures)
    return [
        Measure(name, *(np.concatenate([m[i] for m in measures if m.name == name]) for i in (1, 2))) for name in names
    ]
