"""What stands beside and over the road, as bodies of flat coloured quads. World frame, metres.

A structure is placed from the edges of the pavement (`beside`), stands on the ground as built, and is cheap: a few
quads across a rail, fewer rows and posts far from the host.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.ground import Ground
from synth3dlanes.geometry.sign_faces import FACES, Layer, board
from synth3dlanes.labels import RoadName
from synth3dlanes.scene import Building, Crossing, Post, Rail, RoadSide, Roadside

Values = Float[np.ndarray, " n"]
Points2 = Float[np.ndarray, "n 2"]
Points3 = Float[np.ndarray, "n 3"]
Corners = Float[np.ndarray, "f 4 3"]

# The semantic names of a body's faces; `Body.surface` numbers them.
SURFACES = ("barrier", "pole", "sign", "bridge", "building", "kerb")
# How far bodies reach into the ground, so that none floats on a slope.
SINK_M = 0.4
# Lengths of a rail's pieces: up to these distances ahead of the host, and beyond.
PIECES_M = ((60.0, 2.0), (140.0, 4.0), (np.inf, 8.0))
# Distance between the posts of guardrail and noise wall near the host, and beyond FAR_POSTS_M.
POSTS_M, FAR_POSTS_M, POSTS_FAR_M = 4.0, 80.0, 12.0
# A guardrail's face, from its front (across, up) with its top at 0; it is sunk to the ground over END_M at both ends.
W_BEAM_M = np.array([(0.08, 0.0), (0.0, -0.06), (0.08, -0.155), (0.0, -0.25), (0.08, -0.31)])
END_M = 6.0
# Half of a concrete barrier's section (Jersey shape) as shares of its height, from the bottom.
JERSEY = np.array([(0.37, 0.0), (0.37, 0.1), (0.2, 0.4), (0.1, 1.0)])
KERB_M, WALKWAY_M, WALL_M = 0.15, 1.8, 0.14
POLES_M, WIRE_M, SAG_M, CROSSARM_M = 45.0, 0.025, 0.9, 1.1
LAMP_ARM_M, LAMP_HEAD_M = 1.8, np.array([0.14, 0.38, 0.06])
# Least gap between a crossing's supports and any pavement, and how far from its axis supports are looked for.
SUPPORT_GAP_M, MAX_SPAN_M = 0.8, 90.0
# From a bridge's outer columns to its abutments, the slope and the fall of the dams behind these, and their length.
ABUTMENT_M, DAM_SLOPE, DAM_FALL, DAM_M = 7.0, 1.5, 0.05, 110.0
DECK_M, PARAPET_M, ABUTMENT_WALL_M = 1.1, 0.95, 1.0
STOREY_M = 3.0

METAL, DARK_METAL = (0.36, 0.37, 0.38, 0.5), (0.2, 0.21, 0.22, 0.4)
WHITE, BLACK, GLASS = (0.7, 0.7, 0.68, 0.3), (0.02, 0.02, 0.02, 0.2), (0.05, 0.06, 0.08, 0.35)
WOOD, EARTH = (0.1, 0.07, 0.045, 0.0), (0.1, 0.1, 0.05, 0.0)


@dataclass(frozen=True, eq=False)
class Body:
    """One structure: its quads, each with a colour (linear red, green, blue, and gloss) and a number in SURFACES, and
    the points where it stands on the ground."""

    kind: str
    corners_world: Corners
    colors: Float[np.ndarray, "f 4"]
    surface: Int[np.ndarray, " f"]
    feet_world: Points3


class _Quads:
    """Collects the quads of one body."""

    def __init__(self, kind: str, surface: str) -> None:
        self.kind, self.default = kind, surface
        self.corners: list[Corners] = []
        self.colors: list[Float[np.ndarray, "f 4"]] = []
        self.surfaces: list[Int[np.ndarray, " f"]] = []
        self.feet: list[Points3] = []

    def add(self, corners: Corners, color: Sequence[float], surface: str = "") -> None:
        """Quads of one colour."""
        self.corners.append(corners)
        self.colors.append(np.tile(np.array(_glossy(color), dtype=float), (len(corners), 1)))
        self.surfaces.append(np.full(len(corners), SURFACES.index(surface or self.default)))

    def box(
        self, frame: "Frame", low: Sequence[float], high: Sequence[float], color: Sequence[float], surface: str = ""
    ) -> None:
        """A box between two corners of a frame."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        walls = [[(*a, z0), (*b, z0), (*b, z1), (*a, z1)] for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)]
        ends = [[(*corner, z) for corner in ring] for z in (z0, z1)]
        self.add(frame.world(np.array(walls + ends)), color, surface)

    def tube(
        self, ends_world: Float[np.ndarray, "2 3"], radii_m: tuple[float, float], color: Sequence[float], n: int = 6
    ) -> None:
        """The side of a tapered prism with n faces between two points."""
        along = ends_world[1] - ends_world[0]
        along /= np.linalg.norm(along)
        across = np.cross(along, [1.0, 0, 0] if abs(along[0]) < 0.7 else [0, 1.0, 0])
        across /= np.linalg.norm(across)
        angles = 2 * np.pi * (np.arange(n + 1) + 0.5) / n
        ring = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(along, across)
        rings = ends_world[:, None] + np.array(radii_m)[:, None, None] * ring
        self.sweep(rings, color)

    def sweep(self, rows: Float[np.ndarray, "r c 3"], color: Sequence[float], surface: str = "") -> None:
        """Quads between consecutive rows and columns of points."""
        corners = np.stack([rows[:-1, :-1], rows[:-1, 1:], rows[1:, 1:], rows[1:, :-1]], axis=2)
        self.add(corners.reshape(-1, 4, 3), color, surface)

    def body(self) -> Body:
        """The body of all quads so far."""
        return Body(
            self.kind,
            np.concatenate([*self.corners, np.zeros((0, 4, 3))]),
            np.concatenate([*self.colors, np.zeros((0, 4))]),
            np.concatenate([*self.surfaces, np.zeros(0, dtype=int)]),
            np.concatenate([*self.feet, np.zeros((0, 3))]),
        )


