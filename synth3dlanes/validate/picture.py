"""Check what the image is by itself: exposed, textured, its channels in order, detailed at its full resolution; colours
and light of what the passes name, in clear daylight; and edges where the passes have them.

Where two neighbouring pixels of the passes show different objects, the image's brightness changes more between these
two pixels than between others nearby. This holds in fog, with motion blur and in every part of an image, so it finds
an image that is shifted or stretched by a pixel, or that belongs to another scene, in any sample.

A user's own terrain may have any colour and is not asked for its channels' order; nor is snow, or the blue light after
sunset. Colours are compared with that of the road in the same picture, so that the sun's and the sky's do not matter:
as chroma, which is the share of a channel in the light, minus that of the road.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation, binary_opening

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.imaging.sky import sun_direction
from synth3dlanes.scene.instance_ids import numbers_of
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.system.arrays import Passes
from synth3dlanes.validate.bodies import before_or_shading, meet
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Finding, Result, judged
from synth3dlanes.validate.paint import MAX_DRY
from synth3dlanes.world.visibility import seen_over_ground

# Largest share of white pixels, and least mean brightness. A bright sky in fog may fill half the image, unclipped.
MAX_CLIPPED, MIN_MEAN = 0.5, 8.0
# Blender shows missing textures in pink, which ground is not.
MAX_PINK = 0.02
GROUND = ("terrain", "road", "shoulder", "marking")
GROUNDS = (GROUND, ("terrain",))

# Sampled places: metres ahead of the camera, metres beside the pavement, and least distance from any pavement.
AHEAD_M, ASIDE_M, CLEAR_M = np.arange(6.0, 80.0, 2.0), np.arange(6.0, 20.0, 2.0), 1.5
# Some places show trees, which may be bluish, so a high percentile of red minus blue is used. It is at least 3 levels
# of 255 in 280 rendered images, including the densest fog, and at least 0 in 100 images of 96x72 pixels. Fewer places
# than MIN_PLACES are not judged. With semantic ids, all pixels of terrain within TERRAIN_WITHIN_M are used instead.
LOWEST_SUN_RAD = 1.5
WARMEST, MIN_WARMTH, MIN_PLACES, TERRAIN_WITHIN_M = 67, -2.0, 30, 80.0

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


def _judged(
    name: str, value: float, words: str, least: float = -np.inf, most: float = np.inf, lane: str = ""
) -> Iterator[Result]:
    """A number of the image; `words` say what is expected, and what it is instead, with a place for the number."""
    yield from judged(name, value, f"image: expected {words.format(value)}", least, most, lane)


def check_frame(evidence: Evidence) -> Iterator[Result]:
    """Findings about exposure."""
    image = evidence.picture
    white = float((image.min(axis=2) == 255).mean())
    mean = float(image.mean())
    yield from _judged("picture.mean", mean, "a picture, got black (mean {:.1f} of 255)", MIN_MEAN)
    yield from _judged("picture.white", white, "a picture, got {:.0%} of it white", most=MAX_CLIPPED)


def check_colours(evidence: Evidence) -> Iterator[Result]:
    """Findings if ground is pink, or terrain bluer than it is red."""
    image, passes, scene = evidence.picture, evidence.passes, evidence.scene
    if "semantic" in passes:
        is_ground, is_terrain = (np.isin(passes["semantic"], [SEMANTIC_IDS[name] for name in of]) for of in GROUNDS)
        if "depth" in passes:
            is_terrain &= passes["depth"] < TERRAIN_WITHIN_M
        of_ground, pixels = image[is_ground], image[is_terrain]
    else:
        column, row = _terrain_img(evidence).astype(int).T
        of_ground = pixels = image[row, column]
    if len(of_ground) >= MIN_PLACES:
        red, green, blue = of_ground.T
        pink = float(((np.minimum(red, blue) > 100) & (np.minimum(red, blue) // 2 > green)).mean())
        yield from _judged("picture.pink", pink, "textures, got {:.0%} of the ground pink", most=MAX_PINK)
    is_told = not (scene.assets.terrains or scene.weather.snow) and scene.light.sun_zenith_rad <= LOWEST_SUN_RAD
    if len(pixels) >= MIN_PLACES and is_told:
        red, _, blue = pixels.astype(float).T
        warmth = float(np.percentile(red - blue, WARMEST))
        words = "red, green and blue in this order, got terrain with {:+.0f} of red over blue"
        yield from _judged("picture.warmth", warmth, words, MIN_WARMTH)


def check_sharpness(evidence: Evidence) -> Iterator[Result]:
    """Finding if the image has been upscaled or blurred."""
    scene = evidence.scene
    is_clear = scene.sensor.jpeg_quality >= SHARP_JPEG and scene.air.visibility_m >= FOG_M
    is_clear &= _aside_px(scene) <= MAX_BLUR_PX
    # Clouds are soft, and the back of a van is smooth.
    if not is_clear or not any(lane.visible.any() for lane in evidence.labels.lanes):
        return
    detail = _detail(_middle(evidence.luma))
    if len(detail):
        width, fineness, evenness = detail
        words = "detail of single pixels, got a blurred or blown-up picture, of "
        coarseness = float(width / (fineness * evenness))
        yield from _judged("picture.coarseness", coarseness, words + "coarseness {:.2f}", most=MAX_COARSENESS)
        yield from _judged("picture.evenness", float(evenness), words + "evenness {:.2f}", MIN_EVENNESS)


def _aside_px(scene: Scene) -> float:
    """How far the host's motion blurs what passes a camera that looks aside."""
    aside_m = scene.sensor.motion_blur_m * abs(np.sin(scene.camera.yaw_rad))
    return float(scene.camera.fx_px * aside_m / ASIDE_BLUR_M)


