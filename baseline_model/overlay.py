"""Pictures like the paper's results figure: image and 3D side by side, ground truth blue, detections red."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8

from synth3dlanes.files import replacing
from synth3dlanes.frames import project, transform
from synth3dlanes.labels import Labels, LaneKind

from .lanes import Prediction
from .poses import Pose, road_from_cam

TRUTH, FOUND = "#1f5fff", "#ff2020"
FAR_M = 80.0
LEAST_HEIGHT_M = 12.0
"""Of the view in space, so that an even road looks even."""
VISIBLE = 0.5
STYLES: dict[LaneKind, Literal["-", "--"]] = {"centerline": "-", "delimiter": "--"}


def save_overlay(
    path: Path,
    image: UInt8[np.ndarray, "h w 3"],
    img_from_cam: Float[np.ndarray, "3 3"],
    prediction: Prediction,
    truth: Labels | Sequence[Float[np.ndarray, "_ 2"]],
    threshold: float = 0.5,
) -> None:
    """Draw labels, and detections of at least this confidence, up to 80 m; centre lines solid, delimiters dashed.
    Points that the ground hides, and those predicted to be hidden, are left out. `truth` may be lines in the image
    only, or none."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator

    height, width = image.shape[:2]
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left = figure.add_subplot(1, 2, 1)
    right = figure.add_subplot(1, 2, 2, projection="3d")
    left.imshow(image)
    left.set(xlim=(0, width), ylim=(height, 0), title=prediction.key)
    left.set_axis_off()
    labels = truth if isinstance(truth, Labels) else None
    for line_px in () if isinstance(truth, Labels) else truth:
        left.plot(*(line_px - 0.5).T, color=TRUTH, linewidth=1.4)
    pose = Pose(labels.camera.pitch_rad, labels.camera.height_m) if labels is not None else prediction.pose
    to_road = np.eye(4) if pose is None else road_from_cam(pose)
    for colour, style, xyz_cam in _curves(prediction, labels, threshold):
        xyz_road = transform(to_road, xyz_cam)
        in_reach = (xyz_road[:, 1] >= 0) & (xyz_road[:, 1] <= FAR_M)
        uv = project(img_from_cam, xyz_cam)
        # Pixel (0, 0) has its centre at the origin in imshow, its corner in our coordinates.
        left.plot(*(np.where(in_reach[:, None], uv, np.nan) - 0.5).T, style, color=colour, linewidth=1.4)
        right.plot(*xyz_road[in_reach].T, style, color=colour, linewidth=1.4)
    right.set(xlabel="x right [m]", ylabel="y forward [m]", zlabel="z up [m]", ylim=(0, FAR_M), xlim=(-12, 12))
    low, high = right.get_zlim()
    wider_m = max(0.0, LEAST_HEIGHT_M - (high - low)) / 2
    right.set_zlim(low - wider_m, high + wider_m)
    right.zaxis.set_major_locator(MaxNLocator(4))
    right.set_box_aspect((1.0, 2.0, 0.6))
    right.view_init(elev=25, azim=-70)
    shown = [(FOUND, f"detections, confidence {threshold:g} or more"), *([(TRUTH, "ground truth")] if truth else [])]
    handles = [Line2D([], [], color=colour, label=text) for colour, text in shown]
    handles += [Line2D([], [], color="#666666", linestyle=style, label=kind) for kind, style in STYLES.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    with replacing(path) as stream:
        figure.savefig(stream, dpi=100)


def _curves(
    prediction: Prediction, labels: Labels | None, threshold: float
) -> Iterable[tuple[str, str, Float[np.ndarray, "n 3"]]]:
    for lane in labels.lanes if labels is not None else ():
        hidden = ~lane.terrain_visible[:, None]
        yield TRUTH, STYLES[lane.kind], np.where(hidden, np.nan, lane.xyz_cam)
    for found in prediction.lanes:
        if found.score >= threshold:
            hidden = np.zeros((1, 1), bool) if found.visibility is None else found.visibility[:, None] < VISIBLE
            yield FOUND, STYLES[found.kind], np.where(hidden, np.nan, found.xyz_cam)
