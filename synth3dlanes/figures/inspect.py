"""One scene explained: a summary for the terminal, and a figure."""

import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.console import Group, RenderableType
from rich.table import Table

from synth3dlanes.figures import colors, views
from synth3dlanes.figures.describe import LANE_COLUMNS, describe, lane_row, topology_words
from synth3dlanes.figures.scene_view import SceneView
from synth3dlanes.labels import Labels
from synth3dlanes.scene import Scene


def summary(scene: Scene, labels: Labels) -> RenderableType:
    """The scene in words and its lanes in a table, for `rich.print`."""
    facts = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for group, values in describe(scene, labels).items():
        for number, (name, value) in enumerate(values.items()):
            facts.add_row(f"[bold]{group}[/bold]" if number == 0 else "", name, value)
    lanes = Table(box=None, padding=(0, 2, 0, 0))
    for name in LANE_COLUMNS[:4]:
        lanes.add_column(name, no_wrap=True)
    for name in LANE_COLUMNS[4:]:
        lanes.add_column(name, justify="right", no_wrap=True)
    for lane in labels.lanes:
        lanes.add_row(*lane_row(lane))
    return Group(facts, lanes)


def draw_inspect(scene: Scene, labels: Labels, image: UInt8[np.ndarray, "h w 3"] | None) -> Figure:
    """One page with the image and the scene in 3D, from above and from the side; without an image, lanes alone."""
    view = SceneView(scene, labels)
    figure = Figure(figsize=(15, 14.5), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(9.5, 8.5, 4), width_ratios=(1, 1))
    views.draw_image(figure.add_subplot(grid[0, 0]), labels, image)
    space = figure.add_subplot(grid[0, 1], projection="3d", computed_zorder=False)
    views.draw_3d(space, view)
    views.draw_top(figure.add_subplot(grid[1, :]), view)
    views.draw_side(figure.add_subplot(grid[2, :]), view)
    handles = [
        Line2D(
            [], [], color=colors.hexadecimal(color), linewidth=2, label="centre line" if kind == "centerline" else kind
        )
        for kind, color in colors.KINDS.items()
    ]
    figure.legend(handles=handles, loc="upper right", ncols=2, frameon=False)
    figure.suptitle(
        f"seed {scene.seed}, {scene.split} {scene.index}: {scene.road.n_lanes} lanes, {topology_words(scene.road)}",
        fontsize=14, x=0.01, ha="left", color=colors.INK,
    )  # fmt: skip
    return figure
