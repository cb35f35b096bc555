"""Apollo Sim-3D and OpenLane v1 folders as labelled images, so that the baseline trains and scores on them.

Their frames exist here alone; everything that leaves is in our camera frame. Formats: notes/formats.md, 1 and 2.
"""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from PIL import Image, UnidentifiedImageError

from synth3dlanes.errors import FormatError
from synth3dlanes.frames import project
from synth3dlanes.labels import CameraLabel, Kind, Labels, Lane, LaneGraph

from .poses import Pose, road_from_cam

APOLLO_SIZE_PX = (1920, 1080)
APOLLO_IMG_FROM_CAM = ((2015.0, 960.0, 0.0), (0.0, 540.0, -2015.0), (0.0, 1.0, 0.0))
"""The set's intrinsics; its files do not carry them."""
STEP_M = 0.5
MALFORMED = (KeyError, TypeError, IndexError, ValueError)


@dataclass(frozen=True, eq=False)
class ForeignSample:
    """One labelled image; `key` is the path by which its format names it."""

    key: str
    image: UInt8[np.ndarray, "h w 3"]
    labels: Labels


@dataclass(frozen=True, eq=False)
class ApolloSplit:
    """`data_splits/standard/train.json`; its images lie below the nearest folder above that has them."""

    path: Path

    @cached_property
    def lines(self) -> list[str]:
        """One document per line."""
        try:
            text = self.path.read_text(encoding="utf-8")
        except OSError as error:
            raise FormatError(f"{self.path}: expected an Apollo JSON-lines file, got {error}") from None
        return [line for line in text.splitlines() if line.strip()]

    def __len__(self) -> int:
        return len(self.lines)

    def __getitem__(self, index: int, /) -> ForeignSample:
        key = self.key(index)
        roots = [root for root in self.path.parents if (root / key).is_file()]
        if not roots:
            raise FormatError(f"{self.path}:{index + 1}: expected an image {key} in a folder above, got none")
        return ForeignSample(key, read_image(roots[0] / key), self.labels(index))

    def key(self, index: int) -> str:
        """`raw_file`."""
        return str(self._document(index)["raw_file"])

    def labels(self, index: int) -> Labels:
        """The labels alone."""
        where, document = f"{self.path}:{index + 1}", self._document(index)
        try:
            pitch_rad, height_m = float(document["cam_pitch"]), float(document["cam_height"])
            lanes = []
            kinds: tuple[tuple[str, Kind], ...] = (("laneLines", "delimiter"), ("centerLines", "centerline"))
            for name, kind in kinds:
                for points, visible in zip(document[name], document[f"{name}_visibility"], strict=True):
                    xyz_cam = apollo_to_cam(np.array(points, dtype=float).reshape(-1, 3), pitch_rad, height_m)
                    lanes.append((kind, xyz_cam, np.array(visible, dtype=float) > 0))
        except MALFORMED as error:
            raise FormatError(f"{where}: not an Apollo frame: {type(error).__name__}: {error}") from None
        # Their camera stands at (0, h sin p, h cos p) over the plane z = 0: h cos p above the road.
        pose = Pose(pitch_rad, height_m * float(np.cos(pitch_rad)))
        return _labels(APOLLO_SIZE_PX, np.array(APOLLO_IMG_FROM_CAM), pose, lanes)

    def _document(self, index: int) -> dict[str, Any]:
        return _parse(self.lines[index], f"{self.path}:{index + 1}", "raw_file")


