"""Scenes on the paper's roads as OpenDRIVE describes them: their roads on banked planes, with all paint in place."""

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from synth3dlanes.formats.opendrive.described import SHAPE_PLACES, Described, lane_ascends, shapes
from synth3dlanes.formats.opendrive.marks import marks
from synth3dlanes.formats.opendrive.objects import add_objects
from synth3dlanes.formats.opendrive.roads import JUNCTION, OdrRoad, roads
from synth3dlanes.roads.maps.profiles import cubics, pieces
from synth3dlanes.roads.network import Network
from synth3dlanes.scene.road_map import (
    LaneName,
    MapJunction,
    MapLane,
    MapRoad,
    MapSection,
    MapShape,
    PlanPiece,
    RoadMap,
)
from synth3dlanes.world.world import World

# How far the written reference line, heights and widths (metres) and rolls (radians) may be from the world's.
LINE_M, HEIGHT_M, WIDTH_M, ROLL_RAD = 1e-3, 1e-3, 1e-3, 1e-4


def described_paper(world: World) -> Described:
    """All roads of a world with the paper's roads."""
    found = {road.name: road for road in roads(world.network)}
    told = {name: _told(world, road) for name, road in found.items()}
    segments = {f"{road.name}.0.{lane.number}": str(lane.segment) for road in found.values() for lane in road.driving}
    links = tuple(link for name in found for link in _links(world.network, found, told[name]))
    has_junction = any(road.in_junction for road in found.values())
    junctions = (MapJunction(id=JUNCTION),) if has_junction else ()
    whole = RoadMap(roads=tuple(told.values()), links=links, junctions=junctions, route=(next(iter(segments)),))
    xy_world = np.concatenate([road.xy_world for road in found.values()])
    return Described(whole, told, xy_world, segments, partial(add_objects, world, list(found.values())))


def _told(world: World, road: OdrRoad) -> MapRoad:
    s, painted = road.s_m, marks(world, road)
    lanes = [MapLane(number=0, kind="none", marks=painted[0])]
    for lane in road.lanes:
        widths = tuple(cubics(s, np.abs(lane.outer_m - lane.inner_m), WIDTH_M))
        lanes.append(MapLane(number=lane.number, kind=lane.kind, widths=widths, marks=painted[lane.number]))
    return MapRoad(
        id=road.name,
        plan=tuple(_plan(road)),
        sections=(MapSection(s_m=0.0, lanes=tuple(lanes)),),
        lane_offsets=tuple(cubics(s, road.center_m, WIDTH_M)),
        heights=tuple(cubics(s, road.elevation_m, HEIGHT_M)),
        banks=tuple(cubics(s, road.roll_rad, ROLL_RAD)),
        shapes=tuple(_shapes(road)),
        junction=JUNCTION if road.in_junction else None,
        keeps_left=road.is_left_hand,
    )


def _plan(road: OdrRoad) -> Iterator[PlanPiece]:
    for piece in pieces(road.s_m, road.xy_world, LINE_M, unit_speed=True):
        (x, y), (dx, dy) = piece.abcd[0].tolist(), piece.abcd[1].tolist()
        u, v = (piece.abcd @ np.array([[dx, -dy], [dy, dx]])).T.tolist()
        length_m, heading = piece.end - piece.s, float(np.arctan2(dy, dx))
        cubic = {"u": (0.0, 1.0, *u[2:]), "v": (0.0, 0.0, *v[2:]), "parameter_end": length_m}
        yield PlanPiece(x_m=x, y_m=y, heading_rad=heading, length_m=length_m, **cubic)


def _shapes(road: OdrRoad) -> Iterator[MapShape]:
    edges = [t for lane in road.lanes for t in (lane.inner_m, lane.outer_m)]
    low, high = np.min(edges, axis=0), np.max(edges, axis=0)
    across = [low + (high - low) * share for share in np.linspace(0, 1, SHAPE_PLACES)]
    # Shapes are heights along e_h.
    over_m = np.column_stack([road.over_plane(t) * road.axes[:, 2, 2] for t in across])
    return shapes(road.s_m, over_m, low, high - low)


def _links(network: Network, found: Mapping[str, OdrRoad], told: MapRoad) -> Iterator[tuple[LaneName, LaneName]]:
    """The links of the lanes of a connecting road with those of the roads at its ends, and of another one with those
    of the road behind it, as traffic drives."""
    road = found[told.id]
    there = found.get(road.after or "")
    if there is not None and not road.in_junction:
        pairs = ((lane, at) for lane in road.driving for at in there.driving)
        for lane, at in pairs:
            joined = lane.segment == at.segment or at.segment in {
                beyond.id for beyond in network.joined_to(network.lanes[str(lane.segment)])
            }
            ends = f"{road.name}.0.{lane.number}", f"{there.name}.0.{at.number}"
            if joined:
                yield ends if lane_ascends(told, 0, lane.number) else (ends[1], ends[0])
    for lane in road.driving if road.in_junction else ():
        segments = {lane.segment} | {at.id for at in network.joined_to(network.lanes[str(lane.segment)])}
        before, after = (
            f"{name}.0.{next(there.number for there in found[str(name)].lanes if there.segment in segments)}"
            for name in (road.before, road.after)
        )
        if not lane_ascends(told, 0, lane.number):
            before, after = after, before
        own = f"{road.name}.0.{lane.number}"
        yield before, own
        yield own, after
