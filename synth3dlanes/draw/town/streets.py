"""Streets: their cross sections, and the sections of lanes along them, with turn lanes that open before junctions.

A cross section is told looking away from a junction: traffic that comes in is on its left, as traffic keeps right.
World frame, metres.
"""

from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, pairwise
from typing import NamedTuple

from synth3dlanes.scene.road_map import (
    MapLane,
    MapLaneKind,
    MapMark,
    MapMarkKind,
    MapRoad,
    MapSection,
    PlanPiece,
    Polynomial,
)

PARKING_M, KERB_M, SHOULDER_M, GUTTER_M = 2.2, 0.15, 0.75, 0.3
# Turn lanes, and what is left of a median beside one.
TURN_LANE_M, RESIDUAL_M = 3.0, 0.8
# Length without parking before a junction; lengths over which widths change.
NO_PARKING_M, TURN_TAPER_M, PARKING_TAPER_M = 22.0, 20.0, 5.0
# Strips of a side from the reference line outwards.
KEYS = ("median", "turn_left", "lane1", "lane2", "lane3", "turn_right", "parking", "shoulder", "kerb", "walkway")
LANES = ("turn_left", "lane1", "lane2", "lane3", "turn_right")
KINDS: dict[str, MapLaneKind] = {
    **dict.fromkeys(LANES, "driving"),
    "median": "median",
    "parking": "parking",
    "shoulder": "shoulder",
    "kerb": "kerb",
    "walkway": "walkway",
}


class Pocket(NamedTuple):
    """The turn lanes of traffic that comes in at an end of a street, and how long they are."""

    left: bool = False
    right: bool = False
    length_m: float = 0.0


NO_POCKET = Pocket()


class Cross(NamedTuple):
    """A cross section: the offset of its reference line's lane 0 to the left, and widths by key on each side."""

    shift_m: float
    left: dict[str, float]
    right: dict[str, float]

    @property
    def flipped(self) -> "Cross":
        """The same, looked at from the other side."""
        return Cross(-self.shift_m, self.right, self.left)

    def edge(self, side: str) -> float:
        """The offset to the left of the pavement's edge on a side: the front of the kerb, if it has one."""
        widths = self.left if side == "left" else self.right
        wide_m = sum(width for key, width in widths.items() if key not in ("kerb", "walkway"))
        return self.shift_m + (wide_m if side == "left" else -wide_m)

    def middle(self, side: str, key: str) -> float:
        """The offset to the left of the middle of a strip."""
        widths = self.left if side == "left" else self.right
        inner_m = sum(widths.get(other, 0.0) for other in KEYS[: KEYS.index(key)])
        out_m = inner_m + widths[key] / 2
        return self.shift_m + (out_m if side == "left" else -out_m)


@dataclass(frozen=True)
class StreetForm:
    """A street: lanes of each direction and their width, a median, parked cars at its sides, walkways behind kerbs
    (0 for shoulders without them), and the line between its directions."""

    n_lanes: int
    lane_m: float
    median_m: float
    parking: bool
    walkway_m: float
    divider: MapMarkKind
    yellow: bool
    edge_lines: bool

    def cross(self, pocket: Pocket = NO_POCKET, near: bool = False) -> Cross:
        """The cross section, near a junction or along the street."""
        outer = {f"lane{i + 1}": self.lane_m for i in range(self.n_lanes)}
        ends = {"shoulder": GUTTER_M if self.walkway_m else SHOULDER_M}
        ends |= {"kerb": KERB_M, "walkway": self.walkway_m} if self.walkway_m else {}
        parking = {"parking": PARKING_M} if self.parking and not near else {}
        half_m = self.median_m / 2
        if not pocket.left:
            inner = {"median": half_m} if half_m else {}
            turn = {"turn_right": TURN_LANE_M} if pocket.right else {}
            return Cross(0.0, inner | outer | turn | parking | ends, inner | outer | parking | ends)
        residual_m = min(RESIDUAL_M, self.median_m)
        widened_m = max(0.0, TURN_LANE_M + residual_m - self.median_m)
        # The turn lane takes the median's left part; what is missing widens the street to both sides.
        kept_m = self.median_m + widened_m - TURN_LANE_M
        shift_m = -half_m - widened_m / 2 + kept_m / 2
        inner = {"median": kept_m / 2} if kept_m > 0 else {}
        turn = {"turn_right": TURN_LANE_M} if pocket.right else {}
        left = inner | {"turn_left": TURN_LANE_M} | outer | turn | parking | ends
        return Cross(shift_m, left, inner | outer | parking | ends)


