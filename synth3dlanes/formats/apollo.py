"""Apollo Sim-3D, of Gen-LaneNet: lane lines and centre lines in 3D, JSON lines, image 1920x1080.

| theirs | ours | unit, frame |
|---|---|---|
| `laneLines`, `centerLines` | delimiters, centre lines, near to far | m, their ground frame (`_apollo`) |
| `laneLines_visibility` and the same of centre lines | up to the last point that terrain does not hide | 0 or 1 |
| `cam_height`, `cam_pitch` | height over the road / cos(pitch), pitch | m, rad, positive = down |

The ground frame is x right, y forward, z up, but its origin is not the camera's foot: the projection that all tools of
the format share puts the camera at (0, h sin p, h cos p), where h is the field `cam_height` and p the pitch.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from pydantic import Field, model_validator

from synth3dlanes.formats.comparing import Comparison, ExportView, OurLine, Rule, SourceSample, camera_problems, compare
from synth3dlanes.formats.format import FrameList, PinholeFormat, Rates, ReadFrame
from synth3dlanes.formats.lines import NEAR_START_M, LaneAhead, keep_lines, lines_ahead, sifted
from synth3dlanes.formats.reading import (
    ForeignLane,
    ForeignSample,
    JsonLine,
    LabelLines,
    first_lines,
    labels_of,
    read_image,
)
from synth3dlanes.formats.scoring import EVERY, GEN_LANENET, Line3d, LinePair, line_score, lines_by, predicted, rates
from synth3dlanes.formats.sidecar import Sidecars
from synth3dlanes.formats.writing import CV_FROM_CAM, POINT_DECIMALS, FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.geometry.frames import invert, road_from_cam, transform
from synth3dlanes.labels.labels import CameraLabel, Labels, LaneKind
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import Matrix4, Polyline3
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.json_arrays import JsonPoints
from synth3dlanes.system.schema import Excerpt, Metres, Number, PathBelow, Unit

CAMERA = Pinhole(1920, 1080, 2015.0)
"""The tools of the format assume it; its files do not carry intrinsics."""
ROOT = "Apollo_Sim_3D_Lane_Release"
MAX_LINES = 6
HALF_WIDTH_M = 10.0
EVALUATED_Y_M = np.arange(3.0, 103.0)
HELD_OUT_ILLUMINATION = 0
FIELDS: dict[LaneKind, str] = {"delimiter": "laneLines", "centerline": "centerLines"}
# Coordinates have six decimals, those of the labels four.
RULES: dict[LaneKind, Rule] = {
    "delimiter": Rule("m", 0.001, most=MAX_LINES, name="lane line"),
    "centerline": Rule("m", 0.001, name="center line"),
}
# The band in which the evaluator compares lines.
BAND_ASIDE_M, BAND_NEAR_M, BAND_FAR_M = 9.0, 5.0, 95.0

README = f"""Apollo Sim-3D / Gen-LaneNet layout.

- `{ROOT}/` is the `dataset_dir`; `images/NN/` holds 1920x1080 images at fx = fy = 2015, cx = 960, cy = 540
  (pixel corners at whole numbers), which their tools hard-code.
- NN = 6 steep + 2 illumination + bent: steep = 1 where the road rises above the camera (their flat-ground
  coordinates are singular there); illumination 0 (dark) to 2 (bright); bent = 1 on curves, exits and merges.
- `data_splits/standard`: everything. `rare_subset`: the same training set, tested on NN >= 06.
  `illus_chg`: trained without illumination 0 (NN 00, 01, 06, 07), tested on it alone.
- `data_lists/<split>/*.txt`: the same frames by name. Files begin with frames that have lanes.
- `cam_pitch` in radians, positive = down. `cam_height` = true height / cos(pitch), which makes their projection
  exact and z = 0 the local road plane; `sidecar.jsonl` holds the true height, road_from_cam, the intrinsics, our
  keys and lane ids, and `max_z_over_h`.
- Visibility is a prefix: terrain hides lanes, cars do not. Lines are ordered from the car outwards.
- The evaluator charges 1.5 m where a line has no near (to 40 m) or no far part: so ground truth as prediction has F = 1
  but errors of some centimetres near and decimetres far.
