"""Make samples of a data set again, as its `dataset.json` says, and compare them with what lies there.

Equal bytes need no more words: one kind of machine makes them. Of another kind of machine, or where something is wrong,
the members are read and compared layer by layer with tolerances. A picture is compared by means: over blocks of several
sizes, and over each object and surface; noise of rendering is the smaller, the more pixels a mean has. Other layers are
compared pixel by pixel; single pixels, as in the seams between two objects, may differ.
"""

import json
import re
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from PIL import Image
from scipy.ndimage import uniform_filter

from synth3dlanes import __version__
from synth3dlanes.dataset.description import DESCRIPTION, Description
from synth3dlanes.dataset.format import (
    IMAGE_FORMATS,
    LABELS,
    LIDAR,
    SCENE,
    Picture,
    decode_image,
    encode,
    read_passes,
    read_sweep,
)
from synth3dlanes.labels.labels import MASKS, Labels
from synth3dlanes.production.devices import WorkerSlots, resolve_device
from synth3dlanes.production.forecast import patience_s
from synth3dlanes.production.job import Job, pictures_of
from synth3dlanes.production.recipe import Recipe, take_picture
from synth3dlanes.production.workers import Limits, Pool
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.assets.catalogue import Library
from synth3dlanes.scene.assets.folder import require_assets
from synth3dlanes.scene.instance_ids import END
from synth3dlanes.scene.settings import PASSES as ALL_PASSES
from synth3dlanes.system.arrays import IdImage
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.validate.evidence import luma
from synth3dlanes.validate.findings import differences, some
from synth3dlanes.validate.integrity import Entry, read_sample
from synth3dlanes.validate.labels import ROUNDED
from synth3dlanes.validate.origin import Origin
from synth3dlanes.validate.report import VERDICTS
from synth3dlanes.world.world import resolve

T = TypeVar("T")
Members = Mapping[str, bytes]
Raster = Shaped[np.ndarray, "h w *c"]
ErrorMap = Float[np.ndarray, "h w"]

# Passes that say what each pixel shows.
IDS = ("semantic", "instance")
# Levels of 255 by which means of n pixels may differ: NOISE[0] + NOISE[1] / sqrt(n). Renders by another random seed, or
# of twice the samples a pixel, stay below 0.8 of it; machines differ far less.
NOISE = (3.0, 110.0)
BLOCKS, LEAST_PIXELS = (4, 8, 16, 32, 64), 8
# Wrong pixels are no clump if fewer than CLUMP of 9 neighbours are wrong, or at most FEW of all and SHARE of all.
CLUMP, FEW, SHARE = 3, 3, 0.005
# Errors of depths, heights and ranges: in metres, and as a share.
VALUE_M, VALUE_SHARE = 5e-4, 5e-5
NORMAL = 0.02
# Contrast of single pixels in relation to that of the picture made again: blurred below, noisy above.
CONTRAST = (0.9, 1.1)
DETAIL_PX, FAINT = 16, 0.25
# Points that graze an object may be seen by one machine and not by another: one, or this share of the masks' ends.
GRAZING = 0.05
OF_MASK = re.compile(rf"\.({'|'.join(MASKS)})\.\d+: ")


class RemakeResult(NamedTuple):
    """What came of making a sample again: whether its bytes are equal, and how it differs otherwise."""

    name: str
    is_equal: bool
    faults: Sequence[str]

    @property
    def verdict(self) -> str:
        """One of the report's `VERDICTS`."""
        return VERDICTS[0 if self.is_equal else 2 if self.faults else 1]


@dataclass(frozen=True)
class RemakePlan:
    """How the samples of a data set are made again on this machine."""

    origin: Origin
    recipe: Recipe
    slots: WorkerSlots


def how_to_make(description: Description, origin: Origin | None, library: Library) -> RemakePlan:
    """How to make a data set's samples again. Raises InputError where this version, its assets or its dataset.json
    cannot, MissingPackageError without Blender."""
    if origin is None:
        raise InputError(f"rerender: {DESCRIPTION} does not say how its samples are made")
    if description.generator != __version__:
        raise InputError(
            f"rerender: made by version {description.generator}, and this one, {__version__}, makes other samples: "
            "use that version, or validate without"
        )
    require_assets(origin.assets, library, DESCRIPTION)
    job = Job(**pictures_of(origin), assets=library)
    try:
        return RemakePlan(origin, *resolve_device(job.recipe()))
    except InputError:
        # Pixels of another device agree within the tolerances.
        return RemakePlan(origin, *resolve_device(job.changed({"device": "auto"}).recipe()))


def some_of(entries: Sequence[T], n: int, seed: int) -> list[T]:
    """Some samples at random, in order: the same for equal seeds, and some more of them for a larger n."""
    chosen = np.random.default_rng(seed).permutation(len(entries))[:n]
    return [entries[i] for i in sorted(chosen)]