@dataclass(frozen=True, eq=False)
class OpenLaneSplit:
    """`.../lane3d_1000/validation`; images lie in `.../images`. It labels no centre lines."""

    path: Path

    @cached_property
    def files(self) -> list[Path]:
        """One JSON file a frame."""
        return sorted(self.path.glob("seg*/*.json"))

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int, /) -> ForeignSample:
        key = self.key(index)
        path = self.path.parents[1] / "images" / key
        return ForeignSample(key, read_image(path), self._labels(index, path))

    def key(self, index: int) -> str:
        """`file_path`."""
        return str(self._document(index)["file_path"])

    def labels(self, index: int) -> Labels:
        """The labels; of the image only its size is read."""
        return self._labels(index, self.path.parents[1] / "images" / self.key(index))

    def _labels(self, index: int, image_path: Path) -> Labels:
        document = self._document(index)
        try:
            intrinsic, extrinsic = (np.array(document[name], dtype=float) for name in ("intrinsic", "extrinsic"))
            fx, fy, cx, cy = intrinsic[0, 0], intrinsic[1, 1], intrinsic[0, 2], intrinsic[1, 2]
            lanes = []
            for lane in document["lane_lines"]:
                forward, left, up = np.array(lane["xyz"], dtype=float)
                kind: Kind = "delimiter"
                lanes.append((kind, np.stack([-left, forward, up], axis=1), np.array(lane["visibility"]) > 0))
            # Camera -> vehicle in axes forward, left, up; pitch is how far the camera's forward axis points down.
            pose = Pose(float(np.arcsin(-extrinsic[2, 0])), float(extrinsic[2, 3]))
        except MALFORMED as error:
            raise FormatError(f"{self.files[index]}: not an OpenLane frame: {type(error).__name__}: {error}") from None
        return _labels(_size(image_path), np.array([[fx, cx, 0], [0, cy, -fy], [0, 1.0, 0]]), pose, lanes)

    def _document(self, index: int) -> dict[str, Any]:
        return _parse(self.files[index].read_text(encoding="utf-8"), str(self.files[index]), "file_path")


def is_openlane(path: Path) -> bool:
    """Whether the folder holds OpenLane segments."""
    return path.is_dir() and any(child.is_dir() for child in path.glob("seg*"))


def apollo_to_cam(xyz_ground: Float[np.ndarray, "n 3"], pitch_rad: float, height_m: float) -> Float[np.ndarray, "n 3"]:
    """From the set's ground frame, whose origin is not at the camera's foot, to our camera frame."""
    cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
    x, y, z = xyz_ground.T
    return np.stack([x, cos * y - sin * z, sin * y + cos * z - height_m], axis=1)


def _labels(
    size_px: tuple[int, int],
    img_from_cam: Float[np.ndarray, "3 3"],
    pose: Pose,
    lanes: list[tuple[Kind, Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]],
) -> Labels:
    made = []
    for index, (kind, xyz_cam, visible) in enumerate(lanes):
        kept = _thinned(xyz_cam)
        if len(kept) >= 2:
            xyz_cam, visible = xyz_cam[kept], visible[kept]
            uv = project(img_from_cam, xyz_cam)
            in_image = ((uv >= 0) & (uv <= size_px)).all(1)
            made.append(Lane(f"{kind}{index}", kind, "main", "none", None, None, xyz_cam, in_image, visible, None))
    to_road = road_from_cam(pose)
    camera = CameraLabel(*size_px, img_from_cam, pose.height_m, pose.pitch_rad, to_road, to_road)
    return Labels(camera, tuple(made), LaneGraph((), {}, None))


def _thinned(xyz_cam: Float[np.ndarray, "n 3"]) -> list[int]:
    """Points half a metre further along y than the last one kept: some files have one every 25 cm, in any order."""
    kept: list[int] = []
    for index in np.argsort(xyz_cam[:, 1], kind="stable").tolist():
        if not kept or xyz_cam[index, 1] >= xyz_cam[kept[-1], 1] + STEP_M - 1e-6:
            kept.append(index)
    return kept


def read_image(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """The pixels of an image file of any kind; raise FormatError where it is none."""
    try:
        with Image.open(path) as image:
            return np.array(image.convert("RGB"))
    except (OSError, UnidentifiedImageError) as error:
        raise FormatError(f"{path}: expected an image, got {error}") from None


def _parse(text: str, where: str, key: str) -> dict[str, Any]:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise FormatError(f"{where}: expected a JSON document, got {error}") from None
    if not isinstance(document, dict) or key not in document:
        raise FormatError(f"{where}: expected a frame with {key}, got {type(document).__name__} without it")
    return document


def _size(path: Path) -> tuple[int, int]:
    try:
        with Image.open(path) as image:
            return (image.width, image.height)
    except (OSError, UnidentifiedImageError) as error:
        raise FormatError(f"{path}: expected an image, got {error}") from None
