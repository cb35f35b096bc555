"""Check the terrain's heights: pixels of terrain, unprojected by their depth, must lie on the scene's terrain mesh.

This finds hills that are one per cent too high, or a different focal length, in a single sample.
"""

from collections.abc import Iterator

import numpy as np

from synth3dlanes.frames import transform
from synth3dlanes.geometry.ground import EMBANKMENT_SLOPE, VERGE_M
from synth3dlanes.geometry.terrain import gradient_at
from synth3dlanes.labels import Labels
from synth3dlanes.settings import SEMANTIC_IDS
from synth3dlanes.validate.findings import Finding
from synth3dlanes.validate.ground_contact import terrain_height
from synth3dlanes.validate.passes_proof import Passes
from synth3dlanes.validate.pavement import unproject
from synth3dlanes.world import World

# At most MAX_PIXELS evenly spread pixels are used; fewer than MIN_PIXELS are not judged.
MAX_PIXELS, MIN_PIXELS, RANGE_M = 2_000, 20, 120.0
# Pixels within this many verge widths of the embankment's foot are skipped: verges cover the terrain there.
VERGES = 1.1
# The median over a sample is at most 1 mm in 400 rendered samples.
MAX_MEDIAN_M = 0.005


def check_hills(world: World, labels: Labels, passes: Passes) -> Iterator[Finding]:
    """Finding if the terrain's height differs from the scene's."""
    if not {"depth", "semantic"} <= set(passes):
        return
    is_terrain = (passes["semantic"] == SEMANTIC_IDS["terrain"]) & (passes["depth"] < RANGE_M)
    rows, columns = np.nonzero(is_terrain)
    step = 1 + len(rows) // MAX_PIXELS
    points_cam = unproject(labels.camera, passes["depth"], rows[::step], columns[::step])
    points = transform(labels.camera.world_from_cam, points_cam)
    ground, scene = world.ground, world.scene
    raised_m = 0.0 if world.plan.ramp_start_m is None else EMBANKMENT_SLOPE * scene.road.ramp_height_m
    beside_m = VERGES * VERGE_M * ground.cell_scale(points[:, :2]) + raised_m
    points = points[ground.clearance(points[:, :2]) > beside_m]
    if len(points) < MIN_PIXELS:
        return
    slope = gradient_at(scene.terrain, points[:, :2])
    above_m = (points[:, 2] - terrain_height(ground, points[:, :2])) / np.sqrt(1 + (slope**2).sum(axis=1))
    median_m = float(np.median(np.abs(above_m)))
    if median_m > MAX_MEDIAN_M:
        yield Finding(
            "",
            f"depth: expected terrain within {MAX_MEDIAN_M} m of the scene's in the median, got {median_m:.3f} m, "
            f"at {len(points)} pixels",
        )
