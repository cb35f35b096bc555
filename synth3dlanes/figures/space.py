"""A scene as coloured triangles for the 3D view of a page, from the meshes that are rendered. Road frame."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from synth3dlanes.figures import colors
from synth3dlanes.figures.colors import Rgb
from synth3dlanes.figures.passes import semantic_colors
from synth3dlanes.figures.scene_view import AHEAD_M, SceneView, TreeOutline, frustum
from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import CameraLabel, LaneKind
from synth3dlanes.world.meshes import Mesh
from synth3dlanes.world.paint import PAINT_LIFT_AT_M, PAINT_LIFT_M, paint_color
from synth3dlanes.world.solids import Body
from synth3dlanes.world.world import World

# Extent of the area to each side of the camera.
_ASIDE_M = 70.0
_LANE_HALF_WIDTH_M = 0.06
_LANE_OVER_PAINT_M = 0.006
_FRUSTUM_M = 3.0

_GRASS, _ASPHALT = (122, 150, 96), (112, 116, 122)
_WHITE, _YELLOW = (240, 240, 235), (236, 190, 60)
_LEAVES, _TRUNK = (62, 118, 62), (96, 74, 52)


@dataclass(frozen=True, eq=False)
class Triangles:
    """One group that the page can switch on and off: vertices, a colour per vertex, and triangles of vertex indices;
    without any, the vertices are shown as points."""

    name: str
    vertices_road: Float[np.ndarray, "v 3"]
    colors: Int[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]

    def document(self) -> dict[str, str]:
        """The arrays as little-endian base64 text: float32, uint8 and uint32."""
        arrays = {
            "vertices": self.vertices_road.astype("<f4"),
            "colors": self.colors.astype("u1"),
            "faces": self.faces.astype("<u4"),
        }
        return {"name": self.name} | {key: base64.b64encode(value.tobytes()).decode() for key, value in arrays.items()}


def triangles(view: SceneView, sweep: Sweep | None = None, others: Sequence[CameraLabel] = ()) -> list[Triangles]:
    """The groups of everything near the host, a lidar's points, and the frusta of the rig's other cameras."""
    return [
        *(() if view.world is None else _surfaces(view, view.world)),
        *(_merge(f"{colors.KIND_WORDS[kind]}s", _lanes(view, kind)) for kind in colors.KINDS),
        _merge(
            "objects",
            [
                _prism(item.corners_road, item.height_m, item.color)
                for item in view.objects
                if _is_near(view, item.corners_road)
            ],
        ),
        _merge("trees", [part for tree in view.trees if _is_near(view, tree.foot_road[None]) for part in _tree(tree)]),
        *([_merge("structures", [_body(view, body) for body in view.structures])] if view.structures else []),
        _merge("cameras" if others else "camera", [_camera(view, camera) for camera in (view.labels.camera, *others)]),
        *([_lidar(view, sweep)] if sweep else []),
    ]


def _surfaces(view: SceneView, world: World) -> list[Triangles]:
    """The ground, the roads and their paint."""
    roads = [_mesh(view, mesh, _ASPHALT) for mesh in world.site.surfaces.pavement]
    yellow = {line.id for line in world.site.lines if paint_color(line, world.scene.markings) == "yellow"}
    strips = world.paint(world.view)
    paint = [_mesh(view, mesh, _YELLOW if name in yellow else _WHITE) for name, mesh in strips.items()]
    terrain = [_mesh(view, world.site.surfaces.terrain, _GRASS)]
    return [_merge("terrain", terrain), _merge("road", roads), _merge("paint", paint)]


def _lidar(view: SceneView, sweep: Sweep) -> Triangles:
    """The points of a sweep in the colours of their semantic ids."""
    points = sweep.points()
    vertices_road = transform(view.labels.camera.road_from_cam, points.xyz_cam)
    return Triangles("lidar", vertices_road, semantic_colors(points.semantic).astype(int), np.zeros((0, 3), dtype=int))


def _mesh(view: SceneView, mesh: Mesh, color: Rgb) -> Triangles:
    """The faces of a mesh that reach into the area near the host: they cover it without gaps."""
    vertices_road = transform(view.road_from_world, mesh.vertices_world)
    corners = vertices_road[mesh.faces, :2]
    low_m, high_m = _area(view)
    is_shown = ((corners.max(axis=1) > low_m) & (corners.min(axis=1) < high_m)).all(axis=1)
    used, numbers = np.unique(mesh.faces[is_shown], return_inverse=True)
    return _quads(vertices_road[used], numbers.reshape(-1, 4), color)


def _area(view: SceneView) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The corners of the area that is shown: x to the right and y forward."""
    return np.array([-_ASIDE_M, -view.behind_m]), np.array([_ASIDE_M, AHEAD_M])


