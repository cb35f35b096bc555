"""Labels of scenes on given maps against the file's own numbers, read as `standard` does."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels
from synth3dlanes.roads.cross_section import CrossSection
from synth3dlanes.roads.line_forms import plan_line
from synth3dlanes.roads.maps.given_map import GivenMap
from synth3dlanes.world.world import World
from tests.maps.standard import KERB_M, Road

# Lines are looked at in steps of the first length, and compared where these are near to a point of the labels; lanes of
# whole files are compared in steps of the last.
COARSE_M, NEAR_M, EVERY_M = 10.0, 20.0, 2.0


class Apart(NamedTuple):
    """The farthest that points of labels are from the file's lines, from above and in height (NaN of a map without
    heights), and the longest step between neighbours of one line aside of its direction."""

    plan_m: float
    height_m: float
    jump_m: float
    n_points: int


def apart(world: World, labels: Labels, given: GivenMap, roads: Mapping[str, Road]) -> Apart:
    """All points of the labels of a scene on a map."""
    part, network = world.scene.map, world.network
    assert part is not None
    assert part.given_frame is not None
    files = {name: road_id for road_id, name in given.names.items()}
    own = {road.id: road for road in part.roads}
    curves = {curve.id: curve for curve in network.curves}
    x, y, z, turn = part.given_frame
    cos, sin = np.cos(turn), np.sin(turn)

    def in_file(xyz_world: np.ndarray) -> np.ndarray:
        return xyz_world @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + [x, y, z]

    plan, height, jump = [np.zeros(1)], [np.zeros(1)], [0.0]
    for label in labels.lanes:
        points, curve = in_file(transform(labels.camera.world_from_cam, label.xyz_cam)), curves[label.id]
        lines = []
        for k, piece in enumerate(curve.pieces):
            road = own[piece.road.id]
            lengths_m = np.linspace(piece.start_m, piece.end_m, 2 + int((piece.end_m - piece.start_m) / COARSE_M))
            away_m, _ = cKDTree(points[:, :2]).query(in_file(curve.points_world(lengths_m))[:, :2])
            near = np.flatnonzero(away_m < NEAR_M)
            if not near.size:
                continue
            ends = lengths_m[[max(near[0] - 1, 0), min(near[-1] + 1, len(lengths_m) - 1)]]
            stations = sorted(piece.on(ends) + road.given_from_m)
            edges = list(roads[files[road.id]].edges(*stations))
            if label.kind == "centerline":
                number = int(curve.lanes[k].id.rpartition(".")[2])
                lines.append(next(edge.middle for edge in edges if edge.number == number))
            else:
                inside = in_file(curve.points_world(np.linspace(*ends, 9)[1:-1]))
                own_edge = min(edges, key=lambda edge: float(_off(inside, edge.edge)[:, 0].max()))
                lines.append(own_edge.edge + np.array([0, 0, KERB_M * own_edge.is_raised]))
        off = np.stack([_off(points, line) for line in lines])
        best = off[off[..., 0].argmin(axis=0), np.arange(len(points))]
        plan.append(best[:, 0])
        height.append(best[:, 1])
        jump.append(_jump(points))
    has_heights = any(road.heights for road in part.roads)
    height_m = float(np.max(np.concatenate(height))) if has_heights else np.nan
    return Apart(float(np.max(np.concatenate(plan))), height_m, max(jump), sum(map(len, plan)) - 1)


def everywhere(given: GivenMap, roads: Mapping[str, Road]) -> Apart:
    """The middles and outer edges of all lanes of a file that is read, `EVERY_M` apart."""
    aside_m, height_m, n_points = 0.0, 0.0, 0
    for road_id, name in given.names.items():
        if (road := given.roads.get(name)) is None:
            continue
        line = plan_line(road.plan)
        for i in range(len(road.sections)):
            section = CrossSection.of(road, i)
            s = np.linspace(section.start_m, section.end_m, 2 + int((section.end_m - section.start_m) / EVERY_M))
            own, edges = line.within(section.start_m, section.end_m), section.edges(s)
            for told in roads[road_id].edges(section.start_m, section.end_m):
                k = section.n_left - told.number
                outer, inner = edges[k], edges[k + np.sign(told.number)]
                for t, wanted in ((outer, told.edge), ((inner + outer) / 2, told.middle)):
                    z = section.height(s, t) if road.heights else 0 * s
                    off = _off(np.column_stack([own.xy(s, t) + given.origin, z]), wanted)
                    aside_m, height_m = max(aside_m, off[:, 0].max()), max(height_m, off[:, 1].max())
                    n_points += len(s)
    has_heights = any(road.heights for road in given.roads.values())
    return Apart(float(aside_m), float(height_m) if has_heights else np.nan, 0.0, n_points)


def _off(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """The distance of each point from a line from above, and its height over the nearest place of it."""
    flat = np.array([1.0, 1.0, 0.1])
    _, nearest = cKDTree(line * flat).query(points * flat)
    found = []
    for first in (nearest - 1, nearest):
        a = line[np.clip(first, 0, len(line) - 2)]
        step, to = line[np.clip(first, 0, len(line) - 2) + 1] - a, points - a
        share = (to[:, :2] * step[:, :2]).sum(axis=1) / np.maximum((step[:, :2] ** 2).sum(axis=1), 1e-18)
        off = to - np.clip(share, 0, 1)[:, None] * step
        found.append(np.column_stack([np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])]))
    nearer = found[0] @ [1, 0.1] < found[1] @ [1, 0.1]
    return np.where(nearer[:, None], *found)


def _jump(points: np.ndarray) -> float:
    """The farthest that a point lies aside or above of where the two before it lead to, and those behind it too."""
    if len(points) < 4:
        return 0.0
    before = points[2:-1] - 2 * points[1:-2] + points[:-3]
    behind = points[1:-2] - 2 * points[2:-1] + points[3:]
    return float(np.minimum(np.linalg.norm(before, axis=1), np.linalg.norm(behind, axis=1)).max(initial=0.0))
