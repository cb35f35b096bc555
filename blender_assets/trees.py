"""Six trees: trunk and branches as tubes, leaves and needles as real triangles, at most 10k triangles each.

Trunk base at the origin, z up. Leaves carry their shade (dark inside the crown) and a normal that points out of the
crown, which is what makes a crown look like one soft volume.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from shapes import Shape, tube

from synth3dlanes.scene.assets.catalogue import TREES, TreeModel

BARK, LEAF = 0, 1
ROOT = np.array([0, 0, -0.3])  # trunks go into the ground, so that none floats on a slope


@dataclass
class Tree:
    """The shape, and for each vertex a shade 0..1 and a shading normal (0 = use the face's own)."""

    shape: Shape = field(default_factory=Shape)
    shades: list[Float[np.ndarray, " v"]] = field(default_factory=list)
    normals: list[Float[np.ndarray, "v 3"]] = field(default_factory=list)


def unit(vectors: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
    """Vectors scaled to length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def branch(tree: Tree, path: Float[np.ndarray, "n 3"], r0_m: float, r1_m: float, sides: int = 5) -> None:
    """Add one limb."""
    vertices, faces = tube(path, np.linspace(r0_m, r1_m, len(path)), sides)
    tree.shape.add(vertices, faces, BARK)
    tree.shades.append(np.ones(len(vertices)))
    tree.normals.append(np.zeros((len(vertices), 3)))


def limb_path(
    rng: np.random.Generator, start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"], bend: float, n: int = 5
) -> Float[np.ndarray, "n 3"]:
    """A crooked way from start to end, sagging or rising by `bend` of its length."""
    t = np.linspace(0, 1, n)[:, None]
    length = np.linalg.norm(end - start)
    arch = 4 * t * (1 - t) * np.array([0, 0, bend * length])
    crook = rng.normal(0, 0.035 * length, (n, 3)) * np.sin(np.pi * t)
    return start + t * (end - start) + arch + crook


def leaves(
    tree: Tree,
    rng: np.random.Generator,
    points: Float[np.ndarray, "n 3"],
    outward: Float[np.ndarray, "n 3"],
    shade: Float[np.ndarray, " n"],
    size_m: tuple[float, float],
) -> None:
    """Add a leaf (one triangle, length by width) at each point, facing roughly outward and hanging a little."""
    n = len(points)
    facing = unit(unit(outward) + 0.8 * rng.standard_normal((n, 3)) + [0, 0, 0.35])
    along = unit(np.cross(facing, rng.standard_normal((n, 3))) - [0, 0, 0.3])
    across = unit(np.cross(along, facing))
    size = rng.uniform(0.7, 1.3, (n, 1))
    tip, side = 0.5 * size_m[0] * size * along, 0.5 * size_m[1] * size * across
    corners = np.stack([points - tip - side, points - 0.6 * tip + side, points + tip], axis=1)
    faces = np.concatenate([np.arange(3 * n).reshape(n, 3), np.full((n, 1), -1)], axis=1)
    tree.shape.add(corners.reshape(-1, 3), faces, LEAF)
    tree.shades.append(np.repeat(shade * rng.uniform(0.8, 1.25, n), 3))
    tree.normals.append(np.repeat(unit(unit(outward) + 0.45 * facing), 3, axis=0))


def clumps(
    tree: Tree,
    rng: np.random.Generator,
    centers: Float[np.ndarray, "c 3"],
    radii_m: Float[np.ndarray, " c"],
    n: int,
    leaf_m: tuple[float, float],
    crown: Float[np.ndarray, "3"],
) -> None:
    """Scatter `n` leaves of `leaf_m` (length, width) over clumps of foliage, most of them near the clumps' skins, some
    beyond: a skin without stray leaves looks like a ball."""
    which = rng.choice(len(centers), n, p=radii_m**2 / (radii_m**2).sum())
    direction = unit(rng.standard_normal((n, 3)))
    depth = rng.uniform(0.2, 1, n) ** 0.55 * (1 + 0.5 * rng.random(n) ** 4)
    offset = direction * (radii_m[which] * depth)[:, None] * [1, 1, 0.8]
    points = centers[which] + offset
    out = unit(0.6 * direction + 0.6 * unit(points - crown) + [0, 0, 0.15])
    below = np.clip(0.5 + 0.5 * direction[:, 2], 0, 1)
    leaves(tree, rng, points, out, 0.52 + 0.28 * depth + 0.22 * below, leaf_m)


def scattered(
    rng: np.random.Generator, centers: Float[np.ndarray, "c 3"], radii_m: Float[np.ndarray, " c"], n: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Each clump as `n` smaller ones of unlike sizes around it: crowns are ragged, not made of balls."""
    around = unit(rng.standard_normal((n, len(centers), 3))) * rng.uniform(0.35, 0.95, (n, len(centers), 1))
    small = radii_m * rng.uniform(0.3, 0.75, (n, len(centers)))
    return (centers + radii_m[:, None] * around * [1, 1, 0.75]).reshape(-1, 3), small.ravel()


def broadleaf(rng: np.random.Generator, model: TreeModel) -> Tree:
    """A wide lumpy crown on forked limbs."""
    tree, h, r = Tree(), model.height_m, model.crown_radius_m
    top = np.array([0.15, -0.1, 0.72 * h])
    trunk = limb_path(rng, ROOT, top, 0, 9)
    branch(tree, trunk, 0.21, 0.06, 9)
    crown = np.array([0, 0, 0.60 * h])
    centers, radii = [np.array([0.1, 0, 0.86 * h])], [0.13 * h]
    for k in range(21):
        angle = 2.4 * k + rng.uniform(-0.4, 0.4)
        height = (0.38 + 0.45 * (k / 20)) * h + rng.uniform(-0.2, 0.2)
        reach = r * (0.74 - 0.42 * max(0.0, height / h - 0.55) / 0.3) * rng.uniform(0.75, 1.0)
        center = np.array([reach * np.cos(angle), reach * np.sin(angle), height])
        start = trunk[2 + int(5 * k / 21)]
        branch(tree, limb_path(rng, start, center, 0.06), 0.075, 0.02)
        for _ in range(2):
            branch(tree, limb_path(rng, center * 0.7 + start * 0.3, center + rng.normal(0, 0.5, 3), 0), 0.03, 0.008, 3)
        centers.append(center)
        radii.append(r * rng.uniform(0.24, 0.36))
    clumps(tree, rng, *scattered(rng, np.array(centers), np.array(radii), 4), 7900, (0.33, 0.24), crown)
    return tree


def conifer(rng: np.random.Generator, model: TreeModel) -> Tree:
    """A spruce: whorls of drooping branches with hanging sprays of needles."""
    tree, h, r = Tree(), model.height_m, model.crown_radius_m
    branch(tree, np.array([ROOT, [0, 0, 0.5 * h], [0, 0, 0.985 * h]]), 0.17, 0.012, 7)
    points, outs, shades = [], [], []
    for k in range(26):
        level = k / 25
        z = (0.09 + 0.87 * level) * h
        n = 9 if level < 0.7 else 6
        for j in range(n):
            angle = 2 * np.pi * (j + 0.5 * (k % 2)) / n + rng.uniform(-0.25, 0.25)
            reach = r * (1 - level) ** 0.85 * rng.uniform(0.78, 1.0) + 0.12
            out = np.array([np.cos(angle), np.sin(angle), 0])
            end = np.array([0, 0, z - 0.30 * reach]) + reach * out
            path = limb_path(rng, np.array([0, 0, z + 0.05 * reach]), end, 0.05, 4)
            branch(tree, path, 0.028 * (1.2 - level), 0.006, 3)
            m = int(8 + 32 * reach / r)
            t = np.linspace(0.18, 1.0, m)[:, None]
            side = np.cross(out, [0, 0, 1.0]) * rng.uniform(-0.32, 0.32, (m, 1)) * reach * (1.1 - 0.8 * t)
            on = np.stack([np.interp(t[:, 0], np.linspace(0, 1, 4), path[:, a]) for a in range(3)], -1) + side
            points.append(on - [0, 0, 0.08])
            outs.append(np.broadcast_to(out + np.array([0, 0, 0.55]), on.shape))
            shades.append(0.35 + 0.65 * t[:, 0])
    leaves(tree, rng, np.concatenate(points), np.concatenate(outs), np.concatenate(shades), (0.52, 0.15))
    return tree


def poplar(rng: np.random.Generator, model: TreeModel) -> Tree:
    """A tall column of steep branches."""
    tree, h, r = Tree(), model.height_m, model.crown_radius_m
    branch(tree, limb_path(rng, ROOT, np.array([0, 0, 0.95 * h]), 0, 8), 0.2, 0.02, 7)
    centers, radii = [], []
    for k in range(70):
        level = k / 69
        width = r * (0.56 * np.sin(np.pi * (0.12 + 0.80 * level)) ** 0.7)
        angle = 2.4 * k
        center = np.array([width * np.cos(angle), width * np.sin(angle), (0.13 + 0.82 * level) * h])
        foot = np.array([0, 0, center[2] - 0.11 * h])
        branch(tree, limb_path(rng, foot, center, 0, 4), 0.035, 0.01, 3)
        centers.append(center)
        radii.append(r * (0.38 - 0.16 * level) * rng.uniform(0.8, 1.2))
    foliage = scattered(rng, np.array(centers), np.array(radii), 3)
    clumps(tree, rng, *foliage, 7700, (0.30, 0.22), np.array([0, 0, 0.5 * h]))
    return tree


def bush(rng: np.random.Generator, model: TreeModel) -> Tree:
    """Many stems from the ground, leaves down to the grass."""
    tree, h, r = Tree(), model.height_m, model.crown_radius_m
    centers, radii = [], []
    for k in range(16):
        angle, reach = 2.4 * k, r * 0.66 * np.sqrt(k / 15)
        z = h * (0.72 - 0.42 * (reach / r) ** 1.5) * rng.uniform(0.75, 1.05)
        center = np.array([reach * np.cos(angle), reach * np.sin(angle), z])
        branch(tree, limb_path(rng, center * [0.15, 0.15, 0], center, 0.05, 4), 0.025, 0.008, 4)
        centers.append(center)
        radii.append(rng.uniform(0.26, 0.36) * r)
    low = np.array(centers) * [1.12, 1.12, 0.42]
    centers_all = np.concatenate([np.array(centers), low])
    clumps(tree, rng, centers_all, np.array(radii + radii), 6500, (0.13, 0.09), np.array([0, 0, 0.25 * h]))
    return tree


def dead(rng: np.random.Generator, model: TreeModel) -> Tree:
    """A bare tree: limbs, boughs and twigs, no leaf."""
    tree, h, r = Tree(), model.height_m, model.crown_radius_m
    trunk = limb_path(rng, ROOT, np.array([0.2, 0.1, 0.95 * h]), 0, 10)
    branch(tree, trunk, 0.19, 0.015, 9)
    for k in range(18):
        angle, start = 2.4 * k, trunk[3 + int(6 * k / 18)]
        reach = r * (1 - 0.6 * k / 18) * rng.uniform(0.7, 0.98)
        end = np.array([reach * np.cos(angle), reach * np.sin(angle), min(start[2] + 0.8 * reach, 0.97 * h)])
        limb = limb_path(rng, start, end, rng.uniform(-0.05, 0.1), 6)
        branch(tree, limb, 0.07 * (1.15 - k / 22), 0.012, 5)
        for _ in range(6):
            at = limb[rng.integers(2, 6)]
            tip = at + unit(unit(end - start) + 0.8 * rng.standard_normal(3)) * reach * rng.uniform(0.2, 0.4)
            tip[2] = min(tip[2], 0.99 * h)
            tip[:2] *= min(1.0, r / np.hypot(*tip[:2]))
            twig = limb_path(rng, at, tip, 0.03, 4)
            branch(tree, twig, 0.02, 0.006, 3)
            for _ in range(3):
                end_twig = tip + rng.normal(0, 0.16 * r, 3)
                end_twig[:2] *= min(1.0, r / np.hypot(*end_twig[:2]))
                branch(tree, limb_path(rng, twig[rng.integers(1, 4)], end_twig, 0, 3), 0.009, 0.004, 3)
    return tree


def young(rng: np.random.Generator, model: TreeModel) -> Tree:
    """A planted sapling: thin stem, small egg-shaped crown."""
    tree, h, r = Tree(), model.height_m, model.crown_radius_m
    stem = limb_path(rng, ROOT, np.array([0, 0, 0.9 * h]), 0, 7)
    branch(tree, stem, 0.045, 0.01, 7)
    centers, radii = [np.array([0, 0, 0.86 * h])], [0.30 * r]
    for k in range(13):
        level, angle = k / 12, 2.4 * k
        reach = 0.62 * r * np.sin(np.pi * (0.25 + 0.6 * level))
        center = np.array([reach * np.cos(angle), reach * np.sin(angle), (0.42 + 0.42 * level) * h])
        branch(tree, limb_path(rng, np.array([0, 0, center[2] - 0.35 * r]), center, 0.05), 0.018, 0.005, 4)
        centers.append(center)
        radii.append(rng.uniform(0.27, 0.38) * r)
    foliage = scattered(rng, np.array(centers), np.array(radii), 3)
    clumps(tree, rng, *foliage, 4200, (0.15, 0.11), np.array([0, 0, 0.62 * h]))
    return tree


GROW = {"broadleaf": broadleaf, "conifer": conifer, "poplar": poplar, "bush": bush, "dead": dead, "young": young}


def fit(tree: Tree, model: TreeModel) -> Float[np.ndarray, "v 3"]:
    """Vertices scaled so that height and crown radius are the catalogue's."""
    vertices = np.concatenate(tree.shape.vertices)
    reach = np.quantile(np.hypot(vertices[:, 0], vertices[:, 1]), 0.999)
    wide = model.crown_radius_m / reach
    tall = model.height_m / vertices[:, 2].max()
    fitted = vertices * [wide, wide, tall]
    return fitted


def grow_all() -> list[tuple[TreeModel, Tree]]:
    """All species of the catalogue, each from its own random stream."""
    return [(model, GROW[model.name](np.random.default_rng([4, k]), model)) for k, model in enumerate(TREES)]
