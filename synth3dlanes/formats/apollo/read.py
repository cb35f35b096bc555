"""Read Apollo Sim-3D: one line of a label file, or a whole split as labelled images in our camera frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.apollo.convention import CAMERA, apollo_from_cam
from synth3dlanes.formats.reading import (
    MALFORMED,
    ForeignLane,
    ForeignSample,
    json_lines,
    json_object,
    labels_of,
    read_image,
)
from synth3dlanes.formats.writing import CV_FROM_CAM
from synth3dlanes.frames import invert, transform
from synth3dlanes.labels import Labels, LaneKind

PointLists = tuple[Float[np.ndarray, "_ 3"], ...]
Flags = tuple[Bool[np.ndarray, " _"], ...]


@dataclass(frozen=True, eq=False)
class ApolloFrame:
    """One line of a label file as plain arrays; visibilities as flags."""

    raw_file: str
    cam_height_m: float
    cam_pitch_rad: float
    lane_lines_apollo: PointLists
    lane_lines_visible: Flags
    center_lines_apollo: PointLists
    center_lines_visible: Flags

    def labels(self) -> Labels:
        """The lanes in our camera frame. The camera is h cos p above the plane z = 0."""
        cam_from_apollo = invert(apollo_from_cam(self.cam_height_m, self.cam_pitch_rad))
        groups: tuple[tuple[LaneKind, PointLists, Flags], ...] = (
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
    def lines(self) -> Sequence[str]:
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


def parse(line: str, where: str) -> ApolloFrame:
    """One line of a label file; FormatErrors begin with `where`."""
    document = json_object(line, where)
    try:
        points, flags = [], []
        for name in ("laneLines", "centerLines"):
            points.append(tuple(np.array(line, dtype=float).reshape(-1, 3) for line in document[name]))
            flags.append(tuple(np.array(line, dtype=float) > 0 for line in document[f"{name}_visibility"]))
            if [len(line) for line in points[-1]] != [len(line) for line in flags[-1]]:
                raise ValueError(f"expected a visibility for every point of {name}")
        height_m, pitch_rad = float(document["cam_height"]), float(document["cam_pitch"])
        return ApolloFrame(
            str(document["raw_file"]), height_m, pitch_rad, points[0], flags[0], points[1], flags[1]
        )  # fmt: skip
    except MALFORMED as error:
        raise FormatError(f"{where}: not an Apollo frame: {type(error).__name__}: {error}") from None