def _terrain_img(evidence: Evidence) -> Float[np.ndarray, "n 2"]:
    """Pixels that show terrain, unless a tree hides it."""
    world, camera, ground = evidence.world, evidence.camera, evidence.world.ground
    away_m = np.concatenate([-AHEAD_M, AHEAD_M]) if ground.way.both_ways else AHEAD_M
    way, aside_m = world.network.way, np.concatenate([-ASIDE_M, ASIDE_M])
    s = np.clip(world.network.stations(world.view.camera.y_m + away_m), way.start_m, way.end_m)
    xy = way.points_beside(np.tile(s, len(aside_m)), np.repeat(aside_m, len(s)))[:, :2]
    xy = xy[ground.clearance(xy) > CLEAR_M]
    points_world = np.column_stack([xy, ground.height(xy)])
    eye_world = camera.world_from_cam[:3, 3]
    points_world = points_world[seen_over_ground(ground, eye_world, points_world)]
    points_world = points_world[~meet(evidence.bodies["structure"], eye_world, points_world)]
    points_world = points_world[~before_or_shading(world, points_world)]
    points_cam = transform(invert(camera.world_from_cam), points_world)
    uv = camera.project(points_cam)
    with np.errstate(invalid="ignore"):
        return uv[((uv >= 0) & (uv < [camera.width_px, camera.height_px])).all(axis=1)]


def _middle(luma: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "r c"]:
    """The brightness in the middle of the image, cut at even pixels."""
    height, width = luma.shape
    part = min(1.0, np.sqrt(MAX_PX / (height * width)))
    rows, columns = 2 * int(height * part / 2), 2 * int(width * part / 2)
    top, left = (height - rows) // 4 * 2, (width - columns) // 4 * 2
    return luma[top : top + rows, left : left + columns]


def _detail(luma: Float[np.ndarray, "r c"]) -> Float[np.ndarray, " k"]:
    """Ratios, means of those along rows and columns: steps beside the steepest ones over these; detail of one pixel
    over that of two; mean steps in odd and even pixel pairs, the smaller over the larger. None of an image that is too
    small or uniform."""
    found = []
    for values in (luma, luma.T):
        steps = np.abs(np.diff(values, axis=1))
        inner = steps[:, 1:-1]
        n_steepest = int(STEEPEST * inner.size)
        steep = inner >= np.partition(inner, -n_steepest, axis=None)[-n_steepest] if n_steepest else inner < 0
        odd, even = steps[:, 0::2].mean(), steps[:, 1::2].mean()
        fine, coarse = (_curvature(values, reach) for reach in (1, 2))
        if luma.size < MIN_PX or not inner[steep].sum() or not min(fine, coarse, max(odd, even)):
            return np.zeros(0)
        width = (steps[:, 2:] + steps[:, :-2])[steep].sum() / 2 / inner[steep].sum()
        found.append((width, fine / coarse, min(odd, even) / max(odd, even)))
    return np.mean(found, axis=0)


