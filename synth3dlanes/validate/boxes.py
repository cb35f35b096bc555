"""Boxes that objects may fill, in frames of their own, and coarse ones around structures. World frame, metres.

The boxes of structures follow from the scene's numbers, the road plan and the terrain, and not from the bodies that
are rendered; those of decks and tunnels alone are around the faces of these.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from synth3dlanes.geometry.frames import from_axes, transform
from synth3dlanes.roads.terrain import height_at
from synth3dlanes.scene.roadside import Building, Crossing, Post, Rail, RoadSide
from synth3dlanes.scene.traffic_elements import TrafficSign, TrafficSignal
from synth3dlanes.system.arrays import Points2, Points3
from synth3dlanes.world.solids import Body
from synth3dlanes.world.world import World

# Length of the pieces of rails, and how far these overlap.
PIECE_M, OVERLAP_M = 4.0, 1.0
# The middle of a rail behind its front, half its width, and the room over it. The wires of a power line are straight
# between poles, unlike the road.
RAILS_M = {
    "guardrail": (0.15, 0.4, 0.3),
    "concrete": (0.35, 0.7, 0.3),
    "noise_wall": (0.1, 0.4, 0.4),
    "kerb": (0.1, 0.3, 0.2),
    "walkway": (0.9, 1.2, 0.2),
    "power_line": (0.0, 7.0, 3.0),
}
# Half the width of posts, and the room over their height.
POSTS_M = {"lamp": (2.8, 0.6), "sign": (2.2, 2.6), "delineator": (0.3, 0.2)}
# Half the size of a board or head.
FREE_M = 1.3
# Bodies may reach this far below the ground, whose verges lie up to LOW_M below the terrain.
LOW_M = 1.2
# Crossings: reach to both sides, height of gantries and decks with parapets, and slope of dams.
REACH_M, CROSSING_M, DAM_SLOPE = 160.0, 4.0, 1.5
# Room around a face of a deck or a tunnel.
FACE_ROOM_M = 0.15
# A gable's height over half a house's width, and eaves.
GABLE, EAVES_M = 0.9, 0.8

Corners = Float[np.ndarray, "k 3"]


class Boxes(NamedTuple):
    """Boxes from a low to a high corner, each in its own frame."""

    world_from_boxes: Float[np.ndarray, "k 4 4"]
    low: Corners
    high: Corners


class StructureBoxes(NamedTuple):
    """Boxes and the number of the structure that each belongs to."""

    boxes: Boxes
    owners: Int[np.ndarray, " k"]


def meet(boxes: Boxes, eye_world: Float[np.ndarray, "3"], points_world: Points3) -> Bool[np.ndarray, " n"]:
    """Which straight lines from the eye to the points meet any of the boxes."""
    rotations, origins = boxes.world_from_boxes[:, :3, :3], boxes.world_from_boxes[:, None, :3, 3]
    eyes, ends = (eye_world - origins) @ rotations, (points_world - origins) @ rotations
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = ((corner[:, None] - eyes) / (ends - eyes) for corner in (boxes.low, boxes.high))
    # 0 / 0 along an axis perpendicular to a line is NaN, which fmax and fmin ignore.
    enters = np.fmax.reduce(np.minimum(first, second), axis=2, initial=0)
    leaves = np.fmin.reduce(np.maximum(first, second), axis=2, initial=1)
    return np.asarray((enters <= leaves).any(axis=0))


def inside(owned: StructureBoxes, points_world: Points3, owners: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which points are in a box of their structure, -1 for any structure."""
    found = np.zeros(len(points_world), dtype=bool)
    for pose, low, high, owner in zip(*owned.boxes, owned.owners.tolist(), strict=True):
        at = np.flatnonzero(((owners == owner) | (owners < 0)) & ~found)
        local = (points_world[at] - pose[:3, 3]) @ pose[:3, :3]
        found[at] = ((local > low) & (local < high)).all(axis=1)
    return found


