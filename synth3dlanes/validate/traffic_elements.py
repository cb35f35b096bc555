"""Check traffic elements against what depth, ids and colours show.

Pixels of an element must be in its box and reach its sides; no pixels of a sign or signal may be without a label; the
lights of a signal must shine where its state says; and a signal over a lane must hang over the lane that it governs.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.scene.instance_ids import thing_of
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.system.arrays import Points2
from synth3dlanes.validate.boxes import MIN_SEEN, SideLimit, against_box, by_pixels, check_seen_box
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding, Result, judged

# Share of the pixels that may be outside a box; how far before a side they may end, and which part of the distance
# between two pixels.
MAX_OUTSIDE, MAX_GAP_M, MAX_PART = 0.01, 0.03, 1.0
# How far a share may be from that of its pixels, and how many of them may be on the other side of an edge. Labels ask
# at most MAX_ASKED pixels, in a grid; bodies that reach nearer to the camera's plane are left out.
MAX_SHARE_OFF, EDGE_PIXELS, MAX_ASKED, AHEAD_M = 0.02, 2, 1_000, 0.2
# Elements of fewer pixels are not judged by these.
MIN_PIXELS = 60
# Pixels of an element without a label are a fault if there are more than MAX_UNLABELLED within FARTHEST_M.
MAX_UNLABELLED, FARTHEST_M = 4, 190.0
# How far a signal may hang beside the middle of its lane, seen from above; points of a lane are a metre apart.
BESIDE_LANE_M = 0.6
# Heads of which fewer rows are seen are not judged by their colours; how much brighter a dark light may be than a lit
# one, and how far a red cross may be from red, in levels.
MIN_ROWS, BRIGHTER, LEAST_HUE = 18, 50.0, 12.0
LIT = {"off": (), "red": (0,), "red_amber": (0, 1), "amber": (1,), "green": (2,)}
# Signs of red minus green of the lights over lanes.
HUES = {"red_cross": 1, "green_arrow": -1}


def check_elements(evidence: Evidence) -> Iterator[Result]:
    """Findings about traffic elements that are not where and what pixels show."""
    items = evidence.labels.traffic_elements
    if items is None:
        return
    yield from _unlabelled(evidence, items)
    segments = {segment.id for segment in evidence.labels.graph.segments}
    for item in items:
        yield from judge(evidence, item)
        unknown = [lane for lane in item.lanes if lane not in segments]
        if unknown:
            yield Finding("", f"traffic_elements.{item.id}.lanes: expected segments of the graph, got {unknown[0]}")
        yield from over_its_lane(evidence, item)
        yield from shining(evidence, item)


def _unlabelled(evidence: Evidence, items: tuple[ObjectLabel, ...]) -> Iterator[Finding]:
    """Pixels of signs and signals near the camera whose id has no label."""
    if not {"instance", "semantic", "depth"} <= evidence.has:
        return
    semantic, instance = evidence.passes["semantic"], evidence.passes["instance"]
    is_it = np.isin(semantic, [SEMANTIC_IDS["sign"], SEMANTIC_IDS["signal"]])
    is_it &= np.abs(evidence.passes["depth"]) < FARTHEST_M
    ids, counts = np.unique(instance[is_it], return_counts=True)
    known = {item.id for item in items}
    for id_, count in zip(ids.tolist(), counts.tolist(), strict=True):
        if id_ not in known and count > MAX_UNLABELLED:
            yield Finding("", f"traffic_elements: expected one with id {id_}, which {count} pixels show, got none")


def judge(evidence: Evidence, item: ObjectLabel) -> Iterator[Result]:
    """Findings where pixels with an element's id are not in its rectangles and box, or end before a side of it."""
    if "instance" not in evidence.has:
        return
    label, n_pixels = f"traffic_elements.{item.id}", int((evidence.passes["instance"] == item.id).sum())
    yield from check_seen_box(evidence, item, label)
    if item.visible_fraction is not None and (item.visible_fraction > 0) != (n_pixels > 0) and n_pixels != 1:
        reason = f"expected a share of its {n_pixels} pixels, got {item.visible_fraction:g}"
        yield Finding("", f"{label}.visible_fraction: {reason}")
    yield from _share(evidence, item, label)
    seen = by_pixels(evidence, item.id, item.cam_from_object, MIN_PIXELS)
    if seen is not None:
        sides = _sides(item, seen.apart_m) if _is_whole(item) else ()
        yield from against_box(label, "elements", item.size_m / 2, seen, MAX_OUTSIDE, sides)


def _share(evidence: Evidence, item: ObjectLabel, label: str) -> Iterator[Result]:
    """A finding if an element's share is not that of the pixels inside the outlines of its body's faces which show
    it."""
    if item.box_px is None or item.visible_fraction is None:
        return
    (left, top), (right, bottom) = np.floor(item.box_px[:2]).astype(int), np.ceil(item.box_px[2:]).astype(int)
    step = max(1, int(np.ceil(np.sqrt((bottom - top) * (right - left) / MAX_ASKED))))
    shows = (evidence.passes["instance"][top:bottom:step, left:right:step] == item.id).ravel()
    v, u = np.mgrid[top:bottom:step, left:right:step]
    corners_world = evidence.world.site.structures[thing_of(item.id)[1]].corners_world
    corners_cam = transform(invert(evidence.camera.world_from_cam), corners_world)
    if not (corners_cam[..., 1] > AHEAD_M).all():
        return
    fills = shows | in_outlines(evidence.camera.project(corners_cam), np.column_stack([u.ravel(), v.ravel()]) + 0.5)
    n = int(fills.sum())
    if not n:
        return
    share = float(shows.sum() / n)
    off = abs(item.visible_fraction - share)
    got = f"expected {share:.2f} by the {n} pixels of its body, got {item.visible_fraction:.2f}"
    reason = f"{label}.visible_fraction: {got}"
    yield from judged("elements.seen_share", off, reason, most=MAX_SHARE_OFF + EDGE_PIXELS / n)