@dataclass(frozen=True, eq=False)
class Frame:
    """A place on the ground: x to the right as the host drives, y forward, z up; `outward` is 1 where the road lies on
    the left of it, and -1 where it lies on the right."""

    origin: Float[np.ndarray, "3"]
    forward: Float[np.ndarray, "2"]
    outward: float = 1.0

    def world(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """World points of points in this frame."""
        fx, fy = self.forward
        x, y = points[..., 0], points[..., 1]
        return self.origin + np.stack([x * fy + y * fx, y * fy - x * fx, points[..., 2]], -1)


def bodies(ground: Ground, roadside: Roadside) -> list[Body]:
    """All structures in the order of their instance ids."""
    frames = post_frames(ground, roadside.posts)
    return [
        *(_rail(ground, rail) for rail in roadside.rails),
        *(_post(post, frame) for post, frame in zip(roadside.posts, frames, strict=True)),
        *(_crossing(ground, crossing) for crossing in roadside.crossings),
        *(_building(ground, building) for building in roadside.buildings),
    ]


def lamp_heads(ground: Ground, roadside: Roadside) -> Points3:
    """The middles of the lower sides of all lamps' heads."""
    lamps = [post for post in roadside.posts if post.kind == "lamp"]
    heads = [_lamp_heads(frame, post) for frame, post in zip(post_frames(ground, lamps), lamps, strict=True)]
    return np.concatenate([*heads, np.zeros((0, 3))])


def beside(ground: Ground, road: RoadName, side: RoadSide, s: Values, aside_m: Values | float) -> Points2:
    """World (x, y) at plan stations, `aside_m` outside an edge of the pavement; of the side `median`, at this plan
    offset of the main road."""
    plan = ground.plan
    if road == "exit":
        t = ground.exit_edge_m + np.asarray(aside_m)
        return plan.exit_xy(s, np.broadcast_to(t if side == "right" else -t, s.shape))
    edges = {"left": ground.left_edge_m - np.asarray(aside_m), "median": np.asarray(aside_m)}
    t = edges[side] if side in edges else ground.main_right_edge(s) + aside_m
    return plan.main_xy(s, np.broadcast_to(t, s.shape))


def post_frames(ground: Ground, posts: Sequence[Post]) -> "list[Frame]":
    """Where posts stand."""
    found: dict[int, Frame] = {}
    for road, side in dict.fromkeys((post.road, post.side) for post in posts):
        own = [i for i, post in enumerate(posts) if (post.road, post.side) == (road, side)]
        s, aside_m = np.array([(posts[i].s_m, posts[i].aside_m) for i in own]).T
        found |= dict(zip(own, _frames(ground, road, side, s, aside_m), strict=True))
    return [found[i] for i in range(len(posts))]


@dataclass(frozen=True, eq=False)
class Footprints:
    """Segments with a radius that cover what stands on the ground, and dams, seen from above."""

    starts: Points2
    ends: Points2
    radii_m: Values

    def clear(self, xy_world: Points2, room_m: float) -> Bool[np.ndarray, " n"]:
        """Which points are at least `room_m` from all of them."""
        along = self.ends - self.starts
        to = xy_world[:, None] - self.starts
        share = np.clip((to * along).sum(axis=2) / np.maximum((along * along).sum(axis=1), 1e-9), 0, 1)
        apart_m = np.linalg.norm(to - share[..., None] * along, axis=2)
        return np.asarray((apart_m > self.radii_m + room_m).all(axis=1))


def footprints(ground: Ground, roadside: Roadside) -> Footprints:
    """The footprints of all structures."""
    parts = [
        *(_rail_footprint(ground, rail) for rail in roadside.rails),
        *((frame.origin[None, :2],) * 2 + (1.0,) for frame in post_frames(ground, roadside.posts)),
        *(_crossing_footprint(ground, crossing) for crossing in roadside.crossings),
        *(_building_footprint(building) for building in roadside.buildings),
    ]
    nothing = np.zeros((0, 2))
    return Footprints(
        np.concatenate([starts for starts, _, _ in parts] + [nothing]),
        np.concatenate([ends for _, ends, _ in parts] + [nothing]),
        np.concatenate([np.full(len(starts), radius_m) for starts, _, radius_m in parts] + [np.zeros(0)]),
    )


def _rail_footprint(ground: Ground, rail: Rail) -> tuple[Points2, Points2, float]:
    s = np.linspace(rail.from_m, rail.to_m, 2 + int(abs(rail.to_m - rail.from_m) / 8))
    line = beside(ground, rail.road, rail.side, s, rail.aside_m)
    return line[:-1], line[1:], WALKWAY_M if rail.kind == "walkway" else 0.6


def _crossing_footprint(ground: Ground, crossing: Crossing) -> tuple[Points2, Points2, float]:
    frame, span = crossing_frame(ground, crossing), crossing_span(ground, crossing)
    (left, right), radius_m = span.legs_m, crossing.width_m / 2
    if crossing.kind == "bridge":
        left, right = span.abutments_m[0] - DAM_M, span.abutments_m[1] + DAM_M
        radius_m += DAM_SLOPE * (span.top_m - float(frame.origin[2]))
    ends = frame.world(np.array([[left, 0, 0], [right, 0, 0.0]]))[:, :2]
    return ends[:1], ends[1:], radius_m


def _building_footprint(building: Building) -> tuple[Points2, Points2, float]:
    half, frame = np.sort([building.width_m, building.length_m]) / 2, building_frame(building)
    reach = np.array([0.0, half[1] - half[0], 0.0])
    reach = reach if building.length_m > building.width_m else reach[[1, 0, 2]]
    return frame.world(-reach)[None, :2], frame.world(reach)[None, :2], 1.42 * float(half[0])


# -- rails


def rail_stations(ground: Ground, rail: Rail) -> Values:
    """Plan stations of the rows of a rail, denser near the host."""
    low, high = sorted((rail.from_m, rail.to_m))
    near = ground.near_m * float(ground.plan.flips[1])
    rows = [low]
    while rows[-1] < high:
        step = next(step for reach, step in PIECES_M if abs(rows[-1] - near) < reach)
        rows.append(min(rows[-1] + step, high))
    return np.array(rows)


def _rail(ground: Ground, rail: Rail) -> Body:
    s = rail_stations(ground, rail)
    color = (*rail.color, 0.0)
    if rail.kind == "power_line":
        return _power_line(ground, rail, color)
    quads = _Quads(rail.kind, "kerb" if rail.kind in ("kerb", "walkway") else "barrier")
    if rail.kind == "guardrail":
        _guardrail(quads, ground, rail, s)
    elif rail.kind == "noise_wall":
        _noise_wall(quads, ground, rail, s, color)
    else:
        if rail.kind == "concrete":
            half = JERSEY * rail.height_m
            section = np.concatenate(
                [half[:1] - [0, SINK_M], half, half[::-1] * [-1, 1], half[:1] * [-1, 1] - [0, SINK_M]]
            )
            section[:, 0] += half[0, 0] if rail.side != "median" else 0.0
        else:
            back_m = KERB_M if rail.kind == "kerb" else WALKWAY_M
            up = rail.height_m
            section = np.array(
                [(0, -SINK_M), (0, up - 0.02), (0.02, up), (KERB_M, up), (back_m, up), (back_m, -SINK_M - 0.3)]
            )
        rows = _rows(ground, rail, s, section[:, 0], section[:, 1] + _edge_height(ground, rail, s)[:, None])
        quads.sweep(rows, color)
        quads.add(rows[[0, -1]][:, [0, 2, 3, -1]], color)
    _stand(quads, ground, _rows(ground, rail, s, np.zeros(1), np.zeros((len(s), 1)))[:, 0, :2])
    return quads.body()


def _rows(
    ground: Ground, rail: Rail, s: Values, across_m: Float[np.ndarray, " c"], z: Float[np.ndarray, "*#rows"]
) -> Float[np.ndarray, "r c 3"]:
    """World points at stations and distances outwards from a rail's front, at heights z."""
    z = np.broadcast_to(z, (len(s), len(across_m)))
    columns = [beside(ground, rail.road, rail.side, s, rail.aside_m + across) for across in across_m]
    return np.concatenate([np.stack(columns, axis=1), z[..., None]], axis=2)


def _edge_height(ground: Ground, rail: Rail, s: Values) -> Values:
    """Height of the pavement beside a rail: what stands near its edge is as high over the road everywhere."""
    inside = rail.aside_m if rail.side == "median" else -0.02
    return ground.height(beside(ground, rail.road, rail.side, s, inside))


def _foot_height(ground: Ground, rail: Rail, s: Values, across_m: float) -> Values:
    return ground.height(beside(ground, rail.road, rail.side, s, rail.aside_m + across_m))


def _guardrail(quads: _Quads, ground: Ground, rail: Rail, s: Values) -> None:
    """W-beams before posts; a median's has beams on both sides."""
    color = (*rail.color, 0.5)
    s = np.unique(np.concatenate([s, [rail.from_m + END_M, rail.to_m - END_M]]))
    s = s[(s >= rail.from_m) & (s <= rail.to_m)]
    up = np.clip(np.minimum(s - rail.from_m, rail.to_m - s) / END_M, 0, 1)
    top = _edge_height(ground, rail, s) + rail.height_m * up + 0.05 * (up - 1)
    for sign in (1, -1) if rail.side == "median" else (1,):
        offset = -0.2 if rail.side == "median" else 0.0
        quads.sweep(_rows(ground, rail, s, sign * (W_BEAM_M[:, 0] + offset), top[:, None] + W_BEAM_M[:, 1]), color)
    behind_m = 0.0 if rail.side == "median" else 0.16
    _posts(quads, ground, rail, behind_m, (0.07, 0.055), rail.height_m - 0.03, color, rail.from_m + END_M)


def _noise_wall(quads: _Quads, ground: Ground, rail: Rail, s: Values, color: Sequence[float]) -> None:
    """Panels in bands of two shades between posts, and a light cap."""
    foot = _foot_height(ground, rail, s, WALL_M / 2)[:, None]
    n_bands = max(2, round(rail.height_m / 0.8))
    levels = np.linspace(0, rail.height_m, n_bands + 1)
    for band, (low, high) in enumerate(pairwise(levels)):
        shade = 1.0 if band % 2 else 0.86
        tone = (*(shade * channel for channel in color[:3]), 0.0)
        low = low if band else -SINK_M
        for across in (0.0, WALL_M):
            quads.sweep(_rows(ground, rail, s, np.full(2, across), foot + np.array([low, high])), tone)
    quads.sweep(_rows(ground, rail, s, np.array([-0.03, WALL_M + 0.03]), foot + rail.height_m + 0.03), color)
    dark = (*(0.75 * channel for channel in color[:3]), 0.0)
    _posts(quads, ground, rail, WALL_M / 2, (0.11, 0.09), rail.height_m + 0.05, dark, rail.from_m)


def _posts(
    quads: _Quads,
    ground: Ground,
    rail: Rail,
    across_m: float,
    half_m: tuple[float, float],
    height_m: float,
    color: Sequence[float],
    first_m: float,
) -> None:
    """Posts along a rail up to a height over the edge of the pavement (of a noise wall: over the ground)."""
    s = np.arange(first_m, rail.to_m - (first_m - rail.from_m) + 0.01, POSTS_M)
    away = np.abs(ground.plan.plan_station(s) - ground.near_m)
    s = s[(away < FAR_POSTS_M) | (np.arange(len(s)) % round(POSTS_FAR_M / POSTS_M) == 0)]
    foot = _foot_height(ground, rail, s, across_m)
    top = foot if rail.kind == "noise_wall" else _edge_height(ground, rail, s)
    frames = _frames(ground, rail.road, rail.side, s, rail.aside_m + across_m)
    for frame, rise_m in zip(frames, (top - foot + height_m).tolist(), strict=True):
        x, y = half_m
        quads.box(frame, (-x, -y, -SINK_M), (x, y, rise_m), color)


def _power_line(ground: Ground, rail: Rail, color: Sequence[float]) -> Body:
    """Wooden poles with a crossarm and three wires."""
    quads = _Quads(rail.kind, "pole")
    n = max(1, round((rail.to_m - rail.from_m) / POLES_M))
    frames = _frames(ground, rail.road, rail.side, np.linspace(rail.from_m, rail.to_m, n + 1), rail.aside_m)
    h = rail.height_m
    ties = np.array([(-CROSSARM_M, 0, h + 0.1), (0, 0, h + 0.35), (CROSSARM_M, 0, h + 0.1)])
    for frame in frames:
        quads.tube(frame.world(np.array([(0, 0, -SINK_M), (0, 0, h + 0.3)])), (0.15, 0.1), color)
        quads.box(frame, (-CROSSARM_M - 0.1, -0.06, h - 0.1), (CROSSARM_M + 0.1, 0.06, h + 0.05), color)
    sag = np.linspace(-1, 1, 7)[:, None]
    for a, b in pairwise(frames):
        for tie in ties:
            start, end = a.world(tie), b.world(tie)
            wire = start + (sag + 1) / 2 * (end - start) - SAG_M * (1 - sag**2) * [0, 0, 1.0]
            for piece in pairwise(wire):
                quads.tube(np.array(piece), (WIRE_M, WIRE_M), BLACK, n=3)
    _stand(quads, ground, np.array([frame.origin[:2] for frame in frames]))
    return quads.body()


# -- posts


def _post(post: Post, frame: Frame) -> Body:
    quads = _Quads(post.kind, "pole")
    if post.kind == "lamp":
        _lamp(quads, frame, post)
    elif post.kind == "delineator":
        h = post.height_m
        for low, high, color in ((-SINK_M, h - 0.32, WHITE), (h - 0.32, h - 0.08, BLACK), (h - 0.08, h, WHITE)):
            quads.box(frame, (-0.06, -0.04, low), (0.06, 0.04, high), color)
        for y in (-0.045, 0.045):
            quads.box(frame, (-0.03, y - 0.004, h - 0.29), (0.03, y + 0.004, h - 0.12), (0.75, 0.45, 0.1, 1.0))
    else:
        _sign(quads, frame, post)
    quads.feet.append(frame.origin[None])
    return quads.body()


def _lamp(quads: _Quads, frame: Frame, post: Post) -> None:
    """A tapered pole, with an arm and a head over the road; on a median, with one over either side."""
    h = post.height_m
    quads.tube(frame.world(np.array([(0, 0, -SINK_M), (0, 0, h)])), (0.1, 0.06), METAL)
    for side in _arms(post):
        out = -side * frame.outward
        quads.tube(frame.world(np.array([(0, 0, h - 0.05), (out * LAMP_ARM_M, 0, h + 0.25)])), (0.05, 0.04), METAL)
        middle = np.array([out * (LAMP_ARM_M + LAMP_HEAD_M[1]), 0, h + 0.28])
        half = LAMP_HEAD_M[[1, 0, 2]]
        quads.box(frame, (middle - half).tolist(), (middle + half).tolist(), DARK_METAL)
        glass = middle - [0, 0, half[2] + 0.01]
        half = half * [0.8, 0.8, 0.1]
        quads.box(frame, (glass - half).tolist(), (glass + half).tolist(), WHITE)


def _arms(post: Post) -> tuple[int, ...]:
    return (1, -1) if post.side == "median" else (1,)


def _lamp_heads(frame: Frame, post: Post) -> Points3:
    reach, z = LAMP_ARM_M + LAMP_HEAD_M[1], post.height_m + 0.28 - LAMP_HEAD_M[2] - 0.02
    return np.array([frame.world(np.array([-side * frame.outward * reach, 0, z])) for side in _arms(post)])


def _sign(quads: _Quads, frame: Frame, post: Post) -> None:
    """One or two tubes and a board whose lower edge is at the post's height."""
    layers = FACES[post.face - 1]
    width_m, up_m = np.ptp(layers[0].outline, axis=0)
    for x in (-0.3 * width_m, 0.3 * width_m) if width_m > 1.3 else (0.0,):
        quads.tube(frame.world(np.array([(x, 0, -SINK_M), (x, 0, post.height_m + 0.9 * up_m)])), (0.04, 0.04), METAL)
    low = float(layers[0].outline[:, 1].min())
    _board(quads, frame, layers, np.array([0, -0.06, post.height_m - low]), post.turned)


def _board(quads: _Quads, frame: Frame, layers: Sequence[Layer], middle: Float[np.ndarray, "3"], turned: bool) -> None:
    """A board's gray back and the layers of its face, towards the host or, turned, away from it."""
    sign = -1.0 if turned else 1.0
    for i, layer in enumerate([Layer(layers[0].outline, METAL[:3]), *layers]):
        corners = layer.quads()
        depth = np.full(corners.shape[:2], 0.02 if i == 0 else -0.02 - 0.004 * i)
        local = np.stack([sign * corners[..., 0], sign * depth, corners[..., 1]], -1)
        quads.add(frame.world(local + middle * [1, sign, 1]), (*layer.color, 0.5), "sign")


# -- crossings


@dataclass(frozen=True)
class Span:
    """A crossing in its frame: x of its legs and of a bridge's abutments (left and right), and the world heights of its
    lower side and its top."""

    legs_m: tuple[float, float]
    abutments_m: tuple[float, float]
    under_m: float
    top_m: float


def crossing_frame(ground: Ground, crossing: Crossing) -> Frame:
    return _frames(ground, "main", "median", np.array([crossing.s_m]), 0.0)[0]


def crossing_span(ground: Ground, crossing: Crossing) -> Span:
    """Where a crossing's legs and abutments stand clear of all pavements, and how high it is above these."""
    frame = crossing_frame(ground, crossing)
    half_m = crossing.width_m / 2
    x = np.arange(-MAX_SPAN_M, MAX_SPAN_M + 0.1, 0.25)
    y = np.linspace(-half_m, half_m, 5)
    strip = frame.world(np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((len(x), len(y)))], -1))[..., :2]
    clearance_m = ground.clearance(strip).min(axis=1)
    gap_m = SUPPORT_GAP_M + (0.5 if crossing.kind == "bridge" else 0.2)
    legs, abutments = [], []
    for sign in (-1, 1):
        out = np.flatnonzero((sign * x > 0) & (clearance_m > gap_m))
        legs.append(float(x[out[np.abs(x[out]).argmin()]]) if out.size else sign * MAX_SPAN_M)
        paved = sign * x[(sign * x > 0) & (clearance_m < 3.0)]
        abutments.append(sign * max(float(paved.max(initial=0.0)) + 1.0, sign * legs[-1] + ABUTMENT_M))
    ends = abutments if crossing.kind == "bridge" else legs
    under = strip[(x > ends[0]) & (x < ends[1])]
    heights = ground.height(under.reshape(-1, 2)).reshape(under.shape[:2])
    paved_m = heights[ground.clearance(under.reshape(-1, 2)).reshape(under.shape[:2]) < 0.5]
    under_m = float(paved_m.max()) + crossing.clearance_m
    depth_m = DECK_M if crossing.kind == "bridge" else 2.0
    return Span((legs[0], legs[1]), (abutments[0], abutments[1]), under_m, under_m + depth_m)


