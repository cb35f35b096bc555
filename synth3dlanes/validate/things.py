"""Judge what has labels of its own, objects and traffic elements, by what depth, ids, the sweep and the image show.

Points of what is labelled must be in its box, and those of pixels reach the sides that are seen. A box that is too
small, turned or moved is found by points outside it, one that is too large by the gap before a side. `visible_fraction`
is the share of the pixels that a thing would fill, were it alone, in which it is seen: what something nearer covers of
its box bounds this. What labels count of ids is counted anew. The lights of a signal must shine where its state says.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.object_labels import ObjectLabel, as_seen, object_document
from synth3dlanes.scene.instance_ids import END, thing_of
from synth3dlanes.scene.scene import Scene
from synth3dlanes.truth.object_truth import with_pixel_shares
from synth3dlanes.validate.bodies import FAR_M, box_of, grown, meet
from synth3dlanes.validate.documents import differences, some
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Finding, Result, counted, judged
from synth3dlanes.validate.pixels import some_pixels
from synth3dlanes.world.objects import PlacedObject

# How far outside a box points may be, and how many of them farther.
ROOM_M, MAX_SINGLE = 0.02, 2
# Sides are judged only of what is seen as a whole.
MIN_SEEN = 0.99
# Of objects and of faces of elements: the least number of points, the share of these that may be outside a box
# (built-in models reach at most 2 cm beyond theirs), how far before a side pixels may end, and which part of what lies
# between two of them.
MIN_POINTS, MAX_OUTSIDE, MAX_GAP_M, MAX_PART = 150, 0.002, 0.035, 0.75
MIN_PIXELS, MAX_FACE_OUTSIDE, MAX_FACE_GAP_M, MAX_FACE_PART = 60, 0.01, 0.03, 1.0
# A board may reach a side in a corner alone.
OF_CORNER = {"road_sign": 1.5}
# The eye is this far beyond a side that it sees. Of the others pixels show the outline, which is as wide and as high.
BEYOND_M, ACROSS, ALONG, UP = 0.5, 0, 1, 2
SIDES = ((0, -1, "left"), (0, 1, "right"), (1, -1, "rear"), (1, 1, "front"), (2, -1, "lower"), (2, 1, "upper"))
# The lowest, highest and widest parts are this share of half the length behind the nearer end, at most. Wheels are at
# least WHEELS_M behind: they are hidden as a whole by an end that is CLEARANCE_M over the ground, or higher.
SET_BACK, WHEELS_M, CLEARANCE_M = 0.25, 1.1, 0.15
# The most that mirrors reach beyond a body.
MIRROR_M = 0.07


# The share that the ids of an image show of an element is exact.
MAX_SHARE_ERROR = 0.002
# Heads of which fewer rows are seen are not judged by their colours; how much brighter a dark light may be than a lit
# one, and how far a red cross may be from red, in levels.
MIN_ROWS, BRIGHTER, LEAST_HUE = 18, 50.0, 12.0
LIT = {"off": (), "red": (0,), "red_amber": (0, 1), "amber": (1,), "green": (2,)}
# Signs of red minus green of the lights over lanes.
HUES = {"red_cross": 1, "green_arrow": -1}


class SeenPart(NamedTuple):
    """Points of what is labelled in its frame; of pixels the eye in it, and how far points are from each other at
    most."""

    source: str
    points: Float[np.ndarray, "n 3"]
    eye: Float[np.ndarray, "3"] | None = None
    apart_m: float = 0.0


class SideLimit(NamedTuple):
    """A side of a box: its axis, its sign on that, its name, and how far before it points may end."""

    axis: int
    sign: int
    name: str
    most_m: float


def check_boxes(evidence: Evidence) -> Iterator[Result]:
    """Findings about objects and elements that are not where pixels and points show them."""
    yield from _recounted(evidence)
    objects, elements = evidence.labels.objects or (), evidence.labels.traffic_elements or ()
    wheels_m = _wheels_m(evidence.scene) if objects else []
    for item in (*objects, *elements):
        for seen in views_of(evidence, item):
            series, number = thing_of(item.id)
            is_known = series == "car" and number < len(wheels_m)
            yield from judge(item, seen, wheels_m[number] if is_known else WHEELS_M)


def _recounted(evidence: Evidence) -> Iterator[Finding]:
    """Findings where labels count other pixels and points than ids show."""
    labels, returns = evidence.labels, None if evidence.returns is None else evidence.returns.instance
    instance = evidence.passes.get("instance")
    for group, items in (("objects", labels.objects or ()), ("traffic_elements", labels.traffic_elements or ())):
        shown = np.zeros((0, 0), dtype=int) if instance is None else instance
        beams = returns if group == "objects" else None
        for item, anew in zip(items, as_seen(items, shown, beams), strict=True):
            known = anew if instance is not None else replace(anew, seen_box_px=item.seen_box_px)
            wrong = list(differences(object_document(known), object_document(item)))
            if wrong:
                yield Finding("", f"{group}.{item.id}: {some(wrong)}")
    if instance is None:
        return
    shares = {item.id: item.visible_fraction for item in labels.traffic_elements or ()}
    asked = [item for item in evidence.truth.traffic_elements or () if shares.get(item.id) is not None]
    for item in with_pixel_shares(asked, evidence.world.site, evidence.camera, instance):
        share, got = item.visible_fraction or 0.0, shares[item.id] or 0.0
        if abs(share - got) > MAX_SHARE_ERROR:
            reason = f"expected {share:g} by its pixels, got {got:g}"
            yield Finding("", f"traffic_elements.{item.id}.visible_fraction: {reason}")


def _wheels_m(scene: Scene) -> list[float]:
    """How far behind the ends of each car its wheels are, at least WHEELS_M."""
    models = [(scene.assets.car_models[car.model - 1], car.scale) for car in scene.cars]
    return [
        max(WHEELS_M, scale * ((model.length_m - model.wheelbase_m) / 2 - model.wheel_radius_m))
        for model, scale in models
    ]


def views_of(evidence: Evidence, item: ObjectLabel) -> list[SeenPart]:
    """What pixels show of what is labelled, and points of an object, if it is near the camera and there are enough."""
    found, box_from_cam = [], invert(item.cam_from_object)
    if np.linalg.norm(item.center_cam) > PROOF_M:
        return []
    if {"depth", "instance"} <= evidence.has:
        rows, columns = np.nonzero((evidence.passes["instance"] == item.id) & evidence.has_points)
        if len(rows) >= (MIN_PIXELS if item.is_element else MIN_POINTS):
            points_cam = evidence.points_cam(rows, columns)
            apart_m = float(points_cam[:, 1].max()) / evidence.camera.img_from_cam[0, 0]
            found.append(SeenPart("pixels", transform(box_from_cam, points_cam), box_from_cam[:3, 3], apart_m))
    points = evidence.returns
    if points is not None and not item.is_element:
        own = points.instance == item.id
        if own.sum() >= MIN_POINTS:
            found.append(SeenPart("points", transform(box_from_cam, points.xyz_cam[own])))
    return found


def judge(item: ObjectLabel, seen: SeenPart, wheels_m: float = WHEELS_M) -> Iterator[Result]:
    """Findings where points are outside the box of an object, whose wheels are `wheels_m` behind its ends, or of an
    element; else where pixels end before a side that they show."""
    half, source = item.size_m / 2, seen.source
    group, bound = ("traffic_elements", "elements") if item.is_element else ("objects", "boxes")
    share = MAX_FACE_OUTSIDE if item.is_element else MAX_OUTSIDE
    beyond_m = np.abs(seen.points) - half
    outside, label = (beyond_m > ROOM_M).any(axis=1), f"{group}.{item.id}"
    reason = f"{label}: expected its {source} in its box, got {{wrong}} of {{n}} up to {beyond_m.max():.2f} m outside"
    yield from counted(f"{bound}.outside_{source}", outside, reason, MAX_SINGLE, share)
    if outside.sum() > max(MAX_SINGLE, share * len(outside)) or not _is_whole(item) or seen.eye is None:
        return
    # The box of a person is around all steps, and the ends of a bicycle are thin.
    of_car = _sides(half, seen.eye, seen.apart_m, wheels_m) if thing_of(item.id)[0] == "car" else ()
    for axis, sign, side, most_m in _sides_of_face(item, seen.apart_m) if item.is_element else of_car:
        gap_m = float(half[axis] - (sign * seen.points[:, axis]).max())
        reason = f"expected its {source} to reach the {side} side of its box, got them {gap_m:.2f} m before it"
        yield from judged(f"{bound}.gap_{source}_{side}", gap_m, f"{label}: {reason}", most=most_m)


def _is_whole(item: ObjectLabel) -> bool:
    """Whether it is in the image and seen as a whole."""
    box, whole = item.box_px, item.unclipped_box_px
    is_inside = item.truncation == 0 or (
        item.is_element and box is not None and whole is not None and bool(np.allclose(box, whole))
    )
    return is_inside and (item.visible_fraction or 0.0) >= MIN_SEEN


def _sides_of_face(item: ObjectLabel, apart_m: float) -> Iterator[SideLimit]:
    """The sides of an element's face."""
    most_m = MAX_FACE_GAP_M + (MAX_FACE_PART + OF_CORNER.get(item.category, 0.0)) * apart_m
    yield from (SideLimit(axis, sign, side, most_m) for axis, sign, side in SIDES if axis != ALONG)


