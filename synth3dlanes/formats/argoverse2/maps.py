"""The map of a log: lane segments, drivable areas and crossings as one JSON document, the ground by cells."""

import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.argoverse2.convention import CELL_M, MARGIN_M, LogFiles, mark_type, piece_id
from synth3dlanes.formats.lane_map import LaneSegment, lane_segments
from synth3dlanes.geometry.polylines import thinned
from synth3dlanes.labels.labels import LaneGraph
from synth3dlanes.system.arrays import Points3
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.world import World

REACH_M = 150.0
"""How far the map reaches beyond all places of the host in the clip, and as far the other way."""
PIECE_M = 30.0
"""The API draws the middle of a lane segment with ten points, however long it is."""
LINE_M, DECIMALS = 0.005, 3
"""How far written lines may be from those with all points."""
SAME_LINE_M = 0.2

Sides = Float[np.ndarray, "_ k 3"]


def map_files(world: World, graph: LaneGraph, files: LogFiles) -> tuple[dict[str, str | bytes], int]:
    """The files of the map of a world, and how many lane segments are in it."""
    place, shot = world.view.world_from_host[:3, 3], world.scene.shot
    reach_m = REACH_M + host_driven(shot, shot.duration_s)
    strips = [np.stack(edges, axis=1) for edges in world.ground.pavement_strips(place[:2], reach_m)]
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
    own: dict[str, str | bytes] = {
        files.vector_map: json.dumps(vectors),
        files.heights: stream.getvalue(),
        files.cells: json.dumps(cells),
    }
    return own, len(rows)


@dataclass(frozen=True, eq=False)
class _Piece:
    """A piece of a lane segment of the lane graph, as long as lane segments of the original are."""

    lane: LaneSegment
    first: int
    last: int
    number: int

    @property
    def id(self) -> int:
        """Its id in the map."""
        return piece_id(self.lane.index, self.number)

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """The middle of it."""
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
                "left_neighbor_id": _beside(
                    piece, [of for name in opposite or [left or ""] for of in pieces.get(name, ())]
                ),
            }


def _beside(piece: _Piece, others: Sequence[_Piece]) -> int | None:
    """The piece of another lane that is nearest to the middle of one."""
    return min(others, key=lambda other: float(np.linalg.norm(other.middle - piece.middle))).id if others else None


def _opposite(lane: LaneSegment, lanes: Sequence[LaneSegment], world: World) -> list[str]:
    """The lanes of the other direction whose left boundaries are one line with that of a lane."""
    found, own = [], world.network.lanes[lane.id]
    for other in lanes:
        its = world.network.lanes[other.id]
        if own.road == its.road and own.ascends != its.ascends:
            short, long = sorted((lane.left.points_world, other.left.points_world), key=len)
            apart = np.linalg.norm(short[::10, None, :2] - long[None, :, :2], axis=2).min(axis=1)
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
    columns, rows = np.ceil((high - low) / CELL_M).astype(int)
    x, y = (start + (np.arange(n) + 0.5) * CELL_M for start, n in zip(low, (columns, rows), strict=True))
    xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    near = world.ground.is_within(xy, MARGIN_M)
    heights = np.full(len(xy), np.nan, np.float32)
    heights[near] = world.ground.height(xy[near])
    return heights.reshape(rows, columns), low


def _points(points: Points3) -> list[dict[str, float]]:
    return [dict(zip("xyz", row, strict=True)) for row in (np.round(points, DECIMALS) + 0.0).tolist()]
