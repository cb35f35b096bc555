"""Read a nuScenes export back and compare it with our labels: what its cameras see in pixels; poses, boxes, sweeps and
lanes in metres. Maps are compared from above, in the global frame."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from synth3dlanes.formats.comparing import (
    FLU_CORNERS,
    Comparison,
    Gap,
    Rule,
    SourceSample,
    compare_boxes,
    compare_camera,
    compare_map,
    compare_sweep,
    distances,
    is_beside,
    pinhole_pixels,
    stations,
)
from synth3dlanes.formats.format import ReadFrame
from synth3dlanes.formats.lane_map import link_gaps
from synth3dlanes.formats.nuscenes.convention import (
    CATEGORIES,
    ELEMENTS,
    FRONT_CAMERA,
    LIDAR,
    REAR_M,
    VISIBLE,
    attributes_of,
    map_file,
    segment_type,
    token,
)
from synth3dlanes.formats.nuscenes.read import Arc, CameraPicture, InstanceRow, LaneOfMap, NamedRow, PlaceMap
from synth3dlanes.formats.reading import read_file
from synth3dlanes.formats.writing import objects_of
from synth3dlanes.geometry.frames import invert, transform, turned
from synth3dlanes.labels.labels import Labels, Lane
from synth3dlanes.system.arrays import Matrix4, Points2, Points3
from synth3dlanes.system.errors import FormatError
from synth3dlanes.world.world import scene_network

# Lanes are within this of the labels from above: arcs are fitted, and on a slope heights between the labels' points
# count too, for which other formats have a limit of their own. A map has no heights.
RULE = Rule("m", 0.1, name="lane", slack=np.inf)
LIMIT_PX, BOX_M, POINT_M, POSE_M = 0.02, 0.001, 0.001, 0.001
SIDE_M, GAP_M, LEVEL_TOLERANCE = 0.05, 0.03, 1e-6
# A label's line between two lanes is in a map if the share ON_LINE of it is within ON_LINE_M of dividers.
ON_LINE_M, ON_LINE, LEAST_POINTS = 0.06, 0.9, 10
# The largest share of a line with a lane on one side only along which it may be one between lanes, farther on.
MAX_ONE_SIDED_SHARE = 0.5
# The most that lanes of the other direction are beyond the line beside a median.
FACING_M = 25.0
# Length over which an endless road of the paper is measured.
ARC_STEP_M, ENDLESS_M = 0.5, 300.0
TURN = {"L": 1, "S": 0, "R": -1}
MIRRORED = {"SOLID_DASHED": "DASHED_SOLID", "DASHED_SOLID": "SOLID_DASHED"}
EGO_FROM_HOST = np.array([[0, 1.0, 0, REAR_M], [-1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])
CV_FROM_OURS = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


MapLine = Float[np.ndarray, "_ 2"]


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The camera and the pose of every picture; of a sample the boxes, the sweep and the map."""
    picture: CameraPicture = frame.content
    global_from_ego = picture.pose(picture.data)
    global_from_cam = global_from_ego @ picture.calibrated(picture.data).matrix @ CV_FROM_OURS
    compared = _camera(picture, truth) + _pose(picture, global_from_ego, global_from_cam, truth)
    if not picture.is_first or compared.problems:
        return compared
    compared += _boxes(picture, global_from_cam, truth) + _sweep(picture, global_from_cam, truth)
    return compared + _map(picture, global_from_cam, truth)


def _camera(picture: CameraPicture, truth: SourceSample) -> Comparison:
    """How far places that a camera sees are from their pixels, by its place on the vehicle."""
    camera, mounted, data = truth.labels.camera, truth.scene.camera, picture.data
    calibrated = picture.calibrated(data)
    if (data.width, data.height) != (camera.width_px, camera.height_px) or len(calibrated.camera_intrinsic) != 3:
        expected = f"a matrix and a size of {camera.width_px}x{camera.height_px}"
        return Comparison(problems=(f"camera: expected {expected}, got {data.width}x{data.height}",))
    host_from_cam = turned(0.0, mounted.right_m, mounted.forward_m) @ camera.road_from_cam
    img_from_cv = np.array(calibrated.camera_intrinsic) + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    cv_from_cam = invert(calibrated.matrix) @ EGO_FROM_HOST @ host_from_cam
    return compare_camera(picture.channel, camera, partial(pinhole_pixels, img_from_cv, cv_from_cam), LIMIT_PX)