def _sides(
    half: Float[np.ndarray, "3"], eye: Float[np.ndarray, "3"], apart_m: float, wheels_m: float
) -> Iterator[SideLimit]:
    """The sides that pixels show: those of the outline, and an end that looks at the eye."""
    for axis, sign, side in SIDES:
        if axis != ALONG or sign * eye[axis] > half[axis] + BEYOND_M:
            hidden_m = 0.0 if axis == ALONG else _hidden_m(half, eye, (axis, sign), wheels_m)
            yield SideLimit(axis, sign, side, MAX_GAP_M + MAX_PART * apart_m + hidden_m)


def _hidden_m(
    half: Float[np.ndarray, "3"], eye: Float[np.ndarray, "3"], side: tuple[int, int], wheels_m: float
) -> float:
    """How far before a side what is set back from an object's nearer end may be hidden by this end: wheels under a
    bumper from an eye above it, what stands on a roof from one below it, mirrors, the far side of a body that grows
    wider."""
    axis, sign = side
    away_m, aside_m = max(abs(float(eye[ALONG])) - half[ALONG], 0.0), half[axis] - sign * eye[axis]
    share, of_wheels = (back_m / (away_m + back_m) for back_m in (SET_BACK * half[ALONG], wheels_m))
    if axis == UP and sign < 0 and aside_m * of_wheels > CLEARANCE_M:
        return float(aside_m * of_wheels)
    if axis != ACROSS:
        return float(max(aside_m, 0.0) * share)
    # A body hides its far side from an eye beyond the near one, and the mirror there from one beyond the middle.
    mirror_m = min(aside_m * share, MIRROR_M) if sign * eye[axis] < 0 else 0.0
    return float(max((aside_m - 2 * half[axis]) * share, mirror_m))


