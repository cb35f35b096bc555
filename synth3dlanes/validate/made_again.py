"""Make samples of a data set again, as its `dataset.json` says, and compare them with what lies there.

Equal bytes need no more words: one kind of machine makes them. Of another kind of machine, or where something is wrong,
the members are read and compared layer by layer with tolerances (`likeness`, `like_documents`).
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from typing import NamedTuple, TypeVar

import numpy as np
from PIL import Image

from synth3dlanes import __version__
from synth3dlanes.dataset.description import DESCRIPTION, Description
from synth3dlanes.dataset.format import (
    HEIGHT,
    IMAGE_FORMATS,
    LABELS,
    LIDAR,
    PASSES,
    SCENE,
    Picture,
    decode_image,
    encode,
    read_passes,
    read_sweep,
)
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.labels.labels import Labels
from synth3dlanes.production.devices import WorkerSlots, resolve_device
from synth3dlanes.production.forecast import patience_s
from synth3dlanes.production.recipe import Recipe, take_picture
from synth3dlanes.production.workers import Limits, Pool
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.assets.catalogue import Library
from synth3dlanes.scene.assets.folder import require_assets
from synth3dlanes.scene.instance_ids import END, thing_of
from synth3dlanes.scene.settings import PASSES as ALL_PASSES
from synth3dlanes.scene.settings import SEMANTIC_IDS, RenderSettings
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.validate.causes import likely_cause
from synth3dlanes.validate.integrity import Entry, read_sample
from synth3dlanes.validate.like_documents import unlike
from synth3dlanes.validate.likeness import (
    CONTRAST,
    LayerPair,
    Raster,
    contrast,
    wrong_colours,
    wrong_ids,
    wrong_normals,
    wrong_values,
)
from synth3dlanes.validate.origin import Origin
from synth3dlanes.validate.report import VERDICTS
from synth3dlanes.world.world import resolve

T = TypeVar("T")
Members = Mapping[str, bytes]
# Passes that say what each pixel of a picture is of.
IDS = ("semantic", "instance")
SURFACES = END  # numbers of surfaces beyond those of objects
CLASSES = {number: name for name, number in SEMANTIC_IDS.items()}


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
    settings = RenderSettings(description.render.samples, description.render.passes, description.render.device)
    recipe = Recipe(
        Scenes(origin.params, origin.seed, "", assets=library.assets, shots=origin.shots),
        settings,
        description.image_format,
        library,
    )
    try:
        return RemakePlan(origin, *resolve_device(recipe))
    except InputError:
        # Pixels of another device agree within the tolerances.
        return RemakePlan(origin, *resolve_device(replace(recipe, settings=replace(settings, device="auto"))))


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
    lies, _ = read_sample(entry)
    try:
        scene = origin.drawn(scene_module.from_json(lies[SCENE], SCENE), entry.split, entry.index)
    except (InputError, FormatError, ValueError, LookupError, ArithmeticError) as error:
        return RemakeResult(entry.name, False, [f"cannot be made again: {' '.join(str(error).split())}"])
    asked = recipe.settings
    passes = tuple(name for name in (*ALL_PASSES, "lidar") if name in asked.passes or name in IDS)
    world = resolve(scene)
    made = take_picture(world, replace(asked, passes=passes), recipe.library)
    kept = {name: pixels for name, pixels in made.passes.items() if name in asked.passes}
    text, quality = scene_module.to_json(scene), scene.sensor.jpeg_quality
    members = encode(replace(made, passes=kept), text, recipe.image_format, quality)
    faults = [f"made again: {fault}" for fault in compare(made, members, lies)]
    return RemakeResult(entry.name, members == lies, faults)


def compare(picture: Picture, made: Members, lies: Members) -> Iterator[str]:
    """How what lies there differs from what was made, by more than the kind of machine explains."""
    faults: list[Fault] = []
    for name in made:
        if made[name] == lies.get(name):
            continue
        try:
            if name in (SCENE, LABELS):
                yield from (f"{name}: {line}" for line in unlike(made[name], lies[name]))
                continue
            faults += [fault for layer in _layers(picture, name, made, lies) for fault in _faults(layer)]
            if name in IMAGE_FORMATS:
                yield from _of_detail(made[name], lies[name], bool(faults))
        except (FormatError, KeyError, ValueError) as error:
            yield f"{name}: cannot be compared: {error}"
    puzzles = {fault.layer for fault in faults if not fault.is_explained}
    shows = any(fault.layer == "image" for fault in faults)
    is_alone = puzzles == {"image"} and len(faults) == 1 and PASSES in made
    for fault in faults:
        scene = "rendered from another scene" if len(puzzles) > 1 and shows else ""
        reason = scene or ("the passes agree, so light, colours or materials differ" if is_alone else "")
        yield ": ".join(filter(None, [fault.text, "" if fault.is_explained else reason]))


def _layers(picture: Picture, name: str, made: Members, lies: Members) -> Iterator[LayerPair]:
    """The arrays of a member."""
    prefix, passes = "", picture.passes
    if name == LIDAR and picture.labels.lidar is not None:
        sweeps = (vars(read_sweep(members[name], name, picture.labels.lidar)) for members in (made, lies))
        own, other = ({key.removesuffix("_m"): sweep[key] for key in ("range_m", *IDS)} for sweep in sweeps)
        prefix, passes = "lidar ", own
    elif name in IMAGE_FORMATS:
        own, other = ({"image": decode_image(members[name], name)} for members in (made, lies))
        prefix, passes = "", picture.passes
    else:
        own, other = (read_passes(members[name], name) for members in (made, lies))
    if set(own) != set(other):
        raise FormatError(f"expected {', '.join(own)}, got {', '.join(other)}")
    for kind, pixels in own.items():
        if pixels.shape != other[kind].shape:
            sizes = ["x".join(str(size) for size in found.shape[1::-1]) for found in (pixels, other[kind])]
            raise FormatError(f"{kind}: expected {sizes[0]} pixels, got {sizes[1]}")
    shown, names = _shown(passes), _names(picture.labels, passes)
    also = _shown(_lying_ids(lies, passes) if not prefix else other) if name != HEIGHT else shown
    for kind, pixels in own.items():
        test = wrong_colours(_numbered(shown)) if kind == "image" else TESTS.get(kind, wrong_values)
        here, there, known = shown, also, names
        if kind == "height":
            here = there = np.zeros(pixels.shape, int)
        elif kind in IDS:
            here, there = pixels.astype(int), other[kind].astype(int)
            known = CLASSES if kind == "semantic" else {**names, 0: "nothing"}
        yield LayerPair(f"{prefix}{kind}", pixels, other[kind], test, here, there, known)


def _lying_ids(lies: Members, passes: Mapping[str, Raster]) -> Mapping[str, Raster]:
    """The ids that lie there, or else those made again."""
    try:
        found = read_passes(lies[PASSES], PASSES)
    except (FormatError, KeyError):
        return passes
    fits = {name for name in found if name in IDS and found[name].shape == passes[name].shape}
    return {name: found[name] if name in fits else passes[name] for name in IDS}


TESTS = {"normal": wrong_normals, "semantic": wrong_ids, "instance": wrong_ids}


def _shown(passes: Mapping[str, Raster]) -> Raster:
    """What pixels show: instance ids of objects, numbers of surfaces elsewhere."""
    semantic, instance = (passes[name].astype(int) for name in IDS)
    return np.where(instance > 0, instance, SURFACES + semantic)


def _numbered(shown: Raster) -> Raster:
    """From 0 on without gaps."""
    return np.unique(shown, return_inverse=True)[1].reshape(shown.shape)


def _names(labels: Labels, passes: Mapping[str, Raster]) -> dict[int, str]:
    """Names of objects and surfaces by their numbers."""
    lines = [lane.id for lane in labels.lanes if lane.kind == "delimiter"]
    names = {SURFACES + number: name for number, name in CLASSES.items()}
    for number in np.unique(passes["instance"]).tolist():
        kind, of_kind = thing_of(number)
        if kind == "structure":
            kind = CLASSES.get(int(np.bincount(passes["semantic"][passes["instance"] == number]).argmax()), kind)
        is_line = kind == "delimiter" and of_kind < len(lines)
        names[number] = f"line {lines[of_kind]}" if is_line else f"{kind} {of_kind}"
    return names


class Fault(NamedTuple):
    """How a layer differs; whether a cause explains it."""

    layer: str
    text: str
    is_explained: bool


def _faults(layer: LayerPair) -> Iterator[Fault]:
    """How a layer differs, where, by how much, and why."""
    wrong = layer.wrong(layer.made, layer.lies)
    if not (wrong > 0).any():
        return
    at, cause = np.nonzero(wrong), likely_cause(layer, wrong)
    place = f"u {at[1].min()}-{at[1].max()}, v {at[0].min()}-{at[0].max()}"
    told = f"{layer.name}: {len(at[0])} of {wrong.size} pixels differ ({place}{_size(layer, at)})"
    yield Fault(layer.name, ": ".join(filter(None, [told, cause.words])), cause.is_explained)


def _size(layer: LayerPair, at: tuple[np.ndarray, ...]) -> str:
    """By how much."""
    made, lies = layer.made[at], layer.lies[at]
    if layer.wrong is wrong_ids:
        return ""
    with np.errstate(invalid="ignore"):
        error = np.abs(made.astype(float) - lies)
    if layer.wrong is wrong_values:
        known = error[np.isfinite(error)]
        return f"; {np.median(known):.3g} m in the median" if len(known) else ""
    unit = "" if layer.wrong is wrong_normals else " levels"
    return f"; {error.mean():.3g}{unit} on average"


def _of_detail(made: bytes, lies: bytes, is_known: bool) -> Iterator[str]:
    """How single pixels differ: another quality of JPEG, or, where no other fault is known, blur or noise."""
    own, other = Image.open(BytesIO(made)), Image.open(BytesIO(lies))
    tables = [getattr(image, "quantization", {}) for image in (own, other)]
    if tables[0] != tables[1]:
        means = [np.mean([np.mean(table) for table in found.values()]) if found else 0 for found in tables]
        yield f"image: expected JPEG of the scene's quality, got {means[1] / means[0]:.1f} times as coarse steps"
        return
    share = contrast(*(np.array(image.convert("RGB")) for image in (own, other)))
    if not is_known and not CONTRAST[0] < share < CONTRAST[1]:
        said = "blurred" if share < 1 else "noise"
        yield f"image: single pixels have {share:.2f} times the contrast: {said}"