def _pose(
    picture: CameraPicture, global_from_ego: Matrix4, global_from_cam: Matrix4, truth: SourceSample
) -> Comparison:
    """How far places are from where the first picture of the scene has them; the first vehicle must be level."""
    global_from_world = global_from_cam @ invert(truth.labels.camera.world_from_cam)
    anchor = picture.version.anchors.setdefault(picture.sample.scene_token, global_from_world)
    around = truth.labels.camera.world_from_cam[:3, 3] + 50 * np.eye(3)
    apart = np.linalg.norm(transform(global_from_world, around) - transform(anchor, around), axis=1)
    compared = Comparison.within([Gap.of("the vehicle", "m", apart, "pose")], {"m": POSE_M})
    is_level = np.abs([*(global_from_ego[:3, 2] - [0, 0, 1]), global_from_ego[2, 3]]).max() < LEVEL_TOLERANCE
    if picture.data.sample_token == picture.scene.first_sample_token and not is_level:
        return compared.because(["expected the first vehicle of the scene level and at height 0, got another pose"])
    return compared


def _boxes(picture: CameraPicture, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """Corners of boxes in metres, their class, attribute, visibility, points and track."""
    version, seen = picture.version, _seen(picture, truth)
    rows = version.boxes.get(picture.data.sample_token, [])
    # Sizes are width, length and height.
    corners = (transform(row.matrix, FLU_CORNERS * np.array(row.size)[[1, 0, 2]] / 2) for row in rows)
    boxes, items = zip((row.instance_token for row in rows), corners, strict=True), objects_of(truth.labels, CATEGORIES)
    compared, matched = compare_boxes(boxes, items, global_from_cam, picture.log.logfile, BOX_M)
    problems = list[str]()
    for row, item in zip(rows, matched, strict=True):
        if item is None:
            continue
        instance = version.row("instance", InstanceRow, row.instance_token)
        attributes = [version.row("attribute", NamedRow, name).name for name in row.attribute_tokens]
        speed_m_s = None if item.velocity_cam is None else float(np.linalg.norm(item.velocity_cam))
        names = attributes_of(CATEGORIES[item.category], speed_m_s)
        allowed: list[tuple[str, ...]] = [(name,) for name in names] or [()]
        shares = None if seen[item.id] is None else str(1 + sum(seen[item.id] >= least for least in VISIBLE))
        points = int(bool(seen[item.id])) if item.lidar_points is None else item.lidar_points
        for what, got, expected in (
            ("class", version.row("category", NamedRow, instance.category_token).name, [CATEGORIES[item.category]]),
            ("attribute", tuple(attributes), allowed),
            ("level of visibility", row.visibility_token, [shares or ""]),
            ("number of points", row.num_lidar_pts, [points]),
        ):
            if got not in expected:
                problems.append(f"object {item.id}: expected the {what} {expected[0]}, got {got}")
    return compared.because(problems)


def _seen(picture: CameraPicture, truth: SourceSample) -> dict[int, Any]:
    """The greatest share of each object that a camera of the sample sees, None where nothing is known of it."""
    channels, found = picture.version.sensors[picture.data.sample_token], dict[int, Any]()
    for other in truth.moment:
        if (other.labels.camera.name or FRONT_CAMERA) in channels:
            for item in other.labels.objects or ():
                shares = (item.visible_fraction, found.get(item.id))
                found[item.id] = max((share for share in shares if share is not None), default=None)
    return found


def _sweep(picture: CameraPicture, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """How far points of the lidar are from those of our sweep."""
    data = picture.version.sensors[picture.data.sample_token].get(LIDAR)
    if data is None:
        return Comparison(problems=(f"expected a sweep of {LIDAR}, got none",))
    path, numbers = picture.version.out / data.filename, read_file(picture.version.out / data.filename)
    if len(numbers) % 20:
        raise FormatError(f"{path}: expected points of five numbers of 4 bytes, got {len(numbers)} bytes")
    found = np.frombuffer(numbers, "<f4").reshape(-1, 5).astype(float)
    cam_from_lidar = invert(global_from_cam) @ picture.pose(data) @ picture.calibrated(data).matrix
    compared = compare_sweep(transform(cam_from_lidar, found[:, :3]), truth, POINT_M)
    is_other = bool(compared.gaps and truth.sweep is not None and (found[:, 4] != truth.sweep.points().beam).any())
    return compared.because(["expected the beams of our sweep, got others"] if is_other else [])


class _FromAbove(SourceSample):
    """A sample whose world frame is an export's global frame, and whose lines lie in its plane."""

    def __init__(self, truth: SourceSample, global_from_cam: Matrix4) -> None:
        super().__init__(truth.reader, truth.place)
        self.global_from_cam = global_from_cam

    @cached_property
    def labels(self) -> Labels:
        own = SourceSample(self.reader, self.place).labels
        lanes = tuple(replace(lane, xyz_cam=self._flat(lane.xyz_cam)) for lane in own.lanes)
        symbols = tuple(replace(symbol, xyz_cam=self._flat(symbol.xyz_cam)) for symbol in own.symbols)
        return replace(own, camera=replace(own.camera, world_from_cam=np.eye(4)), lanes=lanes, symbols=symbols)

    def _flat(self, points_cam: Points3) -> Points3:
        return np.asarray(transform(self.global_from_cam, points_cam) * [1, 1, 0])


def _map(picture: CameraPicture, global_from_cam: Matrix4, truth: SourceSample) -> Comparison:
    """Lanes in metres; sides, links and paint; what else is on the road."""
    found, above = picture.version.map(picture.log.location), _FromAbove(truth, global_from_cam)
    names = {token(picture.log.logfile, "lane", segment.id): segment.id for segment in truth.labels.graph.segments}
    try:
        paths = {names[key]: _places(arcs) for key, arcs in found.arcline_path_3.items() if key in names and arcs}
        problems = [
            *_side_problems(found, names, paths, _half_widths(truth, [*paths], global_from_cam)),
            *_link_problems(found, names, paths, truth),
            *_divider_problems(found, above.labels),
            *_thing_problems(found, above.labels, truth, global_from_cam),
        ]
    except KeyError as error:
        path = picture.version.out / map_file(picture.log.location)
        raise FormatError(f"{path}: expected a record with the token {error}, got none") from None
    flat = [(name, np.column_stack([path, np.zeros(len(path))])) for name, path in paths.items()]
    return compare_map(flat, above, RULE).because(problems)


def _places(arcs: list[Arc]) -> Points2:
    """Places along the arcs of a path."""
    found = list[tuple[float, float]]()
    for arc in arcs:
        x, y, yaw = arc.start_pose
        for letter, length in zip(arc.shape, arc.segment_length, strict=False):
            k = TURN.get(letter, 0) / arc.radius
            steps = np.linspace(0, length, 1 + max(1, int(np.ceil(length / ARC_STEP_M)))) if length else np.zeros(1)
            # sinc keeps straight pieces in the same formula: the chord of an arc, in the direction of its middle.
            chords, headings = steps * np.sinc(k * steps / 2 / np.pi), yaw + k * steps / 2
            found += zip(x + chords * np.cos(headings), y + chords * np.sin(headings), strict=True)
            (x, y), yaw = found[-1], yaw + k * length
    return np.array(found)


def _half_widths(truth: SourceSample, names: list[str], global_from_cam: Matrix4) -> dict[str, tuple[float, float]]:
    """Half the least and the greatest width of each lane from above: in a tilted plane, that of its edges in space."""
    global_from_world = global_from_cam @ invert(truth.labels.camera.world_from_cam)
    found, network = dict[str, tuple[float, float]](), scene_network(truth.scene)
    for name in names:
        lane = network.lanes[name]
        road = network.road(lane.road)
        first_m, last_m = np.nan_to_num([lane.start_m, lane.end_m], posinf=ENDLESS_M, neginf=-ENDLESS_M)
        s = np.linspace(first_m, last_m, 50)
        left, right = (transform(global_from_world, road.points(s, edge(s)))[:, :2] for edge in lane.edges)
        # On a slope what is beside a place is not square to the road from above.
        (dx, dy), (x, y) = np.gradient((left + right) / 2, axis=0).T, (right - left).T
        widths_m = np.abs(dx * y - dy * x) / np.hypot(dx, dy)
        found[name] = float(widths_m.min()) / 2, float(widths_m.max()) / 2
    return found


def _side_problems(
    found: PlaceMap, names: Mapping[str, str], paths: Mapping[str, Points2], halves_m: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    """Findings where a boundary is on the other side, or not half a lane's width from the middle, or the middle is not
    in the lane's polygon."""
    own = [lane for lane in (*found.lane, *found.lane_connector) if names.get(lane.token) in paths]
    yield from (f"lane {name}: expected a polygon, got none" for name in {*paths} - {names[lane.token] for lane in own})
    for lane in own:
        name = names[lane.token]
        path, (least_m, most_m) = paths[name], halves_m[name]
        area = shapely.buffer(found.polygons[lane.polygon_token], SIDE_M)
        if not shapely.contains_xy(area, *path.T).all():
            yield f"lane {name}: expected its middle in its polygon, got it outside"
        if not isinstance(lane, LaneOfMap):
            continue
        for side, sign, segments in (
            ("left", 1, lane.left_lane_divider_segments), ("right", -1, lane.right_lane_divider_segments)
        ):  # fmt: skip
            line = found.places([segment.node_token for segment in segments])
            fine = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), 1.0)) if len(line) > 1 else line
            if not len(fine):
                yield f"lane {name}: expected a {side} boundary, got none"
                continue
            at = np.argmin(np.linalg.norm(fine[:, None] - path, axis=2), axis=1)
            (dx, dy), (x, y) = np.gradient(path, axis=0)[at].T, (fine - path[at]).T
            got_m = float(np.median(sign * (dx * y - dy * x) / np.maximum(np.hypot(dx, dy), 1e-9)))
            if not least_m - SIDE_M <= got_m <= most_m + SIDE_M:
                yield f"lane {name}: expected its {side} boundary {most_m:.3f} m on that side, got {got_m:.3f} m"


