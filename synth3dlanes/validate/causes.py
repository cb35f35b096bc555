"""What a layer looks as if it had been done to it: a small catalogue, tried on the layer as `dataset.json` makes it.

Each guess changes the made layer in a region: all of it, a half, objects or surfaces that are wrong. The guess that
leaves least wrong is the likely cause; if none explains most of it, the objects where the layer differs are named.
"""

from collections.abc import Callable, Iterator
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped
from PIL import Image
from scipy.ndimage import affine_transform, distance_transform_edt, uniform_filter

from synth3dlanes.imaging.film import response
from synth3dlanes.validate.findings import some
from synth3dlanes.validate.likeness import ErrorMap, LayerPair, Raster
from synth3dlanes.validate.pixels import luma

# The most of what is wrong that a cause may leave; what a later cause may leave, as a share of what the best one
# leaves; the share of all differences below which no smaller region is tried.
LEFT, BETTER, ENOUGH = 0.35, 0.95, 0.15
# An object is wrong where this share of its pixels is, and alone wrong if this share of all that is wrong is near it.
OF_OBJECT, NEAR, NEAR_PX = 0.2, 0.8, 7
REACH_PX = 4
ENLARGED = (0.98, 0.99, 0.995, 1.0025, 1.005, 1.01, 1.02, 1.05)
THERE, ONE_COLOUR = " there", ("black", "of one colour")
FLAT = 4  # levels, as JPEG has them in a surface of one colour
STEPS_M = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0)
# Radiance and its level in the picture.
LIGHT = np.concatenate([[0.0], np.geomspace(1e-4, 20, 500)])
LEVELS = 255 * response(LIGHT)

PixelValues = Shaped[np.ndarray, "n *c"]
Fit = Callable[[PixelValues, PixelValues, dict[int, str]], Iterator[tuple[str, PixelValues]]]


class Region(NamedTuple):
    """A part of a layer, in words ("" for all of it)."""

    words: str
    mask: Bool[np.ndarray, "h w"]
    is_objects: bool = False


class Cause(NamedTuple):
    """What explains a difference, or only where it is ("" for nothing in particular)."""

    words: str
    is_explained: bool


def likely_cause(layer: LayerPair, wrong: ErrorMap) -> Cause:
    """The guess that explains best what is wrong."""
    total = float(wrong.sum())
    found, at = "", _near(wrong > 0)
    before = best = _unlike(layer.made[at], layer.lies[at])
    for region in _regions(layer, wrong):
        # What is wrong elsewhere remains.
        if wrong[~_near(region.mask)].sum() > LEFT * total:
            continue
        for words, guess in _guesses(layer, region):
            unlike = _unlike(guess[at], layer.lies[at])
            if unlike < BETTER * best and layer.wrong(guess, layer.lies).sum() < LEFT * total:
                found, best = f"{words}{region.words}", unlike
        if best < ENOUGH * before:
            break
    return Cause(found, True) if found else Cause(_place(layer, wrong), False)


def _guesses(layer: LayerPair, region: Region) -> Iterator[tuple[str, Raster]]:
    """What the layer would be, in words."""
    made, lies = layer.made[region.mask], layer.lies[region.mask]
    fit = FITS[layer.name.rpartition(" ")[2]]
    is_small = region.is_objects or region.words == THERE
    for words, values in fit(made, lies, layer.names):
        # Of scattered pixels a fit says little, but for one colour; in a small region any ids become what lies there.
        if (region.words == THERE and not words.startswith(ONE_COLOUR)) or (is_small and fit is _of_ids):
            continue
        guess = layer.made.copy()
        guess[region.mask] = values
        yield words, guess
    if layer.name == "image" and region.is_objects:
        yield "erased, the surface beside it instead", _erased(layer.made, region.mask)
    for words, guess in _moved(layer, region):
        yield words, np.where(_wide(region.mask, guess), guess, layer.made)


