"""Check what the image is by itself: exposed, textured, its channels in order, and detailed at its full resolution.

Works without passes, which only say more exactly what is terrain and road. A user's own terrain may have any colour and
is not asked for its channels' order; nor is snow, or the blue light after sunset.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.validate.bodies import may_show_cars, meet
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Bounded, Finding, Measure, Result
from synth3dlanes.world.visibility import seen_over_ground

# Largest share of white pixels, and least mean brightness. A bright sky in fog may fill half the image, unclipped.
MAX_CLIPPED, MIN_MEAN = 0.5, 8.0
# Blender shows missing textures in pink. Cars may be pink, ground is not.
MAX_PINK_OF_GROUND, MAX_PINK = 0.02, 0.5
GROUND = ("terrain", "road", "shoulder", "marking")

# Sampled places: metres ahead of the camera, metres beside the pavement, and least distance from any pavement.
AHEAD_M, ASIDE_M, CLEAR_M = np.arange(6.0, 80.0, 2.0), np.array([2.0, 3.5, 5.0, 7.0, 9.0, 12.0]), 1.5
# Some places show trees, which may be bluish, so a high percentile of red minus blue is used. It is at least 3 levels
# of 255 in 280 rendered images, including the densest fog, and at least 0 in 100 images of 96x72 pixels. Fewer places
# than MIN_PLACES are not judged. With semantic ids, all pixels of terrain within NEAR_M are used instead.
LOWEST_SUN_RAD = 1.5
WARMEST, MIN_WARMTH, MIN_PLACES, NEAR_M = 67, -2.0, 30, 80.0

# At most this many pixels in the middle of the image are used; images with fewer than MIN_PX are not judged.
MAX_PX, MIN_PX = 200_000, 5_000
# Share of the brightness steps that count as the steepest, and upper limit of a pixel's contribution to fine detail.
STEEPEST, MOST = 0.01, 20.0
# In 1,260 rendered images, including PNG, evenness is at least 0.88 and coarseness at most 1.09. After halving and
# upscaling them, evenness is below 0.78 or coarseness above 1.4.
MIN_EVENNESS, MAX_COARSENESS = 0.8, 1.33
# Coarser JPEG has no detail of single pixels, nor has dense fog.
SHARP_JPEG, FOG_M = 90, 150.0
# Nor has what passes a camera that looks aside: the distance at which the host's motion blurs it by MAX_BLUR_PX.
ASIDE_BLUR_M, MAX_BLUR_PX = 10.0, 1.0


class Detail(NamedTuple):
    """Ratios that measure an image's resolution: `width`, steps beside the steepest ones over these; `fineness`, detail
    of one pixel over that of two; `evenness`, mean steps in odd and even pixel pairs, the smaller over the larger."""

    width: float
    fineness: float
    evenness: float

    @property
    def coarseness(self) -> float:
        """Small for an image with detail of single pixels."""
        return self.width / (self.fineness * self.evenness)


def check_frame(evidence: Evidence) -> Iterator[Result]:
    """Findings about exposure and textures, and measure `clipped_share`: the share of pixels with a channel at 0 or
    255."""
    image, passes = evidence.picture, evidence.passes
    red, green, blue = np.moveaxis(image, -1, 0)
    darkest, brightest = np.minimum(np.minimum(red, green), blue), np.maximum(np.maximum(red, green), blue)
    white = float((darkest == 255).mean())
    yield Bounded("picture.mean", float(image.mean()), MIN_MEAN)
    yield Bounded("picture.white", white, most=MAX_CLIPPED)
    if image.mean() < MIN_MEAN:
        yield Finding("", f"image: expected a picture, got black (mean {image.mean():.1f} of 255)")
    if white > MAX_CLIPPED:
        yield Finding("", f"image: expected a picture, got {100 * white:.0f} % of it white")
    pink = (np.minimum(red, blue) > 100) & (np.minimum(red, blue) // 2 > green)
    limit = MAX_PINK
    if "semantic" in passes:
        pink = pink[np.isin(passes["semantic"], [SEMANTIC_IDS[name] for name in GROUND])]
        limit = MAX_PINK_OF_GROUND
    share = float(pink.mean()) if pink.size else 0.0
    if share > limit and "semantic" not in passes:
        of_cars = may_show_cars(evidence.world, evidence.camera, np.argwhere(pink)[:, ::-1] + 0.5, np.inf)
        share -= float(of_cars.sum()) / pink.size
    yield Bounded("picture.pink", share, most=limit)
    if share > limit:
        yield Finding("", f"image: expected textures, got {100 * share:.0f} % of the ground pink")
    clipped = float(((darkest == 0) | (brightest == 255)).mean())
    yield Measure("clipped_share", np.zeros(1), np.array([clipped]))


def check_colours(evidence: Evidence) -> Iterator[Result]:
    """Finding if terrain is bluer than it is red."""
    image, passes, scene = evidence.picture, evidence.passes, evidence.scene
    if scene.assets.terrains or scene.weather.snow or scene.light.sun_zenith_rad > LOWEST_SUN_RAD:
        return
    if "semantic" in passes:
        is_terrain = passes["semantic"] == SEMANTIC_IDS["terrain"]
        pixels = image[is_terrain & (passes["depth"] < NEAR_M) if "depth" in passes else is_terrain]
    else:
        column, row = _terrain_img(evidence).astype(int).T
        pixels = image[row, column]
    if len(pixels) < MIN_PLACES:
        return
    red, _, blue = pixels.astype(float).T
    warmth = float(np.percentile(red - blue, WARMEST))
    yield Bounded("picture.warmth", warmth, MIN_WARMTH)
    if warmth < MIN_WARMTH:
        yield Finding(
            "", f"image: expected red, green and blue in this order, got terrain with {-warmth:.0f} more blue than red"
        )


def check_sharpness(evidence: Evidence) -> Iterator[Result]:
    """Finding if the image has been upscaled or blurred."""
    scene = evidence.scene
    is_clear = scene.sensor.jpeg_quality >= SHARP_JPEG and scene.air.visibility_m >= FOG_M
    aside_m = scene.sensor.motion_blur_m * abs(np.sin(scene.camera.yaw_rad))
    is_clear &= bool(scene.camera.fx_px * aside_m / ASIDE_BLUR_M <= MAX_BLUR_PX)
    # Clouds are soft, and the back of a van is smooth.
    if not is_clear or not any(lane.visible.any() for lane in evidence.labels.lanes):
        return
    detail = _detail(_middle(evidence.luma))
    if detail is None:
        return
    yield Bounded("picture.evenness", detail.evenness, MIN_EVENNESS)
    yield Bounded("picture.coarseness", detail.coarseness, most=MAX_COARSENESS)
    if detail.evenness < MIN_EVENNESS or detail.coarseness > MAX_COARSENESS:
        yield Finding(
            "",
            f"image: expected detail of single pixels, got a blurred or blown-up picture (coarseness "
            f"{detail.coarseness:.2f} of at most {MAX_COARSENESS}, evenness {detail.evenness:.2f} of at least "
            f"{MIN_EVENNESS})",
        )


def _terrain_img(evidence: Evidence) -> Float[np.ndarray, "n 2"]:
    """Pixels that show terrain, unless a tree hides it."""
    world, camera, ground = evidence.world, evidence.camera, evidence.world.ground
    away_m = np.concatenate([-AHEAD_M, AHEAD_M]) if ground.both_ways else AHEAD_M
    xy = ground.beside_pavement(world.view.camera.y_m + away_m, ASIDE_M)
    xy = xy[ground.clearance(xy) > CLEAR_M]
    points_world = np.column_stack([xy, ground.height(xy)])
    eye_world = camera.world_from_cam[:3, 3]
    points_world = points_world[seen_over_ground(ground, eye_world, points_world)]
    points_world = points_world[~meet(evidence.bodies["structure"], eye_world, points_world)]
    points_cam = transform(invert(camera.world_from_cam), points_world)
    uv = camera.project(points_cam)
    with np.errstate(invalid="ignore"):
        uv = uv[((uv >= 0) & (uv < [camera.width_px, camera.height_px])).all(axis=1)]
    return uv[~may_show_cars(world, camera, uv, AHEAD_M[-1])]


def _middle(luma: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "r c"]:
    """The brightness in the middle of the image, cut at even pixels."""
    height, width = luma.shape
    part = min(1.0, np.sqrt(MAX_PX / (height * width)))
    rows, columns = 2 * int(height * part / 2), 2 * int(width * part / 2)
    top, left = (height - rows) // 4 * 2, (width - columns) // 4 * 2
    return luma[top : top + rows, left : left + columns]


def _detail(luma: Float[np.ndarray, "r c"]) -> Detail | None:
    """The mean of the ratios along rows and columns; None for an image that is too small or uniform."""
    found = []
    for values in (luma, luma.T):
        steps = np.abs(np.diff(values, axis=1))
        inner = steps[:, 1:-1]
        n_steepest = int(STEEPEST * inner.size)
        steep = inner >= np.partition(inner, -n_steepest, axis=None)[-n_steepest] if n_steepest else inner < 0
        odd, even = steps[:, 0::2].mean(), steps[:, 1::2].mean()
        fine, coarse = (_curvature(values, reach) for reach in (1, 2))
        if luma.size < MIN_PX or not inner[steep].sum() or not min(fine, coarse, max(odd, even)):
            return None
        width = (steps[:, 2:] + steps[:, :-2])[steep].sum() / 2 / inner[steep].sum()
        found.append((width, fine / coarse, min(odd, even) / max(odd, even)))
    return Detail(*np.mean(found, axis=0))


def _curvature(values: Float[np.ndarray, "r c"], reach: int) -> float:
    """Mean difference between pixels and the mean of their neighbours at `reach`; limited for strong edges."""
    middle = values[:, 2:-2]
    before, after = values[:, 2 - reach : -2 - reach], values[:, 2 + reach : values.shape[1] - 2 + reach]
    return float(np.minimum(np.abs(middle - (before + after) / 2), MOST).mean())
