"""Pictures and videos of detections: the lines over the whole image, and a figure of the image and the lines from above
and from the side. Drawn with Pillow: a figure of matplotlib takes ten times longer than the network.

The key is that of all pictures (`figures.colors`): blue centre lines, red delimiters, labels as hollow lines.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw, ImageFont

from synth3dlanes.figures.colors import INK, KIND_WORDS, KINDS
from synth3dlanes.figures.strokes import Style, draw_lines, line_width_px, runs
from synth3dlanes.geometry.frames import project, transform
from synth3dlanes.imaging.video import Mp4, mp4
from synth3dlanes.labels.labels import Labels, LaneKind
from synth3dlanes.system.arrays import Points3, Polyline2
from synth3dlanes.system.files import Folder, encoded

from .curves import plane_pose, road_from_cam
from .data import CameraImage, img_from_cam
from .lanes import Prediction

FAR_M = 80.0
ASIDE_M = 12.0
"""Width of the view from above to each side."""
LEAST_HEIGHT_M = 12.0
"""Least height that the view from the side covers, so that an even road looks even."""
PICTURE_ENDINGS = (OVERLAY, FIGURE) = (".overlay.jpg", ".png")
VISIBLE = 0.5
LEAST_DEPTH_M = 0.5
"""Points closer to the camera's plane are not drawn in the image."""

# The figure in pixels: height of the image and width of the views beside it; width of the image and height of the views
# below it.
HEIGHT_PX, VIEWS_WIDTH_PX, WIDTH_PX, VIEWS_HEIGHT_PX = 500, 600, 1100, 440
WIDE = 2.2
"""Aspect from which an image is above the views instead of beside them."""
TEXT_PX, ROW_PX, LEFT_PX = 13, 24, 48
LINE_PX = 2.0
PANEL, GRID = (243, 244, 246), (214, 217, 222)


@dataclass(frozen=True, eq=False)
class Line:
    """The seen part of a lane: in the image, and in the road frame (None for labels in the image alone)."""

    kind: LaneKind
    is_label: bool
    points_img: Polyline2
    xyz_road: Points3 | None


@dataclass(frozen=True)
class _Axis:
    """Metres along one side of a view, from its left or upper end, with a number at every step."""

    words: str
    start_m: float
    end_m: float
    step_m: float

    def pixels(self, values_m: Float[np.ndarray, " n"], n_px: int) -> Float[np.ndarray, " n"]:
        """Pixels from the start on a side of `n_px`."""
        return (values_m - self.start_m) / (self.end_m - self.start_m) * n_px

    def marks_m(self) -> Float[np.ndarray, " n"]:
        """Where the numbers stand."""
        low_m, high_m = sorted((self.start_m, self.end_m))
        return np.arange(np.ceil(low_m / self.step_m), np.floor(high_m / self.step_m) + 1) * self.step_m


FORWARD = _Axis("y forward [m]", 0.0, FAR_M, 10.0)
RIGHT = _Axis("from above: x right [m]", -ASIDE_M, ASIDE_M, 4.0)


def save_pictures(stem: Path, image: CameraImage, prediction: Prediction, threshold: float = 0.5) -> None:
    """Write STEM.overlay.jpg, the image in full size with the lines, and STEM.png, which shows it beside the lines from
    above and from the side.

    Drawn are labels, and detections of at least this confidence, up to 80 m; points that the ground hides, and those
    predicted to be hidden, are left out.
    """
    picture, lines = draw(image, prediction, threshold)
    folder, name = Folder(stem.parent), stem.name
    figure = _figure(picture, lines, prediction.key, threshold)
    folder.write(f"{name}{OVERLAY}", encoded(lambda stream: picture.save(stream, "JPEG", quality=92, subsampling=0)))
    folder.write(f"{name}{FIGURE}", encoded(lambda stream: figure.save(stream, "PNG", compress_level=1)))


def draw(image: CameraImage, prediction: Prediction, threshold: float) -> tuple[Image.Image, list[Line]]:
    """The image with what `save_pictures` says, and the lines that were drawn."""
    picture, matrix, truth = Image.fromarray(image.image), img_from_cam(image.intrinsics), image.truth
    if isinstance(truth, Labels):
        lines = [*_lines(prediction, truth, matrix, threshold)]
    else:
        lines = [Line("delimiter", True, points_img, None) for points_img in truth]
        lines += _lines(prediction, None, matrix, threshold)
    _stroke(picture, [(line, line.points_img) for line in lines], line_width_px(picture.size))
    return picture, lines


