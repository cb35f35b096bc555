"""Write CULane: 2D lines as text, masks, lists; image 1640x590."""

import io
from collections import Counter

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from synth3dlanes.formats.culane.convention import (
    CAMERA,
    MASK_WIDTH_PX,
    MASKS,
    MAX_LINES,
    ROWS_PX,
    scene_list,
    scene_of,
)
from synth3dlanes.formats.culane.read import lines_path
from synth3dlanes.formats.lines import LaneAhead, columns_of, ego_places, keep_lines, lines_ahead
from synth3dlanes.formats.sidecar import sidecar
from synth3dlanes.formats.writing import PARTS, FrameAnnotation, Pinhole, PinholeFrame

MIN_POINTS = 3
FRAMES_PER_FOLDER = 1000
DECIMALS = 3
FINER = 4

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


def annotate(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's lines, its mask and its list entries."""
    labels, dropped = frame.labels, Counter[str]()
    folder, place = divmod(frame.number, FRAMES_PER_FOLDER)
    name = f"driver_{folder:06d}_30frame/{place // 100:02d}.MP4/{place % 100:05d}"
    image, mask = f"{name}.jpg", f"{MASKS}/{name}.png"
    ahead = lines_ahead(labels, frame.pinhole, "delimiter")
    places = ego_places(ahead, labels.camera)
    points = {line.id: _points(line, frame.pinhole) for line in ahead}
    beside = [line for line in ahead if line.id in places]
    if len(beside) < len(ahead):
        dropped["not one of the two nearest on either side of the camera"] += len(ahead) - len(beside)
    crossing = [line for line in beside if len(points[line.id]) >= MIN_POINTS]
    if len(crossing) < len(beside):
        reason = f"its visible part crosses fewer than {MIN_POINTS} of the rows 250 to 590 (CLRNet drops those)"
        dropped[reason] += len(beside) - len(crossing)
    kept = sorted(keep_lines(crossing, dropped), key=lambda line: places[line.id])
    lines_px = {places[line.id]: points[line.id] for line in kept}
    text = "\n".join(" ".join(f"{x:.{DECIMALS}f} {y:.0f}" for x, y in line) for line in lines_px.values())
    flags = " ".join(str(int(number in lines_px)) for number in range(1, MAX_LINES + 1))
    parts = [part for part in PARTS if frame.serves_as(part)]
    lists = [f"list/{part}.txt" for part in parts]
    if "test" in parts:
        lists.append(scene_list(scene_of(frame.tags)))
    shared = (
        (f"/{image}", tuple(lists)),
        (f"/{image} /{mask} {flags}", tuple(f"list/{part}_gt.txt" for part in parts if part != "test")),
        sidecar(image, frame, [line.id for line in kept]),
    )
    return FrameAnnotation(image, len(kept), dropped, {lines_path(image): text, mask: _mask(lines_px)}, shared)


def _points(line: LaneAhead, pinhole: Pinhole) -> Float[np.ndarray, "n 2"]:
    """The line's points in the image, at the format's rows from the bottom up."""
    columns_px = columns_of(line, pinhole, ROWS_PX)
    inside = (columns_px >= 0) & (columns_px < pinhole.width_px)
    return np.column_stack([columns_px, ROWS_PX])[inside]


def _mask(lines_px: dict[int, Float[np.ndarray, "_ 2"]]) -> bytes:
    """The lines as a PNG file of their numbers; 0 is the background."""
    # Drawn larger, because Pillow draws slanted lines some pixels beside their place.
    image = Image.new("L", (FINER * CAMERA.width_px, FINER * CAMERA.height_px))
    draw = ImageDraw.Draw(image)
    for number, line in lines_px.items():
        corners = [(x, y) for x, y in (FINER * line).tolist()]
        draw.line(corners, fill=number, width=FINER * MASK_WIDTH_PX, joint="curve")
    stream = io.BytesIO()
    image.resize((CAMERA.width_px, CAMERA.height_px), Image.Resampling.NEAREST).save(stream, "PNG")
    return stream.getvalue()
