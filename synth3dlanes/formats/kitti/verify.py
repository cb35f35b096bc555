"""Read a KITTI export back and compare it with our labels: objects in metres and pixels, by the projection of its own
calibration, and the lidar's points in metres."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.comparing import Comparison, Gap, SourceSample
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.kitti.convention import (
    DONT_CARE,
    LEAST_SEEN,
    LISTS,
    TYPES,
    KittiObject,
    occlusion,
    parse_line,
    path_of,
)
from synth3dlanes.formats.reading import first_lines, numbers, read_file, read_text
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.object_labels import CORNERS, ObjectLabel
from synth3dlanes.system.errors import FormatError

# Places and sizes have four decimals, pixels two; labels are rounded as much.
LIMIT_M, LIMIT_PX = 0.001, 0.02
# Truncation has two decimals.
TRUNCATION, ANGLE_RAD = 0.006, 2e-4
SHAPES = {"P2": (3, 4), "R0_rect": (3, 3), "Tr_velo_to_cam": (3, 4)}
# How far objects of equal types may be, for the nearest to be the same.
SAME_M = 2.0
# Pixels count less of what is nearer than this.
NEAR_M = 10.0

Content = tuple[list[KittiObject], dict[str, Float[np.ndarray, "r c"]], Float[np.ndarray, "n 4"] | None]


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every list."""
    for path in sorted((out / LISTS).glob("*.txt")):
        yield FrameList(path.stem, (_frame(out, name) for name in first_lines(path, most_frames)))


def _frame(out: Path, name: str) -> ReadFrame:
    if not name.isdecimal():
        raise FormatError(f"{out / LISTS}: expected names of frames, which are numbers, got {name[:60]!r}")
    where = str(out / path_of("label", name))
    lines = [line for line in read_text(Path(where)).splitlines() if line.strip()]
    objects = [parse_line(line, f"{where}:{number}") for number, line in enumerate(lines, start=1)]
    points = out / path_of("points", name)
    content = objects, _calib(out / path_of("calib", name)), _points(points) if points.exists() else None
    return ReadFrame(path_of("image", name), where, path_of("image", name), content)


def _calib(path: Path) -> dict[str, Float[np.ndarray, "r c"]]:
    rows = dict(line.split(":", 1) for line in read_text(path).splitlines() if ":" in line)
    matrices = {}
    for name, shape in SHAPES.items():
        matrix = numbers(rows.get(name, ""), f"{path}: {name}", 1) if rows.get(name, "").strip() else np.zeros((0, 1))
        if matrix.size != shape[0] * shape[1]:
            raise FormatError(f"{path}: {name}: expected {shape[0] * shape[1]} numbers, got {matrix.size}")
        matrices[name] = matrix.reshape(shape)
    return matrices


