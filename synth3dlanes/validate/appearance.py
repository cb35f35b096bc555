"""Check colours and light of what the passes name: terrain, paint and what is black, in clear daylight.

Colours are compared with that of the road in the same picture, so that the sun's and the sky's do not matter: as
chroma, which is the share of a channel in the light, minus that of the road.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, binary_opening

from synth3dlanes.imaging.sky import sun_direction
from synth3dlanes.scene.instance_ids import numbers_of
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Bounded, Finding, Result

# Clear daylight: the sun's zenith angle, and the visibility in fog. A lower sun is warm, its long shadows are blue, and
# roads mirror the sky: of 25 images of `streets` beyond 1.15 rad, 3 had other values than those below, of 79 none.
LOWEST_SUN_RAD, MIN_VISIBILITY_M = 1.1, 1_500.0
# Range of the terrain that is judged, and least numbers of pixels of terrain, road and paint.
TERRAIN_M, MIN_PIXELS, MIN_PAINT = 60.0, 200, 150
# Less light than this share of that in the sun is the sky's.
SHADE = 0.35
# The built-in terrains have less blue than the road, in 86 images at least 0.056; red over green is -0.065 to 0.008 on
# green grass in the open, to 0.040 before brick walls, and 0.055 to 0.151 on dry grass.
MAX_BLUE = -0.02
RED_OVER_GREEN = {1: (-0.1, 0.045), 2: (0.0, 0.2)}
# That of leaves, the upper half of trees without what has less light than this share of the road, is -0.19 to -0.009 in
# 442 images. These trees have none.
LEAVES_OVER_GREEN, LEAVES_LIGHT, BARE = 0.02, 0.05, ("dead",)
# Pixels of narrower paint show as much of the road: an id is that at a pixel's centre.
RESOLVED_PX = 2
# Red over blue of a white line: at most 0.035 in 114 lines; a yellow one has 0.25.
MAX_YELLOW = 0.12
# How many times brighter than the pavement around it paint is that stands out, at least 1.12 in 90 lines; and the reach
# of that pavement.
BRIGHTER, AROUND_PX = 1.05, 4
# Ratio of light between the lighter and the darker parts of pavement from which it lies partly in a shadow.
MOST_UNEVEN = 3
# Angle about the mirrored sun within which rough roads glare.
GLARE_RAD = 0.6
# A road of more light than this, of 1 for white, leaves paint no room to be brighter.
MAX_LIGHT = 0.6
# Share of a picture, without sky, that may be black: at most 0.0007 in 120.
MAX_BLACK, BLACK = 0.02, 3


def check_appearance(evidence: Evidence) -> Iterator[Result]:
    """Findings about the picture's colours and light, by the passes."""
    scene = evidence.scene
    if scene.light.sun_zenith_rad > LOWEST_SUN_RAD or scene.weather.snow or scene.air.visibility_m < MIN_VISIBILITY_M:
        return
    semantic, near = evidence.passes["semantic"], evidence.passes["depth"] < PROOF_M
    road = (semantic == SEMANTIC_IDS["road"]) & near
    if road.sum() < MIN_PIXELS:
        return
    black = float(((evidence.picture.max(axis=2) <= BLACK) & (semantic != SEMANTIC_IDS["sky"])).mean())
    yield Bounded("appearance.black", black, most=MAX_BLACK)
    if black > MAX_BLACK:
        yield Finding("", f"image: expected light everywhere by day, got {100 * black:.1f} % of the picture black")
    linear = _linear(evidence)
    yield from _terrain(evidence, linear, _lit(linear[road]))
    if "instance" not in evidence.passes:
        return
    yield from _leaves(evidence, linear, _lit(linear[road]))
    if evidence.paint.is_dry:
        yield from _paint(evidence, linear)


def _linear(evidence: Evidence) -> Float[np.ndarray, "h w 3"]:
    """The picture's light."""
    values = np.arange(256) / 255
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)[evidence.picture]


