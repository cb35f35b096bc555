"""Read an OpenLane-V2 export back and compare it with our labels."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.comparing import Comparison, Gap, Rule, SourceSample, compare_map
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.lane_map import half_widths, link_gaps
from synth3dlanes.formats.openlane_v2.convention import (
    AHEAD_M,
    ASIDE_M,
    FRONT_CAMERA,
    NEXT_PART,
    ROOT,
    category_and_attribute,
)
from synth3dlanes.formats.openlane_v2.read import TopologyFrame, frames, parse
from synth3dlanes.formats.reading import image_size, read_text
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.element_labels import ElementLabel
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.errors import FormatError

# A curve that is sampled every metre and one that is sampled every half are some millimetres apart.
RULE = Rule("m", 0.05, name="lane", slack=0.3)
LIMIT_PX = 0.02
# Pixels, as shares of the image, and depths at which a camera is compared.
SHARES, DEPTHS_M = (0.1, 0.5, 0.9), (5.0, 50.0)
GAP_M = 1e-3
SIDE_M = 0.05
# What is this near to the area's border may be out of it.
BORDER_M = 2.0
# Rectangles are rounded. What must be in an export: so much of it seen, of so many pixels, at less than 84 degrees.
BOX_PX, CLEAR, CLEAR_PX, CLEAR_COS = 0.2, 0.3, 4.0, 0.1


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The frames of every part: their centre lines, then their lane segments."""
    for part, paths in frames(out).items():
        for name, suffix in ((part, ""), (f"{part}, lane segments", "-ls")):
            files = (path.with_name(f"{path.stem}{suffix}.json") for path in paths[:most_frames])
            yield FrameList(name, _frames(out, files))


def _frames(out: Path, files: Iterator[Path]) -> Iterator[ReadFrame]:
    for path in files:
        frame = parse(read_text(path), str(path))
        image, *others = (f"{ROOT}/{camera.image}" for camera in frame.cameras.values())
        problems = tuple(_image_problems(out, others))
        yield ReadFrame(str(path.relative_to(out)), str(path), image, (frame, problems), tuple(others))


