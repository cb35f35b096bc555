"""CULane: at most four lines in the image as points from the bottom up, masks and lists, image 1640x590.

| theirs | ours | unit |
|---|---|---|
| `*.lines.txt`: x and y in turn | the two nearest delimiters on either side, from left to right | px, rows 590 to 250 |
| the mask, and its flags in `*_gt.txt` | the same, as 1 to 4 for left-left to right-right | lines 16 px wide |
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped
from PIL import Image, ImageDraw

from synth3dlanes.formats.comparing import (
    NEAR_START_M,
    Comparison,
    OurLine,
    Rule,
    SourceSample,
    compare_lines,
    distances,
    places_beside,
)
from synth3dlanes.formats.format import FrameList, PinholeFormat, Rates, ReadFrame
from synth3dlanes.formats.lines import ego_places, keep_lines, lines_ahead, points_at, sifted
from synth3dlanes.formats.reading import drawable, file_below, first_lines, numbers, read_mask, read_text
from synth3dlanes.formats.scoring import EVERY, Canvas, band_score, scored
from synth3dlanes.formats.segments import png
from synth3dlanes.formats.sidecar import Sidecar, Sidecars, sidecar
from synth3dlanes.formats.writing import PARTS, FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.system.arrays import Polyline2
from synth3dlanes.system.errors import FormatError

CAMERA = Pinhole(1640, 590, 1420.3, below_px=69.0)
"""Ours: the original has no intrinsics. 60 degrees wide, the horizon in row 240 or below for a pitch of 5 degrees."""
ROWS_PX = np.arange(590, 240, -10)
"""Rows of labels; UFLD v2's cache has these alone, and anchors of UFLD and CLRNet begin at rows 248 and 270."""
MAX_LINES = 4
EVALUATED = Canvas(1640, 590, 30, 0.5)
MASK_WIDTH_PX = 16
MASKS = "laneseg_label_w16"
SCENES = ("normal", "crowd", "hlight", "shadow", "noline", "arrow", "curve", "cross", "night")
"""The original's kinds of test scenes, in the order of their lists."""
KINDS = ("night", "noline", "hlight", "cross", "crowd", "arrow", "shadow", "curve")
"""Every test frame is in one list: that of the first kind that holds, else `normal`."""
TAGS = {"cross": "intersection"}
"""What we call kinds of another name."""


def scene_of(tags: frozenset[str]) -> str:
    """The kind of test scene that a frame with these tags is."""
    return next((kind for kind in KINDS if TAGS.get(kind, kind) in tags), "normal")


def scene_list(scene: str) -> str:
    """The list of the test frames of a kind of scene."""
    return f"list/test_split/test{SCENES.index(scene)}_{scene}.txt"


MIN_POINTS = 3
FRAMES_PER_FOLDER = 1000
PX_DECIMALS = 3
FINER = 4
# Columns have three decimals.
RULE = Rule("px", 0.002, most=MAX_LINES)
# Lines of the masks are drawn 16 pixels wide, with corners.
MASK_PX = MASK_WIDTH_PX / 2 + 3.0

README = f"""CULane layout.

- `driver_*_30frame/*.MP4/*.jpg`, and beside each image its lines in `*.lines.txt`: x and y in turn, one line of text
  per line, from the bottom up. y are the rows 590 to 250, every 10: tools of UFLD take no others.
- At most four lines a frame, as in the original: the two nearest on either side of the camera. Frames without
  lines have an empty `*.lines.txt`. Terrain hides lines, cars do not.
- `{MASKS}/*/*/*.png`: the lines {MASK_WIDTH_PX} pixels wide, as 1 to 4 for left-left, left, right and right-right of
  the camera.
- `list/train.txt`, `list/val.txt`, `list/test.txt`; `list/*_gt.txt` add the mask and four flags: which of the lines 1
  to 4 there are. `list/test_split/*.txt`: each test frame is in one of them, by the rules of docs/exports.md.
- Pixel corners are at whole numbers. `sidecar.jsonl` holds the camera of each frame, its height over the road and its
  pitch (radians, positive = down). f is longer where the frame's own field of view is narrower than that of the others.
- Loaders keep a cache (`cache/culane_*`, `culane_anno_cache.json`): delete it after exporting again.
"""


