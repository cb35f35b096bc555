"""The control videos of a clip of Cosmos: depth, segmentation, edges and the lane map of a picture, and how frames
are compared with them; what stands still around a clip.

The lane map is the world scenario in the colours and widths of Cosmos's renderer, on black: lines first, then boxes
from far to near. What is far is darker, and lines narrower, as there. What hills hide is not drawn. Frames are compared
with room for what H.264 loses.
"""

import colorsys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw
from scipy.ndimage import label, sobel

from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.lane_map import Boundary, LaneSegment, lane_segments
from synth3dlanes.formats.writing import objects_of
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.labels.labels import CameraLabel, Labels, PaintColor
from synth3dlanes.labels.object_labels import CORNERS, ObjectLabel
from synth3dlanes.scene.things import BOXED, GROUND, KINDS, OWN, Rgb, classes_in
from synth3dlanes.system.arrays import Matrix4, Passes, Points3, Polyline3, RgbImage
from synth3dlanes.system.schema import SymbolKind
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.paint import is_double, paint_color, pair_of
from synth3dlanes.world.world import World

REACH_M = 150.0
"""Reach of lanes ahead of and behind all places of the host in the clip."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """What stands still around a clip. Painted lines by their ids go in the host's driving direction. Of symbols, which
    bound no lane, it has the outlines; of lines across the road their middles from one end to the other. Traffic
    elements have the poses of their frames in the world."""

    lanes: tuple[LaneSegment, ...]
    lines: dict[str, Boundary]
    edges: tuple[Polyline3, ...]
    symbols: tuple[tuple[SymbolKind, Polyline3], ...]
    elements: tuple[tuple[ObjectLabel, Matrix4], ...]


def scenario(world: World, labels: Labels, pictures: Iterable[Labels]) -> Scenario:
    """The scenario of a world by the labels of the clip's first picture, with the traffic elements of all
    `pictures`."""
    place, shot = world.view.world_from_host[:3, 3], world.scene.shot
    reach_m = REACH_M + host_driven(shot, shot.duration_s)
    return Scenario(
        tuple(lane_segments(world, labels.graph.segments, place, reach_m)),
        dict(_lines(world, place, reach_m)),
        tuple(world.ground.paved.edges(place[:2], reach_m)),
        tuple(_symbols(world)),
        _elements(pictures),
    )


def _lines(world: World, place: Float[np.ndarray, "3"], reach_m: float) -> Iterator[tuple[str, Boundary]]:
    network, markings = world.network, world.scene.markings
    for line, s in network.delimiters_near(place[:2], reach_m).items():
        points = line.points_world(s)
        points = points[np.linalg.norm(points[:, :2] - place[:2], axis=1) < 2 * reach_m]
        if line.marking != "none" and len(points) > 1:
            paint = paint_color(line, markings), is_double(line, markings), pair_of(line, markings)
            # Stations may fall as the host drives.
            yield line.id, Boundary(points[:: int(network.onwards)], line.marking, *paint)


def _symbols(world: World) -> Iterator[tuple[SymbolKind, Polyline3]]:
    for form in world.symbol_shapes:
        outline = form.outline
        if form.kind in ("stop_line", "give_way_line"):
            (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
            outline = np.array([[x0, (y0 + y1) / 2], [x1, (y0 + y1) / 2]])
        yield form.kind, form.points_world(outline)


def _elements(pictures: Iterable[Labels]) -> tuple[tuple[ObjectLabel, Matrix4], ...]:
    found = dict[int, tuple[ObjectLabel, Matrix4]]()
    for labels in pictures:
        for item in labels.traffic_elements or ():
            found.setdefault(item.id, (item, labels.camera.world_from_cam @ item.cam_from_object))
    return tuple(found[number] for number in sorted(found))


CATEGORIES, ELEMENTS = classes_in("cosmos"), classes_in("cosmos", of_elements=True)
EDGE_LOW, EDGE_HIGH = 100, 200
"""The thresholds of Canny's edges that inference takes by default."""
CLASS_COLORS = np.zeros((256, 3), np.uint8)
"""The colours of classes in segmentation videos, by semantic id."""
for _kind in KINDS:
    CLASS_COLORS[_kind.semantic_id] = _kind.video_color
