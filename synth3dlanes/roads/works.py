"""The host's lanes along road works on the paper's road: where the boundaries of those that are open lie. Stations and
offsets are those of the plan, see line_forms.py."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.roads.lane_curves import LinePaint
from synth3dlanes.roads.reference_line import Offset
from synth3dlanes.roads.roads import Road
from synth3dlanes.scene.scene import PaperRoad
from synth3dlanes.scene.works import RoadWorks
from synth3dlanes.system.arrays import AnyScalars

# Boundaries that would move by less than this stay in place.
STAYS_M = 1e-6
# The closed area of a shoulder begins this far inside its edge, and in the middle of a median this is left.
EDGE_M, MEDIAN_M = 0.6, 0.3
AREA_STEP_M = 3.0


@dataclass(frozen=True, eq=False)
class WorksLanes:
    """The open lanes along road works, numbered 1..n from the plan's left, and their boundaries 0..n."""

    road: PaperRoad
    works: RoadWorks

    @property
    def span_m(self) -> tuple[float, float]:
        """The stations between which the works are."""
        start_m, end_m = self.works.start_m, self.works.end_m
        return (-end_m, -start_m) if self.road.flip_lateral else (start_m, end_m)

    def share(self, s: AnyScalars) -> AnyScalars:
        """The share of their way that lines have moved at stations: 0 outside the works, 1 between the tapers."""
        (low_m, high_m), works = self.span_m, self.works
        tapers_m = (works.taper_m, works.end_taper_m)[:: -1 if self.road.flip_lateral else 1]
        u = np.minimum((s - low_m) / tapers_m[0], (high_m - s) / tapers_m[1])
        u = np.clip(u, 0, 1)
        return np.asarray(u * u * (3 - 2 * u))

    @property
    def n(self) -> int:
        """How many lanes are open."""
        return self.road.n_lanes - self.works.closes_lane

    @property
    def before_first(self) -> int:
        """The number of lanes of the road left of the first open one."""
        return int(self.works.closes_lane and self.works.inner)

    @cached_property
    def edges_m(self) -> tuple[float, float]:
        """Offsets of the outermost lines between the tapers."""
        works, n = self.works, self.road.n_lanes
        if works.inner:
            return self.road.boundary_m(0) + works.taken_m, self.road.boundary_m(n) + works.shift_m
        return self.road.boundary_m(0) - works.shift_m, self.road.boundary_m(n) - works.taken_m

    def _target_m(self, i: int) -> float:
        """Offset of boundary i between the tapers."""
        if self.works.lines == "as_before":
            return self.road.boundary_m(i + self.before_first)
        low_m, high_m = self.edges_m
        return low_m + (high_m - low_m) * i / self.n

    @property
    def width_m(self) -> float:
        """Width of the open lanes between the tapers."""
        return self._target_m(1) - self._target_m(0)

    def _moving(self, from_m: float, to_m: float) -> Offset:
        """A line from one offset outside the works to another between the tapers."""
        by_m = to_m - from_m
        return Offset(from_m, lambda s: by_m * self.share(s)) if abs(by_m) > STAYS_M else Offset(from_m)

    def boundary(self, i: int) -> Offset:
        """Boundary i of the open lanes."""
        return self._moving(self.road.boundary_m(i + self.before_first), self._target_m(i))

    def middle(self, lane: int) -> Offset:
        """The middle of an open lane."""
        ends_m = ((self.road.boundary_m(at + self.before_first), self._target_m(at)) for at in (lane - 1, lane))
        from_m, to_m = np.mean(list(ends_m), axis=0).tolist()
        return self._moving(from_m, to_m)

    def line_of(self, j: int) -> tuple[int, Offset] | None:
        """The boundary of the open lanes that line j of the road goes on as, and where it runs; None for a line that
        ends where works begin."""
        if self.works.lines == "as_before":
            return j - self.before_first, Offset(self.road.boundary_m(j))
        i = 0 if j == 0 else self.n if j == self.road.n_lanes else j - self.before_first
        if i in (0, self.n) and j not in (0, self.road.n_lanes):
            return None
        return i, self._moving(self.road.boundary_m(j), self._target_m(i))

    def is_moved(self, j: int) -> bool:
        """Whether line j of the road is elsewhere along the works, or is not there."""
        found = self.line_of(j)
        return found is None or found[1].moves is not None

    @property
    def paint(self) -> LinePaint:
        """The paint of the lines that move."""
        return LinePaint(self.works.lines == "yellow", self.works.line_width_m)

    # -- the closed area

    @property
    def outward(self) -> int:
        """1 where the closed area is on the side to which t grows, else -1."""
        return -1 if self.works.inner else 1

    @property
    def shoulder_m(self) -> float:
        """Width of the shoulder on the side of the works; of one beside a median, what cars may use."""
        road = self.road
        width_m = road.shoulder_factor * road.lane_width_m
        return max(min(width_m, road.median_m / 2 - MEDIAN_M), 0.0) if self.works.inner and road.n_oncoming else width_m

    @property
    def pavement_m(self) -> float:
        """Offset of the outer edge of the closed area, which is that of the shoulder."""
        return self.road.boundary_m(self._outermost) + self.outward * self.shoulder_m

    @property
    def _outermost(self) -> int:
        """The number of the edge line on the side of the works."""
        return 0 if self.works.inner else self.road.n_lanes

    @cached_property
    def closed_from(self) -> Offset:
        """The inner edge of the closed area: the line that moves in, or what holds in its place."""
        works, edge_m = self.works, self.road.boundary_m(self._outermost)
        if works.taken_m:
            line = self.line_of(self._outermost)
            assert line is not None, "the outermost lines go on"
            return line[1]
        if works.closes_lane:
            return self._moving(edge_m, self.road.boundary_m(self._outermost - self.outward))
        return self._moving(self.pavement_m - self.outward * EDGE_M, edge_m)

    def closed(self, road: Road) -> Float[np.ndarray, "k 4 2"]:
        """What they close of the road, from above: quadrangles one behind the other."""
        low_m, high_m = self.span_m
        s = np.linspace(low_m, high_m, 2 + int((high_m - low_m) / AREA_STEP_M))
        inner, outer = road.xy(s, self.closed_from(s)), road.xy(s, self.pavement_m)
        return np.stack([inner[:-1], outer[:-1], outer[1:], inner[1:]], axis=1)