def _curvature(values: Float[np.ndarray, "r c"], reach: int) -> float:
    """Mean difference between pixels and the mean of their neighbours at `reach`; limited for strong edges."""
    middle = values[:, 2:-2]
    before, after = values[:, 2 - reach : -2 - reach], values[:, 2 + reach : values.shape[1] - 2 + reach]
    return float(np.minimum(np.abs(middle - (before + after) / 2), MOST).mean())


# Clear daylight: the sun's zenith angle, and the visibility in fog. A lower sun is warm, its long shadows are blue, and
# roads mirror the sky: of 25 images of `streets` beyond 1.15 rad, 3 had other values than those below, of 79 none.
CLEAR_SUN_RAD, MIN_VISIBILITY_M = 1.1, 1_500.0
# Range of the terrain that is judged, and least numbers of pixels of terrain, road and paint.
TERRAIN_M, MIN_PIXELS, MIN_PAINT = 60.0, 200, 150
# Less light than this share of that in the sun is the sky's.
SHADE = 0.35
# The built-in terrains have less blue than the road, in 86 images at least 0.056; red over green is -0.065 to 0.008 on
# green grass in the open, to 0.040 before brick walls, and 0.055 to 0.151 on dry grass, 0.212 before a red house.
MAX_BLUE = -0.02
RED_OVER_GREEN = {1: (-0.1, 0.045), 2: (0.0, 0.26)}
# A wet road with more of blue over red mirrors the sky: 0.10 before a blue one.
SKY_BLUE = 0.05
# Red over green of leaves is -0.19 to -0.009 in 442 images. Leaves are the upper halves of trees, but for pixels with
# less light than the share LEAVES_LIGHT of the road's; those of BROWN trees are not green, if they have any.
LEAVES_OVER_GREEN, LEAVES_LIGHT, BROWN = 0.02, 0.05, ("dead", "bush")
# Pixels of narrower paint show as much of the road: an id is that at a pixel's centre.
RESOLVED_PX = 2
# Red over blue of a white line: at most 0.035 in 114 lines; a yellow one has 0.25, a worn one on concrete 0.09.
MAX_YELLOW, MIN_YELLOW = 0.12, 0.06
# Paint that stands out is this many times brighter than the pavement up to AROUND_PX around it: at least 1.12 times in
# 90 lines.
BRIGHTER, AROUND_PX = 1.05, 4
# Ratio of light between the lighter and the darker parts of pavement from which it lies partly in a shadow.
MOST_UNEVEN = 3
# Angle about the mirrored sun within which rough roads glare.
GLARE_RAD = 0.6
# On a road that is brighter than this (white is 1), paint cannot be clearly brighter.
MAX_LIGHT = 0.6
# Share of a picture, without sky, that may be black: at most 0.0007 in 120.
MAX_BLACK, BLACK = 0.02, 3
# Where there is this share of sky, a tenth of the picture is brighter than BRIGHT: than 106 in 175 pictures.
MIN_SKY, BRIGHT = 0.05, 60.0


