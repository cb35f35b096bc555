"""Check the image against the labels: across every visible delimiter, brightness has its ridge at the label.

Works without passes. Brightness profiles across the line are sampled at equal distances on the road, so that
perspective does not matter, and their median along the line is judged: shadows, cracks and worn paint affect some
profiles, but not the median. Profiles that a car, its shadow or a structure may touch are left out. A line without
contrast is not judged. A line elsewhere must differ from the road on both of its sides alike: the edge of a shadow, of
a puddle or of a new surface does so on one. An image with hardly any line in place is not the labels' image; one whose
lines are clearest together at an offset was shifted or stretched. On a wet road lines without contrast are not asked
for. Images whose paint may not show (`WorldPaint.shows`) are skipped, and those with snow, which lies on the edges of
the road.

Of a photograph without a scene nobody knows which lines are dashed, hidden or worn. Only what shows is judged: where
most of its clear lines together have their paint.
"""

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import CameraLabel, Lane
from synth3dlanes.system.arrays import Points3
from synth3dlanes.validate.bodies import before_or_shading, meet
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Finding, Result, judged

LEAST_PX_PER_M = 1e-3
# Half the length of a profile; its step resolves the narrowest paint (0.1 m).
REACH_M, PROFILE_STEP_M = 1.0, 0.025
# Ridges are searched up to this offset; beyond it the profile may contain the next line's paint.
SEARCH_M = 0.75
# Range of the road beside the paint, in widths of the paint from its middle.
BESIDE = (0.75, 1.75)
# What structures mirror and shade is this far about them.
STRUCTURE_ROOM_M = 0.3
# The extent of the pavement is computed for every ROOM_EVERY-th profile.
ROOM_EVERY = 10
# A ridge this close to its label counts as in place: about half the width of the narrowest paint.
IN_PLACE_M = 0.06
# Least number of profiles of a line: fewer may all lie in one shadow, tar seam or worn stretch.
MIN_PROFILES = 15
# Gray levels of 255 in a line's median: 1 to 4 occur by chance without paint, 5 with paint as gray as the road. In low
# sun a line may have 3, but then it has them in place.
CONTRAST, FAINT, FAINTEST = 12.0, 4.0, 2.5
# The least brightness of a road whose paint stands out: paint that reflects BRIGHTER times as much is, by the curve of
# sRGB, a quarter brighter, and that must be FAINT.
DARK = 16.0
# A road of this brightness leaves paint no room to be brighter, as in the glare of the sun.
WHITE = 240.0
# A ridge elsewhere must be this many times stronger than in place: the edge of a shadow reaches 2.7 times.
STRONGER = 3.0
# An image is judged as a whole from this many profiles on; with a smaller share of them in place it is not the labels'
# image. Of 150 images of `appendix_i` and 102 of `streets` with that many, none fails; judged by the labels of another
# scene, 87 % and 78 % of them fail.
MIN_IMAGE_PROFILES, MIN_SHARE = 60, 0.4
# All lines together are tried at these shifts (pixels) and stretches about the image's middle (shares); a profile
# counts at most MAX_OF_MEDIAN times its line's median. In place, lines are at least 0.99 times as clear as at their
# clearest in 91 images; shifted by 3 px, at most 0.91 times.
MOVES_PX, STRETCHES, MAX_OF_MEDIAN = np.arange(-12, 13) / 2, np.arange(-10, 11) / 200, 1.5
# Less than MIN_MOVE_M on the road is within two steps of the profiles, however many pixels of a large image it is.
MIN_CLEAR, MIN_MOVE_PX, MIN_MOVE_M = 0.95, 2.25, 0.04

# In photographs: the width of paint, in metres, and the most levels by which one profile counts. Paint is found aside
# if its strength is highest beyond FAR_M, and within CLOSE_M below this share of that. Of 85 pictures of a motorway,
# with lines by hand, 51 show two clear lines: none of these is blamed, and 41 and 34 are with their lines 0.5 m to the
# right or to the left.
PAINT_M, MOST_LEVELS, CLOSE_M, FAR_M, ON_LABELS = 0.15, 60.0, 0.1, 0.2, 0.5

OFFSETS_M = np.arange(-REACH_M, REACH_M + PROFILE_STEP_M / 2, PROFILE_STEP_M)
PLACES_M = OFFSETS_M[np.abs(OFFSETS_M) <= SEARCH_M + PROFILE_STEP_M / 2]


