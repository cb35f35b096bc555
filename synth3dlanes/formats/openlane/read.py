"""Read OpenLane v1: one label file, or a whole split as labelled images in our camera frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.openlane.convention import PAINTS, WAYMO_FROM_CAM
from synth3dlanes.formats.reading import (
    MALFORMED,
    UNKNOWN,
    ForeignLane,
    ForeignSample,
    image_size,
    json_object,
    labels_of,
    read_image,
    read_text,
)
from synth3dlanes.formats.writing import CV_FROM_CAM
from synth3dlanes.labels import Labels


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
        return parse(read_text(self.files[index]), str(self.files[index]))

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


def parse(text: str, where: str) -> OpenLaneFrame:
    """One label file; FormatErrors begin with `where`."""
    document = json_object(text, where)
    try:
        lines = tuple(
            OpenLaneLine(
                xyz_waymo=np.array(line["xyz"], dtype=float).reshape(3, -1).T,
                visible=np.array(line["visibility"], dtype=float) > 0,
                uv_img=np.array(line.get("uv", [[], []]), dtype=float).reshape(2, -1).T,
                category=line["category"],
                attribute=line.get("attribute", 0),
                track_id=line.get("track_id", 0),
            )
            for line in document["lane_lines"]
        )
        if any(len(line.visible) != len(line.xyz_waymo) for line in lines):
            raise ValueError("expected a visibility for every point of a line")
        intrinsic = np.array(document["intrinsic"], dtype=float).reshape(3, 3)
        extrinsic = np.array(document["extrinsic"], dtype=float).reshape(4, 4)
        return OpenLaneFrame(str(document["file_path"]), intrinsic, extrinsic, lines)
    except (*MALFORMED, AttributeError) as error:
        raise FormatError(f"{where}: not an OpenLane frame: {type(error).__name__}: {error}") from None
