"""tuSimple: lines in the image, a column (x) for each of its rows, no 3D; JSON lines, image 1280x720.

| theirs | ours | unit |
|---|---|---|
| `lanes` | delimiters, the nearest first | columns of `h_samples`, whole px; -2 where there is none |
| `raw_file` | the image | path |
"""

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int, UInt8
from pydantic import Field, model_validator

from synth3dlanes.formats.comparing import Comparison, Rule, SourceSample, compare_lines
from synth3dlanes.formats.format import FrameList, PinholeFormat, Rates, ReadFrame
from synth3dlanes.formats.lines import LaneAhead, columns_of, keep_lines, lines_ahead, sifted
from synth3dlanes.formats.reading import LabelLines, first_lines, read_image
from synth3dlanes.formats.scoring import EVERY, lines_by, scored
from synth3dlanes.formats.sidecar import Sidecar, Sidecars, sidecar
from synth3dlanes.formats.writing import FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.system import schema
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import open_regular
from synth3dlanes.system.schema import MAX_BYTES, Excerpt, Number, PathBelow, shown

CAMERA = Pinhole(1280, 720, 2015.0 * 2 / 3)
ROWS_PX = np.arange(160, 720, 10)
ABSENT = -2
MAX_LINES = 5
TEST_LABELS, TEST_TASKS = "test_label.json", "test_tasks_0627.json"
LABEL_FILES = ("label_data_0313.json", "label_data_0531.json", "label_data_0601.json", TEST_LABELS, TEST_TASKS)
# Columns are whole pixels.
RULE = Rule("px", 0.51, most=MAX_LINES)

README = """tuSimple layout.

- `clips/<split>/<key>/20.jpg`, 1280x720. Label files are JSON lines with `raw_file`, `h_samples` (rows 160 to 710,
  every 10) and `lanes` (x per row in whole pixels, -2 = absent).
- `label_data_0313.json`, `label_data_0601.json`: training frames. `label_data_0531.json`: val frames where there are
  test frames beside them, else training frames (keys ending in 7; those ending in 2 are in 0601).
  `test_label.json`: test frames, or val frames where there are no test frames; `test_tasks_0627.json` names them.
- One to five lines a frame, the nearest to the camera (the official accuracy fails on none and exceeds 1 on more);
  a line ends where it would come back to a row that it has crossed. Frames without lines are left out.
- Terrain hides lines, cars do not. `sidecar.jsonl` holds the camera (f = 1343.3, c = (640, 360)), its height over
  the road and its pitch (radians, positive = down). f is longer where the frame's own field of view is narrower
  than that of the others.
"""


def write(frame: PinholeFrame) -> FrameAnnotation | None:
    """The frame's label line; None for a frame without lines, which the benchmark cannot score."""
    dropped = Counter[str]()
    raw_file = f"clips/{frame.split}/{frame.key}/20.jpg"

    def is_crossing(line: LaneAhead) -> bool:
        return np.count_nonzero(rows_of(line, frame.pinhole) != ABSENT) >= 2

    ahead, reason = (
        lines_ahead(frame.labels, frame.pinhole, "delimiter"),
        "its visible part crosses fewer than two rows",
    )
    crossing = sifted(ahead, is_crossing, dropped, f"{reason} of the image")
    kept = keep_lines(crossing, dropped, MAX_LINES, f"beyond the {MAX_LINES} nearest (the score exceeds 1 with more)")
    if not kept:
        return None
    lanes = [rows_of(line, frame.pinhole).tolist() for line in kept]
    document = {"lanes": lanes, "h_samples": ROWS_PX.tolist(), "raw_file": raw_file}
    task = {"raw_file": raw_file, "h_samples": ROWS_PX.tolist(), "lanes": []}
    file = label_file(frame)
    shared = (
        (json.dumps(document), (file,)),
        sidecar(raw_file, frame, [line.id for line in kept]),
        (json.dumps(task), (TEST_TASKS,) if file == TEST_LABELS else ()),
    )
    return FrameAnnotation(raw_file, len(kept), dropped, shared=shared)


