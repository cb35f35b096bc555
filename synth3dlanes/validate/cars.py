"""Check `car_visible_fraction`: the share of the pixels that a car would fill, were it alone, in which it is seen.

A car's box in the image bounds the pixels that it would fill. What the camera sees of it counts, so that long vehicles
alongside are judged too.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.scene.instance_ids import numbers_of
from synth3dlanes.validate.bodies import corners_world, covers, outline
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Bounded, Finding, Result

# Share of a car's projected box that the car fills: 0.52 to 0.93 for all built-in cars; up to 1 for a user's.
FILL, OWN_FILL = (0.5, 0.95), (0.2, 1.0)
# Cars fit their nominal boxes to 1 %, but for mirrors.
MIRROR_ROOM = 1.2
# Labels measure shares with at least RAYS rays, passes with pixel centres. Labels of 1,020 cars that are seen are at
# most 0.02 outside these limits, a fifth of the error allowed.
RAYS, SIGMAS, MAX_SHARE_OFF, SLACK_PX, EDGE_PX = 60, 4.0, 0.03, 6, 1.0
# Boxes that reach farther aside than this cosine of the angle from the viewing axis say less: pixels are stretched.
WIDE = 0.4
# Share of a large box, cut by the image's border, that a car of which there is any pixel fills.
SLIVER = 0.05


def check_cars(evidence: Evidence) -> Iterator[Result]:
    """Findings where a car's share does not fit its number of pixels."""
    shares = evidence.labels.car_visible_fraction
    assert shares is not None
    numbers = numbers_of("car", evidence.passes["instance"].ravel())
    counts = np.bincount(numbers + 1, minlength=len(shares) + 1)[1:]
    for i, share in enumerate(shares):
        low, high = _seen_share(evidence, i, int(counts[i]))
        off, near = max(low - share, share - high, 0.0), low if share < low else high
        seen = Bounded("cars.seen_share", off, most=_error(near))
        yield seen
        if seen.is_beyond:
            yield Finding(
                "",
                f"car_visible_fraction: expected {low:.2f} to {high:.2f} of car {i} by its {counts[i]} pixels, "
                f"got {share:.2f}",
            )


def _seen_share(evidence: Evidence, car: int, n_px: int) -> tuple[float, float]:
    """Limits of the share of a car's pixels that is seen, from their number and the car's box in the image."""
    world, camera = evidence.world, evidence.camera
    corners_cam, outer_cam = (
        transform(invert(camera.world_from_cam), corners_world(world, car, room)) for room in (1.0, MIRROR_ROOM)
    )
    uv, outer = outline(camera, corners_cam), outline(camera, outer_cam)
    if not _n_pixels(outer, camera):
        return 0.0, float(n_px > 0)
    box_px = _n_pixels(uv, camera)
    if not box_px:
        return 0.0, 1.0
    is_wide = (corners_cam[:, 1] < WIDE * np.linalg.norm(corners_cam, axis=1)).any()
    if is_wide or not camera.shows(corners_cam).all():
        # It may show a sliver only; but one without any pixel is not seen.
        return max(n_px - SLACK_PX, 0) / box_px, 1.0 if n_px else min(SLACK_PX / (SLIVER * box_px), 1.0)
    least, most = OWN_FILL if world.scene.assets.cars else FILL
    hull_px = float(ConvexHull(uv).volume)
    return n_px / (most * box_px), min((n_px + SLACK_PX) / (least * hull_px), 1.0)


def _n_pixels(corners: Float[np.ndarray, "n 2"], camera: CameraLabel) -> int:
    """The number of the image's pixels whose centres, or whose neighbours', are inside the hull of corners."""
    if not len(corners):
        return 0
    size = np.array([camera.width_px, camera.height_px])
    low, high = (np.clip(edge, 0, size).astype(int) for edge in (corners.min(axis=0) - 1, corners.max(axis=0) + 2))
    uv = np.stack(np.meshgrid(*(np.arange(*ends) for ends in zip(low, high, strict=True))), axis=-1).reshape(-1, 2)
    return int(covers(corners, uv + 0.5, EDGE_PX).sum())


def _error(share: float) -> float:
    """How far a label may be from this share: it is the mean of some rays that are seen or not."""
    share = min(max(share, 0.0), 1.0)
    return MAX_SHARE_OFF + SIGMAS * float(np.sqrt(share * (1 - share) / RAYS))
