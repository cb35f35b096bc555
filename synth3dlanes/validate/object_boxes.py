"""Check the boxes of objects: against the scene, and against what depth, ids and the sweep show.

Points of an object must be in its box, and reach the sides that are seen.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.object_labels import ObjectLabel, object_document
from synth3dlanes.validate.documents import some
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Finding, Result
from synth3dlanes.validate.labelled_boxes import (
    MIN_SEEN,
    PLACES,
    SeenPart,
    SideLimit,
    against_box,
    by_pixels,
    check_seen_box,
    otherwise,
)

# Share of an object's points that may be outside its box: built-in models reach at most 2 cm beyond theirs.
MAX_OUTSIDE = 0.002
# How far before a side of a box its points may end, and which part of what lies between two pixels, or between two
# beams, of which one may return nothing.
MAX_GAP_M, MAX_PART = 0.035, {"pixels": 0.75, "points": 2.0}
# Objects with fewer points are not judged.
MIN_POINTS = 150
# The eye is this far beyond a side that it sees. Of the others pixels show the outline, which is as wide and as high.
BEYOND_M, ACROSS, ALONG, UP = 0.5, 0, 1, 2
# The lowest, highest and widest parts are this share of half the length behind the nearer end, at most. The axles of
# vans are AXLE_M behind: their wheels are hidden as a whole by an end that is CLEARANCE_M over the ground, or higher.
SET_BACK, AXLE_M, CLEARANCE_M = 0.25, 1.1, 0.15
# The most that mirrors reach beyond a body.
MIRROR_M = 0.07
MAX_TRUNCATION_OFF = 0.005


def check_boxes(evidence: Evidence) -> Iterator[Result]:
    """Findings about objects that are not those of the scene, or not where pixels and points show them."""
    items, truth = evidence.labels.objects, evidence.truth.objects
    if items is None or truth is None:
        return
    if [item.id for item in items] != [item.id for item in truth]:
        yield Finding("", f"objects: expected the {len(truth)} cars of the scene in its order, got other ids")
        return
    for item, true in zip(items, truth, strict=True):
        wrong = list(_otherwise(item, true))
        if wrong:
            yield Finding("", f"objects.{item.id}: {some(wrong)}")
        yield from _counts(evidence, item)
        for seen in views_of(evidence, item):
            yield from judge(item, seen)


def _otherwise(item: ObjectLabel, true: ObjectLabel) -> Iterator[str]:
    """How an object differs from the scene's, by more than rounding."""
    yield from otherwise(object_document(item), object_document(true), ("category", *PLACES))
    if abs(item.truncation - true.truncation) > MAX_TRUNCATION_OFF:
        yield f"truncation: expected {true.truncation:.3f}, got {item.truncation:.3f}"


def _counts(evidence: Evidence, item: ObjectLabel) -> Iterator[Finding]:
    """Compare the rectangle of an object's pixels and the number of its points with those that are there."""
    if "instance" in evidence.has:
        yield from check_seen_box(evidence, item, f"objects.{item.id}")
    n = None if evidence.returns is None else int((evidence.returns.instance == item.id).sum())
    if item.lidar_points != n:
        expected, got = ("none" if count is None else count for count in (n, item.lidar_points))
        yield Finding("", f"objects.{item.id}.lidar_points: expected {expected} by the sweep, got {got}")


def views_of(evidence: Evidence, item: ObjectLabel) -> list[SeenPart]:
    """What pixels and points there are of an object near the camera, if enough."""
    pixels = by_pixels(evidence, item.id, item.cam_from_object, MIN_POINTS)
    views, points = [] if pixels is None else [pixels], evidence.returns
    distance_m = float(np.linalg.norm(item.center_cam))
    if evidence.sweep is not None and points is not None and distance_m <= PROOF_M:
        own = points.instance == item.id
        if own.sum() >= MIN_POINTS:
            lidar, object_from_cam = evidence.sweep.lidar, invert(item.cam_from_object)
            eye = transform(object_from_cam, lidar.cam_from_lidar[:3, 3])
            points_object = transform(object_from_cam, points.xyz_cam[own])
            apart_m = distance_m * _step_rad(lidar.elevations_rad, points.xyz_lidar[own])
            views.append(SeenPart("points", points_object, eye, apart_m))
    return views


def _step_rad(elevations_rad: Sequence[float], xyz_lidar: Float[np.ndarray, "n 3"]) -> float:
    """The largest angle between two neighbouring beams, of those that meet points and one on either side."""
    beams = np.sort(elevations_rad)
    up_rad = np.arctan2(xyz_lidar[:, 2], np.hypot(*xyz_lidar[:, :2].T))
    first, last = np.searchsorted(beams, [up_rad.min(), up_rad.max()])
    return float(np.diff(beams[max(first - 1, 0) : last + 2]).max(initial=0.0))


def judge(item: ObjectLabel, seen: SeenPart) -> Iterator[Result]:
    """Findings where points of an object are outside its box, or end before a side that is seen."""
    half, is_whole = item.size_m / 2, item.truncation == 0 and (item.visible_fraction or 0.0) >= MIN_SEEN
    sides = _sides(half, seen) if is_whole else ()
    yield from against_box(f"objects.{item.id}", "boxes", half, seen, MAX_OUTSIDE, sides)


def _sides(half: Float[np.ndarray, "3"], seen: SeenPart) -> Iterator[SideLimit]:
    """The sides that are seen."""
    for axis, name in enumerate(("left right", "rear front", "lower upper")):
        for sign, side in zip((-1, 1), name.split(), strict=True):
            has_outline = seen.source == "pixels" and axis != ALONG
            if has_outline or sign * seen.eye[axis] > half[axis] + BEYOND_M:
                hidden_m = _hidden_m(half, seen.eye, axis, sign) if has_outline else 0.0
                yield SideLimit(axis, sign, side, MAX_GAP_M + MAX_PART[seen.source] * seen.apart_m + hidden_m)


def _hidden_m(half: Float[np.ndarray, "3"], eye: Float[np.ndarray, "3"], axis: int, sign: int) -> float:
    """How far before a side what is set back from an object's nearer end may be hidden by this end: wheels under a
    bumper from an eye above it, what stands on a roof from one below it, mirrors, the far side of a body that grows
    wider."""
    away_m, aside_m = max(abs(float(eye[ALONG])) - half[ALONG], 0.0), half[axis] - sign * eye[axis]
    share, of_axle = (back_m / (away_m + back_m) for back_m in (SET_BACK * half[ALONG], AXLE_M))
    if axis == UP and sign < 0 and aside_m * of_axle > CLEARANCE_M:
        return float(aside_m * of_axle)
    if axis != ACROSS:
        return float(max(aside_m, 0.0) * share)
    # A body hides its far side from an eye beyond the near one, and the mirror there from one beyond the middle.
    mirror_m = min(aside_m * share, MIRROR_M) if sign * eye[axis] < 0 else 0.0
    return float(max((aside_m - 2 * half[axis]) * share, mirror_m))