def check_appearance(evidence: Evidence) -> Iterator[Result]:
    """Findings about the picture's colours and light, by the passes."""
    scene = evidence.scene
    if scene.light.sun_zenith_rad > CLEAR_SUN_RAD or scene.weather.snow or scene.air.visibility_m < MIN_VISIBILITY_M:
        return
    semantic, near = evidence.passes["semantic"], evidence.passes["depth"] < PROOF_M
    road = (semantic == SEMANTIC_IDS["road"]) & near
    if road.sum() < MIN_PIXELS:
        return
    black = float(((evidence.picture.max(axis=2) <= BLACK) & (semantic != SEMANTIC_IDS["sky"])).mean())
    yield from _judged("appearance.black", black, "light by day, got {:.1%} of the picture black", most=MAX_BLACK)
    bright = float(np.quantile(evidence.luma, 0.9))
    if (semantic == SEMANTIC_IDS["sky"]).mean() > MIN_SKY:
        yield from _judged("appearance.bright", bright, "daylight, got {:.0f} of 255 in its brighter parts", BRIGHT)
    levels = np.arange(256) / 255
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)[evidence.picture]
    # A road in glare, and a wet one that mirrors the sky, have the sky's colours.
    road[road] = ~_may_glare(evidence, road)
    light = _lit(linear[road])
    red, _, blue = _chroma(light) if len(light) else np.zeros(3)
    is_mirror = scene.surface.wetness > MAX_DRY and blue - red > SKY_BLUE
    # Rain takes the colours away.
    if road.sum() >= MIN_PIXELS and not is_mirror and not scene.weather.rain:
        yield from _terrain(evidence, linear, light)
        yield from _leaves(evidence, linear, light) if "instance" in evidence.passes else ()
    if "instance" in evidence.passes and evidence.paint.is_dry:
        yield from _paint(evidence, linear)