def make_again(making: RemakePlan, entries: Sequence[Entry], workers: int) -> Iterator[RemakeResult]:
    """Make samples again in worker processes, as `generate` does."""
    todo, limits = deque(entries), Limits(patience_s(making.recipe))
    with Pool(max(1, min(workers or making.slots.workers, len(todo))), limits, masks=making.slots.masks) as pool:
        while todo or pool.busy:
            while todo and pool.idle:
                entry = todo.popleft()
                pool.start(entry.name, _make, making.origin, making.recipe, entry)
            for outcome in pool.wait(1.0):
                failed = RemakeResult(outcome.task, False, [f"cannot be made again: {outcome.reason}"])
                yield outcome.value if outcome.status == "done" else failed


def _make(origin: Origin, recipe: Recipe, entry: Entry) -> RemakeResult:
    found, _ = read_sample(entry)
    try:
        scene = origin.drawn(scene_module.from_json(found[SCENE], SCENE), entry.split, entry.index)
    except (InputError, FormatError, ValueError, LookupError, ArithmeticError) as error:
        return RemakeResult(entry.name, False, [f"cannot be made again: {' '.join(str(error).split())}"])
    asked = recipe.settings
    passes = tuple(name for name in (*ALL_PASSES, "lidar") if name in asked.passes or name in IDS)
    world = resolve(scene)
    made = take_picture(world, replace(asked, passes=passes), recipe.library)
    kept = {name: pixels for name, pixels in made.passes.items() if name in asked.passes}
    text, quality = scene_module.to_json(scene), scene.sensor.jpeg_quality
    members = encode(replace(made, passes=kept), text, recipe.image_format, quality)
    faults = [f"made again: {fault}" for fault in compare(made, members, found)]
    return RemakeResult(entry.name, members == found, faults)


def clumps(off: Bool[np.ndarray, "h w"]) -> ErrorMap:
    """Where pixels are off that are more than a few at a seam: none, or all of them."""
    together = off & (uniform_filter(off.astype(np.float32), 3, mode="constant") * 9 > CLUMP - 0.5)
    is_wrong = together.sum() > FEW or off.mean() > SHARE
    return (off if off.mean() > SHARE else together).astype(np.float32) * is_wrong


def wrong_values(made: Raster, found: Raster) -> ErrorMap:
    """The errors of metres, which may be infinite."""
    with np.errstate(invalid="ignore"):
        off = np.abs(made - found) > VALUE_M + VALUE_SHARE * np.abs(found)
    return clumps(np.where(np.isfinite(made) & np.isfinite(found), off, made != found))