LINE_COLORS: dict[PaintColor, Rgb] = {"white": (255, 255, 255), "yellow": (255, 255, 0)}
BOUNDARY, WAIT_LINE, CROSSWALK, ROAD_MARKING = (253, 1, 232), (108, 179, 59), (139, 93, 255), (20, 254, 185)
SIGN, LIGHT, BOX_EDGE = (8, 2, 255), (100, 100, 100), (200, 200, 200)
"""Colours of the lane-map video, as its renderer's third version has them."""
BOX_COLORS: dict[str, tuple[Rgb, Rgb]] = {
    "automobile": ((126, 206, 255), (0, 46, 136)),
    "person": ((255, 150, 200), (170, 10, 90)),
    "rider": ((150, 240, 170), (0, 110, 50)),
}
LARGE_COLORS = ((255, 192, 64), (204, 55, 0))
"""Colours of the rear and the front of boxes by class; those of persons and riders are our own."""
WIDTH_PX, OF_WIDTH_PX = 12.0, 1280.0
"""The width of lines in an image of this width."""
GOLDEN = 0.618034
# A fisheye also sees what is beside the plane of its camera, at depth 0, and behind it.
LEAST_DEPTH_M = 1.0
FINER = 2
"""Pictures are drawn this much larger, and made smaller."""
NEAREST_M, FARTHEST_M = 0.3, 200.0
"""Colours and widths fall from here to none."""
PAIR_M, DASH_M, GAP_M = 0.15, 3.0, 9.0
"""How far the stripes of a pair are from its middle; dashes as Cosmos draws long ones."""
BEHIND_M, BEHIND_SHARE = 1.0, 0.05
"""How much nearer the ground must be than a point to hide it."""
IS_GROUND = np.isin(np.arange(256), GROUND)
FACES = ((4, 5, 6, 7), (0, 4, 7, 3), (1, 5, 6, 2), (3, 2, 6, 7), (0, 1, 5, 4), (0, 1, 2, 3))
"""Faces of a box by its corners: rear, left, right, lower side, upper side, front."""
SHADES = (0.0, 0.5, 0.5, 0.5, 0.5, 1.0)
STATE_COLORS: dict[str, Rgb] = {"red": (240, 50, 50), "yellow": (255, 200, 0), "green": (130, 240, 132)}
# The share of a frame's pixels that may be off by more than these grey levels (of 255): H.264 blurs borders and narrow
# lines. A frame that is moved by this must fit worse.
SHARE_OFF, MOVED_PX = 0.2, 4
GREYS = {"rgb": 24, "depth": 8, "seg": 64, "edge": 64, "hdmap": 64}
Pixels = Float[np.ndarray, "_ 2"]


def nearness(passes: Passes) -> Float[np.ndarray, "h w"]:
    """1 / depth, 0 where nothing is hit; LEAST_DEPTH_M counts for all that is nearer or behind."""
    return 1.0 / np.maximum(passes["depth"].astype(float), LEAST_DEPTH_M)


def nearness_span(passes: Passes) -> tuple[float, float]:
    """The least and the greatest nearness of a picture, but for the host's own bonnet, which would darken all else."""
    found = nearness(passes)[~np.isin(passes["semantic"], OWN)]
    return (float(found.min()), float(found.max())) if found.size else (0.0, 0.0)


def depth_picture(passes: Passes, span: tuple[float, float]) -> RgbImage:
    """Nearness from the least (black) to the greatest (white) of a clip, which are its span."""
    low, high = span
    grey = np.rint(255 * (nearness(passes) - low) / max(high - low, 1e-9)).clip(0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)


def seg_picture(passes: Passes) -> RgbImage:
    """A colour for each class, and for each object with a box one of its own, the same in all frames."""
    semantic, instance = passes["semantic"], passes["instance"]
    picture, is_object = CLASS_COLORS[semantic], np.isin(semantic, BOXED)
    numbers, at = np.unique(instance[is_object], return_inverse=True)
    if len(numbers):
        picture[is_object] = np.array([object_color(int(number)) for number in numbers], np.uint8)[at]
    return picture


def object_color(number: int) -> Rgb:
    """The colour of an object by its instance id; those of successive ids are far apart."""
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(number * GOLDEN % 1, 0.8, 0.95))
    return red, green, blue


def edge_picture(image: RgbImage) -> RgbImage:
    """Canny's edges, white on black, with the thresholds of Cosmos and the operators of OpenCV: Sobel's, of the
    channel that changes most."""
    return np.repeat((edges(image) * np.uint8(255))[..., None], 3, axis=2)


def edges(image: RgbImage) -> Bool[np.ndarray, "h w"]:
    """Where the edges of an image are."""
    # SciPy's operator would also smooth over the axis of the channels.
    channels = np.moveaxis(image.astype(np.int32), 2, 0)
    along = [np.stack([sobel(one, axis, mode="nearest") for one in channels], axis=2) for axis in (1, 0)]
    size = np.abs(along[0]) + np.abs(along[1])
    channel = size.argmax(axis=2)[..., None]
    dx, dy, size = (np.take_along_axis(values, channel, axis=2)[..., 0] for values in (*along, size))
    strong = _ridges(dx, dy, size) & (size > EDGE_LOW)
    numbers, n_parts = label(strong, np.ones((3, 3)))
    kept = np.zeros(n_parts + 1, dtype=bool)
    kept[np.unique(numbers[strong & (size > EDGE_HIGH)])] = True
    kept[0] = False
    return kept[numbers]


