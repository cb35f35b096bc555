"""Judge what has labels of its own, objects and traffic elements, by depth, ids, the sweep and the image.

What labels count of ids is counted anew. `visible_fraction` is the share of the pixels that a thing would fill, were it
alone, in which it is seen: what something nearer covers of its box bounds this. The lights of a signal must shine where
its state says. That pixels and points are in its box, a row of `seen` says.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.labels.object_labels import ObjectLabel, as_seen, object_document
from synth3dlanes.scene.instance_ids import END, thing_of
from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.truth.object_truth import with_pixel_shares
from synth3dlanes.validate.bodies import FAR_M, box_of, grown, meet
from synth3dlanes.validate.evidence import Evidence, some_pixels
from synth3dlanes.validate.findings import Finding, Result, differences, judged, some
from synth3dlanes.world.placement import PlacedObject

# Lights are judged of signals that are seen as a whole.
MIN_SEEN = 0.99
# The share that the ids of an image show of an element is exact.
MAX_SHARE_ERROR = 0.002
# Heads of which fewer rows are seen are not judged by their colours; how much brighter a dark light may be than a lit
# one, and how far a red cross may be from red, in levels.
MIN_ROWS, BRIGHTER, LEAST_HUE = 18, 50.0, 12.0
LIT = {"off": (), "red": (0,), "red_amber": (0, 1), "amber": (1,), "green": (2,)}
# Signs of red minus green of the lights over lanes.
HUES = {"red_cross": 1, "green_arrow": -1}


def check_counts(evidence: Evidence) -> Iterator[Finding]:
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


# Labels measure shares with at least RAYS rays, passes with pixel centres, of which SLACK_PX may be of something else.
# Of 382 cars and things that are seen, none uses more than 0.4 of the error allowed.
RAYS, SIGMAS, MAX_SHARE_OFF, SLACK_PX = 100, 4.0, 0.03, 2
# Of what something nearer covers of a body's box, the body fills at least THIN times the share that it fills of the
# rest: 0.52 in the median, 0.25 for one car of 80. Of what nothing covers it fills at least SLIVER; rays may miss less.
THIN, SLIVER = 0.35, 0.05


def check_cars(evidence: Evidence) -> Iterator[Result]:
    """Findings where the share of a car, or of a thing, does not fit its pixels and those that something nearer
    covers."""
    items, cars = evidence.labels.objects or (), evidence.labels.car_visible_fraction or ()
    shares = [*cars, *(item.visible_fraction or 0.0 for item in items[len(cars) :])]
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
    """Findings about signals whose dark lights are much brighter than their lit ones, or whose cross or arrow has the
    other's colour."""
    if evidence.image is None or "instance" not in evidence.has:
        return
    for item in evidence.labels.traffic_elements or ():
        yield from shining(evidence, evidence.image, item)


def shining(evidence: Evidence, image: RgbImage, item: ObjectLabel) -> Iterator[Result]:
    """The same of one signal, where it faces the camera and is seen as a whole."""
    box, whole = item.box_px, item.unclipped_box_px
    if item.state is None or item.seen_box_px is None or box is None or whole is None:
        return
    left, top, right, bottom = item.seen_box_px.tolist()
    faces_us = float(item.normal_cam @ item.center_cam) < -0.7 * float(np.linalg.norm(item.center_cam))
    is_whole = (item.visible_fraction or 0.0) >= MIN_SEEN and np.allclose(box, whole)
    if bottom - top < MIN_ROWS or not faces_us or not is_whole:
        return
    own = evidence.passes["instance"][top:bottom, left:right] == item.id
    pixels = np.where(own[..., None], image[top:bottom, left:right], 0).astype(float)
    state = f"traffic_elements.{item.id}.state: expected"
    if item.category == "traffic_light":
        lights = [_brightest(part, part.any(axis=2)) for part in np.array_split(pixels, 3, axis=0)]
        lit = LIT[item.state]
        dark = [level for number, level in enumerate(lights) if number not in lit]
        off = max(dark, default=0.0) - min((lights[number] for number in lit), default=np.inf)
        levels = ", ".join(f"{level:.0f}" for level in lights)
        reason = f"{state} {item.state} lights, got levels of {levels} from the top"
        yield from judged("elements.dark_light", off, reason, most=BRIGHTER)
    elif item.state in HUES:
        chosen = pixels[pixels.max(axis=2) >= np.percentile(pixels.max(axis=2), 90)]
        hue = HUES[item.state] * float((chosen[:, 0] - chosen[:, 1]).mean())
        got = f"{state} the colour of {item.state}, got {-hue:.0f} levels of the other"
        yield from judged("elements.hue", hue, got, least=-LEAST_HUE)


def _brightest(part: Float[np.ndarray, "h w 3"], own: Bool[np.ndarray, "h w"]) -> float:
    """The level of the brightest tenth of the pixels of an element, by their strongest channel."""
    return float(np.percentile(part[own].max(axis=1), 90)) if own.any() else 0.0
