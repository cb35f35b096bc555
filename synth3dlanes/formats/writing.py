"""What every foreign format's writer takes and returns. Paths are relative to the exported folder."""

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import project
from synth3dlanes.labels import Labels, Lane

CV_FROM_CAM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""OpenCV's camera axes (frame `_cv`: x right, y down, z forward) from ours."""
DECIMALS = 6

Part = Literal["train", "val", "test"]
PARTS: tuple[Part, ...] = ("train", "val", "test")


@dataclass(frozen=True)
class Pinhole:
    """A camera without distortion, its principal point `below_px` under the middle of the image."""

    width_px: int
    height_px: int
    f_px: float
    below_px: float = 0.0

    @property
    def img_from_cv(self) -> Float[np.ndarray, "3 3"]:
        """The usual intrinsic matrix K."""
        cy_px = self.height_px / 2 + self.below_px
        return np.array([[self.f_px, 0, self.width_px / 2], [0, self.f_px, cy_px], [0, 0, 1.0]])

    def resized(self, width_px: int, height_px: int) -> "Pinhole":
        """The camera of another image size with the same horizontal field of view."""
        scale = width_px / self.width_px
        return Pinhole(width_px, height_px, self.f_px * scale, self.below_px * scale)

    def project(self, points_cv: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Pixels of points in front of the camera."""
        return project(self.img_from_cv, points_cv)


@dataclass(frozen=True)
class ExportFrame:
    """One of our images and what decides how a format files it: `key` counts within `split`, `number` within the
    export. It is used for `part`; `parts` are all that the data set has."""

    split: str
    key: str
    number: int
    part: Part
    parts: frozenset[Part]

    @property
    def is_train(self) -> bool:
        """Whether networks train on it."""
        return self.part == "train"

    def serves_as(self, part: Part) -> bool:
        """Whether tools that open this part find the frame: where a data set has val frames only or test frames only,
        they serve as both."""
        return part == self.part or (not self.is_train and part != "train" and part not in self.parts)


@dataclass(frozen=True)
class PinholeFrame(ExportFrame):
    """A frame whose image is resampled: `pinhole` is its camera there; `tags` are the kinds of scene; `illumination` is
    0 (dark) to 2 (bright); `clip` is the number of the first picture of its clip by this camera, None for single
    pictures. `kerbs` are those of formats that have them."""

    pinhole: Pinhole
    tags: frozenset[str]
    illumination: int
    clip: int | None = None
    kerbs: tuple[Lane, ...] = ()


@dataclass(frozen=True)
class FrameAnnotation:
    """A frame in a foreign format: where its image goes, label files of its own, and lines of shared files, each with
    the files that it belongs to. `dropped` counts lanes by reason. Without `image`, none is written."""

    image: str | None
    n_lines: int
    dropped: Counter[str] = field(default_factory=Counter)
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    shared: tuple[tuple[str, tuple[str, ...]], ...] = ()


SIDECAR = "sidecar.jsonl"


def sidecar(image: str, labels: Labels, frame: PinholeFrame, lines_ids: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """A frame's line of `sidecar.jsonl`, for formats that have pixels only: the camera, and where the frame is from."""
    document = {
        "image": image,
        "source": f"{frame.split}/{frame.key}",
        "img_from_cv": frame.pinhole.img_from_cv.tolist(),
        "camera_height_m": labels.camera.height_m,
        "camera_pitch_rad": labels.camera.pitch_rad,
        "lines_ids": list(lines_ids),
    }
    return json.dumps(document), (SIDECAR,)


@dataclass(frozen=True, kw_only=True)
class Format:
    """One foreign format: the README of an export, and links within it. `lists` are files that tools open even where no
    frame belongs there; `replaced_words` what tools replace wherever a path has it; `counted` is what `n_lines` counts.

    A shared file holds the lines of its frames. If it is to be one document, `document` makes that of the file's path
    in the export and the file of its lines.
    """

    readme: str
    links: Mapping[str, str] = field(default_factory=dict)
    lists: tuple[str, ...] = ()
    replaced_words: tuple[str, ...] = ()
    document: Callable[[str, Path], Iterator[str]] | None = None
    counted: str = "lane lines"


@dataclass(frozen=True, kw_only=True)
class PinholeFormat(Format):
    """A format with a camera of its own, to which images are resampled, and the function that writes one frame; that
    returns None where the format has no place for the frame.

    A frame that is too narrow for the camera gets a longer focal length of its own if `is_f_free`, and is left out
    otherwise; images may have any size if `is_size_free`. Frames come with their kerbs if it `has_kerbs`.
    """

    camera: Pinhole
    is_f_free: bool
    is_size_free: bool
    has_kerbs: bool = False
    annotate: Callable[[Labels, PinholeFrame], FrameAnnotation | None]
