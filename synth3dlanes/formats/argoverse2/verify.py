"""Read an Argoverse 2 export back and compare it with our labels: what its cameras see in pixels, its boxes, sweeps and
lanes in metres."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float

from synth3dlanes.formats.argoverse2.convention import CATEGORIES, LogFiles, mark_type, place_of
from synth3dlanes.formats.argoverse2.read import IMAGE, Log, LogLane, LogMap, matrices
from synth3dlanes.formats.comparing import Comparison, Gap, Rule, SourceSample, compare_map, distances, is_beside
from synth3dlanes.formats.format import FrameList, ReadFrame
from synth3dlanes.formats.lane_map import half_widths, link_gaps
from synth3dlanes.formats.writing import PARTS
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.geometry.polylines import resampled
from synth3dlanes.labels.labels import Lane, Segment
from synth3dlanes.labels.object_labels import CORNERS
from synth3dlanes.system.errors import FormatError

# The pieces of each segment, in order, and half its least and its greatest width.
PiecesOf = dict[str, list[LogLane]]
HalvesOf = dict[str, tuple[float, float]]
# Lanes are within this of the labels from above; heights within the slack. Labels of boxes and points are rounded.
RULE = Rule("m", 0.05, name="lane", slack=0.3)
LIMIT_PX, BOX_M, POINT_M = 0.02, 0.001, 0.001
SIDE_M, GAP_M, GROUND_M = 0.05, 0.005, 0.2
# Drivable areas have seams where one begins at the end of another.
SEAM_M = 0.01
# A boundary has the paint of a delimiter if the share ON_LINE of its points that the labels reach, and at least
# LEAST_POINTS, are within ON_LINE_M of it.
ON_LINE_M, ON_LINE, LEAST_POINTS = 0.05, 0.9, 10
# A map's boundary is compared if the labels reach more than this share of it, of which ON_LINE is more than half.
MOST = 0.6
# Pixels, as shares of the image, and depths at which a camera is compared.
SHARES, DEPTHS_M = (0.1, 0.5, 0.9), (5.0, 50.0)


def read(out: Path, most_frames: int) -> Iterator[FrameList]:
    """The pictures of each part."""
    for part in PARTS:
        if (out / part).is_dir() and not (out / part).is_symlink():
            yield FrameList(part, _frames(out, part, most_frames), "picture")


def _frames(out: Path, part: str, most: int) -> Iterator[ReadFrame]:
    for folder in sorted(path for path in (out / part).iterdir() if path.is_dir()):
        log = Log(out, LogFiles(part, folder.name))
        found = [(int(match["timestamp"]), path) for path in folder.glob("sensors/cameras/*/*")
                 if (match := IMAGE.fullmatch(path.name))]  # fmt: skip
        cameras = list(log.lenses)
        for timestamp_ns, path in sorted(found, key=lambda pair: (pair[0], pair[1].parent.name)):
            if most == 0:
                return
            most -= 1
            camera = path.parent.name
            if camera not in log.lenses or camera not in log.sensors:
                raise FormatError(f"{out / log.files.intrinsics}: expected a row of {camera}, got none")
            name = str(path.relative_to(out))
            yield ReadFrame(name, str(path), name, (log, camera, timestamp_ns, camera == cameras[0]))


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The camera of every picture; of an instant the boxes, the sweep and the map."""
    log, camera, timestamp_ns, is_first = frame.content
    if timestamp_ns not in log.poses:
        raise FormatError(f"{log.out / log.files.poses}: expected a pose at {timestamp_ns}, got none")
    city_from_ego = log.poses[timestamp_ns]
    compared = _camera(log, camera, city_from_ego, truth)
    if not is_first:
        return compared
    compared += _boxes(log, timestamp_ns, city_from_ego, truth) + _sweep(log, timestamp_ns, city_from_ego, truth)
    return compared + _map(log.map, truth)


def _camera(log: Log, name: str, city_from_ego: Float[np.ndarray, "4 4"], truth: SourceSample) -> Comparison:
    """How far places that a camera sees are from their pixels."""
    camera, (k, size_px) = truth.labels.camera, log.lenses[name]
    if size_px != (camera.width_px, camera.height_px):
        text = f"camera {name}: expected a size of {camera.width_px}x{camera.height_px}, got {size_px[0]}x{size_px[1]}"
        return Comparison(problems=(text,))
    shares = np.array([(u, v, depth) for u in SHARES for v in SHARES for depth in DEPTHS_M])
    uv = shares[:, :2] * size_px
    world = transform(camera.world_from_cam, camera.points(uv, shares[:, 2]))
    x, y, z = transform(invert(log.sensors[name]) @ invert(city_from_ego), world).T
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.column_stack([k[0, 2] + k[0, 0] * x / z, k[1, 2] + k[1, 1] * y / z])
    apart = np.where(z > 0, np.linalg.norm(found - (uv - 0.5), axis=1), np.inf)
    return Comparison.within([Gap.of(f"camera {name}", "px", apart, "camera")], {"px": LIMIT_PX})