def _stroke(image: Image.Image, lines_px: Sequence[tuple[Line, Polyline2]], width_px: float) -> None:
    """Lines at these pixels, in the colours and styles of what they are: detections over labels."""
    styles: dict[Style, bool] = {"hollow": True, "full": False}
    for style, is_label in styles.items():
        for kind, color in KINDS.items():
            chosen = (points for line, points in lines_px if (line.kind, line.is_label) == (kind, is_label))
            draw_lines(image, chosen, color, width_px, style)


def _figure(image: Image.Image, lines: Sequence[Line], title: str, threshold: float) -> Image.Image:
    """The image as large as its shape allows, and the views beside or below it."""
    aspect = image.width / image.height
    if aspect > WIDE:
        shown_px, views_px = (WIDTH_PX, max(1, round(WIDTH_PX / aspect))), (WIDTH_PX, VIEWS_HEIGHT_PX)
        views_at, size_px = (0, ROW_PX + shown_px[1]), (WIDTH_PX, shown_px[1] + VIEWS_HEIGHT_PX + 2 * ROW_PX)
    else:
        shown_px, views_px = (max(1, round(HEIGHT_PX * aspect)), HEIGHT_PX), (VIEWS_WIDTH_PX, HEIGHT_PX)
        views_at, size_px = (shown_px[0], ROW_PX), (shown_px[0] + VIEWS_WIDTH_PX, HEIGHT_PX + 2 * ROW_PX)
    figure = Image.new("RGB", size_px, "white")
    figure.paste(image.resize(shown_px, Image.Resampling.BILINEAR, reducing_gap=2.0), (0, ROW_PX))
    figure.paste(_views(lines, views_px), views_at)
    _text(figure, (8, ROW_PX / 2), title, "lm")
    _key(figure, f"confidence {threshold:g} or more", any(line.is_label for line in lines))
    return figure


def _views(lines: Sequence[Line], size_px: tuple[int, int]) -> Image.Image:
    """From above, with the left of the road at the top, and from the side."""
    views = Image.new("RGB", size_px, "white")
    width, height = size_px[0] - LEFT_PX - 12, size_px[1] - 3 * ROW_PX
    above = round(0.6 * height)
    views.paste(_view(lines, RIGHT, 0, (width, above)), (0, 0))
    views.paste(_view(lines, _up(lines), 2, (width, height - above)), (0, above + ROW_PX))
    for y_m, x_px in zip(FORWARD.marks_m(), FORWARD.pixels(FORWARD.marks_m(), width), strict=True):
        _text(views, (LEFT_PX + x_px, height + 1.5 * ROW_PX), f"{y_m:g}", "mm")
    _text(views, (LEFT_PX + width / 2, height + 2.5 * ROW_PX), FORWARD.words, "mm")
    return views


def _up(lines: Sequence[Line]) -> _Axis:
    """The heights of the lines; at least LEAST_HEIGHT_M."""
    z_m = np.concatenate([np.zeros(1), *(line.xyz_road[:, 2] for line in lines if line.xyz_road is not None)])
    low_m, high_m = float(z_m.min()), float(z_m.max())
    beyond_m = max(1.0, (LEAST_HEIGHT_M - (high_m - low_m)) / 2)
    step_m = 4.0 * max(1, round((high_m - low_m) / 16))
    return _Axis("from the side: z up [m]", high_m + beyond_m, low_m - beyond_m, step_m)