def _crossing(ground: Ground, crossing: Crossing) -> Body:
    frame, span = crossing_frame(ground, crossing), crossing_span(ground, crossing)
    quads = _Quads(crossing.kind, "pole" if crossing.kind == "gantry" else "bridge")
    if crossing.kind == "gantry":
        _gantry(quads, ground, crossing, frame, span)
    else:
        _bridge(quads, ground, crossing, frame, span)
    return quads.body()


def _ground_over(ground: Ground, frame: Frame, places: Float[np.ndarray, "n 2"]) -> Values:
    """Heights of the ground at (x, y) of a frame, in this frame."""
    flat = frame.world(np.column_stack([places, np.zeros(len(places))]))
    return ground.height(flat[:, :2]) - frame.origin[2]


def _gantry(quads: _Quads, ground: Ground, crossing: Crossing, frame: Frame, span: Span) -> None:
    """Two legs, two chords with verticals between them, and boards in front of these."""
    half, (left, right) = crossing.width_m / 2, span.legs_m
    base, rise_m = span.under_m - float(frame.origin[2]) + 0.35, 1.3
    feet = np.array([(left, 0.0), (right, 0.0)])
    for (x, _), z in zip(feet, _ground_over(ground, frame, feet), strict=True):
        quads.box(frame, (x - 0.16, -0.16, z - SINK_M), (x + 0.16, 0.16, base + rise_m + 0.1), METAL)
    for y in (-half, half):
        for z in (base, base + rise_m):
            quads.box(frame, (left, y - 0.07, z - 0.07), (right, y + 0.07, z + 0.07), METAL)
        ends = np.linspace(left, right, 2 + int((right - left) / 2.2))
        for i, (a, b) in enumerate(pairwise(ends)):
            low, high = (base, base + rise_m) if i % 2 else (base + rise_m, base)
            quads.tube(frame.world(np.array([(a, y, low), (b, y, high)])), (0.04, 0.04), METAL, n=3)
    plan, s = ground.plan, np.array([crossing.s_m])
    edges = np.array([ground.left_edge_m, float(ground.main_right_edge(s)[0])]) * plan.flips[0]
    middle, width_m = float(edges.mean()), float(np.ptp(edges)) - 2 * plan.shoulder_m
    n = max(1, min(3, round(width_m / 5)))
    for i, x in enumerate(middle + width_m * ((np.arange(n) + 0.5) / n - 0.5)):
        layers = board(0.82 * min(width_m / n, 5.5), 2.0, crossing.color, i + round(10 * abs(crossing.s_m)))
        _board(quads, frame, layers, np.array([x, -half - 0.12, base - 0.35 + 1.0]), False)
    _stand(quads, ground, frame.world(np.column_stack([feet, np.zeros(2)]))[:, :2])


