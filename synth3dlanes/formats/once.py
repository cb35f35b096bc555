"""ONCE-3DLanes: lines in 3D, one JSON a frame, image 1920x1020.

| theirs | ours | unit, frame |
|---|---|---|
| `lanes` | delimiters, far to near | m, camera: x right, y down, z forward (`_cv`) |
| `calibration` | the matrix K and a column of zeros | px |
| `camera_height_m`, `camera_pitch_rad` | the same; in our exports alone | m, rad |
"""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Float
from PIL import Image, ImageDraw
from pydantic import Field

from synth3dlanes.formats.comparing import (
    Comparison,
    ExportView,
    FoundLines,
    Rule,
    SourceSample,
    compare_lines,
    distances,
)
from synth3dlanes.formats.format import FrameList, PinholeFormat, Rates, ReadFrame
from synth3dlanes.formats.lines import LaneAhead, keep_lines, lines_ahead
from synth3dlanes.formats.reading import JsonLine, listed_files, read_text
from synth3dlanes.formats.scoring import EVERY, Scores, f_score, overlaps, scored
from synth3dlanes.formats.writing import CV_FROM_CAM, PARTS, POINT_DECIMALS, FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.geometry.polylines import resampled
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import MaskImage, Polyline3
from synth3dlanes.system.json_arrays import Row4
from synth3dlanes.system.schema import Excerpt, Number, Unit

CAMERA = Pinhole(1920, 1020, 958.0)
"""About the cameras of the original; every label file carries its own intrinsics."""
ROOT = "ONCE_3DLanes"
MAX_LINES = 8
RASTER_M = 10.0
"""How far ahead and to each side the evaluator assigns lines by their place."""
FRAMES_PER_SEQUENCE = 1000
RULE = Rule("m", 0.001, direction=-1, most=MAX_LINES)

README = f"""ONCE-3DLanes layout.

- `{ROOT}/{{train,val,test}}/<seq>/cam01/*.json`, images in `{ROOT}/data/<seq>/cam01/*.jpg`. Loaders assume 1920x1020
  unless they are told another size. Where the data set has only one of val and test, its frames are in both folders:
  some tools open the one, some the other.
- Tools replace "train", "val" or "test" by "data" in the WHOLE path: keep these words out of the folders above.
- `lanes`: points in the camera frame x right, y down, z forward, metres, far to near. `calibration`: 3x4, one for each
  frame: c in the middle of the image (pixel corners at whole numbers); f = 958 for a width of 1920 as in the original,
  or longer where the frame's own field of view is narrower than that.
- The format has no extrinsics; loaders assume 1.5 m and 0.5 or 0.3 degrees. The true values are in the extra keys
  `camera_height_m` and `camera_pitch_rad` (positive = down).
- The official evaluator assigns lines by what lies within 10 m ahead and 10 m to the side. So lines keep their
  stretch below the image. Lines without a part there come last: it pairs those in the order of the list.
- `annotations`, `raw_data` (links) and `data_lists` are for Anchor3DLane.
"""


def write(frame: PinholeFrame) -> FrameAnnotation:
    camera, dropped = frame.labels.camera, Counter[str]()
    parts = frame.served
    name = f"{frame.number // FRAMES_PER_SEQUENCE:06d}/cam01/{frame.number:08d}"
    ahead = sorted(lines_ahead(frame.labels, frame.pinhole, "delimiter"), key=lambda line: not _is_placed(line))
    lines = keep_lines(ahead, dropped, MAX_LINES, f"beyond the {MAX_LINES} nearest (cap of Anchor3DLane)")
    document = {
        "lane_num": len(lines),
        "lanes": [np.round(line.points_cv[line.visible][::-1], POINT_DECIMALS).tolist() for line in lines],
        "calibration": np.column_stack([frame.pinhole.img_from_cv, np.zeros(3)]).tolist(),
        "camera_height_m": camera.height_m,
        "camera_pitch_rad": camera.pitch_rad,
        "source": f"{frame.split}/{frame.key}",
    }
    text = json.dumps(document)
    files = {f"{ROOT}/{part}/{name}.json": text for part in parts}
    # Anchor3DLane has no cache of training frames without lanes.
    shared = (
        (name, tuple(f"{ROOT}/list/{part}.txt" for part in parts)),
        (f"{name}.jpg", tuple(f"data_lists/{part}.txt" for part in parts) if lines or not frame.is_train else ()),
    )
    return FrameAnnotation(f"{ROOT}/data/{name}.jpg", len(lines), dropped, files, shared)


def _is_placed(line: LaneAhead) -> bool:
    """Whether the evaluator can assign a line by its place."""
    x_m, _, z_m = line.points_cv[line.visible].T
    return np.count_nonzero((z_m < RASTER_M) & (np.abs(x_m) < RASTER_M)) >= 2


