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
    FROM_MIDDLE,
    Comparison,
    Gap,
    Rule,
    SourceSample,
    compare_boxes,
    compare_pinhole,
    compare_sweep,
    distances,
    is_beside,
    stations,
)
from synth3dlanes.formats.comparing_maps import (
    FoundLane,
    area_problems,
    compare_map,
    half_widths,
    link_problems,
    side_problems,
    symbol_problems,
)
from synth3dlanes.formats.format import ReadFrame
from synth3dlanes.formats.nuscenes.tables import (
    CATEGORIES,
    ELEMENTS,
    FRONT_CAMERA,
    LIDAR,
    REAR_M,
    Arc,
    CameraPicture,
    PlaceMap,
    Row,
    Version,
    attribute_of,
    map_file,
    matrix_of,
    parked_of,
    points_of,
    segment_type,
    token,
    visibility_of,
)
from synth3dlanes.formats.reading import read_file
from synth3dlanes.formats.writing import objects_of
from synth3dlanes.geometry.frames import invert, transform, turned
from synth3dlanes.labels.labels import MIRRORED, Labels, Lane
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.system.arrays import Matrix4, Points2, Points3
from synth3dlanes.system.errors import FormatError

# Lanes are within this of the labels from above: arcs are fitted, and on a slope heights between the labels' points
# count too, for which other formats have a limit of their own. A map has no heights.
RULE = Rule("m", 0.1, name="lane", slack=np.inf)
LIMIT_PX, BOX_M, POINT_M, POSE_M = 0.02, 0.001, 0.001, 0.001
GAP_M, LEVEL_TOLERANCE, ARC_STEP_M = 0.03, 1e-6, 0.5
# A label's line between two lanes is in a map if the share ON_LINE of it is within ON_LINE_M of dividers.
ON_LINE_M, ON_LINE, LEAST_POINTS = 0.06, 0.9, 10
# The largest share of a line with a lane on one side only along which it may be one between lanes, farther on.
MAX_ONE_SIDED_SHARE = 0.5
# The most that lanes of the other direction are beyond the line beside a median.
FACING_M = 25.0
# How far from a lane's middle its polygon may end.
AREA_M = 0.05
TURN = {"L": 1, "S": 0, "R": -1}
EGO_FROM_HOST = np.array([[0, 1.0, 0, REAR_M], [-1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])
CV_FROM_OURS = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
MapLine = Float[np.ndarray, "_ 2"]


def verify(frame: ReadFrame, truth: SourceSample) -> Comparison:
    """The camera and the pose of every picture; of a sample the boxes, the sweep and the map."""
    picture: CameraPicture = frame.content
    global_from_ego = picture.pose(picture.data)
    global_from_cam = global_from_ego @ matrix_of(picture.calibrated(picture.data)) @ CV_FROM_OURS
    compared = _camera(picture, truth) + _pose(picture, global_from_ego, global_from_cam, truth)
    if not picture.is_first or compared.problems:
        return compared
    compared += _boxes(picture, global_from_cam, truth) + _sweep(picture, global_from_cam, truth)
    return compared + _map(picture, global_from_cam, truth)


def _camera(picture: CameraPicture, truth: SourceSample) -> Comparison:
    """How far places that a camera sees are from their pixels, by its place on the vehicle."""
    camera, mounted, data = truth.labels.camera, truth.scene.camera, picture.data
    calibrated = picture.calibrated(data)
    if len(calibrated.camera_intrinsic) != 3:
        return Comparison(problems=(f"camera {picture.channel}: expected a matrix, got none",))
    host_from_cam = turned(0.0, mounted.right_m, mounted.forward_m) @ camera.road_from_cam
    cv_from_cam = invert(matrix_of(calibrated)) @ EGO_FROM_HOST @ host_from_cam
    k, size_px = np.array(calibrated.camera_intrinsic) + FROM_MIDDLE, (data.width, data.height)
    return compare_pinhole(picture.channel, camera, k, cv_from_cam, LIMIT_PX, size_px)


def _pose(
    picture: CameraPicture, global_from_ego: Matrix4, global_from_cam: Matrix4, truth: SourceSample
) -> Comparison:
    """How far places are from where the first picture of the scene has them; the first vehicle must be level."""
    global_from_world = global_from_cam @ invert(truth.labels.camera.world_from_cam)
    anchor = picture.version.anchors.setdefault(picture.scene.token, global_from_world)
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
    rows, parked = version.boxes.get(picture.data.sample_token, []), parked_of(truth.scene, truth.labels.objects or ())
    # Sizes are width, length and height.
    corners = (transform(matrix_of(row), FLU_CORNERS * np.array(row.size)[[1, 0, 2]] / 2) for row in rows)

    def expected(item: ObjectLabel) -> dict[str, object]:
        return {
            "class": CATEGORIES[item.category],
            "attribute": attribute_of(item, item.id in parked),
            "level of visibility": visibility_of(seen[item.id]),
            "number of points": points_of(item.lidar_points, seen[item.id]),
        }

    told = zip((row.instance_token for row in rows), corners, map(partial(_told, version), rows), strict=True)
    items = objects_of(truth.labels, CATEGORIES)
    return compare_boxes(told, items, expected, global_from_cam, picture.log.logfile, BOX_M)


def _told(version: Version, row: Row) -> dict[str, object]:
    """What a box tells but for its place and size."""
    category = version.row("instance", row.instance_token).category_token
    attributes = [version.row("attribute", name).name for name in row.attribute_tokens]
    return {
        "class": version.row("category", category).name,
        "attribute": ", ".join(attributes) or None,
        "level of visibility": row.visibility_token,
        "number of points": row.num_lidar_pts,
    }


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
    cam_from_lidar = invert(global_from_cam) @ picture.pose(data) @ matrix_of(picture.calibrated(data))
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
    links = found.layers.connectivity
    try:
        paths = {name: _places(arcs) for name, arcs in found.layers.arcline_path_3.items() if name in names and arcs}
        lanes = [
            FoundLane(names[name], names[name], path,
                      *([names.get(at, at) for at in ids] for ids in (links[name].outgoing, links[name].incoming)))
            for name, path in paths.items()
        ]  # fmt: skip
        global_from_world = global_from_cam @ invert(truth.labels.camera.world_from_cam)
        halves_m = half_widths(truth.scene, [lane.segment for lane in lanes], global_from_world)
        problems = [
            *_side_problems(found, {names[name]: (name, path) for name, path in paths.items()}, halves_m),
            *link_problems(lanes, truth, GAP_M),
            *_divider_problems(found, above.labels),
            *_thing_problems(found, above, truth, global_from_cam),
        ]
    except KeyError as error:
        path = picture.version.out / map_file(picture.log.location)
        raise FormatError(f"{path}: expected a record with the token {error}, got none") from None
    flat = [(lane.segment, np.column_stack([lane.middle, np.zeros(len(lane.middle))])) for lane in lanes]
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


def _side_problems(
    found: PlaceMap, paths: Mapping[str, tuple[str, Points2]], halves_m: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    """Findings where a boundary is on the other side, or not half a lane's width from the middle, or the middle is not
    in the lane's polygon."""
    own = {lane.token: lane for lane in (*found.layers.lane, *found.layers.lane_connector)}
    for name, (key, path) in paths.items():
        if key not in own:
            yield f"lane {name}: expected a polygon, got none"
            continue
        area = shapely.buffer(found.polygons[own[key].polygon_token], AREA_M)
        if not shapely.contains_xy(area, *path.T).all():
            yield f"lane {name}: expected its middle in its polygon, got it outside"
        if own[key] in found.layers.lane:
            nodes = {side: getattr(own[key], f"{side}_lane_divider_segments") for side in ("left", "right")}
            lines = {side: found.places([at.node_token for at in of]) for side, of in nodes.items()}
            yield from side_problems(name, path, lines, halves_m[name])


def _divider_problems(found: PlaceMap, labels: Labels) -> Iterator[str]:
    """Findings where a painted line between two lanes is no divider, or one of another kind or paint."""
    centers = {lane.id: lane for lane in labels.lanes if lane.kind == "centerline" and len(lane.xyz_cam) > 1}
    kinds: dict[str, list[tuple[Points2, set[str] | None]]] = {
        "road divider": [(found.lines[row.line_token], None) for row in found.layers.road_divider],
        "lane divider": [
            (found.lines[row.line_token], {of.segment_type for of in row.lane_divider_segments})
            for row in found.layers.lane_divider
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
        return text.replace(line.pair.upper(), MIRRORED[line.pair].upper())
    return text


def _thing_problems(
    found: PlaceMap, above: SourceSample, truth: SourceSample, global_from_cam: Matrix4
) -> Iterator[str]:
    """Findings where symbols, signals or the pavement below lanes are not in the map."""
    layers = found.layers
    for word, rows, kinds in (
        ("pedestrian crossing", layers.ped_crossing, ("crosswalk",)),
        ("stop line", layers.stop_line, ("stop_line", "give_way_line")),
    ):
        outlines = [np.array(found.polygons[row.polygon_token].exterior.coords)[:-1] for row in rows]
        flat = [np.column_stack([outline, np.zeros(len(outline))]) for outline in outlines]
        yield from symbol_problems(word, flat, above, kinds, RULE.limit, is_whole=False)
    lights = np.array([(row.pose.tx, row.pose.ty, row.pose.tz) for row in layers.traffic_light]).reshape(-1, 3)
    for item in truth.labels.traffic_elements or ():
        if item.category in ELEMENTS:
            (place,) = transform(global_from_cam, item.center_cam[None])
            off_m = float(np.linalg.norm(lights - place, axis=1).min(initial=np.inf))
            if not off_m <= RULE.limit:
                yield f"expected a traffic light at that of the labels, got none nearer than {off_m:.3g} m"
    names = [name for row in layers.drivable_area for name in row.polygon_tokens]
    yield from area_problems(shapely.buffer(shapely.union_all([found.polygons[at] for at in names]), RULE.limit), above)