# Labels measure shares with at least RAYS rays, passes with pixel centres, of which SLACK_PX may be of something else.
# Of 382 cars and things that are seen, none uses more than 0.4 of the error allowed.
RAYS, SIGMAS, MAX_SHARE_OFF, SLACK_PX = 100, 4.0, 0.03, 2
# Of what something nearer covers of a body's box, the body fills at least THIN times the share that it fills of the
# rest: 0.52 in the median, 0.25 for one car of 80. Of what nothing covers it fills at least SLIVER; rays may miss less.
THIN, SLIVER = 0.35, 0.05


def check_cars(evidence: Evidence) -> Iterator[Result]:
    """Findings where the share of a car, or of a thing, does not fit its pixels and those that something nearer
    covers."""
    items, cars = evidence.labels.objects, evidence.labels.car_visible_fraction
    assert cars is not None
    # Of older labels only those of cars are known.
    shares = [*cars, *(item.visible_fraction or 0.0 for item in (items or ())[len(cars) :])]
    counts = np.bincount(evidence.passes["instance"].ravel(), minlength=END)
    for item, place, share in zip(evidence.world.view.objects, evidence.truth.objects or (), shares, strict=False):
        kind, number = thing_of(item.id)
        low, high = _seen_share(evidence, item, place.box_px)
        off, near = max(low - share, share - high, 0.0), low if share < low else high
        expected = f"{low:.2f} to {high:.2f} of {kind} {number} by its {counts[item.id]} pixels"
        reason = f"{kind}_visible_fraction: expected {expected}, got {share:.2f}"
        # It is the mean of some rays that are seen or not.
        error = MAX_SHARE_OFF + SIGMAS * float(np.sqrt(near * (1 - near) / RAYS))
        yield from judged(f"{kind}s.seen_share", off, reason, most=error)