def _link_problems(
    found: PlaceMap, names: Mapping[str, str], paths: Mapping[str, Points2], truth: SourceSample
) -> Iterator[str]:
    """Findings where links are not those of the lane graph, or lanes do not meet."""
    links = [(a, b) for a, after in truth.labels.graph.successors.items() for b in after if a in paths and b in paths]
    gaps_m = link_gaps(truth.scene, links)
    for key, name in names.items():
        if name not in paths:
            continue
        got = found.connectivity[key]
        for word, tokens, expected in (
            ("follow", got.outgoing, {b for a, b in links if a == name}),
            ("precede", got.incoming, {a for a, b in links if b == name}),
        ):
            others = {names.get(other, other) for other in tokens}
            if others != expected:
                yield f"lane {name}: expected {sorted(expected) or 'none'} to {word} it, got {sorted(others) or 'none'}"
    for (a, b), most_m in gaps_m.items():
        gap_m = float(np.linalg.norm(paths[a][-1] - paths[b][0]))
        if not gap_m <= GAP_M + most_m:
            yield f"lane {a}: expected {b} to begin where it ends, got it {gap_m:.3f} m away"


def _divider_problems(found: PlaceMap, labels: Labels) -> Iterator[str]:
    """Findings where a painted line between two lanes is no divider, or one of another kind or paint."""
    centers = {lane.id: lane for lane in labels.lanes if lane.kind == "centerline" and len(lane.xyz_cam) > 1}
    kinds: dict[str, list[tuple[Points2, set[str] | None]]] = {
        "road divider": [(found.lines[row.line_token], None) for row in found.road_divider],
        "lane divider": [
            (found.lines[row.line_token], {of.segment_type for of in row.lane_divider_segments})
            for row in found.lane_divider
        ],
    }
    kinds = {kind: [divider for divider in of if len(divider[0]) > 1] for kind, of in kinds.items()}
    every = [divider for dividers in kinds.values() for divider in dividers]
    for line in labels.lanes:
        if line.kind != "delimiter" or line.junction is not None:
            continue
        sides = [centers[name] for name in (line.left, line.right) if name in centers]
        if len(sides) < 2:
            if len(line.xyz_cam) >= LEAST_POINTS and not (sides and _faces_others(line, sides[0], centers)):
                xy = line.xyz_cam[:, :2]
                on = [distances(xy, of) < ON_LINE_M for of, _ in every if _may_touch(of, xy)]
                share = np.any(on, axis=0).mean() if on else 0.0
                if share > MAX_ONE_SIDED_SHARE:
                    yield f"{line.id}: expected no divider along the edge of a road, got one along {share:.0%} of it"
            continue
        xy = line.xyz_cam[:, :2]
        xy = xy[np.all([is_beside(xy, side.xyz_cam[:, :2]) for side in sides], axis=0)]
        if len(xy) < LEAST_POINTS:
            continue
        kind = "lane divider" if len({_goes_on(side, xy) for side in sides}) == 1 else "road divider"
        near = [(of, paint, distances(xy, of) < ON_LINE_M) for of, paint in kinds[kind] if _may_touch(of, xy)]
        covered = np.any([at for _, _, at in near], axis=0).mean() if near else 0.0
        if not covered >= ON_LINE:
            yield f"{line.id}: expected a {kind} along it, got one along {covered:.0%} of it"
            continue
        for of, paint, at in near:
            if paint is not None and at.mean() > ON_LINE:
                expected = _paint(line, of, xy)
                if paint != {expected}:
                    told = ", ".join(sorted(paint))
                    yield f"{line.id}: expected the paint {expected}, got {told}"


