"""`sidecar.jsonl` of exports whose format has no place for the camera or for our ids: a line of JSON for each image."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Generic, TypeVar

from synth3dlanes.formats.comparing import ExportView, FoundLines, Points
from synth3dlanes.formats.reading import read_file
from synth3dlanes.formats.writing import PinholeFrame
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import JsonMatrix3
from synth3dlanes.system.schema import Excerpt, Positive, parse

SIDECAR = "sidecar.jsonl"


def sidecar(image: str, frame: PinholeFrame, lines_ids: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """A frame's line of `sidecar.jsonl`, for formats that have pixels only: the camera, and where the frame is from."""
    document = {
        "image": image,
        "source": f"{frame.split}/{frame.key}",
        "img_from_cv": frame.pinhole.img_from_cv.tolist(),
        "camera_height_m": frame.labels.camera.height_m,
        "camera_pitch_rad": frame.labels.camera.pitch_rad,
        "lines_ids": list(lines_ids),
    }
    return json.dumps(document), (SIDECAR,)


class Sidecar(Excerpt):
    """A frame's line, of formats that have pixels only."""

    image: str
    img_from_cv: JsonMatrix3
    camera_height_m: Positive
    camera_pitch_rad: float
    lines_ids: list[str]

    def found(self, lines_px: Sequence[Points], size_px: tuple[int, int]) -> FoundLines:
        """Lines of its image, of this width and height, as they are compared."""
        view = ExportView(self.img_from_cv, size_px)
        return FoundLines(lines_px, view, self.lines_ids, self.camera_height_m, self.camera_pitch_rad)


Line = TypeVar("Line", bound=Excerpt)


class Sidecars(dict[str, Line], Generic[Line]):
    """The lines of an export by the images that `key` names; FormatError for an image without one."""

    def __init__(self, out: Path, model: type[Line], key: str = "image") -> None:
        self.path = out / SIDECAR
        # An export without frames has none.
        lines = read_file(self.path).splitlines() if self.path.exists() else []
        for number, line in enumerate(lines, start=1):
            found = parse(model, line, f"{self.path}:{number}", "a frame of an export")
            self[getattr(found, key)] = found

    def __missing__(self, image: str) -> Line:
        raise FormatError(f"{self.path}: expected a line of the image {image}, got none")