def structure_boxes(world: World) -> StructureBoxes:
    """The boxes of all structures."""
    roadside = world.scene.roadside
    found = [
        *(_rail(world, rail) for rail in roadside.rails),
        *([_post(world, post)] for post in roadside.posts),
        *(_crossing(world, crossing) for crossing in roadside.crossings),
        *([_building(world, building)] for building in roadside.buildings),
        *([_free(world, item)] for item in roadside.free_elements if item.has_pole),
        *(_faces(body) for body in world.site.surfaces.bodies),
        *([_post(world, post)] for post in roadside.posts if post.kind == "sign"),
    ]
    on_gantries = [_crossing(world, crossing)[0] for crossing in roadside.crossings if crossing.kind == "gantry"]
    n_free = len(roadside.free_elements)
    found += [on_gantries] * (len(world.site.structures) - len(found) - n_free)
    found += [[_free(world, item)] for item in roadside.free_elements]
    boxes = [box for of_one in found for box in of_one]
    poses = np.array([pose for pose, _, _ in boxes]).reshape(-1, 4, 4)
    low, high = (np.array([box[i] for box in boxes]).reshape(-1, 3) for i in (1, 2))
    return StructureBoxes(Boxes(poses, low, high), np.repeat(np.arange(len(found)), [len(of_one) for of_one in found]))


def _faces(body: Body) -> list["PosedBox"]:
    """A box round each face of a body."""
    low, high = body.corners_world.min(axis=1) - FACE_ROOM_M, body.corners_world.max(axis=1) + FACE_ROOM_M
    return [(np.eye(4), *ends) for ends in zip(low, high, strict=True)]


PosedBox = tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3"], Float[np.ndarray, "3"]]


def beside_world(
    world: World, road: str, side: RoadSide, s: Float[np.ndarray, " n"], aside_m: float
) -> Float[np.ndarray, "n 2"]:
    """World (x, y) at stations and a distance from an edge of the pavement (a median: an offset)."""
    on = world.network.road(road)
    return on.xy(s, np.full(len(s), aside_m) if side == "median" else on.edge(side, s, aside_m))


def _level(xy: Float[np.ndarray, "2"], forward: Float[np.ndarray, "2"]) -> Float[np.ndarray, "4 4"]:
    """An upright frame at height 0 with y along a direction."""
    fx, fy = forward / np.linalg.norm(forward)
    return from_axes(np.array([fy, -fx, 0]), np.array([fx, fy, 0]), np.array([0, 0, 1.0]), np.array([*xy, 0.0]))


def _rail(world: World, rail: Rail) -> list[PosedBox]:
    road = world.network.road(rail.road)
    behind_m, half_m, over_m = RAILS_M[rail.kind]
    s = np.linspace(rail.from_m, rail.to_m, 2 + int((rail.to_m - rail.from_m) / PIECE_M))
    sign = 0.0 if rail.side == "median" else 1.0
    line = beside_world(world, rail.road, rail.side, s, rail.aside_m + sign * behind_m)
    z = height_at(road.terrain, line)
    # On a slope the edge of the pavement, over which a rail is level, is higher than the rail's foot.
    edge = beside_world(world, rail.road, rail.side, s, (1 - sign) * rail.aside_m)
    z_edge = np.maximum(z, height_at(road.terrain, edge)) + road.raised(s)
    boxes = []
    for i in range(len(s) - 1):
        along = line[i + 1] - line[i]
        reach_m = float(np.linalg.norm(along)) / 2 + OVERLAP_M
        low_m, high_m = z[i : i + 2].min() - LOW_M - over_m, z_edge[i : i + 2].max()
        boxes.append(
            (
                _level((line[i] + line[i + 1]) / 2, along),
                np.array([-half_m, -reach_m, low_m]),
                np.array([half_m, reach_m, high_m + rail.height_m + over_m]),
            )
        )
    return boxes


def _post(world: World, post: Post) -> PosedBox:
    road, s = world.network.road(post.road), np.array([post.s_m, post.s_m + 0.5])
    half_m, over_m = POSTS_M[post.kind]
    foot, ahead = beside_world(world, post.road, post.side, s, post.aside_m)
    z = float(height_at(road.terrain, foot[None])[0])
    raised = float(road.raised(s).max())
    low, high = np.array([-half_m, -half_m, z - LOW_M]), np.array([half_m, half_m, z + raised + post.height_m + over_m])
    return _level(foot, ahead - foot), low, high


