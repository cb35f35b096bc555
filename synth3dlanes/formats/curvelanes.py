"""CurveLanes: all lines in the image as points from the bottom up, one JSON a frame, image 2560x1440.

| theirs | ours | unit |
|---|---|---|
| `Lines`, each a list of `x` and `y` | delimiters at every tenth row | px, as text |
"""

import json
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path, PurePath

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.comparing import Comparison, Rule, SourceSample, compare_lines
from synth3dlanes.formats.format import FrameList, PinholeFormat, Rates, ReadFrame
from synth3dlanes.formats.lines import keep_lines, lines_ahead, points_at, sifted
from synth3dlanes.formats.reading import drawable, image_size, listed_files, numbers, read_text
from synth3dlanes.formats.scoring import EVERY, Canvas, band_score, scored
from synth3dlanes.formats.sidecar import Sidecar, Sidecars, sidecar
from synth3dlanes.formats.writing import FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import Polyline2
from synth3dlanes.system.schema import Excerpt

CAMERA = Pinhole(2560, 1440, 2217.0, below_px=114.0)
"""Ours: the original has no intrinsics. 60 degrees wide, the horizon in row 640 or below for a pitch of 5 degrees:
CondLaneNet cuts off what is above."""
ROW_STEP_PX = 10
EVALUATED = Canvas(224, 224, 5, 0.5)
"""Lines are scaled to this size to be scored."""
MIN_POINTS = 2
PX_DECIMALS = 2
# Columns have two decimals.
RULE = Rule("px", 0.02)

README = """CurveLanes layout.

- `{train,valid,test}/images/*.jpg`, `{train,valid,test}/labels/*.lines.json` and the lists `train/train.txt`,
  `valid/valid.txt`, `test/test.txt`. Test frames are in `valid`, or in `test` where the data set has val frames too;
  those of the original have no labels. CondLaneNet takes images of 2560x1440, 1570x660 and 1280x720 alone.
- `Lines`: all delimiters, as points with `x` and `y` (text), from the bottom up, every 10 rows. A line ends where it
  would come back to a row that it has crossed. Terrain hides lines, cars do not.
- Pixel corners are at whole numbers. `sidecar.jsonl` holds the camera of each frame, its height over the road and its
  pitch (radians, positive = down). f is longer where the frame's own field of view is narrower than that of the others.
"""


def write(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's label file and its list entry."""
    labels, dropped = frame.labels, Counter[str]()
    part = "train" if frame.is_train else "valid" if frame.serves_as("val") else "test"
    image = f"{part}/images/{frame.split}_{frame.key}.jpg"
    ahead = lines_ahead(labels, frame.pinhole, "delimiter")
    rows_px = np.arange(frame.pinhole.height_px, -1, -ROW_STEP_PX)
    points = {line.id: points_at(line, frame.pinhole, rows_px).tolist() for line in ahead}
    reason = f"its visible part crosses fewer than {MIN_POINTS} rows"
    crossing = sifted(ahead, lambda line: len(points[line.id]) >= MIN_POINTS, dropped, reason)
    kept = keep_lines(crossing, dropped)
    text = json.dumps({"Lines": [[_point(*at) for at in points[line.id]] for line in kept]})
    shared = (
        (image.partition("/")[2], (f"{part}/{part}.txt",)),
        sidecar(image, frame, [line.id for line in kept]),
    )
    return FrameAnnotation(image, len(kept), dropped, {labels_path(image): text}, shared)


def _point(x: float, y: float) -> dict[str, str]:
    return {"y": f"{y:.{PX_DECIMALS}f}", "x": f"{x:.{PX_DECIMALS}f}"}


class _Point(Excerpt):
    x: str
    y: str


class _Lines(Excerpt):
    Lines: list[list[_Point]]


def parse(text: str, where: str) -> tuple[Float[np.ndarray, "_ 2"], ...]:
    """A file `.lines.json`; FormatErrors begin with `where`."""
    found = schema.parse(_Lines, text, where, "lines of CurveLanes")
    return tuple(numbers(" ".join(f"{point.x} {point.y}" for point in line), where) for line in found.Lines)


def labels_path(image: str) -> str:
    """Where the lines of an image are, `images/a.jpg` or `train/images/a.jpg`."""
    folder, _, name = image.rpartition("images/")
    return f"{folder}labels/{name.removesuffix('.jpg')}.lines.json"


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    sidecars = Sidecars(out, Sidecar)
    for path in sorted(out.glob("*/*.txt")):
        yield FrameList(path.parent.name, _frames(out, path, most_frames, sidecars))


def _frames(out: Path, path: Path, most_frames: int, sidecars: Sidecars[Sidecar]) -> Iterator[ReadFrame]:
    for name in listed_files(path, most_frames):
        image = f"{path.parent.name}/{name}"
        where = str(out / labels_path(image))
        lines = drawable(parse(read_text(Path(where)), where), where)
        yield ReadFrame(image, where, image, (lines, sidecars[image]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    lines, about = frame.content
    width_px = round(2 * about.img_from_cv[0, 2])
    height_px = round(width_px * CAMERA.height_px / CAMERA.width_px)
    rows_px = np.arange(height_px, -1, -ROW_STEP_PX)
    return compare_lines(about.found(lines, (width_px, height_px)), truth, RULE, rows_px=rows_px)[0]


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A folder with the files `*.lines.json` of all images, of their size: in the folders of the export, or in none."""

    def of_frame(frame: ReadFrame) -> tuple[list[Polyline2], list[Polyline2]] | None:
        own = labels_path(frame.file)
        for path in (predictions / own, predictions / PurePath(own).name):
            if path.exists():
                found = drawable(parse(read_text(path), str(path)), str(path))
                scale = np.array([EVALUATED.width_px, EVALUATED.height_px]) / image_size(out / frame.file)
                return [line * scale for line in frame.content[0]], [line * scale for line in found]
        return None

    return scored(read(out, EVERY), of_frame, partial(band_score, canvas=EVALUATED), predictions)


FORMAT = PinholeFormat(
    title="CurveLanes: all lane lines in the image",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=True,
    lists=("train/train.txt", "valid/valid.txt", "test/test.txt"),
)