class LineProfiles(NamedTuple):
    """One line in the image. For each profile: its column, the pixels per metre along the row, and how much
    brighter than the road to its left and to its right a stripe at each of PLACES_M is."""

    lane: str
    u_px: Float[np.ndarray, " n"]
    px_per_m: Float[np.ndarray, " n"]
    over: Float[np.ndarray, "2 n m"]

    @property
    def ridges(self) -> Float[np.ndarray, "n m"]:
        """How much brighter than its surroundings a stripe is."""
        return np.asarray(self.over.mean(axis=0))

    def verdict(self) -> tuple[Literal["in place", "elsewhere", "unclear"], str]:
        """Where the image shows the line, by the medians of its profiles, and words for a stripe elsewhere: one that
        differs from both of its sides alike."""
        strength = np.abs(np.median(self.ridges, axis=0))
        ridge, ridge_m = strength.max(), PLACES_M[strength.argmax()]
        in_place = strength[np.abs(PLACES_M) <= IN_PLACE_M].max()
        left, right = np.median(self.over, axis=1)
        stripe = np.where(left * right > 0, np.minimum(np.abs(left), np.abs(right)), 0.0)
        if stripe.max() >= CONTRAST and in_place * STRONGER < stripe.max():
            contrast = f"(contrast {stripe.max():.0f} there, {in_place:.0f} in place, {len(self.u_px)} profiles)"
            return "elsewhere", f"got it {PLACES_M[stripe.argmax()]:+.2f} m aside {contrast}"
        if abs(ridge_m) <= IN_PLACE_M:
            return ("in place" if ridge >= FAINTEST else "unclear"), ""
        return ("in place" if in_place >= FAINT and 2 * in_place >= ridge else "unclear"), ""


def check_ridges(evidence: Evidence) -> Iterator[Result]:
    """Findings about lines and the whole image."""
    if evidence.known_world is None:
        yield from _of_photograph(evidence)
        return
    paint = evidence.paint
    if not paint.shows or evidence.scene.weather.snow:
        return
    lanes = [lane for lane in evidence.labels.lanes if lane.kind == "delimiter"]
    lanes = [lane for lane in lanes if paint.stands_out(lane.color or "white")]
    lines = list(_lines(evidence, lanes))
    n, in_place = 0, 0
    for line in lines:
        verdict, found = line.verdict()
        if verdict == "elsewhere":
            yield Finding(line.lane, f"image: expected the line's paint within {IN_PLACE_M} m, {found}")
        if paint.is_dry or verdict != "unclear":
            n, in_place = n + len(line.u_px), in_place + len(line.u_px) * (verdict == "in place")
    if n >= MIN_IMAGE_PROFILES:
        reason = f"image: expected paint under its delimiters, got it under {in_place} of {n} profiles"
        yield from judged("ridges.in_place", in_place / n, reason, MIN_SHARE)
        yield from check_move(lines, evidence.luma.shape[1])


def _of_photograph(evidence: Evidence) -> Iterator[Result]:
    """A finding if the clear lines of a picture without a scene have their paint aside of the labels, all alike."""
    camera, found = evidence.camera, []
    for lane in evidence.labels.lanes:
        points_cam = _every_pixel(camera, lane)
        if lane.kind == "delimiter" and len(points_cam) >= MIN_PROFILES:
            across_cam = np.cross(np.gradient(points_cam, axis=0), camera.road_from_cam[2, :3])
            across_cam /= np.linalg.norm(across_cam, axis=1, keepdims=True)
            profiles = _profiles(camera, points_cam, across_cam, evidence.luma)
            over = _over(profiles[np.isfinite(profiles).all(axis=1)], PAINT_M, (0.0,)).min(axis=0)
            # Dashes are a part of a line: the mean has them, the median may not.
            found.append(np.clip(over, 0, MOST_LEVELS).mean(axis=0) if len(over) >= MIN_PROFILES else np.zeros(1))
    clear = [strength for strength in found if strength.max() >= FAINT]
    if len(clear) > 1:
        strength = np.sum(clear, axis=0)
        aside_m, here = PLACES_M[strength.argmax()], strength[np.abs(PLACES_M) <= CLOSE_M].max()
        agree = sum(abs(PLACES_M[line.argmax()] - aside_m) <= CLOSE_M for line in clear)
        share = float(here / strength.max()) if abs(aside_m) > FAR_M and agree > 1 else 1.0
        reason = f"image: expected the paint of its lines where these are, got it {aside_m:+.2f} m aside"
        yield from judged("ridges.photograph", share, reason, ON_LABELS)


