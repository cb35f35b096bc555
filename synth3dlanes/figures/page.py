"""HTML pages of one scene or a data set, from the templates in `web/`. Each is a single file that loads nothing:
histograms are paths of an SVG."""

import base64
import json
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.ticker import MaxNLocator
from PIL import Image

from synth3dlanes.figures import colors
from synth3dlanes.figures.describe import (
    LANE_COLUMNS,
    describe,
    element_row,
    lane_row,
    object_tables,
    shown_title,
)
from synth3dlanes.figures.overlay import color_of, objects_in_image, stretches_img
from synth3dlanes.figures.passes import WORDS, pass_picture
from synth3dlanes.figures.samples import ShownScene
from synth3dlanes.figures.scene_view import SceneView
from synth3dlanes.figures.space import triangles
from synth3dlanes.figures.stats import Histogram, LabelStatistics, SceneStatistics, histograms, is_fine
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import CameraLabel, Labels
from synth3dlanes.scene.scene import Scene, to_json
from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.files import encoded

MAX_FRAMES = 60
_JPEG_QUALITY = 92


# What the macros of `web/parts.html` take: a drawing, or a part of one.
Values = dict[str, Any]


def scene_page(
    shown: ShownScene,
) -> str:
    """A page of one scene: the image, with lanes and masks that can be switched on and off; a 3D view with the lidar's
    points; the passes; and all parameters. A clip adds a slider through its frames (at most MAX_FRAMES, evenly spaced),
    a rig the images of all its cameras."""
    scene, labels, shot = shown.scene, shown.labels, shown.shot
    step = max(1, -(-len(shown.clip) // MAX_FRAMES))
    numbers = range(0, len(shown.clip), step)
    clip = [(number, *shown.clip[number]) for number in numbers]
    frames = [
        {"words": f"frame {number}, {seen.time_s or 0:.2f} s", "drawn": drawing(seen, image)}
        for number, seen, image in clip
    ]
    return render(
        "scene.html",
        title=shown_title(shown),
        switches=_switches([labels]),
        drawn=drawing(labels, shown.image),
        frames=frames,
        pause_ms=round(1000 / shot.fps * step),
        start=min(range(len(frames)), key=lambda i: abs(numbers[i] - shot.frame), default=0),
        rig=[(found.camera.name, drawing(found, picture)) for found, picture in shown.rig],
        passes=[
            {"name": name, "words": WORDS[name], "jpeg": _jpeg(pass_picture(name, values))}
            for name, values in shown.passes.items()
        ],
        groups=describe(shown),
        lane_columns=LANE_COLUMNS,
        lane_rows=[lane_row(lane) for lane in labels.lanes],
        object_tables=object_tables(labels),
        document="" if scene is None else json.dumps(json.loads(to_json(scene)), indent=1),
        space=_space(SceneView(scene, labels), shown.sweep, [found.camera for found, _ in shown.rig]),
    )


def report_page(
    title: str,
    samples: Sequence[tuple[str, Scene | None, Labels, RgbImage]],
    scenes: SceneStatistics,
    labels: LabelStatistics,
) -> str:
    """A data set: some of its samples (name, scene, labels, image), its distributions, and its parameters as declared
    and as drawn."""
    return render(
        "report.html",
        title=title,
        n_scenes=scenes.n_scenes,
        switches=_switches(sample for _, _, sample, _ in samples),
        cards=[
            {"name": name, "words": scene.roads.words if scene else "", "drawn": drawing(sample, image)}
            for name, scene, sample, image in samples
        ],
        topologies=scenes.topologies.items(),
        measured=[
            (row.name, *_short(row.minimum, row.p05, row.median, row.p95, row.maximum, row.mean))
            for row in labels.summaries
        ],
        plots=[plot(histogram) for histogram in histograms(scenes, labels)],
        parameters=[
            (
                row.key,
                row.declared,
                *_short(row.minimum, row.maximum, row.mean),
                row.count,
                row.test,
                "" if row.p_value is None else f"{row.p_value:.2g}",
            )
            for row in scenes.parameters
        ],
        bad={row.key for row in scenes.parameters if not is_fine(row)},
    )


def render(template: str, **values: Any) -> str:
    """The text of a template in `web/`; values are escaped."""
    loader = PackageLoader("synth3dlanes.figures", "web")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": False}
    return environment.get_template(template).render(values)


def drawing(labels: Labels, image: RgbImage | None) -> Values:
    """An image, if there is one, with its lanes in seen and hidden stretches, the boxes of its objects or faces of its
    traffic elements, and the points of each mask, in pixels."""
    lanes = [
        {
            "id": lane.id,
            "kind": lane.kind,
            "color": colors.hexadecimal(colors.KINDS[lane.kind]),
            "stretches": [(is_seen, _points(line)) for is_seen, line in stretches_img(labels.camera, lane)],
        }
        for lane in labels.lanes
    ]
    objects = [
        {
            "of_class": "element" if item.is_element else "object",
            "name": " ".join(element_row(item)[:3]) if item.is_element else f"{item.category} {item.id}",
            "color": colors.hexadecimal(color_of(item)),
            "lines": [_points(line) for line in lines],
        }
        for item, lines in objects_in_image(labels)
    ]
    masks = [
        {"name": _class(name), "color": color, "points": _dots(labels, name)} for name, color in colors.MASKS.items()
    ]
    size = {"width": labels.camera.width_px, "height": labels.camera.height_px}
    return {**size, "jpeg": image is not None and _jpeg(image), "lanes": lanes, "objects": objects, "masks": masks}


def _points(stretch: Float[np.ndarray, "n 2"]) -> str:
    return " ".join(f"{u:.2f},{v:.2f}" for u, v in stretch.tolist())


def _dots(labels: Labels, mask: str) -> list[tuple[str, str]]:
    """The points in the image to which a mask applies."""
    dots = []
    for lane in labels.lanes:
        behind_ground = ~lane.terrain_visible
        chosen = {"seen": lane.visible, "hidden by the ground": behind_ground}.get(mask, ~behind_ground & ~lane.visible)
        points_cam = lane.xyz_cam[lane.in_image & chosen]
        dots += [(f"{u:.1f}", f"{v:.1f}") for u, v in labels.camera.project(points_cam).tolist()]
    return dots


def _switches(labels: Iterable[Labels]) -> list[Values]:
    """Check boxes for the images: lanes by kind, hidden stretches, objects, traffic elements, and one for each mask
    (initially off)."""
    labels, masks = list(labels), dict(colors.MASKS)
    if any(lane.object_visible is None for one in labels for lane in one.lanes):
        del masks["hidden by objects"]
    is_element = {item.is_element for one in labels for item, _ in objects_in_image(one)}
    hexadecimal = colors.hexadecimal
    lines = {
        f".lane.{kind}": (f"{colors.KIND_WORDS[kind]}s", hexadecimal(color)) for kind, color in colors.KINDS.items()
    }
    lines[".lane .hidden"] = "hidden parts", "currentColor"
    lines |= {".object": ("objects", hexadecimal(colors.OBJECT))} if False in is_element else {}
    lines |= {".element": ("traffic elements", hexadecimal(colors.ELEMENT))} if True in is_element else {}
    points = {f".mask.{_class(name)}": (f"points {name}", color) for name, color in masks.items()}
    return [
        {"shows": shows, "name": name, "color": color, "is_on": shows in lines}
        for shows, (name, color) in {**lines, **points}.items()
    ]


def _class(mask: str) -> str:
    return mask.replace(" ", "-")


def _jpeg(image: RgbImage) -> str:
    jpeg = encoded(lambda stream: Image.fromarray(image).save(stream, "JPEG", quality=_JPEG_QUALITY))
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"


def _space(view: SceneView, sweep: Sweep | None, others: Sequence[CameraLabel]) -> dict[str, Any]:
    """What the script of the 3D view needs: field of view, places to look from, and triangles."""
    camera = view.labels.camera
    eye, axis = camera.road_from_cam[:3, 3], camera.road_from_cam[:3, 1]
    looks = {"azimuth_rad": camera.yaw_rad, "elevation_rad": camera.pitch_rad}
    views = {
        "behind": {"target": [0, 35, 0], "azimuth_rad": 0.5, "elevation_rad": 0.45, "distance_m": 75},
        "driver": {"target": (eye + 30 * axis).tolist(), **looks, "distance_m": 30},
        "above": {"target": [0, 50, 0], "azimuth_rad": 0, "elevation_rad": math.pi / 2, "distance_m": 150},
    }  # fmt: skip
    return {
        "fov_rad": 2 * math.atan(camera.height_px / 2 / -camera.img_from_cam[1, 2]),
        "views": views,
        "groups": [group.document() for group in triangles(view, sweep, others)],
    }


def _short(*values: float) -> list[str]:
    return [f"{value:.4g}" for value in values]


_WIDTH, _HEIGHT = 260, 160
# Half of the longest number fits beside the last tick.
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 20, 8, 32

Ticks = list[tuple[float, str]]


class Plot(NamedTuple):
    """A histogram in pixels: paths of its bars, its declared distribution ("" without one) and its axes, and its ticks
    as (place, text). `kind` is measured, good or bad."""

    title: str
    quantity: str
    label: str
    kind: str
    bars: str
    declared: str
    axes: str
    ticks_x: Ticks
    ticks_y: Ticks
    width: int = _WIDTH
    height: int = _HEIGHT
    left: int = _LEFT


def plot(histogram: Histogram) -> Plot:
    edges, counts, expected = histogram.edges, histogram.counts, histogram.expected
    highest = max(counts.max(), 0.0 if expected is None else expected.max(), 1.0) * 1.05
    bottom, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT

    def x(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.asarray(_LEFT + (values - edges[0]) / (edges[-1] - edges[0]) * (right - _LEFT))

    def y(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.asarray(bottom - values / highest * (bottom - _TOP))

    def stairs(heights: Float[np.ndarray, " n"]) -> str:
        corners = zip(np.repeat(x(edges), 2)[1:-1].tolist(), np.repeat(y(heights), 2).tolist(), strict=True)
        return f"M{_LEFT},{bottom}" + "".join(f"L{u:.1f},{v:.1f}" for u, v in corners) + f"L{right},{bottom}"

    at_x, at_y = _ticks(edges[0], edges[-1], 5, histogram.is_of_integers), _ticks(0.0, highest, 3, True)
    places_x, places_y = x(at_x).tolist(), y(at_y).tolist()
    marks = [f"M{u:.1f},{bottom}v4" for u in places_x] + [f"M{_LEFT},{v:.1f}h-4" for v in places_y]
    words = f"{histogram.title}: {counts.sum():.0f} values from {edges[0]:.4g} to {edges[-1]:.4g}"
    return Plot(
        histogram.title,
        histogram.quantity,
        words if histogram.is_fine else f"{words}, not as declared",
        "measured" if expected is None else "good" if histogram.is_fine else "bad",
        stairs(counts),
        "" if expected is None else stairs(expected),
        f"M{_LEFT},{_TOP}V{bottom}H{right}" + "".join(marks),
        list(zip(places_x, (f"{value:g}" for value in at_x), strict=True)),
        list(zip(places_y, (f"{value:g}" for value in at_y), strict=True)),
    )


def _ticks(low: float, high: float, n: int, is_whole: bool) -> Float[np.ndarray, " n"]:
    """At most n + 1 round values in the range."""
    values = np.asarray(MaxNLocator(n, steps=[1, 2, 5, 10], integer=is_whole).tick_values(low, high))
    return np.round(values[(values >= low) & (values <= high)], 12) + 0.0