class StreetPiece(NamedTuple):
    """A section of a street: its length, cross sections at its start and end, and whether it is near a junction."""

    length_m: float
    start: Cross
    end: Cross
    near: bool


class LaneAt(NamedTuple):
    """A lane of a street at one of its ends: its name, its key, and the offset of its middle to the left, looking away
    from the junction there."""

    name: str
    key: str
    offset_m: float
    width_m: float


@dataclass(frozen=True)
class Street:
    """A street on its plan. `ends` are the pockets of its start and its end; None where it leads to no junction."""

    id: str
    profile: StreetForm
    plan: tuple[PlanPiece, ...]
    start: Pocket
    end: Pocket | None = None
    pieces: tuple[StreetPiece, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pieces", tuple(_pieces(self.profile, self.length_m, self.start, self.end)))

    @cached_property
    def length_m(self) -> float:
        """Length of its reference line."""
        return sum(piece.length_m for piece in self.plan)

    @cached_property
    def stations(self) -> list[float]:
        """Where its sections begin, and the end of the last one."""
        return list(accumulate((piece.length_m for piece in self.pieces), initial=0.0))

    def section_at(self, s_m: float) -> int:
        """The number of the section at a station."""
        return min(max(bisect_right(self.stations, s_m) - 1, 0), len(self.pieces) - 1)

    def eased_at(self, s_m: float) -> tuple[StreetPiece, float]:
        """The section at a station, and the share of the change from its start to its end there."""
        i = self.section_at(s_m)
        u = (s_m - self.stations[i]) / self.pieces[i].length_m
        return self.pieces[i], u * u * (3 - 2 * u)

    def cross_at(self, at_start: bool) -> Cross:
        """The cross section at an end, looking away from the junction there."""
        return self.pieces[0].start if at_start else self.pieces[-1].end.flipped

    def lanes_at(self, at_start: bool, incoming: bool) -> list[LaneAt]:
        """The lanes of one direction at an end, from the driver's left."""
        cross = self.cross_at(at_start)
        side = "left" if incoming else "right"
        widths = cross.left if incoming else cross.right
        section = 0 if at_start else len(self.pieces) - 1
        # Looking away from its start, a street's own left is on the left; from its end, on the right.
        own_left = incoming == at_start
        names = self.names(section)
        return [
            LaneAt(names["left" if own_left else "right"][key], key, cross.middle(side, key), widths[key])
            for key in LANES
            if widths.get(key, 0.0) > 0
        ]

    def names(self, section: int) -> dict[str, dict[str, str]]:
        """The names of a section's lanes by side and key."""
        return self._names[section]

    @cached_property
    def _names(self) -> list[dict[str, dict[str, str]]]:
        return [
            {
                side: {key: f"{self.id}.{section}.{sign * (i + 1)}" for i, key in enumerate(self._keys(section, side))}
                for side, sign in (("left", 1), ("right", -1))
            }
            for section in range(len(self.pieces))
        ]

    def width(self, section: int, side: str, key: str, at_end: bool) -> float:
        """The width of a strip at the start or the end of a section."""
        cross = self.pieces[section].end if at_end else self.pieces[section].start
        return (cross.left if side == "left" else cross.right).get(key, 0.0)

    def _keys(self, section: int, side: str) -> list[str]:
        return [
            key for key in KEYS if self.width(section, side, key, False) > 0 or self.width(section, side, key, True) > 0
        ]

    @property
    def links(self) -> list[tuple[str, str]]:
        """The links between lanes of its sections."""
        found = []
        for i, j in pairwise(range(len(self.pieces))):
            before, after = self.names(i), self.names(j)
            for side in ("left", "right"):
                for key in LANES:
                    if key in before[side] and key in after[side] and self.width(j, side, key, False) > 0:
                        pair = before[side][key], after[side][key]
                        found.append(pair if side == "right" else pair[::-1])
        return found

    @property
    def road(self) -> MapRoad:
        """The street as a road of a map."""
        stations = self.stations
        sections = tuple(
            MapSection(s_m=round(stations[i], 6), lanes=tuple(self._lanes(i))) for i in range(len(self.pieces))
        )
        offsets = tuple(
            smooth(round(stations[i], 6), piece.length_m, piece.start.shift_m, piece.end.shift_m)
            for i, piece in enumerate(self.pieces)
        )
        has_offsets = any(piece.start.shift_m or piece.end.shift_m for piece in self.pieces)
        return MapRoad(id=self.id, plan=self.plan, sections=sections, lane_offsets=offsets if has_offsets else ())

    def _lanes(self, section: int) -> list[MapLane]:
        piece = self.pieces[section]
        sides = []
        for side, sign in (("left", 1), ("right", -1)):
            keys = self._keys(section, side)
            sides.append(
                [
                    MapLane(
                        number=sign * (i + 1),
                        kind=KINDS[key],
                        widths=(
                            smooth(
                                0.0,
                                piece.length_m,
                                self.width(section, side, key, False),
                                self.width(section, side, key, True),
                            ),
                        ),
                        marks=self._marks(piece, keys, i),
                    )
                    for i, key in enumerate(keys)
                ]
            )
        left, right = sides
        return [*reversed(left), MapLane(number=0, kind="none", marks=self._divider(piece)), *right]

    def _divider(self, piece: StreetPiece) -> tuple[MapMark, ...]:
        if "median" in piece.start.left or "median" in piece.end.left:
            return ()
        kind = "solid" if piece.near and self.profile.divider == "dashed" else self.profile.divider
        return (MapMark(kind=kind, yellow=self.profile.yellow),)

    def _marks(self, piece: StreetPiece, keys: list[str], i: int) -> tuple[MapMark, ...]:
        """The paint on the outer edge of a strip."""
        key, outer = keys[i], keys[i + 1] if i + 1 < len(keys) else ""
        if key == "median":
            return (MapMark(kind="solid", yellow=self.profile.yellow),)
        if key in LANES and outer in LANES:
            return (MapMark(kind="solid" if piece.near else "dashed"),)
        if key in LANES and outer == "parking":
            return (MapMark(kind="dashed"),)
        if key in LANES and (self.profile.edge_lines or not self.profile.walkway_m):
            return (MapMark(kind="solid"),)
        return ()


def _pieces(profile: StreetForm, length_m: float, start: Pocket, end: Pocket | None) -> list[StreetPiece]:
    """The sections of a street: near its junctions, where widths change, and between."""
    along = profile.cross()

    def zone(pocket: Pocket) -> tuple[float, float]:
        turns = pocket.left or pocket.right
        return (max(pocket.length_m, NO_PARKING_M), TURN_TAPER_M) if turns else (NO_PARKING_M, PARKING_TAPER_M)

    near_start, near_end = profile.cross(start, near=True), None if end is None else profile.cross(end, near=True)
    need_m = sum(zone(start)) + (0.0 if end is None else sum(zone(end))) + 5.0
    if need_m > length_m:
        plain = profile.cross(near=True)
        return [StreetPiece(length_m, plain, plain, True)]
    near_m, taper_m = zone(start)
    pieces = [StreetPiece(near_m, near_start, near_start, True), StreetPiece(taper_m, near_start, along, False)]
    used_m = near_m + taper_m
    tail: list[StreetPiece] = []
    if end is not None and near_end is not None:
        near_m, taper_m = zone(end)
        flipped = near_end.flipped
        tail = [StreetPiece(taper_m, along, flipped, False), StreetPiece(near_m, flipped, flipped, True)]
        used_m += near_m + taper_m
    return [*pieces, StreetPiece(length_m - used_m, along, along, False), *tail]


def smooth(s_m: float, length_m: float, start: float, end: float) -> Polynomial:
    """A value that changes without a corner from one end of a section to the other."""
    by = end - start
    return Polynomial(
        s_m=s_m,
        a=round(start, 9),
        c=round(3 * by / length_m**2, 12),
        d=round(-2 * by / length_m**3, 12),
    )
