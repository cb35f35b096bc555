"""Statistics as tables for the terminal and as a page of plots."""

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table

from synth3dlanes.figures import colors
from synth3dlanes.figures.stats import LabelStatistics, ParameterStatistics, SceneStatistics

DOUBTFUL_P = 1e-4
"""With about 50 parameters, a p value below this is unlikely to be chance."""

_COLUMNS = 7


def statistics_table(scenes: SceneStatistics, labels: LabelStatistics | None) -> RenderableType:
    """Tables of the parameters as declared and as drawn, of the topologies, and of the label quantities."""
    parameters = _table(f"{scenes.n_scenes} scenes", "parameter", "declared", "from", "to", "mean", "n", "test", "p")
    for row in scenes.parameters:
        color = "" if is_fine(row) else "[bold red]"
        numbers = (f"{value:.4g}" for value in (row.minimum, row.maximum, row.mean))
        p_value = "-" if row.p_value is None else f"{row.p_value:.2g}"
        parameters.add_row(color + row.key, row.declared, *numbers, str(row.count), row.test, p_value)
    topologies = _table("topologies", "road", "scenes")
    for name, count in scenes.topologies.items():
        topologies.add_row(name, str(count))
    if labels is None:
        return Group(parameters, topologies)
    measured = _table(f"labels of {labels.n_images} images", "quantity", "min", "5 %", "median", "95 %", "max", "mean")
    for summary in labels.summaries:
        values = (summary.minimum, summary.p05, summary.median, summary.p95, summary.maximum, summary.mean)
        measured.add_row(escape(summary.name), *(f"{value:.3g}" for value in values))
    return Group(parameters, topologies, measured)


def is_fine(parameter: ParameterStatistics) -> bool:
    """Whether every value lies in the declared range and the test does not reject the declared distribution."""
    return parameter.outside == 0 and (parameter.p_value is None or parameter.p_value >= DOUBTFUL_P)


def verdict(scenes: SceneStatistics) -> str:
    """One line: how many parameters are as declared, and which are not."""
    bad = [row.key for row in scenes.parameters if not is_fine(row)]
    fine = f"{len(scenes.parameters) - len(bad)} of {len(scenes.parameters)} parameters as declared"
    return f"{fine}; not: {', '.join(bad)}" if bad else fine


def draw_statistics(scenes: SceneStatistics, labels: LabelStatistics | None) -> Figure:
    """One page of histograms: label quantities, then every parameter that varies, over its declared range."""
    measured: Mapping[str, Float[np.ndarray, " _"]] = {} if labels is None else labels.measured
    varying = [row for row in scenes.parameters if row.count and row.minimum < row.maximum]
    rows = math.ceil((len(measured) + len(varying)) / _COLUMNS)
    figure = Figure(figsize=(2.6 * _COLUMNS, 1.75 * rows + 0.6), layout="constrained")
    grid = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
    blue = colors.hexadecimal(colors.KINDS["centerline"])
    for axes, (name, values) in zip(grid, measured.items(), strict=False):
        low, high = np.percentile(values, [0.5, 99.5])
        _histogram(axes, name, values, np.linspace(low, max(high, low + 1e-6), 41), blue)
    for axes, row in zip(grid[len(measured) :], varying, strict=False):
        good = colors.TREE if is_fine(row) else colors.hexadecimal(colors.KINDS["delimiter"])
        _histogram(axes, row.key, scenes.drawn[row.key], _edges(row), good)
    for axes in grid[len(measured) + len(varying) :]:
        axes.set_visible(False)
    figure.suptitle(f"{scenes.n_scenes} scenes: labels in blue, parameters in green (red: not as declared)")
    return figure


def _histogram(
    axes: Axes, title: str, values: Float[np.ndarray, " n"], edges: Float[np.ndarray, " e"], color: str
) -> None:
    counts, _ = np.histogram(values, edges)
    axes.stairs(counts, edges, fill=True, color=color, alpha=0.75)
    axes.set_title(title, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.set_yticks([])
    axes.set_ylim(bottom=0)


def _edges(row: ParameterStatistics) -> Float[np.ndarray, " e"]:
    """Bins over the declared range; one bin per value for a discrete parameter with few values."""
    low, high = min(row.low, row.minimum), max(row.high, row.maximum)
    is_discrete = row.test == "chi2" or row.key == "camera.lane"
    return np.arange(low - 0.5, high + 1) if is_discrete and high - low < 30 else np.linspace(low, high, 21)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
    table.add_column(columns[0], no_wrap=True)
    for name in columns[1:]:
        table.add_column(name, justify="right", no_wrap=True)
    return table
