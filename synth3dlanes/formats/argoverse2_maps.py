"""The map of a log of Argoverse 2 around all places of the host in the clip: written, read back, and compared with the
labels. City frame, metres.

| theirs | ours |
|---|---|
| `lane_segments` | pieces of the segments of the lane graph; `id` is (segment + 1) * 1000 + piece |
| `*_lane_mark_type` | the paint along most of the segment (`mark_type`) |
| `successors`, `predecessors`, `*_neighbor_id` | links and neighbours of the lane graph |
| `drivable_areas` | strips of the pavement |
| `pedestrian_crossings` | crosswalks, by both of their edges |
"""

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from synth3dlanes.formats.comparing import Comparison, SourceSample, distances
from synth3dlanes.formats.comparing_maps import (
    FoundLane,
    MapRule,
    area_problems,
    compare_lanes,
    half_widths,
    middle_of,
    symbol_problems,
)
from synth3dlanes.formats.lane_map import LaneSegment, lane_segments
from synth3dlanes.formats.reading import read_file
from synth3dlanes.geometry.frames import transform
from synth3dlanes.geometry.polylines import distances_between, thinned
from synth3dlanes.labels.labels import LaneGraph, Marking, PaintColor, Pair, Segment
from synth3dlanes.system import schema
from synth3dlanes.system.arrays import Points3
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import Excerpt, Number
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.world import World

PIECE_M = 30.0
"""The API draws the middle of a lane segment with ten points, however long it is."""
REACH_M = 150.0
"""Reach of the map ahead of and behind all places of the host in the clip."""
MOST_PIECES = 1000
CELL_M, MARGIN_M, BLOCK = 0.3, 5.0, 16
"""Size of the cells of the ground's heights, how far beyond the pavement there are any, and cells along a block."""
LINE_M, MM_DECIMALS = 0.005, 3
"""How far written lines may be from those with all points."""
SAME_LINE_M = 0.2
GROUND_M = 0.2
# Drivable areas have seams where one begins at the end of another.
SEAM_M = 0.01
Sides = Float[np.ndarray, "_ k 3"]


def piece_id(segment: int, number: int) -> int:
    """The id of a piece of a lane segment by its place in the lane graph, from 0, and its number along it."""
    return (segment + 1) * MOST_PIECES + number


def place_of(lane_id: int) -> tuple[int, int]:
    """The inverse of `piece_id`."""
    segment, number = divmod(lane_id, MOST_PIECES)
    return segment - 1, number


def mark_type(marking: Marking, color: PaintColor | None, double: bool | None, pair: Pair | None = None) -> str:
    """The code of paint; a pair is named from the left, as the lane's traffic drives."""
    if marking == "none":
        return "NONE"
    if pair is not None:
        pattern = "SOLID_DASH" if pair == "solid_dashed" else "DASH_SOLID"
    elif double:
        pattern = "DOUBLE_SOLID" if marking == "solid" else "DOUBLE_DASH"
    else:
        pattern = "SOLID" if marking == "solid" else "DASHED"
    return f"{pattern}_{(color or 'white').upper()}"


# Lanes are within this of the labels from above; heights within the slack.
RULE = MapRule("m", 0.05, slack=0.3, word=mark_type)


class MapFiles(NamedTuple):
    """The files of a map: lanes, areas and crossings as JSON; heights of the ground as an array of numpy, and the cell
    of a place as JSON."""

    vectors: str
    heights: bytes
    cells: str