- LATR explodes the lists into its own folders: delete those after exporting again.
"""


def cam_height_m(height_m: float, pitch_rad: float) -> float:
    """The field `cam_height` of a camera `height_m` above the road: with it the road plane is z = 0."""
    return float(height_m / np.cos(pitch_rad))


def apollo_from_cam(cam_height_m: float, pitch_rad: float) -> Matrix4:
    """From our camera frame to their ground frame."""
    moved = road_from_cam(cam_height_m * float(np.cos(pitch_rad)), pitch_rad)
    moved[1, 3] = cam_height_m * np.sin(pitch_rad)
    return moved


def write(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's label line, the lists that it belongs to and its sidecar line."""
    labels, camera, dropped = frame.labels, frame.labels.camera, Counter[str]()
    raw_file = image_path(frame)
    most: dict[LaneKind, int] = {"delimiter": MAX_LINES, "centerline": len(labels.lanes)}
    lines = {FIELDS[kind]: _kept(labels, kind, n, dropped) for kind, n in most.items()}
    document: dict[str, object] = {
        "raw_file": raw_file,
        "cam_height": cam_height_m(camera.height_m, camera.pitch_rad),
        "cam_pitch": camera.pitch_rad,
    }
    for name, kept in lines.items():
        points = [np.round(apollo_from_cv(line.points_cv, camera), POINT_DECIMALS).tolist() for line in kept]
        document |= {name: points, f"{name}_visibility": [line.visible.astype(float).tolist() for line in kept]}
    is_rare, is_held_out = "steep" in frame.tags, frame.illumination == HELD_OUT_ILLUMINATION
    splits = ["standard"]
    splits += ["rare_subset"] if frame.is_train or is_rare else []
    splits += ["illus_chg"] if frame.is_train != is_held_out else []
    # Tools open train and test; val is for people.
    parts = sorted({frame.part, "test"} if frame.serves_as("test") else {frame.part})
    lists = [f"{split}/{part}" for split in splits for part in parts]
    return FrameAnnotation(
        image=f"{ROOT}/{raw_file}",
        n_lines=len(lines["laneLines"]),
        dropped=dropped,
        shared=(
            (json.dumps(document), tuple(f"data_splits/{name}.json" for name in lists)),
            (raw_file, tuple(f"data_lists/{name}.txt" for name in lists)),
            (_sidecar(frame, raw_file, **lines), ("sidecar.jsonl",)),
        ),
    )


def image_path(frame: PinholeFrame) -> str:
    """`images/NN/name.jpg`: exactly three components, unique over all splits."""
    bent = not frame.tags.isdisjoint(("curve", "merge_split"))
    folder = 6 * ("steep" in frame.tags) + 2 * frame.illumination + bent
    return f"images/{folder:02d}/{frame.split}_{frame.key}.jpg"


def apollo_from_cv(points_cv: Float[np.ndarray, "n 3"], camera: CameraLabel) -> Float[np.ndarray, "n 3"]:
    """Their ground coordinates: the inverse of their own projection."""
    ground_from_cam = apollo_from_cam(cam_height_m(camera.height_m, camera.pitch_rad), camera.pitch_rad)
    return transform(ground_from_cam, points_cv @ CV_FROM_CAM)


def _kept(labels: Labels, kind: LaneKind, most: int, dropped: Counter[str]) -> tuple[LaneAhead, ...]:
    def is_kept(line: LaneAhead) -> bool:
        points_apollo = apollo_from_cv(line.points_cv[line.visible], labels.camera)
        return len(points_apollo) < 2 or _is_evaluated(points_apollo)

    reason = "its visible part is never within 10 m beside the camera's axis, 3 to 102 m ahead"
    near = sifted(lines_ahead(labels, CAMERA, kind), is_kept, dropped, reason)
    return keep_lines(near, dropped, most, f"beyond the {most} nearest (cap of LATR, PersFormer, Anchor3DLane)")


def _is_evaluated(points_apollo: Float[np.ndarray, "n 3"]) -> bool:
    # The evaluator counts a line that it cannot match, so at least two of its own samples must be on the line,
    # and the loaders want two of the line's points in the same band.
    x_m, y_m, _ = points_apollo.T
    start_m, end_m = y_m[0], y_m[-1]
    sampled_y_m = EVALUATED_Y_M[(start_m <= EVALUATED_Y_M) & (end_m >= EVALUATED_Y_M)]
    in_band = np.abs(np.interp(sampled_y_m, y_m, x_m)) <= HALF_WIDTH_M
    return bool(np.count_nonzero(in_band) >= 2 and np.count_nonzero(np.abs(x_m) < HALF_WIDTH_M) >= 2)


