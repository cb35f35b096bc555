"""Check that the image's channels are in the order red, green, blue, by the built-in terrain: yellow or green.

Works without passes, from the terrain's position in the scene. A user's own terrain may have any colour and is skipped;
so is snow, and the blue light after sunset.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, UInt8

from synth3dlanes.frames import invert, transform
from synth3dlanes.geometry.visibility import seen_over_ground
from synth3dlanes.labels import CameraLabel
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.bodies import may_show_cars
from synth3dlanes.validate.boxes import meet, structure_boxes
from synth3dlanes.validate.findings import Finding
from synth3dlanes.validate.passes_proof import Passes
from synth3dlanes.world import World

# Sampled places: metres ahead of the camera, metres beside the pavement, and least distance from any pavement.
AHEAD_M, ASIDE_M, CLEAR_M = np.arange(6.0, 80.0, 2.0), np.array([2.0, 3.5, 5.0, 7.0, 9.0, 12.0]), 1.5
# Some places show trees, which may be bluish, so a high percentile of red minus blue is used. It is at least 3 levels
# of 255 in 280 rendered images, including the densest fog, and at least 0 in 100 images of 96x72 pixels. Fewer places
# than MIN_PLACES are not judged. With semantic ids, all pixels of terrain within NEAR_M are used instead.
LOWEST_SUN_RAD = 1.5
WARMEST, MIN_WARMTH, MIN_PLACES, NEAR_M = 67, -2.0, 30, 80.0


def check_colours(
    world: World, camera: CameraLabel, image: UInt8[np.ndarray, "h w 3"], passes: Passes
) -> Iterator[Finding]:
    """Finding if terrain is bluer than it is red."""
    if world.scene.assets.terrains or world.scene.weather.snow or world.scene.light.sun_zenith_rad > LOWEST_SUN_RAD:
        return
    if "semantic" in passes:
        is_terrain = passes["semantic"] == SEMANTIC_IDS["terrain"]
        pixels = image[is_terrain & (passes["depth"] < NEAR_M) if "depth" in passes else is_terrain]
    else:
        column, row = _terrain_img(world, camera).astype(int).T
        pixels = image[row, column]
    if len(pixels) < MIN_PLACES:
        return
    red, _, blue = pixels.astype(float).T
    warmth = float(np.percentile(red - blue, WARMEST))
    if warmth < MIN_WARMTH:
        yield Finding(
            "", f"image: expected red, green and blue in this order, got terrain with {-warmth:.0f} more blue than red"
        )


def _terrain_img(world: World, camera: CameraLabel) -> Float[np.ndarray, "n 2"]:
    """Pixels that show terrain, unless a tree hides it."""
    ground = world.ground
    away_m = np.concatenate([-AHEAD_M, AHEAD_M]) if ground.both_ways else AHEAD_M
    s, ahead = ground.plan.plan_station(world.view.camera.y_m + away_m), len(away_m)
    aside = np.concatenate([ground.left_edge_m - ASIDE_M, ground.edge_m + ASIDE_M])
    xy = ground.plan.main_xy(np.tile(s, len(aside)), np.repeat(aside, ahead))
    xy = xy[ground.clearance(xy) > CLEAR_M]
    points_world = np.column_stack([xy, ground.height(xy)])
    eye_world = camera.world_from_cam[:3, 3]
    points_world = points_world[seen_over_ground(ground, eye_world, points_world)]
    points_world = points_world[~meet(structure_boxes(world).boxes, eye_world, points_world)]
    points_cam = transform(invert(camera.world_from_cam), points_world)
    uv = camera.project(points_cam)
    with np.errstate(invalid="ignore"):
        uv = uv[((uv >= 0) & (uv < [camera.width_px, camera.height_px])).all(axis=1)]
    return uv[~may_show_cars(world, camera, uv, AHEAD_M[-1])]
