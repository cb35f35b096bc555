"""Check the boxes of objects: against the scene, and against what depth, ids and the sweep show.

Points of an object must be in its box, and reach the sides that are seen: so a box that is too small, turned or moved
is found by points outside it, one that is too large by the gap before a side.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import invert, transform
from synth3dlanes.object_labels import ObjectLabel, object_document, rectangle_around
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Bounded, Finding, Result, differences, some

# How far points of an object may be outside its box: built-in models reach at most 2 cm beyond theirs. And how many.
ROOM_M, MAX_OUTSIDE, MAX_SINGLE = 0.02, 0.002, 2
# How far before a side of a box its points may end, and which part of what lies between two pixels or beams.
MAX_GAP_M, MAX_PART = 0.03, 0.75
# Objects with fewer points are not judged, and sides only of those that are in the image and seen as a whole.
MIN_POINTS, MIN_SEEN = 150, 0.99
# The eye is this far beyond a side that it sees. Of the others pixels show the outline, which is as wide and as high.
BEYOND_M, ALONG, UP = 0.5, 1, 2
# The lowest and highest parts are this share of half the length behind the nearer end, at most.
SET_BACK = 0.25
# Numbers of a label that follow from the scene are rounded in files; the projection of those adds to that.
PLACES = {"size_m": 2e-4, "center_cam": 2e-4, "rotation_wxyz": 2e-6, "velocity_cam": 2e-3}
RECTANGLES = {"box_px": 0.2, "unclipped_box_px": 0.2}
MAX_TRUNCATION_OFF = 0.005


class SeenPart(NamedTuple):
    """Points of an object in its frame, the eye in it, and how far points are from each other at most."""

    source: str
    points: Float[np.ndarray, "n 3"]
    eye: Float[np.ndarray, "3"]
    apart_m: float


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
    found, expected = object_document(item), object_document(true)
    for name in ("category", *PLACES, *RECTANGLES):
        most = (PLACES | RECTANGLES).get(name)
        a, b = expected[name], found[name]
        if most is None or a is None or b is None or not np.allclose(a, b, rtol=1e-6, atol=most):
            yield from differences(a, b, name)
    if abs(item.truncation - true.truncation) > MAX_TRUNCATION_OFF:
        yield f"truncation: expected {true.truncation:.3f}, got {item.truncation:.3f}"


def _counts(evidence: Evidence, item: ObjectLabel) -> Iterator[Finding]:
    """Compare the rectangle of an object's pixels and the number of its points with those that are there."""
    if "instance" in evidence.has:
        there = rectangle_around(*np.nonzero(evidence.passes["instance"] == item.id))
        shown = [None if box is None else box.tolist() for box in (there, item.seen_box_px)]
        if shown[0] != shown[1]:
            yield Finding("", f"objects.{item.id}.seen_box_px: expected {shown[0]} by its pixels, got {shown[1]}")
    n = None if evidence.returns is None else int((evidence.returns.instance == item.id).sum())
    if item.lidar_points != n:
        expected, got = ("none" if count is None else count for count in (n, item.lidar_points))
        yield Finding("", f"objects.{item.id}.lidar_points: expected {expected} by the sweep, got {got}")


def views_of(evidence: Evidence, item: ObjectLabel) -> list[SeenPart]:
    """What pixels and points there are of an object near the camera, if enough."""
    distance_m, views = float(np.linalg.norm(item.center_cam)), []
    if distance_m > PROOF_M:
        return []
    object_from_cam = invert(item.cam_from_object)
    if {"depth", "instance"} <= evidence.has:
        at = evidence.passes["instance"] == item.id
        rows, columns = np.nonzero(at & np.isfinite(evidence.passes["depth"]))
        if len(rows) >= MIN_POINTS:
            points_cam = evidence.points_cam(rows, columns)
            apart_m = float(points_cam[:, 1].max()) / evidence.camera.img_from_cam[0, 0]
            views.append(SeenPart("pixels", transform(object_from_cam, points_cam), object_from_cam[:3, 3], apart_m))
    points = evidence.returns
    if evidence.sweep is not None and points is not None:
        own = points.instance == item.id
        if own.sum() >= MIN_POINTS:
            lidar = evidence.sweep.lidar
            eye = transform(object_from_cam, lidar.cam_from_lidar[:3, 3])
            step_rad = float(np.ptp(lidar.elevations_rad)) / max(1, len(lidar.elevations_rad) - 1)
            points_object = transform(object_from_cam, points.xyz_cam[own])
            views.append(SeenPart("points", points_object, eye, distance_m * step_rad))
    return views


def judge(item: ObjectLabel, seen: SeenPart) -> Iterator[Result]:
    """Findings where points of an object are outside its box, or end before a side that is seen."""
    half = item.size_m / 2
    beyond_m = np.abs(seen.points) - half
    n, n_outside = len(seen.points), int((beyond_m > ROOM_M).any(axis=1).sum())
    most = max(MAX_SINGLE, MAX_OUTSIDE * n)
    yield Bounded(f"boxes.outside_{seen.source}", n_outside, most=most)
    if n_outside > most:
        yield Finding(
            "",
            f"objects.{item.id}: expected its {seen.source} in its box, got {n_outside} of {n} up to "
            f"{beyond_m.max():.2f} m outside",
        )
        return
    if item.truncation > 0 or (item.visible_fraction or 0.0) < MIN_SEEN:
        return
    for axis, name in enumerate(("left right", "rear front", "lower upper")):
        for sign, side in zip((-1, 1), name.split(), strict=True):
            has_outline = seen.source == "pixels" and axis != ALONG
            if has_outline or sign * seen.eye[axis] > half[axis] + BEYOND_M:
                gap_m = float(half[axis] - (sign * seen.points[:, axis]).max())
                most_m = MAX_GAP_M + MAX_PART * seen.apart_m + (_hidden_m(half, seen.eye, sign) if axis == UP else 0.0)
                yield Bounded(f"boxes.gap_{seen.source}_{side}", gap_m, most=most_m)
                if gap_m > most_m:
                    yield Finding(
                        "",
                        f"objects.{item.id}: expected its {seen.source} to reach the {side} side of its box, got them "
                        f"{gap_m:.2f} m before it",
                    )


def _hidden_m(half: Float[np.ndarray, "3"], eye: Float[np.ndarray, "3"], sign: int) -> float:
    """How much of the height of parts that are set back from an object's nearer end this end may hide: of wheels under
    a bumper from an eye above it, of what stands on a roof from one below it."""
    away_m, back_m = max(abs(float(eye[ALONG])) - half[ALONG], 0.0), SET_BACK * half[ALONG]
    return float(max(half[UP] - sign * eye[UP], 0.0) * back_m / (away_m + back_m))