def _image_problems(out: Path, images: list[str]) -> Iterator[str]:
    for image in images:
        try:
            image_size(out / image)
        except FormatError as error:
            yield f"expected the image {image}: {error}"


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Cameras in pixels; lanes in metres, in the world frame; boundaries by their side and distance; what follows
    what."""
    found, problems = frame.content
    graph = truth.labels.graph
    numbers = [i % NEXT_PART for i in found.ids]
    if any(i >= len(graph.segments) for i in numbers) or len({*found.ids}) < len(found.ids):
        text = f"expected ids of their own, those of {len(graph.segments)} segments, got {list(found.ids)}"
        return Comparison(problems=(*problems, text))
    names = [graph.segments[i].id for i in numbers]
    lanes = [
        (name, transform(found.world_from_ego, lines[0])) for name, lines in zip(names, found.lanes_ego, strict=True)
    ]

    cameras = _cameras(found, truth)
    behind_m = AHEAD_M if any(_looks_back(camera, found) for camera in cameras.values()) else 0.0

    def is_in_area(points_world: Float[np.ndarray, "n 3"]) -> np.ndarray:
        x, y, _ = transform(invert(found.world_from_ego), points_world).T
        return np.asarray((x > BORDER_M - behind_m) & (x < AHEAD_M - BORDER_M) & (np.abs(y) < ASIDE_M - BORDER_M))

    compared = compare_map(lanes, truth, RULE, is_in_area) + _compared_cameras(found, cameras)
    sides = _side_problems(found, names, half_widths(truth.scene, names))
    elements = _element_problems(found, names, truth.labels.traffic_elements or ())
    topology = _topology_problems(found, names, graph.successors, truth.scene)
    return compared.because([*problems, *sides, *topology, *elements])


def _cameras(found: TopologyFrame, truth: SourceSample) -> dict[str, CameraLabel]:
    """The cameras of the labels at this moment that the export has, by their names in it."""
    cameras = (picture.labels.camera for picture in truth.moment)
    return {name: camera for camera in cameras if (name := camera.name or FRONT_CAMERA) in found.cameras}


def _looks_back(camera: CameraLabel, found: TopologyFrame) -> bool:
    return bool(camera.world_from_cam[:3, 1] @ found.world_from_ego[:3, 0] < 0)


def _compared_cameras(found: TopologyFrame, cameras: dict[str, CameraLabel]) -> Comparison:
    """How far places that cameras see are from their pixels."""
    gaps = []
    for name, camera in cameras.items():
        shares = np.array([(u, v, depth) for u in SHARES for v in SHARES for depth in DEPTHS_M])
        uv, theirs = shares[:, :2] * (camera.width_px, camera.height_px), found.cameras[name]
        points_world = transform(camera.world_from_cam, camera.points(uv, shares[:, 2]))
        x, y, z = theirs.img_from_cv @ transform(invert(found.world_from_ego @ theirs.ego_from_cv), points_world).T
        apart = np.where(z > 0, np.hypot(x / z - uv[:, 0], y / z - uv[:, 1]), np.inf)
        gaps.append(Gap.of(f"camera {name}", "px", apart, "camera"))
    unknown = [f"camera {name}: expected one of the labels, got none" for name in found.cameras if name not in cameras]
    return Comparison.within(gaps, {"px": LIMIT_PX}).because(unknown)


def _side_problems(found: TopologyFrame, names: list[str], halves_m: list[tuple[float, float]]) -> Iterator[str]:
    """Findings where a boundary is on the other side of its lane, or not half a lane's width from its middle, seen from
    above."""
    for name, lines, (least_m, most_m) in zip(names, found.lanes_ego, halves_m, strict=True):
        middle, *sides = (transform(found.world_from_ego, line)[:, :2] for line in lines)
        along = np.gradient(middle, axis=0)
        for side, sign, line in zip(("left", "right"), (1, -1), sides, strict=False):
            (x, y), (dx, dy) = (line - middle).T, along.T
            got_m = float(np.median(sign * (dx * y - dy * x) / np.maximum(np.hypot(dx, dy), 1e-9)))
            if not least_m - SIDE_M <= got_m <= most_m + SIDE_M:
                yield f"lane {name}: expected its {side} boundary {most_m:.3f} m on that side, got {got_m:.3f} m"


def _topology_problems(
    found: TopologyFrame, names: list[str], successors: dict[str, tuple[str, ...]], scene: Scene
) -> Iterator[str]:
    gaps_m = link_gaps(scene, [(a, b) for a in {*names} for b in successors.get(a, ()) if b in names])
    for i, lane in enumerate(names):
        for j, other in enumerate(names):
            gap_m = float(np.linalg.norm(found.lanes_ego[i][0][-1] - found.lanes_ego[j][0][0]))
            follows = other in successors.get(lane, ())
            is_near = gap_m <= GAP_M + gaps_m.get((lane, other), 0.0)
            if found.follows[i, j] and not (follows and is_near):
                yield f"lane {other}: expected it not to follow {lane}, got it {gap_m:.3f} m from its end"
            if not found.follows[i, j] and follows and gap_m <= GAP_M:
                yield f"lane {other}: expected it to follow {lane}, whose end it touches, got it not to"


def _element_problems(found: TopologyFrame, names: list[str], items: Sequence[ElementLabel]) -> Iterator[str]:
    """Findings about traffic elements that are not those of the labels, or govern other lanes than these say."""
    ours, there = {item.id: item for item in items}, [element.id for element in found.elements]
    if len({*there, *found.ids}) < len(there) + len(found.ids):
        yield f"traffic elements: expected ids of their own, got {there}"
    for id_, item in ours.items():
        if is_clear(item) and id_ not in there:
            yield f"traffic element {id_}: expected it, because {item.visible_fraction:.0%} of it are seen, got none"
    for j, element in enumerate(found.elements):
        own = ours.get(element.id)
        if own is None or own.box_px is None:
            yield f"traffic element {element.id}: expected one of the labels in the image, got another"
            continue
        codes, expected = (element.category, element.attribute), category_and_attribute(own)
        if codes != expected:
            yield f"traffic element {element.id}: expected category and attribute {expected}, got {codes}"
        off_px = float(np.abs(element.box_px - own.box_px).max())
        if not off_px <= BOX_PX:
            yield f"traffic element {element.id}: expected its rectangle within {BOX_PX} px, got it {off_px:.1f} px off"
        for i, lane in enumerate(names):
            if bool(found.governs[i, j]) != (lane in own.lanes):
                words = ("it to govern", "got it not to") if lane in own.lanes else ("it not to govern", "got it to")
                yield f"traffic element {element.id}: expected {words[0]} {lane}, {words[1]}"


def is_clear(item: ElementLabel) -> bool:
    """Whether an element must be in an export: the first camera sees most of it, from its front, and not too small."""
    if item.box_px is None or item.visible_fraction is None or item.visible_fraction < CLEAR:
        return False
    width_px, height_px = item.box_px[2:] - item.box_px[:2]
    away_m = float(np.linalg.norm(item.center_cam))
    return min(width_px, height_px) >= CLEAR_PX and bool(item.normal_cam @ item.center_cam < -CLEAR_COS * away_m)
