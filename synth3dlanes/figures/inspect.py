"""One scene explained: a summary for the terminal, and a figure of four views. Road frame at the host, metres."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Circle, Patch, Polygon
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D, art3d
from rich.console import Group, RenderableType
from rich.table import Table

from synth3dlanes.figures import colors
from synth3dlanes.figures.describe import LANE_COLUMNS, describe, lane_row, object_tables, shown_title
from synth3dlanes.figures.overlay import color_of, objects_in_image, stretches_img
from synth3dlanes.figures.passes import draw_pass, semantic_colors
from synth3dlanes.figures.samples import ShownScene
from synth3dlanes.figures.scene_view import AHEAD_M, SceneView, frustum
from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane
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
    draw_image(figure.add_subplot(grid[0, 0]), labels, shown.image)
    space = figure.add_subplot(grid[0, 1], projection="3d", computed_zorder=False)
    draw_3d(space, view)
    for row, pictures in enumerate(rig_rows, 1):
        cells = grid[row, :].subgridspec(1, RIG_COLUMNS)
        for column, (seen, picture) in enumerate(pictures):
            axes = figure.add_subplot(cells[column])
            draw_image(axes, seen, picture)
            axes.set_title(seen.camera.name)
    for row, names in enumerate(pass_rows, 1 + len(rig_rows)):
        for column, name in enumerate(names):
            if name in passes:
                draw_pass(figure.add_subplot(grid[row, column]), name, passes[name])
    draw_top(figure.add_subplot(grid[-2, :]), view, shown.sweep, [seen.camera for seen, _ in rig])
    draw_side(figure.add_subplot(grid[-1, :]), view)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(shown_title(shown), fontsize=14, x=0.01, ha="left", color=colors.INK)
    return figure


def _legend() -> list[Artist]:
    """What the lines and shapes of all views mean."""
    blue, red = (colors.hexadecimal(colors.KINDS[kind]) for kind in ("centerline", "delimiter"))
    return [
        Line2D([], [], color=blue, linewidth=2, label="centre line"),
        Line2D([], [], color=red, linewidth=2, label="delimiter, solid"),
        Line2D([], [], color=red, linewidth=2, linestyle=DASHES, label="delimiter, dashed"),
        Line2D([], [], color=red, alpha=HIDDEN_OPACITY, linewidth=1, label="pale: hidden or outside the image"),
        Line2D([], [], color=red, linewidth=1, linestyle=":", label="dotted, in the image: hidden"),
        Line2D([], [], color=colors.hexadecimal(colors.OBJECT), linewidth=0.8, label="object"),
        Patch(facecolor=colors.FRUSTUM, alpha=FRUSTUM_OPACITY, label="field of view"),
        Line2D([], [], color=colors.FRUSTUM, markeredgecolor=colors.INK, marker="o", linestyle="", label="camera"),
    ]


HIDDEN_OPACITY = 0.4
FRUSTUM_OPACITY = 0.13
DASHES = (0, (5, 2))
_HALF_WIDTH_3D_M = 32.0
_HEIGHT_FACTOR_3D = 2.0
# The least extent of the vertical axis in space: on flat ground its numbers would overlap otherwise.
_LEAST_HEIGHT_3D_M = 14.0
_WINDOW_M = 46.0


def draw_image(axes: Axes, labels: Labels, image: UInt8[np.ndarray, "h w 3"] | None) -> None:
    """The image with its lanes, objects and traffic elements, or an empty frame of its size."""
    width_px, height_px = labels.camera.width_px, labels.camera.height_px
    if image is None:
        axes.set_facecolor("#eceff3")
        axes.text(width_px / 2, 14, "not rendered", ha="center", va="top", color=colors.FAINT)
    else:
        axes.imshow(image, extent=(0, width_px, height_px, 0))
    for item, lines in objects_in_image(labels):
        for line in lines:
            axes.plot(*line.T, color=colors.hexadecimal(color_of(item)), linewidth=0.6)
    for lane in labels.lanes:
        for is_seen, points_img in stretches_img(labels.camera, lane):
            style: Literal["-", ":"] = "-" if is_seen else ":"
            color = colors.hexadecimal(colors.KINDS[lane.kind])
            axes.plot(*points_img.T, style, color=color, linewidth=1.2 if is_seen else 1.0)
    axes.set(xlim=(0, width_px), ylim=(height_px, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    axes.set_title(f"{labels.camera.name or 'image'}: solid = seen, dotted = hidden")


def draw_top(axes: Axes, view: SceneView, sweep: Sweep | None = None, others: Sequence[CameraLabel] = ()) -> None:
    """View from above, driving direction to the right: roads, lanes, objects, trees, the fields of view of the camera
    and of the rig's other cameras, and the lidar's points in the colours of their semantic ids."""
    for left, right in view.roads:
        axes.add_patch(Polygon(np.concatenate([left, right[::-1]])[:, [1, 0]], color=colors.ROAD, zorder=1))
    for camera in (*others, view.labels.camera):
        _frustum_from_above(axes, view, camera)
    for body in view.structures:
        corners_road = transform(view.road_from_world, body.corners_world)
        axes.add_collection(PolyCollection([*corners_road[..., [1, 0]]], color=colors.STRUCTURE, alpha=0.5, zorder=3))
    for tree in view.trees:
        patch = Circle((tree.foot_road[1], tree.foot_road[0]), tree.radius_m, color=colors.TREE, alpha=0.45, zorder=2)
        axes.add_patch(patch)
    for lane, points_road in zip(view.labels.lanes, view.lanes_road, strict=True):
        _plot(axes, lane, points_road[:, [1, 0]])
    for item in view.objects:
        face = colors.hexadecimal(item.color)
        axes.add_patch(Polygon(item.corners_road[:, [1, 0]], facecolor=face, edgecolor=colors.INK, zorder=5))
    if sweep is not None:
        points = sweep.points()
        x, y, _ = transform(view.labels.camera.road_from_cam, points.xyz_cam).T
        axes.scatter(y, x, s=1, c=semantic_colors(points.semantic) / 255, linewidths=0, zorder=5.5)
    low, high = _lateral_extent(view)
    axes.set(xlim=(-view.behind_m, AHEAD_M), ylim=(high, low), aspect="equal")
    axes.set(xlabel="y forward [m]", ylabel="x right [m]")
    axes.set_title("from above")


def draw_side(axes: Axes, view: SceneView) -> None:
    """Side view: heights over the road plane at the host against the distance ahead."""
    ground = view.ground_along_host
    if len(ground):
        floor = ground[:, 2].min() - 5
        axes.fill_between(ground[:, 1], ground[:, 2], floor, color=colors.GROUND, alpha=0.5, zorder=1)
    for lane, points_road in zip(view.labels.lanes, view.lanes_road, strict=True):
        _plot(axes, lane, points_road[:, [1, 2]])
    heights = np.concatenate([np.zeros(1), *(points[:, 2] for points in (ground, *view.lanes_road))])
    foot = view.ramp_foot
    if foot is not None and -view.behind_m < foot[1] < AHEAD_M:
        axes.axvline(foot[1], color=colors.FAINT, linestyle="--", linewidth=1)
        is_merge = view.scene is not None and view.scene.roads.flip_lateral
        words = "ramp of the exit ends" if is_merge else "ramp of the exit begins"
        side, gap = ("left", 4) if foot[1] < AHEAD_M / 2 else ("right", -4)
        axes.annotate(words, (foot[1], 0.95), (gap, 0), ("data", "axes fraction"), "offset points", ha=side, va="top")
    height_m = view.labels.camera.height_m
    axes.plot(0, height_m, "o", color=colors.FRUSTUM, markeredgecolor=colors.INK, zorder=6)
    axes.axhline(0, color=colors.FAINT, linewidth=0.8, zorder=0)
    low, high = heights.min(), max(height_m, heights.max())
    margin = max(0.5, 0.08 * (high - low))
    axes.set(xlim=(-view.behind_m, AHEAD_M), ylim=(low - margin, high + margin))
    axes.set(xlabel="y forward [m]", ylabel="z up [m]")
    axes.set_title(f"from the side{' (ground along the way of the host in green)' * (len(ground) > 0)}")


def draw_3d(axes: Axes3D, view: SceneView) -> None:
    """3D view of terrain, roads, lanes, objects and camera; heights are exaggerated so that hills are visible."""
    grid = view.ground_grid(_HALF_WIDTH_3D_M, 4.0)
    if grid is not None:
        look = {"color": colors.GROUND, "edgecolor": "#8fa883", "linewidth": 0.2, "alpha": 0.55}
        axes.plot_surface(*np.moveaxis(grid, -1, 0), **look, zorder=0)
    for left, right in view.roads:
        keep = _in_space(view, left) & _in_space(view, right)
        quads = np.stack([left[:-1], left[1:], right[1:], right[:-1]], 1)[keep[1:] & keep[:-1]]
        axes.add_collection3d(art3d.Poly3DCollection(quads, facecolor=colors.ROAD, edgecolor="none", zorder=1))
    for lane, points_road in zip(view.labels.lanes, view.lanes_road, strict=True):
        points_road = np.where(np.abs(points_road[:, :1]) < _HALF_WIDTH_3D_M, points_road, np.nan)
        _plot(axes, lane, points_road)
    for item in view.objects:
        if _in_space(view, item.corners_road).all():
            sides, face = _box(item.corners_road, item.height_m), colors.hexadecimal(item.color)
            axes.add_collection3d(
                art3d.Poly3DCollection(sides, facecolor=face, edgecolor=colors.INK, linewidth=0.4, zorder=5)
            )
    for x, y, z, height_m in (
        (*tree.foot_road, tree.height_m) for tree in view.trees if _in_space(view, tree.foot_road)
    ):
        axes.plot([x, x], [y, y], [z, z + height_m], color=colors.TREE, linewidth=1, alpha=0.5, zorder=2)
    axes.scatter(0, 0, view.labels.camera.height_m, color=colors.FRUSTUM, edgecolor=colors.INK, s=36, zorder=6)
    shown = [points.reshape(-1, 3)[:, 2] for points in ([grid] if grid is not None else view.lanes_road)]
    heights = np.concatenate([np.zeros(1), *shown])
    low, high = heights.min(), heights.max() + 2
    high = max(high, low + _LEAST_HEIGHT_3D_M)
    axes.zaxis.set_major_locator(MaxNLocator(min(6, round((high - low) / 5) + 1)))
    axes.set(xlim=(-_HALF_WIDTH_3D_M, _HALF_WIDTH_3D_M), ylim=(-view.behind_m, AHEAD_M), zlim=(low, high))
    axes.set_box_aspect((2 * _HALF_WIDTH_3D_M, AHEAD_M + view.behind_m, _HEIGHT_FACTOR_3D * (high - low)), zoom=1.4)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(6))
    axes.set(xlabel="x right [m]", ylabel="y forward [m]", zlabel="z up [m]")
    # Beside the numbers along the long axis, of up to four characters.
    axes.yaxis.labelpad = 18
    axes.view_init(elev=24, azim=-112)
    axes.set_title(f"in space (heights x {_HEIGHT_FACTOR_3D:g})")


def _plot(axes: Any, lane: Lane, points: Float[np.ndarray, "n d"]) -> None:
    """Plot one lane in any view: faint along its whole length, full where it is visible."""
    color = colors.hexadecimal(colors.KINDS[lane.kind])
    axes.plot(*points.T, color=color, linewidth=1, alpha=HIDDEN_OPACITY, zorder=3)
    seen = np.where(lane.visible[:, None], points, np.nan)
    axes.plot(*seen.T, color=color, linewidth=1.6, linestyle=DASHES if lane.marking == "dashed" else "-", zorder=4)


def _frustum_from_above(axes: Axes, view: SceneView, camera: CameraLabel) -> None:
    corners_img = np.array([[0.0, camera.height_px / 2], [camera.width_px, camera.height_px / 2]])
    rays_cam = frustum(camera, corners_img)
    road_from_cam = view.road_from_world @ camera.world_from_cam
    rays_road, (x, y) = (rays_cam @ road_from_cam[:3, :3].T)[:, :2], road_from_cam[:2, 3]
    axis_road = road_from_cam[:2, 1] / np.linalg.norm(road_from_cam[:2, 1])
    ends = [x, y] + rays_road / (rays_road @ axis_road)[:, None] * AHEAD_M
    triangle = np.array([[x, y], *ends])[:, [1, 0]]
    axes.add_patch(Polygon(triangle, facecolor=colors.FRUSTUM, alpha=FRUSTUM_OPACITY, edgecolor="none", zorder=1.5))
    marker = MarkerStyle(">").rotated(rad=float(np.arctan2(-axis_road[0], axis_road[1])))
    axes.plot(y, x, marker=marker, color=colors.FRUSTUM, markeredgecolor=colors.INK, markersize=9, zorder=6)


def _lateral_extent(view: SceneView) -> tuple[float, float]:
    """Lateral limits around the middle of the lanes: _WINDOW_M wide, or wider if the lanes need it."""
    lanes_road = np.concatenate([np.zeros((1, 3)), *view.lanes_road])
    low, high = lanes_road[:, 0].min(), lanes_road[:, 0].max()
    half_m = max(_WINDOW_M, high - low + 6) / 2
    return (low + high) / 2 - half_m, (low + high) / 2 + half_m


def _in_space(view: SceneView, points_road: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
    x, y = points_road[..., 0], points_road[..., 1]
    return np.asarray((np.abs(x) < _HALF_WIDTH_3D_M) & (-view.behind_m < y) & (y < AHEAD_M))


def _box(corners: Float[np.ndarray, "4 3"], height_m: float) -> list[Float[np.ndarray, "4 3"]]:
    top = corners + np.array([0.0, 0.0, height_m])
    around = [np.stack([corners[i], corners[i - 1], top[i - 1], top[i]]) for i in range(4)]
    return [*around, top]