def _boxes(log: Log, timestamp_ns: int, city_from_ego: Float[np.ndarray, "4 4"], truth: SourceSample) -> Comparison:
    """Corners of boxes in metres, their class, points and track."""
    table = log.annotations
    rows = np.flatnonzero(table["timestamp_ns"] == timestamp_ns)
    poses, items = matrices({key: table[key][rows] for key in table}), list(truth.labels.objects or ())
    problems, gaps, tracks, left = list[str](), list[Gap](), dict[str, str](), {item.id: item for item in items}
    world_from_cam = truth.labels.camera.world_from_cam
    for row, pose in zip(rows.tolist(), poses, strict=True):
        size = np.array([table[key][row] for key in ("length_m", "width_m", "height_m")])
        found = transform(city_from_ego @ pose, CORNERS[:, [1, 0, 2]] * [1, -1, 1] * size / 2)
        middle = found.mean(axis=0)
        if not left:
            problems.append(f"object {table['track_uuid'][row]}: expected one of the labels, got none left")
            continue
        ours = {item: transform(world_from_cam, one.corners_cam) for item, one in left.items()}
        nearest = min(ours, key=lambda item: float(np.linalg.norm(ours[item].mean(axis=0) - middle)))
        item = left.pop(nearest)
        gaps.append(Gap.of(f"object {item.id}", "m", np.linalg.norm(found - ours[item.id], axis=1), "box"))
        tracks[str(table["track_uuid"][row])] = f"object {item.id} of {log.files}"
        if table["category"][row] != CATEGORIES[item.category]:
            problems.append(f"object {item.id}: expected {CATEGORIES[item.category]}, got {table['category'][row]}")
        if table["num_interior_pts"][row] != (item.lidar_points or 0):
            expected, got = item.lidar_points or 0, table["num_interior_pts"][row]
            problems.append(f"object {item.id}: expected {expected} points of the lidar on it, got {got}")
    problems += (f"expected {item.category} {item.id}, got it in no row" for item in left.values())
    return Comparison.within(gaps, {"m": BOX_M}).because(problems) + Comparison(tracks=tracks)


def _sweep(log: Log, timestamp_ns: int, city_from_ego: Float[np.ndarray, "4 4"], truth: SourceSample) -> Comparison:
    """How far points of the lidar are from those of our sweep."""
    found, camera = log.sweep(timestamp_ns), truth.labels.camera
    ours = np.zeros((0, 3)) if truth.sweep is None else truth.sweep.points().xyz_cam
    if len(found) != len(ours):
        return Comparison(problems=(f"expected {len(ours)} points of the lidar, got {len(found)}",))
    if not len(ours):
        return Comparison()
    apart = np.linalg.norm(transform(city_from_ego, found) - transform(camera.world_from_cam, ours), axis=1)
    compared = Comparison.within([Gap.of("points of the lidar", "m", apart, "sweep")], {"m": POINT_M})
    lidar = truth.labels.lidar
    assert lidar is not None, "a sweep has a lidar"
    place = (city_from_ego @ log.sensors["up_lidar"])[:3, 3] if "up_lidar" in log.sensors else np.full(3, np.nan)
    off_m = float(np.linalg.norm(place - (camera.world_from_cam @ lidar.cam_from_lidar)[:3, 3]))
    problems = [] if off_m <= POINT_M else [f"expected the lidar at its place, got it {off_m:.3g} m off"]
    return compared.because(problems)


def _map(found: LogMap, truth: SourceSample) -> Comparison:
    """Lanes in metres; sides, links, neighbours and paint; crossings, areas and heights."""
    segments = truth.labels.graph.segments
    pieces = {place_of(lane.id): lane for lane in found.lanes}
    if any(not 0 <= i < len(segments) for i, _ in pieces) or len(pieces) < len(found.lanes):
        text = f"expected ids of lanes of their own, those of {len(segments)} segments, got {[*pieces][:20]}"
        return Comparison(problems=(text,))
    lanes: PiecesOf = {}
    for i, number in sorted(pieces):
        lanes.setdefault(segments[i].id, []).append(pieces[i, number])
    middles = [(name, np.concatenate([_middle(piece) for piece in lane])) for name, lane in lanes.items()]
    compared = compare_map(middles, truth, RULE)
    halves_m = dict(zip(lanes, half_widths(truth.scene, list(lanes)), strict=True))
    problems = [*_side_problems(lanes, halves_m), *_link_problems(lanes, truth)]
    problems += [*_neighbour_problems(lanes, truth, halves_m), *_paint_problems(lanes, truth)]
    return compared.because([*problems, *_crossing_problems(found, truth), *_ground_problems(found, truth)])