def _points(path: Path) -> Float[np.ndarray, "n 4"]:
    data = read_file(path)
    if len(data) % 16:
        raise FormatError(f"{path}: expected four numbers of 4 bytes for each point, got {len(data)} bytes")
    return np.frombuffer(data, "<f4").reshape(-1, 4).astype(float)


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Each object of a frame beside the one of the labels that it is, those that it lacks, and the points."""
    content: Content = frame.content
    objects, calib, points = content
    camera, items = truth.labels.camera, truth.labels.objects or ()
    sides = np.array([camera.width_px, camera.height_px, camera.width_px, camera.height_px], float)
    wanted = [item for item in items if item.box_px is not None and item.seen_box_px is not None]
    gaps, problems, left = list[Gap](), list[str](), {item.id: item for item in wanted}
    strange = Counter[str]()
    if not objects:
        problems.append("expected a line, also without objects, because tools fail on an empty file; got none")
    for number, found in enumerate(objects):
        if not wanted and found.type == DONT_CARE and not found.box_px.any():
            continue
        item = _nearest(found, list(left.values()), sides)
        if item is None:
            problems.append(f"object {number}: expected one of the labels, got {found.type} far from any of that kind")
            strange["object"] += 1
            continue
        del left[item.id]
        gaps.append(Gap.of(f"object {item.id}", "px", np.abs(found.box_px - _box(item, sides)), "object"))
        if found.type != DONT_CARE:
            gaps += _gaps(found, item, calib, truth)
            problems += _problems(found, item)
    problems += (f"expected {item.category} {item.id}, got it in no line" for item in left.values())
    gaps += _of_points(points, calib, truth, problems)
    return Comparison.within(gaps, {"m": LIMIT_M, "px": LIMIT_PX}) + Comparison((), tuple(problems), strange=strange)


def _nearest(found: KittiObject, items: list[ObjectLabel], sides: Float[np.ndarray, "4"]) -> ObjectLabel | None:
    """The object of the labels that a line is about: of those of its type the nearest, in space or in the image."""
    is_region = found.type == DONT_CARE
    alike = [
        item
        for item in items
        if ((item.visible_fraction or 0.0) < LEAST_SEEN if is_region else TYPES[item.category] == found.type)
    ]
    if not alike:
        return None
    if is_region:
        return min(alike, key=lambda item: float(np.abs(found.box_px - _box(item, sides)).max()))
    apart_m = [float(np.linalg.norm(found.location_cv - _foot_cv(item))) for item in alike]
    at = int(np.argmin(apart_m))
    return alike[at] if apart_m[at] < SAME_M else None


def _foot_cv(item: ObjectLabel) -> Float[np.ndarray, "3"]:
    """The middle of the four lower corners, in the axes of the format."""
    x, y, z = item.corners_cam[CORNERS[:, 2] < 0].mean(axis=0)
    return np.array([x, -z, y])


def _box(item: ObjectLabel, sides: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
    """The rectangle of an object, where pixels count from the middle of the first one."""
    assert item.box_px is not None
    return np.clip(item.box_px - 0.5, 0, sides - 1)


def _gaps(found: KittiObject, item: ObjectLabel, calib: dict[str, np.ndarray], truth: SourceSample) -> Iterator[Gap]:
    """Distances of corners in space, but for the slope that the format does not have; and of the foot in the image."""
    corners_cv = item.corners_cam[:, [0, 2, 1]] * [1, -1, 1]
    foot_cv, size_m = _foot_cv(item), item.size_m
    along = corners_cv[:4].mean(axis=0) - corners_cv[4:].mean(axis=0)
    heading = np.array([along[0], 0, along[2]]) / np.hypot(along[0], along[2])
    right = np.array([heading[2], 0, -heading[0]])
    half = CORNERS * size_m / 2
    ours = (
        foot_cv + half[:, :1] * right + half[:, 1:2] * heading - np.array([0, 1.0, 0]) * (half[:, 2:] + size_m[2] / 2)
    )
    height_m, width_m, length_m = found.height_width_length_m
    c, s = np.cos(found.rotation_y_rad), np.sin(found.rotation_y_rad)
    turned = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    own = np.column_stack(
        [CORNERS[:, 1] * length_m / 2, (CORNERS[:, 2] + 1) * -height_m / 2, -CORNERS[:, 0] * width_m / 2]
    )
    theirs = own @ turned.T + found.location_cv
    yield Gap.of(f"object {item.id}", "m", np.linalg.norm(theirs - ours, axis=1), "object")
    foot = calib["R0_rect"] @ found.location_cv
    u, v, w = calib["P2"] @ [*foot, 1.0]
    expected = truth.labels.camera.project(np.array([foot_cv[0], foot_cv[2], -foot_cv[1]])) - 0.5
    if np.isfinite(expected).all() and foot_cv[2] > 1.0:
        off_px = np.abs([u / w, v / w] - expected) * min(1.0, foot_cv[2] / NEAR_M)
        yield Gap.of(f"object {item.id}", "px", off_px, "object")


def _problems(found: KittiObject, item: ObjectLabel) -> Iterator[str]:
    seen = item.visible_fraction or 0.0
    if found.occluded != occlusion(seen):
        yield f"object {item.id}: expected the occlusion of {seen:.2f} seen, {occlusion(seen)}, got {found.occluded}"
    if not abs(found.truncated - item.truncation) <= TRUNCATION:
        yield f"object {item.id}: expected the truncation {item.truncation:.2f}, got {found.truncated:.2f}"
    looks = found.rotation_y_rad - np.arctan2(found.location_cv[0], found.location_cv[2])
    off_rad = abs((found.alpha_rad - looks + np.pi) % (2 * np.pi) - np.pi)
    if not off_rad <= ANGLE_RAD:
        yield f"object {item.id}: expected alpha as it is seen from the camera, got it {off_rad:.4f} rad off"


def _of_points(
    points: Float[np.ndarray, "n 4"] | None, calib: dict[str, np.ndarray], truth: SourceSample, problems: list[str]
) -> Iterator[Gap]:
    """How far points of the lidar are from those of the sweep, in the camera's frame."""
    ours = np.zeros((0, 3)) if truth.sweep is None else truth.sweep.points().xyz_cam
    theirs = np.zeros((0, 4)) if points is None else points
    if (truth.sweep is None) != (points is None) or len(ours) != len(theirs):
        problems.append(f"expected {len(ours)} points of the lidar, got {len(theirs)}")
    elif len(ours):
        pose = np.vstack([calib["Tr_velo_to_cam"], [0, 0, 0, 1]])
        apart_m = np.linalg.norm(transform(pose, theirs[:, :3]) - ours[:, [0, 2, 1]] * [1, -1, 1], axis=1)
        yield Gap.of("points of the lidar", "m", apart_m, "sweep")