def _faces_others(line: Lane, own: Lane, centers: Mapping[str, Lane]) -> bool:
    """Whether a line is on that side of its lane where others drive the other way, beyond a median."""
    xy, middle = line.xyz_cam[:, :2], own.xyz_cam[:, :2]
    is_onward = _goes_on(own, xy)
    for other in centers.values():
        its = other.xyz_cam[:, :2]
        if is_beside(xy, its).sum() > LEAST_POINTS and _goes_on(other, xy) != is_onward:
            apart_m = float(np.median(distances(xy, its)))
            if apart_m < min(float(np.median(distances(middle, its))), FACING_M):
                return True
    return False


def _goes_on(lane: Lane, xy: Points2) -> bool:
    """Whether the traffic of a lane goes from the first to the last of some places beside it."""
    first_m, last_m = stations(xy[[0, -1]], lane.xyz_cam[:, :2])
    return bool((last_m > first_m) != (lane.direction == "oncoming"))


def _may_touch(of: MapLine, xy: MapLine) -> bool:
    """Whether the boxes around two lines touch."""
    return bool((of.min(axis=0) <= xy.max(axis=0) + 1).all() and (of.max(axis=0) >= xy.min(axis=0) - 1).all())


def _paint(line: Lane, of: MapLine, xy: MapLine) -> str:
    """The paint of a line of the labels as the traffic along a divider sees it."""
    text = segment_type(line.marking, line.color, line.double, line.pair)
    if line.pair is not None and (xy[-1] - xy[0]) @ (of[-1] - of[0]) < 0:
        stripes = line.pair.upper()
        return text.replace(stripes, MIRRORED[stripes])
    return text


