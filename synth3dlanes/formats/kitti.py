"""KITTI's object detection: 3D boxes of cars, and the points of a lidar; a text file for each image.

| theirs | ours | unit, frame |
|---|---|---|
| `type` | the class of an object (TYPES); `DontCare` for what is hardly seen | |
| `truncated`, `occluded` | the share of the box outside the image, a level of what is seen | |
| `bbox` | the box of the 3D box in the image | px, from the middle of the first one |
| `dimensions` | height, width, length | m |
| `location` | the middle of the lower side | m, camera (`_cv`: x right, y down, z forward) |
| `rotation_y`, `alpha` | the heading, 0 where the front looks along x; as seen from the camera | rad |
| `P2`, `Tr_velo_to_cam` | the camera's matrix; camera from lidar, which looks along x | px, m |

A box stands upright in the camera's frame: the slope of a car against the camera's plane is lost.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.comparing import Comparison, Gap, SourceSample, compare_sweep
from synth3dlanes.formats.format import FrameList, ReadFrame, SampleFormat, SampleFrame
from synth3dlanes.formats.one_frame import FRAMES_PER_SPLIT
from synth3dlanes.formats.reading import first_lines, numbers, read_file, read_text
from synth3dlanes.formats.writing import (
    CV_FROM_CAM,
    FrameAnnotation,
    expect_objects,
    expect_pinhole,
    img_from_cv_centred,
)
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel, Labels
from synth3dlanes.labels.object_labels import CORNERS, ObjectLabel
from synth3dlanes.scene.things import classes_in
from synth3dlanes.system.errors import FormatError

LISTS = "ImageSets"
IMAGE, LABEL = "training/image_2/{}.png", "training/label_2/{}.txt"
CALIB, POINTS = "training/calib/{}.txt", "training/velodyne/{}.bin"
"""All frames are in one folder, as KITTI's own training and validation frames are."""
TYPES = classes_in("kitti")
DONT_CARE = "DontCare"
HALF_PX = 0.5
VELO_FROM_LIDAR = np.array([[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""KITTI's lidar looks along x, y is to its left; ours looks along y, x is to its right."""
SEEN_BY_LEVEL = (0.9, 0.5)
"""The least visible shares for the levels of occlusion 0 and 1; 2 is below."""
LEAST_SEEN = 0.05
"""Objects with a smaller visible share are regions that detectors need not care about."""
N_FIELDS = 15
NOT_SEEN, OUT, NO_TYPE = "hidden", "out of the image", "of a kind that KITTI has no type for"
# Names of six digits, as KITTI's tools take them, in data sets of up to ten splits of 100,000 samples.
SHORT = 100_000
# Places and sizes have four decimals, pixels two; our labels are rounded likewise.
LIMIT_M, LIMIT_PX = 0.001, 0.02
# Truncation has two decimals.
TRUNCATION, ANGLE_RAD = 0.006, 2e-4
SHAPES = {"P2": (3, 4), "R0_rect": (3, 3), "Tr_velo_to_cam": (3, 4)}
# A line is of the nearest object of its type, if that is at most this far away.
SAME_M = 2.0
# Distance from which errors in pixels count fully.
FULL_WEIGHT_M = 10.0

README = f"""KITTI's object detection layout.

- `training/image_2/*.png`, `label_2/*.txt`, `calib/*.txt`, and `velodyne/*.bin` of data sets with a lidar. All frames
  are in `training`, as KITTI's testing frames have no labels; `ImageSets/{{train,val,trainval,test}}.txt` divide them.
- Types are Car (with pickups), Van, Truck (with tractors and their semitrailers), Pedestrian, Cyclist and Misc (buses,
  motorcyclists). KITTI has no road works: cones and the like are left out. An object of which less than
  {100 * LEAST_SEEN:.0f} % is seen is a region DontCare; one that is not seen at all is left out. A frame without
  objects has one region DontCare without a size, as no label file of the original is empty and OpenPCDet fails on one.
- Occlusion is 0 if {100 * 0.9:.0f} % or more of the object's pixels are seen, 1 from 50 %, else 2. Truncation is the
  share of the 3D box that is outside the image.
- The 2D box is that of the 3D box in the image. Pixels count from the middle of the first one, so the principal point
  is half a pixel less than in the data set.
- Boxes stand upright in the camera's frame, as KITTI's format has them: place (the middle of the lower side), size and
  heading are exact, the slope of a car against the camera's plane is lost. It is the camera's pitch on a level road.
- There is one camera: P0 to P3 are alike. R0_rect is the identity, reflectance is 0. Without a lidar, Tr_velo_to_cam is
  from the camera's foot on the road.
"""


@dataclass(frozen=True, eq=False)
class KittiObject:
    """A line of `label_2`: pixels (left, top, right, bottom), metres and radians; -1, -10 and -1000 for what a region
    `DontCare` does not have."""

    type: str
    truncated: float
    occluded: int
    alpha_rad: float
    box_px: Float[np.ndarray, "4"]
    height_width_length_m: Float[np.ndarray, "3"]
    location_cv: Float[np.ndarray, "3"]
    rotation_y_rad: float

    def line(self) -> str:
        pixels = " ".join(f"{value:.2f}" for value in self.box_px)
        box = " ".join(
            f"{value:.4f}" for value in (*self.height_width_length_m, *self.location_cv, self.rotation_y_rad)
        )
        return f"{self.type} {self.truncated:.2f} {self.occluded} {self.alpha_rad:.4f} {pixels} {box}"


def dont_care(box_px: Float[np.ndarray, "4"]) -> KittiObject:
    """A region in which there is something that detectors need not find."""
    return KittiObject(DONT_CARE, -1, -1, -10, box_px, np.full(3, -1.0), np.full(3, -1000.0), -10)


NOTHING = dont_care(np.zeros(4))
"""What the label file of a frame without objects has: all files of the original have lines, and OpenPCDet fails on one
that has none. A region without a size hides no detection."""


def wrapped(angle_rad: float) -> float:
    """The same angle between -pi and pi."""
    return float((angle_rad + np.pi) % (2 * np.pi) - np.pi)


def occlusion(visible_fraction: float) -> int:
    """The level of occlusion: 0 seen, 1 partly hidden, 2 largely hidden."""
    return next((level for level, least in enumerate(SEEN_BY_LEVEL) if visible_fraction >= least), len(SEEN_BY_LEVEL))


def write(frame: SampleFrame) -> FrameAnnotation:
    labels, objects = frame.labels, expect_objects(frame)
    expect_pinhole(labels.camera, frame.where)
    name, dropped, lines = _name(frame), Counter[str](), list[str]()
    for item in objects:
        reason = _left_out(item)
        if reason:
            dropped[reason] += 1
        else:
            lines.append(kitti_object(labels.camera, item).line())
    files: dict[str, str | bytes] = {
        LABEL.format(name): "\n".join(lines or [NOTHING.line()]),
        CALIB.format(name): _calib(labels),
    }
    if frame.sweep is not None:
        xyz_velo = frame.sweep.points().xyz_lidar @ VELO_FROM_LIDAR[:3, :3].T
        files[POINTS.format(name)] = np.column_stack([xyz_velo, np.zeros(len(xyz_velo))]).astype("<f4").tobytes()
    lists: list[str] = [*frame.served]
    if {"train", "val"} & {*lists}:
        lists.append("trainval")
    shared = ((name, tuple(f"{LISTS}/{part}.txt" for part in lists)),)
    return FrameAnnotation(IMAGE.format(name), len(lines), dropped, files, shared)


def _left_out(item: ObjectLabel) -> str:
    """Why an object has no line; "" for one that has."""
    if item.category not in TYPES:
        return NO_TYPE
    return OUT if item.box_px is None else NOT_SEEN if item.seen_box_px is None else ""


def kitti_object(camera: CameraLabel, item: ObjectLabel) -> KittiObject:
    """An object of which something is in the image and seen."""
    assert item.box_px is not None
    size_px = np.array([camera.width_px, camera.height_px])
    box_px = np.clip(item.box_px - HALF_PX, 0, np.tile(size_px - 1, 2))
    seen = item.visible_fraction or 0.0
    if seen < LEAST_SEEN:
        return dont_care(box_px)
    width_m, length_m, height_m = item.size_m
    pose = item.cam_from_object
    location_cv = CV_FROM_CAM @ (pose[:3, 3] - pose[:3, 2] * height_m / 2)
    ahead_x, _, ahead_z = CV_FROM_CAM @ pose[:3, 1]
    rotation_y_rad = float(np.arctan2(-ahead_z, ahead_x))
    alpha_rad = wrapped(rotation_y_rad - float(np.arctan2(location_cv[0], location_cv[2])))
    size_m, truncation = np.array([height_m, width_m, length_m]), item.truncation or 0.0
    return KittiObject(
        TYPES[item.category], truncation, occlusion(seen), alpha_rad, box_px, size_m, location_cv, rotation_y_rad
    )


def _name(frame: SampleFrame) -> str:
    split, key = divmod(frame.number, FRAMES_PER_SPLIT)
    return f"{split * SHORT + key:06d}" if key < SHORT and split < 10 else f"{frame.number:09d}"


def _calib(labels: Labels) -> str:
    """The text of a calibration: matrices row by row."""
    camera = labels.camera
    cam_from_velo = (invert(camera.road_from_cam) if labels.lidar is None else labels.lidar.cam_from_lidar) @ invert(
        VELO_FROM_LIDAR
    )
    cv_from_velo = CV_FROM_CAM @ cam_from_velo[:3]
    projection = np.column_stack([img_from_cv_centred(camera), np.zeros(3)])
    matrices = {**{f"P{i}": projection for i in range(4)}, "R0_rect": np.eye(3)}
    matrices |= {"Tr_velo_to_cam": cv_from_velo, "Tr_imu_to_velo": np.eye(4)[:3]}
    rows = {name: " ".join(f"{value:.12e}" for value in (matrix + 0.0).ravel()) for name, matrix in matrices.items()}
    return "\n".join(f"{name}: {row}" for name, row in rows.items())


Content = tuple[list[KittiObject], dict[str, Float[np.ndarray, "r c"]], Float[np.ndarray, "n 4"] | None]


def parse_line(text: str, where: str) -> KittiObject:
    """A line of `label_2`; raise FormatError for another."""
    words = text.split()
    try:
        values = [float(word) for word in words[1:]]
    except ValueError:
        values = []
    if len(words) != N_FIELDS or len(values) != N_FIELDS - 1 or not np.isfinite(values).all():
        raise FormatError(f"{where}: expected a type and {N_FIELDS - 1} numbers, got {text[:60]!r}")
    box, size, place = np.array(values[3:7]), np.array(values[7:10]), np.array(values[10:13])
    return KittiObject(words[0], values[0], int(values[1]), values[2], box, size, place, values[13])


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    for path in sorted((out / LISTS).glob("*.txt")):
        yield FrameList(path.stem, (_frame(out, name) for name in first_lines(path, most_frames)))


def _frame(out: Path, name: str) -> ReadFrame:
    if not name.isdecimal():
        raise FormatError(f"{out / LISTS}: expected names of frames, which are numbers, got {name[:60]!r}")
    where, image = str(out / LABEL.format(name)), IMAGE.format(name)
    lines = [line for line in read_text(Path(where)).splitlines() if line.strip()]
    objects = [parse_line(line, f"{where}:{number}") for number, line in enumerate(lines, start=1)]
    points = out / POINTS.format(name)
    content = objects, _matrices(out / CALIB.format(name)), _points(points) if points.exists() else None
    return ReadFrame(image, where, image, content)


def _matrices(path: Path) -> dict[str, Float[np.ndarray, "r c"]]:
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
    wanted = [item for item in items if not _left_out(item)]
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
    cv_from_velo = np.vstack([calib["Tr_velo_to_cam"], [0, 0, 0, 1]])
    found_cam = None if points is None else transform(cv_from_velo, points[:, :3]) @ CV_FROM_CAM
    return (
        Comparison.within(gaps, {"m": LIMIT_M, "px": LIMIT_PX})
        + Comparison((), tuple(problems), strange=strange)
        + compare_sweep(found_cam, truth, LIMIT_M)
    )


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
    return np.clip(item.box_px - HALF_PX, 0, sides - 1)


def _gaps(found: KittiObject, item: ObjectLabel, calib: dict[str, np.ndarray], truth: SourceSample) -> Iterator[Gap]:
    """Distances of corners in space, but for the slope that the format does not have; and of the foot in the image."""
    foot_cv, (width_m, length_m, height_m) = _foot_cv(item), item.size_m
    ahead_x, ahead_y, _ = item.corners_cam[:4].mean(axis=0) - item.corners_cam[4:].mean(axis=0)
    ours = _corners_cv(foot_cv, np.array([height_m, width_m, length_m]), float(np.arctan2(-ahead_y, ahead_x)))
    theirs = _corners_cv(found.location_cv, found.height_width_length_m, found.rotation_y_rad)
    yield Gap.of(f"object {item.id}", "m", np.linalg.norm(theirs - ours, axis=1), "object")
    foot = calib["R0_rect"] @ found.location_cv
    u, v, w = calib["P2"] @ [*foot, 1.0]
    expected = truth.labels.camera.project(np.array([foot_cv[0], foot_cv[2], -foot_cv[1]])) - 0.5
    if np.isfinite(expected).all() and foot_cv[2] > 1.0:
        off_px = np.abs([u / w, v / w] - expected) * min(1.0, foot_cv[2] / FULL_WEIGHT_M)
        yield Gap.of(f"object {item.id}", "px", off_px, "object")


def _corners_cv(
    location_cv: Float[np.ndarray, "3"], height_width_length_m: Float[np.ndarray, "3"], rotation_y_rad: float
) -> Float[np.ndarray, "8 3"]:
    height_m, width_m, length_m = height_width_length_m
    right, ahead, up = (CORNERS / 2).T
    own = np.column_stack([ahead * length_m, -(up + 0.5) * height_m, -right * width_m])
    c, s = np.cos(rotation_y_rad), np.sin(rotation_y_rad)
    return own @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + location_cv


def _problems(found: KittiObject, item: ObjectLabel) -> Iterator[str]:
    seen, truncation = item.visible_fraction or 0.0, item.truncation or 0.0
    if found.occluded != occlusion(seen):
        yield f"object {item.id}: expected the occlusion of {seen:.2f} seen, {occlusion(seen)}, got {found.occluded}"
    if not abs(found.truncated - truncation) <= TRUNCATION:
        yield f"object {item.id}: expected the truncation {truncation:.2f}, got {found.truncated:.2f}"
    looks = found.rotation_y_rad - np.arctan2(found.location_cv[0], found.location_cv[2])
    off_rad = abs(wrapped(found.alpha_rad - float(looks)))
    if not off_rad <= ANGLE_RAD:
        yield f"object {item.id}: expected alpha as it is seen from the camera, got it {off_rad:.4f} rad off"


FORMAT = SampleFormat(
    title="KITTI: 3D boxes of cars, people and riders, with the points of a lidar",
    readme=README,
    write=write,
    read=read,
    verify=verify,
    tolerances={"m": LIMIT_M, "px": LIMIT_PX},
    lists=tuple(f"ImageSets/{part}.txt" for part in ("train", "val", "trainval", "test")),
    takes_sweeps=True,
    counted="objects",
)