def _bridge(quads: _Quads, ground: Ground, crossing: Crossing, frame: Frame, span: Span) -> None:
    """A deck with parapets on columns and abutments, and dams of earth behind these."""
    half, color = crossing.width_m / 2, (*crossing.color, 0.0)
    dark = (*(0.8 * channel for channel in crossing.color), 0.0)
    under, top = span.under_m - float(frame.origin[2]), span.top_m - float(frame.origin[2])
    (left, right), (far_left, far_right) = span.legs_m, span.abutments_m
    quads.box(frame, (far_left, -half + 0.8, under), (far_right, half - 0.8, top - 0.35), dark)
    quads.box(frame, (far_left, -half, top - 0.35), (far_right, half, top), color)
    for y in (-half, half - 0.25):
        quads.box(frame, (far_left - 4, y, top), (far_right + 4, y + 0.25, top + PARAPET_M), color)
    columns = np.array([(x, y) for x in (left, right) for y in np.linspace(1.2 - half, half - 1.2, 3)])
    for (x, y), z in zip(columns, _ground_over(ground, frame, columns), strict=True):
        quads.box(frame, (x - 0.4, y - 0.4, z - SINK_M), (x + 0.4, y + 0.4, under), dark)
    for sign, x in ((-1, far_left), (1, far_right)):
        wall = np.column_stack([np.full(5, x), np.linspace(-half, half, 5)])
        low = float(_ground_over(ground, frame, wall).min()) - 1.0
        back = x + sign * (ABUTMENT_WALL_M + 0.1)
        quads.box(frame, (min(x, back), -half, min(low, under - 0.5)), (max(x, back), half, top - 0.35), color)
        _dam(quads, ground, frame, x + sign * ABUTMENT_WALL_M, sign, half, top)
    _stand(quads, ground, frame.world(np.column_stack([columns, np.zeros(len(columns))]))[:, :2])


