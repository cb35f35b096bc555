"""The middles of a town's lanes as points, and routes along them. World frame, metres; lengths are those seen from
above."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from synth3dlanes.draw.town.layout import TownMap
from synth3dlanes.draw.town.plan import poses
from synth3dlanes.draw.town.streets import LANES, Street
from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.road_map import lane_key
from synth3dlanes.scene.scene import Terrain
from synth3dlanes.system.arrays import Points2, Scalars

LANE_STEP_M = 0.5


@dataclass(frozen=True, eq=False)
class LaneLine:
    """The middle of a lane as its traffic drives: points at lengths, the stations of its road and headings there."""

    lengths_m: Scalars
    stations: Scalars
    points: Points2
    headings: Scalars

    @property
    def length_m(self) -> float:
        """Its length."""
        return float(self.lengths_m[-1])

    @cached_property
    def sharpest(self) -> float:
        """Its largest curvature."""
        steps = np.diff(self.lengths_m)
        return float((np.abs(np.diff(self.headings)) / np.maximum(steps, 1e-3)).max())


class LaneLines:
    """The lanes of a town by name, as `LaneLine`, and routes along them, each made once."""

    def __init__(self, town_map: TownMap) -> None:
        self.town_map = town_map
        self.connectors = {at.lane: at for rules in town_map.junctions for at in rules.junction.connectors}
        self.streets = {street.id: street for street in town_map.streets}
        self._made: dict[str, LaneLine] = {}
        self._routes: dict[tuple[str, ...], Route] = {}

    def __getitem__(self, name: str) -> LaneLine:
        if name not in self._made:
            self._made[name] = self._line(name)
        return self._made[name]

    def route(self, lanes: tuple[str, ...]) -> "Route":
        """The route along linked lanes."""
        if lanes not in self._routes:
            self._routes[lanes] = Route(lanes, self)
        return self._routes[lanes]

    def _line(self, name: str) -> LaneLine:
        if name in self.connectors:
            plan, length_m = self.connectors[name].plan, self.connectors[name].length_m
            s = np.linspace(0, length_m, 2 + int(length_m / LANE_STEP_M))
            points, headings = poses(plan, s)
            return _measured(points, np.unwrap(headings), s)
        road, section, number = lane_key(name)
        return strip_line(self.streets[road], section, number)


def strip_line(street: Street, section: int, number: int) -> LaneLine:
    """The middle of a strip of a street, as traffic drives on its side."""
    side = "left" if number > 0 else "right"
    keys = list(street.names(section)[side])
    piece, start_m = street.pieces[section], street.stations[section]
    u = np.linspace(0, 1, 2 + int(piece.length_m / LANE_STEP_M))
    share, slope = u * u * (3 - 2 * u), 6 * u * (1 - u) / piece.length_m
    s = np.minimum(start_m + u * piece.length_m, street.length_m)
    points, headings = poses(street.plan, s)

    def offset_m(at_end: bool) -> float:
        widths = [street.width(section, side, key, at_end) for key in keys[: abs(number)]]
        out_m = sum(widths[:-1]) + widths[-1] / 2
        shift_m = piece.end.shift_m if at_end else piece.start.shift_m
        return shift_m + (out_m if number > 0 else -out_m)

    by = offset_m(True) - offset_m(False)
    left = np.stack([-np.sin(headings), np.cos(headings)], -1)
    points = points + (offset_m(False) + share * by)[:, None] * left
    headings = np.unwrap(headings + np.arctan(slope * by))
    if number > 0:
        return _measured(points[::-1], np.unwrap(headings[::-1] + np.pi), s[::-1])
    return _measured(points, headings, s)


def _measured(points: Points2, headings: Scalars, stations: Scalars) -> LaneLine:
    lengths = lengths_along(points)
    return LaneLine(lengths, stations, points, headings)


class Route:
    """Linked lanes one after the other: where each begins, and poses at lengths along all of them."""

    def __init__(self, lanes: Sequence[str], lines: LaneLines) -> None:
        self.lanes = tuple(lanes)
        own = [lines[name] for name in lanes]
        self.starts = np.concatenate([[0.0], np.cumsum([line.length_m for line in own])]).tolist()
        self.place = {name: k for k, name in enumerate(self.lanes)}
        self.sharpest = [line.sharpest for line in own]
        self._own = own

    @property
    def length_m(self) -> float:
        """Its length."""
        return float(self.starts[-1])

    def place_at(self, length_m: float) -> tuple[int, float]:
        """The number of the lane at a length, and the station of its road there."""
        k = min(int(np.searchsorted(self.starts, length_m, side="right")) - 1, len(self.lanes) - 1)
        own = self._own[k]
        return k, float(np.interp(length_m - self.starts[k], own.lengths_m, own.stations))

    def climbed(self, terrain: Terrain, lengths_m: Scalars) -> Scalars:
        """Lengths along the terrain at lengths seen from above."""
        lengths, points, _ = self._points
        steps = np.diff(lengths)
        rises = np.diff(height_at(terrain, points))
        return np.interp(lengths_m, lengths, np.concatenate([[0.0], np.cumsum(np.hypot(steps, rises))]))

    @cached_property
    def _points(self) -> tuple[Scalars, Points2, Scalars]:
        lengths = np.concatenate([line.lengths_m + start for line, start in zip(self._own, self.starts, strict=False)])
        points = np.concatenate([line.points for line in self._own])
        headings = np.unwrap(np.concatenate([line.headings for line in self._own]))
        return lengths, points, headings

    def xy(self, length_m: Scalars) -> Points2:
        """Points at lengths."""
        lengths, points, _ = self._points
        return np.stack([np.interp(length_m, lengths, points[:, k]) for k in (0, 1)], -1)

    def at(self, length_m: Scalars) -> tuple[Points2, Float[np.ndarray, "n 2"]]:
        """Points and unit headings at lengths."""
        lengths, _, headings = self._points
        heading = np.interp(length_m, lengths, headings)
        return self.xy(length_m), np.stack([np.cos(heading), np.sin(heading)], -1)


def street_lanes(street: Street, side: str, key: str) -> list[str]:
    """The names of a lane of a street through its sections, where it has its width."""
    names = [street.names(i)[side] for i in range(len(street.pieces))]
    return [name[key] for name in names if key in name]


def lanes_along(street: Street) -> list[tuple[str, str]]:
    """Sides and keys of the lanes along a street, without turn lanes."""
    return [(side, key) for side in ("left", "right") for key in LANES if key in street.profile.cross().left]