def _middle(lane: LogLane) -> Float[np.ndarray, "n 3"]:
    """The middle between boundaries with a point on each side; otherwise each is cut anew at equal shares."""
    left, right = lane.left, lane.right
    if len(left) != len(right):
        left, right = (resampled(line, 100) for line in (left, right))
    return (left + right) / 2


def _side_problems(lanes: PiecesOf, halves_m: HalvesOf) -> Iterator[str]:
    """Findings where a boundary is on the other side, or not half a lane's width from the middle."""
    for name, pieces in lanes.items():
        least_m, most_m = halves_m[name]
        for lane in pieces:
            middle = _middle(lane)[:, :2]
            dx, dy = np.gradient(middle, axis=0).T
            for side, sign, line in (("left", 1, lane.left), ("right", -1, lane.right)):
                if len(line) != len(middle):
                    continue
                x, y = (line[:, :2] - middle).T
                got_m = float(np.median(sign * (dx * y - dy * x) / np.maximum(np.hypot(dx, dy), 1e-9)))
                if not least_m - SIDE_M <= got_m <= most_m + SIDE_M:
                    yield f"lane {name}: expected its {side} boundary {most_m:.3f} m on that side, got {got_m:.3f} m"


def _link_problems(lanes: PiecesOf, truth: SourceSample) -> Iterator[str]:
    """Findings where links are not those of the lane graph and between pieces, or lanes do not meet."""
    graph = truth.labels.graph
    links = [pair for pieces in lanes.values() for pair in pairwise(pieces)]
    links += (
        (pieces[-1], lanes[after][0])
        for name, pieces in lanes.items()
        for after in graph.successors.get(name, ())
        if after in lanes
    )
    pairs = [(a, b) for a, after in graph.successors.items() for b in after if a in lanes and b in lanes]
    gaps_m = {(lanes[a][-1].id, lanes[b][0].id): gap_m for (a, b), gap_m in link_gaps(truth.scene, pairs).items()}
    for name, lane in ((name, piece) for name, pieces in lanes.items() for piece in pieces):
        after = {to.id for one, to in links if one is lane}
        before = {one.id for one, to in links if to is lane}
        for word, got, expected in (("follow", lane.successors, after), ("precede", lane.predecessors, before)):
            if sorted(got) != sorted(expected):
                yield f"lane {name}: expected {sorted(expected) or 'none'} to {word} {lane.id}, got {got or 'none'}"
        for other in (to for one, to in links if one is lane):
            gap_m = float(np.linalg.norm(_middle(lane)[-1] - _middle(other)[0]))
            if not gap_m <= GAP_M + gaps_m.get((lane.id, other.id), 0.0):
                yield f"lane {name}: expected {other.id} to begin where {lane.id} ends, got it {gap_m:.3f} m away"


def _neighbour_problems(lanes: PiecesOf, truth: SourceSample, halves_m: HalvesOf) -> Iterator[str]:
    """Findings where a lane has another neighbour than in the lane graph: to the left it may have an oncoming one,
    across a line that both share."""
    owner = {piece.id: (name, piece) for name, pieces in lanes.items() for piece in pieces}
    by_id = {segment.id: segment for segment in truth.labels.graph.segments}
    for name, lane in ((name, piece) for name, pieces in lanes.items() for piece in pieces):
        segment, is_oncoming = by_id[name], _is_oncoming(by_id[name])
        # On a map left and right are those of the lane's traffic.
        swaps = is_oncoming and truth.scene.map is None
        sides = (segment.right, segment.left) if swaps else (segment.left, segment.right)
        for side, number, wanted in zip(
            ("left", "right"), (lane.left_neighbor_id, lane.right_neighbor_id), sides, strict=True
        ):
            got, other = (None, None) if number is None else owner.get(number, (str(number), None))
            apart_m = 0.0 if got is None else np.inf
            if other is not None:
                own, its = (lane.left, other.left if wanted is None else other.right)
                own, its = (own, its) if side == "left" else (lane.right, other.left)
                apart_m = float(distances(own, its).min())
            is_across = wanted is None and side == "left" and got in lanes
            is_across = is_across and is_oncoming != _is_oncoming(by_id[str(got)])
            # Where a lane opens, it is beside its neighbour only farther on.
            most_m = RULE.slack if is_across else 2 * halves_m[name][1]
            if not (got == (wanted if wanted in lanes else None) or is_across) or not apart_m <= most_m:
                yield f"lane {name}: expected {wanted} on its {side}, got {got}, {apart_m:.3g} m off"


