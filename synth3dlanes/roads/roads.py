"""Roads on reference lines, and their lanes. World frame, metres; the rules are in docs/network.md.

A place is (road, s, t), see reference_line.py. It lies on the terrain, at the height of a ramp over that, or as high as
the road's own sections say.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import groupby, pairwise
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.labels.labels import Direction
from synth3dlanes.roads.cross_section import CrossSection
from synth3dlanes.roads.reference_line import GUESS_STEP_M, Offset, ReferenceLine
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.road_map import MapRoad, MapSpan
from synth3dlanes.scene.scene import Terrain
from synth3dlanes.system.arrays import AnyPoints2, AnyPoints3, AnyScalars, Spread

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")

# Straight pieces between `Ramp.stations` are at most this far from the ramp: less than the height at which paint
# floats.
RAMP_SAG_M = 0.001
# Assumed width of lanes of a road without lanes of traffic.
LANE_WIDTH_M = 3.5
# Tolerance of the middle between two carriageways, which belongs to the right one.
HAIR_M = 1e-6


@dataclass(frozen=True)
class Ramp:
    """A road's rise over the terrain, from a station on, to a height that it keeps."""

    start_m: float
    length_m: float
    height_m: float

    def __call__(self, s: AnyScalars) -> AnyScalars:
        """Height over the terrain at stations."""
        u = np.clip((s - self.start_m) / self.length_m, 0, 1)
        return np.asarray(self.height_m * u * u * (3 - 2 * u))

    @property
    def stations(self) -> Float[np.ndarray, " _"]:
        """Stations from its start to its end, spaced for its curvature."""
        # A piece of length d is off by d^2 / 8 times the curvature, which is 6 height / length^2 at both ends.
        pieces = int(np.ceil(np.sqrt(6 * self.height_m / (8 * RAMP_SAG_M))))
        return self.start_m + self.length_m * np.linspace(0, 1, max(pieces, 1) + 1)


@dataclass(frozen=True)
class NetworkLane:
    """A lane between two stations of its road, a node of the lane graph: `number` of its section from the host's left.
    Its traffic drives as the host does, is `oncoming` or neither; `ascends` says whether it goes with growing s. Its
    `sides` are its edges as t grows, half its width from its middle unless they are given. `junction` is the one that
    it is in."""

    id: str
    road: str
    section: str
    number: int
    middle: Offset
    width_m: float
    start_m: float
    end_m: float
    direction: Direction = "same"
    ascends: bool = True
    junction: str | None = None
    sides: tuple[Offset, Offset] | None = None

    @property
    def edges(self) -> tuple[Offset, Offset]:
        """Its edges as t grows."""
        half_m = self.width_m / 2
        return self.sides or (self.middle.shifted(-half_m), self.middle.shifted(half_m))

    @property
    def driven(self) -> tuple[float, float]:
        """Its first and its last station, as its traffic drives."""
        return (self.start_m, self.end_m) if self.ascends else (self.end_m, self.start_m)


class Carriageway(NamedTuple):
    """Lanes of one direction beside each other: offsets of its edges, and how many they are."""

    left_m: float
    right_m: float
    n_lanes: int
    direction: Direction


@dataclass(frozen=True, eq=False)
class Parting:
    """Where a road begins: beside another, on whose right side (as t grows) it leaves. `gap_m` is the free width
    between the lanes of both at stations, and `station` the first one with such a gap, as opposed to `gap_m`.
    `rise_m` is how high the road may rise there: its embankment has room for it."""

    road: "Road"
    gap_m: Callable[[AnyScalars], AnyScalars]
    station: Callable[[float], float]
    rise_m: float