def _seen_share(evidence: Evidence, item: PlacedObject, box_px: Float[np.ndarray, "4"] | None) -> tuple[float, float]:
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
    box = grown(box_of(item))
    is_it = own | meet(box, eye, ends)
    if has_depth:
        hit = evidence.has_points[rows, columns]
        ends[hit] = evidence.points_world(rows[hit], columns[hit])
    n, n_box, n_open = (int(of.sum()) for of in (own, is_it, own | (is_it & meet(box, eye, ends))))
    covered = n_box - n_open
    most = n + covered if has_depth and n >= SLIVER * n_box else n_box
    # Along its edges the ground may be nearer than a box that is sunk into it.
    hidden = THIN * max(covered - np.sqrt(n_box), 0.0)
    low, high = max(n - SLACK_PX, 0) / max(most, 1), (n_open + SLACK_PX) / (n_open + SLACK_PX + hidden)
    return low, high if n or not n_open else min(high, SLACK_PX / (SLIVER * n_open))


def check_elements(evidence: Evidence) -> Iterator[Result]:
    """Findings about traffic elements in another state than their lights show."""
    items = evidence.labels.traffic_elements
    if items is None or "instance" not in evidence.has:
        return
    for item in items:
        yield from shining(evidence, item)


def shining(evidence: Evidence, item: ObjectLabel) -> Iterator[Result]:
    """A signal whose dark lights are much brighter than its lit ones, or a cross or arrow of the other colour."""
    if evidence.image is None or item.state is None or item.seen_box_px is None:
        return
    left, top, right, bottom = item.seen_box_px.tolist()
    faces_us = float(item.normal_cam @ item.center_cam) < -0.7 * float(np.linalg.norm(item.center_cam))
    if bottom - top < MIN_ROWS or not faces_us or not _is_whole(item):
        return
    own = evidence.passes["instance"][top:bottom, left:right] == item.id
    pixels = np.where(own[..., None], evidence.image[top:bottom, left:right], 0).astype(float)
    if item.category == "traffic_light":
        lights = [_brightest(part, part.any(axis=2)) for part in np.array_split(pixels, 3, axis=0)]
        lit = LIT[item.state]
        dark = [level for number, level in enumerate(lights) if number not in lit]
        off = max(dark, default=0.0) - min((lights[number] for number in lit), default=np.inf)
        levels = ", ".join(f"{level:.0f}" for level in lights)
        reason = f"traffic_elements.{item.id}.state: expected {item.state} lights, got levels of {levels} from the top"
        yield from judged("elements.dark_light", off, reason, most=BRIGHTER)
    elif item.state in HUES:
        chosen = pixels[pixels.max(axis=2) >= np.percentile(pixels.max(axis=2), 90)]
        hue = HUES[item.state] * float((chosen[:, 0] - chosen[:, 1]).mean())
        got = f"expected the colour of {item.state}, got {-hue:.0f} levels of the other"
        yield from judged("elements.hue", hue, f"traffic_elements.{item.id}.state: {got}", least=-LEAST_HUE)


def _brightest(part: Float[np.ndarray, "h w 3"], own: Bool[np.ndarray, "h w"]) -> float:
    """The level of the brightest tenth of the pixels of an element, by their strongest channel."""
    return float(np.percentile(part[own].max(axis=1), 90)) if own.any() else 0.0
