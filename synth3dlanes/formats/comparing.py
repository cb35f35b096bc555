"""How far the lines of an export are from our labels: in metres or pixels, line by line.

Nothing here is shared with the writers. Labels are taken upright (frame `_up`: x right in the road plane, y along the
view, z up) by the axes of their own road plane, and projected by the intrinsics that the export itself names.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from synth3dlanes.dataset.format import SCENE
from synth3dlanes.geometry.frames import transform
from synth3dlanes.geometry.polylines import all_feet, distances_between, feet_of, lengths_along
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, LaneKind
from synth3dlanes.labels.object_labels import CORNERS, ObjectLabel
from synth3dlanes.system.arrays import Matrix4, Points3, Polyline2, RgbImage

if TYPE_CHECKING:
    # Readers of a format need none of these.
    import synth3dlanes.dataset.read
    import synth3dlanes.imaging.sweep
    import synth3dlanes.scene.scene

Points = Float[np.ndarray, "_ d"]
Distances = Float[np.ndarray, " _"]
Flags = Bool[np.ndarray, " _"]

# A line must be in an export if this number of its points is surely seen: at a border, rounding decides.
SURE_POINTS = 8
BORDER_PX = 2.0
# Lines that begin farther ahead are not beside the camera.
NEAR_START_M = 20.0
LEAST_M = 0.5
# |du/dv| beyond which a step in the image counts as level.
MOST_LEVEL = 15.0
ANGLE_RAD, HEIGHT_M = 1e-6, 1e-6
ROUNDING = 1e-3
# Where cameras are compared: shares of the image, and depths.
SHARES, DEPTHS_M = (0.1, 0.5, 0.9), (5.0, 50.0)
BOX_M = 0.001
FLU_CORNERS = CORNERS[:, [1, 0, 2]] * [1, -1, 1]
"""Corners of a box of size 2 with x forward and y left, in the order of CORNERS."""


class SourceSample:
    """The sample of the data set that a frame of an export was made from."""

    def __init__(self, reader: "synth3dlanes.dataset.read.Reader", place: int) -> None:
        self.reader, self.place = reader, place

    @cached_property
    def labels(self) -> Labels:
        return self.reader.labels(self.place)

    @property
    def has_scene(self) -> bool:
        """Whether it was drawn: a sample that was lifted from a real drive has no scene."""
        from synth3dlanes.dataset.description import is_lifted

        return not is_lifted(self.reader.description)

    @cached_property
    def scene(self) -> "synth3dlanes.scene.scene.Scene":
        from synth3dlanes.scene import scene as scene_format

        where = f"{self.reader.url}:{self.reader.key(self.place)}"
        return scene_format.from_json(self.reader.member(self.place, SCENE), where)

    @cached_property
    def kerbs(self) -> tuple[Lane, ...]:
        """The kerbs that its camera sees, if it has a scene."""
        from synth3dlanes.formats.conditions import kerb_lanes

        return kerb_lanes(self.scene, self.labels.camera) if self.has_scene else ()

    @cached_property
    def image(self) -> RgbImage:
        return self.reader.image(self.place)

    @cached_property
    def passes(self) -> dict[str, Shaped[np.ndarray, "..."]]:
        return self.reader.passes(self.place)

    @cached_property
    def sweep(self) -> "synth3dlanes.imaging.sweep.Sweep | None":
        """The sweep of its lidar, if it has one."""
        return self.reader.lidar(self.place) if self.reader.has_lidar else None

    @cached_property
    def moment(self) -> "list[SourceSample]":
        """The pictures by all cameras of the rig at its scene and frame, this one among them."""
        return [self if i == self.place else SourceSample(self.reader, i) for i in self.reader.rig(self.place)]

    def lanes(self, kind: LaneKind) -> "list[UprightLane]":
        """The lanes of a kind, upright."""
        return self.upright(lane for lane in self.labels.lanes if lane.kind == kind)

    def upright(self, lanes: Iterable[Lane]) -> "list[UprightLane]":
        """Lanes of its labels, or its kerbs, upright."""
        camera = self.labels.camera
        return [UprightLane(camera, of.id, upright(camera, of.xyz_cam), of.terrain_visible) for of in lanes]


@dataclass(frozen=True, eq=False)
class UprightLane:
    """A lane of the labels, from near to far, as the camera would have it without roll; where the ground does not hide
    it."""

    camera: CameraLabel
    id: str
    points_up: Float[np.ndarray, "n 3"]
    on_ground: Flags

    @property
    def ahead(self) -> slice:
        """Its points ahead of the camera, up to where it comes back: seen from the camera or along the road."""
        pitch = np.arcsin(-self.camera.road_from_cam[2, 1])
        along = self.points_up[:, 1:] @ np.array([[1.0, np.cos(pitch)], [0.0, np.sin(pitch)]])
        in_front = np.flatnonzero((along > LEAST_M).all(axis=1))
        if not len(in_front):
            return slice(0, 0)
        start = int(in_front[0])
        back = np.flatnonzero((np.diff(along[start:], axis=0) <= 0).any(axis=1))
        return slice(start, start + int(back[0]) + 1 if len(back) else len(along))

    def sure(self, view: "ExportView") -> Flags:
        """Which of its points are sure to be in the image and on ground that is seen, one after the other."""
        uv = pixels(view.img_from_cv, self.points_up[self.ahead])
        sure = np.zeros(len(self.points_up), dtype=bool)
        if len(uv) >= 2:
            du, dv = np.diff(uv, axis=0).T
            is_rising = (dv < 0) & (np.abs(du) < 0.9 * MOST_LEVEL * -dv)
            rises = np.logical_and.accumulate(np.concatenate([is_rising[:1], is_rising]))
            inside = ((uv > BORDER_PX) & (uv < np.array(view.size_px) - BORDER_PX)).all(axis=1)
            sure[self.ahead] = inside & rises & self.on_ground[self.ahead]
        return sure

    def in_metres(self, view: "ExportView") -> "OurLine":
        return OurLine(self.id, self.points_up, self.points_up[self.sure(view)])

    def at_rows(self, view: "ExportView", rows_px: Sequence[int] | Int[np.ndarray, " _"]) -> "OurLine":
        """The line in the image; it must be found at the rows, from the bottom up, that it is sure to cross."""
        uv, sure = pixels(view.img_from_cv, self.points_up), np.flatnonzero(self.sure(view))
        rows = np.sort(rows_px)[::-1]
        wanted = np.zeros((0, 2))
        if len(sure) >= 2:
            u, v = uv[sure[0] : sure[-1] + 1][::-1].T
            wanted = np.column_stack([np.interp(rows, v, u, left=np.nan, right=np.nan), rows])
            with np.errstate(invalid="ignore"):
                wanted = wanted[(wanted[:, 0] > BORDER_PX) & (wanted[:, 0] < view.size_px[0] - BORDER_PX)]
        return OurLine(self.id, uv[~np.isnan(uv[:, 0])], wanted)


@dataclass(frozen=True, eq=False)
class ExportView:
    """An upright pinhole camera, as an export says: its matrix K and the size of its image."""

    img_from_cv: Float[np.ndarray, "3 _"]
    size_px: tuple[int, int]

    @classmethod
    def around(cls, img_from_cv: Float[np.ndarray, "3 _"]) -> "ExportView":
        """The view of an image whose principal point is in its middle."""
        return cls(img_from_cv, (round(2 * img_from_cv[0, 2]), round(2 * img_from_cv[1, 2])))


@dataclass(frozen=True, eq=False)
class FoundLines:
    """The lines of a frame as an export has them, in metres in the frame of its upright camera or in pixels, and what
    it says of that camera; with the ids of our lanes, if it has these."""

    points: Sequence[Points]
    view: ExportView
    ids: Sequence[str] | None = None
    height_m: float | None = None
    pitch_rad: float | None = None


@dataclass(frozen=True, eq=False)
class OurLine:
    """A line of the labels where it is compared, and which points an export of it must have."""

    id: str
    points: Points
    wanted: Points


@dataclass(frozen=True)
class Gap:
    """How far a thing of an export is from ours: a line, or what `word` says. What has several gaps counts once."""

    name: str
    unit: str
    worst: float
    median: float
    word: str = "line"

    @classmethod
    def of(cls, name: str, unit: str, apart: Float[np.ndarray, " _"], word: str = "line") -> "Gap":
        """The gap of these distances."""
        return cls(name, unit, float(apart.max()), float(np.median(apart)), word)


@dataclass(frozen=True)
class Comparison:
    """A frame compared with our labels: how far its things are, and what is wrong. `tracks` are the lanes by the ids
    that must name one lane only in all frames. Of things by their words, `strange` counts those that the labels do not
    have, `outside` those that were not compared because the labels do not reach them."""

    gaps: tuple[Gap, ...] = ()
    problems: tuple[str, ...] = ()
    tracks: Mapping[str, str] = field(default_factory=dict)
    strange: Counter[str] = field(default_factory=Counter)
    outside: Counter[str] = field(default_factory=Counter)

    def __add__(self, other: "Comparison") -> "Comparison":
        return Comparison(
            self.gaps + other.gaps,
            self.problems + other.problems,
            {**self.tracks, **other.tracks},
            self.strange + other.strange,
            self.outside + other.outside,
        )

    @classmethod
    def within(cls, gaps: Sequence[Gap], limits: Mapping[str, float]) -> "Comparison":
        """The comparison with these gaps, none of which may be beyond the limit of its unit."""
        off = (gap for gap in gaps if not gap.worst <= limits[gap.unit])
        problems = (f"{gap.name}: expected it as in the labels, got it {gap.worst:.3g} {gap.unit} off" for gap in off)
        return cls(tuple(gaps), tuple(problems))

    def because(self, problems: Iterable[str]) -> "Comparison":
        return self + Comparison(problems=tuple(problems))


@dataclass(frozen=True)
class Rule:
    """How lines of an export are compared: the unit, how far they may be; whether their points run from near to far (1)
    or from far to near (-1); the most lines that a frame may have; what one is called. `spacing` is how far the nearest
    point may be from one that is wanted: 0 where the points are ours. `slack` is how much farther points may be between
    those of the labels, and in maps heights: where ramps begin, a straight metre is that far from the road."""

    unit: str
    limit: float
    direction: int = 1
    most: float = np.inf
    name: str = "line"
    spacing: float = 0.0
    slack: float = 0.0


def compare(
    found: Sequence[Points], ours: Sequence[OurLine], rule: Rule, ids: Sequence[str] | None = None
) -> tuple[Comparison, list[str]]:
    """Compare each line of a frame with the nearest of ours, or with ours of its id, and report ours without one;
    return this and the ids of our nearest lines."""
    gaps, problems, lanes, n_strange = list[Gap](), list[str](), list[str](), 0
    if ids is not None and len(ids) != len(found):
        problems.append(f"expected {len(ids)} {rule.name}s as its ids say, got {len(found)}")
        ids = None
    by_id = {line.id: line for line in ours}
    for i, points in enumerate(found):
        line = nearest(points, ours, rule) if ids is None else by_id.get(ids[i])
        if line is None:
            problems.append(f"{rule.name} {i}: expected a line of the labels, got none of this kind")
            n_strange += 1
            continue
        gap = _gap(points, line, rule)
        gaps.append(gap)
        lanes.append(line.id)
        if not gap.worst <= rule.limit:
            problems.append(f"{rule.name} {i}: {_too_far(points, gap, ours, rule)}")
        problems += (f"{rule.name} {i} ({line.id}): {text}" for text in _order_problems(points, line, rule))
    twice = {lane for lane in lanes if lanes.count(lane) > 1}
    problems += (f"{rule.name}s: expected one of {lane}, got {lanes.count(lane)}" for lane in sorted(twice))
    if len(found) < rule.most:
        problems += (
            f"{rule.name} of {line.id}: expected one, got none nearer than {apart:.3g} {rule.unit}"
            for line in ours
            if line.id not in lanes and len(line.wanted) >= SURE_POINTS
            if (apart := _apart(found, line)) > MISSING[rule.unit]
        )
    return Comparison(tuple(gaps), tuple(problems), strange=Counter({rule.name: n_strange})), lanes


def compare_lines(
    found: FoundLines,
    truth: SourceSample,
    rule: Rule,
    lanes: Sequence[UprightLane] | None = None,
    rows_px: Sequence[int] | Int[np.ndarray, " _"] = (),
) -> tuple[Comparison, list[str]]:
    """Lines, in metres or at rows of the image by the rule's unit, beside these lanes (by default all delimiters), and
    the camera beside that of the labels; and the ids of the lanes that the lines are."""
    lanes = truth.lanes("delimiter") if lanes is None else lanes
    in_image = rule.unit == "px"
    ours = [lane.at_rows(found.view, rows_px) if in_image else lane.in_metres(found.view) for lane in lanes]
    compared, ids = compare(found.points, ours, rule, found.ids)
    return compared.because(camera_problems(truth, found.height_m, found.pitch_rad)), ids


MISSING = {"m": 0.1, "px": 4.0}
"""Lines whose visible parts coincide are exported once: what is this near to another line is not missing."""


def nearest(points: Points, ours: Sequence[OurLine], rule: Rule) -> OurLine | None:
    """The line that is nearest to all of these points; of lines about as near, the one with the smallest gap."""
    if not ours or not len(points):
        return None
    some = points[np.unique(np.linspace(0, len(points) - 1, 9).astype(int))]
    rough = [distances(some, line.points).max() for line in ours]
    close = [line for line, apart in zip(ours, rough, strict=True) if apart <= min(rough) + 0.1]
    return min(close, key=lambda line: _gap(points, line, rule).worst) if len(close) > 1 else close[0]


def distances(points: Points, line: Points) -> Distances:
    """How far points are from a polyline."""
    return feet_of(points, line)[0]


def stations(points: Points, line: Points) -> Distances:
    """Where along a polyline the nearest places to points are, by its length."""
    (_, at, share), along = feet_of(points, line), lengths_along(line)
    return np.asarray(along[at] + share * np.diff(along, append=along[-1])[at])


def is_beside(points: Points, line: Points) -> Flags:
    """Which points are beside a polyline from above, not before its beginning or behind its end."""
    _, at, share = feet_of(points[:, :2], line[:, :2])
    return np.asarray((at + share > 0) & (at + share < len(line) - 1))


def upright(camera: CameraLabel, points_cam: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Points as a camera at the same place has them that does not roll."""
    up_cam, view_cam = camera.road_from_cam[2, :3], np.array([0.0, 1.0, 0.0])
    right_cam = np.cross(view_cam, up_cam)
    right_cam /= np.linalg.norm(right_cam)
    return points_cam @ np.stack([right_cam, view_cam, np.cross(right_cam, view_cam)]).T


