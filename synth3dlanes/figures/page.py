"""HTML pages of one scene or a whole data set. Each is a single file without external resources."""

import base64
import io
import json
import math
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from synth3dlanes.figures import colors
from synth3dlanes.figures.describe import LANE_COLUMNS, describe, lane_row, topology_words
from synth3dlanes.figures.overlay import stretches_img
from synth3dlanes.figures.scene_view import SceneView
from synth3dlanes.figures.space import triangles
from synth3dlanes.figures.stats import LabelStatistics, SceneStatistics
from synth3dlanes.figures.stats_views import draw_statistics, is_fine
from synth3dlanes.labels import Labels, Lane, LaneKind
from synth3dlanes.scene import Scene, to_json

Picture = UInt8[np.ndarray, "h w 3"]

_JPEG_QUALITY = 92
_LAYERS: dict[str, LaneKind] = {"centre lines": "centerline", "delimiters": "delimiter"}
_MASKS = {"seen": "#17a34a", "hidden by the ground": "#f59e0b", "hidden by objects": "#a21caf"}


def scene_page(scene: Scene, labels: Labels, image: Picture | None) -> str:
    """One scene: the image with lanes and masks that can be switched on and off, a 3D view, and all parameters."""
    title = f"seed {scene.seed}, {scene.split} {scene.index}: {topology_words(scene.road)}"
    picture = f'<div><div class="bar">{_switches([labels])}</div>{_svg(labels, image)}</div>'
    space = '<div><div class="bar" id="space-bar"></div><canvas id="space"></canvas></div>'
    groups = "".join(
        f"<section><h2>{escape(group)}</h2>{_table((), facts.items())}</section>"
        for group, facts in describe(scene, labels).items()
    )
    lanes = _table(LANE_COLUMNS, (lane_row(lane) for lane in labels.lanes), numbers_from=4)
    document = json.dumps(json.loads(to_json(scene)), indent=1)
    return _page(
        title,
        f'<div class="pair">{picture}{space}</div><div class="columns">{groups}</div><h2>lanes, counted in points</h2>'
        f"{lanes}<h2>scene.json</h2><details><summary>show</summary><pre>{escape(document)}</pre></details>"
        f'<script type="application/json" id="space-data">{_space(SceneView(scene, labels))}</script>',
    )


def report_page(
    title: str, samples: Sequence[tuple[str, Picture, Labels]], scenes: SceneStatistics, labels: LabelStatistics
) -> str:
    """A data set: some of its samples (name, image, labels), its distributions, and its parameters as declared and as
    drawn."""
    cards = "".join(
        f"<figure>{_svg(sample, image)}<figcaption>{escape(name)}</figcaption></figure>"
        for name, image, sample in samples
    )
    switches = _switches(sample for _, _, sample in samples)
    plots = io.BytesIO()
    draw_statistics(scenes, labels).savefig(plots, format="png", dpi=75)
    measured = _table(
        ("quantity", "min", "5 %", "median", "95 %", "max", "mean"),
        (
            (
                one.name,
                *(f"{value:.3g}" for value in (one.minimum, one.p05, one.median, one.p95, one.maximum, one.mean)),
            )
            for one in labels.summaries
        ),
        numbers_from=1,
    )
    topologies = _table(("road", "scenes"), ((name, str(n)) for name, n in scenes.topologies.items()), numbers_from=1)
    return _page(
        title,
        f'<p>{scenes.n_scenes} scenes.</p><div class="bar">{switches}</div><div class="cards">{cards}</div>'
        f"<h2>topologies</h2>{topologies}<h2>labels</h2>{measured}<h2>distributions</h2>"
        f'<img alt="histograms" src="data:image/png;base64,{base64.b64encode(plots.getvalue()).decode()}">'
        f"<h2>declared against drawn</h2>{_parameters(scenes)}",
    )