def _lines(evidence: Evidence, lanes: Sequence[Lane]) -> Iterator[LineProfiles]:
    """Lines with enough complete profiles clear of cars and glare; ridges beyond the pavement are set to 0."""
    paint, world, camera = evidence.paint, evidence.world, evidence.camera
    points_cam = {lane: _every_pixel(camera, lane) for lane in lanes}
    strips = {
        lane.id: paint.strip(camera, lane, points) for lane, points in points_cam.items() if len(points) >= MIN_PROFILES
    }
    if not strips:
        return
    number = np.repeat(np.arange(len(strips)), [strip.resolved.sum() for strip in strips.values()])
    middle_cam, across_cam = (
        np.concatenate([values[strip.resolved] for strip, values in of])
        for of in zip(*(((s, s.points_cam), (s, s.across_cam)) for s in strips.values()), strict=True)
    )
    profiles = _profiles(camera, middle_cam, across_cam, evidence.luma)
    whole = np.isfinite(profiles).all(axis=1)
    number, middle_cam, across_cam, profiles = (of[whole] for of in (number, middle_cam, across_cam, profiles))
    ends_cam = (middle_cam[:, None] + np.array([-REACH_M, 0.0, REACH_M])[:, None] * across_cam[:, None]).reshape(-1, 3)
    ends_world, u_px = transform(camera.world_from_cam, ends_cam), camera.project(ends_cam)[:, 0].reshape(-1, 3)
    hidden = before_or_shading(world, ends_world)
    hidden |= meet(evidence.bodies["structure"], world.view.eye_world, ends_world, STRUCTURE_ROOM_M)
    is_clear = ~hidden.reshape(-1, 3).any(axis=1)
    for symbol in evidence.painted["symbol"]:
        is_clear &= symbol.beyond_m(ends_world[1::3, :2]) > REACH_M
    some = np.arange(0, len(number), ROOM_EVERY)
    outside_m = world.ground.clearance(ends_world.reshape(-1, 3, 3)[some].reshape(-1, 3)[:, :2]).reshape(-1, 3)
    for i, id_ in enumerate(strips):
        width_m, stripes_m = paint.width_m(id_), paint.stripes_m(id_)
        at = (number == i) & is_clear
        road = _beside(profiles[at], width_m, stripes_m)
        at[at] = (road < WHITE).all(axis=1) & (road > DARK).all(axis=1)
        reach_m, beyond_m = BESIDE[1] * width_m + max(stripes_m), outside_m[number[some] == i]
        left_m, right_m = (_room(beyond_m[:, 1], beyond_m[:, side]) - reach_m for side in (0, 2))
        if at.sum() >= MIN_PROFILES and min(left_m, right_m) > 0:
            over = _over(profiles[at], width_m, stripes_m)
            over[..., (-left_m > PLACES_M) | (right_m < PLACES_M)] = 0.0
            px_per_m = (u_px[at, 2] - u_px[at, 0]) / (2 * REACH_M)
            # A line across the view, as cameras that look aside see it, has its profiles along columns.
            px_per_m = np.where(np.abs(px_per_m) < LEAST_PX_PER_M, LEAST_PX_PER_M, px_per_m)
            yield LineProfiles(id_, u_px[at, 1], px_per_m, over)


def _beside(
    profiles: Float[np.ndarray, "n k"], width_m: float, stripes_m: tuple[float, ...]
) -> Float[np.ndarray, "n 2"]:
    """The road's brightness on both sides of the paint of every profile."""
    beyond_m = np.stack([min(stripes_m) - OFFSETS_M, OFFSETS_M - max(stripes_m)]) / width_m
    beside = (beyond_m > BESIDE[0]) & (beyond_m < BESIDE[1])
    return profiles @ (beside / beside.sum(axis=1, keepdims=True)).T


def _room(at_m: Float[np.ndarray, " n"], end_m: Float[np.ndarray, " n"]) -> float:
    """How far the pavement extends to one side of a line, at most REACH_M, from the distances outside the pavement of
    points on the line and of the profiles' ends."""
    return float(np.min(REACH_M * at_m / (at_m - np.maximum(end_m, 0)), initial=REACH_M))