def map_files(world: World, graph: LaneGraph) -> tuple[MapFiles, int]:
    """The files of the map of a world, and how many lane segments are in it."""
    place, shot = world.view.world_from_host[:3, 3], world.scene.shot
    reach_m = REACH_M + host_driven(shot, shot.duration_s)
    strips = [np.stack(edges, axis=1) for edges in world.ground.paved.strips(place[:2], reach_m)]
    lanes = list(lane_segments(world, graph.segments, place, reach_m))
    rows = list(_lanes(lanes, graph, world))
    vectors = {
        "pedestrian_crossings": {str(row["id"]): row for row in _crossings(world)},
        "lane_segments": {str(row["id"]): row for row in rows},
        "drivable_areas": {str(i): {"area_boundary": _outline(strip), "id": i} for i, strip in enumerate(strips, 1)},
    }
    heights, west_south = _heights(world, np.concatenate([strip.reshape(-1, 3)[:, :2] for strip in strips]))
    cells = {"R": [1.0, 0.0, 0.0, 1.0], "t": (-west_south).tolist(), "s": 1 / CELL_M}
    stream = io.BytesIO()
    np.save(stream, heights)
    return MapFiles(json.dumps(vectors), stream.getvalue(), json.dumps(cells)), len(rows)


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece of a lane segment of the lane graph, as long as lane segments of the original are."""

    lane: LaneSegment
    first: int
    last: int
    number: int

    @property
    def id(self) -> int:
        return piece_id(self.lane.index, self.number)

    @property
    def left_world(self) -> Points3:
        return self.lane.left.points_world[self.first : self.last + 1]

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        return np.asarray(self.lane.points_world[(self.first + self.last) // 2])


def _pieces(lane: LaneSegment) -> list[_Piece]:
    """Lanes beside each other, with as many points, are cut at the same places."""
    length_m = float(np.linalg.norm(np.diff(lane.points_world, axis=0), axis=1).sum())
    ends = np.rint(np.linspace(0, len(lane.points_world) - 1, 1 + int(np.ceil(length_m / PIECE_M)))).astype(int)
    return [_Piece(lane, *pair, number) for number, pair in enumerate(pairwise(ends.tolist()))]


def _lanes(lanes: Sequence[LaneSegment], graph: LaneGraph, world: World) -> Iterator[dict[str, Any]]:
    pieces = {lane.id: _pieces(lane) for lane in lanes}
    for lane in lanes:
        left, right = world.network.neighbours(graph.segments[lane.index])
        opposite = [] if left else _opposite(lane, lanes, world)
        after = [pieces[name][0].id for name in graph.successors.get(lane.id, ()) if name in pieces]
        before = [pieces[name][-1].id for name in pieces if lane.id in graph.successors.get(name, ())]
        paint = [mark_type(side.marking, side.color, side.double, side.pair) for side in (lane.left, lane.right)]
        sides = np.stack([lane.left.points_world, lane.right.points_world], axis=1)
        own = pieces[lane.id]
        for piece in own:
            lines = sides[piece.first : piece.last + 1]
            # A line between both directions has the same points from either side, as in the original: MapTRv2 leaves
            # such lines out, and would take the pieces of one that has others.
            lines = lines if opposite else thinned(lines, LINE_M)
            yield {
                "id": piece.id,
                "is_intersection": lane.is_connector,
                "lane_type": "VEHICLE",
                "left_lane_boundary": _points(lines[:, 0]),
                "left_lane_mark_type": paint[0],
                "right_lane_boundary": _points(lines[:, 1]),
                "right_lane_mark_type": paint[1],
                "successors": after if piece is own[-1] else [piece.id + 1],
                "predecessors": before if piece is own[0] else [piece.id - 1],
                "right_neighbor_id": _beside(piece, pieces.get(right or "", ())),
                "left_neighbor_id": _beside(piece, _across(piece, opposite, pieces))
                if opposite
                else _beside(piece, pieces.get(left or "", ())),
            }


def _beside(piece: _Piece, others: Sequence[_Piece]) -> int | None:
    """The piece of another lane that is nearest to the middle of one."""
    return min(others, key=lambda other: float(np.linalg.norm(other.middle - piece.middle))).id if others else None


def _across(piece: _Piece, opposite: Sequence[str], pieces: Mapping[str, Sequence[_Piece]]) -> list[_Piece]:
    """The pieces of lanes of the other direction that share a stretch of the left line of one."""
    tree = cKDTree(piece.left_world)
    others = [other for name in opposite for other in pieces[name]]
    return [other for other in others if np.min(tree.query(other.left_world)[0]) < SAME_LINE_M]


def _opposite(lane: LaneSegment, lanes: Sequence[LaneSegment], world: World) -> list[str]:
    """The lanes of the other direction whose left boundaries are one line with that of a lane."""
    found, own = [], world.network.lanes[lane.id]
    for other in lanes:
        its = world.network.lanes[other.id]
        if own.road == its.road and own.ascends != its.ascends:
            short, long = sorted((lane.left.points_world, other.left.points_world), key=len)
            apart = distances_between(short[::10, :2], long[:, :2]).min(axis=1)
            if np.median(apart) < SAME_LINE_M:
                found.append(other.id)
    return found


def _crossings(world: World) -> Iterator[dict[str, Any]]:
    """Crosswalks by both of their edges in the direction of their walkers."""
    for index, form in enumerate(world.symbol_shapes, start=1):
        if form.kind == "crosswalk":
            (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
            edges = (form.points_world(np.array([[x0, y], [x1, y]])) for y in (y0, y1))
            yield {**{f"edge{i}": _points(edge) for i, edge in enumerate(edges, start=1)}, "id": index}


def _outline(strip: Sides) -> list[dict[str, float]]:
    """A strip between two lines as a polygon, whose last point is not the first one again."""
    kept = thinned(strip, LINE_M)
    return _points(np.concatenate([kept[:, 0], kept[::-1, 1]]))


def _heights(
    world: World, paved: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "2"]]:
    """Heights of the ground in cells, NaN far from the pavement, and where the first cell begins. A row goes east."""
    low, high = np.floor(paved.min(axis=0) - MARGIN_M), np.ceil(paved.max(axis=0) + MARGIN_M)
    columns, rows = np.ceil((high - low) / CELL_M).astype(int).tolist()

    def is_near(at: Int[np.ndarray, "n 2"], size_m: float, room_m: float) -> Bool[np.ndarray, " n"]:
        return ~world.ground.paved.is_clear(low + (at + 0.5) * size_m, room_m)

    # Most cells are far from the pavement: it is asked for blocks of them first.
    block_m, m, n = BLOCK * CELL_M, -(-columns // BLOCK), -(-rows // BLOCK)
    blocks = is_near(_places(m, n), block_m, MARGIN_M + block_m / np.sqrt(2)).reshape(n, m)
    near = blocks.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)[:rows, :columns].ravel()
    at = _places(columns, rows)
    near[near] = is_near(at[near], CELL_M, MARGIN_M)
    heights = np.full(rows * columns, np.nan, np.float32)
    heights[near] = world.ground.height(low + (at[near] + 0.5) * CELL_M)
    return heights.reshape(rows, columns), low


def _places(columns: int, rows: int) -> Int[np.ndarray, "_ 2"]:
    """The column and the row of each cell, row by row."""
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)


def _points(points: Points3) -> list[dict[str, float]]:
    return [dict(zip("xyz", row, strict=True)) for row in (np.round(points, MM_DECIMALS) + 0.0).tolist()]


class _Point(Excerpt):
    x: Number
    y: Number
    z: Number


class LogLane(Excerpt):
    """A lane segment as its file says."""

    id: int
    is_intersection: bool
    left_lane_boundary: list[_Point]
    right_lane_boundary: list[_Point]
    left_lane_mark_type: str
    right_lane_mark_type: str
    successors: list[int]
    predecessors: list[int]
    left_neighbor_id: int | None
    right_neighbor_id: int | None

    @property
    def left(self) -> Float[np.ndarray, "n 3"]:
        return _array(self.left_lane_boundary)

    @property
    def right(self) -> Float[np.ndarray, "n 3"]:
        return _array(self.right_lane_boundary)

    @property
    def middle(self) -> Float[np.ndarray, "n 3"]:
        """The middle between them."""
        return middle_of(self.left, self.right)


class _Area(Excerpt):
    area_boundary: list[_Point]


class _Crossing(Excerpt):
    edge1: list[_Point]
    edge2: list[_Point]


class _Vectors(Excerpt):
    lane_segments: dict[str, LogLane]
    drivable_areas: dict[str, _Area]
    pedestrian_crossings: dict[str, _Crossing]


class _Cells(Excerpt):
    R: tuple[Number, Number, Number, Number]
    t: tuple[Number, Number]
    s: Number


@dataclass(frozen=True, eq=False)
class LogMap:
    """The map of a log. Heights are NaN where there are none."""

    lanes: tuple[LogLane, ...]
    areas: tuple[Float[np.ndarray, "_ 3"], ...]
    crossings: tuple[Float[np.ndarray, "_ 3"], ...]
    heights: Float[np.ndarray, "rows columns"]
    cell_from_city: Float[np.ndarray, "2 3"]

    def height(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Height of the ground in the cells of places, NaN outside."""
        columns, rows = np.floor(xy @ self.cell_from_city[:, :2].T + self.cell_from_city[:, 2]).T
        found = np.full(len(xy), np.nan)
        inside = (rows >= 0) & (rows < self.heights.shape[0]) & (columns >= 0) & (columns < self.heights.shape[1])
        found[inside] = self.heights[rows[inside].astype(int), columns[inside].astype(int)]
        return found


