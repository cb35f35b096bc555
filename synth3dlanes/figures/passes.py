"""Passes as pictures."""

import colorsys

import numpy as np
from jaxtyping import Shaped, UInt8
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.patches import Patch

from synth3dlanes.figures import colors
from synth3dlanes.scene.things import KINDS
from synth3dlanes.system.arrays import RgbImage

WORDS = {
    "depth": "metres along the viewing direction, from 2 m (yellow) to 500 m (violet); gray: sky",
    "normal": "red: x right, green: y forward, blue: z up; gray: sky",
    "semantic": ", ".join(f"{kind.name} {kind.word}" for kind in KINDS),
    "instance": "a colour for each thing with an id; gray: all else",
    "height": "metres over the road plane, from -5 m (blue) to 5 m (red), seen from above",
}

_SCALES = {
    "depth": ("viridis_r", LogNorm(2.0, 500.0, clip=True)),
    "height": ("coolwarm", Normalize(-5.0, 5.0, clip=True)),
}
_NOTHING = np.array([150, 158, 166], dtype=np.uint8)
# Successive multiples of the golden ratio are far apart on the colour circle.
_GOLDEN = 0.618034


def pass_picture(name: str, values: Shaped[np.ndarray, "h w ..."]) -> RgbImage:
    """One pass in the colours of `WORDS`."""
    if name in _SCALES:
        map_name, norm = _SCALES[name]
        picture = colormaps[map_name](norm(np.where(np.isfinite(values), values, 1.0)), bytes=True)[..., :3]
        return np.where(np.isfinite(values)[..., None], picture, _NOTHING)
    if name == "normal":
        picture = np.round(127.5 * (values.astype(float) + 1)).clip(0, 255).astype(np.uint8)
        return np.where((values == 0).all(axis=-1, keepdims=True), _NOTHING, picture)
    return _palette(name, int(values.max()) + 1)[values]


def semantic_colors(ids: UInt8[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
    """The colours of points by their semantic ids, as in the picture of the pass."""
    return _palette("semantic", int(ids.max(initial=0)) + 1)[ids]


def draw_pass(axes: Axes, name: str, values: Shaped[np.ndarray, "h w ..."]) -> None:
    """One pass with its scale or legend."""
    axes.imshow(pass_picture(name, values), extent=(0, values.shape[1], values.shape[0], 0))
    axes.set(title=name, xlabel="u [px]", ylabel="v [px]")
    if name in _SCALES:
        map_name, norm = _SCALES[name]
        bar = axes.figure.colorbar(ScalarMappable(norm, map_name), ax=axes, fraction=0.04, pad=0.02)
        bar.set_label("depth y_cam [m]" if name == "depth" else "height over the road plane [m]")
    if name == "height":
        axes.set(title="height (from above, far rows first)", xlabel="column", ylabel="row")
    elif name == "semantic":
        there = [kind for kind in KINDS if (values == kind.semantic_id).any()]
        handles = [Patch(color=colors.hexadecimal(kind.color), label=kind.name) for kind in there]
        axes.legend(handles=handles, loc="lower left", fontsize=7, ncols=2)
    elif name in ("normal", "instance"):
        axes.text(4, values.shape[0] - 4, WORDS[name], fontsize=7, va="bottom", color="white",
                  bbox={"facecolor": colors.INK, "edgecolor": "none", "alpha": 0.7})  # fmt: skip


def _palette(name: str, n: int) -> UInt8[np.ndarray, "n 3"]:
    """The colour of each id below n."""
    bright = [colorsys.hsv_to_rgb(number * _GOLDEN % 1, 0.65 + 0.3 * (number % 2), 0.95) for number in range(n)]
    palette = np.round(255 * np.array(bright)).astype(np.uint8)
    if name == "semantic":
        for kind in KINDS:
            palette[kind.semantic_id : kind.semantic_id + 1] = kind.color
    else:
        palette[0] = _NOTHING
    return palette