def _near(mask: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """An object and its outline."""
    return np.asarray(uniform_filter(mask.astype(np.float32), NEAR_PX) > 1e-3)


def _regions(layer: LayerPair, wrong: ErrorMap) -> Iterator[Region]:
    """All, the halves, the wrong objects of each kind, all that is wrong."""
    height, width = wrong.shape
    row, column = np.mgrid[:height, :width]
    yield Region("", np.ones(wrong.shape, bool))
    halves = {"upper": row < height // 2, "lower": row >= height // 2}
    halves |= {"left": column < width // 2, "right": column >= width // 2}
    if layer.name.startswith("lidar"):
        ahead = abs(column - (width - 1) / 2) < width / 4
        halves = {"front": ahead, "rear": ~ahead}
    for name, mask in halves.items():
        yield Region(f" in the {name} half", mask)
    yield from _objects(layer, wrong)
    yield Region(THERE, wrong > 0)


def _objects(layer: LayerPair, wrong: ErrorMap) -> Iterator[Region]:
    """Of each kind, as cars, those objects that are wrong."""
    both, twice = np.stack([layer.shown, layer.also]), np.stack([wrong > 0, wrong > 0])
    areas = np.bincount(both.ravel())
    shares = np.bincount(both.ravel(), twice.ravel()) / np.maximum(areas, 1)
    kinds: dict[str, list[int]] = {}
    for number in np.flatnonzero(areas).tolist():
        kinds.setdefault(layer.names.get(number, "other").partition(" ")[0], []).append(number)
    for kind, numbers in kinds.items():
        those = sorted((number for number in numbers if shares[number] > OF_OBJECT), key=lambda n: -areas[n])
        if those:
            told = some([layer.names.get(number, f"id {number}") for number in those]).replace("; ", ", ")
            told = f"every {kind}" if len(those) == len(numbers) > 1 else told
            yield Region(f" at {told}", np.isin(both, those).any(axis=0), is_objects=True)


def _place(layer: LayerPair, wrong: ErrorMap) -> str:
    """Which objects alone differ; "" if not these alone."""
    total = wrong.sum()
    for region in sorted(_objects(layer, wrong), key=lambda region: region.mask.sum()):
        if wrong[_near(region.mask)].sum() > NEAR * total:
            made, lies = (pixels[region.mask].reshape(region.mask.sum(), -1) for pixels in (layer.made, layer.lies))
            means = (f"({', '.join(f'{value:.0f}' for value in pixels.mean(axis=0))})" for pixels in (made, lies))
            colours = f", expected colour {next(means)}, got {next(means)}" if layer.name == "image" else ""
            return f"only{region.words} and about{colours}"
    return ""


def _moved(layer: LayerPair, region: Region) -> Iterator[tuple[str, Raster]]:
    """The layer mirrored or enlarged, and by the whole pixels that fit best."""
    made, lies, mask = layer.made, layer.lies, region.mask
    if not region.words:
        yield "left and right exchanged", made[:, ::-1]
        yield "rows upside down", made[::-1]
        yield "turned by 180 degrees", made[::-1, ::-1]
        if not layer.name.startswith("lidar"):
            yield from ((f"enlarged by {100 * (k - 1):g} %", _enlarged(made, k)) for k in ENLARGED)
    if "half" in region.words or not region.words:
        reach = range(-REACH_PX, REACH_PX + 1)
        shifts = [(down, right) for down, right in product(reach, reach) if (down, right) != (0, 0)]
        some_rows = slice(None, None, 3)
        plain, mask, lies = made[..., 1] if made.ndim == 3 else made, mask[some_rows], lies[some_rows]
        lies = lies[..., 1] if lies.ndim == 3 else lies
        fits = [_unlike(np.roll(plain, shift, (0, 1))[some_rows][mask], lies[mask]) for shift in shifts]
        shift = shifts[int(np.argmin(fits))]
        yield f"moved {_way(*shift)}", np.roll(made, shift, (0, 1))


def _unlike(a: PixelValues, b: PixelValues) -> float:
    """How much two layers differ; a pixel that sees nothing counts as any other that is far off."""
    with np.errstate(invalid="ignore"):
        differ = np.abs(a.astype(np.float32) - b.astype(np.float32))
    return float(np.minimum(np.where(a == b, 0, np.nan_to_num(differ, nan=1e3)), 20).mean())


def _way(down: int, right: int) -> str:
    words = [f"{abs(right)} px to the {'right' if right > 0 else 'left'}"] if right else []
    return ", ".join([*words, *([f"{abs(down)} px {'down' if down > 0 else 'up'}"] if down else [])])


def _enlarged(made: Raster, factor: float) -> Raster:
    middle = (np.array(made.shape[:2]) - 1) / 2
    order = 1 if made.ndim == 3 else 0
    matrix, offset = np.array([1 / factor, 1 / factor]), middle - middle / factor
    planes = np.moveaxis(made.reshape(*made.shape[:2], -1), -1, 0)
    moved = [affine_transform(plane, matrix, offset, order=order, mode="nearest") for plane in planes]  # type: ignore[call-overload]
    return np.stack(moved, axis=-1).reshape(made.shape)


def _erased(made: Raster, mask: Bool[np.ndarray, "h w"]) -> Raster:
    """With the nearest pixels outside instead; rendered edges of an object are partly its own."""
    edge = uniform_filter(mask.astype(np.float32), 3) > 0.05
    row, column = distance_transform_edt(edge, return_distances=False, return_indices=True)
    return np.asarray(made[row, column])


def _wide(mask: Bool[np.ndarray, "h w"], of: Raster) -> Bool[np.ndarray, "h w *d"]:
    return mask if of.ndim == mask.ndim else mask[..., None]


def _of_colours(made: PixelValues, lies: PixelValues, _: dict[int, str]) -> Iterator[tuple[str, PixelValues]]:
    p, q = made.astype(np.float32), lies.astype(np.float32)
    colour = np.median(q, axis=0)
    if np.median(np.abs(q - colour)) < FLAT:
        said = (
            "black" if colour.max() < 2 * FLAT else f"of one colour ({', '.join(f'{value:.0f}' for value in colour)})"
        )
        yield said, np.broadcast_to(colour, p.shape)
    names = ("red", "green", "blue")
    for order in permutations(range(3)):
        moved = [names[i] for i in range(3) if order[i] != i]
        if moved:
            said = f"{moved[0]} and {moved[1]} exchanged" if len(moved) == 2 else "red, green and blue in another order"
            yield said, made[:, order]
    gray_p, gray_q = (luma(values) for values in (p, q))
    chroma_p, chroma_q = p - gray_p[:, None], q - gray_q[:, None]
    share = _ratio(chroma_p, chroma_q)
    said = "gray: without its colours" if abs(share) < 0.05 else f"saturation x {share:.2f}"
    yield said, gray_p[:, None] + share * chroma_p
    yield _hue(made, lies)
    gain = _ratio(p, q)
    yield f"{abs(gain - 1):.0%} {'darker' if gain < 1 else 'brighter'}", gain * p
    inside = (p > 8) & (p < 247) & (q > 8) & (q < 247)
    if inside.any():
        power = _ratio(np.log(p[inside] / 255), np.log(q[inside] / 255))
        yield f"gamma {power:.2f}", 255 * (p / 255) ** power
        light_p, light_q = (np.interp(values, LEVELS, LIGHT) for values in (p, q))
        factor = float(np.median(light_q[inside] / light_p[inside]))
        yield f"light x {factor:.2f}: exposure", np.interp(factor * light_p, LIGHT, LEVELS)
    if p.std() > 1:
        slope = float(np.mean((p - p.mean()) * (q - q.mean())) / p.var())
        yield f"contrast x {slope:.2f}", q.mean() + slope * (p - p.mean())


def _hue(made: PixelValues, lies: PixelValues) -> tuple[str, PixelValues]:
    """All hues turned by the angle that fits best."""
    pictures = (Image.fromarray(values[None].astype(np.uint8)) for values in (made, lies))
    hsv_p, hsv_q = (np.array(picture.convert("HSV"))[0] for picture in pictures)
    weight = np.minimum(hsv_p[:, 1].astype(float), hsv_q[:, 1]) * hsv_p[:, 2]
    turn = np.angle((weight * np.exp(2j * np.pi / 256 * (hsv_q[:, 0].astype(float) - hsv_p[:, 0]))).sum())
    hsv_p[:, 0] += np.uint8(round(float(turn) * 128 / np.pi) % 256)
    turned = np.array(Image.fromarray(hsv_p[None], "HSV").convert("RGB"))[0]
    return f"hue turned by {np.degrees(turn):.0f} degrees", turned


def _ratio(p: Float[np.ndarray, "*n"], q: Float[np.ndarray, "*n"]) -> float:
    return float((p * q).sum() / max(float((p * p).sum()), 1e-9))


def _of_metres(made: PixelValues, lies: PixelValues, _: dict[int, str]) -> Iterator[tuple[str, PixelValues]]:
    is_known = np.isfinite(made) & np.isfinite(lies)
    p, q = made[is_known], lies[is_known]
    if not len(p):
        return
    offset = float(np.median(q - p))
    yield f"{abs(100 * offset):.3g} cm {'more' if offset > 0 else 'less'} throughout", made + np.float32(offset)
    factor = float(np.median(q / np.where(p == 0, 1, p)))
    yield f"x {factor:.4g}", made * np.float32(factor)
    rounded = {step: (np.round(p / step) * step).astype(np.float32) for step in STEPS_M}
    step = min(rounded, key=lambda step: float(np.abs(rounded[step] - q).mean()))
    yield f"rounded to {100 * step:g} cm", (np.round(made / step) * step).astype(np.float32)


def _of_ids(made: PixelValues, lies: PixelValues, names: dict[int, str]) -> Iterator[tuple[str, PixelValues]]:
    """Each id as what most of its pixels are."""
    pairs, counts = np.unique(np.stack([made, lies], axis=-1).astype(int), axis=0, return_counts=True)
    most = {a: b for (a, b), _ in sorted(zip(pairs.tolist(), counts, strict=True), key=lambda pair: pair[1])}
    other = {a: b for a, b in most.items() if a != b}
    if not other:
        return
    told = [
        f"{names.get(a, a)} and {names.get(b, b)} exchanged"
        if other.get(b) == a
        else f"{names.get(a, a)} as {names.get(b, b)}"
        for a, b in other.items()
        if other.get(b) != a or a < b
    ]
    by = {b - a for a, b in other.items()}
    said = f"ids {by.pop():+d}" if len(by) == 1 < len(other) else some(told)
    table = np.arange(max(int(made.max()), *other) + 1)
    table[list(other)] = list(other.values())
    yield said, table[made.astype(int)].astype(made.dtype)


def _of_normals(made: PixelValues, lies: PixelValues, _: dict[int, str]) -> Iterator[tuple[str, PixelValues]]:
    """Turned or mirrored, as in another frame."""
    left, _values, right = np.linalg.svd(made.T.astype(float) @ lies)
    turn = left @ right
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    said = "negated" if np.allclose(turn, -np.eye(3), atol=0.05) else f"in another frame, turned by {angle:.0f} degrees"
    said = said if np.linalg.det(turn) > 0 or said == "negated" else "in another frame, mirrored"
    yield said, (made @ turn).astype(np.float32)


FITS: dict[str, Fit] = {"image": _of_colours, "normal": _of_normals, "semantic": _of_ids, "instance": _of_ids}
FITS |= dict.fromkeys(("depth", "height", "range"), _of_metres)
