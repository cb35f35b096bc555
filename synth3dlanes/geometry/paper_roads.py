"""The paper's numbers -> Network: a main road, perhaps with oncoming lanes, and perhaps an exit that leaves it.

The *plan* is the road before its flips: the exit leaves to the right for stations s >= 0, and a station is the y of a
point on the main road's line. The world is the plan with x and y mirrored as the scene's flips say; t is the plan's.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from synth3dlanes.arrays import AnyPoints2, AnyScalars
from synth3dlanes.geometry.lane_curves import LaneCurve, joined
from synth3dlanes.geometry.network import Network
from synth3dlanes.geometry.reference_line import MAX_STEP_M, NEWTON_STEPS, LineFrames, ReferenceLine, dot, paired
from synth3dlanes.geometry.roads import BEFORE_M, WIDER, NetworkLane, Offset, Parting, Ramp, Road
from synth3dlanes.labels import Direction, Marking
from synth3dlanes.scene import PaperRoad, Terrain

# Of a painted line: the lanes beside it as t grows; roads, offsets there, and stations where each of these begins.
LanesBeside = tuple[str | None, str | None]
Parts = list[tuple[Road, Offset, float]]

# Knots of the quartic (paper, Table 'Lane top view geometry'); beyond them roads continue along their tangents.
S_END_M = 100.0
# An exit continues straight from where the inside of a bend would compress its length per station below this share of
# the main road's: beyond that the displaced curve would fold back on itself.
MIN_STRETCH = 0.3
# Lower limit of the ramp's length; avoids a division by zero.
MIN_RAMP_LENGTH_M = 0.1
# Length behind the split over which the pavement of a lane that leaves narrows to nothing (topology 4).
TAPER_M = 20.0
# min(q, width) has a corner at the nose. It is rounded where q is this close to the width, so that the lane is smooth;
# this moves the lane by at most 1.5 cm.
CORNER_M = 0.06
# Stations from the split to far beyond the scene.
EXIT_STATIONS_M = np.concatenate([np.arange(0.0, 400.0, 2.0), np.geomspace(400.0, 20_000.0, 40)])


class Flips(NamedTuple):
    """(+-1, +-1): world = plan * flips."""

    x: float
    y: float


class Quartic(ReferenceLine):
    """The main road's line: x = f(y), straight beyond the outer knots. A station is y in the plan."""

    def __init__(self, road: PaperRoad, flips: Flips) -> None:
        self.flips = flips
        ys = np.array([-100.0, -50.0, 50.0, 100.0])
        xs = [road.offset_m50_m + road.offset_m100_m, road.offset_m50_m]
        xs += [road.offset_p50_m, road.offset_p50_m + road.offset_p100_m]
        f = np.concatenate([[0.0], np.linalg.solve(ys[:, None] ** np.arange(1, 5), np.array(xs))])
        df = f[1:] * np.arange(1, 5)
        # The polynomial and its first two derivatives, the constant first.
        self._f, self._df, self._d2f = f.tolist(), df.tolist(), (df[1:] * np.arange(1, 4)).tolist()

    @property
    def is_mirrored(self) -> bool:
        """As one of its two flips makes it."""
        return self.flips.x * self.flips.y < 0

    def _plan(self, s: AnyScalars) -> tuple[AnyScalars, AnyScalars, AnyScalars]:
        """x in the plan and its first two derivatives."""
        # The function that is called most often: on few stations numpy's own overhead counts.
        (a0, a1, a2, a3, a4), (b0, b1, b2, b3), (c0, c1, c2) = self._f, self._df, self._d2f
        inside = np.minimum(np.maximum(s, -S_END_M), S_END_M)
        x = (((a4 * inside + a3) * inside + a2) * inside + a1) * inside + a0
        slope = ((b3 * inside + b2) * inside + b1) * inside + b0
        bend = (c2 * inside + c1) * inside + c0
        beyond = s - inside
        return x + beyond * slope, slope, np.where(beyond == 0, bend, 0.0)

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations."""
        x, slope, bend = self._plan(s)
        speed = np.sqrt(1 + slope * slope)
        points = paired(self.flips.x * x, self.flips.y * s)
        normals = paired(self.flips.x / speed, -self.flips.y * slope / speed)
        return LineFrames(points, normals, speed, bend / (speed * speed))

    def guess(self, xy_world: AnyPoints2) -> AnyScalars:
        """The points' y in the plan."""
        return np.asarray(xy_world[..., 1] * self.flips.y)

    def across(self, xy_world: AnyPoints2) -> AnyScalars:
        """About how far points are beside the line: their distance from its tangent at their y."""
        x, slope, _ = self._plan(self.guess(xy_world))
        return np.asarray((xy_world[..., 0] * self.flips.x - x) / np.sqrt(1 + slope * slope))

    def near(self, xy_world: AnyPoints2, low_m: AnyScalars, high_m: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which points may lie between these offsets."""
        across = self.across(xy_world)
        return np.asarray((across > low_m) & (across < high_m))


@dataclass(frozen=True, eq=False)
class Opening:
    """q(s): how far the exit lanes have moved away from the main road, along its normal; straight from `end_m` on."""

    slope: float
    offset_m: float
    end_m: float = S_END_M

    def polynomial(self, s: AnyScalars) -> tuple[AnyScalars, AnyScalars]:
        """q and its derivative before the end."""
        return s * self.slope + self.offset_m * (s / 60) ** 2, self.slope + self.offset_m * s / 1800

    def __call__(self, s: AnyScalars) -> AnyScalars:
        """q at stations; 0 before the split."""
        inside = np.clip(s, 0, self.end_m)
        q, dq = self.polynomial(inside)
        return np.asarray(q + np.clip(s - inside, 0, None) * dq)

    def station(self, q_m: float) -> float:
        """Smallest station at which it is `q_m`."""
        bend = self.offset_m / 60**2
        bent = 2 * q_m / (self.slope + np.sqrt(self.slope**2 + 4 * bend * q_m))
        if bent <= self.end_m:
            return float(bent)
        q, dq = self.polynomial(np.array([self.end_m]))
        return float(self.end_m + (q_m - q[0]) / dq[0])


@dataclass(frozen=True, eq=False)
class Displaced(ReferenceLine):
    """The exit's line: displaced from the main road's by `base_m` and its opening, for stations >= 0 of that line."""

    base: Quartic
    base_m: float
    opening: Opening

    @property
    def is_mirrored(self) -> bool:
        """As the main road's line."""
        return self.base.is_mirrored

    def _steps(self, s: AnyScalars) -> tuple[AnyPoints2, AnyPoints2, AnyPoints2]:
        """Points, their derivatives by station, and unit normals."""
        inside = np.clip(s, 0, self.opening.end_m)
        points, normals, speed, turn = self.base.frames(inside)
        q, dq = self.opening.polynomial(inside)
        displaced = self.base_m + q
        sign = self.base.flips.x * self.base.flips.y
        tangents = paired(-sign * normals[..., 1], sign * normals[..., 0])
        steps = (speed - turn * displaced)[..., None] * tangents + dq[..., None] * normals
        aside = paired(sign * steps[..., 1], -sign * steps[..., 0]) / np.sqrt(dot(steps, steps))[..., None]
        return points + displaced[..., None] * normals + (s - inside)[..., None] * steps, steps, aside

    def frames(self, s: AnyScalars) -> LineFrames:
        """The line at stations; its turn is not needed by its own projection."""
        points, steps, aside = self._steps(s)
        return LineFrames(points, aside, np.sqrt(dot(steps, steps)), np.zeros(np.shape(s)))

    def xy(self, s: AnyScalars, t: AnyScalars | float) -> AnyPoints2:
        """World (x, y) of places."""
        points, _, aside = self._steps(s)
        return np.asarray(points + np.asarray(t)[..., None] * aside)

    def guess(self, xy_world: AnyPoints2) -> AnyScalars:
        """Stations of the main road's line."""
        return self.base.project(xy_world)[0]

    def project(self, xy_world: AnyPoints2, guess: AnyScalars | None = None) -> tuple[AnyScalars, AnyScalars]:
        """(s, t) of points near the line; s may be negative."""
        s = self.guess(xy_world) if guess is None else guess
        for _ in range(NEWTON_STEPS):
            points, steps, _ = self._steps(s)
            ahead = dot(xy_world - points, steps) / dot(steps, steps)
            s = s + np.clip(ahead, -MAX_STEP_M, MAX_STEP_M)
        points, _, aside = self._steps(s)
        return s, dot(xy_world - points, aside)

    @cached_property
    def _plan_y(self) -> AnyScalars:
        y = self._steps(EXIT_STATIONS_M)[0][:, 1] * self.base.flips.y
        return np.asarray(np.maximum.accumulate(y))

    def near(self, xy_world: AnyPoints2, low_m: AnyScalars, high_m: AnyScalars) -> Bool[np.ndarray, "*n"]:
        """Which points may lie between these offsets."""
        across = self.base.across(xy_world) - self.base_m
        # An exit that leaves at an angle reaches a given y only at a much larger station.
        station = np.interp(self.base.guess(xy_world), self._plan_y, EXIT_STATIONS_M)
        return np.asarray((across > low_m) & (across < high_m + WIDER * self.opening(station + BEFORE_M)))


def smooth_min(q: AnyScalars, width_m: float) -> AnyScalars:
    """min(q, width) with its corner rounded; equal to min(q, width) outside CORNER_M of it."""
    h = np.clip(CORNER_M - np.abs(q - width_m), 0, None)
    return np.minimum(q, width_m) - h * h / (4 * CORNER_M)


def paper_network(road: PaperRoad, terrain: Terrain) -> Network:
    """The roads of the paper's numbers over a terrain; drawing and resolving a scene ask for the same."""
    return _Plan(road, terrain).network


def is_wide_enough(road: PaperRoad) -> bool:
    """Whether the bends of a road leave room for its oncoming lanes: on the inside of a sharp one they would fold."""
    plan = _Plan(road, Terrain(gaussians=()))
    _, _, speed, turn = plan.line.frames(np.linspace(-S_END_M, S_END_M, 401))
    return bool((speed - turn * (plan.left_m - plan.shoulder_m) >= MIN_STRETCH * speed).all())


@dataclass(frozen=True, eq=False)
class _Plan:
    """The paper's numbers, and what is made of them step by step. Lanes 1..n and lines 0..n count from the plan's
    left."""

    road: PaperRoad
    terrain: Terrain

    @cached_property
    def flips(self) -> Flips:
        return Flips(-1.0 if self.road.flip_longitudinal else 1.0, -1.0 if self.road.flip_lateral else 1.0)

    @cached_property
    def line(self) -> Quartic:
        return Quartic(self.road, self.flips)

    @property
    def shoulder_m(self) -> float:
        return self.road.shoulder_factor * self.road.lane_width_m

    def boundary_m(self, j: int) -> float:
        """Offset of lane boundary j = 0..n of the main road before the split."""
        return (j - self.road.n_lanes / 2) * self.road.lane_width_m

    def middle_m(self, lane: int) -> float:
        """Offset of the middle of lane 1..n of the main road before the split."""
        return self.boundary_m(lane) - self.road.lane_width_m / 2

    @property
    def left_m(self) -> float:
        """Offset of the leftmost lane boundary."""
        road = self.road
        if not road.n_oncoming:
            return self.boundary_m(0)
        return self.boundary_m(0) - road.median_m - road.n_oncoming * road.lane_width_m

    @property
    def exit_half_m(self) -> float:
        """Half the width of the exit's lanes."""
        return self.road.n_exit_lanes * self.road.lane_width_m / 2

    @property
    def exit_base_m(self) -> float:
        """Main-road offset of the exit's line at the split: the middle of the exit's lanes there."""
        return self.boundary_m(self.road.n_lanes) - self.exit_half_m

    @cached_property
    def opening(self) -> Opening:
        opening = Opening(float(np.tan(self.road.exit_angle_rad)), self.road.exit_offset_m)
        s = np.linspace(0, S_END_M, 401)
        _, _, speed, turn = self.line.frames(s)
        displaced = self.exit_base_m + opening.polynomial(s)[0]
        folded = np.flatnonzero(speed - turn * displaced < MIN_STRETCH * speed)
        return replace(opening, end_m=float(s[folded[0]])) if folded.size else opening

    @cached_property
    def nose_m(self) -> float:
        """Station of the nose, where the opening is one lane wide."""
        return self.opening.station(self.road.lane_width_m)

    # -- ids: numbers count from the host's left

    def _seen(self, number: int, last: int) -> int:
        return last - number if self.flips.x < 0 else number

    def lane_id(self, section: str, lane: int) -> str:
        """The id of lane 1..n of a section."""
        return f"{section}_{self._seen(lane, self._count(section) + 1)}"

    def line_id(self, section: str, j: int) -> str:
        """The id of the painted line j = 0..n of a section's lanes."""
        return f"{section}_line_{self._seen(j, self._count(section))}"

    def _count(self, section: str) -> int:
        road = self.road
        counts = {"stem": road.n_lanes, "main": road.n_main_after, "exit": road.n_exit_lanes}
        return counts.get(section, road.n_oncoming)

    # -- lanes and links

    def section(
        self,
        name: str,
        road: str,
        middles: list[Offset],
        span_m: tuple[float, float],
        direction: Direction = "same",
    ) -> list[NetworkLane]:
        """The lanes of a section, from the host's left."""
        lanes = [
            NetworkLane(
                self.lane_id(name, k),
                road,
                name,
                self._seen(k, len(middles) + 1),
                at,
                self.road.lane_width_m,
                *span_m,
                direction,
                ascends=(direction == "same") == (self.flips.y > 0),
            )
            for k, at in enumerate(middles, 1)
        ]
        return sorted(lanes, key=lambda lane: lane.number)

    @cached_property
    def main_lanes(self) -> list[NetworkLane]:
        """The lanes of the main road: of its stem before the split, beyond it, and oncoming ones."""
        road, whole = self.road, (-np.inf, np.inf)
        middles = [Offset(self.middle_m(lane)) for lane in range(1, road.n_lanes + 1)]
        after = middles[: road.n_main_after]
        if road.topology == 3:
            after[-1] = Offset(self.middle_m(road.n_lanes - 1), self._opens)
        oncoming = [Offset(self.left_m + (lane - 0.5) * road.lane_width_m) for lane in range(1, road.n_oncoming + 1)]
        lanes = self.section("main", "main", after, whole if road.topology == 1 else (0.0, np.inf))
        if road.topology > 1:
            lanes = self.section("stem", "main", middles, (-np.inf, 0.0)) + lanes
        return lanes + self.section("oncoming", "main", oncoming, whole, "oncoming")

    def _opens(self, s: AnyScalars) -> AnyScalars:
        """How far a lane that opens beside its neighbour has come."""
        return smooth_min(self.opening(np.maximum(s, 0)), self.road.lane_width_m)

    @cached_property
    def exit_lanes(self) -> list[NetworkLane]:
        road, first = self.road, self.road.n_lanes - self.road.n_exit_lanes
        middles = [Offset(self.middle_m(first + lane) - self.exit_base_m) for lane in range(1, road.n_exit_lanes + 1)]
        return self.section("exit", "exit", middles, (0.0, np.inf))

    @property
    def links(self) -> tuple[tuple[str, str], ...]:
        """(lane, lane) of every way, as traffic drives; from the plan's left."""
        road, n = self.road, self.road.n_lanes
        if road.topology == 1:
            return ()
        pairs = [(lane, "main", lane) for lane in range(1, road.n_main_after + 1)]
        if road.topology == 3:
            pairs[-1] = (n - 1, "main", n)
        pairs += [(n - road.n_exit_lanes + lane, "exit", lane) for lane in range(1, road.n_exit_lanes + 1)]
        named = [(self.lane_id("stem", stem), self.lane_id(section, lane)) for stem, section, lane in pairs]
        return tuple(named if self.flips.y > 0 else [(fork, stem) for stem, fork in named])

    # -- roads

    @cached_property
    def main_road(self) -> Road:
        road = self.road
        edge_m, lost_m = (
            road.n_lanes * road.lane_width_m / 2 + self.shoulder_m,
            (road.n_lanes - road.n_main_after) * road.lane_width_m,
        )

        def tapers(s: AnyScalars) -> AnyScalars:
            return -lost_m * np.clip(s / min(TAPER_M, self.nose_m), 0, 1)

        right = Offset(edge_m, tapers if lost_m else None)
        left = Offset(self.left_m - self.shoulder_m)
        return Road("main", self.line, self.terrain, left, right, self.shoulder_m, tuple(self.main_lanes))

    @cached_property
    def exit_road(self) -> Road:
        road, width_m = self.road, self.road.lane_width_m
        edge_m, start_m = self.exit_half_m + self.shoulder_m, self.opening.station(width_m + 2 * self.shoulder_m)
        length_m = max(road.ramp_height_m * road.ramp_slope, MIN_RAMP_LENGTH_M)
        return Road(
            "exit",
            Displaced(self.line, self.exit_base_m, self.opening),
            self.terrain,
            Offset(-edge_m),
            Offset(edge_m),
            self.shoulder_m,
            tuple(self.exit_lanes),
            start_m=0.0,
            ramp=Ramp(start_m, length_m, road.ramp_height_m) if start_m <= S_END_M else None,
            parting=Parting(
                self.main_road,
                lambda s: self.opening(s) - width_m,
                lambda gap_m: self.opening.station(gap_m + width_m),
                road.ramp_height_m,
            ),
        )

    @property
    def network(self) -> Network:
        roads = (self.main_road,) if self.road.topology == 1 else (self.main_road, self.exit_road)
        lines = self._delimiters() + self._oncoming_delimiters()
        facing = (
            {self.line_id("main", 0), self.line_id("oncoming", self.road.n_oncoming)} if self.road.n_oncoming else set()
        )
        delimiters = tuple(replace(at, is_inner=at.id in facing or (not facing and at.left is None)) for at in lines)
        return Network(self.terrain, roads, delimiters, self.links, self.flips.y)

    # -- painted lines

    def _line(
        self, section: str, j: int, marking: Marking, parts: Parts, start_m: float = -np.inf, end_m: float = np.inf
    ) -> LaneCurve:
        """Painted line j of a section; parts are a road, an offset and where it begins."""
        beside = (
            self.lane_id(section, j) if j > 0 else None,
            self.lane_id(section, j + 1) if j < self._count(section) else None,
        )
        return self._painted(self.line_id(section, j), marking, beside, parts, start_m, end_m)

    def _painted(
        self,
        name: str,
        marking: Marking,
        beside: LanesBeside,
        parts: Parts,
        start_m: float = -np.inf,
        end_m: float = np.inf,
    ) -> LaneCurve:
        left, right = beside[:: int(self.flips.x)]
        road = "exit" if name.startswith("exit") else "main"
        direction: Direction = "oncoming" if name.startswith("oncoming") else "same"
        return LaneCurve(name, "delimiter", road, marking, left, right, joined(parts), start_m, end_m, direction)

    def _on_main(self, t_m: float) -> Parts:
        return [(self.main_road, Offset(t_m), -np.inf)]

    def _through(self, j: int) -> LaneCurve:
        """Line j of the main road that runs along all of it."""
        road = self.road
        if j == 0 and self.is_divided_by_line:
            beside = self.lane_id("oncoming", road.n_oncoming), self.lane_id("main", 1)
            marking: Marking = "dashed" if road.divider_dashed else "solid"
            return self._painted(
                self.line_id("main", 0), marking, beside, self._on_main(self.boundary_m(0)), -np.inf, np.inf
            )
        return self._line("main", j, "dashed" if 0 < j < road.n_lanes else "solid", self._on_main(self.boundary_m(j)))

    @property
    def is_divided_by_line(self) -> bool:
        """Whether the main road's left line divides it from oncoming lanes."""
        return self.road.n_oncoming > 0 and self.road.median_m == 0

    def _delimiters(self) -> list[LaneCurve]:
        n, n_after, topology = self.road.n_lanes, self.road.n_main_after, self.road.topology
        if topology == 1:
            return [self._through(j) for j in range(n + 1)]
        main, half_m, nose_m = self.main_road, self.exit_half_m, self.nose_m

        def beyond(road: Road, t_m: float) -> Parts:
            return [(road, Offset(t_m), nose_m)]

        def leaving(stem_m: float, t_m: float) -> Parts:
            return [(main, Offset(stem_m), -np.inf), (self.exit_road, Offset(t_m), 0.0)]

        lines = [self._through(j) for j in range(n if topology == 2 else n - 1)]
        if topology == 3:
            # The dashed line between the last two lanes continues along the exit's left side to the nose.
            parted = self.lane_id("main", n), self.lane_id("exit", 1)
            lines += [
                self._painted("stem_line", "dashed", parted, leaving(self.boundary_m(n - 1), -half_m), -np.inf, nose_m),
                self._line("main", n - 1, "dashed", beyond(main, self.boundary_m(n - 1)), nose_m),
            ]
        lines += [
            self._line("main", n_after, "solid", beyond(main, self.boundary_m(n_after)), nose_m),
            self._line("exit", 0, "solid", beyond(self.exit_road, -half_m), nose_m),
        ]
        if topology == 4:
            lines.append(self._line("exit", 1, "dashed", leaving(self.boundary_m(n - 1), 0.0)))
        return [*lines, self._line("exit", self.road.n_exit_lanes, "solid", leaving(self.boundary_m(n), half_m))]

    def _oncoming_delimiters(self) -> list[LaneCurve]:
        """The lines of the oncoming lanes; without a median the innermost is the main road's own."""
        n = self.road.n_oncoming
        return [
            self._line(
                "oncoming",
                j,
                "dashed" if 0 < j < n else "solid",
                self._on_main(self.left_m + j * self.road.lane_width_m),
            )
            for j in range(n if self.is_divided_by_line or n == 0 else n + 1)
        ]
