"""Check the boxes of labels against what depth, ids and the sweep show: those of objects here, of traffic elements in
`traffic_elements`.

Points of what is labelled must be in its box, and reach the sides that are seen. A box that is too small, turned or
moved is found by points outside it, one that is too large by the gap before a side. `car_visible_fraction` is
the share of the pixels that a car would fill, were it alone, in which it is seen: its box in the image bounds these.
Objects move from picture to picture of a scene as the velocities of their labels say: there, labels alone are compared.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.labels.object_labels import ObjectLabel, rectangle_around
from synth3dlanes.scene.instance_ids import END, thing_of
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.arrays import Matrix4
from synth3dlanes.validate.bodies import corners_world, covers, outline
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import PROOF_M, Finding, Instant, MovingObject, Result, counted, judged
from synth3dlanes.world.objects import PlacedObject

# How far outside a box points may be, and how many of them farther.
ROOM_M, MAX_SINGLE = 0.02, 2
# Sides are judged only of what is seen as a whole.
MIN_SEEN = 0.99
# Share of an object's points that may be outside its box: built-in models reach at most 2 cm beyond theirs.
MAX_OUTSIDE = 0.002
# How far before a side of a box its points may end, and which part of what lies between two pixels, or between two
# beams, of which one may return nothing.
MAX_GAP_M, MAX_PART = 0.035, {"pixels": 0.75, "points": 2.0}
# Objects with fewer points are not judged.
MIN_POINTS = 150
# The eye is this far beyond a side that it sees. Of the others pixels show the outline, which is as wide and as high.
BEYOND_M, ACROSS, ALONG, UP = 0.5, 0, 1, 2
# The lowest, highest and widest parts are this share of half the length behind the nearer end, at most. Wheels are at
# least WHEELS_M behind: they are hidden as a whole by an end that is CLEARANCE_M over the ground, or higher.
SET_BACK, WHEELS_M, CLEARANCE_M = 0.25, 1.1, 0.15
# The most that mirrors reach beyond a body.
MIRROR_M = 0.07


class SeenPart(NamedTuple):
    """Points of what is labelled in its frame, the eye in it, and how far points are from each other at most."""

    source: str
    points: Float[np.ndarray, "n 3"]
    eye: Float[np.ndarray, "3"]
    apart_m: float


class SideLimit(NamedTuple):
    """A side of a box: its axis, its sign on that, its name, and how far before it points may end."""

    axis: int
    sign: int
    name: str
    most_m: float


def check_boxes(evidence: Evidence) -> Iterator[Result]:
    """Findings about objects that are not where pixels and points show them."""
    wheels_m = _wheels_m(evidence.scene) if evidence.labels.objects else []
    for item in evidence.labels.objects or ():
        label = f"objects.{item.id}"
        if "instance" in evidence.has:
            yield from check_seen_box(evidence, item, label)
        n = None if evidence.returns is None else int((evidence.returns.instance == item.id).sum())
        if item.lidar_points != n:
            expected, got = ("none" if count is None else count for count in (n, item.lidar_points))
            yield Finding("", f"{label}.lidar_points: expected {expected} by the sweep, got {got}")
        for seen in views_of(evidence, item):
            series, number = thing_of(item.id)
            is_known = series == "car" and number < len(wheels_m)
            yield from judge(item, seen, wheels_m[number] if is_known else WHEELS_M)


def _wheels_m(scene: Scene) -> list[float]:
    """How far behind the ends of each car its wheels are, at least WHEELS_M."""
    models = [(scene.assets.car_models[car.model - 1], car.scale) for car in scene.cars]
    return [
        max(WHEELS_M, scale * ((model.length_m - model.wheelbase_m) / 2 - model.wheel_radius_m))
        for model, scale in models
    ]


def check_seen_box(evidence: Evidence, item: ObjectLabel, label: str) -> Iterator[Finding]:
    """A finding if the rectangle of the pixels with the id of what is labelled is another one."""
    there = rectangle_around(*np.nonzero(evidence.passes["instance"] == item.id))
    expected, got = (None if box is None else box.tolist() for box in (there, item.seen_box_px))
    if expected != got:
        yield Finding("", f"{label}.seen_box_px: expected {expected} by its pixels, got {got}")


def by_pixels(evidence: Evidence, id_: int, cam_from_box: Matrix4, least: int) -> SeenPart | None:
    """What pixels show of what is labelled, if it is near the camera and has at least the least number of pixels."""
    if not {"depth", "instance"} <= evidence.has or np.linalg.norm(cam_from_box[:3, 3]) > PROOF_M:
        return None
    at = evidence.passes["instance"] == id_
    rows, columns = np.nonzero(at & evidence.has_points)
    if len(rows) < least:
        return None
    points_cam, box_from_cam = evidence.points_cam(rows, columns), invert(cam_from_box)
    apart_m = float(points_cam[:, 1].max()) / evidence.camera.img_from_cam[0, 0]
    return SeenPart("pixels", transform(box_from_cam, points_cam), box_from_cam[:3, 3], apart_m)


def against_box(
    label: str, bound: str, half: Float[np.ndarray, "3"], seen: SeenPart, share: float, sides: Iterable[SideLimit]
) -> Iterator[Result]:
    """Findings if more than a share of the points is outside a box; else where they end before one of these sides."""
    beyond_m = np.abs(seen.points) - half
    outside = (beyond_m > ROOM_M).any(axis=1)
    reason = (
        f"{label}: expected its {seen.source} in its box, got {{wrong}} of {{n}} up to {beyond_m.max():.2f} m outside"
    )
    yield from counted(f"{bound}.outside_{seen.source}", outside, reason, MAX_SINGLE, share)
    if outside.sum() > max(MAX_SINGLE, share * len(outside)):
        return
    for axis, sign, side, most_m in sides:
        gap_m = float(half[axis] - (sign * seen.points[:, axis]).max())
        reason = f"expected its {seen.source} to reach the {side} side of its box, got them {gap_m:.2f} m before it"
        yield from judged(f"{bound}.gap_{seen.source}_{side}", gap_m, f"{label}: {reason}", most=most_m)


def views_of(evidence: Evidence, item: ObjectLabel) -> list[SeenPart]:
    """What pixels and points there are of an object near the camera, if enough."""
    pixels = by_pixels(evidence, item.id, item.cam_from_object, MIN_POINTS)
    views, points = [] if pixels is None else [pixels], evidence.returns
    distance_m = float(np.linalg.norm(item.center_cam))
    if evidence.sweep is not None and points is not None and distance_m <= PROOF_M:
        own = points.instance == item.id
        if own.sum() >= MIN_POINTS:
            lidar, object_from_cam = evidence.sweep.lidar, invert(item.cam_from_object)
            eye = transform(object_from_cam, lidar.cam_from_lidar[:3, 3])
            points_object = transform(object_from_cam, points.xyz_cam[own])
            corners_cam = transform(item.cam_from_object, item.size_m * (np.array([*np.ndindex(2, 2, 2)]) - 0.5))
            corners_lidar = transform(invert(lidar.cam_from_lidar), corners_cam)
            apart_m = distance_m * _step_rad(lidar.elevations_rad, points.xyz_lidar[own], corners_lidar)
            views.append(SeenPart("points", points_object, eye, apart_m))
    return views


def _step_rad(
    elevations_rad: Sequence[float], xyz_lidar: Float[np.ndarray, "n 3"], corners_lidar: Float[np.ndarray, "8 3"]
) -> float:
    """The largest angle between two neighbouring beams, of those that meet points and one on either side; infinite
    where a part of the body is over all beams."""
    beams = np.sort(elevations_rad)
    up_rad, top_rad = (np.arctan2(at[:, 2], np.hypot(*at[:, :2].T)) for at in (xyz_lidar, corners_lidar))
    first, last = np.searchsorted(beams, [up_rad.min(), up_rad.max()])
    return np.inf if top_rad.max() > beams[-1] else float(np.diff(beams[max(first - 1, 0) : last + 2]).max(initial=0.0))


def judge(item: ObjectLabel, seen: SeenPart, wheels_m: float = WHEELS_M) -> Iterator[Result]:
    """Findings where points of an object, whose wheels are `wheels_m` behind its ends, are outside its box, or end
    before a side that is seen."""
    half, is_whole = item.size_m / 2, item.truncation == 0 and (item.visible_fraction or 0.0) >= MIN_SEEN
    # The box of a person is around all steps, and the ends of a bicycle are thin.
    sides = _sides(half, seen, wheels_m) if is_whole and thing_of(item.id)[0] == "car" else ()
    yield from against_box(f"objects.{item.id}", "boxes", half, seen, MAX_OUTSIDE, sides)


def _sides(half: Float[np.ndarray, "3"], seen: SeenPart, wheels_m: float) -> Iterator[SideLimit]:
    """The sides that are seen."""
    for axis, name in enumerate(("left right", "rear front", "lower upper")):
        for sign, side in zip((-1, 1), name.split(), strict=True):
            has_outline = seen.source == "pixels" and axis != ALONG
            if has_outline or sign * seen.eye[axis] > half[axis] + BEYOND_M:
                hidden_m = _hidden_m(half, seen.eye, (axis, sign), wheels_m) if has_outline else 0.0
                yield SideLimit(axis, sign, side, MAX_GAP_M + MAX_PART[seen.source] * seen.apart_m + hidden_m)


def _hidden_m(
    half: Float[np.ndarray, "3"], eye: Float[np.ndarray, "3"], side: tuple[int, int], wheels_m: float
) -> float:
    """How far before a side what is set back from an object's nearer end may be hidden by this end: wheels under a
    bumper from an eye above it, what stands on a roof from one below it, mirrors, the far side of a body that grows
    wider."""
    axis, sign = side
    away_m, aside_m = max(abs(float(eye[ALONG])) - half[ALONG], 0.0), half[axis] - sign * eye[axis]
    share, of_wheels = (back_m / (away_m + back_m) for back_m in (SET_BACK * half[ALONG], wheels_m))
    if axis == UP and sign < 0 and aside_m * of_wheels > CLEARANCE_M:
        return float(aside_m * of_wheels)
    if axis != ACROSS:
        return float(max(aside_m, 0.0) * share)
    # A body hides its far side from an eye beyond the near one, and the mirror there from one beyond the middle.
    mirror_m = min(aside_m * share, MIRROR_M) if sign * eye[axis] < 0 else 0.0
    return float(max((aside_m - 2 * half[axis]) * share, mirror_m))


# Share of a car's projected box that the car fills: 0.52 to 0.93 for all built-in cars; up to 1 for a user's. People
# and riders, whose boxes are around all poses, fill less of theirs.
FILL, OWN_FILL, OF_THING = (0.5, 0.95), (0.2, 1.0), (0.1, 1.0)
# Cars fit their nominal boxes to 1 %, but for mirrors.
MIRROR_ROOM = 1.2
# Labels measure shares with at least RAYS rays, passes with pixel centres. Labels of 1,020 cars that are seen are at
# most 0.02 outside these limits, a fifth of the error allowed.
RAYS, SIGMAS, MAX_SHARE_OFF, SLACK_PX, EDGE_PX = 60, 4.0, 0.03, 6, 1.0
# Boxes that reach farther aside than this cosine of the angle from the viewing axis say less: pixels are stretched.
WIDE = 0.4
# Share of a large box, cut by the image's border, that a car of which there is any pixel fills.
SLIVER = 0.05


def check_cars(evidence: Evidence) -> Iterator[Result]:
    """Findings where the share of a car, or of a thing, does not fit its number of pixels."""
    items, cars = evidence.labels.objects, evidence.labels.car_visible_fraction
    assert cars is not None
    # Of older labels only those of cars are known.
    things = [item.visible_fraction or 0.0 for item in (items or ())[len(cars) :]]
    counts = np.bincount(evidence.passes["instance"].ravel(), minlength=END)
    for item, share in zip(evidence.world.view.objects, [*cars, *things], strict=False):
        kind, number = thing_of(item.id)
        low, high = _seen_share(evidence, item, int(counts[item.id]))
        off, near = max(low - share, share - high, 0.0), low if share < low else high
        expected = f"{low:.2f} to {high:.2f} of {kind} {number} by its {counts[item.id]} pixels"
        reason = f"{kind}_visible_fraction: expected {expected}, got {share:.2f}"
        yield from judged(f"{kind}s.seen_share", off, reason, most=_error(near))


def _seen_share(evidence: Evidence, item: PlacedObject, n_px: int) -> tuple[float, float]:
    """Limits of the share of an object's pixels that is seen, from their number and the object's box in the image."""
    camera = evidence.camera
    corners_cam, outer_cam = (
        transform(invert(camera.world_from_cam), corners_world(item, room)) for room in (1.0, MIRROR_ROOM)
    )
    uv, outer = outline(camera, corners_cam), outline(camera, outer_cam)
    if not _n_pixels(outer, camera):
        return 0.0, float(n_px > 0)
    box_px = _n_pixels(uv, camera)
    if not box_px:
        return 0.0, 1.0
    is_wide = (corners_cam[:, 1] < WIDE * np.linalg.norm(corners_cam, axis=1)).any()
    if is_wide or not camera.shows(corners_cam).all():
        # It may show a sliver only; but one without any pixel is not seen.
        return max(n_px - SLACK_PX, 0) / box_px, 1.0 if n_px else min(SLACK_PX / (SLIVER * box_px), 1.0)
    least, most = OF_THING if item.kind else OWN_FILL if evidence.scene.assets.cars else FILL
    hull_px = float(ConvexHull(uv).volume)
    return n_px / (most * box_px), min((n_px + SLACK_PX) / (least * hull_px), 1.0)


def _n_pixels(corners: Float[np.ndarray, "n 2"], camera: CameraLabel) -> int:
    """The number of the image's pixels whose centres, or whose neighbours', are inside the hull of corners."""
    if not len(corners):
        return 0
    size = np.array([camera.width_px, camera.height_px])
    low, high = (np.clip(edge, 0, size).astype(int) for edge in (corners.min(axis=0) - 1, corners.max(axis=0) + 2))
    uv = np.stack(np.meshgrid(*(np.arange(*ends) for ends in zip(low, high, strict=True))), axis=-1).reshape(-1, 2)
    return int(covers(corners, uv + 0.5, EDGE_PX).sum())


def _error(share: float) -> float:
    """How far a label may be from this share: it is the mean of some rays that are seen or not."""
    share = min(max(share, 0.0), 1.0)
    return MAX_SHARE_OFF + SIGMAS * float(np.sqrt(share * (1 - share) / RAYS))


# The most that tyres hold, in metres per second squared. The mean speed between two pictures differs from the mean of
# both speeds by at most a quarter of the change that this allows.
MOST_ACCELERATION = 10.0
# Rounding of places, and of velocities in metres per second.
PLACE_M, SPEED = 0.002, 0.005
# A velocity is along the axis of a body, whose axles stand on ground of different slopes where ramps begin: its middle
# goes another way, by 0.1 radians in one of 350 cars, by 0.0003 in most.
OFF_AXIS = 0.15


def instant(evidence: Evidence) -> Iterator[Instant]:
    """What a picture of a clip or a rig tells of its objects."""
    scene, items = evidence.scene, evidence.labels.objects
    if items and scene.shot.n_frames * scene.shot.n_cameras * scene.shot.n_views > 1:
        world_from_cam = evidence.camera.world_from_cam
        objects = {item.id: _object(world_from_cam, item) for item in items}
        yield Instant(f"{scene.split}:{scene.index}", scene.shot.time_s, objects)


def _object(world_from_cam: Float[np.ndarray, "4 4"], item: ObjectLabel) -> MovingObject:
    """An object by its place on the road, whose velocity is labelled."""
    foot_cam = transform(item.cam_from_object, np.array([[0.0, 0.0, -item.size_m[2] / 2]]))
    velocity = None if item.velocity_cam is None else world_from_cam[:3, :3] @ item.velocity_cam
    return MovingObject(transform(world_from_cam, foot_cam)[0], velocity)


def between(before: Instant, after: Instant) -> Iterator[Finding]:
    """Findings where an object is not where both of its velocities lead to."""
    step_s = after.time_s - before.time_s
    if before.scene != after.scene or step_s < 0:
        return
    least_m = PLACE_M + SPEED * step_s + MOST_ACCELERATION * step_s**2 / 4
    for number, now in after.objects.items():
        then = before.objects.get(number)
        if then is None:
            continue
        moved_m, expected_m = now.foot_world - then.foot_world, np.zeros(3)
        if step_s:
            if now.velocity_world is None or then.velocity_world is None:
                continue
            expected_m = step_s * (now.velocity_world + then.velocity_world) / 2
        level_m, up_m = np.hypot(*expected_m[:2]), abs(expected_m[2])
        off_level_m, off_up_m = np.hypot(*(moved_m - expected_m)[:2]), abs(moved_m[2] - expected_m[2])
        if not (off_level_m <= least_m + OFF_AXIS * up_m and off_up_m <= least_m + OFF_AXIS * level_m):
            yield Finding(
                "",
                f"objects.{number}: expected it moved by {_text(expected_m)} m in the {step_s:.3g} s since the picture "
                f"before, as its velocities say, got {_text(moved_m)} m",
            )


def _text(vector: Float[np.ndarray, "3"]) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in vector) + ")"
