"""A growing polygon mesh in numpy and the solids that cars and trees are put together from.

x right, y forward, z up, metres. A shape is vertices, faces (triangles or quads) and one material number a face.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int


@dataclass
class Shape:
    """Vertices and faces collected so far; triangles repeat their last corner as -1."""

    vertices: list[Float[np.ndarray, "v 3"]] = field(default_factory=list)
    faces: list[Int[np.ndarray, "f 4"]] = field(default_factory=list)
    materials: list[Int[np.ndarray, " f"]] = field(default_factory=list)
    n: int = 0

    def add(
        self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 4"], material: int | Int[np.ndarray, " f"]
    ) -> None:
        """Append a part; `faces` count from the part's first vertex."""
        self.faces.append(np.where(faces < 0, -1, faces + self.n))
        self.vertices.append(vertices)
        self.materials.append(np.broadcast_to(np.asarray(material), len(faces)))
        self.n += len(vertices)

    def arrays(self) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 4"], Int[np.ndarray, " f"]]:
        """All parts as one mesh."""
        return np.concatenate(self.vertices), np.concatenate(self.faces), np.concatenate(self.materials)


def grid_faces(rows: int, columns: int, wrap: bool = False) -> Int[np.ndarray, "f 4"]:
    """Quads of a rows x columns vertex grid; `wrap` joins the last column to the first."""
    r, c = np.meshgrid(np.arange(rows - 1), np.arange(columns if wrap else columns - 1), indexing="ij")
    c1 = (c + 1) % columns
    return np.stack([r * columns + c, r * columns + c1, (r + 1) * columns + c1, (r + 1) * columns + c], -1).reshape(
        -1, 4
    )


def rounded_box(
    center_m: tuple[float, float, float], size_m: tuple[float, float, float], radius_m: float, n: int = 2
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 4"]]:
    """A box with rounded edges, `n` segments a rounding."""
    half = np.asarray(size_m) / 2
    radius = min(radius_m, *(0.98 * half))
    angles = np.linspace(0, np.pi / 2, n + 1)
    lon = np.concatenate([angles + q * np.pi / 2 for q in range(4)])
    lat = np.concatenate([angles - np.pi / 2, angles])
    sx = np.repeat([1, -1, -1, 1], n + 1)
    sy = np.repeat([1, 1, -1, -1], n + 1)
    sz = np.repeat([-1, 1], n + 1)
    x = (half[0] - radius) * sx + radius * np.cos(lat)[:, None] * np.cos(lon)
    y = (half[1] - radius) * sy + radius * np.cos(lat)[:, None] * np.sin(lon)
    z = np.broadcast_to(((half[2] - radius) * sz + radius * np.sin(lat))[:, None], x.shape)
    rows, columns = x.shape
    faces = grid_faces(rows, columns, wrap=True)
    caps = np.array([[0, columns - 1 - k, columns - 2 - k, -1] for k in range(columns - 2)])
    top = (rows - 1) * columns + np.array([[0, k + 1, k + 2, -1] for k in range(columns - 2)])
    top[:, 3] = -1
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3) + np.asarray(center_m)
    return vertices, np.concatenate([faces, caps, top])


def lathe_x(
    profile: Float[np.ndarray, "n 2"], segments: int, center_m: tuple[float, float, float]
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 4"]]:
    """Turn a profile of (x offset, radius) about the x axis."""
    angle = 2 * np.pi * np.arange(segments) / segments
    x = np.repeat(profile[:, :1], segments, axis=1)
    y = profile[:, 1:] * np.cos(angle)
    z = profile[:, 1:] * np.sin(angle)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3) + np.asarray(center_m)
    return vertices, grid_faces(len(profile), segments, wrap=True)


def tube(
    path: Float[np.ndarray, "n 3"], radii_m: Float[np.ndarray, " n"], sides: int
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 4"]]:
    """A tapered tube along a path."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    helper = np.where(np.abs(tangent[:, 2:]) > 0.9, [[1.0, 0, 0]], [[0, 0, 1.0]])
    a = np.cross(tangent, helper)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(tangent, a)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(angle)[None, :, None] * a[:, None] + np.sin(angle)[None, :, None] * b[:, None]
    vertices = path[:, None] + radii_m[:, None, None] * ring
    return vertices.reshape(-1, 3), grid_faces(len(path), sides, wrap=True)