def _dam(quads: _Quads, ground: Ground, frame: Frame, x: float, sign: int, half_m: float, top_m: float) -> None:
    """The dam of a bridge's road from its abutment outwards, down to the ground or to DAM_M."""
    rows = dam_section(ground, frame, x, sign, half_m, top_m)
    quads.sweep(frame.world(rows), EARTH)
    quads.add(frame.world(rows[:1]), EARTH)


def dam_section(
    ground: Ground, frame: Frame, x: float, sign: int, half_m: float, top_m: float
) -> Float[np.ndarray, "r 4 3"]:
    """Foot, top, top and foot of a dam at distances behind an abutment, in the crossing's frame."""
    way = np.linspace(0, DAM_M, 12)
    middle = np.column_stack([x + sign * way, np.zeros(12)])
    low = _ground_over(ground, frame, middle)
    top = np.maximum(top_m - DAM_FALL * way, low - 1.0)
    foot = np.zeros((12, 2))
    for side, y_sign in enumerate((-1, 1)):
        y = np.full(12, y_sign * half_m)
        for _ in range(4):
            z = _ground_over(ground, frame, np.column_stack([middle[:, 0], y]))
            y = y_sign * (half_m + DAM_SLOPE * np.clip(top - z, 0, None))
        foot[:, side] = y
    ends = np.array([-half_m, half_m])
    y = np.column_stack([foot[:, 0], np.tile(ends, (12, 1)), foot[:, 1]])
    z_foot = [top - (np.abs(foot[:, k]) - half_m) / DAM_SLOPE - 0.3 for k in (0, 1)]
    z = np.column_stack([z_foot[0], top, top, z_foot[1]])
    return np.stack([np.tile(middle[:, :1], (1, 4)), y, z], -1)