def _is_near(view: SceneView, points_road: Float[np.ndarray, "n 3"]) -> bool:
    """Whether all points are in the area that is shown."""
    low_m, high_m = _area(view)
    return bool(((points_road[:, :2] > low_m) & (points_road[:, :2] < high_m)).all())


def _quads(vertices_road: Float[np.ndarray, "v 3"], quads: Int[np.ndarray, "f 4"], color: Rgb) -> Triangles:
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Triangles("", vertices_road, np.tile(np.array(color), (len(vertices_road), 1)), faces)


def _lanes(view: SceneView, kind: LaneKind) -> list[Triangles]:
    """Each lane as a narrow ribbon, paler where it is not visible."""
    ribbons = []
    for lane in view.labels.lanes:
        if lane.kind != kind:
            continue
        points_road = transform(view.labels.camera.road_from_cam, lane.xyz_cam)
        points_road[:, 2] += np.interp(np.abs(points_road[:, 1]), PAINT_LIFT_AT_M, PAINT_LIFT_M) + _LANE_OVER_PAINT_M
        along = np.gradient(points_road, axis=0)
        right = np.stack([along[:, 1], -along[:, 0], np.zeros(len(along))], -1)
        right *= _LANE_HALF_WIDTH_M / np.linalg.norm(right, axis=1, keepdims=True)
        n = len(points_road)
        i = np.arange(n - 1)
        ribbon = _quads(
            np.concatenate([points_road - right, points_road + right]),
            np.stack([i, i + n, i + n + 1, i + 1], -1),
            (0, 0, 0),
        )
        seen = np.tile(lane.visible, 2)[:, None]
        color = np.array(colors.KINDS[kind])
        ribbons.append(Triangles("", ribbon.vertices_road, np.where(seen, color, (color + 2 * 190) // 3), ribbon.faces))
    return ribbons


def _body(view: SceneView, body: Body) -> Triangles:
    """The quads of a structure near the host, in their own colours."""
    corners_road = transform(view.road_from_world, body.corners_world)
    low_m, high_m = _area(view)
    is_near = ((corners_road[..., :2] > low_m) & (corners_road[..., :2] < high_m)).all(axis=(1, 2))
    shown = corners_road[is_near].reshape(-1, 3)
    quads = _quads(shown, np.arange(len(shown)).reshape(-1, 4), (0, 0, 0))
    display = np.rint(255 * np.sqrt(np.repeat(body.colors[is_near, :3], 4, axis=0))).astype(int)
    return Triangles("", shown, display, quads.faces)


def _prism(corners_road: Float[np.ndarray, "4 3"], height_m: float, color: Rgb) -> Triangles:
    vertices = np.concatenate([corners_road, corners_road + np.array([0.0, 0.0, height_m])])
    sides = [[i, j, j + 4, i + 4] for i, j in pairwise([0, 1, 2, 3, 0])]
    return _quads(vertices, np.array([[4, 5, 6, 7], *sides]), color)


def _tree(tree: TreeOutline) -> list[Triangles]:
    """A trunk and a crown of two cones."""
    angles = np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], -1)
    middle = ring * tree.radius_m + [0.0, 0.0, 0.35 * tree.height_m]
    ends = [[0.0, 0.0, 0.12 * tree.height_m], [0.0, 0.0, tree.height_m]]
    crown = tree.foot_road + np.concatenate([middle, ends])
    around = list(pairwise([*range(6), 0]))
    faces = np.array([[i, j, 7] for i, j in around] + [[j, i, 6] for i, j in around])
    trunk_m = 0.04 * tree.height_m
    trunk = _prism(tree.foot_road + ring[[0, 1, 3, 4]] * trunk_m, 0.3 * tree.height_m, _TRUNK)
    return [Triangles("", crown, np.tile(np.array(_LEAVES), (8, 1)), faces), trunk]


def _camera(view: SceneView, camera: CameraLabel) -> Triangles:
    """A camera's frustum as a pyramid."""
    corners_img = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * [camera.width_px, camera.height_px]
    rays_cam = frustum(camera, corners_img) * _FRUSTUM_M
    road_from_cam = view.road_from_world @ camera.world_from_cam
    vertices = transform(road_from_cam, np.concatenate([np.zeros((1, 3)), rays_cam]))
    faces = np.array([[0, i, j] for i, j in pairwise([1, 2, 3, 4, 1])])
    return Triangles("", vertices, np.tile(np.array(colors.CAMERA), (5, 1)), faces)


def _merge(name: str, parts: list[Triangles]) -> Triangles:
    """Several parts as one group with a name."""
    if not parts:
        return Triangles(name, np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.zeros((0, 3), dtype=int))
    starts = np.cumsum([0, *(len(part.vertices_road) for part in parts[:-1])])
    return Triangles(
        name,
        np.concatenate([part.vertices_road for part in parts]),
        np.concatenate([part.colors for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
    )
