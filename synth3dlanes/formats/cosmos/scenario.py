"""The world scenario of a clip: what stands still around it, in the world frame."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.lane_map import LaneSegment, lane_segments
from synth3dlanes.labels.labels import Labels, Marking, PaintColor, Pair
from synth3dlanes.labels.object_labels import ObjectLabel
from synth3dlanes.system.arrays import Matrix4, Points3
from synth3dlanes.system.schema import SymbolKind
from synth3dlanes.world.motion import host_driven
from synth3dlanes.world.paint import is_double, paint_color, pair_of
from synth3dlanes.world.world import World

REACH_M = 150.0
"""Reach of lanes ahead of and behind all places of the host in the clip."""


@dataclass(frozen=True, eq=False)
class PaintedLine:
    """A painted line, in the host's driving direction; `pair` names stripes that differ from the left."""

    id: str
    points_world: Points3
    marking: Marking
    color: PaintColor
    double: bool
    pair: Pair | None


@dataclass(frozen=True, eq=False)
class RoadSymbol:
    """Paint that bounds no lane: its outline; of a line across the road, its middle from one end to the other."""

    kind: SymbolKind
    points_world: Points3


@dataclass(frozen=True, eq=False)
class StandingElement:
    """A traffic element, and the pose of its frame."""

    label: ObjectLabel
    world_from_element: Matrix4


@dataclass(frozen=True, eq=False)
class Scenario:
    """What stands still around a clip."""

    lanes: tuple[LaneSegment, ...]
    lines: tuple[PaintedLine, ...]
    edges: tuple[Points3, ...]
    symbols: tuple[RoadSymbol, ...]
    elements: tuple[StandingElement, ...]


def scenario(world: World, labels: Labels, pictures: Iterable[Labels]) -> Scenario:
    """The scenario of a world by the labels of the clip's first picture, with the traffic elements of all
    `pictures`."""
    place, shot = world.view.world_from_host[:3, 3], world.scene.shot
    reach_m = REACH_M + host_driven(shot, shot.duration_s)
    return Scenario(
        tuple(lane_segments(world, labels.graph.segments, place, reach_m)),
        tuple(_lines(world, place, reach_m)),
        tuple(world.ground.pavement_edges(place[:2], reach_m)),
        tuple(_symbols(world)),
        _elements(pictures),
    )


def _lines(world: World, place: Float[np.ndarray, "3"], reach_m: float) -> Iterator[PaintedLine]:
    network, markings = world.network, world.scene.markings
    for line, s in network.delimiters_near(place[:2], reach_m).items():
        points = line.points_world(s)
        points = points[np.linalg.norm(points[:, :2] - place[:2], axis=1) < 2 * reach_m]
        if line.marking != "none" and len(points) > 1:
            paint = paint_color(line, markings) or "white", bool(is_double(line, markings)), pair_of(line, markings)
            # Stations may fall as the host drives.
            yield PaintedLine(line.id, points[:: int(network.onwards)], line.marking, *paint)


def _symbols(world: World) -> Iterator[RoadSymbol]:
    for form in world.symbol_shapes:
        if form.kind in ("stop_line", "give_way_line"):
            (x0, y0), (x1, y1) = form.outline.min(axis=0), form.outline.max(axis=0)
            ends = np.array([[x0, (y0 + y1) / 2], [x1, (y0 + y1) / 2]])
            yield RoadSymbol(form.kind, form.points_world(ends))
        else:
            yield RoadSymbol(form.kind, form.points_world(form.outline))


def _elements(pictures: Iterable[Labels]) -> tuple[StandingElement, ...]:
    found = dict[int, StandingElement]()
    for labels in pictures:
        for item in labels.traffic_elements or ():
            found.setdefault(item.id, StandingElement(item, labels.camera.world_from_cam @ item.cam_from_object))
    return tuple(found[number] for number in sorted(found))
