"""The lanelets of an OSM file: both bounds as traffic drives, whichever way their lines are drawn."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.maps.osm import Osm, OsmRelation
from synth3dlanes.system.arrays import Polyline3
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import shown

MAX_LENGTH_M = 10_000.0


@dataclass(frozen=True, eq=False)
class LaneletBound:
    """One side of a lanelet: the id of its way, whether its traffic goes against that, its nodes and points as traffic
    drives, and the tags of the way."""

    way: str
    is_against: bool
    nodes: tuple[str, ...]
    points: Polyline3
    tags: dict[str, str]


@dataclass(frozen=True, eq=False)
class Lanelet:
    """A lanelet: its id, tags and bounds, and the ids of its regulatory elements."""

    id: str
    tags: dict[str, str]
    left: LaneletBound
    right: LaneletBound
    rules: tuple[str, ...]

    @property
    def begins(self) -> tuple[str, str]:
        """The nodes on the left and the right where traffic enters it."""
        return self.left.nodes[0], self.right.nodes[0]

    @property
    def ends(self) -> tuple[str, str]:
        """The nodes where traffic leaves it."""
        return self.left.nodes[-1], self.right.nodes[-1]


def read_lanelet(osm: Osm, name: str) -> Lanelet:
    """The lanelet of a relation. Raises FormatError for one without two bounds of some length, one on either side."""
    relation = osm.relations[name]
    left, right = (_bound(osm, name, relation, role) for role in ("left", "right"))
    # As the lines are drawn, their directions are either traffic's or not: it has the left bound on its left.
    if _apart(left.points, right.points) > _apart(left.points, right.points[::-1]):
        right = _turned(right)
    if _is_right_of(left.points, right.points) < 0:
        left, right = _turned(left), _turned(right)
    if _is_right_of(left.points, right.points) <= 0:
        raise FormatError(f"lanelet {name}: expected a left and a right bound beside each other, got one line twice")
    return Lanelet(name, relation.tags, left, right, tuple(relation.of("regulatory_element")))


def _bound(osm: Osm, name: str, relation: OsmRelation, role: str) -> LaneletBound:
    ways = relation.of(role)
    if len(ways) != 1:
        raise FormatError(f"lanelet {name}: expected one {role} bound, got {len(ways)}")
    try:
        points = osm.points(ways[0])
    except FormatError as error:
        raise FormatError(f"lanelet {name}: {error}") from None
    nodes = osm.ways[ways[0]].nodes
    moved = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0)
    # The ends are those of the way also where points lie on each other.
    moved[-1:] = True
    kept = np.flatnonzero(moved)
    length_m = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    if length_m > MAX_LENGTH_M:
        raise FormatError(f"lanelet {name}: expected bounds of at most {MAX_LENGTH_M:g} m, got {length_m:.0f} m")
    if len(kept) < 2 or not length_m > 0:
        raise FormatError(
            f"lanelet {name}: expected a {role} bound of some length, got way {shown(ways[0])} without one"
        )
    return LaneletBound(ways[0], False, tuple(nodes[i] for i in kept), points[kept], osm.ways[ways[0]].tags)


def _turned(bound: LaneletBound) -> LaneletBound:
    return LaneletBound(bound.way, not bound.is_against, bound.nodes[::-1], bound.points[::-1], bound.tags)


def _apart(one: Polyline3, other: Polyline3) -> float:
    return float(np.linalg.norm(one[0] - other[0]) + np.linalg.norm(one[-1] - other[-1]))


def _is_right_of(left: Polyline3, right: Polyline3) -> float:
    """The area between two lines from above that go the same way: negative if the second is on the left of the first;
    0 where they enclose none."""
    ring: Float[np.ndarray, "n 2"] = np.concatenate([left, right[::-1]])[:, :2]
    x, y = (ring - ring[0]).T
    return float(np.sum(np.roll(x, -1) * y - x * np.roll(y, -1)) / 2)
