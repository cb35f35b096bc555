"""Make one sample: scene -> labels -> image -> bytes -> disk. The first sample loads Blender.

Of a recipe with a condition, sample n has SCENES_OF_ONE scenes to itself, those from n * SCENES_OF_ONE on (clip n, and
moment n of a rig, likewise), and shows the first of them that fits. So what it shows depends on no other sample, and a
set can be resumed, extended, and divided among workers.
"""

import importlib.util
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from synth3dlanes import __version__
from synth3dlanes.dataset.columns import PLACE_COLUMNS, numbers_of, table
from synth3dlanes.dataset.format import Picture, encode, member_names
from synth3dlanes.dataset.query import rows_where
from synth3dlanes.dataset.write import Shard
from synth3dlanes.draw.sample import Scenes, draw_world, sample_world, world_in_shot
from synth3dlanes.imaging.daylight import daylight
from synth3dlanes.imaging.layers import Layers
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.distributions import form
from synth3dlanes.params.groups import CameraParams
from synth3dlanes.params.shots import SINGLE, ShotNumbers
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.scene.assets.catalogue import BUILT_IN, FIRST_KINDS, KINDS, Library
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import SCENES_OF_ONE, TRIES, RenderSettings
from synth3dlanes.system.errors import DrawError, InputError, MissingPackageError
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.height_map import height_map
from synth3dlanes.world.world import View, World

# The least number of drawn scenes from which the share that fits a condition is estimated.
PROBED = 30
# While none fits, the time between two lines that say so.
TELL_EVERY_S = 10.0
# Columns that say nothing about a scene, and columns that are known only once it is rendered.
OF_FILES = ("key", "index", "sha256", *PLACE_COLUMNS)
OF_PICTURES = ("object_hidden_fraction", "n_visible_centerlines", "n_visible_delimiters")


@dataclass(frozen=True)
class Condition:
    """A query on the columns of the index (docs/format.md), as of `gallery --where`, and the most scenes to draw for a
    sample until one fits."""

    query: str
    tries: int = TRIES

    def __post_init__(self) -> None:
        if not 1 <= self.tries <= SCENES_OF_ONE:
            raise InputError(f"tries: expected 1 to {SCENES_OF_ONE}, got {self.tries}")
        for name in OF_PICTURES:
            if re.search(rf"\b{name}\b", self.query):
                raise InputError(f"where {self.query}: expected columns of scenes and labels, got {name} of pictures")

    def fits(self, scenes: Scenes, drawn: World) -> bool:
        """Whether a drawn scene fits, as its first view and frame by its first camera shows it. Raises InputError for a
        query that cannot be read."""
        world = world_in_shot(scenes, drawn, ShotNumbers(drawn.scene.index, 0, 0))
        row = {"key": "0", "index": 0, **numbers_of(world.scene, label(world, world.view))}
        found = table([row])
        known = [name for name in found.column_names if name not in (*OF_FILES, *OF_PICTURES)]
        return len(rows_where(found.select(known), self.query)) > 0

    def probe(self, scenes: Scenes, tell: Callable[[str], None] = lambda line: None) -> str:
        """How many of the scenes drawn for the first sample fit, in words. `tell` is called now and then while none is
        found. Raises DrawError if none does."""
        first = fitting_world(scenes, self, 0, tell).scene.index
        others = range(first + 1, PROBED)
        n_fitting = 1 + sum(self.fits(scenes, draw_world(scenes, number)) for number in others)
        return f"where {self.query} ({n_fitting} of the first {max(PROBED, first + 1)} scenes drawn fit)"


# The pictures of one scene are made one after the other.
@lru_cache(maxsize=1)
def fitting_world(
    scenes: Scenes, condition: Condition, n: int, tell: Callable[[str], None] = lambda line: None
) -> World:
    """The world of the scene that sample n shows, or clip n. `tell` is called now and then while none is found. Raises
    DrawError if none of those drawn fits."""
    told_s = time.monotonic()
    for drawn in range(condition.tries):
        world = draw_world(scenes, n * SCENES_OF_ONE + drawn)
        if condition.fits(scenes, world):
            return world
        if time.monotonic() - told_s > TELL_EVERY_S:
            tell(f"where {condition.query}: 0 of {drawn + 1:,} scenes drawn fit; at most {condition.tries:,} are drawn")
            told_s = time.monotonic()
    raise DrawError(
        f"where {condition.query}: expected a scene that fits, got none in {condition.tries:,} tries for sample "
        f"{n} (up to {SCENES_OF_ONE:,} can be asked for)"
    )


def belongs_to(number: int, n: int) -> bool:
    """Whether a scene is one of those drawn for sample n."""
    return number // SCENES_OF_ONE == n


