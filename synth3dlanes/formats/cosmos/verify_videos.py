"""Compare the videos of a view with the pictures, passes and labels that they were made from: frame by frame, with room
for what H.264 loses."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_gradient_magnitude, maximum_filter

from synth3dlanes.formats.comparing import SourceSample
from synth3dlanes.formats.cosmos.controls import car_color
from synth3dlanes.formats.cosmos.convention import CLASS_COLORS, FOLDERS
from synth3dlanes.formats.cosmos.read import CosmosClip
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.settings import SEMANTIC_IDS
from synth3dlanes.system.arrays import RgbImage

# How much of a frame may be off by more than so many of 255 grey levels.
SHARE_OFF = 0.2
GREYS = {"rgb": 24, "depth": 8, "seg": 64}
# Depth videos tell no smaller depths.
NEAR_M = 1.0
# What is moved by so many pixels must fit worse.
MOVED_PX, LEAST_EDGES = 4, 200
# The share of the points of painted lines, up to so far ahead, that must be brighter than that in the lane map, the
# least number of points to judge by, and how much brighter the map may be beside them.
LEAST_LIT, DARK, LINE_POINTS, FARTHEST_M, MORE_LIGHT = 0.9, 60, 8, 60.0, 1.05


def video_problems(
    clip: CosmosClip, view: str, pictures: list[SourceSample], kinds: Iterable[str] = FOLDERS
) -> Iterator[str]:
    """Findings in the videos of a view."""
    rate_hz, span = pictures[0].scene.shot.fps, clip.span(view)
    for kind in kinds:
        path, n = clip.files.video(kind, view), 0
        for frame in clip.frames(kind, view, rate_hz):
            n += 1
            if n > len(pictures):
                break
            picture = pictures[n - 1]
            height, width = picture.image.shape[:2]
            if frame.shape != (height + height % 2, width + width % 2, 3):
                yield f"{path}: frame {n - 1}: expected {width}x{height} pixels, got {frame.shape[1]}x{frame.shape[0]}"
                break
            problem = CHECKS[kind](frame[:height, :width], picture, span)
            if problem:
                yield f"{path}: frame {n - 1}: {problem}"
        if n != len(pictures):
            yield f"{path}: expected {len(pictures)} frames, got {'more' if n > len(pictures) else n}"


def _off(frame: RgbImage, expected: Float[np.ndarray, "h w c"], greys: int) -> str:
    """What is wrong with a frame that should look as expected: H.264 blurs borders, but moves nothing."""
    share = float((np.abs(frame.astype(np.float32) - expected).max(axis=2) > greys).mean())
    if share > SHARE_OFF:
        return f"expected at most {SHARE_OFF:.0%} of its pixels off by {greys} of 255, got {share:.0%}"
    here = _apart(frame, expected)
    for name, moved in (
        ("up", np.roll(expected, -MOVED_PX, axis=0)),
        ("down", np.roll(expected, MOVED_PX, axis=0)),
        ("to the left", np.roll(expected, -MOVED_PX, axis=1)),
        ("to the right", np.roll(expected, MOVED_PX, axis=1)),
        ("to the other side", expected[:, ::-1]),
    ):
        if _apart(frame, moved) < here:
            return f"expected it in its place, got it nearer to its picture {MOVED_PX} px {name}"
    return ""


def _apart(frame: RgbImage, expected: Float[np.ndarray, "h w c"]) -> float:
    inner = slice(MOVED_PX, -MOVED_PX)
    return float(np.abs(frame.astype(np.float32) - expected)[inner, inner].mean())


def _rgb(frame: RgbImage, picture: SourceSample, span: tuple[float, float]) -> str:
    return _off(frame, picture.image.astype(float), GREYS["rgb"])


def _depth(frame: RgbImage, picture: SourceSample, span: tuple[float, float]) -> str:
    (low, high), depth_m = span, picture.passes["depth"].astype(float)
    # What is behind a fisheye counts as near.
    share = (1 / np.where(depth_m < NEAR_M, NEAR_M, depth_m) - low) / max(high - low, 1e-9)
    return _off(frame, 255 * np.clip(share, 0, 1)[..., None], GREYS["depth"])


def _seg(frame: RgbImage, picture: SourceSample, span: tuple[float, float]) -> str:
    semantic, instance = picture.passes["semantic"], picture.passes["instance"]
    expected = CLASS_COLORS[semantic].astype(float)
    for number in np.unique(instance[semantic == SEMANTIC_IDS["car"]]).tolist():
        expected[(semantic == SEMANTIC_IDS["car"]) & (instance == number)] = car_color(number)
    return _off(frame, expected, GREYS["seg"])


def _edge(frame: RgbImage, picture: SourceSample, span: tuple[float, float]) -> str:
    change = gaussian_gradient_magnitude(picture.image.mean(axis=2), 1.0)
    rows, columns = np.nonzero(frame.min(axis=2) > 127)
    height, width = change.shape
    if len(rows) < LEAST_EDGES:
        return ""
    here = change[rows, columns].mean()
    for name, row, column in (
        ("up", rows - MOVED_PX, columns),
        ("down", rows + MOVED_PX, columns),
        ("left", rows, columns - MOVED_PX),
        ("right", rows, columns + MOVED_PX),
        ("to the other side", rows, width - 1 - columns),
    ):
        there = change[row.clip(0, height - 1), column.clip(0, width - 1)].mean()
        if not there < here:
            return f"expected edges on changes of the image, got stronger ones {MOVED_PX} px {name}"
    return ""


def _hdmap(frame: RgbImage, picture: SourceSample, span: tuple[float, float]) -> str:
    lit = maximum_filter(frame.max(axis=2), size=3)
    uv = _sure_points(picture.labels)
    if len(uv) >= LINE_POINTS:
        column, row = np.floor(uv).astype(int).T
        share = float((lit[row, column] > DARK).mean())
        if share < LEAST_LIT:
            return f"expected {LEAST_LIT:.0%} of the points of painted lines drawn, got {share:.0%}"
        light = frame.max(axis=2).astype(float)
        for name, aside in (("left", -MOVED_PX), ("right", MOVED_PX)):
            there = light[row, (column + aside).clip(0, light.shape[1] - 1)].mean()
            if there > MORE_LIGHT * light[row, column].mean():
                return f"expected painted lines in their place, got them nearer {MOVED_PX} px to the {name}"
    for item in picture.labels.objects or ():
        inside = picture.labels.camera.shows(item.center_cam[None])[0]
        if inside and item.corners_cam[:, 1].min() > 1.0 and item.center_cam[1] < FARTHEST_M:
            column, row = np.floor(picture.labels.camera.project(item.center_cam[None])[0]).astype(int)
            if lit[row, column] <= DARK:
                return f"expected the box of car {item.id} over its middle, got nothing there"
    return ""


def _sure_points(labels: Labels) -> np.ndarray:
    """Pixels of solid lines that the ground does not hide, which boxes may cover."""
    solid = [lane for lane in labels.lanes if lane.marking == "solid" and not lane.double]
    points = [lane.xyz_cam[lane.in_image & lane.terrain_visible] for lane in solid]
    xyz = np.concatenate([np.zeros((0, 3)), *points])
    uv = labels.camera.project(xyz[xyz[:, 1] < FARTHEST_M])
    inside = (uv > 1).all(axis=1) & (uv < np.array([labels.camera.width_px, labels.camera.height_px]) - 1).all(axis=1)
    return np.asarray(uv[inside])


CHECKS: dict[str, Callable[[RgbImage, SourceSample, tuple[float, float]], str]] = {
    "rgb": _rgb,
    "depth": _depth,
    "seg": _seg,
    "edge": _edge,
    "hdmap": _hdmap,
}
