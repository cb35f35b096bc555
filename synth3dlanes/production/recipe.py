"""One sample: scene -> labels -> image -> bytes -> disk. Blender is loaded with the first sample."""

import importlib.util
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from synth3dlanes import __version__
from synth3dlanes import scene as scene_module
from synth3dlanes.catalogue import BUILT_IN, KINDS, Library
from synth3dlanes.dataset.format import encode, member_names
from synth3dlanes.dataset.write import Shard
from synth3dlanes.errors import MissingPackageError
from synth3dlanes.ground_truth import ground_truth
from synth3dlanes.params import Params
from synth3dlanes.sample import sample_scene
from synth3dlanes.scene import Scene
from synth3dlanes.settings import RenderSettings


@dataclass(frozen=True)
class Recipe:
    """All that decides the bytes of a split's samples, but for their index."""

    params: Params
    seed: int
    split: str
    settings: RenderSettings
    image_format: str
    library: Library = field(default=BUILT_IN, kw_only=True)

    def scene(self, index: int) -> Scene:
        """The world of sample `index`."""
        return sample_scene(self.params, self.seed, self.split, index, self.library.assets)

    def description(self) -> dict[str, Any]:
        """What `dataset.json` says about it; samples of two recipes that differ here do not mix."""
        return {
            "generator": __version__,
            "seed": self.seed,
            "image_format": self.image_format,
            "render": asdict(self.settings),
            "params": self.params.model_dump(mode="json"),
            "assets": {kind: {own.name: asdict(own) for own in self.library.assets.own(kind)} for kind in KINDS},
        }

    @property
    def names(self) -> tuple[str, ...]:
        """The members of every sample."""
        return member_names(self.image_format, self.settings.passes)


@dataclass(frozen=True)
class Made:
    """A sample's members by name, and seconds by stage."""

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


def make_sample(recipe: Recipe, index: int) -> Made:
    """Draw, label, render and encode sample `index`."""
    start = time.perf_counter()
    scene = recipe.scene(index)
    seconds = time.perf_counter() - start
    made = make_image(scene, recipe.settings, recipe.image_format, recipe.library)
    return Made(made.members, {"sample": seconds, **made.timings})


def make_image(scene: Scene, settings: RenderSettings, image_format: str, library: Library) -> Made:
    """Label, render and encode a scene."""
    # Loaded here: only the processes that render may carry Blender.
    from synth3dlanes.blender.render import render

    clock = [time.perf_counter()]
    labels = ground_truth(scene)
    clock.append(time.perf_counter())
    rendering = render(scene, labels, settings, library)
    clock.append(time.perf_counter())
    text = scene_module.to_json(scene)
    members = encode(rendering.image, rendering.labels, text, rendering.passes, image_format)
    clock.append(time.perf_counter())
    return Made(members, {"labels": clock[1] - clock[0], **rendering.timings, "encode": clock[3] - clock[2]})


def make_part(
    maker: Callable[[Recipe, int], Made], recipe: Recipe, shard: Shard, index: int
) -> dict[str, float | dict[str, float]]:
    """What a worker does: make one sample and keep it; returns its size and the seconds by stage."""
    start = time.perf_counter()
    made = maker(recipe, index)
    before = time.perf_counter()
    size = shard.write_part(index, made.members)
    end = time.perf_counter()
    return {"bytes": size, "seconds": end - start, "stages": {**made.timings, "write": end - before}}


def scene_json(recipe: Recipe, index: int) -> str:
    """The scene of sample `index` as `scene.json`, without Blender."""
    return scene_module.to_json(recipe.scene(index))