class OnceFrame(Excerpt):
    """One label file. The camera's height and pitch are in our exports alone."""

    lanes_cv: list[JsonLine] = Field(alias="lanes")
    calibration: tuple[Row4, Row4, Row4]
    camera_height_m: Number | None = None
    camera_pitch_rad: Number | None = None

    @property
    def img_from_cv(self) -> Float[np.ndarray, "3 4"]:
        """The matrix K, and a column."""
        return np.array(self.calibration)


def parse(text: str, where: str) -> OnceFrame:
    """One label file; FormatErrors begin with `where`."""
    return schema.parse(OnceFrame, text, where, "a frame of ONCE-3DLanes")


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    for path in sorted((out / ROOT / "list").glob("*.txt")):
        yield FrameList(path.stem, _frames(out, path, most_frames))


def _frames(out: Path, path: Path, most_frames: int) -> Iterator[ReadFrame]:
    for name in listed_files(path, most_frames):
        file = f"{ROOT}/{path.stem}/{name}.json"
        frame = parse(read_text(out / file), str(out / file))
        yield ReadFrame(file, str(out / file), f"{ROOT}/data/{name}.jpg", frame)


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in metres, and their order: those that the evaluator can pair by their place come first."""
    found: OnceFrame = frame.content
    lines, view = [points_cv @ CV_FROM_CAM for points_cv in found.lanes_cv], ExportView.around(found.img_from_cv)
    read_back = FoundLines(lines, view, None, found.camera_height_m, found.camera_pitch_rad)
    compared, _ = compare_lines(read_back, truth, RULE)
    is_near = [np.count_nonzero((line[:, 1] < RASTER_M) & (np.abs(line[:, 0]) < RASTER_M)) >= 2 for line in lines]
    return compared.because(
        f"line {i}: expected lines within {RASTER_M:g} m first, got one behind line {i - 1}, which is farther ahead"
        for i in range(1, len(lines))
        if is_near[i] and not is_near[i - 1]
    )


# The benchmark's score, from its description alone.
RASTER_PX_PER_M = 10
RASTER_WIDTH_PX = 5
MATCH_M = 0.3
N_POINTS = 10
CONFIDENT = 0.5


def benchmark(frames: Sequence[tuple[Sequence[Polyline3], Sequence[Polyline3]]]) -> Scores:
    """Frames of (ground truth, prediction), in `_cv`. Lines are paired by overlap in a bird's-eye raster of the first
    10 m, those without any in the order of the list, then matched within 0.3 m in 3D."""
    distances_m = []
    for true, predicted in frames:
        overlapping = overlaps(*(list(map(_raster, lines)) for lines in (true, predicted)))
        in_order = -1e-6 * np.abs(np.subtract.outer(np.arange(len(true)), np.arange(len(predicted))))
        rows, columns = scipy.optimize.linear_sum_assignment(overlapping + in_order, maximize=True)
        distances_m += [_distance_m(true[i], predicted[j]) for i, j in zip(rows, columns, strict=True)]
    matched_m = [distance_m for distance_m in distances_m if distance_m < MATCH_M]
    return {**f_score(len(matched_m), frames), "distance_m": float(np.mean(matched_m)) if matched_m else np.nan}


def _raster(points_cv: Polyline3) -> MaskImage:
    size_px = int(2 * RASTER_M * RASTER_PX_PER_M), int(RASTER_M * RASTER_PX_PER_M)
    raster = Image.new("1", size_px)
    x_m, z_m = points_cv[:, 0], points_cv[:, 2]
    inside = (z_m < RASTER_M) & (np.abs(x_m) < RASTER_M)
    if np.count_nonzero(inside) >= 2:
        pixels = np.column_stack([x_m + RASTER_M, z_m])[inside] * RASTER_PX_PER_M
        ImageDraw.Draw(raster).line([(float(u), float(v)) for u, v in pixels], fill=1, width=RASTER_WIDTH_PX)
    return np.asarray(raster)


def _distance_m(true_cv: Polyline3, predicted_cv: Polyline3) -> float:
    """The mean distance of ten points of the one line from the other."""
    return float(distances(resampled(true_cv, N_POINTS), predicted_cv).mean())


class _Found(Excerpt):
    points: JsonLine
    score: Unit


class _Prediction(Excerpt):
    lanes: list[_Found]


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A folder with a file `SEQUENCE/cam01/STAMP.json` for each image: `lanes`, each with `points` and `score`; those
    of 0.5 and more count."""

    def of_frame(frame: ReadFrame) -> tuple[Sequence[Polyline3], Sequence[Polyline3]] | None:
        path = predictions / frame.file.removeprefix(f"{ROOT}/").partition("/")[2]
        if not path.exists():
            return None
        lanes = schema.parse(_Prediction, read_text(path), str(path), "predictions of ONCE-3DLanes").lanes
        return frame.content.lanes_cv, [lane.points for lane in lanes if lane.score >= CONFIDENT]

    return scored(read(out, EVERY), of_frame, benchmark, predictions)


FORMAT = PinholeFormat(
    title="ONCE-3DLanes: lane lines in 3D",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=True,
    links={"annotations": ROOT, "raw_data": f"{ROOT}/data"},
    replaced_words=PARTS,
)
