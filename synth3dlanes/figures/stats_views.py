"""Statistics as tables for the terminal and as a page of plots."""

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table

from synth3dlanes.figures import colors
from synth3dlanes.figures.stats import Histogram, LabelStatistics, SceneStatistics, histograms, is_fine
from synth3dlanes.system.words import counted

_COLUMNS = 7
# Inches over and under the plots; Matplotlib's own layouts would take as much time as the drawing.
_TOP, _BOTTOM = 0.65, 0.5


def statistics_table(scenes: SceneStatistics, labels: LabelStatistics | None) -> RenderableType:
    """Tables of the parameters as declared and as drawn, the topologies, and the label quantities."""
    tables = [] if not scenes.n_scenes else _of_scenes(scenes)
    if labels is None:
        return Group(*tables)
    measured = _table(
        f"labels of {counted(labels.n_images, 'image')}", "quantity", "min", "5 %", "median", "95 %", "max", "mean"
    )
    for summary in labels.summaries:
        values = (summary.minimum, summary.p05, summary.median, summary.p95, summary.maximum, summary.mean)
        measured.add_row(escape(summary.name), *(f"{value:.3g}" for value in values))
    return Group(*tables, measured)


def _of_scenes(scenes: SceneStatistics) -> list[Table]:
    """The tables of parameters and of topologies."""
    parameters = _table(
        counted(scenes.n_scenes, "scene"), "parameter", "declared", "from", "to", "mean", "n", "test", "p"
    )
    for row in scenes.parameters:
        color = "" if is_fine(row) else "[bold red]"
        numbers = (f"{value:.4g}" for value in (row.minimum, row.maximum, row.mean))
        p_value = "-" if row.p_value is None else f"{row.p_value:.2g}"
        parameters.add_row(color + row.key, row.declared, *numbers, str(row.count), row.test, p_value)
    topologies = _table("topologies", "road", "scenes")
    for name, count in scenes.topologies.items():
        topologies.add_row(name, str(count))
    return [parameters, topologies]


def verdict(scenes: SceneStatistics) -> str:
    """One line: how many parameters are as declared, and which are not."""
    if not scenes.n_scenes:
        return "No scenes: the samples were lifted from a real drive."
    bad = [row.key for row in scenes.parameters if not is_fine(row)]
    fine = f"{len(scenes.parameters) - len(bad)} of {len(scenes.parameters)} parameters as declared"
    return f"{fine}; not: {', '.join(bad)}" if bad else fine


def draw_statistics(scenes: SceneStatistics, labels: LabelStatistics | None) -> Figure:
    """One page of histograms: label quantities, then every parameter that varies."""
    found = histograms(scenes, labels)
    rows = math.ceil(len(found) / _COLUMNS)
    height = 2.15 * rows
    figure = Figure(figsize=(2.6 * _COLUMNS, height))
    figure.subplots_adjust(0.03, _BOTTOM / height, 0.99, 1 - _TOP / height, wspace=0.27, hspace=0.6)
    grid = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
    for axes, histogram in zip(grid, found, strict=False):
        _draw(axes, histogram)
    for axes in grid[len(found) :]:
        axes.set_visible(False)
    figure.suptitle(
        f"{scenes.n_scenes} scenes: labels in blue, parameters in green (red: not as declared); "
        "the black line is the declared distribution",
        y=1 - _TOP / 3 / height,
    )
    return figure


def _draw(axes: Axes, histogram: Histogram) -> None:
    is_of_labels = histogram.expected is None
    color = colors.hexadecimal(colors.KINDS["centerline" if is_of_labels else "delimiter"])
    if not is_of_labels and histogram.is_fine:
        color = colors.TREE
    axes.stairs(histogram.counts, histogram.edges, fill=True, color=color, alpha=0.75)
    if histogram.expected is not None:
        axes.stairs(histogram.expected, histogram.edges, color=colors.INK, linewidth=1)
    axes.set_title(histogram.title, fontsize=8)
    axes.set_xlabel(histogram.quantity, fontsize=7)
    axes.set_ylabel("values", fontsize=7)
    axes.tick_params(labelsize=7)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10], integer=histogram.is_of_integers))
    axes.yaxis.set_major_locator(MaxNLocator(3, integer=True))
    axes.set_ylim(bottom=0)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
    table.add_column(columns[0], no_wrap=True)
    for name in columns[1:]:
        # Where a terminal is narrow, what is declared is written in several lines, and the numbers stay whole.
        is_text = name == "declared"
        table.add_column(name, justify="left" if is_text else "right", no_wrap=not is_text, overflow="fold")
    return table