@dataclass(frozen=True)
class Recipe:
    """All values that decide the bytes of a split's samples, except the index: what is drawn, and how it is rendered.
    `library` has the files of the assets. With `where`, scenes are drawn for each sample until one fits."""

    scenes: Scenes
    settings: RenderSettings
    image_format: str
    library: Library = BUILT_IN
    where: Condition | None = field(default=None, kw_only=True)

    def world(self, index: int) -> World:
        if self.where is None:
            return sample_world(self.scenes, index)
        place = self.scenes.shots.place(index)
        return world_in_shot(self.scenes, fitting_world(self.scenes, self.where, place.scene), place)

    def scene(self, index: int) -> Scene:
        return self.world(index).scene

    def description(self) -> dict[str, Any]:
        """The part of `dataset.json` that identifies the recipe. Samples of recipes that differ here do not mix."""
        scenes = self.scenes
        return {
            "generator": __version__,
            "seed": scenes.seed,
            "image_format": self.image_format,
            "render": asdict(self.settings),
            "params": scenes.params.model_dump(mode="json"),
            "assets": {
                kind: {own.name: asdict(own) for own in self.library.assets.own(kind)}
                for kind in KINDS
                # Older data sets know the first ones only.
                if kind in FIRST_KINDS or self.library.assets.own(kind)
            },
            **({} if scenes.shots == SINGLE else {"shots": scenes.shots.model_dump(mode="json")}),
            **({} if scenes.like is None else {"like": scenes.like.model_dump(mode="json")}),
            **({} if scenes.map is None else {"map": scenes.map.description()}),
            **({} if self.where is None else {"where": self.where.query}),
        }

    @property
    def cameras(self) -> tuple[CameraSpec | CameraParams, ...]:
        """The cameras that see every scene: the shots' cameras, or the parameters' camera."""
        return self.scenes.shots.cameras or (self.scenes.params.camera,)

    @property
    def sizes(self) -> str:
        """The images' sizes, as in "480x360 px"."""
        sizes = [f"{form(camera.width_px)}x{form(camera.height_px)}" for camera in self.cameras]
        return f"{', '.join(dict.fromkeys(sizes))} px"

    @property
    def names(self) -> tuple[str, ...]:
        return member_names(self.image_format, self.settings.passes)


@dataclass(frozen=True)
class EncodedSample:
    """The bytes of a sample's members by name, and the seconds of each stage."""

    members: dict[str, bytes]
    timings: dict[str, float]


def require_blender() -> None:
    """Raise MissingPackageError where this Python has no bpy."""
    if importlib.util.find_spec("bpy") is None:
        version = ".".join(map(str, sys.version_info[:2]))
        raise MissingPackageError(
            f"Blender's module bpy is not installed in Python {version} ({sys.executable}). It is published for "
            "Python 3.11 only; with that: pip install 'bpy==4.5.*'"
        )


def make_sample(recipe: Recipe, index: int) -> EncodedSample:
    """Draw, label, render and encode sample `index`."""
    start = time.perf_counter()
    world = recipe.world(index)
    seconds = time.perf_counter() - start
    made = make_image(world, recipe.settings, recipe.image_format, recipe.library)
    return EncodedSample(made.members, {"sample": seconds, **made.timings})


def make_image(world: World, settings: RenderSettings, image_format: str, library: Library) -> EncodedSample:
    """Take a world's picture and encode it with its labels."""
    picture, timings = _timed_picture(world, settings, library)
    start = time.perf_counter()
    text = scene_module.to_json(world.scene)
    quality = world.scene.sensor.jpeg_quality
    members = encode(picture, text, image_format, quality)
    return EncodedSample(members, {**timings, "encode": time.perf_counter() - start})


def take_picture(world: World, settings: RenderSettings, library: Library = BUILT_IN) -> Picture:
    """Label, render and develop a world as its scene's camera sees it."""
    return _timed_picture(world, settings, library)[0]


def _timed_picture(world: World, settings: RenderSettings, library: Library) -> tuple[Picture, dict[str, float]]:
    """The picture of a world, and the seconds of each stage."""
    # Loaded here: only processes that render may load Blender, and scipy would slow the start of all others.
    from synth3dlanes.blender.render import render
    from synth3dlanes.imaging.develop import develop

    view, start = world.view, time.perf_counter()
    labels = label(world, view)
    labelled = time.perf_counter()
    light = daylight(world.scene, float(view.eye_world[2]))
    lit = time.perf_counter()
    rendering = render(world, view, light, labels, settings, library)
    rendered = time.perf_counter()
    image = develop(world.scene, view, light, rendering.layers, world.site.street_lamps)
    passes = _passes(world, view, rendering.layers, settings.passes)
    seconds = {"labels": labelled - start, "light": lit - labelled, "develop": time.perf_counter() - rendered}
    return Picture(image, rendering.labels, passes, rendering.sweep), {**seconds, **rendering.timings}


def _passes(world: World, view: View, layers: Layers, names: Sequence[str]) -> dict[str, np.ndarray]:
    """The layers that a sample keeps beside its image."""
    found = {"depth": layers.depth_m, "normal": layers.normal, "semantic": layers.semantic, "instance": layers.instance}
    passes = {name: layer for name, layer in found.items() if name in names and layer is not None}
    if "height" in names:
        passes["height"] = height_map(world.ground, view.world_from_road).astype(np.float32)
    return passes


def make_part(
    maker: Callable[[Recipe, int], EncodedSample], recipe: Recipe, shard: Shard, index: int
) -> dict[str, float | dict[str, float]]:
    """In a worker: make one sample and store it. Returns its bytes and the seconds of each stage."""
    start = time.perf_counter()
    made = maker(recipe, index)
    before = time.perf_counter()
    size = shard.write_part(index, made.members)
    end = time.perf_counter()
    return {"bytes": size, "seconds": end - start, "stages": {**made.timings, "write": end - before}}


def scene_json(recipe: Recipe, index: int) -> str:
    """The scene of sample `index` as `scene.json`, without Blender."""
    return scene_module.to_json(recipe.scene(index))
