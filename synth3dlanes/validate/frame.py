"""Check that the image is neither black nor overexposed, nor pink from missing textures."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, UInt8

from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.findings import Finding, Measure
from synth3dlanes.validate.passes_proof import Passes

# Largest share of white pixels, and least mean brightness. A bright sky in fog may fill half the image, unclipped.
MAX_CLIPPED, MIN_MEAN = 0.5, 8.0
# Blender shows missing textures in pink. Cars may be pink, ground is not.
MAX_PINK_OF_GROUND, MAX_PINK = 0.02, 0.5
GROUND = ("terrain", "road", "shoulder", "marking")

OfPixels = Callable[[Float[np.ndarray, "n 2"]], Bool[np.ndarray, " n"]]


def check_frame(
    image: UInt8[np.ndarray, "h w 3"], passes: Passes, may_show_cars: OfPixels | None = None
) -> tuple[list[Finding], list[Measure]]:
    """Findings about the image, and measure `clipped_share`: the share of pixels with a channel at 0 or 255.
    `may_show_cars` tells which pixels may be a car's, where no pass does."""
    findings = []
    red, green, blue = np.moveaxis(image, -1, 0)
    darkest, brightest = np.minimum(np.minimum(red, green), blue), np.maximum(np.maximum(red, green), blue)
    white = float((darkest == 255).mean())
    if image.mean() < MIN_MEAN:
        findings.append(Finding("", f"image: expected a picture, got black (mean {image.mean():.1f} of 255)"))
    if white > MAX_CLIPPED:
        findings.append(Finding("", f"image: expected a picture, got {100 * white:.0f} % of it white"))
    pink = (np.minimum(red, blue) > 100) & (np.minimum(red, blue) // 2 > green)
    limit = MAX_PINK
    if "semantic" in passes:
        pink = pink[np.isin(passes["semantic"], [SEMANTIC_IDS[name] for name in GROUND])]
        limit = MAX_PINK_OF_GROUND
    share = float(pink.mean()) if pink.size else 0.0
    if share > limit and "semantic" not in passes and may_show_cars is not None:
        share -= float(may_show_cars(np.argwhere(pink)[:, ::-1] + 0.5).sum()) / pink.size
    if share > limit:
        findings.append(Finding("", f"image: expected textures, got {100 * share:.0f} % of the ground pink"))
    clipped = float(((darkest == 0) | (brightest == 255)).mean())
    return findings, [Measure("clipped_share", np.zeros(1), np.array([clipped]))]
