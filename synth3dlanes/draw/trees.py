"""The trees of a scene, off the roads and clear of structures and buildings."""

import numpy as np

from synth3dlanes.draw.draws import DrawsOf
from synth3dlanes.scene.scene import Scene, Tree
from synth3dlanes.system.errors import InputError
from synth3dlanes.world.ground import Ground
from synth3dlanes.world.roadside import footprints

# Draws of places for all trees that have none yet.
TRIES = 300
# Least distance of a tree from the pavement: TREE_GAP_M plus a share of its crown's radius.
TREE_GAP_M, TREE_GAP_OF_CROWN = 1.0, 0.5


def draw_trees(scene: Scene, ground: Ground, of: DrawsOf, has_to_fit: bool) -> tuple[Tree, ...]:
    """The trees of a scene. Without room in its ranges a tree is left out; with `has_to_fit` InputError is raised."""
    looks, places = of("trees"), of("trees", "tree_places")
    drawn = looks.rows(("model", "yaw_deg", "scale"), looks("n"))
    models = scene.assets.tree_models
    trees: list[Tree] = []
    structures = footprints(ground, scene.roadside)
    for _ in range(TRIES):
        if len(trees) == len(drawn):
            break
        xy = np.array(places.rows(("x_m", "y_m"), 2 * (len(drawn) - len(trees)) + 16))
        clear = ground.clearance(xy)
        stands = structures.clear(xy, TREE_GAP_M)
        for (x, y), clearance_m, is_free in zip(xy.tolist(), clear.tolist(), stands.tolist(), strict=True):
            if len(trees) == len(drawn):
                break
            model, yaw_rad, scale = drawn[len(trees)]
            gap_m = TREE_GAP_M + TREE_GAP_OF_CROWN * scale * models[model - 1].crown_radius_m
            if is_free and clearance_m >= gap_m:
                trees.append(Tree(model=model, x_m=x, y_m=y, yaw_rad=yaw_rad, scale=scale))
    if has_to_fit and len(trees) < len(drawn):
        missing = len(drawn) - len(trees)
        raise InputError(f"trees.x_m, trees.y_m: no room off the roads for {missing} trees of scene {scene.index}")
    return tuple(trees)
