"""The picture of docs/network.md: `python -m scripts.network_picture` (`make pictures`) draws it anew."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.figures import colors
from synth3dlanes.params.params import load_params
from synth3dlanes.roads.from_paper import paper_network
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.scene import PaperRoad

PICTURE = Path(__file__).parents[1] / "docs/pictures/network.png"
ROAD = {
    "topology": 3, "n_lanes": 2, "n_oncoming": 1, "median_m": 2.0, "lane_width_m": 3.6, "shoulder_factor": 0.5,
    "flip_longitudinal": False, "flip_lateral": False, "exit_angle_rad": 0.09, "exit_offset_m": 9.0,
    "offset_m100_m": 2.0, "offset_m50_m": -1.5, "offset_p50_m": 2.0, "offset_p100_m": 5.0,
}  # fmt: skip
LANE, LINE, MARK = "#2f6f4f", "#b5541c", "#d81e5b"
FROM_M, TO_M = -45.0, 85.0


def draw(network: Network) -> Figure:
    """The roads seen from above, driving to the right."""
    figure = Figure(figsize=(15, 6), layout="constrained")
    axes = figure.add_subplot()
    for road in network.roads:
        s = np.linspace(max(FROM_M, road.start_m), TO_M, 300)
        left, right = road.xy(s, road.left(s)), road.xy(s, road.right(s))
        axes.add_patch(Polygon(_turned(np.concatenate([left, right[::-1]])), color=colors.ROAD, zorder=1))
        axes.plot(*_turned(road.xy(s, 0.0)).T, color=colors.INK, linewidth=1, linestyle="-.", zorder=4)
    for line in network.delimiters:
        s = np.linspace(max(FROM_M, line.start_m), min(TO_M, line.end_m), 400)
        style = "--" if line.marking == "dashed" else "-"
        axes.plot(*_turned(line.xy_world(s)).T, color=LINE, linewidth=1.4, linestyle=style, zorder=3)
        _label(axes, line.xy_world(s[-1:]), line.id, LINE)
    for lane in network.lanes.values():
        road = network.road(lane.road)
        s = np.linspace(max(FROM_M, lane.start_m + 1), min(TO_M, lane.end_m - 1), 200)
        way = _turned(road.xy(s, lane.middle(s)))[:: 1 if lane.direction == "same" else -1]
        axes.annotate("", way[120], way[90], arrowprops={"arrowstyle": "-|>", "color": LANE, "linewidth": 2}, zorder=5)
        axes.plot(*way.T, color=LANE, linewidth=0.8, zorder=3)
        x, y = way[80]
        axes.text(x, y, lane.id, color=LANE, ha="right", va="center", fontsize=11, zorder=5)
    s = np.array([FROM_M + 36])
    (foot,), (aside,) = (_turned(network.main.xy(s, t)) for t in (0.0, 6.0))
    axes.annotate("", aside, foot, arrowprops={"arrowstyle": "-|>", "color": MARK, "linewidth": 2}, zorder=6)
    axes.text(aside[0] + 0.8, aside[1], "t", color=MARK, fontsize=15, zorder=6)
    for station in (-40.0, 0.0, 40.0, 80.0):
        (x, y) = _turned(network.main.xy(np.array([station]), 0.0))[0]
        axes.plot(x, y, "o", color=MARK, markersize=5, zorder=6)
        axes.text(x, y + 0.6, f"s = {station:g}", color=MARK, fontsize=11, zorder=6)
    axes.set(aspect="equal", xlim=(FROM_M - 2, TO_M + 16), xlabel="world y [m]", ylabel="world -x [m]")
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _turned(xy: np.ndarray) -> np.ndarray:
    return np.column_stack([xy[:, 1], -xy[:, 0]])


def _label(axes: Axes, xy_world: np.ndarray, text: str, color: str) -> None:
    (x, y) = _turned(xy_world)[0]
    axes.text(x + 0.8, y, text, color=color, va="center", fontsize=9, zorder=5)


def main() -> None:
    """Draw the picture."""
    scene = sample_scene(Scenes(load_params("tiny")), 0)
    road = PaperRoad.model_validate(scene.paper_road.model_dump() | ROAD)
    draw(paper_network(road, scene.terrain)).savefig(PICTURE, dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    main()