def write(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's lines, its mask and its list entries."""
    labels, dropped = frame.labels, Counter[str]()
    folder, place = divmod(frame.number, FRAMES_PER_FOLDER)
    name = f"driver_{folder:06d}_30frame/{place // 100:02d}.MP4/{place % 100:05d}"
    image, mask = f"{name}.jpg", f"{MASKS}/{name}.png"
    ahead = lines_ahead(labels, frame.pinhole, "delimiter")
    places = ego_places(ahead, labels.camera)
    points = {line.id: points_at(line, frame.pinhole, ROWS_PX) for line in ahead}
    reason = "not one of the two nearest on either side of the camera"
    beside = sifted(ahead, lambda line: line.id in places, dropped, reason)
    reason = f"its visible part crosses fewer than {MIN_POINTS} of the rows 250 to 590 (CLRNet drops those)"
    crossing = sifted(beside, lambda line: len(points[line.id]) >= MIN_POINTS, dropped, reason)
    kept = sorted(keep_lines(crossing, dropped), key=lambda line: places[line.id])
    lines_px = {places[line.id]: points[line.id] for line in kept}
    text = "\n".join(" ".join(f"{x:.{PX_DECIMALS}f} {y:.0f}" for x, y in line) for line in lines_px.values())
    flags = " ".join(str(int(number in lines_px)) for number in range(1, MAX_LINES + 1))
    parts = frame.served
    lists = [f"list/{part}.txt" for part in parts]
    if "test" in parts:
        lists.append(scene_list(scene_of(frame.tags)))
    shared = (
        (f"/{image}", tuple(lists)),
        (f"/{image} /{mask} {flags}", tuple(f"list/{part}_gt.txt" for part in parts if part != "test")),
        sidecar(image, frame, [line.id for line in kept]),
    )
    return FrameAnnotation(image, len(kept), dropped, {lines_path(image): text, mask: _mask(lines_px)}, shared)


def _mask(lines_px: dict[int, Float[np.ndarray, "_ 2"]]) -> bytes:
    """The lines as a PNG file of their numbers; 0 is the background."""
    # Drawn larger, because Pillow draws slanted lines some pixels beside their place.
    image = Image.new("L", (FINER * CAMERA.width_px, FINER * CAMERA.height_px))
    draw = ImageDraw.Draw(image)
    for number, line in lines_px.items():
        corners = [(x, y) for x, y in (FINER * line).tolist()]
        draw.line(corners, fill=number, width=FINER * MASK_WIDTH_PX, joint="curve")
    return png(np.asarray(image.resize(CAMERA.size_px, Image.Resampling.NEAREST)))


@dataclass(frozen=True)
class CulaneEntry:
    """One line of a list. Lists of the name `*_gt.txt` have a mask, and whether the lines left-left, left, right and
    right-right of the camera are in it, as 1 to 4."""

    image: str
    mask: str | None
    exists: tuple[bool, ...]


def parse_lines(text: str, where: str) -> tuple[Polyline2, ...]:
    """A file `.lines.txt`: x and y in turn, one line of text per line; FormatErrors begin with `where`."""
    lines = enumerate(text.splitlines(), start=1)
    return tuple(numbers(line, f"{where}:{number}") for number, line in lines if line.strip())


def parse_entry(line: str, where: str) -> CulaneEntry:
    """One line of a list, its paths without the slash that they begin with; FormatErrors begin with `where`."""
    match line.split():
        case [image]:
            return CulaneEntry(file_below(image.lstrip("/"), where), None, ())
        case [image, mask, *flags] if len(flags) == 4 and set(flags) <= {"0", "1"}:
            image, mask = (file_below(path.lstrip("/"), where) for path in (image, mask))
            return CulaneEntry(image, mask, tuple(flag == "1" for flag in flags))
    raise FormatError(f"{where}: expected an image, or an image, a mask and four flags 0 or 1, got {line!r:.80}")


def lines_path(image: str) -> str:
    """Where the lines of an image are."""
    return image.removesuffix(".jpg") + ".lines.txt"


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every list, with the masks of those that have them."""
    sidecars = Sidecars(out, Sidecar)
    for path in sorted((out / "list").rglob("*.txt")):
        yield FrameList(str(path.relative_to(out)), _frames(out, path, most_frames, sidecars))


def _frames(out: Path, path: Path, most_frames: int, sidecars: Sidecars[Sidecar]) -> Iterator[ReadFrame]:
    for number, text in enumerate(first_lines(path, most_frames), start=1):
        entry = parse_entry(text, f"{path}:{number}")
        where = str(out / lines_path(entry.image))
        lines = drawable(parse_lines(read_text(Path(where)), where), where)
        mask = entry.mask and read_mask(out / entry.mask, CAMERA.size_px, "L")
        yield ReadFrame(entry.image, where, entry.image, (lines, entry, mask, sidecars[entry.image]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in pixels, from left to right; the flags and the mask, where a line has its place as number."""
    lines, entry, mask, about = frame.content
    lanes = truth.lanes("delimiter")
    places = places_beside(lanes, NEAR_START_M)
    beside = [lane for lane in lanes if lane.id in places]
    found = about.found(lines, CAMERA.size_px)
    compared, ids = compare_lines(found, truth, RULE, beside, ROWS_PX)
    problems, numbers = list[str](), [places[name] for name in ids]
    if numbers != sorted(numbers):
        problems.append(f"expected lines from left to right, got the places {numbers} of {', '.join(ids)}")
    if mask is None:
        return compared.because(problems)
    flags = [number for number, exists in enumerate(entry.exists, start=1) if exists]
    if flags != sorted(numbers):
        problems.append(f"{entry.mask}: expected the flags of the lines {sorted(numbers)}, got those of {flags}")
    by_place = {places[lane.id]: lane.at_rows(found.view, ROWS_PX) for lane in beside if lane.id in ids}
    return compared.because([*problems, *_mask_problems(entry.mask, mask, by_place)])


def _mask_problems(where: str, mask: Shaped[np.ndarray, "h w"], by_place: dict[int, OurLine]) -> Iterator[str]:
    """Findings where a mask has other numbers than those of its lines, or has them elsewhere."""
    for number, line in by_place.items():
        drawn = np.argwhere(mask == number)[:, ::-1] + 0.5
        apart_px = distances(drawn[:: max(1, len(drawn) // 500)], line.points).max(initial=0)
        if not apart_px <= MASK_PX:
            yield f"{where}: expected the line {line.id} within {MASK_PX:g} px, got pixels {apart_px:.3g} px away"
    others = sorted(set(np.unique(mask).tolist()) - {0, *by_place})
    if others:
        yield f"{where}: expected the numbers {sorted(by_place)} of its lines, got {others} too"
    for number, line in by_place.items():
        columns, rows = np.clip(np.floor(line.wanted[1:-1]).astype(int), 0, np.array(mask.shape)[::-1] - 1).T
        bare = np.count_nonzero(mask[rows, columns] == 0)
        if bare:
            yield f"{where}: expected the line {line.id} as {number}, got {bare} of its {len(rows)} points without it"


def score(out: Path, predictions: Path) -> Iterator[Rates]:
    """A folder with the files `*.lines.txt` of all images, in the folders of the export."""

    def of_frame(frame: ReadFrame) -> tuple[tuple[Polyline2, ...], tuple[Polyline2, ...]] | None:
        path = predictions / lines_path(frame.file)
        if not path.exists():
            return None
        return frame.content[0], drawable(parse_lines(read_text(path), str(path)), str(path))

    return scored(read(out, EVERY), of_frame, partial(band_score, canvas=EVALUATED), predictions)


FORMAT = PinholeFormat(
    title="CULane: up to four lane lines in the image, by row, and masks",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    score=score,
    tolerances={RULE.unit: RULE.limit},
    camera=CAMERA,
    is_f_free=True,
    is_size_free=False,
    lists=(
        *(f"list/{part}.txt" for part in PARTS),
        *(f"list/{part}_gt.txt" for part in PARTS if part != "test"),
        *map(scene_list, SCENES),
    ),
)
