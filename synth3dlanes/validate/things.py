"""Judge how much of each object is seen. `visible_fraction` is the share of the pixels that a thing would fill, were it
alone, in which it is seen: what something nearer covers of its box bounds this. That pixels and points are in its box,
a row of `seen` says."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from synth3dlanes.scene.instance_ids import END, thing_of
from synth3dlanes.validate.bodies import FAR_M, box_of, grown, meet
from synth3dlanes.validate.evidence import Evidence, some_pixels
from synth3dlanes.validate.findings import Result, judged
from synth3dlanes.world.placement import PlacedObject

# Labels measure shares with at least RAYS rays, passes with pixel centres, of which SLACK_PX may be of something else.
# None of 382 cars and things that are seen uses more than 0.4 of the error allowed.
RAYS, SIGMAS, MAX_SHARE_OFF, SLACK_PX = 100, 4.0, 0.03, 2
# Of what something nearer covers of a body's box, the body fills at least THIN times the share that it fills of the
# rest: 0.52 in the median, 0.25 for one car of 80. People whom the image cuts may show an umbrella alone: of these
# nothing is known. Of what nothing covers a body fills at least SLIVER; rays may miss less.
THIN, SLIVER = 0.35, 0.05


def check_cars(evidence: Evidence) -> Iterator[Result]:
    """Findings where the share of a car, or of a thing, does not fit its pixels and those that something nearer
    covers."""
    items, cars = evidence.labels.objects or (), evidence.labels.car_visible_fraction or ()
    shares = [*cars, *(item.visible_fraction or 0.0 for item in items[len(cars) :])]
    counts = np.bincount(evidence.passes["instance"].ravel(), minlength=END)
    for item, place, share in zip(evidence.world.view.objects, evidence.truth.objects or (), shares, strict=False):
        kind, number = thing_of(item.id)
        thin = THIN if kind == "car" or not place.truncation else 0.0
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
    box = grown(box_of(item))
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
