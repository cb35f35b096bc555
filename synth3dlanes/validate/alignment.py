"""Check that the image's edges are where those of its passes are.

Where two neighbouring pixels of the passes show different objects, the image's brightness changes more between these
two pixels than between others nearby. This holds in fog, with motion blur and in every part of an image, so it finds
an image that is shifted or stretched by a pixel, or that belongs to another scene, in any sample.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.system.arrays import Passes
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding

# Brightness steps are measured up to this many pixels from each border.
REACH_PX = 6
# Rows and columns of a large image are skipped, so that about this many pixels are used.
MAX_PIXELS = 250_000


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
GROUND = [SEMANTIC_IDS[name] for name in ("terrain", "road", "shoulder", "marking", "symbol")]
# After civil twilight edges beyond the headlights are not seen. Sine of the yaw from which on motion blur runs across
# the image.
DARK_RAD, ASIDE = 1.68, 0.3


def check_alignment(evidence: Evidence) -> Iterator[Finding]:
    """Findings where the image is shifted or stretched against its passes, or belongs to other passes."""
    scene, passes, luma = evidence.scene, evidence.passes, evidence.luma
    is_lit = scene.light.sun_zenith_rad < DARK_RAD
    is_smeared = scene.sensor.motion_blur_m > 0 and abs(np.sin(scene.camera.yaw_rad)) > ASIDE
    if not evidence.paint.shows or not is_lit or is_smeared:
        return
    every = int(np.ceil(luma.size / MAX_PIXELS))
    rows, columns = np.s_[::every], np.s_[:, ::every]
    yield from _judge(luma[rows], _things(passes, rows), "right", ACROSS)
    things = _things(passes, columns)
    # Motion blur smears the ground near the host along the driving direction.
    things[np.isin(passes["semantic"][columns], GROUND)] = 0
    yield from _judge(luma[columns].T, things.T, "down", DOWN)


def _things(passes: Passes, of: tuple[slice, ...] | slice) -> Int[np.ndarray, "r c"]:
    """A number for each visible object; all trees share one, because their twigs overlap."""
    semantic = passes["semantic"][of].astype(int)
    if "instance" not in passes:
        return semantic
    return np.where(semantic == SEMANTIC_IDS["tree"], 0, passes["instance"][of].astype(int)) * 256 + semantic


def _judge(
    luma: Float[np.ndarray, "r c"], things: Int[np.ndarray, "r c"], way: str, parts: tuple[ImagePart, ...]
) -> Iterator[Finding]:
    """Findings along the rows."""
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
        if mean.max() > MOVED * mean[REACH_PX] and _most(partial(_is_clearer, at), *of_things):
            found = f"{at - REACH_PX:+d} px {way}"
        elif _is_blank(mean) and _most(_is_blank, *of_things):
            found = "none"
        if found:
            yield Finding("", f"image: expected edges where the passes have them, got {found} in {part.name}")


def _is_clearer(at: int, steps: Float[np.ndarray, " k"]) -> bool:
    """Whether the step there is clearly larger than in place."""
    return bool(steps[at] > CLEARLY * steps[REACH_PX])


def _is_blank(steps: Float[np.ndarray, " k"]) -> bool:
    """Whether the step in place is not larger than those away from it."""
    return bool(max(steps[0], steps[-1]) > BLANK * steps[REACH_PX])


def _most(
    says: Callable[[Float[np.ndarray, " k"]], bool], around: Float[np.ndarray, "n k"], owners: Int[np.ndarray, " n"]
) -> bool:
    """Whether the mean steps of two things or more, and of most of them, say so: a single one may be as bright as what
    is behind it, and have an edge of its own inside its border."""
    of_thing = (around[owners == thing] for thing in np.unique(owners))
    votes = [says(borders.mean(axis=0)) for borders in of_thing if len(borders) >= LEAST_OF_THING]
    return sum(votes) > 1 and 2 * sum(votes) > len(votes)
