"""Walkways of a map near the host, as strips that people go along, round corners too. World frame, metres."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from synth3dlanes.geometry.polylines import lengths_along
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import Road
from synth3dlanes.system.arrays import Points2, Scalars

# Distance between points of strips, least width of a walkway, distance at which ends are joined.
STRIP_STEP_M, LEAST_WIDTH_M, JOINED_M = 1.0, 1.0, 1.0
# Headings are measured over this length to both sides.
HEADING_M = 0.3


class Walkway(NamedTuple):
    """A walkway: points of its edge at the road and of its other edge, beside each other."""

    inner: Points2
    outer: Points2

    @property
    def middle(self) -> Points2:
        """The line in its middle."""
        return (self.inner + self.outer) / 2

    def beside(self, aside_m: float, room_m: float) -> Points2:
        """The line `aside_m` from the edge at the road, at least `room_m` from the other one."""
        across = self.outer - self.inner
        width_m = np.linalg.norm(across, axis=1, keepdims=True)
        return self.inner + across * np.clip(np.minimum(aside_m, width_m - room_m) / width_m, 0.0, 1.0)


class WalkedLine(NamedTuple):
    """A line that somebody goes along, with lengths along it at its points."""

    points: Points2
    lengths_m: Scalars

    @classmethod
    def through(cls, points: Points2) -> "WalkedLine":
        """The route through points; of points that almost coincide it keeps one."""
        kept = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-3])
        return cls(points[kept], lengths_along(points[kept]))

    @property
    def length_m(self) -> float:
        """Its length."""
        return float(self.lengths_m[-1])

    def at(self, gone_m: Scalars) -> tuple[Points2, Scalars]:
        """Places at lengths along it, and where it leads there: counter-clockwise from world y."""
        behind, here, ahead = (self._places(gone_m + by) for by in (-HEADING_M, 0.0, HEADING_M))
        x, y = (ahead - behind).T
        return here, np.arctan2(-x, y)

    def _places(self, gone_m: Scalars) -> Points2:
        return np.stack([np.interp(gone_m, self.lengths_m, column) for column in self.points.T], -1)


class Walkways:
    """The walkways of a map that come within a reach of some places."""

    def __init__(self, network: Network, places: Points2, reach_m: float) -> None:
        self.strips = list[Walkway]()
        if any(road.sections for road in network.roads):
            low, high = network.index.boxes
            near = ((low < places.max(axis=0) + reach_m) & (high > places.min(axis=0) - reach_m)).all(axis=1)
            self.strips += [strip for i in np.flatnonzero(near).tolist() for strip in _strips(network.roads[i])]
        self.ends = np.array([strip.middle[[0, -1]] for strip in self.strips]).reshape(-1, 2)

    def starts(self, places: Points2, reach_m: float) -> list[tuple[int, int]]:
        """The strips and the numbers of their points within a reach of some places."""
        found = []
        for k, strip in enumerate(self.strips):
            away_m = np.linalg.norm(strip.middle[:, None] - places, axis=2).min(axis=1)
            found += [(k, i) for i in np.flatnonzero(away_m < reach_m).tolist()]
        return found

    def nearest(self, place: Float[np.ndarray, "2"]) -> tuple[tuple[int, int], float] | None:
        """The strip and the number of its point that is nearest to a place, and how far that is; None without any."""
        away_m = [np.linalg.norm(strip.middle - place, axis=1) for strip in self.strips]
        if not away_m:
            return None
        k = int(np.argmin([each.min() for each in away_m]))
        return (k, int(away_m[k].argmin())), float(away_m[k].min())

    def onward(
        self, start: tuple[int, int], forward: bool, aside: tuple[float, float], length_m: float
    ) -> list[Points2]:
        """The lines, beside the road as `Walkway.beside` says, from a point of a strip on until they are long enough or
        the walkway ends."""
        (k, i), lines, gone_m = start, list[Points2](), 0.0
        for _ in range(12):
            line = self.strips[k].beside(*aside)
            line = line[i:] if forward else line[: i + 1][::-1]
            lines.append(line)
            gone_m += float(lengths_along(line)[-1]) if len(line) > 1 else 0.0
            joined = self._joined(2 * k + int(forward))
            if gone_m > length_m or joined is None:
                break
            k, forward = joined // 2, joined % 2 == 0
            i = 0 if forward else len(self.strips[k].inner) - 1
        return lines

    def _joined(self, end: int) -> int | None:
        """The end of a strip where another one's end is."""
        away_m = np.linalg.norm(self.ends - self.ends[end], axis=1)
        away_m[[end - end % 2, end - end % 2 + 1]] = np.inf
        nearest = int(away_m.argmin())
        return nearest if away_m[nearest] < JOINED_M else None


def _strips(road: Road) -> Iterator[Walkway]:
    """The walkways of a road, section by section."""
    for stretch in road.stretches:
        (section,) = stretch.sections
        for i, lane in enumerate(section.lanes):
            if lane.kind == "walkway":
                s = np.linspace(
                    section.start_m, section.end_m, 2 + int((section.end_m - section.start_m) / STRIP_STEP_M)
                )
                inner, outer = (i + 1, i) if lane.number > 0 else (i, i + 1)
                found = Walkway(*(stretch.xy(s, section.edge(edge, s)) for edge in (inner, outer)))
                if np.linalg.norm(found.outer - found.inner, axis=1).min() > LEAST_WIDTH_M:
                    yield found