def _view(lines: Sequence[Line], axis: _Axis, column: int, size_px: tuple[int, int]) -> Image.Image:
    """One view with a column of `xyz_road` along its vertical axis, whose numbers are at its left."""
    width, height = size_px
    panel, view = Image.new("RGB", size_px, PANEL), Image.new("RGB", (width + LEFT_PX, height), "white")
    draw = ImageDraw.Draw(panel)
    for x_px in FORWARD.pixels(FORWARD.marks_m(), width).tolist():
        draw.line((x_px, 0, x_px, height), fill=GRID)
    for mark_m, y_px in zip(axis.marks_m(), axis.pixels(axis.marks_m(), height).tolist(), strict=True):
        draw.line((0, y_px, width, y_px), fill=GRID)
        if ROW_PX / 3 < y_px < height - ROW_PX / 3:
            _text(view, (LEFT_PX - 6, y_px), f"{mark_m:g}", "rm")
    points_px = [
        (line, np.stack([FORWARD.pixels(at[:, 1], width), axis.pixels(at[:, column], height)], axis=1))
        for line, at in ((line, line.xyz_road) for line in lines)
        if at is not None
    ]
    _stroke(panel, points_px, LINE_PX)
    view.paste(panel, (LEFT_PX, 0))
    _text(view, (LEFT_PX + 6, ROW_PX / 2), axis.words, "lm")
    return view


def _key(figure: Image.Image, confidence: str, has_labels: bool) -> None:
    """What colours and styles mean, in the last row."""
    y_px, x_px = figure.height - ROW_PX / 2, 12.0
    for kind, color in KINDS.items():
        for is_label in (False, True)[: 1 + has_labels]:
            words = f"{KIND_WORDS[kind]}: label" if is_label else f"{KIND_WORDS[kind]}, {confidence}"
            points = np.array([[x_px, y_px], [x_px + 30, y_px]])
            draw_lines(figure, [points], color, LINE_PX, "hollow" if is_label else "full")
            x_px = _text(figure, (x_px + 38, y_px), words, "lm") + 24


def _text(image: Image.Image, at_px: tuple[float, float], words: str, anchor: str) -> float:
    """Write words at a place, which Pillow's `anchor` says of; return where they end."""
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(TEXT_PX)
    draw.text(at_px, words, fill=INK, font=font, anchor=anchor)
    return float(draw.textbbox(at_px, words, font=font, anchor=anchor)[2])


def _lines(
    prediction: Prediction, labels: Labels | None, img_from_cam: Float[np.ndarray, "3 3"], threshold: float
) -> Iterator[Line]:
    """Labels and detections where they are seen, up to FAR_M."""
    pose = plane_pose(labels) if labels is not None else prediction.pose
    to_road = np.eye(4) if pose is None else road_from_cam(pose)

    def parts(kind: LaneKind, is_label: bool, xyz_cam: Points3, is_seen: Bool[np.ndarray, " n"]) -> Iterator[Line]:
        xyz_road = transform(to_road, xyz_cam)
        is_drawn = is_seen & (xyz_road[:, 1] >= 0) & (xyz_road[:, 1] <= FAR_M) & (xyz_cam[:, 1] > LEAST_DEPTH_M)
        points_img = project(img_from_cam, xyz_cam)
        for start, stop in runs(is_drawn.astype(int)):
            if is_drawn[start] and stop - start > 1:
                yield Line(kind, is_label, points_img[start:stop], xyz_road[start:stop])

    for lane in labels.lanes if labels is not None else ():
        yield from parts(lane.kind, True, lane.xyz_cam, lane.terrain_visible)
    for found in prediction.lanes:
        if found.score >= threshold:
            seen = np.ones(len(found.xyz_cam)) if found.visibility is None else found.visibility
            yield from parts(found.kind, False, found.xyz_cam, seen >= VISIBLE)


class LaneVideos(ExitStack):
    """Writes OUT/NAME.lanes.mp4 for each of the first `most` clips whose frames are added. As a context manager, it
    leaves whole videos only."""

    def __init__(self, out: Path, rate_hz: float, most: int) -> None:
        super().__init__()
        self._out, self._rate_hz, self._left, self._time_s = out, rate_hz, most, math.inf
        self._video: Mp4 | None = None

    def add(self, name: str, image: CameraImage, prediction: Prediction, threshold: float) -> None:
        """Append a frame with the lanes of at least this confidence. One that is not later than the frame before begins
        the next video, of this name."""
        time_s = image.time_s or 0.0
        if time_s <= self._time_s:
            self.close()
            self._left -= 1
            self._video = self._opened(f"{name}.lanes.mp4") if self._left >= 0 else None
        self._time_s = time_s
        if self._video is not None:
            self._video.add(np.asarray(draw(image, prediction, threshold)[0]))

    def _opened(self, name: str) -> Mp4:
        stream = self.enter_context(Folder(self._out).replacing(name))
        return self.enter_context(mp4(str(self._out / name), stream, self._rate_hz))
