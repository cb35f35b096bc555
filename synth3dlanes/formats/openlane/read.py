"""Read OpenLane v1: one label file, or a whole split as labelled images in our camera frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from pydantic import model_validator

from synth3dlanes.formats.openlane.convention import PAINTS, WAYMO_FROM_CAM
from synth3dlanes.formats.reading import (
    UNKNOWN,
    ForeignLane,
    ForeignSample,
    image_size,
    labels_of,
    read_file,
    read_image,
)
from synth3dlanes.formats.writing import CV_FROM_CAM
from synth3dlanes.labels.labels import Labels
from synth3dlanes.system import schema
from synth3dlanes.system.json_arrays import JsonMatrix3, JsonMatrix4
from synth3dlanes.system.schema import Excerpt, Number, PathBelow


@dataclass(frozen=True, eq=False)
class OpenLaneLine:
    """One line of a frame as plain arrays, points transposed to n x 3. Some files lack `attribute` and `track_id`."""

    xyz_waymo: Float[np.ndarray, "n 3"]
    visible: Bool[np.ndarray, " n"]
    uv_img: Float[np.ndarray, "m 2"]
    category: int
    attribute: int
    track_id: int


@dataclass(frozen=True, eq=False)
class OpenLaneFrame:
    """One label file."""

    file_path: str
    img_from_cv: Float[np.ndarray, "3 3"]
    vehicle_from_cam_waymo: Float[np.ndarray, "4 4"]
    lines: tuple[OpenLaneLine, ...]

    def labels(self, size_px: tuple[int, int]) -> Labels:
        """The lines in our camera frame, of an image of this width and height; the format has no centre lines."""
        lanes = [
            ForeignLane("delimiter", line.xyz_waymo @ WAYMO_FROM_CAM, line.visible, PAINTS.get(line.category, UNKNOWN))
            for line in self.lines
        ]
        # Pitch is how far the camera's forward axis points down in the vehicle's frame.
        pitch_rad = float(np.arcsin(-self.vehicle_from_cam_waymo[2, 0]))
        height_m = float(self.vehicle_from_cam_waymo[2, 3])
        return labels_of(size_px, self.img_from_cv @ CV_FROM_CAM, height_m, pitch_rad, lanes)


@dataclass(frozen=True, eq=False)
class OpenLaneSplit:
    """`.../lane3d_1000/validation`; images lie in `.../images`."""

    path: Path

    @cached_property
    def files(self) -> Sequence[Path]:
        """One JSON file a frame."""
        return sorted(self.path.glob("seg*/*.json"))

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int, /) -> ForeignSample:
        frame = self.frame(index)
        image = read_image(self._image(frame))
        return ForeignSample(frame.file_path, image, frame.labels((image.shape[1], image.shape[0])))

    def frame(self, index: int) -> OpenLaneFrame:
        """One label file."""
        return parse(read_file(self.files[index]), str(self.files[index]))

    def key(self, index: int) -> str:
        """`file_path`."""
        return self.frame(index).file_path

    def labels(self, index: int) -> Labels:
        """The labels; of the image only its size is read."""
        frame = self.frame(index)
        return frame.labels(image_size(self._image(frame)))

    def _image(self, frame: OpenLaneFrame) -> Path:
        return self.path.parents[1] / "images" / frame.file_path


def is_openlane(path: Path) -> bool:
    """Whether the folder holds OpenLane segments."""
    return path.is_dir() and any(child.is_dir() for child in path.glob("seg*"))


def parse(text: str | bytes, where: str) -> OpenLaneFrame:
    """One label file; FormatErrors begin with `where`."""
    found = schema.parse(_Frame, text, where, "a frame of OpenLane")
    lines = tuple(
        OpenLaneLine(
            xyz_waymo=np.array(line.xyz, dtype=float).T,
            visible=np.array(line.visibility) > 0,
            uv_img=np.array(line.uv, dtype=float).T,
            category=line.category,
            attribute=line.attribute,
            track_id=line.track_id,
        )
        for line in found.lane_lines
    )
    return OpenLaneFrame(found.file_path, found.intrinsic, found.extrinsic, lines)


class _Line(Excerpt):
    xyz: tuple[list[Number], list[Number], list[Number]]
    visibility: list[Number]
    uv: tuple[list[Number], list[Number]] = ([], [])
    category: int
    attribute: int = 0
    track_id: int = 0

    @model_validator(mode="after")
    def _has_whole_points(self) -> "_Line":
        if len({*map(len, self.xyz), len(self.visibility)}) > 1:
            raise ValueError("expected as many x, y and z as values of visibility")
        if len(self.uv[0]) != len(self.uv[1]):
            raise ValueError("uv: expected as many u as v")
        return self


class _Frame(Excerpt):
    file_path: PathBelow
    intrinsic: JsonMatrix3
    extrinsic: JsonMatrix4
    lane_lines: list[_Line]

    @model_validator(mode="after")
    def _is_a_camera(self) -> "_Frame":
        turn = self.extrinsic[:3, :3]
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3):
            raise ValueError("extrinsic: expected a rotation and a place")
        if min(self.intrinsic[0, 0], self.intrinsic[1, 1]) <= 0:
            raise ValueError("intrinsic: expected focal lengths above 0")
        return self
