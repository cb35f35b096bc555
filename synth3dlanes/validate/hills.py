"""The pixels of the terrain, put back in the world by their depth: are the hills those of the scene?

Beside the roads the terrain's mesh is all there is, and a pixel's point lies on it. So hills that are a per cent higher
are found in one sample, and so is a lens of another focal length.
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

# So many pixels are asked, evenly spread; of fewer than MIN_PIXELS nothing is said.
MAX_PIXELS, MIN_PIXELS, RANGE_M = 2_000, 20, 120.0
# Verges and embankments lie over the terrain up to this far beyond their feet, in widths of a verge.
VERGES = 1.1
# The median over a sample is 1 mm at most in 400 rendered ones.
MAX_MEDIAN_M = 0.005


def check_hills(world: World, labels: Labels, passes: Passes) -> Iterator[Finding]:
    """Is the terrain as high as it should be?"""
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
