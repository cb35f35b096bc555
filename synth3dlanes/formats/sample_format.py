"""Formats that take samples as they are, with their own cameras: what their writers get."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Shaped

from synth3dlanes.formats.writing import ExportFrame, Format, FrameAnnotation
from synth3dlanes.labels import CameraLabel, Labels
from synth3dlanes.scene import Scene


@dataclass(frozen=True, eq=False)
class SampleFrame(ExportFrame):
    """A frame taken as it is, with its scene, its labels (a rolled camera stays rolled) and its passes by name, if the
    format asks for any. The image is of `image_format`, jpg or png. `cameras` are those of all exported pictures of
    this moment by a rig, itself included, by their keys: for the first of them, none for the others."""

    scene: Scene
    labels: Labels
    passes: Mapping[str, Shaped[np.ndarray, "..."]]
    image_format: str
    cameras: Mapping[str, CameraLabel] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SampleFormat(Format):
    """A format that takes samples as they are, and the function that writes one frame. Images are copied byte for byte,
    and encoded anew only if their path asks for the other image format.

    Data sets must have the passes `passes`. If it `is_per_scene`, only the first frame of each scene is written.
    """

    annotate: Callable[[SampleFrame], FrameAnnotation | None]
    passes: tuple[str, ...] = ()
    is_per_scene: bool = False