def _lit(pixels: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Those of a surface's pixels that lie in no shadow, whose light is the sky's."""
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
    yield Bounded("appearance.blue", float(blue), most=MAX_BLUE)
    yield Bounded(f"appearance.red_over_green_{texture}", float(red - green), low, high)
    if blue > MAX_BLUE:
        yield Finding("", f"image: expected grass with at most {MAX_BLUE} of blue over the road's, got {blue:+.3f}")
    if not low < red - green < high:
        found = f"{red - green:+.3f}"
        yield Finding("", f"image: expected grass with {low} to {high} of red over green, got {found}")


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
    foot_m = np.array([np.inf if model.name in BARE else model.height_m * tree.scale / 2 for model, tree in crowns])
    up_m = evidence.points_world(rows, columns)[:, 2] - evidence.world.site.trees_world[own, 2]
    leaves = linear[rows, columns][up_m > foot_m[own]]
    if len(leaves) < MIN_PIXELS:
        return
    red, green, _ = _chroma(leaves) - _chroma(road)
    yield Bounded("appearance.leaves", float(red - green), most=LEAVES_OVER_GREEN)
    if red - green > LEAVES_OVER_GREEN:
        found = f"{red - green:+.3f}"
        yield Finding("", f"image: expected leaves with at most {LEAVES_OVER_GREEN} of red over green, got {found}")


def _paint(evidence: Evidence, linear: Float[np.ndarray, "h w 3"]) -> Iterator[Result]:
    near = evidence.passes["depth"] < PROOF_M
    numbers = numbers_of("delimiter", evidence.passes["instance"])
    for number, lane in enumerate(lane for lane in evidence.labels.lanes if lane.kind == "delimiter"):
        at = (numbers == number) & near
        at = binary_opening(at, np.ones((RESOLVED_PX, RESOLVED_PX), dtype=bool))
        at[at] = ~_may_glare(evidence, at)
        color = lane.color or "white"
        if at.sum() < MIN_PAINT or not evidence.paint.shows or not evidence.paint.stands_out(color):
            continue
        beside = linear[_pavement_beside(evidence, at)]
        if not len(beside):
            continue
        red, _, blue = _chroma(linear[at]) - _chroma(beside)
        if color == "white":
            yield Bounded("appearance.yellow", float(red - blue), most=MAX_YELLOW)
        if color == "white" and red - blue > MAX_YELLOW:
            yield Finding(lane.id, f"image: expected white paint, got yellow ({red - blue:+.2f} of red over blue)")
        # In red, of which yellow paint has as much as white one.
        times = brighter(linear[at][:, 0], beside[:, 0], evidence.paint.contrast("white"))
        if np.isinf(times):
            continue
        yield Bounded("appearance.brighter", times, BRIGHTER)
        if times < BRIGHTER:
            yield Finding(
                lane.id,
                f"image: expected its {at.sum()} pixels of paint brighter than the road around them, got them "
                f"{times:.2f} times as bright",
            )


def _pavement_beside(evidence: Evidence, at: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    paved = np.isin(evidence.passes["semantic"], [SEMANTIC_IDS["road"], SEMANTIC_IDS["shoulder"]])
    return np.asarray(binary_dilation(at, iterations=AROUND_PX) & paved)


def _may_glare(evidence: Evidence, at: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, " n"]:
    """Which of these pixels of a road may mirror the sun or the sky about it."""
    rows, columns = np.nonzero(at)
    rays = evidence.camera.rays(np.column_stack([columns, rows]) + 0.5) @ evidence.camera.world_from_cam[:3, :3].T
    return np.asarray((rays * [1, 1, -1]) @ sun_direction(evidence.scene.light) > np.cos(GLARE_RAD))


def brighter(paint: Float[np.ndarray, " n"], beside: Float[np.ndarray, " m"], contrast: float) -> float:
    """How many times brighter paint is than the pavement beside it; infinite in glare, which whitens both, and where
    the edge of a shadow may run along the line: paint that is `contrast` times as bright in equal light may be as dark
    there as the road."""
    dark, of_road, light = np.quantile(beside, (0.2, 0.5, 0.8))
    if of_road >= MAX_LIGHT or light > min(MOST_UNEVEN, contrast / BRIGHTER) * dark:
        return np.inf
    return float(np.median(paint) / max(float(of_road), 1e-6))