def check_move(lines: Sequence[LineProfiles], width_px: int) -> Iterator[Finding]:
    """Finding if all lines together are clearer with the image shifted or stretched. At least two lines must agree and
    none contradict: a single line may lie between a bright road and a dark shoulder."""
    strengths = np.array([_strengths(line, width_px) for line in lines])
    total = strengths.sum(axis=0)
    i, j = np.unravel_index(total.argmax(), total.shape)
    here, there = strengths[:, len(MOVES_PX) // 2, len(STRETCHES) // 2], strengths[:, i, j]
    u_px = np.concatenate([line.u_px for line in lines])
    is_clear = there > CONTRAST / 2 * np.array([len(line.u_px) for line in lines])
    aside_px = np.abs(MOVES_PX[i] + STRETCHES[j] * (u_px - width_px / 2))
    aside_m = aside_px / np.abs(np.concatenate([line.px_per_m for line in lines]))
    is_far = np.median(aside_px) > MIN_MOVE_PX and np.median(aside_m) > MIN_MOVE_M
    agree, contradict = (here < MIN_CLEAR * there)[is_clear], (there < MIN_CLEAR * here)[is_clear]
    if is_far and agree.sum() > 1 and not contradict.any() and here.sum() < MIN_CLEAR * there.sum():
        yield Finding(
            "",
            f"image: expected paint under its delimiters, got it clearest {MOVES_PX[i]:+.1f} px to the right and "
            f"stretched by {100 * STRETCHES[j]:+.1f} %",
        )


def _strengths(line: LineProfiles, width_px: int) -> Float[np.ndarray, "a b"]:
    """The line's clarity for each shift and stretch of the image, summed over its profiles."""
    aside_px = MOVES_PX[:, None, None] + STRETCHES[:, None] * (line.u_px - width_px / 2)
    place = np.rint((aside_px / line.px_per_m + SEARCH_M) / PROFILE_STEP_M).astype(int)
    inside = (place >= 0) & (place < len(PLACES_M))
    ridges = line.ridges[np.arange(len(line.ridges)), np.clip(place, 0, len(PLACES_M) - 1)]
    most = MAX_OF_MEDIAN * np.abs(np.median(line.ridges, axis=0)).max()
    return np.abs(np.clip(np.where(inside, ridges, 0.0), -most, most).sum(axis=2))


def _every_pixel(camera: CameraLabel, lane: Lane) -> Float[np.ndarray, "n 3"]:
    """Points about one pixel apart in the image along the visible part of a line; perspective is linear in 1/y,
    and about so in 1/distance through lenses."""
    seen = lane.visible & (lane.xyz_cam[:, 1] < PROOF_M)
    uv = camera.project(lane.xyz_cam)
    pieces = [np.zeros((0, 3))]
    for i in np.flatnonzero(seen[:-1] & seen[1:]):
        a, b = lane.xyz_cam[i : i + 2]
        n = max(1, int(np.hypot(*(uv[i + 1] - uv[i]))))
        share = (np.arange(n) + 0.5) / n
        near, far = (a[1], b[1]) if camera.lens.is_pinhole else (np.linalg.norm(a), np.linalg.norm(b))
        share = share * near / (far + share * (near - far))
        pieces.append(a + share[:, None] * (b - a))
    return np.concatenate(pieces)


def _profiles(
    camera: CameraLabel, middle_cam: Points3, across_cam: Points3, luma: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "n k"]:
    """Brightness profiles across lines; NaN outside the image."""
    points = middle_cam[:, None] + OFFSETS_M[:, None] * across_cam[:, None]
    u, v = camera.project(points.reshape(-1, 3)).T
    height_px, width_px = luma.shape
    with np.errstate(invalid="ignore"):
        inside = (u >= 0) & (u <= width_px) & (v >= 0) & (v <= height_px)
    values = np.full(len(u), np.nan)
    values[inside] = map_coordinates(luma, [v[inside] - 0.5, u[inside] - 0.5], order=1, mode="nearest")
    return values.reshape(points.shape[:2])


def _over(
    profiles: Float[np.ndarray, "n k"], width_m: float, stripes_m: tuple[float, ...]
) -> Float[np.ndarray, "2 n m"]:
    """How much brighter stripes of the paint's width are than their left and right, for lines at the offsets
    PLACES_M."""
    weights = np.zeros((2, len(OFFSETS_M), len(PLACES_M)))
    for j, place_m in enumerate(PLACES_M):
        aside_m = OFFSETS_M - place_m - np.array(stripes_m)[:, None]
        away, right = np.abs(aside_m).min(axis=0) / width_m, aside_m.mean(axis=0) > 0
        stripe, beside = away < 0.5, (away > BESIDE[0]) & (away < BESIDE[1])
        for side, of in enumerate((beside & ~right, beside & right)):
            weights[side, :, j] = stripe / max(stripe.sum(), 1) - of / max(of.sum(), 1)
    return profiles @ weights
