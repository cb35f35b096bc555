"""The picture of docs/frames.md: `python -m scripts.frames_picture` (`make pictures`) draws it anew."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image

from synth3dlanes.draw.sample import Scenes, sample_scene
from synth3dlanes.figures import colors
from synth3dlanes.figures.inspect import draw_image
from synth3dlanes.geometry.frames import project, road_from_cam, transform
from synth3dlanes.labels.labels import Labels, from_json
from synth3dlanes.params.params import load_params
from synth3dlanes.scene.scene import Scene, to_json
from synth3dlanes.system.arrays import AnyPoints3, Matrix4
from synth3dlanes.world.world import World, resolve

PICTURE = Path(__file__).parents[1] / "docs/pictures/frames.png"
# The scene and the point of the page's example.
INDEX, LANE, POINT = 17, "main_2", 20
WORLD, ROAD, CAMERA, MARK = "#2f6f4f", "#b5541c", "#5b3fa0", "#d81e5b"
# The sketches: a camera so high and so pitched that the angles can be seen, in units of no meaning.
SKETCH_HEIGHT, SKETCH_PITCH = 3.6, np.radians(12)


def draw(scene: Scene, labels: Labels, image: UInt8[np.ndarray, "h w 3"]) -> Figure:
    """All frames on one page: a sketch in space, the image, the side and the plan."""
    figure = Figure(figsize=(17, 12), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=(8, 7.2, 4.3), height_ratios=(7, 5))
    draw_space(figure.add_subplot(grid[0, 0], projection="3d", computed_zorder=False))
    draw_pixels(figure.add_subplot(grid[0, 1]), labels, image)
    draw_side(figure.add_subplot(grid[1, :2]))
    draw_plan(figure.add_subplot(grid[:, 2]), resolve(scene), labels)
    for axes in figure.axes:
        axes.title.set(fontsize=13, color=colors.INK)
    return figure


def height(x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """The ground of the sketches."""
    return 2.6 * np.exp(-((y - 13) ** 2) / 40) + 0.16 * y - 0.05 * x


def on_ground(x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]) -> AnyPoints3:
    """Points of the sketched road; x is the distance from its middle line."""
    x = x + 0.012 * y**2
    return np.stack([x, y, height(x, y)], -1)


def sketched_road_frame() -> Matrix4:
    """world_from_road of the sketch, by differences: z the normal, y along the road."""
    foot, ahead, right = on_ground(np.array([0.0, 0.0, 1e-3]), np.array([0.0, 1e-3, 0.0]))
    y = (ahead - foot) / np.linalg.norm(ahead - foot)
    z = np.cross(right - foot, y)
    z /= np.linalg.norm(z)
    frame = np.eye(4)
    frame[:3] = np.column_stack([np.cross(y, z), y, z, foot])
    return frame


def draw_space(axes: Axes3D) -> None:
    """World, road and camera frames on a road that climbs."""
    world_from_road = sketched_road_frame()
    world_from_cam = world_from_road @ road_from_cam(SKETCH_HEIGHT, SKETCH_PITCH)
    y = np.linspace(-3.5, 14, 60)
    edges = [on_ground(np.full_like(y, x), y) for x in (-2.0, 2.0)]
    faces = [[edges[0][i], edges[0][i + 1], edges[1][i + 1], edges[1][i]] for i in range(len(y) - 1)]
    axes.add_collection3d(Poly3DCollection(faces, facecolor=colors.ROAD, edgecolor=colors.ROAD, zorder=1))
    for x, style in ((-2.0, "-"), (0.0, "--"), (2.0, "-")):
        axes.plot(*on_ground(np.full_like(y, x), y).T, style, color="white", linewidth=1.8, zorder=2)
    corners_road = np.array([[-3.2, -3.2, 0], [3.2, -3.2, 0], [3.2, 6.6, 0], [-3.2, 6.6, 0]])
    plane = Poly3DCollection([transform(world_from_road, corners_road)], alpha=0.16, zorder=3)
    plane.set(facecolor=ROAD, edgecolor=ROAD)
    axes.add_collection3d(plane)
    words(
        axes,
        transform(world_from_road, np.array([3.0, -2.9, 0.0])),
        "plane that touches the road\nunder the camera",
        ROAD,
        ha="left",
        va="top",
    )
    _frustum(axes, world_from_cam)
    foot, centre = world_from_road[:3, 3], world_from_cam[:3, 3]
    axes.plot(*np.stack([foot, centre]).T, color=colors.INK, linestyle=":", linewidth=1.4, zorder=5)
    words(axes, foot + 0.83 * (centre - foot), "height_m  ", colors.INK, ha="right")
    origin_world = np.eye(4)
    origin_world[:3, 3] = on_ground(np.zeros(1), np.array([10.5]))[0]
    triad(axes, origin_world, "world", WORLD, 2.6)
    triad(axes, world_from_road, "road", ROAD, 1.8)
    triad(axes, world_from_cam, "cam", CAMERA, 2.6)
    axes.set(xlim=(-4, 5), ylim=(-4, 13.5), zlim=(-0.5, 6), title="three frames: x right, y forward, z up in each")
    axes.set_box_aspect((9, 17.5, 6.5), zoom=1.45)
    axes.view_init(elev=24, azim=-57)
    axes.set_proj_type("ortho")
    axes.set_axis_off()


def triad(axes: Axes3D, world_from_frame: Matrix4, name: str, color: str, length: float) -> None:
    """Three arrows with their names."""
    origin = world_from_frame[:3, 3]
    for i, letter in enumerate("xyz"):
        tip = length * world_from_frame[:3, i]
        axes.quiver(*origin, *tip, color=color, linewidth=2.4, arrow_length_ratio=0.16, zorder=8)
        words(axes, origin + 1.22 * tip, f"${letter}_{{{name}}}$", color, size=14, ha="center")
    axes.plot(*origin[:, None], "o", color=color, markersize=6, zorder=9)


def words(
    axes: Axes3D, place: Float[np.ndarray, "3"], text: str, color: str, size: float = 11, **alignment: str
) -> None:
    """Text in space, before everything else."""
    axes.text(*place, text, color=color, fontsize=size, zorder=10, **{"va": "center", **alignment})


def _frustum(axes: Axes3D, world_from_cam: Matrix4) -> None:
    """What the camera sees, as a pyramid with an image at its end."""
    corners_cam = np.array([[-1.35, 4.2, 1.0], [1.35, 4.2, 1.0], [1.35, 4.2, -1.0], [-1.35, 4.2, -1.0]])
    corners = transform(world_from_cam, corners_cam)
    image = Poly3DCollection([corners], alpha=0.25, zorder=6)
    image.set(facecolor=colors.FRUSTUM, edgecolor=colors.INK)
    axes.add_collection3d(image)
    for corner in corners:
        axes.plot(*np.stack([world_from_cam[:3, 3], corner]).T, color=colors.FRUSTUM, linewidth=1.2, zorder=6)
    for letter, end in (("u", corners[1]), ("v", corners[3])):
        axes.quiver(*corners[0], *(end - corners[0]) * 0.6, color=MARK, linewidth=2.2, arrow_length_ratio=0.2, zorder=8)
        words(axes, corners[0] + (end - corners[0]) * 0.75, f"${letter}$", MARK, size=14, ha="center")


def draw_pixels(axes: Axes, labels: Labels, image: UInt8[np.ndarray, "h w 3"]) -> None:
    """The image with its axes, its centre and the point of the example."""
    draw_image(axes, replace(labels, objects=None), image)
    (lane,) = (lane for lane in labels.lanes if lane.id == LANE)
    (pixel,) = project(labels.camera.img_from_cam, lane.xyz_cam[[POINT]])
    style = {"arrowstyle": "-|>,head_width=0.35,head_length=0.7", "color": MARK, "linewidth": 2.6}
    for letter, tip, place in (("u", (120, 0), (127, 12)), ("v", (0, 120), (6, 134))):
        axes.annotate("", tip, (0, 0), arrowprops={**style, "shrinkA": 0, "shrinkB": 0}, annotation_clip=False)
        axes.text(*place, f"${letter}$", color=MARK, fontsize=16, va="center")
    axes.plot(0, 0, "o", color=MARK, clip_on=False, zorder=9)
    axes.text(
        8, 26, "(0, 0): outer corner of\nthe top-left pixel", color="white", fontsize=10, va="top", fontweight="bold"
    )
    camera = labels.camera
    cx_px, cy_px = camera.img_from_cam[0, 1], camera.img_from_cam[1, 1]
    axes.plot(cx_px, cy_px, "+", color="white", markersize=16, markeredgewidth=2)
    note: dict[str, Any] = {"textcoords": "offset points", "fontsize": 10.5, "ha": "center"}
    box = {"boxstyle": "round,pad=0.35", "facecolor": "white", "edgecolor": "none", "alpha": 0.9}
    axes.annotate(
        f"(cx, cy) = ({cx_px:g}, {cy_px:g})",
        (cx_px, cy_px),
        (-20, 62),
        bbox=box,
        arrowprops={"arrowstyle": "-"},
        **note,
    )
    axes.plot(*pixel, "o", markersize=9, markerfacecolor="none", markeredgecolor=MARK, markeredgewidth=2.5)
    x, y, z = lane.xyz_cam[POINT]
    text = f"({x:.2f}, {y:.2f}, {z:.2f}) m in cam\npixel ({pixel[0]:.1f}, {pixel[1]:.1f})"
    axes.annotate(
        text, pixel, (-40, -95), bbox=box, arrowprops={"arrowstyle": "-", "color": MARK, "linewidth": 1.5}, **note
    )
    axes.set_title(f"image of train {INDEX}: u right, v down, pixels")


def draw_side(axes: Axes) -> None:
    """Pitch and height, seen from the right: the plane x_road = 0."""
    c, s = np.cos(SKETCH_PITCH), np.sin(SKETCH_PITCH)
    centre, sight, up = np.array([0.0, SKETCH_HEIGHT]), np.array([c, -s]), np.array([s, c])
    y = np.linspace(-4, 16, 200)
    axes.fill_between(y, 0.009 * y * np.abs(y), -1.2, color=colors.ROAD, zorder=1)
    axes.plot((-4, 16), (0, 0), color=ROAD, linewidth=1.3, zorder=2)
    axes.text(15.9, -0.18, "plane that touches the road: $z_{road}$ = 0", color=ROAD, ha="right", va="top")
    axes.plot((0, 8), (SKETCH_HEIGHT, SKETCH_HEIGHT), color=colors.FAINT, linestyle="--", linewidth=1.2)
    arrow(axes, np.zeros(2), np.array([3.0, 0.0]), "$y_{road}$", ROAD, (0, -15))
    arrow(axes, np.zeros(2), np.array([0.0, 1.7]), "$z_{road}$", ROAD, (20, -6))
    arrow(axes, centre, centre + 3.6 * sight, "$y_{cam}$", CAMERA, (-2, -19))
    arrow(axes, centre, centre + 1.7 * up, "$z_{cam}$", CAMERA, (22, 0))
    axes.annotate("", (-0.55, 0), (-0.55, SKETCH_HEIGHT), arrowprops={"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0})
    axes.text(-0.7, SKETCH_HEIGHT / 2, "height_m", ha="right", va="center")
    axes.add_patch(
        Arc((0, SKETCH_HEIGHT), 13, 13, theta1=-np.degrees(SKETCH_PITCH), theta2=0, color=colors.INK, linewidth=1.6)
    )
    axes.text(6.75, SKETCH_HEIGHT - 0.45, "pitch_rad > 0: looks down", va="center")
    axes.text(
        6.75, SKETCH_HEIGHT + 1.2, "roll_rad > 0: turned clockwise about $y_{cam}$,\nas the driver sees it", va="center"
    )
    _lane_point(axes, centre, sight)
    axes.plot(*centre, "o", color=CAMERA, zorder=7)
    axes.plot(0, 0, "o", color=ROAD, zorder=7)
    axes.set(xlim=(-4, 16), ylim=(-1.2, 5.7), aspect="equal", title="from the side (the angle is exaggerated)")
    axes.axis("off")


def _lane_point(axes: Axes, centre: Float[np.ndarray, "2"], sight: Float[np.ndarray, "2"]) -> None:
    """A point on the road and its depth along the view."""
    point = np.array([8.5, 0.009 * 8.5**2])
    on_sight = centre + (point - centre) @ sight * sight
    for end in (centre, point):
        axes.plot(*np.stack([on_sight, end]).T, color=CAMERA, linewidth=1, linestyle=":")
    axes.plot(*point, "o", color=MARK, zorder=6)
    axes.text(point[0] + 0.25, point[1], "lane point", color=MARK, va="top")
    turn = {"rotation": -np.degrees(SKETCH_PITCH), "rotation_mode": "anchor"}
    axes.text(on_sight[0] - 0.15, on_sight[1] + 0.2, "depth = $y_{cam}$", color=CAMERA, va="bottom", **turn)


def arrow(
    axes: Axes,
    start: Float[np.ndarray, "2"],
    end: Float[np.ndarray, "2"],
    name: str,
    color: str,
    shift: tuple[float, float],
) -> None:
    """An axis with its name, moved by `shift` in points."""
    style = {
        "arrowstyle": "-|>,head_width=0.35,head_length=0.7",
        "color": color,
        "linewidth": 2.4,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axes.annotate("", tuple(end), tuple(start), arrowprops=style, zorder=5)
    axes.annotate(
        name, tuple(end), shift, textcoords="offset points", color=color, fontsize=14, ha="center", va="center"
    )


def draw_plan(axes: Axes, world: World, labels: Labels) -> None:
    """Stations and offsets of the scene from above, in the world frame."""
    main, *branches = world.network.roads
    s = np.linspace(-100, 100, 201)
    half_m = main.carriageways[-1].right_m
    edges = [(main.xy(s, -half_m), main.xy(s, half_m))]
    for branch in branches:
        beyond = s[s >= branch.start_m]
        edges.append(
            (branch.xy(beyond, branch.carriageways[0].left_m), branch.xy(beyond, branch.carriageways[-1].right_m))
        )
    for left, right in edges:
        axes.add_patch(Polygon(np.concatenate([left, right[::-1]]), color=colors.ROAD, zorder=1))
    axes.plot(*main.xy(s, 0.0).T, color=colors.INK, linewidth=1.4, zorder=2)
    for station in range(-100, 101, 50):
        ((x, y),) = main.xy(np.array([float(station)]), 0.0)
        axes.plot(x, y, "o", color=colors.INK, markersize=4, zorder=3)
        axes.text(x - half_m - 3, y, f"s = {station}", ha="right", va="center")
    at_m = np.array([72.0])
    (start,), (end,) = main.xy(at_m, 0.0), main.xy(at_m, 14.0)
    arrow(axes, start, end, "$t$", MARK, (9, 0))
    for letter, tip, shift in (("x", (16.0, 0), (18, 0)), ("y", (0, 16.0), (0, 12))):
        arrow(axes, np.zeros(2), np.array(tip), f"${letter}_{{world}}$", WORLD, shift)
    axes.plot(0, 0, "o", color=WORLD, zorder=6)
    foot = world.view.world_from_road[:2, 3]
    sides = np.array([[-np.tan(np.pi / 6) * 26, 26, 0], [np.tan(np.pi / 6) * 26, 26, 0]])
    sides_world = transform(labels.camera.world_from_cam, sides)
    axes.add_patch(Polygon(np.vstack([foot, sides_world[:, :2]]), color=colors.FRUSTUM, alpha=0.35, zorder=2))
    axes.plot(*foot, "o", color=CAMERA, zorder=6)
    axes.annotate(
        "camera\ny = camera.y_m",
        tuple(foot),
        (38, -30),
        textcoords="offset points",
        color=CAMERA,
        va="center",
        arrowprops={"arrowstyle": "-", "color": CAMERA},
    )
    axes.set(xlim=(-38, 40), ylim=(-108, 108), aspect="equal", title="from above: stations s, offsets t")
    axes.set(xlabel="x_world [m]", ylabel="y_world [m]")
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    """Render the scene and draw the picture."""
    from synth3dlanes_cli.main import main as synth3dlanes

    scene = sample_scene(Scenes(load_params("appendix_i")), INDEX)
    with TemporaryDirectory() as folder:
        path, image_path = Path(folder) / "scene.json", Path(folder) / "image.png"
        path.write_text(to_json(scene))
        synth3dlanes(["render", str(path), "--out", str(image_path)], standalone_mode=False)
        labels = from_json(image_path.with_suffix(".labels.json").read_text(), "the scene")
        image = np.asarray(Image.open(image_path).convert("RGB"))
    draw(scene, labels, image).savefig(PICTURE, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