# -- buildings


def building_frame(building: Building, floor_m: float = 0.0) -> Frame:
    """The middle of a building's floor, at this height."""
    forward = np.array([-np.sin(building.yaw_rad), np.cos(building.yaw_rad)])
    return Frame(np.array([building.x_m, building.y_m, floor_m]), forward)


def _building(ground: Ground, building: Building) -> Body:
    quads = _Quads(building.kind, "building")
    x, y, h = building.width_m / 2, building.length_m / 2, building.height_m
    frame = building_frame(building, float(ground.height(np.array([[building.x_m, building.y_m]]))[0]))
    wall, roof = (*building.color, 0.0), (*building.roof, 0.1)
    corners = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    bottom = float(_ground_over(ground, frame, corners).min()) - SINK_M
    quads.box(frame, (-x, -y, min(bottom, -SINK_M)), (x, y, h), wall)
    if building.kind == "house":
        ridge = h + 0.8 * x
        for side in (-1, 1):
            slope = [
                (side * (x + 0.5), -y - 0.4, h - 0.4),
                (side * (x + 0.5), y + 0.4, h - 0.4),
                (0, y + 0.4, ridge),
                (0, -y - 0.4, ridge),
            ]
            quads.add(frame.world(np.array([slope])), roof)
            gable = [(-x, side * y, h), (x, side * y, h), (0, side * y, ridge), (0, side * y, ridge - 0.01)]
            quads.add(frame.world(np.array([gable])), wall)
        quads.box(
            frame,
            (0.3 * x, 0.2 * y, h),
            (0.3 * x + 0.6, 0.2 * y + 0.6, ridge + 0.5),
            (*(0.6 * c for c in building.color), 0.0),
        )
    else:
        quads.box(frame, (-x - 0.1, -y - 0.1, h), (x + 0.1, y + 0.1, h + 0.35), roof)
    _windows(quads, frame, building)
    quads.feet.append(frame.origin[None])
    return quads.body()