def _thing_problems(found: PlaceMap, above: Labels, truth: SourceSample, global_from_cam: Matrix4) -> Iterator[str]:
    """Findings where symbols, signals or the pavement below lanes are not in the map."""
    for word, rows, kinds in (
        ("pedestrian crossing", found.ped_crossing, ("crosswalk",)),
        ("stop line", found.stop_line, ("stop_line", "give_way_line")),
    ):
        areas = [found.polygons[row.polygon_token] for row in rows]
        for symbol in (symbol for symbol in above.symbols if symbol.kind in kinds):
            ours = shapely.Polygon(symbol.xyz_cam[:, :2])
            off_m = min((float(shapely.hausdorff_distance(ours, area)) for area in areas), default=np.inf)
            if not off_m <= RULE.limit:
                yield f"expected a {word} on a {symbol.kind}, got none nearer than {off_m:.3g} m"
    lights = np.array([(row.pose.tx, row.pose.ty, row.pose.tz) for row in found.traffic_light]).reshape(-1, 3)
    for item in truth.labels.traffic_elements or ():
        if item.category in ELEMENTS:
            (place,) = transform(global_from_cam, item.center_cam[None])
            off_m = float(np.linalg.norm(lights - place, axis=1).min(initial=np.inf))
            if not off_m <= RULE.limit:
                yield f"expected a traffic light at that of the labels, got none nearer than {off_m:.3g} m"
    names = [name for row in found.drivable_area for name in row.polygon_tokens]
    area = shapely.buffer(shapely.union_all([found.polygons[name] for name in names]), RULE.limit)
    shapely.prepare(area)
    for lane in above.lanes:
        inside = shapely.contains_xy(area, *lane.xyz_cam[:, :2].T)
        if lane.kind == "centerline" and not inside.all():
            yield f"lane {lane.id}: expected it in the drivable area, got {int((~inside).sum())} points outside"
