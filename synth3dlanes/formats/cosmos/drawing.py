"""The lane-map picture: the world scenario in the colours and widths of Cosmos's renderer, on black.

Lines first, then boxes from far to near. What is far is darker, and lines narrower, as there. What hills hide is not
drawn.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw

from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.cosmos.convention import (
    BOUNDARY,
    BOX_EDGE,
    CAR_COLORS,
    CROSSWALK,
    LIGHT,
    LINE_COLORS,
    OF_WIDTH_PX,
    ROAD_MARKING,
    SIGN,
    TRUCK_COLORS,
    WAIT_LINE,
    WIDTH_PX,
    Rgb,
)
from synth3dlanes.formats.cosmos.scenario import PaintedLine, Scenario
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.labels.element_labels import ElementLabel
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.labels.object_labels import CORNERS
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import Passes, Points3, RgbImage

FINER = 2
"""Pictures are drawn this much larger, and made smaller."""
NEAREST_M, FARTHEST_M = 0.3, 200.0
"""Colours and widths fall from here to none."""
PAIR_M, DASH_M, GAP_M = 0.15, 3.0, 9.0
"""How far the stripes of a pair are from its middle; dashes as Cosmos draws long ones."""
BEHIND_M, BEHIND_SHARE = 1.0, 0.05
"""How much nearer the ground must be than a point to hide it."""
GROUND = np.isin(np.arange(256), [SEMANTIC_IDS[name] for name in ("terrain", "road", "shoulder", "marking", "symbol")])
FACES = ((4, 5, 6, 7), (0, 4, 7, 3), (1, 5, 6, 2), (3, 2, 6, 7), (0, 1, 5, 4), (0, 1, 2, 3))
"""Faces of a box by its corners: rear, left, right, lower side, upper side, front."""
SHADES = (0.0, 0.5, 0.5, 0.5, 0.5, 1.0)
STATE_COLORS: dict[str, Rgb] = {"red": (240, 50, 50), "yellow": (255, 200, 0), "green": (130, 240, 132)}

Pixels = Float[np.ndarray, "_ 2"]


def lane_map_picture(picture: SourceSample, around: Scenario) -> RgbImage:
    """The lane map of a picture."""
    camera = picture.labels.camera
    canvas = _Canvas(camera, picture.passes)
    for edge in around.edges:
        canvas.line(edge, BOUNDARY, WIDTH_PX)
    for symbol in around.symbols:
        if symbol.kind in ("stop_line", "give_way_line"):
            canvas.line(symbol.points_world, WAIT_LINE, WIDTH_PX)
        elif symbol.kind != "gore":
            canvas.area(symbol.points_world, CROSSWALK if symbol.kind == "crosswalk" else ROAD_MARKING)
    for line in around.lines:
        for stripe in _stripes(line):
            canvas.line(stripe, LINE_COLORS[line.color], WIDTH_PX)
    boxes = [(item.corners_cam, TRUCK_COLORS if item.category in ("truck", "bus", "trailer") else CAR_COLORS)
             for item in picture.labels.objects or ()]  # fmt: skip
    states = {item.id: item for item in picture.labels.traffic_elements or ()}
    for element in around.elements:
        label = states.get(element.label.id, element.label)
        color = _element_color(label)
        corners_world = transform(element.world_from_element, CORNERS * label.size_m / 2)
        boxes.append((transform(canvas.cam_from_world, corners_world), (color, color)))
    for corners_cam, colors in sorted(boxes, key=lambda box: -float(np.linalg.norm(box[0].mean(axis=0)))):
        canvas.box(corners_cam, colors)
    return canvas.image()


def _element_color(label: ElementLabel) -> Rgb:
    if label.category == "road_sign":
        return SIGN
    state = label.state or "off"
    light = "red" if "red" in state else "green" if "green" in state else "yellow" if "amber" in state else ""
    return STATE_COLORS.get(light, LIGHT)


def _stripes(line: PaintedLine) -> Iterator[Points3]:
    """The painted pieces of a line; of a double one, or of a pair, those of both stripes."""
    if not line.double and line.pair is None:
        yield from _dashes(line.points_world) if line.marking == "dashed" else (line.points_world,)
        return
    along = np.gradient(line.points_world[:, :2], axis=0)
    right = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(along))])
    right /= np.maximum(np.linalg.norm(right, axis=1), 1e-9)[:, None]
    patterns = (line.pair or f"{line.marking}_{line.marking}").split("_")
    for pattern, aside_m in zip(patterns, (-PAIR_M, PAIR_M), strict=True):
        points = line.points_world + aside_m * right
        yield from _dashes(points) if pattern == "dashed" else (points,)


def _dashes(points: Points3) -> Iterator[Points3]:
    at_m = lengths_along(points)
    for start_m in np.arange(0.0, at_m[-1], DASH_M + GAP_M):
        inner = at_m[(at_m > start_m) & (at_m < start_m + DASH_M)]
        wanted = np.concatenate([[start_m], inner, [min(start_m + DASH_M, at_m[-1])]])
        yield np.column_stack([np.interp(wanted, at_m, column) for column in points.T])


class _Canvas:
    """A picture by a camera that is being drawn."""

    def __init__(self, camera: CameraLabel, passes: Passes) -> None:
        self.camera, self.cam_from_world = camera, invert(camera.world_from_cam)
        self._depth = np.where(GROUND[passes["semantic"]], passes["depth"], np.inf)
        self._image = Image.new("RGB", (FINER * camera.width_px, FINER * camera.height_px))
        self._draw = ImageDraw.Draw(self._image)
        self._scale = FINER * camera.width_px / OF_WIDTH_PX

    def line(self, points_world: Points3, color: Rgb, width_px: float) -> None:
        """A line on the ground, where it is ahead and hills do not hide it."""
        points = transform(self.cam_from_world, points_world)
        shown = (points[:, 1] > NEAREST_M) & (points[:, 1] < FARTHEST_M)
        uv = np.where(shown[:, None], self.camera.project(np.where(shown[:, None], points, 1.0)), np.nan)
        kept = np.isfinite(uv).all(axis=1) & ~self._is_hidden(uv, points[:, 1])
        for i, j in pairwise(range(len(uv))):
            if kept[i] and kept[j]:
                share = _share(points[i : j + 1])
                width = max(1, round(width_px * self._scale * share))
                self._draw.line(_flat(uv[[i, j]]), fill=_darker(color, share), width=width)

    def area(self, points_world: Points3, color: Rgb) -> None:
        """A filled area on the ground."""
        points = transform(self.cam_from_world, points_world)
        middle = points.mean(axis=0)
        uv = self.camera.project(middle[None])
        if NEAREST_M < middle[1] < FARTHEST_M and not self._is_hidden(uv, middle[1:2])[0]:
            self._polygon(points, color, None)

    def box(self, corners_cam: Float[np.ndarray, "8 3"], colors: tuple[Rgb, Rgb]) -> None:
        """A box with the colours of its rear and front, its faces from far to near. Cars have edges."""
        if corners_cam[:, 1].max() < NEAREST_M or corners_cam[:, 1].min() > FARTHEST_M:
            return
        rear, front = (np.array(color, float) for color in colors)
        faces = [(corners_cam[list(face)], shade) for face, shade in zip(FACES, SHADES, strict=True)]
        for face, shade in sorted(faces, key=lambda pair: -float(np.linalg.norm(pair[0].mean(axis=0)))):
            red, green, blue = np.rint(rear + shade * (front - rear)).astype(int).tolist()
            self._polygon(face, (red, green, blue), BOX_EDGE if colors[0] != colors[1] else None)

    def image(self) -> RgbImage:
        """The picture."""
        return np.asarray(self._image.reduce(FINER))

    def _polygon(self, points_cam: Points3, color: Rgb, edge: Rgb | None) -> None:
        ahead = _clipped(points_cam)
        if len(ahead) < 3:
            return
        uv = self.camera.project(ahead)
        if np.isfinite(uv).all():
            share = _share(ahead)
            outline = edge and _darker(edge, share)
            self._draw.polygon(_flat(uv), fill=_darker(color, share), outline=outline, width=FINER)

    def _is_hidden(self, uv: Pixels, depth_m: Float[np.ndarray, " _"]) -> Bool[np.ndarray, " _"]:
        """Whether the ground is before points in the image."""
        size = np.array([self.camera.width_px, self.camera.height_px])
        inside = np.isfinite(uv).all(axis=1) & (uv >= 0).all(axis=1) & (uv < size).all(axis=1)
        column, row = np.floor(uv[inside]).astype(int).T
        hidden = np.zeros(len(uv), dtype=bool)
        hidden[inside] = self._depth[row, column] * (1 + BEHIND_SHARE) + BEHIND_M < depth_m[inside]
        return hidden


def _share(points_cam: Points3) -> float:
    """What is left of colours and widths at a distance."""
    return float(np.clip(1 - points_cam[:, 1].mean() / FARTHEST_M, 0, 1))


def _darker(color: Rgb, share: float) -> Rgb:
    red, green, blue = (round(part * share) for part in color)
    return red, green, blue


def _clipped(points_cam: Points3) -> Float[np.ndarray, "_ 3"]:
    """The part of a polygon ahead of the camera."""
    made = list[np.ndarray]()
    for a, b in zip(points_cam, np.roll(points_cam, -1, axis=0), strict=True):
        if a[1] >= NEAREST_M:
            made.append(a)
        if (a[1] >= NEAREST_M) != (b[1] >= NEAREST_M):
            made.append(a + (NEAREST_M - a[1]) / (b[1] - a[1]) * (b - a))
    return np.array(made).reshape(-1, 3)


def _flat(uv: Pixels) -> Sequence[tuple[float, float]]:
    # Pillow's pixels have their middle at whole numbers.
    return [(float(u), float(v)) for u, v in (uv * FINER - 0.5).clip(-1e5, 1e5)]
