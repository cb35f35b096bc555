"""One scene explained: a summary for the terminal, and a figure."""

from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from rich.console import Group, RenderableType
from rich.table import Table

from synth3dlanes.figures import colors, views
from synth3dlanes.figures.describe import LANE_COLUMNS, describe, lane_row, object_tables, shown_title
from synth3dlanes.figures.passes import draw_pass
from synth3dlanes.figures.scene_view import SceneView
from synth3dlanes.figures.shown import ShownScene
from synth3dlanes.scene.settings import PASSES

# Images of a rig's cameras in a row.
RIG_COLUMNS = 3


def summary(shown: ShownScene) -> RenderableType:
    """The scene in words, its lanes, objects and traffic elements in a table each, for `rich.print`."""
    facts, labels = Table(box=None, show_header=False, padding=(0, 2, 0, 0)), shown.labels
    for group, values in describe(shown).items():
        for number, (name, value) in enumerate(values.items()):
            facts.add_row(f"[bold]{group}[/bold]" if number == 0 else "", name, value)
    lanes = Table(box=None, padding=(0, 2, 0, 0))
    for name in LANE_COLUMNS[:4]:
        lanes.add_column(name, no_wrap=True)
    for name in LANE_COLUMNS[4:]:
        lanes.add_column(name, justify="right", no_wrap=True)
    for lane in labels.lanes:
        lanes.add_row(*lane_row(lane))
    tables = [facts, lanes]
    for of in object_tables(labels):
        tables.append(Table(*of.columns, box=None, padding=(0, 2, 0, 0)))
        for row in of.rows:
            tables[-1].add_row(*row)
    return Group(*tables)


def draw_inspect(
    shown: ShownScene,
) -> Figure:
    """One page: the image, its passes, the scene in 3D, from above with the lidar's points, and from the side. Without
    an image, the lanes alone are drawn. The images of a rig's cameras have rows of their own."""
    scene, labels, passes, rig = shown.scene, shown.labels, shown.passes, shown.rig
    view = SceneView(scene, labels)
    pass_rows = [names for names in (PASSES[:2], PASSES[2:4], PASSES[4:]) if set(names) & set(passes)]
    rig_rows = [rig[i : i + RIG_COLUMNS] for i in range(0, len(rig), RIG_COLUMNS)]
    heights = (9.5, *(4.0 for _ in rig_rows), *(7.0 for _ in pass_rows), 8.5, 4)
    figure = Figure(figsize=(15, 14.5 / 22 * sum(heights)), layout="constrained")
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights, width_ratios=(1, 1))
    views.draw_image(figure.add_subplot(grid[0, 0]), labels, shown.image)
    space = figure.add_subplot(grid[0, 1], projection="3d", computed_zorder=False)
    views.draw_3d(space, view)
    for row, pictures in enumerate(rig_rows, 1):
        cells = grid[row, :].subgridspec(1, RIG_COLUMNS)
        for column, (seen, picture) in enumerate(pictures):
            axes = figure.add_subplot(cells[column])
            views.draw_image(axes, seen, picture)
            axes.set_title(seen.camera.name)
    for row, names in enumerate(pass_rows, 1 + len(rig_rows)):
        for column, name in enumerate(names):
            if name in passes:
                draw_pass(figure.add_subplot(grid[row, column]), name, passes[name])
    views.draw_top(figure.add_subplot(grid[-2, :]), view, shown.sweep, [seen.camera for seen, _ in rig])
    views.draw_side(figure.add_subplot(grid[-1, :]), view)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(shown_title(shown), fontsize=14, x=0.01, ha="left", color=colors.INK)
    return figure


def _legend() -> list[Artist]:
    """What the lines and shapes of all views mean."""
    blue, red = (colors.hexadecimal(colors.KINDS[kind]) for kind in ("centerline", "delimiter"))
    return [
        Line2D([], [], color=blue, linewidth=2, label="centre line"),
        Line2D([], [], color=red, linewidth=2, label="delimiter, solid"),
        Line2D([], [], color=red, linewidth=2, linestyle=views.DASHES, label="delimiter, dashed"),
        Line2D([], [], color=red, alpha=views.HIDDEN_OPACITY, linewidth=1, label="pale: hidden or outside the image"),
        Line2D([], [], color=red, linewidth=1, linestyle=":", label="dotted, in the image: hidden"),
        Line2D([], [], color=colors.hexadecimal(colors.OBJECT), linewidth=0.8, label="object"),
        Patch(facecolor=colors.FRUSTUM, alpha=views.FRUSTUM_OPACITY, label="field of view"),
        Line2D([], [], color=colors.FRUSTUM, markeredgecolor=colors.INK, marker="o", linestyle="", label="camera"),
    ]