def _sidecar(
    frame: PinholeFrame, raw_file: str, laneLines: tuple[LaneAhead, ...], centerLines: tuple[LaneAhead, ...]
) -> str:
    camera = frame.labels.camera
    heights_m = [apollo_from_cv(line.points_cv[line.visible], camera)[:, 2] for line in (*laneLines, *centerLines)]
    highest_m = float(np.max(np.concatenate(heights_m))) if heights_m else 0.0
    document = {
        "raw_file": raw_file,
        "source": f"{frame.split}/{frame.key}",
        "tags": sorted(frame.tags),
        "cv_img_from_cam": CAMERA.img_from_cv.tolist(),
        "camera_height_m": camera.height_m,
        "camera_pitch_rad": camera.pitch_rad,
        "road_from_cam": camera.road_from_cam.tolist(),
        "max_z_over_h": round(highest_m / camera.height_m, 4),
        "laneLines_ids": [line.id for line in laneLines],
        "centerLines_ids": [line.id for line in centerLines],
        "starts_beyond_20_m": [bool(line.points_cv[0, 2] > NEAR_START_M) for line in laneLines],
    }
    return json.dumps(document)


class ApolloFrame(Excerpt):
    raw_file: PathBelow
    cam_height_m: Metres = Field(alias="cam_height")
    cam_pitch_rad: float = Field(alias="cam_pitch", gt=-math.pi / 2, lt=math.pi / 2)
    laneLines: list[JsonPoints]
    laneLines_visibility: list[list[Number]]
    centerLines: list[JsonPoints]
    centerLines_visibility: list[list[Number]]

    @model_validator(mode="after")
    def _every_point_has_a_visibility(self) -> "ApolloFrame":
        for name in FIELDS.values():
            lines, seen = getattr(self, name), getattr(self, f"{name}_visibility")
            if list(map(len, lines)) != list(map(len, seen)):
                raise ValueError(f"{name}_visibility: expected a value for every point of {name}")
        return self

    @property
    def height_m(self) -> float:
        """How far the camera is above the plane z = 0."""
        return self.cam_height_m * float(np.cos(self.cam_pitch_rad))

    def lines_apollo(self, kind: LaneKind) -> list[Polyline3]:
        """Lines in their ground frame."""
        lines: list[Polyline3] = getattr(self, FIELDS[kind])
        return lines

    def lines_cam(self, kind: LaneKind) -> list[Polyline3]:
        """Lines in our camera frame."""
        cam_from_apollo = invert(apollo_from_cam(self.cam_height_m, self.cam_pitch_rad))
        return [transform(cam_from_apollo, points_apollo) for points_apollo in self.lines_apollo(kind)]

    def visible(self, kind: LaneKind) -> list[Bool[np.ndarray, " _"]]:
        """Which points of each line are visible."""
        return [np.array(seen) > 0 for seen in getattr(self, f"{FIELDS[kind]}_visibility")]

    def labels(self) -> Labels:
        """The lanes in our camera frame."""
        lanes = [
            ForeignLane(kind, points_cam, visible)
            for kind in FIELDS
            for points_cam, visible in zip(self.lines_cam(kind), self.visible(kind), strict=True)
        ]
        return labels_of(CAMERA.size_px, CAMERA.img_from_cv @ CV_FROM_CAM, self.height_m, self.cam_pitch_rad, lanes)


def parse(line: str | bytes, where: str) -> ApolloFrame:
    """One line of a label file; FormatErrors begin with `where`."""
    return schema.parse(ApolloFrame, line, where, "a frame of Apollo Sim-3D")


class ApolloSplit(LabelLines):
    """`data_splits/standard/train.json`; its images lie below the nearest folder above that has them."""

    def __getitem__(self, index: int, /) -> ForeignSample:
        frame = self.frame(index)
        roots = [root for root in self.path.parents if (root / frame.raw_file).is_file()]
        if not roots:
            where = f"{self.path}:{index + 1}"
            raise FormatError(f"{where}: expected an image {frame.raw_file} in a folder above, got none")
        return ForeignSample(frame.raw_file, read_image(roots[0] / frame.raw_file), frame.labels())

    def frame(self, index: int) -> ApolloFrame:
        return parse(self.lines[index], f"{self.path}:{index + 1}")

    def key(self, index: int) -> str:
        """`raw_file`."""
        return self.frame(index).raw_file

    def labels(self, index: int) -> Labels:
        """The labels alone."""
        return self.frame(index).labels()


