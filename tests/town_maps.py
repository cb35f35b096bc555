"""An own reading of RoadMaps for tests: lanes as points and headings by summing small steps, without the sampler's
code."""

from functools import cache

import numpy as np

from synth3dlanes.scene.road_map import MapLane, MapRoad, PlanPiece, Polynomial, RoadMap

STEPS = 150


def _piece(piece: PlanPiece) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stations, points and headings of a piece at its ends and between, by the midpoint rule."""
    if piece.u is None or piece.v is None:
        s = np.linspace(0, piece.length_m, STEPS + 1)
        middles = (s[1:] + s[:-1]) / 2
        by = (piece.curvature_end - piece.curvature) / piece.length_m

        def heading(at: np.ndarray) -> np.ndarray:
            return np.asarray(piece.heading_rad + piece.curvature * at + by * at**2 / 2)

        turns = np.stack([np.cos(heading(middles)), np.sin(heading(middles))], -1) * np.diff(s)[:, None]
        points = np.array([piece.x_m, piece.y_m]) + np.concatenate([np.zeros((1, 2)), np.cumsum(turns, axis=0)])
        return s, points, heading(s)
    p = np.linspace(0, piece.parameter_end, STEPS + 1)
    u, v = (np.polynomial.Polynomial(c) for c in (piece.u, piece.v))
    cos, sin = np.cos(piece.heading_rad), np.sin(piece.heading_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    points = np.array([piece.x_m, piece.y_m]) + np.stack([u(p), v(p)], -1) @ turn.T
    along = np.stack([u.deriv()(p), v.deriv()(p)], -1) @ turn.T
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return s, points, np.unwrap(np.arctan2(along[:, 1], along[:, 0]))


def values(polynomials: tuple[Polynomial, ...], s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes of cubics at stations; 0 without polynomials."""
    value, slope = np.zeros_like(s), np.zeros_like(s)
    for at in polynomials:
        x = s - at.s_m
        here = x >= -1e-9
        value = np.where(here, at.a + x * (at.b + x * (at.c + x * at.d)), value)
        slope = np.where(here, at.b + x * (2 * at.c + x * 3 * at.d), slope)
    return value, slope


class MapReader:
    """Lanes of a map by name: points of the middle, headings as traffic drives, and width."""

    def __init__(self, road_map: RoadMap) -> None:
        self.roads = {road.id: road for road in road_map.roads}
        self.lines = {road.id: self._line(road) for road in road_map.roads}

    @staticmethod
    def _line(road: MapRoad) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s, points, headings, start = [], [], [], 0.0
        for piece in road.plan:
            own, xy, heading = _piece(piece)
            own = own * piece.length_m / own[-1]
            s.append(start + own)
            points.append(xy)
            headings.append(heading)
            start += piece.length_m
        turns = np.unwrap(np.concatenate(headings))
        return np.concatenate(s), np.concatenate(points), turns

    @cache  # noqa: B019
    def lane(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points, headings and widths along a lane's middle, as its traffic drives."""
        road_id, section, number_text = name.rsplit(".", 2)
        road, i, number = self.roads[road_id], int(section), int(number_text)
        start = road.sections[i].s_m
        end = road.sections[i + 1].s_m if i + 1 < len(road.sections) else road.length_m
        s_all, xy_all, h_all = self.lines[road_id]
        s = np.unique(np.concatenate([[start, end], s_all[(s_all > start) & (s_all < end)]]))
        xy = np.stack([np.interp(s, s_all, xy_all[:, k]) for k in (0, 1)], -1)
        heading = np.interp(s, s_all, h_all)
        inside = np.minimum(s, end - 1e-7)
        t, slope = values(road.lane_offsets, inside)
        sign = 1 if number > 0 else -1
        lanes: dict[int, MapLane] = {lane.number: lane for lane in road.sections[i].lanes}
        width = np.zeros_like(s)
        for k in range(1, abs(number) + 1):
            width, its_slope = values(lanes[sign * k].widths, inside - start)
            half = 0.5 if k == abs(number) else 1.0
            t, slope = t + sign * half * width, slope + sign * half * its_slope
        left = np.stack([-np.sin(heading), np.cos(heading)], -1)
        points = xy + t[:, None] * left
        headings = heading + np.arctan(slope)
        if number > 0:
            return points[::-1], headings[::-1] + np.pi, width[::-1]
        return points, headings, width


def off(a: float, b: float) -> float:
    """The angle between two headings."""
    return float(abs((a - b + np.pi) % (2 * np.pi) - np.pi))
