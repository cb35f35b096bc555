"""Pictures of detections: the lines over the whole image, and a figure of the image and the lines in space.

The key is that of all pictures (`figures.colors`): blue centre lines, red delimiters, labels as hollow lines.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import AbstractPathEffect, Stroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]
from PIL import Image

from synth3dlanes.arrays import Points3, Polyline2
from synth3dlanes.figures.colors import KIND_WORDS, KINDS, hexadecimal
from synth3dlanes.figures.strokes import Style, draw_lines, line_width_px, runs
from synth3dlanes.files import Folder, replacing
from synth3dlanes.frames import project, transform
from synth3dlanes.labels import Labels, LaneKind

from .lanes import Prediction
from .poses import Pose, road_from_cam

FAR_M = 80.0
LEAST_HEIGHT_M = 12.0
"""Of the view in space, so that an even road looks even."""
VISIBLE = 0.5
NEAR_M = 0.5
"""Points closer to the camera's plane are not drawn in the image."""

# The figure in inches at DPI: the image is this high beside the view in space, or as wide as both above it.
DPI = 100
HEIGHT, SPACE_WIDTH, WIDTH, SPACE_HEIGHT = 5.0, 5.5, 11.0, 4.5
WIDE = 2.2
"""Aspect from which an image is above the view in space instead of beside it."""


@dataclass(frozen=True, eq=False)
class Line:
    """The seen part of a lane: in the image, and in the road frame (None for labels in the image alone)."""

    kind: LaneKind
    is_label: bool
    points_img: Polyline2
    xyz_road: Points3 | None


def save_pictures(
    path: Path,
    image: Image.Image,
    img_from_cam: Float[np.ndarray, "3 3"],
    prediction: Prediction,
    truth: Labels | Sequence[Polyline2],
    threshold: float = 0.5,
) -> None:
    """Write a figure of the image and the lines in space to `path` (NAME.png), and NAME.overlay.jpg beside it: the
    image in full size with the lines. The image is drawn on.

    Drawn are labels, and detections of at least this confidence, up to 80 m; points that the ground hides, and those
    predicted to be hidden, are left out. `truth` may be lines in the image only, or none.
    """
    labels = truth if isinstance(truth, Labels) else None
    lines = [Line("delimiter", True, points_img, None) for points_img in (() if isinstance(truth, Labels) else truth)]
    lines += _lines(prediction, labels, img_from_cam, threshold)
    figure = _figure(image, lines, prediction.key, threshold)
    with replacing(path) as stream:
        figure.savefig(stream, dpi=DPI)
    _draw(image, lines, (1.0, 1.0))
    with Folder(path.parent).replacing(f"{path.stem}.overlay.jpg") as stream:
        image.save(stream, "JPEG", quality=92, subsampling=0)


def _figure(image: Image.Image, lines: Sequence[Line], title: str, threshold: float) -> Figure:
    """The image as large as its shape allows, and the lines in space beside or below it."""
    aspect = image.width / image.height
    is_wide = aspect > WIDE
    widths, heights = (
        ([WIDTH], [WIDTH / aspect, SPACE_HEIGHT]) if is_wide else ([HEIGHT * aspect, SPACE_WIDTH], [HEIGHT])
    )
    figure = Figure(figsize=(sum(widths), sum(heights) + 0.7), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(len(heights), len(widths), width_ratios=widths, height_ratios=heights)
    left = figure.add_subplot(grid[0])
    shown_px = max(1, round(DPI * widths[0])), max(1, round(DPI * heights[0]))
    shown = image.resize(shown_px, reducing_gap=2.0)
    _draw(shown, lines, (shown.width / image.width, shown.height / image.height))
    left.imshow(np.asarray(shown))
    left.set(title=title)
    left.set_axis_off()
    _draw_in_space(figure.add_subplot(grid[1], projection="3d", computed_zorder=False), lines)
    handles = [Line2D([], [], color=hexadecimal(KINDS[kind]), label=KIND_WORDS[kind]) for kind in KINDS]
    handles.append(Line2D([], [], color="#666666", label=f"detection of confidence {threshold:g} or more"))
    if any(line.is_label for line in lines):
        handles.append(Line2D([], [], path_effects=_hollow("#666666"), label="label"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure


def _draw(image: Image.Image, lines: Sequence[Line], scale: tuple[float, float]) -> None:
    """Draw the lines onto an image that was resized by these factors."""
    styles: dict[Style, bool] = {"hollow": True, "full": False}
    for style, is_label in styles.items():
        for kind, color in KINDS.items():
            chosen = (line.points_img * scale for line in lines if (line.kind, line.is_label) == (kind, is_label))
            draw_lines(image, chosen, color, line_width_px(image.size), style)


def _draw_in_space(axes: Axes3D, lines: Sequence[Line]) -> None:
    for line in lines:
        if line.xyz_road is None:
            continue
        color, points = hexadecimal(KINDS[line.kind]), line.xyz_road.T
        if line.is_label:
            axes.plot(*points, path_effects=_hollow(color), zorder=1)
        else:
            axes.plot(*points, color=color, linewidth=1.4, zorder=2)
    axes.set(xlabel="x right [m]", ylabel="y forward [m]", zlabel="z up [m]", ylim=(0, FAR_M), xlim=(-12, 12))
    low, high = axes.get_zlim()
    wider_m = max(0.0, LEAST_HEIGHT_M - (high - low)) / 2
    axes.set_zlim(low - wider_m, high + wider_m)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    axes.yaxis.labelpad = 14
    axes.set_box_aspect((1.0, 2.0, 0.6), zoom=1.15)
    axes.view_init(elev=25, azim=-70)


def _hollow(color: str) -> list[AbstractPathEffect]:
    return [Stroke(linewidth=5.0, foreground=color), Stroke(linewidth=3.0, foreground="white")]


def _lines(
    prediction: Prediction, labels: Labels | None, img_from_cam: Float[np.ndarray, "3 3"], threshold: float
) -> Iterator[Line]:
    """Labels and detections, as far as they are seen and up to FAR_M."""
    pose = Pose(labels.camera.pitch_rad, labels.camera.height_m) if labels is not None else prediction.pose
    to_road = np.eye(4) if pose is None else road_from_cam(pose)

    def parts(kind: LaneKind, is_label: bool, xyz_cam: Points3, is_seen: Bool[np.ndarray, " n"]) -> Iterator[Line]:
        xyz_road = transform(to_road, xyz_cam)
        is_drawn = is_seen & (xyz_road[:, 1] >= 0) & (xyz_road[:, 1] <= FAR_M) & (xyz_cam[:, 1] > NEAR_M)
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
