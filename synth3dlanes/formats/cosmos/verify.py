"""Read a Cosmos export back and compare it with our labels: lines, cars, signs and lanes in metres through its own
poses and cameras, its lenses in pixels."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from synth3dlanes.formats.comparing import Comparison, Gap, Rule, SourceSample, compare_map, distances, stations
from synth3dlanes.formats.cosmos.convention import CATEGORIES, FRONT_VIEW, ClipFiles, line_style
from synth3dlanes.formats.cosmos.read import Box, CosmosClip, CosmosView
from synth3dlanes.formats.cosmos.verify_videos import video_problems
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.writing import PARTS
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.labels.labels import SymbolLabel
from synth3dlanes.labels.object_labels import CORNERS
from synth3dlanes.system.arrays import Matrix4

# Lanes are within this of the labels from above, heights within the slack; painted lines in space.
RULE = Rule("m", 0.05, name="lane", slack=0.3)
LIMIT_PX, BOX_M = 1.0, 0.002
# Points of a line are this far back at most: labels are rounded.
BACK_M = 0.01
CAM_OF_FLU = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
# Corners of a box with x forward and y left, in the order of CORNERS.
FLU_CORNERS = CORNERS[:, [1, 0, 2]] * [1, -1, 1]
# Pixels, as shares of the image, and depths at which a camera is compared.
SHARES, DEPTHS_M = (0.05, 0.3, 0.5, 0.7, 0.95), (5.0, 50.0)
TABLE_OF = {"stop_line": "wait_line", "give_way_line": "wait_line", "crosswalk": "crosswalk", "gore": None}


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The clips of each part."""
    for part in PARTS:
        if (out / part).is_dir() and not (out / part).is_symlink():
            yield FrameList(part, _clips(out, part, most_frames), "clip")


def _clips(out: Path, part: str, most: int) -> Iterator[ReadFrame]:
    for folder in sorted(path for path in (out / part / "clipgt").glob("*") if path.is_dir())[:most]:
        files = ClipFiles(part, folder.name)
        name = files.table("egomotion_estimate")
        yield ReadFrame(name, str(out / part / "clipgt" / folder.name), None, CosmosClip(out, files))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """Every picture of a clip; with the first ones what stands still, and the videos."""
    clip: CosmosClip = frame.content
    found = Comparison()
    for name, view in clip.views.items():
        pictures = _pictures(name, truth)
        if not pictures:
            found = found.because([f"view {name}: expected a camera of the data set, got none of this name"])
            continue
        found += _view(clip, name, view, pictures)
    if not any(truth.place == picture.place for name in clip.views for picture in _pictures(name, truth)[:1]):
        found = found.because([f"expected a view of {truth.labels.camera.name or FRONT_VIEW}, got none"])
    return found


def _pictures(view: str, truth: SourceSample) -> list[SourceSample]:
    """The pictures of the scene by the camera of a view, in order."""
    reader, cameras = truth.reader, truth.reader.cameras
    named = {f"camera_{camera.name.replace(':', '_').removeprefix('camera_')}": i for i, camera in enumerate(cameras)}
    number = named.get(view) if len(cameras) > 1 else 0 if view == FRONT_VIEW else None
    if number is None:
        return []
    return [SourceSample(reader, place) for place in reader.clip(int(reader.scene_of[truth.place]), number)]


def _view(clip: CosmosClip, name: str, view: CosmosView, pictures: list[SourceSample]) -> Comparison:
    micros = [round(1e6 * picture.scene.shot.time_s) for picture in pictures]
    problems = list[str]()
    for what, got in (("times", clip.times), ("poses", list(clip.poses))):
        if got != micros:
            problems.append(f"expected {what} at {_shown(micros)} microseconds, got {_shown(got)}")
    if problems:
        return Comparison(problems=tuple(problems))
    compared = _lens(name, view, pictures[0])
    for number, (at, picture) in enumerate(zip(micros, pictures, strict=True)):
        cam_from_clip = CAM_OF_FLU @ invert(view.rig_from_flu) @ invert(clip.poses[at])
        here = _lines(clip, cam_from_clip, picture) + _boxes(clip.obstacles(at), cam_from_clip, picture)
        here += _elements(clip, cam_from_clip, picture)
        if number == 0:
            here += _lanes(clip, cam_from_clip, picture).because(_symbol_problems(clip, cam_from_clip, picture))
        told = tuple(f"{name} frame {number}: {problem}" for problem in here.problems)
        named = tuple(replace(gap, name=f"{name} {number} {gap.name}") for gap in here.gaps)
        compared += replace(here, gaps=named, problems=told)
    return compared.because(video_problems(clip, name, pictures))


def _lens(name: str, view: CosmosView, picture: SourceSample) -> Comparison:
    camera = picture.labels.camera
    if view.size_px != (camera.width_px, camera.height_px):
        text = f"{name}: expected a size of {camera.width_px}x{camera.height_px}, got {view.size_px}"
        return Comparison(problems=(text,))
    shares = np.array([(u, v, depth) for u in SHARES for v in SHARES for depth in DEPTHS_M])
    uv = shares[:, :2] * view.size_px
    points = camera.points(uv, shares[:, 2])
    known = np.isfinite(points).all(axis=1)
    found = view.project(transform(CAM_OF_FLU.T, points[known]))
    apart = Gap.of(f"camera {name}", "px", np.linalg.norm(found - uv[known], axis=1), "camera")
    return Comparison.within([apart], {"px": LIMIT_PX})


