"""Check labels for consistency, and against their scene and its recomputed ground truth. No pixels."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from synth3dlanes.frames import road_from_cam, transform
from synth3dlanes.geometry.terrain import height_at
from synth3dlanes.labels import CameraLabel, Labels, Lane, SymbolLabel
from synth3dlanes.scene import Scene
from synth3dlanes.validate.documents import shown
from synth3dlanes.validate.findings import Finding
from synth3dlanes.validate.host import host_of

# labels.json rounds points to 0.1 mm and matrices to 1e-9.
POINT_M = 1e-4
MATRIX = 1e-8
# Points this close to the image's border may be on either side of it after rounding.
BORDER_PX = 0.2


def check_shape(scene: Scene, labels: Labels) -> Iterator[Finding]:
    """Check what all other checks rely on: points, masks of a rendered scene, known references."""
    if not labels.lanes:
        yield Finding("", "expected lanes, got none")
    for id_, count in Counter(lane.id for lane in labels.lanes).items():
        if count > 1:
            yield Finding(id_, f"expected unique ids of lanes, got {count} lanes with this one")
    for lane in labels.lanes:
        n = len(lane.xyz_cam)
        if n < 2:
            yield Finding(lane.id, f"expected two points or more, got {n}")
        if lane.object_visible is None:
            yield Finding(lane.id, f"expected {n} values in object_visible, got none")
    for i, symbol in enumerate(labels.symbols):
        if symbol.object_visible is None:
            yield Finding("", f"symbols.{i}: expected {len(symbol.xyz_cam)} values in object_visible, got none")
    yield from _references(labels)
    shares = labels.car_visible_fraction
    if shares is None or len(shares) != len(scene.cars):
        reason = f"car_visible_fraction: expected {len(scene.cars)} of them, got {shown(shares)}"
        yield Finding("", reason)


def check_values(scene: Scene, truth: Labels, labels: Labels) -> Iterator[Finding]:
    """Check camera, and every lane's order, projection and labels, against the scene."""
    yield from _camera(scene, labels)
    for lane in labels.lanes:
        yield from _order(labels.camera, lane)
        inside_px = _inside_px(labels.camera, lane)
        wrong = np.where(lane.in_image, ~(inside_px > -BORDER_PX), inside_px > BORDER_PX)
        if wrong.any():
            yield Finding(lane.id, f"in_image: expected the mask of our projection, got another at {_at(wrong)}")
    yield from _against_ground_truth(truth, labels)
    yield from _symbols(truth, labels)


def points_to_pixels(labels: Labels) -> bool:
    """Whether all points marked as in the image project into it, as checks of pixels require."""
    return all((_inside_px(labels.camera, lane)[lane.in_image] > -BORDER_PX).all() for lane in labels.lanes)


def _inside_px(camera: CameraLabel, lane: Lane) -> Float[np.ndarray, " n"]:
    """Distance of each projected point from the nearest border of the image, negative outside; NaN behind the
    camera."""
    uv = camera.project(lane.xyz_cam)
    return np.asarray(np.minimum(uv, [camera.width_px, camera.height_px] - uv).min(axis=1))


def _references(labels: Labels) -> Iterator[Finding]:
    kinds = {lane.id: lane.kind for lane in labels.lanes}
    for lane in labels.lanes:
        for side in ("left", "right"):
            id_ = getattr(lane, side)
            # In a clip it may be a line of another frame.
            is_known = id_ in kinds or labels.time_s is not None
            if id_ is not None and not (is_known and kinds.get(id_) != lane.kind):
                yield Finding(lane.id, f"{side}: expected the id of a line of the other kind or null, got {id_}")
    segments = {segment.id for segment in labels.graph.segments}
    named = [name for segment in labels.graph.segments for name in (segment.left, segment.right) if name is not None]
    named += [name for key, values in labels.graph.successors.items() for name in (key, *values)]
    lines = {name for segment in labels.graph.segments for name in segment.centerlines}
    unknown = sorted({*named} - segments) + sorted(name for name in lines if kinds.get(name) != "centerline")
    if unknown:
        yield Finding("", f"graph: expected ids of segments and centre lines, got {', '.join(unknown)}")


def _order(camera: CameraLabel, lane: Lane) -> Iterator[Finding]:
    """Findings unless points go on in the host's driving direction, without a step of zero length or back."""
    steps = np.diff(lane.xyz_cam, axis=0)
    back = np.linalg.norm(steps, axis=1) < POINT_M
    back[1:] |= (steps[1:] * steps[:-1]).sum(axis=1) <= 0
    if back.any():
        yield Finding(lane.id, f"expected points that advance along the line, got a step back at {_at(back)}")
    first, last = transform(camera.road_from_cam, lane.xyz_cam[[0, -1]])[:, 1]
    if first > last:
        yield Finding(lane.id, f"expected points in driving order, got {first:.1f} m first and {last:.1f} m last")


