"""Check labels by themselves and against the recomputed labels of their scene, with what ids of pixels and points tell
of objects."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from synth3dlanes.geometry.frames import road_from_cam, transform
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, to_json
from synth3dlanes.labels.object_labels import as_seen
from synth3dlanes.scene.scene import Scene
from synth3dlanes.truth.object_truth import with_pixel_shares
from synth3dlanes.validate.evidence import BORDER_PX, Evidence, inside_px
from synth3dlanes.validate.findings import Finding, Tolerance, differences, some

# labels.json rounds points to 0.1 mm and matrices to 1e-9.
POINT_M = 1e-4
MATRIX = 1e-8
# Numbers that are rounded in files, and rectangles of projected boxes, which add to that. On another machine, shares of
# objects are counted by rays, some of which graze; rectangles of what is seen end at pixels of an object's edge.
ROUNDED = Tolerance(
    {
        **dict.fromkeys(("xyz_cam", "size_m", "center_cam"), 2e-4),
        **dict.fromkeys(("box_px", "unclipped_box_px"), 0.2),
        **dict.fromkeys(("img_from_cam", "road_from_cam", "world_from_cam", "cam_from_lidar"), MATRIX),
        **dict.fromkeys(("car_visible_fraction", "visible_fraction"), 0.03),
        **{"rotation_wxyz": 2e-6, "velocity_cam": 2e-3, "truncation": 0.005, "seen_box_px": 2.0, "lidar_points": 3.0},
    },
    share=1e-6,
)
# Numbers that follow from the ids of the same sample are exact.
COUNTED = ROUNDED._replace(by_key={**ROUNDED.by_key, "seen_box_px": 0, "lidar_points": 0, "visible_fraction": 0.002})
GROUPS = ("lanes", "symbols", "objects", "traffic_elements")
# Parts of labels that need a rendered scene; they have checks of their own.
RENDERED = ("object_visible", "car_visible_fraction")
# The most that a line of a map moves aside from one point to the next by a bend: 1.1 m for a line 7 m beside an arc of
# 3 m.
MAX_JUMP_M = 1.5


def check_shape(labels: Labels, scene: Scene | None) -> Iterator[Finding]:
    """Findings about what all other checks rely on: unique ids, points, known references; of a rendered scene masks and
    shares, of a real drive how certain points are."""
    if not labels.lanes and scene is not None:
        yield Finding("", "expected lanes, got none")
    for id_, count in Counter(lane.id for lane in labels.lanes).items():
        if count > 1:
            yield Finding(id_, f"expected unique ids of lanes, got {count} lanes with this one")
    for lane in labels.lanes:
        n = len(lane.xyz_cam)
        if n < 2:
            yield Finding(lane.id, f"expected two points or more, got {n}")
        if scene is not None and lane.object_visible is None:
            yield Finding(lane.id, f"expected {n} values in object_visible, got none")
        if scene is None and (lane.std_m is None or not (lane.std_m > 0).all()):
            yield Finding(lane.id, "std_m: expected how certain each point is, above 0, got none or 0")
    yield from _references(labels)
    if scene is None:
        return
    for i, symbol in enumerate(labels.symbols):
        if symbol.object_visible is None:
            yield Finding("", f"symbols.{i}: expected {len(symbol.xyz_cam)} values in object_visible, got none")
    shares = labels.car_visible_fraction
    if shares is None or len(shares) != len(scene.cars):
        got = None if shares is None else len(shares)
        yield Finding("", f"car_visible_fraction: expected {len(scene.cars)} of them, got {got}")


def check_form(evidence: Evidence) -> Iterator[Finding]:
    """Findings about the camera's poses, and about every lane's order and projection."""
    labels, camera = evidence.labels, evidence.labels.camera
    for name in ("world_from_cam", "road_from_cam"):
        turn = getattr(camera, name)[:3, :3]
        if not np.allclose(turn @ turn.T, np.eye(3), atol=MATRIX) or np.linalg.det(turn) < 0:
            yield Finding("", f"camera.{name}: expected a rotation, got another matrix")
    pose = road_from_cam(camera.height_m, camera.pitch_rad, camera.roll_rad, camera.yaw_rad)
    if not np.allclose(camera.road_from_cam, pose, atol=MATRIX):
        yield Finding("", "camera.road_from_cam: expected its height and angles, got another transform")
    for lane in labels.lanes:
        yield from order(camera, lane)
        inside = inside_px(camera, lane)
        wrong = np.where(lane.in_image, ~(inside > -BORDER_PX), inside > BORDER_PX)
        if wrong.any():
            yield Finding(lane.id, f"in_image: expected the mask of our projection, got another at {_at(wrong)}")


def check_labels(evidence: Evidence) -> Iterator[Finding]:
    """Findings where labels are not those that are computed anew of their scene: by lane and symbol, by object, and
    others."""
    of_pixels = () if "instance" in evidence.passes else ("seen_box_px", "visible_fraction")
    of_points = () if evidence.sweep else ("lidar_points",)
    unknown = {"objects": ("visible_fraction", *of_pixels, *of_points), "traffic_elements": of_pixels}
    expected, found = (_document(labels, unknown) for labels in (_counted(evidence), evidence.labels))
    for group in GROUPS:
        true, own = (document.pop(group, None) for document in (expected, found))
        names = [[str(item.get("id", item.get("kind"))) for item in part or ()] for part in (true, own)]
        if names[0] != names[1]:
            others = some(sorted({*names[0]} ^ {*names[1]}) or ["their order"])
            got = f"got {len(names[1])}, which differ in {others}"
            yield Finding("", f"{group}: expected {len(names[0])} as in the scene, {got}")
            continue
        for i, pair in enumerate(zip(true or (), own or (), strict=True)):
            lines = list(differences(*pair, tolerance=COUNTED))
            if lines:
                lane = {"lanes": names[0][i], "symbols": f"symbol {i}"}.get(group, "")
                yield Finding(lane, some(lines) if lane else f"{group}.{names[0][i]}: {some(lines)}")
    lines = list(differences(expected, found, tolerance=ROUNDED))
    if lines:
        yield Finding("", some(lines))


def _counted(evidence: Evidence) -> Labels:
    """The labels of the scene, and what ids of pixels and of points tell of its objects and traffic elements."""
    truth, instance = evidence.truth, evidence.passes.get("instance", np.zeros((0, 0), dtype=int))
    points = None if evidence.returns is None else evidence.returns.instance
    elements = as_seen(truth.traffic_elements or (), instance)
    if "instance" in evidence.passes:
        elements = with_pixel_shares(elements, evidence.world.site, evidence.camera, instance)
    return replace(truth, objects=as_seen(truth.objects or (), instance, points), traffic_elements=elements)


def _document(labels: Labels, unknown: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """The JSON form of labels without what is unknown of each group."""
    document: dict[str, Any] = json.loads(to_json(labels))
    parts: list[tuple[dict[str, Any], Sequence[str]]] = [(document, RENDERED)]
    parts += [(item, unknown.get(group, RENDERED)) for group in GROUPS for item in document[group] or ()]
    for part, keys in parts:
        for key in keys:
            part.pop(key, None)
    return document


def _references(labels: Labels) -> Iterator[Finding]:
    """Findings about neighbours that are not there. The graph is compared with that of the scene."""
    kinds = {lane.id: lane.kind for lane in labels.lanes}
    # In a clip a name may be that of a line of another frame.
    is_clip = labels.time_s is not None
    for lane in labels.lanes:
        for side in ("left", "right"):
            id_ = getattr(lane, side)
            is_known = id_ in kinds or is_clip
            if id_ is not None and not (is_known and kinds.get(id_) != lane.kind):
                yield Finding(lane.id, f"{side}: expected the id of a line of the other kind or null, got {id_}")


def order(camera: CameraLabel, lane: Lane) -> Iterator[Finding]:
    """Findings unless points go on in the host's driving direction, without a step of zero length, back or far aside.
    Lines of maps fold where a road turns more sharply than they are beside its reference line."""
    steps = np.diff(lane.xyz_cam, axis=0)
    lengths_m, along = np.linalg.norm(steps, axis=1), (steps[1:] * steps[:-1]).sum(axis=1)
    back = lengths_m < POINT_M
    if lane.connector is None:
        back[1:] |= along <= 0
    else:
        aside_m = np.sqrt(np.maximum(lengths_m[1:] ** 2 - (along / np.maximum(lengths_m[:-1], POINT_M)) ** 2, 0.0))
        if (aside_m > MAX_JUMP_M).any():
            jump = f"{aside_m.max():.2f} m aside after point {int(aside_m.argmax()) + 1}"
            yield Finding(lane.id, f"expected points that go on along the line, got a jump of {jump}")
    if back.any():
        yield Finding(lane.id, f"expected points that advance along the line, got a step back at {_at(back)}")
    first, last = transform(camera.road_from_cam, lane.xyz_cam[[0, -1]])[:, 1]
    # On a map a line may turn back.
    if first > last and lane.connector is None:
        yield Finding(lane.id, f"expected points in driving order, got {first:.1f} m first and {last:.1f} m last")


def _at(wrong: np.ndarray) -> str:
    """The number and the first of the wrong points, in words."""
    return f"{int(wrong.sum())} of {len(wrong)} points, the first is {int(wrong.argmax())}"