def wrong_colours(made: Raster, found: Raster, shown: IdImage) -> ErrorMap:
    """The errors of a picture in levels of 255, beyond what noise explains; `shown` numbers its objects and surfaces
    from 0."""
    error = made.astype(np.float32) - found
    excess = np.zeros(shown.shape, np.float32)
    for size in BLOCKS:
        rows, columns = (n // size for n in shown.shape)
        whole = excess[: rows * size, : columns * size]
        blocks = error[: rows * size, : columns * size].reshape(rows, size, columns, size, 3)
        means = np.abs(blocks.mean(axis=(1, 3))).max(axis=-1) - _noise(size * size)
        # Where smaller blocks show it, they show better where.
        is_told = whole.reshape(rows, size, columns, size).max(axis=(1, 3)) > 0
        whole += np.kron(np.where(is_told, 0, np.maximum(means, 0)), np.ones((size, size), np.float32))
    areas = np.bincount(shown.ravel())
    sums = np.stack([np.bincount(shown.ravel(), error[..., i].ravel()) for i in range(3)], axis=-1)
    means = np.abs(sums).max(axis=-1) / np.maximum(areas, 1) - _noise(np.maximum(areas, 1))
    is_told = np.bincount(shown.ravel(), excess.ravel()) > 0
    means = np.where(is_told | (areas < LEAST_PIXELS) | (areas > BLOCKS[-1] ** 2), 0, np.maximum(means, 0))
    return np.asarray(excess + means[shown], np.float32)


def _noise(n: int | Int[np.ndarray, " n"]) -> Float[np.ndarray, "*n"]:
    return np.asarray(NOISE[0] + NOISE[1] / np.sqrt(n))


def contrast(made: Raster, found: Raster) -> float:
    """The contrast of single pixels to their neighbours, as a multiple of that in the picture made again; the median of
    blocks."""
    squares = []
    for picture in (made, found):
        gray = luma(picture)
        squares.append(uniform_filter((gray - uniform_filter(gray, 3)) ** 2, DETAIL_PX)[::DETAIL_PX, ::DETAIL_PX])
    return float(np.sqrt(np.median((squares[1] + FAINT) / (squares[0] + FAINT))))


def unlike(made: bytes, found: bytes) -> list[str]:
    """A line for each value of a scene or of labels that differs; of masks, where more differ than graze."""
    expected, other = json.loads(made), json.loads(found)
    lines = list(differences(expected, other, tolerance=ROUNDED._replace(least=1e-5)))
    flips = [line for line in lines if OF_MASK.search(line)]
    masks = [item.get(name) or [] for key in ("lanes", "symbols") for item in expected.get(key, ()) for name in MASKS]
    ends = sum(int(np.count_nonzero(np.diff(mask))) for mask in masks)
    return lines if len(flips) > 1 + GRAZING * ends else [line for line in lines if line not in flips]


def compare(picture: Picture, made: Members, found: Members) -> Iterator[str]:
    """Where and by how much what a sample has differs from what was made, by more than the kind of machine explains."""
    for name in made:
        if made[name] == found.get(name):
            continue
        try:
            if name in (SCENE, LABELS):
                lines = unlike(made[name], found[name])
                yield from [f"{name}: {some(lines)}"] if lines else []
                continue
            layers, others = (_layers(name, members[name], picture.labels) for members in (made, found))
            if set(layers) != set(others):
                raise FormatError(f"expected {', '.join(layers)}, got {', '.join(others)}")
            faults = [fault for layer in layers for fault in _unlike_layer(picture, layer, layers, others)]
            yield from faults
            if name in IMAGE_FORMATS:
                yield from _unlike_detail(made[name], found[name], bool(faults))
        except (FormatError, KeyError, ValueError) as error:
            yield f"{name}: cannot be compared: {error}"


def _layers(name: str, data: bytes, labels: Labels) -> dict[str, Raster]:
    """The arrays of a member by their names."""
    if name == LIDAR:
        if labels.lidar is None:
            raise FormatError("expected none, as the labels have no lidar")
        sweep = vars(read_sweep(data, name, labels.lidar))
        return {f"lidar {key.removesuffix('_m')}": sweep[key] for key in ("range_m", *IDS)}
    return {"image": decode_image(data, name)} if name in IMAGE_FORMATS else dict(read_passes(data, name))


def _unlike_layer(
    picture: Picture, layer: str, layers: Mapping[str, Raster], others: Mapping[str, Raster]
) -> Iterator[str]:
    """At how many pixels a layer differs, where these are, and by how much."""
    made, found = layers[layer], others[layer]
    if made.shape != found.shape:
        sizes = ["x".join(str(size) for size in pixels.shape[1::-1]) for pixels in (made, found)]
        raise FormatError(f"{layer}: expected {sizes[0]} pixels, got {sizes[1]}")
    kind = layer.rpartition(" ")[2]
    if kind == "image":
        semantic, instance = (picture.passes[name].astype(int) for name in IDS)
        shown = np.unique(np.where(instance > 0, instance, END + semantic), return_inverse=True)[1]
        wrong = wrong_colours(made, found, shown.reshape(semantic.shape))
    elif kind in IDS:
        wrong = clumps(made != found)
    else:
        wrong = clumps(np.abs(made - found).max(axis=-1) > NORMAL) if kind == "normal" else wrong_values(made, found)
    if not (wrong > 0).any():
        return
    at = np.nonzero(wrong)
    with np.errstate(invalid="ignore"):
        error = np.abs(made[at].astype(float) - found[at])
    error = error[np.isfinite(error)]
    by_kind = {"image": (np.mean, "levels on average"), "normal": (np.mean, "on average")}
    of, words = by_kind.get(kind, (np.median, "m in the median"))
    size = f"; {of(error):.3g} {words}" if kind not in IDS and error.size else ""
    place = f"u {at[1].min()}-{at[1].max()}, v {at[0].min()}-{at[0].max()}"
    yield f"{layer}: {len(at[0])} of {wrong.size} pixels differ ({place}{size})"


def _unlike_detail(made: bytes, found: bytes, is_known: bool) -> Iterator[str]:
    """How single pixels differ: another quality of JPEG, or, where no other fault is known, their contrast."""
    own, other = Image.open(BytesIO(made)), Image.open(BytesIO(found))
    tables = [getattr(image, "quantization", {}) for image in (own, other)]
    if tables[0] != tables[1]:
        means = [np.mean([np.mean(table) for table in each.values()]) if each else 0 for each in tables]
        yield f"image: expected JPEG of the scene's quality, got {means[1] / means[0]:.1f} times as coarse steps"
        return
    share = contrast(*(np.array(image.convert("RGB")) for image in (own, other)))
    if not is_known and not CONTRAST[0] < share < CONTRAST[1]:
        yield f"image: expected detail of single pixels, got {share:.2f} times its contrast"