def _is_oncoming(segment: Segment) -> bool:
    return segment.s_start_m > segment.s_end_m


def _paint_problems(lanes: PiecesOf, truth: SourceSample) -> Iterator[str]:
    """Findings where a boundary has other paint than the delimiter along which it runs where the labels reach it."""
    world = {lane.id: transform(truth.labels.camera.world_from_cam, lane.xyz_cam) for lane in truth.labels.lanes}
    ours = [(lane, world[lane.id]) for lane in truth.labels.lanes
            if lane.kind == "delimiter" and len(lane.xyz_cam) > 1]  # fmt: skip
    by_id = {segment.id: segment for segment in truth.labels.graph.segments}
    for name, pieces in lanes.items():
        is_oncoming = _is_oncoming(by_id[name])
        paths = [world[path] for path in by_id[name].centerlines if len(world.get(path, ())) > 1]
        for side in ("left", "right"):
            fine = resampled(np.concatenate([getattr(piece, side) for piece in pieces]), 200)
            reached = np.any([is_beside(fine, path) for path in paths], axis=0) if paths else np.zeros(len(fine), bool)
            # Along the paper's lanes paint does not change; on a map the labels may not reach what most of it is.
            if truth.scene.map is not None and np.count_nonzero(reached) <= MOST * len(fine):
                continue
            fine = fine[reached]
            close = [paint for paint, points in ours if _runs_along(fine, points)]
            expected = _mark_type(close[0], is_oncoming) if len(close) == 1 else ""
            got = {getattr(piece, f"{side}_lane_mark_type") for piece in pieces}
            if expected and got != {expected}:
                told = ", ".join(sorted(got))
                yield f"lane {name}: expected {expected} on its {side}, as {close[0].id} is painted, got {told}"


def _runs_along(points: Float[np.ndarray, "n 3"], line: Float[np.ndarray, "m 3"]) -> bool:
    """Whether most of the points are on a line; most lines are too far away to be asked point by point."""
    low, high = line.min(axis=0) - ON_LINE_M, line.max(axis=0) + ON_LINE_M
    around = points[((points > low) & (points < high)).all(axis=1)]
    least = max(LEAST_POINTS, ON_LINE * len(points))
    return len(around) >= least and int((distances(around, line) < ON_LINE_M).sum()) >= least


def _mark_type(paint: Lane, is_oncoming: bool) -> str:
    pair = paint.pair
    if pair is not None and is_oncoming:
        pair = "dashed_solid" if pair == "solid_dashed" else "solid_dashed"
    return mark_type(paint.marking, paint.color, paint.double, pair)


def _crossing_problems(found: LogMap, truth: SourceSample) -> Iterator[str]:
    """Findings where crossings are not the crosswalks of the labels."""
    pose = truth.labels.camera.world_from_cam
    ours = [transform(pose, symbol.xyz_cam) for symbol in truth.labels.symbols if symbol.kind == "crosswalk"]
    if len(ours) != len(found.crossings):
        yield f"expected {len(ours)} pedestrian crossings, got {len(found.crossings)}"
    for corners in found.crossings:
        apart = [float(distances(corners, np.concatenate([line, line[:1]])).max()) for line in ours]
        if len(corners) != 4 or not min(apart, default=np.inf) <= RULE.limit:
            yield f"expected a pedestrian crossing on a crosswalk, got it {min(apart, default=np.inf):.3g} m away"


def _ground_problems(found: LogMap, truth: SourceSample) -> Iterator[str]:
    """Findings where lanes are not in a drivable area or not on the ground's heights."""
    outlines = [shapely.make_valid(shapely.Polygon(outline[:, :2])) for outline in found.areas if len(outline) > 2]
    area = shapely.buffer(shapely.union_all(outlines), SEAM_M)
    shapely.prepare(area)
    for lane in truth.labels.lanes:
        if lane.kind != "centerline":
            continue
        points = transform(truth.labels.camera.world_from_cam, lane.xyz_cam)
        inside = shapely.contains_xy(area, points[:, 0], points[:, 1])
        if not inside.all():
            yield f"lane {lane.id}: expected it in the drivable areas, got {int((~inside).sum())} points outside"
        over_m = np.abs(found.height(points[:, :2]) - points[:, 2])
        # Where a ramp leaves a road, the higher one is the ground.
        if not np.median(over_m) <= GROUND_M:
            yield f"lane {lane.id}: expected the ground at its height, got it {np.median(over_m):.3g} m away"
