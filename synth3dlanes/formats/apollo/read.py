"""Read Apollo Sim-3D: one line of a label file, or a whole split as labelled images in our camera frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field, model_validator

from synth3dlanes.formats.apollo.convention import CAMERA, apollo_from_cam
from synth3dlanes.formats.reading import (
    ForeignLane,
    ForeignSample,
    json_lines,
    labels_of,
    read_image,
)
from synth3dlanes.formats.writing import CV_FROM_CAM
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import Labels, LaneKind
from synth3dlanes.system import schema
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import JsonPoints
from synth3dlanes.system.schema import Excerpt, Metres, Number, PathBelow

PointLists = tuple[Float[np.ndarray, "_ 3"], ...]
FlagLists = tuple[Bool[np.ndarray, " _"], ...]


@dataclass(frozen=True, eq=False)
class ApolloFrame:
    """One line of a label file as plain arrays; visibilities as flags."""

    raw_file: str
    cam_height_m: float
    cam_pitch_rad: float
    lane_lines_apollo: PointLists
    lane_lines_visible: FlagLists
    center_lines_apollo: PointLists
    center_lines_visible: FlagLists

    def labels(self) -> Labels:
        """The lanes in our camera frame. The camera is h cos p above the plane z = 0."""
        cam_from_apollo = invert(apollo_from_cam(self.cam_height_m, self.cam_pitch_rad))
        groups: tuple[tuple[LaneKind, PointLists, FlagLists], ...] = (
            ("delimiter", self.lane_lines_apollo, self.lane_lines_visible),
            ("centerline", self.center_lines_apollo, self.center_lines_visible),
        )
        lanes = [
            ForeignLane(kind, transform(cam_from_apollo, points_apollo), visible)
            for kind, lines, flags in groups
            for points_apollo, visible in zip(lines, flags, strict=True)
        ]
        size_px = (CAMERA.width_px, CAMERA.height_px)
        height_m = self.cam_height_m * float(np.cos(self.cam_pitch_rad))
        return labels_of(size_px, CAMERA.img_from_cv @ CV_FROM_CAM, height_m, self.cam_pitch_rad, lanes)


@dataclass(frozen=True, eq=False)
class ApolloSplit:
    """`data_splits/standard/train.json`; its images lie below the nearest folder above that has them."""

    path: Path

    @cached_property
    def lines(self) -> Sequence[bytes]:
        """One document per line."""
        return json_lines(self.path)

    def __len__(self) -> int:
        return len(self.lines)

    def __getitem__(self, index: int, /) -> ForeignSample:
        frame = self.frame(index)
        roots = [root for root in self.path.parents if (root / frame.raw_file).is_file()]
        if not roots:
            where = f"{self.path}:{index + 1}"
            raise FormatError(f"{where}: expected an image {frame.raw_file} in a folder above, got none")
        return ForeignSample(frame.raw_file, read_image(roots[0] / frame.raw_file), frame.labels())

    def frame(self, index: int) -> ApolloFrame:
        """One line of the file."""
        return parse(self.lines[index], f"{self.path}:{index + 1}")

    def key(self, index: int) -> str:
        """`raw_file`."""
        return self.frame(index).raw_file

    def labels(self, index: int) -> Labels:
        """The labels alone."""
        return self.frame(index).labels()


def parse(line: str | bytes, where: str) -> ApolloFrame:
    """One line of a label file; FormatErrors begin with `where`."""
    found = schema.parse(_Line, line, where, "a frame of Apollo Sim-3D")
    return ApolloFrame(
        found.raw_file,
        found.cam_height,
        found.cam_pitch,
        tuple(found.laneLines),
        tuple(np.array(seen) > 0 for seen in found.laneLines_visibility),
        tuple(found.centerLines),
        tuple(np.array(seen) > 0 for seen in found.centerLines_visibility),
    )


class _Line(Excerpt):
    raw_file: PathBelow
    cam_height: Metres
    cam_pitch: Annotated[float, Field(gt=-math.pi / 2, lt=math.pi / 2)]
    laneLines: list[JsonPoints]
    laneLines_visibility: list[list[Number]]
    centerLines: list[JsonPoints]
    centerLines_visibility: list[list[Number]]

    @model_validator(mode="after")
    def _every_point_has_a_visibility(self) -> "_Line":
        for name in ("laneLines", "centerLines"):
            lines, seen = getattr(self, name), getattr(self, f"{name}_visibility")
            if list(map(len, lines)) != list(map(len, seen)):
                raise ValueError(f"{name}_visibility: expected a value for every point of {name}")
        return self
