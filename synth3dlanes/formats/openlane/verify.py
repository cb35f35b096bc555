"""Read an OpenLane export back and compare it with our labels."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path, PurePath

import numpy as np

from synth3dlanes.formats.comparing import (
    NEAR_START_M,
    Comparison,
    ExportView,
    Gap,
    OurLine,
    Rule,
    SourceSample,
    UprightLane,
    camera_problems,
    compare,
    distances,
    pixels,
    places_beside,
    upright,
)
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.kerbs import kerb_lanes
from synth3dlanes.formats.openlane.convention import CASES, PAINTS
from synth3dlanes.formats.openlane.read import OpenLaneFrame, OpenLaneLine, parse
from synth3dlanes.formats.reading import listed_files, read_text
from synth3dlanes.labels.labels import Lane
from synth3dlanes.system.arrays import Polyline3

# Points between those of the labels lie on a spline.
RULE = Rule("m", 0.001, most=20, slack=0.2)
# Pixels have four decimals.
TOLERANCE_PX = 0.001


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """Every list."""
    for path in sorted([*(out / "lists").glob("*.txt"), *(out / "lane3d_1000/test").glob("*.txt")]):
        yield FrameList(str(path.relative_to(out)), _frames(out, path, most_frames))


def _frames(out: Path, path: Path, most_frames: int) -> Iterator[ReadFrame]:
    case = {name: case for case, name in CASES.items()}.get(path.name)
    for image in listed_files(path, most_frames):
        label = image.replace("jpg", "json")
        if case is not None:
            label = f"test/{case}_case/{label.partition('/')[2]}"
        file = f"lane3d_1000/{label}"
        frame = parse(read_text(out / file), str(out / file))
        yield ReadFrame(file, str(out / file), f"images/{image}", frame)


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Lines in metres; their pixels; category, place beside the camera and track."""
    found: OpenLaneFrame = frame.content
    camera, to_vehicle = truth.labels.camera, found.vehicle_from_cam_waymo
    kerbs = kerb_lanes(truth.scene, camera) if truth.has_scene else ()
    delimiters = truth.lanes("delimiter")
    curbs = [UprightLane(camera, kerb.id, upright(camera, kerb.xyz_cam), kerb.terrain_visible) for kerb in kerbs]
    view = ExportView(found.img_from_cv, (round(2 * found.img_from_cv[0, 2]), round(2 * found.img_from_cv[1, 2])))
    ours = [lane.in_metres(view) for lane in (*delimiters, *curbs)]
    # Waymo's axes: x ahead, y to the left, z up.
    lines = [line.xyz_waymo @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) for line in found.lines]
    compared, ids = compare(lines, ours, RULE)
    problems = list(camera_problems(truth, to_vehicle[2, 3], float(np.arcsin(-to_vehicle[2, 0]))))
    if PurePath(frame.image or "").relative_to("images") != PurePath(found.file_path):
        problems.append(f"expected the file_path {frame.image}, got {found.file_path}")
    by_id: dict[str, Lane] = {lane.id: lane for lane in (*truth.labels.lanes, *kerbs)}
    places, gaps, tracks = places_beside(delimiters, NEAR_START_M), list[Gap](), dict[str, str]()
    for i, (line, name) in enumerate(zip(found.lines, ids, strict=False)):
        seen = pixels(found.img_from_cv, lines[i][line.visible])
        if len(seen) != len(line.uv_img):
            problems.append(f"line {i}: expected {len(seen)} uv, one for each visible point, got {len(line.uv_img)}")
        elif len(seen):
            apart = np.linalg.norm(seen - line.uv_img, axis=1)
            gaps.append(Gap.of(name, "px", apart))
            if not apart.max() <= TOLERANCE_PX:
                problems.append(f"line {i} ({name}): expected uv where xyz is seen, got it {apart.max():.3g} px away")
        problems += (f"line {i}: {text}" for text in _paint_problems(line, by_id[name], lines[i]))
        problems += (f"line {i}: {text}" for text in _place_problems(line, name, lines[i], places, ours))
        scene = f"{truth.reader.url}:{truth.reader.scene_of[truth.place]} {name}"
        tracks[f"{PurePath(found.file_path).parent.name}/{line.track_id}"] = scene
    if len(tracks) < len(found.lines) == len(ids):
        problems.append(f"expected a track_id for each of {len(found.lines)} lines, got {len(tracks)} different ones")
    return replace(compared, tracks=tracks) + Comparison(tuple(gaps), tuple(problems))


def _paint_problems(line: OpenLaneLine, lane: Lane, points_up: Polyline3) -> Iterator[str]:
    """Findings where a line has another category than our lane."""
    if lane.id.startswith("kerb_"):
        expected = {20 if points_up[0, 0] < 0 else 21}
    else:
        paint = (lane.marking, lane.color or "white", bool(lane.double), lane.pair)
        expected = {number for number, other in PAINTS.items() if other == paint} or {0}
    if line.category not in expected:
        yield f"expected the category {min(expected)} of {lane.id}, got {line.category}"


def _place_problems(
    line: OpenLaneLine, name: str, points_up: Polyline3, places: dict[str, int], ours: Sequence[OurLine]
) -> Iterator[str]:
    """Findings where a line is said to be elsewhere beside the camera."""
    if line.attribute != places.get(name, 0):
        there = [other for other in ours if line.attribute and places.get(other.id) == line.attribute]
        apart = (f": that of {other.id}, {distances(points_up, other.points).max():.3g} m away" for other in there)
        yield f"expected the attribute {places.get(name, 0)} of {name}, got {line.attribute}{''.join(apart)}"
