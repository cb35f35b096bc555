"""Check what labels say is seen against the passes: points of lines, and shares of objects. That these are where labels
say, rows of `seen` tell.

A pixel's pass value is one sample at its centre, so a point's visibility is judged from the sixteen pixels around it:
where these disagree, an edge is less than two pixels away and the point is skipped. `visible_fraction` is the share of
the pixels that a thing would fill, were it alone, in which it is seen: what something nearer covers of its box bounds
this.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.labels.labels import CameraLabel, Lane
from synth3dlanes.scene.instance_ids import END, thing_of
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.system.arrays import Passes, Points2
from synth3dlanes.validate.bodies import FAR_M, boxes_of, grown, meet
from synth3dlanes.validate.evidence import Evidence, some_pixels
from synth3dlanes.validate.findings import Bounded, Finding, Result, counted, judged
from synth3dlanes.validate.paint import Strip
from synth3dlanes.validate.seen import MAX_SHARE, OBJECTS_IDS, check_seen
from synth3dlanes.world.placement import PlacedObject

# Masks may differ from the passes where a line of sight grazes a crest or a twig: at up to 5 points of a line in 1,350
# scenes.
MAX_GRAZING = 5
# A mask moved along its line by one point must have MIN_MOVED more wrong points and MOVED times as many as unmoved.
MIN_MOVED, MOVED = 3, 2
# Pixels whose depths differ by a larger factor show two surfaces.
SMOOTH = 1.2
# How much nearer than a point, in depth, a shoulder must be to be taken for a kerb before it.
KERB_NEARER_M = 0.3
# Distance beyond which a kerb is thinner than a pixel: a constant, and metres for each pixel of the focal length.
KERBS_M, KERBS_M_A_PX = 80.0, 0.24
# Pixels of an object whose inverse depths are off a plane's, which are linear over the image, by less than this share
# show one surface without a gap.
OFF_PLANE = 0.0125
# A point is left out if the pixels in the rows next to it see the ground at less than this share of its distance.
MIN_NEXT = 0.6
# A surface nearer than a point by this factor and distance hides it; the point's own surface differs by less in depth
# from pixel to pixel.
NEARER, NEARER_M = 0.985, 0.05
Squares = Int[np.ndarray, "k n"]
# Objects with narrower boxes, whose upper parts may be narrower than a pixel, tell nothing of what is behind them.
NARROW_PX = 5.0
# Labels measure shares with at least RAYS rays, passes with pixel centres, of which SLACK_PX may be of something else.
# None of 382 cars and things that are seen uses more than 0.4 of the error allowed.
RAYS, SIGMAS, MAX_SHARE_OFF, SLACK_PX = 100, 4.0, 0.03, 2
# A body fills at least the share SLIVER of the part of its box that nothing covers (rays may miss less), and of the
# covered part at least THIN times that share: 0.52 times in the median, 0.25 for one car of 80. People whom the image
# cuts are not judged, nor are cars of which it cuts more than MOST_CUT: an umbrella or a wheel alone may be seen.
THIN, MOST_CUT, SLIVER = 0.35, 0.9, 0.05


class Sight(NamedTuple):
    """Which points the passes clearly show, which they show hidden by the ground, and which hidden by an object."""

    clear: Bool[np.ndarray, " n"]
    by_ground: Bool[np.ndarray, " n"]
    by_object: Bool[np.ndarray, " n"]


def check_points(evidence: Evidence) -> Iterator[Result]:
    """Findings about lines, of depth at them, and of masks that the available passes (depth, semantic) contradict."""
    yield from check_seen("points", evidence)
    if not {"depth", "semantic"} <= evidence.has:
        return
    moved = np.zeros(3, dtype=int)
    for lane in evidence.labels.lanes:
        uv = evidence.camera.project(lane.xyz_cam)
        strip = evidence.paint.strip(evidence.camera, lane, lane.xyz_cam)
        sight = _sight(evidence.camera, lane, strip, uv, evidence.passes)
        # The deck of a bridge is as thin as its road: from below its points are at their depths, too.
        asked = evidence.is_single[lane.id] & ~_behind_narrow(evidence, lane, uv)
        sight = Sight(*(of & asked for of in sight))
        for name, mask, hidden in (
            ("terrain_visible", lane.terrain_visible, sight.by_ground),
            ("object_visible", lane.object_visible, sight.by_object),
        ):
            wrong = np.not_equal(np.asarray(mask), sight.clear)[sight.clear | hidden]
            reason = f"{name}: expected what the passes show, got another at {{wrong}} of {{n}}"
            yield from counted(f"points.{name}", wrong, reason, MAX_GRAZING, MAX_SHARE, lane.id)
        # If its mask is moved back by a point, as it is, and moved on.
        at, shown = (sight.clear | sight.by_object)[1:-1], sight.clear[1:-1]
        mask = np.asarray(lane.object_visible)
        moved += [np.count_nonzero((mask[1 + by : len(mask) - 1 + by] != shown)[at]) for by in (-1, 0, 1)]
    here, best = int(moved[1]), int(moved.min())
    yield Bounded("points.moved_mask", float(here - best), most=MIN_MOVED - 1)
    if here - best >= MIN_MOVED and best * MOVED < here:
        got = f"got another at {here} points, and at {best} if every mask is moved by a point"
        yield Finding("", f"object_visible: expected what the passes show, {got}")


def _behind_narrow(evidence: Evidence, lane: Lane, uv: Points2) -> Bool[np.ndarray, " n"]:
    """Which points of a lane may be behind an object that is narrower than a pixel, as a far cone beside a line is: it
    may hide a point and yet be at no pixel's centre."""
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
    rows, columns = _around(uv, passes["depth"].shape)
    depth = passes["depth"][rows, columns]
    own_depth = _own_depth(camera, strip, rows, columns)
    nearer = depth < NEARER * own_depth - NEARER_M
    objects = np.isin(passes["semantic"][rows, columns], OBJECTS_IDS)
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
    is_one = _off_plane(depth) < OFF_PLANE
    return Sight(
        asked & ~nearer.any(axis=0) & shown,
        asked & (nearer & ~objects).all(axis=0),
        asked & (nearer & objects).all(axis=0) & is_one,
    )