def _free(world: World, item: TrafficSignal | TrafficSign) -> PosedBox:
    """A signal or sign with its pole and arm."""
    foot, reach_m = np.array([item.x_m, item.y_m]), abs(item.reach_m) + FREE_M
    low_m, high_m = _ground_m(world, foot[None])
    raised = max([at.ramp.height_m for at in world.network.roads if at.ramp], default=0.0)
    pose = _level(foot, np.array([-np.sin(item.yaw_rad), np.cos(item.yaw_rad)]))
    top_m = high_m + raised + item.height_m + 2 * FREE_M
    return pose, np.array([-reach_m, -FREE_M, low_m - LOW_M]), np.array([reach_m, FREE_M, top_m])


def _ground_m(world: World, xy: Points2) -> tuple[float, float]:
    """The least and greatest height of the ground at some places: of the terrain, and as roads with heights of their
    own lie on it."""
    z = np.concatenate([height_at(world.network.terrain, xy), world.ground.height(xy)])
    return float(z.min()), float(z.max())


def _crossing(world: World, crossing: Crossing) -> list[PosedBox]:
    """What is over the road, and all that may stand beside it."""
    road = world.network.main
    s = np.array([crossing.s_m, crossing.s_m + 0.5])
    here, ahead = road.xy(s, 0.0)
    pose = _level(here, ahead - here)
    across = np.arange(-REACH_M, REACH_M + 1, 4.0)

    def terrain_at(along_m: float) -> Float[np.ndarray, " n"]:
        strip = transform(pose, np.column_stack([across, np.full(len(across), along_m), np.zeros(len(across))]))
        return height_at(road.terrain, strip[:, :2])

    z = terrain_at(0.0)
    offsets = np.array([road.left(s)[0], road.right(s)[0]])
    edges = transform(np.linalg.inv(pose), np.column_stack([road.xy(s[[0, 0]], offsets), [0, 0]]))
    left, right = np.sort(edges[:, 0])
    raised = max([at.ramp.height_m for at in world.network.roads if at.ramp], default=0.0)
    half_m, road_m = crossing.width_m / 2 + 0.8, float(height_at(road.terrain, here[None])[0])
    top_m = max(float(z[np.abs(across) < REACH_M / 3].max()), road_m) + raised + crossing.clearance_m + CROSSING_M
    reach_m, wide_m, low_m = REACH_M, half_m, z.min()
    if crossing.kind == "bridge":
        # Where the ground falls along the road, a dam goes on down to its foot.
        beside_m = half_m + DAM_SLOPE * (top_m - z.min()) * np.array([-1.25, -0.6, 0.6, 1.25])
        low_m = min(low_m, *(terrain_at(along_m).min() for along_m in beside_m))
        wide_m += DAM_SLOPE * (top_m - low_m)
    low_m -= LOW_M
    return [
        (pose, np.array([-reach_m, -half_m, road_m + crossing.clearance_m - 1.0]), np.array([reach_m, half_m, top_m])),
        (pose, np.array([-reach_m, -wide_m, low_m]), np.array([left - 0.3, wide_m, top_m])),
        (pose, np.array([right + 0.3, -wide_m, low_m]), np.array([reach_m, wide_m, top_m])),
    ]


def _building(world: World, building: Building) -> PosedBox:
    forward = np.array([-np.sin(building.yaw_rad), np.cos(building.yaw_rad)])
    pose = _level(np.array([building.x_m, building.y_m]), forward)
    half = np.array([building.width_m / 2 + EAVES_M, building.length_m / 2 + EAVES_M])
    x, y = (part.ravel() for part in np.meshgrid(np.array([-1, 0, 1]) * half[0], np.array([-1, 0, 1]) * half[1]))
    low_m, high_m = _ground_m(world, transform(pose, np.column_stack([x, y, np.zeros(9)]))[:, :2])
    top_m = high_m + building.height_m + GABLE * building.width_m / 2 + EAVES_M
    return pose, np.array([*-half, low_m - LOW_M]), np.array([*half, top_m])