def _lines(clip: CosmosClip, cam_from_clip: Matrix4, picture: SourceSample) -> Comparison:
    """Painted lines by the ids of the delimiters, in space, with their paint and direction."""
    lines = {row["map_id"]: (row, points) for row, points in clip.lines("lane_line", "line_rail")}
    gaps, problems = [], list[str]()
    for lane in picture.labels.lanes:
        if lane.kind != "delimiter" or lane.marking == "none" or len(lane.xyz_cam) < 2:
            continue
        row, points = lines.get(lane.id, ({}, np.zeros((0, 3))))
        if len(points) < 2:
            others = (transform(cam_from_clip, line) for _, line in lines.values() if len(line) > 1)
            apart = min((float(distances(lane.xyz_cam, line).max()) for line in others), default=np.inf)
            problems.append(f"line {lane.id}: expected it in lane_line, got none nearer than {apart:.3g} m")
            continue
        ours = transform(cam_from_clip, points)
        gaps.append(Gap.of(lane.id, "m", distances(lane.xyz_cam, ours)))
        at = stations(lane.xyz_cam, ours)
        back = float(np.max(np.maximum.accumulate(at) - at, initial=0.0))
        if not back <= BACK_M:
            problems.append(f"line {lane.id}: expected points as in the labels, got them {back:.3g} m back")
        expected = (line_style(lane.marking, lane.double, lane.pair), (lane.color or "white").upper())
        got = {*zip(row["styles"], row["colors"], strict=False)}
        if got != {expected} or len(row["styles"]) != len(points):
            problems.append(f"line {lane.id}: expected {' '.join(expected)} at each point, got {sorted(got)[:3]}")
    return Comparison.within(gaps, {"m": RULE.limit}).because(problems)


def _boxes(boxes: list[Box], cam_from_clip: Matrix4, picture: SourceSample) -> Comparison:
    """Corners of cars by their tracks."""
    ours = {str(item.id): (item.corners_cam, CATEGORIES[item.category]) for item in picture.labels.objects or ()}
    return _compared("car", boxes, ours, cam_from_clip)


def _elements(clip: CosmosClip, cam_from_clip: Matrix4, picture: SourceSample) -> Comparison:
    """Corners of traffic lights and signs by their ids; those of other pictures of the clip are left out."""
    found = Comparison()
    for table in ("traffic_light", "traffic_sign"):
        is_sign = table == "traffic_sign"
        ours = {str(item.id): (item.corners_cam, "") for item in picture.labels.traffic_elements or ()
                if (item.category == "road_sign") == is_sign}  # fmt: skip
        boxes = [box for box in clip.elements(table) if box.name in ours]
        found += _compared(table.replace("_", " "), boxes, ours, cam_from_clip)
    return found


def _compared(
    word: str, boxes: list[Box], ours: dict[str, tuple[np.ndarray, str]], cam_from_clip: Matrix4
) -> Comparison:
    names = [box.name for box in boxes]
    problems = [f"{word} {name}: expected one row, got {names.count(name)}" for name in sorted({*ours, *names})
                if names.count(name) != 1 or name not in ours]  # fmt: skip
    gaps = []
    for box in boxes:
        if box.name in ours:
            corners, category = ours[box.name]
            found = transform(cam_from_clip @ box.clip_from_box, FLU_CORNERS * box.size_m / 2)
            gaps.append(Gap.of(f"{word} {box.name}", "m", np.linalg.norm(found - corners, axis=1), word))
            if category and box.category != category:
                problems.append(f"{word} {box.name}: expected {category}, got {box.category}")
    return Comparison.within(gaps, {"m": BOX_M}).because(problems)


def _lanes(clip: CosmosClip, cam_from_clip: Matrix4, picture: SourceSample) -> Comparison:
    """The middle between the rails of each lane, by the segment of the lane graph that it is."""
    world_from_clip, found = picture.labels.camera.world_from_cam @ cam_from_clip, []
    left, right = clip.lines("lane", "left_rail"), clip.lines("lane", "right_rail")
    for (row, one), (_, other) in zip(left, right, strict=True):
        if len(one) != len(other) or len(one) < 2:
            text = f"lane {row['map_id']}: expected rails of as many points, got {len(one)} and {len(other)}"
            return Comparison(problems=(text,))
        found.append((str(row["map_id"]), transform(world_from_clip, (one + other) / 2)))
    return compare_map(found, picture, RULE)


def _symbol_problems(clip: CosmosClip, cam_from_clip: Matrix4, picture: SourceSample) -> Iterator[str]:
    """Findings where crosswalks, arrows and lines across the road are not those of the labels."""
    for table in ("crosswalk", "wait_line", "road_marking"):
        ours = [symbol for symbol in picture.labels.symbols if TABLE_OF.get(symbol.kind, "road_marking") == table]
        found = [transform(cam_from_clip, points) for _, points in clip.lines(table, "location")]
        if len(ours) != len(found):
            yield f"{table}: expected {len(ours)} as in the labels, got {len(found)}"
        for symbol in ours:
            apart_m = min((_symbol_gap(symbol, points) for points in found if len(points) > 1), default=np.inf)
            if not apart_m <= RULE.limit:
                yield f"{table}: expected {symbol.kind} as in the labels, got none nearer than {apart_m:.3g} m"


def _symbol_gap(symbol: SymbolLabel, points: np.ndarray) -> float:
    """How far a polygon is from the outline of a symbol, and the outline from it; of a line, how far its ends are."""
    outline = np.concatenate([symbol.xyz_cam, symbol.xyz_cam[:1]])
    there = float(distances(points, outline).max())
    closed = np.concatenate([points, points[:1]])
    return there if len(points) == 2 else max(there, float(distances(symbol.xyz_cam, closed).max()))


def _shown(times: list[int]) -> str:
    return f"{times[:3]}... ({len(times)})" if len(times) > 3 else str(times)
