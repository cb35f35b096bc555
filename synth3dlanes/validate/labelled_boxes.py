"""What the checks of objects and of traffic elements share: a label beside the scene's, and its box beside what is seen
of it. A box that is too small, turned or moved is found by points outside it, one that is too large by the gap before a
side."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.element_labels import ElementLabel
from synth3dlanes.labels.object_labels import ObjectLabel, rectangle_around
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.validate.documents import differences
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Bounded, Finding, Result

# How far outside a box points may be, and how many of them farther.
ROOM_M, MAX_SINGLE = 0.02, 2
# Sides are judged only of what is seen as a whole.
MIN_SEEN = 0.99
# Numbers of a label that follow from the scene are rounded in files; the projection of rectangles adds to that.
PLACES = {"size_m": 2e-4, "center_cam": 2e-4, "rotation_wxyz": 2e-6, "velocity_cam": 2e-3, "box_px": 0.2,
          "unclipped_box_px": 0.2}  # fmt: skip


class SeenPart(NamedTuple):
    """Points of what is labelled in its frame, the eye in it, and how far points are from each other at most."""

    source: str
    points: Float[np.ndarray, "n 3"]
    eye: Float[np.ndarray, "3"]
    apart_m: float


class SideLimit(NamedTuple):
    """A side of a box: its axis, its sign on that, its name, and how far before it points may end."""

    axis: int
    sign: int
    name: str
    most_m: float


def otherwise(found: Mapping[str, Any], expected: Mapping[str, Any], names: Iterable[str]) -> Iterator[str]:
    """How values of a label's JSON form differ from the scene's, those of PLACES by more than rounding."""
    for name in names:
        a, b = expected[name], found[name]
        if name not in PLACES or a is None or b is None or not np.allclose(a, b, rtol=1e-6, atol=PLACES[name]):
            yield from differences(a, b, name)


def check_seen_box(evidence: Evidence, item: ObjectLabel | ElementLabel, label: str) -> Iterator[Finding]:
    """A finding if the rectangle of the pixels with the id of what is labelled is another one."""
    there = rectangle_around(*np.nonzero(evidence.passes["instance"] == item.id))
    expected, got = (None if box is None else box.tolist() for box in (there, item.seen_box_px))
    if expected != got:
        yield Finding("", f"{label}.seen_box_px: expected {expected} by its pixels, got {got}")


def by_pixels(evidence: Evidence, id_: int, cam_from_box: Matrix4, least: int) -> SeenPart | None:
    """What pixels show of what is labelled, if it is near the camera and has at least the least number of pixels."""
    if not {"depth", "instance"} <= evidence.has or np.linalg.norm(cam_from_box[:3, 3]) > PROOF_M:
        return None
    at = evidence.passes["instance"] == id_
    rows, columns = np.nonzero(at & evidence.has_points)
    if len(rows) < least:
        return None
    points_cam, box_from_cam = evidence.points_cam(rows, columns), invert(cam_from_box)
    apart_m = float(points_cam[:, 1].max()) / evidence.camera.img_from_cam[0, 0]
    return SeenPart("pixels", transform(box_from_cam, points_cam), box_from_cam[:3, 3], apart_m)


def against_box(
    label: str, bound: str, half: Float[np.ndarray, "3"], seen: SeenPart, share: float, sides: Iterable[SideLimit]
) -> Iterator[Result]:
    """Findings if more than a share of the points is outside a box; else where they end before one of these sides."""
    beyond_m = np.abs(seen.points) - half
    n, n_outside = len(seen.points), int((beyond_m > ROOM_M).any(axis=1).sum())
    most = max(MAX_SINGLE, share * n)
    yield Bounded(f"{bound}.outside_{seen.source}", n_outside, most=most)
    if n_outside > most:
        off = f"got {n_outside} of {n} up to {beyond_m.max():.2f} m outside"
        yield Finding("", f"{label}: expected its {seen.source} in its box, {off}")
        return
    for axis, sign, side, most_m in sides:
        gap_m = float(half[axis] - (sign * seen.points[:, axis]).max())
        yield Bounded(f"{bound}.gap_{seen.source}_{side}", gap_m, most=most_m)
        if gap_m > most_m:
            reach = f"expected its {seen.source} to reach the {side} side of its box"
            yield Finding("", f"{label}: {reach}, got them {gap_m:.2f} m before it")