def in_outlines(quads_img: Float[np.ndarray, "f 4 2"], uv: Points2) -> Bool[np.ndarray, " n"]:
    """Which places in the image are inside one of some convex quads."""
    sides = np.roll(quads_img, -1, axis=1) - quads_img
    to = uv[:, None, None] - quads_img
    turns = sides[..., 0] * to[..., 1] - sides[..., 1] * to[..., 0]
    return np.asarray(((turns >= 0).all(axis=2) | (turns <= 0).all(axis=2)).any(axis=1))


def _is_whole(item: ObjectLabel) -> bool:
    """Whether an element is in the image and seen as a whole."""
    box, whole = item.box_px, item.unclipped_box_px
    is_inside = box is not None and whole is not None and bool(np.allclose(box, whole))
    return is_inside and (item.visible_fraction or 0.0) >= MIN_SEEN


def _sides(item: ObjectLabel, apart_m: float) -> Iterator[SideLimit]:
    """The sides of the face; the pixels of a board may end farther before one that it reaches in a corner alone."""
    most_m = MAX_GAP_M + MAX_PART * apart_m + (1.5 * apart_m if item.category == "road_sign" else 0.0)
    for axis, name in ((0, "left right"), (2, "lower upper")):
        for sign, side in zip((-1, 1), name.split(), strict=True):
            yield SideLimit(axis, sign, side, most_m)


def over_its_lane(evidence: Evidence, item: ObjectLabel) -> Iterator[Result]:
    """A signal over a lane that does not hang over the middle of the lane that it governs."""
    if item.category != "lane_signal" or len(item.lanes) != 1:
        return
    graph = evidence.labels.graph
    names = {name for segment in graph.segments if segment.id == item.lanes[0] for name in segment.centerlines}
    lines = [lane.xyz_cam for lane in evidence.labels.lanes if lane.id in names]
    if not lines:
        return
    world_from_cam = evidence.camera.world_from_cam
    x, y, _ = transform(world_from_cam, item.center_cam)
    points = transform(world_from_cam, np.concatenate(lines))
    if not points[:, 1].min() <= y <= points[:, 1].max():
        return
    off_m = float(np.hypot(points[:, 0] - x, points[:, 1] - y).min())
    got = f"got {item.lanes[0]}, which is {off_m:.2f} m beside it"
    reason = f"traffic_elements.{item.id}.lanes: expected the lane below it, {got}"
    yield from judged("elements.beside_lane", off_m, reason, most=BESIDE_LANE_M)


def shining(evidence: Evidence, item: ObjectLabel) -> Iterator[Result]:
    """A signal whose dark lights are much brighter than its lit ones, or a cross or arrow of the other colour."""
    if evidence.image is None or item.state is None or item.seen_box_px is None or "instance" not in evidence.has:
        return
    left, top, right, bottom = item.seen_box_px.tolist()
    faces_us = float(item.normal_cam @ item.center_cam) < -0.7 * float(np.linalg.norm(item.center_cam))
    is_cut = item.box_px is None or item.unclipped_box_px is None or (item.box_px != item.unclipped_box_px).any()
    if bottom - top < MIN_ROWS or (item.visible_fraction or 0.0) < MIN_SEEN or not faces_us or is_cut:
        return
    own = evidence.passes["instance"][top:bottom, left:right] == item.id
    pixels = np.where(own[..., None], evidence.image[top:bottom, left:right], 0).astype(float)
    if item.category == "traffic_light":
        lights = [_brightest(part, part.any(axis=2)) for part in np.array_split(pixels, 3, axis=0)]
        lit = LIT[item.state]
        dark = [level for number, level in enumerate(lights) if number not in lit]
        off = max(dark, default=0.0) - min((lights[number] for number in lit), default=np.inf)
        levels = ", ".join(f"{level:.0f}" for level in lights)
        reason = f"traffic_elements.{item.id}.state: expected {item.state} lights, got levels of {levels} from the top"
        yield from judged("elements.dark_light", off, reason, most=BRIGHTER)
    elif item.state in HUES:
        chosen = pixels[pixels.max(axis=2) >= np.percentile(pixels.max(axis=2), 90)]
        hue = HUES[item.state] * float((chosen[:, 0] - chosen[:, 1]).mean())
        got = f"expected the colour of {item.state}, got {-hue:.0f} levels of the other"
        yield from judged("elements.hue", hue, f"traffic_elements.{item.id}.state: {got}", least=-LEAST_HUE)


def _brightest(part: Float[np.ndarray, "h w 3"], own: Bool[np.ndarray, "h w"]) -> float:
    """The level of the brightest tenth of the pixels of an element, by their strongest channel."""
    return float(np.percentile(part[own].max(axis=1), 90)) if own.any() else 0.0