def label_file(frame: PinholeFrame) -> str:
    """Tools train on 0313 and 0601, and on 0531 or validate on it; training frames are dealt to the three as in the
    original, where 8 of 10 are in 0313. With splits val and test of its own a data set has val in 0531."""
    if frame.serves_as("test"):
        return TEST_LABELS
    if frame.part == "val":
        return "label_data_0531.json"
    dealt = {2: "0601"} if frame.parts >= {"val", "test"} else {2: "0601", 7: "0531"}
    return f"label_data_{dealt.get(int(frame.key) % 10, '0313')}.json"


def rows_of(line: LaneAhead, pinhole: Pinhole) -> Int[np.ndarray, " r"]:
    """The line's column at each row, ABSENT where it has none in the image."""
    columns_px = np.rint(columns_of(line, pinhole, ROWS_PX))
    return np.where((columns_px >= 0) & (columns_px < pinhole.width_px), columns_px, ABSENT).astype(int)


class _Line(Excerpt):
    raw_file: PathBelow
    h_samples: Annotated[list[Number], Field(min_length=1)]
    lanes: list[list[Number]]

    @model_validator(mode="after")
    def _has_a_column_for_every_row(self) -> "_Line":
        if any(len(lane) != len(self.h_samples) for lane in self.lanes):
            raise ValueError(f"lanes: expected {len(self.h_samples)} columns each, as many as h_samples")
        return self


@dataclass(frozen=True, eq=False)
class TusimpleFrame:
    """One line of a label file as plain arrays; a column below 0 is absent."""

    raw_file: str
    rows_px: Int[np.ndarray, " r"]
    lanes_u_px: Float[np.ndarray, "l r"]


def parse(line: str | bytes, where: str) -> TusimpleFrame:
    """One line of a label file; FormatErrors begin with `where`."""
    found = schema.parse(_Line, line, where, "a frame of tuSimple")
    lanes_u_px = np.array(found.lanes, dtype=float).reshape(-1, len(found.h_samples))
    return TusimpleFrame(found.raw_file, np.array(found.h_samples, dtype=int), lanes_u_px)


class TusimpleSplit(LabelLines):
    """A `label_data_*.json`; the clips lie beside it."""

    def frame(self, index: int) -> TusimpleFrame:
        return parse(self.lines[index], f"{self.path}:{index + 1}")

    def image(self, index: int) -> UInt8[np.ndarray, "h w 3"]:
        return read_image(self.path.parent / self.frame(index).raw_file)


def is_tusimple(path: Path) -> bool:
    """Whether the first line of the file is a tuSimple frame."""
    try:
        with open_regular(path) as file:
            return b'"h_samples"' in file.readline(MAX_BYTES)
    except OSError as error:
        raise FormatError(f"{path}: cannot be read: {error.strerror}") from None


def find_labels(source: Path) -> Path | None:
    """The tuSimple label file that a path names, or the only one in a folder; None if there is none."""
    if source.suffix == ".json":
        return source if is_tusimple(source) else None
    found = [path for path in sorted(source.glob("*.json")) if is_tusimple(path)]
    if len(found) > 1:
        raise InputError(f"{source}: expected one of its label files, {', '.join(path.name for path in found)}")
    return found[0] if found else None


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every label file of an export, with the cameras of its frames."""
    sidecars = Sidecars(out, Sidecar)
    for path in sorted(out.glob("*label*.json")):
        yield FrameList(path.name, _frames(path, most_frames, sidecars))


def _frames(path: Path, most_frames: int, sidecars: Sidecars[Sidecar]) -> Iterator[ReadFrame]:
    for number, line in enumerate(first_lines(path, most_frames), start=1):
        where = f"{path}:{number}"
        frame = parse(line, where)
        if not np.array_equal(frame.rows_px, ROWS_PX):
            got = shown(frame.rows_px.tolist())
            raise FormatError(f"{where}: h_samples: expected the rows of the benchmark, got {got}")
        yield ReadFrame(frame.raw_file, where, frame.raw_file, (frame, sidecars[frame.raw_file]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in pixels, from the bottom up."""
    found, about = frame.content
    lines = [np.column_stack([u_px, ROWS_PX])[u_px >= 0][::-1] for u_px in found.lanes_u_px]
    return compare_lines(about.found(lines, CAMERA.size_px), truth, RULE, rows_px=ROWS_PX)[0]