def pixels(img_from_cv: Float[np.ndarray, "3 _"], points_up: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Where an upright pinhole of this matrix K sees points; NaN for those that are not ahead."""
    right, ahead, up = points_up.T
    ahead = np.where(ahead > LEAST_M / 2, ahead, np.nan)
    (fx, _, cx, *_), (_, fy, cy, *_), _ = img_from_cv
    return np.column_stack([cx + fx * right / ahead, cy - fy * up / ahead])


def places_beside(lanes: Sequence[UprightLane], most_ahead_m: float) -> dict[str, int]:
    """1 to 4 for the two nearest lines on either side of the camera, from left to right, of those that begin beside
    it."""
    starts = dict[str, float]()
    for lane in lanes:
        ahead_up = lane.points_up[lane.ahead]
        if len(ahead_up) >= 2 and ahead_up[0, 1] <= most_ahead_m:
            starts[lane.id] = float(ahead_up[0, 0])
    left = sorted((name for name in starts if starts[name] < 0), key=lambda name: -starts[name])[:2]
    right = sorted((name for name in starts if starts[name] >= 0), key=lambda name: starts[name])[:2]
    return dict(zip((*left, *right), (2, 1)[: len(left)] + (3, 4)[: len(right)], strict=True))


def camera_problems(truth: SourceSample, height_m: float | None, pitch_rad: float | None) -> Iterator[str]:
    """Findings where an export has another height or pitch of the camera than the labels."""
    pose = truth.labels.camera.road_from_cam
    for name, got, expected, limit in (
        ("height", height_m, pose[2, 3], HEIGHT_M),
        ("pitch", pitch_rad, np.arcsin(-pose[2, 1]), ANGLE_RAD),
    ):
        if got is not None and not abs(got - expected) <= limit:
            yield f"camera: expected a {name} of {expected:.6f} as in the labels, got {got:.6f}"


def _gap(points: Points, line: OurLine, rule: Rule) -> Gap:
    there, back = distances(points, line.points), np.zeros(0)
    if len(line.wanted):
        back = distances_between(line.wanted, points).min(axis=1) - rule.spacing
    worst = max(there.max() - rule.slack, back.max(initial=0.0))
    median = float(np.median(np.maximum(there - rule.slack, 0)))
    return Gap(line.id, rule.unit, float(worst), median, rule.name)


def _too_far(points: Points, gap: Gap, ours: Sequence[OurLine], rule: Rule) -> str:
    other = nearest(points, ours, rule)
    there = "" if other is None or other.id == gap.name or _gap(points, other, rule).worst > rule.limit else other.id
    return too_far(gap, rule) + (f" (it lies on {there})" if there else "")


def too_far(gap: Gap, rule: Rule) -> str:
    """What is wrong with a line that is beyond the limit."""
    unit = rule.unit
    return f"expected {gap.name} within {rule.limit:g} {unit} of the labels, got it {gap.worst:.3g} {unit} away"


def _apart(found: Sequence[Points], line: OurLine) -> float:
    return min((float(distances(line.wanted, points).max()) for points in found), default=np.inf)


def _order_problems(points: Points, line: OurLine, rule: Rule) -> Iterator[str]:
    limit = max(rule.limit, ROUNDING)
    back = back_along(points[:: rule.direction], line.points, limit)
    if back > limit:
        order = "near to far" if rule.direction > 0 else "far to near"
        yield f"expected points from {order}, got {back:.3g} {rule.unit} back"


def back_along(points: Points, line: Points, slack: float) -> float:
    """How far points that should follow a line go back on it. A line may pass a place twice, in an image or around a
    roundabout: of the places that are nearest to a point, but for `slack`, the first that goes on is taken."""
    apart, share = all_feet(points, line)
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(lengths)])[: share.shape[1]] + share * (lengths if len(lengths) else 0.0)
    reached, back = -np.inf, 0.0
    for places in (row[off <= off.min() + slack] for row, off in zip(at, apart, strict=True)):
        ahead = places[places >= reached - ROUNDING]
        back = max(back, 0.0 if len(ahead) else float(reached - places.max()))
        reached = max(reached, float(ahead.min())) if len(ahead) else reached
    return back


FROM_MIDDLE = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
"""What a matrix K of pixels that count from the middle of the first one lacks to those that count from its corner."""


def compare_camera(
    name: str,
    camera: CameraLabel,
    project: Callable[[Points3], Polyline2],
    limit_px: float,
    shares: Sequence[float] = SHARES,
    size_px: tuple[int, int] | None = None,
) -> Comparison:
    """How far places that a camera of the labels sees, at these shares of its width and height, are from its pixels by
    the camera of an export. `project` takes points in our camera frame; pixels count from the corner of the first. Its
    images must be of `size_px`, if that is given."""
    own_px = camera.width_px, camera.height_px
    if size_px not in (None, own_px):
        own, got = (f"{width}x{height}" for width, height in (own_px, size_px or own_px))
        return Comparison(problems=(f"camera {name}: expected a size of {own}, got {got}",))
    grid = np.array([(u, v, depth_m) for u in shares for v in shares for depth_m in DEPTHS_M])
    uv = grid[:, :2] * own_px
    points_cam = camera.points(uv, grid[:, 2])
    known = np.isfinite(points_cam).all(axis=1)
    apart = np.linalg.norm(project(points_cam[known]) - uv[known], axis=1)
    return Comparison.within([Gap.of(f"camera {name}", "px", apart, "camera")], {"px": limit_px})


def compare_pinhole(
    name: str,
    camera: CameraLabel,
    img_from_cv: Float[np.ndarray, "3 3"],
    cv_from_cam: Matrix4,
    limit_px: float,
    size_px: tuple[int, int] | None = None,
) -> Comparison:
    """`compare_camera` for a pinhole of this matrix K and place; places behind it are infinitely far."""

    def project(points_cam: Points3) -> Polyline2:
        x, y, z = img_from_cv @ transform(cv_from_cam, points_cam).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where((z > 0)[:, None], np.column_stack([x / z, y / z]), np.inf)

    return compare_camera(name, camera, project, limit_px, size_px=size_px)


def compare_sweep(found_cam: Points | None, truth: SourceSample, limit_m: float) -> Comparison:
    """Points of the lidar, in our camera frame, beside those of the sweep; None for an export that has no file of
    them."""
    ours = np.zeros((0, 3)) if truth.sweep is None else truth.sweep.points().xyz_cam
    found = np.zeros((0, 3)) if found_cam is None else found_cam
    if (found_cam is None and truth.sweep is not None) or len(found) != len(ours):
        return Comparison(problems=(f"expected {len(ours)} points of the lidar, got {len(found)}",))
    if not len(ours):
        return Comparison()
    apart = np.linalg.norm(found - ours, axis=1)
    return Comparison.within([Gap.of("points of the lidar", "m", apart, "sweep")], {"m": limit_m})


class FoundBox(NamedTuple):
    """A box: its track, its pose (x forward, y left, z up), length, width and height, and what else is told of it."""

    track: str
    pose: Matrix4
    size_m: Float[np.ndarray, "3"]
    told: Mapping[str, object]


def compare_boxes(
    found: Iterable[FoundBox],
    items: Sequence[ObjectLabel],
    expected: Callable[[ObjectLabel], Mapping[str, object]],
    cam_from_b: Matrix4,
    of: str,
    words: tuple[str, str] = ("object", "box"),
) -> Comparison:
    """Boxes in a frame, each beside the nearest of our objects that is left, of which as much is expected as is told.
    `of` says where tracks name one object; `words` are what one of ours and one of theirs is called."""
    gaps, problems, tracks, left = list[Gap](), list[str](), dict[str, str](), {item.id: item for item in items}
    for box in found:
        if not left:
            problems.append(f"{words[0]} {box.track}: expected one of the labels, got none left")
            continue
        corners = transform(cam_from_b @ box.pose, FLU_CORNERS * box.size_m / 2)
        middle = corners.mean(axis=0)
        nearest = min(left, key=lambda key: float(np.linalg.norm(left[key].center_cam - middle)))
        item, name = left.pop(nearest), f"{words[0]} {nearest}"
        gaps.append(Gap.of(name, "m", np.linalg.norm(corners - item.corners_cam, axis=1), words[1]))
        tracks[f"{words[0]} {box.track}"] = f"{name} of {of}"
        for what, wanted in expected(item).items():
            if box.told[what] != wanted:
                problems.append(f"{name}: expected the {what} {wanted}, got {box.told[what]}")
    problems += (f"expected {item.category} {item.id}, got it in no row" for item in left.values())
    return Comparison.within(gaps, {"m": BOX_M}).because(problems) + Comparison(tracks=tracks)