def _lit(pixels: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """The pixels of a surface that lie in no shadow, where all light is the sky's."""
    light = pixels.sum(axis=1)
    return pixels[light > SHADE * np.quantile(light, 0.9)]


def _chroma(pixels: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """The shares of red, green and blue in the median of pixels."""
    light = np.median(pixels, axis=0)
    return light / max(float(light.sum()), 1e-6)


def _terrain(
    evidence: Evidence, linear: Float[np.ndarray, "h w 3"], road: Float[np.ndarray, "n 3"]
) -> Iterator[Result]:
    texture = evidence.scene.surface.terrain_texture
    if evidence.scene.assets.terrains or evidence.scene.assets.roads or texture not in RED_OVER_GREEN:
        return
    at = (evidence.passes["semantic"] == SEMANTIC_IDS["terrain"]) & (evidence.passes["depth"] < TERRAIN_M)
    at &= linear.sum(axis=2) > SHADE * np.median(road.sum(axis=1))
    if at.sum() < MIN_PIXELS:
        return
    red, green, blue = _chroma(linear[at]) - _chroma(road)
    low, high = RED_OVER_GREEN[texture]
    words = f"grass with at most {MAX_BLUE} of blue over the road's, got {{:+.3f}}"
    yield from _judged("appearance.blue", float(blue), words, most=MAX_BLUE)
    words = f"grass with {low} to {high} of red over green, got {{:+.3f}}"
    yield from _judged(f"appearance.red_over_green_{texture}", float(red - green), words, low, high)


def _leaves(evidence: Evidence, linear: Float[np.ndarray, "h w 3"], road: Float[np.ndarray, "n 3"]) -> Iterator[Result]:
    scene, ids = evidence.scene, evidence.passes["instance"]
    if not scene.trees or scene.assets.trees or scene.assets.roads:
        return
    at = (evidence.passes["semantic"] == SEMANTIC_IDS["tree"]) & (evidence.passes["depth"] < TERRAIN_M)
    at &= linear.sum(axis=2) > LEAVES_LIGHT * np.median(road.sum(axis=1))
    numbers = numbers_of("tree", ids)
    at &= (numbers >= 0) & (numbers < len(scene.trees))
    rows, columns = np.nonzero(at)
    own = numbers[rows, columns]
    models = [scene.assets.tree_models[tree.model - 1] for tree in scene.trees]
    crowns = zip(models, scene.trees, strict=True)
    foot_m = np.array([np.inf if model.name in BROWN else model.height_m * tree.scale / 2 for model, tree in crowns])
    up_m = evidence.points_world(rows, columns)[:, 2] - evidence.world.site.trees_world[own, 2]
    leaves = linear[rows, columns][up_m > foot_m[own]]
    if len(leaves) < MIN_PIXELS:
        return
    red, green, _ = _chroma(leaves) - _chroma(road)
    words = f"leaves with at most {LEAVES_OVER_GREEN} of red over green, got {{:+.3f}}"
    yield from _judged("appearance.leaves", float(red - green), words, most=LEAVES_OVER_GREEN)


def _paint(evidence: Evidence, linear: Float[np.ndarray, "h w 3"]) -> Iterator[Result]:
    near = evidence.passes["depth"] < PROOF_M
    numbers = numbers_of("delimiter", evidence.passes["instance"])
    paved = np.isin(evidence.passes["semantic"], [SEMANTIC_IDS["road"], SEMANTIC_IDS["shoulder"]])
    for number, lane in enumerate(lane for lane in evidence.labels.lanes if lane.kind == "delimiter"):
        at = (numbers == number) & near
        at = binary_opening(at, np.ones((RESOLVED_PX, RESOLVED_PX), dtype=bool))
        at[at] = ~_may_glare(evidence, at)
        color = lane.color or "white"
        if at.sum() < MIN_PAINT or not evidence.paint.shows or not evidence.paint.stands_out(color):
            continue
        beside = linear[binary_dilation(at, iterations=AROUND_PX) & paved]
        if not len(beside):
            continue
        # In red, of which yellow paint has as much as white one.
        times = brighter(linear[at][:, 0], beside[:, 0], evidence.paint.contrast("white"))
        red, _, blue = _chroma(linear[at]) - _chroma(beside)
        # On pale concrete worn yellow paint is known by its colour alone.
        if not np.isfinite(times) or (color == "yellow" and red - blue > MIN_YELLOW):
            continue
        words = f"its {at.sum()} pixels of paint brighter than the road around them, got them {{:.2f}} times as bright"
        yield from _judged("appearance.brighter", times, words, BRIGHTER, lane=lane.id)
        if color == "white":
            words = "white paint, got yellow ({:+.2f} of red over blue)"
            yield from _judged("appearance.yellow", float(red - blue), words, most=MAX_YELLOW, lane=lane.id)


def _may_glare(evidence: Evidence, at: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, " n"]:
    """Which of these pixels of a road may mirror the sun or the sky about it."""
    rays = evidence.rays_world(*np.nonzero(at))
    return np.asarray((rays * [1, 1, -1]) @ sun_direction(evidence.scene.light) > np.cos(GLARE_RAD))


def brighter(paint: Float[np.ndarray, " n"], beside: Float[np.ndarray, " m"], contrast: float) -> float:
    """How many times brighter paint is than the pavement beside it; infinite where neither that nor its colour tells
    anything: in glare, which whitens both, and where the edge of a shadow, which is blue, may run along the line: paint
    that is `contrast` times as bright in equal light may be as dark there as the road."""
    dark, of_road, light = np.quantile(beside, (0.2, 0.5, 0.8))
    if of_road >= MAX_LIGHT or light > min(MOST_UNEVEN, contrast / BRIGHTER) * dark:
        return np.inf
    return float(np.median(paint) / max(float(of_road), 1e-6))


# -- edges of the image, where the passes have them

# Brightness steps are measured up to this many pixels from each border.
REACH_PX = 6
# Rows and columns of a large image are skipped, so that about this many pixels are used.
MAX_STEPS = 250_000


class ImagePart(NamedTuple):
    """A part of the image, as shares of its width or height, and the least number of borders in it for a verdict."""

    name: str
    first: float
    last: float
    least: int


# In 1,260 rendered images of all presets, in any of these parts, the steps beside the borders are at most 0.9 times
# those at them, with strong motion blur 1.19 times; those REACH_PX away are at most 0.75 times as large. In images
# shifted by one pixel they are mostly more than 1.3 times as large, in images of other scenes as large. A stretched
# image may be in place in the middle. For a single thing to say that the image is shifted, a tenth is enough.
MOVED, CLEARLY, BLANK = 1.25, 1.1, 0.9
LEAST_OF_THING = 20
ACROSS = (
    ImagePart("the image", 0, 1, 100),
    ImagePart("its left third", 0, 1 / 3, 250),
    ImagePart("its middle third", 1 / 3, 2 / 3, 250),
    ImagePart("its right third", 2 / 3, 1, 250),
)
DOWN = (ImagePart("the image", 0, 1, 250),)
# After civil twilight edges beyond the headlights are not seen. Sine of the yaw from which on motion blur runs across
# the image, whose edges it then moves: it is judged in coarser pixels, of which it is at most SMEAR_PX at ASIDE_BLUR_M,
# and by whether it has edges at all.
DARK_RAD, ASIDE, SMEAR_PX = 1.68, 0.3, 5.0
SMEARED = [SEMANTIC_IDS[name] for name in (*GROUND, "symbol")]


def check_alignment(evidence: Evidence) -> Iterator[Finding]:
    """Findings where the image is shifted or stretched against its passes, or belongs to other passes."""
    scene, passes, luma = evidence.scene, evidence.passes, evidence.luma
    if not evidence.paint.shows or scene.light.sun_zenith_rad >= DARK_RAD:
        return
    if scene.sensor.motion_blur_m > 0 and abs(np.sin(scene.camera.yaw_rad)) > ASIDE:
        size = int(np.ceil(_aside_px(scene) / SMEAR_PX))
        rows, columns = (n // size for n in luma.shape)
        coarse = luma[: rows * size, : columns * size].reshape(rows, size, columns, size).mean(axis=(1, 3))
        things = _things(passes, np.s_[size // 2 :: size, size // 2 :: size])[:rows, :columns]
        yield from _edges(coarse, things, "", ACROSS[:1])
        return
    every = int(np.ceil(luma.size / MAX_STEPS))
    rows_of, columns_of = np.s_[::every], np.s_[:, ::every]
    yield from _edges(luma[rows_of], _things(passes, rows_of), "right", ACROSS)
    things = _things(passes, columns_of)
    # Motion blur smears the ground near the host along the driving direction.
    things[np.isin(passes["semantic"][columns_of], SMEARED)] = 0
    yield from _edges(luma[columns_of].T, things.T, "down", DOWN)


def _things(passes: Passes, of: tuple[slice, ...] | slice) -> Int[np.ndarray, "r c"]:
    """A number for each visible object; all trees share one, because their twigs overlap."""
    semantic = passes["semantic"][of].astype(int)
    if "instance" not in passes:
        return semantic
    return np.where(semantic == SEMANTIC_IDS["tree"], 0, passes["instance"][of].astype(int)) * 256 + semantic


def _edges(
    luma: Float[np.ndarray, "r c"], things: Int[np.ndarray, "r c"], way: str, parts: tuple[ImagePart, ...]
) -> Iterator[Finding]:
    """Findings along the rows; without a `way` edges may be moved."""

    def is_clearer(at: int, steps: Float[np.ndarray, " k"]) -> bool:
        return bool(steps[at] > CLEARLY * steps[REACH_PX])

    def is_blank(steps: Float[np.ndarray, " k"]) -> bool:
        """Whether the step in place is not larger than those away from it."""
        return bool(max(steps[0], steps[-1]) > BLANK * steps[REACH_PX])

    steps = np.abs(np.diff(luma, axis=1))
    n = steps.shape[1]
    rows, columns = np.nonzero(things[:, 1:] != things[:, :-1])
    inner = (columns >= REACH_PX) & (columns < n - REACH_PX)
    rows, columns = rows[inner], columns[inner]
    around = np.stack([steps[rows, columns + k] for k in range(-REACH_PX, REACH_PX + 1)], axis=1)
    owners = np.maximum(things[rows, columns], things[rows, columns + 1])
    for part in parts:
        inside = (columns >= part.first * n) & (columns < part.last * n)
        if inside.sum() < part.least:
            continue
        mean, of_things = around[inside].mean(axis=0), (around[inside], owners[inside])
        at = int(mean.argmax())
        found = ""
        if way and mean.max() > MOVED * mean[REACH_PX] and _most(partial(is_clearer, at), *of_things):
            found = f"{at - REACH_PX:+d} px {way}"
        elif is_blank(mean) and _most(is_blank, *of_things):
            found = "none"
        if found:
            yield Finding("", f"image: expected edges where the passes have them, got {found} in {part.name}")


def _most(
    says: Callable[[Float[np.ndarray, " k"]], bool], around: Float[np.ndarray, "n k"], owners: Int[np.ndarray, " n"]
) -> bool:
    """Whether `says` holds for the mean steps of at least two things, and of most of them: a single thing may be as
    bright as what is behind it, and have an edge of its own inside its border."""
    of_thing = (around[owners == thing] for thing in np.unique(owners))
    votes = [says(borders.mean(axis=0)) for borders in of_thing if len(borders) >= LEAST_OF_THING]
    return sum(votes) > 1 and 2 * sum(votes) > len(votes)