# The benchmark's accuracy, from its description alone. Lines are columns (x) by row; below 0 is absent.
MATCH_PX = 20.0
MATCHED_SHARE = 0.85
MAX_EXTRA = 2
MAX_COUNTED = 4
ABSENT_AT_PX = -100.0
MOST_MS = 200.0

Lines = Float[np.ndarray, "_ r"]
Rows = Float[np.ndarray, " r"]


@dataclass(frozen=True)
class TusimpleScore:
    """Row accuracy, false-positive and false-negative rate: of one frame, or their means over many."""

    accuracy: float
    false_positive: float
    false_negative: float


def mean_score(scores: Sequence[TusimpleScore]) -> TusimpleScore:
    """Means over frames; NaN without any."""
    rates = [(one.accuracy, one.false_positive, one.false_negative) for one in scores]
    return TusimpleScore(*(map(float, np.mean(rates, axis=0)) if rates else (float("nan"),) * 3))


def score_frame(true: Lines, predicted: Lines, rows_px: Rows) -> TusimpleScore:
    """A row is right within 20 px / cos(angle of the true line), or where both lines are absent. Of more than four true
    lines the worst is left out. Frames that took longer than 200 ms score as no line would; time is not looked at here.
    """
    if len(predicted) > len(true) + MAX_EXTRA:
        return TusimpleScore(0.0, 0.0, 1.0)
    best = [_best_share(line, predicted, rows_px) for line in true]
    missed = sum(share < MATCHED_SHARE for share in best)
    false_positive = (len(predicted) - (len(true) - missed)) / max(1, len(predicted))
    # The sum is divided by four where a line was left out, too.
    is_forgiven = len(true) > MAX_COUNTED
    total = sum(best) - (min(best) if is_forgiven else 0.0)
    counted = max(1, min(MAX_COUNTED, len(true)))
    return TusimpleScore(total / counted, false_positive, max(0, missed - is_forgiven) / counted)


def _best_share(line: Rows, predicted: Lines, rows_px: Rows) -> float:
    present = line >= 0
    slope = np.polyfit(rows_px[present], line[present], 1)[0] if np.count_nonzero(present) > 1 else 0.0
    tolerance_px = MATCH_PX / np.cos(np.arctan(slope))
    gaps_px = np.abs(np.where(present, line, ABSENT_AT_PX) - np.where(predicted >= 0, predicted, ABSENT_AT_PX))
    return float(np.max((gaps_px < tolerance_px).mean(axis=1), initial=0.0))


class _Prediction(Excerpt):
    raw_file: str
    lanes: list[list[Number]]
    run_time: Number = 0.0


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A file of JSON lines with `raw_file`, `lanes` (a column for each row of the labels) and `run_time` (ms)."""
    by_image = lines_by(predictions, _Prediction, "raw_file")

    def of_frame(frame: ReadFrame) -> TusimpleScore | None:
        found = by_image.get(frame.file)
        if found is None:
            return None
        if any(len(lane) != len(ROWS_PX) for lane in found.lanes):
            raise FormatError(f"{predictions}: {frame.file}: lanes: expected {len(ROWS_PX)} columns each, got others")
        if found.run_time > MOST_MS:
            return TusimpleScore(0.0, 0.0, 1.0)
        lanes = np.array(found.lanes, dtype=float).reshape(-1, len(ROWS_PX))
        return score_frame(frame.content[0].lanes_u_px, lanes, ROWS_PX.astype(float))

    return scored(read(out, EVERY), of_frame, lambda found: asdict(mean_score(found)), predictions)


FORMAT = PinholeFormat(
    title="tuSimple: up to five lane lines in the image, by row",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=False,
    lists=LABEL_FILES,
)