def read_map(vectors: Path, heights: Path, cells: Path) -> LogMap:
    """The map of a log by its three files."""
    found = schema.parse(_Vectors, read_file(vectors), str(vectors), "a map of Argoverse 2", 1 << 28)
    lanes = tuple(found.lane_segments.values())
    areas = tuple(_array(area.area_boundary) for area in found.drivable_areas.values())
    crossings = tuple(_array([*c.edge1, *c.edge2[::-1]]) for c in found.pedestrian_crossings.values())
    if any(min(len(lane.left), len(lane.right)) < 2 for lane in lanes) or any(len(area) < 3 for area in areas):
        raise FormatError(f"{vectors}: expected boundaries of two points and areas of three or more, got fewer")
    similar = schema.parse(_Cells, read_file(cells), str(cells), "a similarity")
    cell_from_city = similar.s * np.column_stack([np.array(similar.R).reshape(2, 2), similar.t])
    return LogMap(lanes, areas, crossings, _read_heights(heights), cell_from_city)


def _read_heights(path: Path) -> Float[np.ndarray, "rows columns"]:
    try:
        heights = np.load(io.BytesIO(read_file(path)), allow_pickle=False)
    except (ValueError, EOFError, OSError, MemoryError) as error:
        raise FormatError(f"{path}: expected heights as an array of numpy, got {str(error)[:80]}") from None
    if not isinstance(heights, np.ndarray) or heights.ndim != 2 or heights.dtype.kind != "f":
        raise FormatError(f"{path}: expected heights in rows and columns, got something else")
    return heights.astype(float)