class _Sidecar(Excerpt):
    raw_file: str
    laneLines_ids: list[str]
    centerLines_ids: list[str]


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    ids = Sidecars(out, _Sidecar, "raw_file")
    for path in sorted((out / "data_splits").glob("*/*.json")):
        yield FrameList(str(path.relative_to(out)), _frames(path, most_frames, ids))


def _frames(path: Path, most_frames: int, ids: Sidecars[_Sidecar]) -> Iterator[ReadFrame]:
    for number, line in enumerate(first_lines(path, most_frames), start=1):
        where = f"{path}:{number}"
        frame = parse(line, where)
        image = f"{ROOT}/{frame.raw_file}"
        yield ReadFrame(image, where, image, (frame, ids[frame.raw_file]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lane lines and centre lines in metres."""
    found, ids = frame.content
    view = ExportView(CAMERA.img_from_cv, CAMERA.size_px)
    compared = Comparison(problems=tuple(camera_problems(truth, found.height_m, found.cam_pitch_rad)))
    for kind, name in FIELDS.items():
        ours = [_in_band(lane.in_metres(view)) for lane in truth.lanes(kind)]
        compared += compare(found.lines_cam(kind), ours, RULES[kind], getattr(ids, f"{name}_ids"))[0].because(
            f"{RULES[kind].name} {i}: expected visible points first, got a hidden one before them"
            for i, visible in enumerate(found.visible(kind))
            if (np.diff(visible.astype(int)) > 0).any()
        )
    return compared


def _in_band(line: OurLine) -> OurLine:
    x, y, _ = line.wanted.T
    in_band = (np.abs(x) < BAND_ASIDE_M) & (y > BAND_NEAR_M) & (y < BAND_FAR_M)
    return line if in_band.sum() >= 3 else OurLine(line.id, line.points, line.wanted[:0])


class _Prediction(Excerpt):
    raw_file: str
    laneLines: tuple[JsonLine, ...]
    laneLines_prob: tuple[Unit, ...]
    centerLines: tuple[JsonLine, ...] = ()
    centerLines_prob: tuple[Unit, ...] = ()

    @model_validator(mode="after")
    def _every_line_has_a_probability(self) -> "_Prediction":
        if any(len(getattr(self, name)) != len(getattr(self, f"{name}_prob")) for name in FIELDS.values()):
            raise ValueError("expected a probability for every line")
        return self


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A file of JSON lines with `raw_file`, `laneLines`, `laneLines_prob`, and the same of centre lines."""
    by_image = lines_by(predictions, _Prediction, "raw_file")

    def of_frame(frame: ReadFrame) -> dict[LaneKind, LinePair] | None:
        true: ApolloFrame = frame.content[0]
        found = by_image.get(true.raw_file)
        if found is None:
            return None
        pairs = dict[LaneKind, LinePair]()
        for kind, name in FIELDS.items():
            lines, shares = getattr(found, name), getattr(found, f"{name}_prob")
            guessed = [Line3d.whole(points, probability=share) for points, share in zip(lines, shares, strict=True)]
            pairs[kind] = list(map(Line3d, true.lines_apollo(kind), true.visible(kind))), guessed
        return pairs

    for name, frames in predicted(read(out, EVERY), of_frame, predictions):
        for kind in FIELDS:
            pairs = [pair_of[kind] for _, pair_of in frames]
            if kind == "delimiter" or any(found for _, found in pairs):
                yield rates(f"{name}, {RULES[kind].name}s", len(frames), line_score(pairs, GEN_LANENET))


FORMAT = PinholeFormat(
    title="Apollo Sim-3D (Gen-LaneNet): lane lines and centre lines in 3D",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    score=score,
    tolerances={rule.unit: rule.limit for rule in RULES.values()},
    camera=CAMERA,
    is_f_free=False,
    is_size_free=False,
    links={"images": f"{ROOT}/images"},
)