@dataclass(frozen=True, eq=False)
class Road:
    """A road on its reference line over the stations [start_m, end_m]. Its cross-section, as t grows: the left edge of
    its pavement, a shoulder, lanes and perhaps a median between them, a shoulder, and the right edge. It lies on the
    terrain, or on a `ramp` over it. With `sections` these say what lies across it and, where they have heights, how
    high (world z of its line) and how far turned about that: then `left` and `right` are theirs (`with_edges`). `given`
    is the road of a map that it is."""

    id: str
    line: ReferenceLine
    terrain: Terrain
    left: Offset
    right: Offset
    shoulder_m: float
    lanes: tuple[NetworkLane, ...]
    start_m: float = -np.inf
    end_m: float = np.inf
    ramp: Ramp | None = None
    parting: Parting | None = None
    sections: tuple[CrossSection, ...] = ()
    bridges: tuple[MapSpan, ...] = ()
    tunnels: tuple[MapSpan, ...] = ()
    junction: str | None = None
    given: MapRoad | None = None

    # -- its lanes and sections

    @property
    def lane_width_m(self) -> float:
        """Width of its first lane."""
        return self.lanes[0].width_m if self.lanes else LANE_WIDTH_M

    @cached_property
    def carriageways(self) -> tuple[Carriageway, ...]:
        """Its carriageways where it begins, from the left."""
        first = sorted((at for at in self.lanes if at.start_m == self.start_m), key=lambda lane: lane.middle.order)
        found = []
        for direction, group in groupby(first, key=lambda lane: lane.direction):
            lanes = list(group)
            half_m = lanes[0].width_m / 2
            ends = lanes[0].middle.base_m - half_m, lanes[-1].middle.base_m + half_m
            found.append(Carriageway(*ends, len(lanes), direction))
        return tuple(found)

    @property
    def medians(self) -> list[tuple[float, float]]:
        """Offsets between which carriageways are apart from each other, without width where one line divides them."""
        return [(a.right_m, b.left_m) for a, b in pairwise(self.carriageways)]

    def is_oncoming(self, t: float) -> bool:
        """Whether the traffic next to an offset is oncoming."""
        beyond = sum(t + HAIR_M > (low_m + high_m) / 2 for low_m, high_m in self.medians)
        return self.carriageways[beyond].direction == "oncoming"

    def lanes_at(self, s: float) -> list[NetworkLane]:
        """Its lanes at a station, as t grows."""
        here = [lane for lane in self.lanes if lane.start_m <= s < lane.end_m]
        return sorted(here, key=lambda lane: lane.middle.order)

    @cached_property
    def stretches(self) -> tuple["Road", ...]:
        """The road within each of its sections. Where one ends, the road itself is as the next one begins."""
        if len(self.sections) < 2:
            return (self,)
        return tuple(
            replace(
                self,
                start_m=at.start_m,
                end_m=at.end_m,
                sections=(at,),
                line=self.line.within(at.start_m, at.end_m),
                left=Offset(0.0, partial(at.edge, at.paved[0])),
                right=Offset(0.0, partial(at.edge, at.paved[1])),
            )
            for at in self.sections
        )

    def with_edges(self) -> "Road":
        """The road between the edges of the pavement of its own sections."""
        left, right = (Offset(0.0, partial(self._paved, side)) for side in (0, 1))
        return replace(self, left=left, right=right)

    def stretch_of(self, lane: NetworkLane) -> "Road":
        """The road within the section of one of its lanes."""
        return next(at for at in self.stretches if at.start_m <= lane.start_m < lane.end_m <= at.end_m)

    @cached_property
    def _starts(self) -> Float[np.ndarray, " k"]:
        return np.array([section.start_m for section in self.sections])

    def _by_section(self, value: Callable[..., AnyScalars], *places: Spread | float) -> AnyScalars:
        """A value of places, which begin with their stations, by the section that each is in."""
        if len(self.sections) == 1:
            return value(self.sections[0], *places)
        every = np.broadcast_arrays(*places)
        at = np.clip(np.searchsorted(self._starts, every[0], side="right") - 1, 0, None)
        found = np.zeros(at.shape)
        for i in np.unique(at):
            here = at == i
            found[here] = value(self.sections[i], *(values[here] for values in every))
        return found

    def _paved(self, which: int, s: AnyScalars) -> AnyScalars:
        """Offsets of the left (0) or right (1) edge of the pavement of its sections."""
        return self._by_section(lambda section, s: section.edge(section.paved[which], s), s)

    # -- places

    @cached_property
    def stations(self) -> Float[np.ndarray, " k"]:
        """The stations of places along it, GUESS_STEP_M apart or closer; of a road with both ends."""
        n = 2 + int((self.end_m - self.start_m) / GUESS_STEP_M)
        return np.asarray(self.start_m + np.linspace(0, self.end_m - self.start_m, n))

    def xy(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        """World (x, y) of places."""
        return self.line.xy(s, t)

    def points(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints3:
        """Points on its surface."""
        points = self.base_points(s, t)
        if self.has_kerbs:
            points[..., 2] += self.kerb(s, t)
        return points

    def base_points(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints3:
        """Points on its surface without raised lanes."""
        return self._without_kerbs(self.xy(s, t), s, t)

    def rows(self, s: Float[np.ndarray, " r"], t: Float[np.ndarray, "r c"]) -> Float[np.ndarray, "r c 3"]:
        """Points on its surface without raised lanes: at each station those at several offsets."""
        points, normals, _, _ = self.line.frames(s)
        xy_world = points[:, None] + t[..., None] * normals[:, None]
        return self._without_kerbs(xy_world, s[:, None], t)

    def _without_kerbs(self, xy_world: AnyPoints2, s: Spread, t: Spread | float) -> AnyPoints3:
        if self.has_heights:
            return np.concatenate([xy_world, self._by_section(CrossSection.height, s, t)[..., None]], -1)
        return lift(self.terrain, xy_world, np.broadcast_to(self._on_ramp(s), xy_world.shape[:-1]))

    @cached_property
    def is_raised(self) -> bool:
        """Whether it leaves the terrain anywhere."""
        return self.ramp is not None or self.has_heights or self.has_kerbs

    @cached_property
    def has_heights(self) -> bool:
        """Whether it has heights of its own."""
        return any(section.heights is not None for section in self.sections)

    @cached_property
    def has_kerbs(self) -> bool:
        """Whether any of its lanes is raised."""
        return any(section.raised for section in self.sections)

    def raised(self, s: AnyScalars, t: AnyScalars | float = 0.0) -> AnyScalars:
        """Height of its surface over the terrain at places."""
        if self.has_heights:
            z = self._by_section(CrossSection.height, s, t)
            return np.asarray(z + self.kerb(s, t) - height_at(self.terrain, self.xy(s, t)))
        return self._on_ramp(s) + self.kerb(s, t) if self.has_kerbs else self._on_ramp(s)

    def _on_ramp(self, s: AnyScalars) -> AnyScalars:
        return np.zeros(np.shape(s)) if self.ramp is None else self.ramp(s)

    def kerb(self, s: AnyScalars, t: AnyScalars | float) -> AnyScalars:
        """Height of raised lanes over the pavement at places."""
        return self._by_section(CrossSection.kerb, s, t) if self.has_kerbs else np.zeros(np.shape(s))

    def edge(self, side: Side, s: AnyScalars, out_m: AnyScalars | float = 0.0) -> AnyScalars:
        """Offsets `out_m` outside an edge of its pavement."""
        return self.left(s) - out_m if side == "left" else self.right(s) + out_m

    def outside(self, s: AnyScalars, t: AnyScalars) -> AnyScalars:
        """Distance of places from its pavement, negative on it; infinite before its start and beyond its end."""
        beside = np.maximum(self.left(s) - t, t - self.right(s))
        if np.isfinite(self.start_m) or np.isfinite(self.end_m):
            beside = np.where((s >= self.start_m) & (s <= self.end_m), beside, np.inf)
        return np.asarray(beside)

    def may_reach(self, xy_world: AnyPoints2, reach_m: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which points may be within `reach_m` of its pavement."""
        return self.line.near(xy_world, self.left.base_m - reach_m, self.right.base_m + reach_m)

    def in_lanes(self, s: AnyScalars, t: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which places lie between its shoulders."""
        return np.asarray(self.outside(s, t) < -self.shoulder_m)

    def speed(self, s: AnyScalars) -> AnyScalars:
        """Metres per station of its line and, before its start, of that of the road where it begins."""
        speed = self.line.speed(s)
        return speed if self.parting is None else np.where(s < self.start_m, self.parting.road.speed(s), speed)


def lift(terrain: Terrain, xy_world: AnyPoints2, above_m: AnyScalars | float = 0.0) -> AnyPoints3:
    """3D points on the terrain, or `above_m` over it."""
    z = height_at(terrain, xy_world) + above_m
    return np.concatenate([xy_world, np.asarray(z)[..., None]], -1)