def _ridges(dx: np.ndarray, dy: np.ndarray, size: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """Where the gradient is greater than on both sides along its direction, of which there are four."""
    padded = np.pad(size, 1)
    height, width = size.shape

    def beside(down: int, right: int) -> np.ndarray:
        return padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    tan_22 = np.sqrt(2) - 1
    level, steep = np.abs(dy) < tan_22 * np.abs(dx), np.abs(dy) > np.abs(dx) / tan_22
    falls = dx * dy >= 0
    found = np.zeros(size.shape, dtype=bool)
    for where, (down, right) in (
        (level, (0, 1)),
        (steep, (1, 0)),
        (~level & ~steep & falls, (1, 1)),
        (~level & ~steep & ~falls, (1, -1)),
    ):
        before, after = beside(-down, -right), beside(down, right)
        is_ridge = (size > before) & ((size >= after) if down == 0 or right == 0 else (size > after))
        found |= where & is_ridge
    return found


def lane_map_picture(picture: SourceSample, around: Scenario) -> RgbImage:
    camera = picture.labels.camera
    canvas = _Canvas(camera, picture.passes)
    for edge in around.edges:
        canvas.line(edge, BOUNDARY, WIDTH_PX)
    for kind, outline in around.symbols:
        if kind in ("stop_line", "give_way_line"):
            canvas.line(outline, WAIT_LINE, WIDTH_PX)
        elif kind != "gore":
            canvas.area(outline, CROSSWALK if kind == "crosswalk" else ROAD_MARKING)
    for line in around.lines.values():
        for stripe in _stripes(line):
            canvas.line(stripe, LINE_COLORS[line.color or "white"], WIDTH_PX)
    items = objects_of(picture.labels, CATEGORIES)
    boxes = [(item.corners_cam, BOX_COLORS.get(CATEGORIES[item.category], LARGE_COLORS)) for item in items]
    states = {item.id: item for item in picture.labels.traffic_elements or ()}
    for first, world_from_element in around.elements:
        label = states.get(first.id, first)
        color = _element_color(label)
        corners_world = transform(world_from_element, CORNERS * label.size_m / 2)
        boxes.append((transform(canvas.cam_from_world, corners_world), (color, color)))
    for corners_cam, colors in sorted(boxes, key=lambda box: -float(np.linalg.norm(box[0].mean(axis=0)))):
        canvas.box(corners_cam, colors)
    return canvas.image()


def _element_color(label: ObjectLabel) -> Rgb:
    if label.state is None:
        return SIGN
    state = label.state
    light = "red" if "red" in state else "green" if "green" in state else "yellow" if "amber" in state else ""
    return STATE_COLORS.get(light, LIGHT)


def _stripes(line: Boundary) -> Iterator[Points3]:
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
        self._depth = np.where(IS_GROUND[passes["semantic"]], passes["depth"], np.inf)
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


DRAWN: dict[str, Callable[[SourceSample, Scenario, tuple[float, float]], RgbImage]] = {
    "rgb": lambda picture, around, span: picture.image,
    "depth": lambda picture, around, span: depth_picture(picture.passes, span),
    "seg": lambda picture, around, span: seg_picture(picture.passes),
    "edge": lambda picture, around, span: edge_picture(picture.image),
    "hdmap": lambda picture, around, span: lane_map_picture(picture, around),
}
"""What the video of each kind shows of a picture, given what is around the clip and the span of its depth video."""


def frame_problem(frame: RgbImage, expected: Float[np.ndarray, "h w 3"], greys: int) -> str:
    """What is wrong with a frame that should look as expected: H.264 blurs borders, but moves nothing."""
    share = float((np.abs(frame - expected).max(axis=2) > greys).mean())
    if share > SHARE_OFF:
        return f"expected at most {SHARE_OFF:.0%} of its pixels off by {greys} of 255, got {share:.0%}"
    here = _apart(frame, expected)
    for name, other in (
        (f"moved up by {MOVED_PX} px", np.roll(expected, -MOVED_PX, axis=0)),
        (f"moved down by {MOVED_PX} px", np.roll(expected, MOVED_PX, axis=0)),
        (f"moved to the left by {MOVED_PX} px", np.roll(expected, -MOVED_PX, axis=1)),
        (f"moved to the right by {MOVED_PX} px", np.roll(expected, MOVED_PX, axis=1)),
        ("mirrored", expected[:, ::-1]),
        ("black", np.zeros_like(expected)),
    ):
        if _apart(frame, other) < here:
            return f"expected it as its picture, got it nearer to that one {name}"
    return ""


def _apart(frame: RgbImage, expected: Float[np.ndarray, "h w 3"]) -> float:
    inner = slice(MOVED_PX, -MOVED_PX)
    return float(np.abs(frame - expected)[inner, inner].mean())
