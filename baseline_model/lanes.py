"""Detected lanes with scores: read and written as JSON lines, and decoded from anchors.

Frame: lanes are in camera coordinates, as in the files of `evaluate --predictions` (docs/baseline.md).
"""

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import LaneKind
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.files import Folder, open_regular
from synth3dlanes.system.json_arrays import JsonPoints
from synth3dlanes.system.schema import MAX_BYTES, Excerpt, Metres, Number, Unit, parse

from .anchors import anchor_positions_m
from .config import ModelConfig
from .curves import Pose, cam_from_road
from .onnx_decode import distinct_lanes, natural_spline

DENSE_Y_M = np.arange(101.0)
"""Decoded lanes are sampled every metre of road y; linear interpolation is within 2 mm of the spline."""


@dataclass(frozen=True, eq=False)
class Detection:
    """One detected lane, near to far. `visibility` is the probability that the ground does not hide a point; None if it
    is not estimated."""

    kind: LaneKind
    score: float
    xyz_cam: Float[np.ndarray, "n 3"]
    visibility: Float[np.ndarray, " n"] | None = None


@dataclass(frozen=True, eq=False)
class Prediction:
    """All detections of one image; `pose` is None if it is not estimated, `time_s` if it is no frame of a clip."""

    key: str
    lanes: tuple[Detection, ...]
    pose: Pose | None
    time_s: float | None = None


def interpolate(
    y_m: Float[np.ndarray, " k"], values: Float[np.ndarray, "k ..."], at_m: Float[np.ndarray, " y"], spline: str
) -> Float[np.ndarray, "y ..."]:
    """Interpolate smoothly through the knots, and extrapolate beyond them. A natural cubic spline has a 1-sigma error
    near the car of 2.9 cm, linear interpolation 10.5 cm."""
    if len(y_m) < 2:
        return np.repeat(values, len(at_m), axis=0)
    if spline == "natural":
        return natural_spline(y_m, values, at_m)
    from scipy.interpolate import PchipInterpolator  # takes longer to import than a photograph takes

    return np.asarray(PchipInterpolator(y_m, values)(at_m))


def decode(
    x_m: Float[np.ndarray, "t a k"],
    z_m: Float[np.ndarray, "t a k"],
    scores: Float[np.ndarray, "t a"],
    pose: Pose,
    model: ModelConfig,
    visibility: Float[np.ndarray, "t a k"] | None = None,
) -> tuple[Detection, ...]:
    """Decode the anchors' output, in the road frame of `pose`, as lanes in camera coordinates. Between the knots,
    `visibility` is linear; no point is dropped because it is predicted to be hidden."""
    # In float32, as the network has them.
    x_m = x_m + np.array(anchor_positions_m(model), dtype=np.float32)[:, None].astype(float)
    knots_y_m = np.array(model.knots_y_m)
    types, anchors = distinct_lanes(scores, x_m, z_m, knots_y_m).T
    knots_xz = np.stack([x_m[types, anchors], z_m[types, anchors]], axis=-1)
    dense_xz = interpolate(knots_y_m, np.moveaxis(knots_xz, 0, 1), DENSE_Y_M, model.spline)
    lanes = []
    for i, (lane_type, anchor) in enumerate(zip(types, anchors, strict=True)):
        xyz_road = np.stack([dense_xz[:, i, 0], DENSE_Y_M, dense_xz[:, i, 1]], axis=-1)
        kind: LaneKind = "delimiter" if model.types[lane_type] == "d" else "centerline"
        xyz_cam = transform(cam_from_road(pose), xyz_road)
        seen = None if visibility is None else np.interp(DENSE_Y_M, knots_y_m, visibility[lane_type, anchor])
        lanes.append(Detection(kind, float(scores[lane_type, anchor]), xyz_cam, seen))
    return tuple(lanes)


def to_line(prediction: Prediction) -> str:
    """A prediction as one JSON line; points are rounded to a millimetre."""
    document: dict[str, Any] = {"key": prediction.key, "lanes": [_lane_document(lane) for lane in prediction.lanes]}
    if prediction.pose is not None:
        document["pose"] = {
            "pitch_rad": round(float(prediction.pose.pitch_rad), 8),
            "height_m": round(float(prediction.pose.height_m), 6),
        }
    if prediction.time_s is not None:
        document["time_s"] = round(prediction.time_s, 6)
    return json.dumps(document, separators=(",", ":"), allow_nan=False)


def write_predictions(path: Path, predictions: Iterable[Prediction]) -> None:
    """Write predictions as JSON lines. A killed process leaves no partial file."""
    folder = Folder(path.parent)
    folder.remove_unfinished(path.name)
    with folder.replacing(path.name) as file:
        for prediction in predictions:
            file.write(f"{to_line(prediction)}\n".encode())


def read_predictions(path: Path) -> Iterator[Prediction]:
    """Read predictions of any detector: `key`, `lanes[]` {`kind`, `score`, `xyz_cam`, optionally `visibility`}, and
    optionally `pose`. Other keys are left alone."""
    try:
        with open_regular(path) as file:
            for number in itertools.count(1):
                line = file.readline(MAX_BYTES + 1)
                if not line:
                    return
                if line.strip():
                    yield _prediction(parse(_Line, line, f"{path}:{number}", "a prediction (docs/baseline.md)"))
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror}") from None


def read_by_key(path: Path, keys: Sequence[str]) -> list[Prediction]:
    """Read a prediction for each image with these keys; those without a line have no detections. Unknown and repeated
    keys are errors."""
    found = {key: Prediction(key, (), None) for key in keys}
    given = set[str]()
    for prediction in read_predictions(path):
        if prediction.key not in found:
            raise FormatError(f"{path}: expected keys such as {next(iter(keys), '')!r}, got {prediction.key!r}")
        if prediction.key in given:
            raise FormatError(f"{path}: expected each key once, got {prediction.key!r} again")
        given.add(prediction.key)
        found[prediction.key] = prediction
    return [found[key] for key in keys]


def _lane_document(lane: Detection) -> dict[str, Any]:
    xyz_cam = (np.round(lane.xyz_cam, 3) + 0.0).tolist()
    document: dict[str, Any] = {"kind": lane.kind, "score": round(lane.score, 6), "xyz_cam": xyz_cam}
    if lane.visibility is not None:
        document["visibility"] = np.round(lane.visibility, 3).tolist()
    return document


class _Lane(Excerpt):
    kind: LaneKind
    score: Number
    xyz_cam: Annotated[JsonPoints, Field(min_length=2)]
    visibility: list[Unit] | None = None

    @model_validator(mode="after")
    def _has_a_visibility_for_every_point(self) -> "_Lane":
        if self.visibility is not None and len(self.visibility) != len(self.xyz_cam):
            raise ValueError(f"visibility: expected {len(self.xyz_cam)} values, got {len(self.visibility)}")
        return self


class _Pose(Excerpt):
    pitch_rad: Annotated[float, Field(gt=-math.pi / 2, lt=math.pi / 2)]
    height_m: Metres


class _Line(Excerpt):
    key: str
    lanes: list[_Lane]
    pose: _Pose | None = None
    time_s: Number | None = None


def _prediction(line: _Line) -> Prediction:
    lanes = tuple(
        Detection(lane.kind, lane.score, lane.xyz_cam, None if lane.visibility is None else np.array(lane.visibility))
        for lane in line.lanes
    )
    pose = None if line.pose is None else Pose(line.pose.pitch_rad, line.pose.height_m)
    return Prediction(line.key, lanes, pose, line.time_s)