def _windows(quads: _Quads, frame: Frame, building: Building) -> None:
    """Windows of houses, bands of windows of other buildings, and gates of halls, in front of the walls."""
    x, y, h = building.width_m / 2, building.length_m / 2, building.height_m
    for depth, half, along_y in ((x, y, True), (y, x, False)):
        panes = _panes(building.kind, half, h)
        for sign in (-1, 1):
            for (a, b), (low, high), is_gate in panes:
                ring = [(a, low), (b, low), (b, high), (a, high)]
                d = sign * (depth + 0.03)
                corners = np.array([[(d, u, z) if along_y else (u, d, z) for u, z in ring]])
                quads.add(frame.world(corners), tuple(0.5 * c for c in building.roof) if is_gate else GLASS)


Range = tuple[float, float]


def _panes(kind: str, half: float, height_m: float) -> list[tuple[Range, Range, bool]]:
    """Where a wall of length 2 half has panes: along it and up, and whether each is a gate."""

    def places(spacing_m: float) -> Values:
        n = max(1, int(2 * half / spacing_m))
        return ((np.arange(n) + 0.5) / n * 2 - 1) * half

    storeys = np.arange(max(1, int(height_m / STOREY_M))) * STOREY_M
    if kind == "house":
        return [((u - 0.55, u + 0.55), (z + 0.9, z + 2.2), False) for z in storeys for u in places(3.2)]
    if kind == "block":
        wide = 0.8 * half / max(1, int(half / 6))
        return [((u - wide, u + wide), (z + 1.0, z + 2.4), False) for z in storeys for u in places(12.0)]
    gates = [((u - 1.8, u + 1.8), (0.0, min(3.8, 0.6 * height_m)), True) for u in places(16.0)]
    return [((-0.9 * half, 0.9 * half), (height_m - 1.8, height_m - 0.9), False), *gates]


def _frames(ground: Ground, road: RoadName, side: RoadSide, s: Values, aside_m: Values | float) -> list[Frame]:
    """Frames on the ground beside a road: y along the road as the host drives."""
    behind, middle, ahead, out = (
        beside(ground, road, side, s + ds, aside_m + da) for ds, da in ((-0.5, 0.0), (0.0, 0.0), (0.5, 0.0), (0.0, 1.0))
    )
    forward = (ahead - behind) * ground.plan.flips[1]
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    out = out - middle
    outward = np.sign(out[:, 0] * forward[:, 1] - out[:, 1] * forward[:, 0])
    origins = np.column_stack([middle, ground.height(middle)])
    return [Frame(*place) for place in zip(origins, forward, outward.tolist(), strict=True)]


def _stand(quads: _Quads, ground: Ground, xy_world: Points2) -> None:
    quads.feet.append(np.column_stack([xy_world, ground.height(xy_world)]))


def _glossy(color: Sequence[float]) -> tuple[float, ...]:
    return tuple(color) if len(color) == 4 else (*color, 0.1)