def _array(points: list[_Point]) -> Float[np.ndarray, "n 3"]:
    return np.array([(point.x, point.y, point.z) for point in points]).reshape(-1, 3)


PiecesOf = dict[str, list[LogLane]]
"""The pieces of each segment, in order."""


def compare_log_map(found: LogMap, truth: SourceSample) -> Comparison:
    """Lanes in metres; sides, links, neighbours and paint; crossings, areas and heights."""
    segments = truth.labels.graph.segments
    pieces = {place_of(lane.id): lane for lane in found.lanes}
    if any(not 0 <= i < len(segments) for i, _ in pieces) or len(pieces) < len(found.lanes):
        text = f"expected ids of lanes of their own, those of {len(segments)} segments, got {[*pieces][:20]}"
        return Comparison(problems=(text,))
    lanes: PiecesOf = {}
    for i, number in sorted(pieces):
        lanes.setdefault(segments[i].id, []).append(pieces[i, number])
    every = [
        FoundLane(
            str(piece.id),
            name,
            piece.middle,
            {"left": piece.left, "right": piece.right},
            {"left": piece.left_lane_mark_type, "right": piece.right_lane_mark_type},
            [str(other) for other in piece.successors],
            [str(other) for other in piece.predecessors],
        )
        for name, own in lanes.items()
        for piece in own
    ]
    problems = [*_neighbour_problems(lanes, truth, half_widths(truth.scene, lanes)), *_ground_problems(found, truth)]
    problems += symbol_problems("pedestrian crossing", found.crossings, truth, ("crosswalk",), RULE.limit)
    return compare_lanes(every, truth, RULE).because(problems)


def _neighbour_problems(
    lanes: PiecesOf, truth: SourceSample, halves_m: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    """Findings where a lane has another neighbour than in the lane graph: to the left it may have an oncoming one,
    across a line that both share."""
    owner = {piece.id: (name, piece) for name, pieces in lanes.items() for piece in pieces}
    by_id = {segment.id: segment for segment in truth.labels.graph.segments}
    for name, lane in ((name, piece) for name, pieces in lanes.items() for piece in pieces):
        segment, is_oncoming = by_id[name], _is_oncoming(by_id[name])
        swaps = is_oncoming and truth.scene.roads.sides_are_hosts
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


def _ground_problems(found: LogMap, truth: SourceSample) -> Iterator[str]:
    """Findings where lanes are not in a drivable area or not on the ground's heights."""
    outlines = [shapely.make_valid(shapely.Polygon(outline[:, :2])) for outline in found.areas if len(outline) > 2]
    yield from area_problems(shapely.buffer(shapely.union_all(outlines), SEAM_M), truth)
    for lane in (lane for lane in truth.labels.lanes if lane.kind == "centerline"):
        points = transform(truth.labels.camera.world_from_cam, lane.xyz_cam)
        over_m = np.abs(found.height(points[:, :2]) - points[:, 2])
        # Where a ramp leaves a road, the higher one is the ground.
        if not np.median(over_m) <= GROUND_M:
            yield f"lane {lane.id}: expected the ground at its height, got it {np.median(over_m):.3g} m away"