def _page(title: str, body: str) -> str:
    """A complete HTML document with this body; its security policy forbids all network connections."""
    web = files("synth3dlanes.figures") / "web"
    style, script = ((web / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">'
        f"<style>{style}</style></head>"
        f"<body><h1>{escape(title)}</h1>{body}<script>{script}</script></body></html>\n"
    )


def _svg(labels: Labels, image: Picture | None) -> str:
    """The image with its lanes (classes: lane, the kind, seen or hidden) and the points of each mask on top."""
    size = f"{labels.camera.width_px} {labels.camera.height_px}"
    width, height = labels.camera.width_px, labels.camera.height_px
    below = "" if image is None else f'<image width="{width}" height="{height}" href="{_jpeg(image)}"></image>'
    lanes = "".join(_polylines(labels, lane) for lane in labels.lanes)
    masks = "".join(
        f'<g class="mask {_class(name)}" fill="{color}">{_dots(labels, name)}</g>' for name, color in _MASKS.items()
    )
    return f'<svg viewBox="0 0 {size}">{below}{lanes}{masks}</svg>'


def _polylines(labels: Labels, lane: Lane) -> str:
    color = colors.hexadecimal(colors.KINDS[lane.kind])
    lines = "".join(
        f'<g class="{"seen" if is_seen else "hidden"}"><polyline points="{_points(stretch)}"></polyline></g>'
        for is_seen, stretch in stretches_img(labels.camera, lane)
    )
    return f'<g class="lane {lane.kind}" stroke="{color}"><title>{escape(lane.id)}</title>{lines}</g>'


def _points(stretch: Float[np.ndarray, "n 2"]) -> str:
    return " ".join(f"{u:.2f},{v:.2f}" for u, v in stretch.tolist())


def _dots(labels: Labels, mask: str) -> str:
    """One dot for each point in the image to which a mask applies."""
    dots = []
    for lane in labels.lanes:
        behind_ground = ~lane.terrain_visible
        chosen = {"seen": lane.visible, "hidden by the ground": behind_ground}.get(mask, ~behind_ground & ~lane.visible)
        points_cam = lane.xyz_cam[lane.in_image & chosen]
        homogeneous = points_cam @ labels.camera.img_from_cam.T
        dots += [f'<circle cx="{u / w:.1f}" cy="{v / w:.1f}" r="1.3"></circle>' for u, v, w in homogeneous.tolist()]
    return "".join(dots)


def _switches(labels: Iterable[Labels]) -> str:
    """Check boxes for the images: lanes by kind, hidden stretches, and one for each mask (initially off)."""
    masks = dict(_MASKS)
    if any(lane.object_visible is None for one in labels for lane in one.lanes):
        del masks["hidden by objects"]
    lanes = [
        _switch(f".lane.{kind}", name, colors.hexadecimal(colors.KINDS[kind]), is_on=True)
        for name, kind in _LAYERS.items()
    ]
    dots = [_switch(f".mask.{_class(name)}", f"points {name}", color, is_on=False) for name, color in masks.items()]
    return "".join([*lanes, _switch(".lane .hidden", "hidden parts", colors.INK, is_on=True), *dots])


def _class(mask: str) -> str:
    return mask.replace(" ", "-")


def _switch(shows: str, name: str, color: str, is_on: bool) -> str:
    checked = "checked" if is_on else ""
    return f'<label style="color:{color}"><input type="checkbox" data-shows="{shows}" {checked}> {escape(name)}</label>'


def _jpeg(image: Picture) -> str:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=_JPEG_QUALITY)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()


def _space(view: SceneView) -> str:
    camera = view.labels.camera
    eye = camera.road_from_cam[:3, 3]
    fov_rad = 2 * math.atan(camera.height_px / 2 / -camera.img_from_cam[1, 2])
    ahead = eye + 30 * camera.road_from_cam[:3, 1]
    views = {
        "behind": {"target": [0, 35, 0], "azimuth_rad": 0.5, "elevation_rad": 0.45, "distance_m": 75},
        "driver": {"target": ahead.tolist(), "azimuth_rad": 0, "elevation_rad": camera.pitch_rad, "distance_m": 30},
        "above": {"target": [0, 50, 0], "azimuth_rad": 0, "elevation_rad": math.pi / 2, "distance_m": 150},
    }  # fmt: skip
    return json.dumps({"fov_rad": fov_rad, "views": views, "groups": [group.document() for group in triangles(view)]})


def _parameters(scenes: SceneStatistics) -> str:
    rows = []
    for row in scenes.parameters:
        numbers = [f"{value:.4g}" for value in (row.minimum, row.maximum, row.mean)]
        p_value = "" if row.p_value is None else f"{row.p_value:.2g}"
        rows.append((row.key, row.declared, *numbers, str(row.count), row.test, p_value))
    bad = {row.key for row in scenes.parameters if not is_fine(row)}
    return _table(("parameter", "declared", "from", "to", "mean", "n", "test", "p"), rows, numbers_from=2, bad=bad)


def _table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers_from: int = 99,
    bad: set[str] | frozenset[str] = frozenset(),
) -> str:
    """A table; columns from `numbers_from` on are formatted as numbers, rows whose first cell is in `bad` are red."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{' class=number' if i >= numbers_from else ''}>{escape(cell)}</{tag}>" for i, cell in enumerate(row)
        )

    head = f"<tr>{cells('th', columns)}</tr>" if columns else ""
    body = "".join(f"<tr{' class=bad' if row[0] in bad else ''}>{cells('td', row)}</tr>" for row in rows)
    return f"<table>{head}{body}</table>"