def _camera(scene: Scene, labels: Labels) -> Iterator[Finding]:
    camera, asked = labels.camera, scene.camera
    for name in ("width_px", "height_px", "height_m", "pitch_rad", "roll_rad", "yaw_rad", "name", "lens"):
        if getattr(camera, name) != getattr(asked, name):
            yield Finding(
                "", f"camera.{name}: expected {getattr(asked, name)} as in the scene, got {getattr(camera, name)}"
            )
    rotation = camera.world_from_cam[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=MATRIX) or np.linalg.det(rotation) < 0:
        yield Finding("", "camera.world_from_cam: expected a rotation, got another matrix")
    pose = road_from_cam(asked.height_m, asked.pitch_rad, asked.roll_rad, asked.yaw_rad)
    if not np.allclose(camera.road_from_cam, pose, atol=MATRIX):
        yield Finding("", "camera.road_from_cam: expected the scene's height and angles, got another transform")
    place = host_of(scene, camera)[:3, 3]
    gap_m = abs(place[2] - float(height_at(scene.terrain, place[None, :2])[0]))
    if gap_m > POINT_M:
        yield Finding("", f"camera: expected the host on the road, got it {gap_m:.4f} m off")


def _against_ground_truth(expected: Labels, labels: Labels) -> Iterator[Finding]:
    """Compare all labels with the scene's recomputed ground truth, except those that need a rendered scene."""
    for name in ("img_from_cam", "road_from_cam", "world_from_cam"):
        if not np.allclose(getattr(labels.camera, name), getattr(expected.camera, name), atol=MATRIX):
            yield Finding("", f"camera.{name}: expected the scene's ground truth, got another")
    lidars = [lidar and {**vars(lidar), "cam_from_lidar": None} for lidar in (labels.lidar, expected.lidar)]
    if lidars[0] != lidars[1] or not (
        labels.lidar is None
        or expected.lidar is None
        or np.allclose(labels.lidar.cam_from_lidar, expected.lidar.cam_from_lidar, atol=MATRIX)
    ):
        yield Finding("", "lidar: expected the scene's, got another")
    if labels.time_s != expected.time_s:
        yield Finding("", f"time_s: expected {expected.time_s}, got {labels.time_s}")
    if labels.graph != expected.graph or labels.horizon != expected.horizon:
        yield Finding("", "graph, horizon: expected the scene's ground truth, got another")
    ids = [lane.id for lane in labels.lanes]
    if ids != [lane.id for lane in expected.lanes]:
        yield Finding("", f"expected lanes {[lane.id for lane in expected.lanes]}, got {ids}")
        return
    # Older labels do not have the paint of their lines.
    paint = ("color", "double") if any(lane.color for lane in labels.lanes) else ()
    for lane, true in zip(labels.lanes, expected.lanes, strict=True):
        for name in ("kind", "road", "marking", "left", "right", *paint):
            if getattr(lane, name) != getattr(true, name):
                yield Finding(
                    lane.id, f"{name}: expected {getattr(true, name)} by its scene, got {getattr(lane, name)}"
                )
        if lane.xyz_cam.shape != true.xyz_cam.shape:
            yield Finding(lane.id, f"expected {len(true.xyz_cam)} points by its scene, got {len(lane.xyz_cam)}")
            continue
        yield from _points(lane.id, true, lane)


def _symbols(expected: Labels, labels: Labels) -> Iterator[Finding]:
    """Compare the symbols with those of the scene."""
    kinds, asked = ([symbol.kind for symbol in of.symbols] for of in (labels, expected))
    if kinds != asked or any(
        symbol.xyz_cam.shape != true.xyz_cam.shape
        for symbol, true in zip(labels.symbols, expected.symbols, strict=True)
    ):
        yield Finding("", f"symbols: expected {shown(asked)} with their outlines by the scene, got {shown(kinds)}")
        return
    for i, (symbol, true) in enumerate(zip(labels.symbols, expected.symbols, strict=True)):
        yield from _points(f"symbol {i}", true, symbol)


def _points(id_: str, true: Lane | SymbolLabel, got: Lane | SymbolLabel) -> Iterator[Finding]:
    """Compare points and masks with those of the scene."""
    off_m = np.linalg.norm(got.xyz_cam - true.xyz_cam, axis=1)
    if not off_m.max() <= POINT_M:
        yield Finding(id_, f"expected points where its scene has them, got them up to {off_m.max():.4f} m off")
    for name in ("in_image", "terrain_visible"):
        wrong = getattr(got, name) != getattr(true, name)
        if wrong.any():
            yield Finding(id_, f"{name}: expected the mask of its scene, got another at {_at(wrong)}")


def _at(wrong: np.ndarray) -> str:
    """The number and the first of the wrong points, in words."""
    return f"{int(wrong.sum())} of {len(wrong)} points, the first is {int(wrong.argmax())}"