def _off_plane(depth: Float[np.ndarray, "k n"]) -> Float[np.ndarray, " n"]:
    """How far the inverse depths of sixteen pixels are at most from those of one plane, as shares of their mean."""
    row, column = np.divmod(np.arange(len(depth)), 4)
    plane = np.column_stack([np.ones(len(depth)), row, column])
    # Nothing is at infinity, and beside a fisheye depths may be 0: there is no plane.
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / depth
        off = inverse - plane @ (np.linalg.pinv(plane) @ inverse)
        return np.asarray(np.abs(off).max(axis=0) / np.abs(inverse.mean(axis=0)))


def _own_depth(camera: CameraLabel, strip: Strip, rows: Squares, columns: Squares) -> Float[np.ndarray, "k n"]:
    """The depth that pixels around points would have without occlusion: that of the surface's tangent plane at the
    point, but at most the point's own depth."""
    pixels = np.stack([columns, rows], axis=-1) + 0.5
    rays_cam = camera.points(pixels, np.ones(rows.shape))
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (strip.points_cam * strip.normal_cam).sum(axis=1) / (rays_cam * strip.normal_cam).sum(axis=2)
    y_m = strip.points_cam[:, 1]
    return np.where((depth > 0) & (depth < y_m), depth, y_m)


def _around(uv: Points2, shape: tuple[int, ...]) -> tuple[Squares, Squares]:
    """Rows and columns of the sixteen pixels around each pixel position, row by row (arbitrary for positions outside
    the image)."""
    sizes = np.array([shape[1], shape[0]])
    j, i = np.floor(np.clip(np.nan_to_num(uv - 0.5), 0, sizes - 2)).astype(int).T
    dy, dx = (steps.ravel()[:, None] for steps in np.mgrid[-1:3, -1:3])
    return np.clip(i + dy, 0, shape[0] - 1), np.clip(j + dx, 0, shape[1] - 1)


def check_cars(evidence: Evidence) -> Iterator[Result]:
    """Findings where the share of a car, or of a thing, does not fit its pixels and those that something nearer
    covers."""
    items, cars = evidence.labels.objects or (), evidence.labels.car_visible_fraction or ()
    shares = [*cars, *(item.visible_fraction or 0.0 for item in items[len(cars) :])]
    counts = np.bincount(evidence.passes["instance"].ravel(), minlength=END)
    for item, place, share in zip(evidence.world.view.objects, evidence.truth.objects or (), shares, strict=False):
        kind, number = thing_of(item.id)
        thin = THIN if (place.truncation or 0) <= (MOST_CUT if kind == "car" else 0) else 0.0
        low, high = _seen_share(evidence, item, place.box_px, thin)
        off, near = max(low - share, share - high, 0.0), low if share < low else high
        expected = f"{low:.2f} to {high:.2f} of {kind} {number} by its {counts[item.id]} pixels"
        reason = f"{kind}_visible_fraction: expected {expected}, got {share:.2f}"
        # It is the mean of some rays that are seen or not.
        error = MAX_SHARE_OFF + SIGMAS * float(np.sqrt(near * (1 - near) / RAYS))
        yield from judged(f"{kind}s.seen_share", off, reason, most=error)


def _seen_share(
    evidence: Evidence, item: PlacedObject, box_px: Float[np.ndarray, "4"] | None, thin: float
) -> tuple[float, float]:
    """Limits of the share of an object's pixels that is seen, by its box: which pixels look at it, which of these show
    the object, and which something nearer. No pixel of a pass without depth tells what it hides."""
    instance = evidence.passes["instance"]
    if box_px is None:
        return 0.0, float((instance == item.id).any())
    near = np.zeros(instance.shape, dtype=bool)
    left, top, right, bottom = (int(edge) for edge in box_px)
    near[max(top - 1, 0) : bottom + 2, max(left - 1, 0) : right + 2] = True
    has_depth = "depth" in evidence.passes
    if has_depth:
        near &= evidence.has_points | np.isinf(evidence.passes["depth"])
    rows, columns = some_pixels(near)
    eye, own = evidence.world.view.eye_world, instance[rows, columns] == item.id
    ends = eye + FAR_M * evidence.rays_world(rows, columns)
    box = grown(boxes_of([item]))
    is_it = own | meet(box, eye, ends)
    if has_depth:
        hit = evidence.has_points[rows, columns]
        ends[hit] = evidence.points_world(rows[hit], columns[hit])
    n, n_box, n_open = (int(of.sum()) for of in (own, is_it, own | (is_it & meet(box, eye, ends))))
    covered = n_box - n_open
    most = n + covered if has_depth and n >= SLIVER * n_box else n_box
    # Along its edges the ground may be nearer than a box that is sunk into it.
    hidden = thin * max(covered - np.sqrt(n_box), 0.0)
    low, high = max(n - SLACK_PX, 0) / max(most, 1), (n_open + SLACK_PX) / (n_open + SLACK_PX + hidden)
    return low, high if n or not n_open else min(high, SLACK_PX / (SLIVER * n_open))
