"""A lidar's sweep, rendered: Cycles' panoramic camera sends one ray through the middle of each pixel, here one for each
beam and azimuth, and its depth is the distance along the ray. So ranges and ids are those of the surfaces in the image.
"""

from collections.abc import Iterator, Sequence

import bpy
import mathutils
import numpy as np

from synth3dlanes.blender.camera import CAM_FROM_BLENDER
from synth3dlanes.blender.lens import SCREEN_ID
from synth3dlanes.blender.trace import distances, run_cycles
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import LidarLabel
from synth3dlanes.scene.settings import NO_HIT_DEPTH_M
from synth3dlanes.system.arrays import Matrix4

# Beams whose spacing is even to this tolerance are rendered in one image: Cycles' directions are no more exact.
EVEN_RAD = 1e-7
# Blender renders no image of fewer rows, so a beam that is rendered alone gets spare rows below it.
MIN_ROWS, SPARE_ROWS_RAD = 4, 1e-3
# Measured: with its narrowest filter Cycles' rays start above the middle of a row, by this share of it.
ABOVE_MIDDLE = 4.84e-4


def scan(camera: bpy.types.Object, lidar: LidarLabel, world_from_lidar: Matrix4) -> Sweep:
    """One turn of a lidar in the scene that is built, by the scene's camera; its pose and image must be set again
    before the next picture."""
    blender, lens, layer = bpy.context.scene, camera.data, bpy.context.scene.view_layers[0]
    camera.matrix_world = mathutils.Matrix((world_from_lidar @ CAM_FROM_BLENDER).tolist())
    blender.cycles.samples, blender.cycles.filter_width, blender.cycles.max_bounces = 1, 0.01, 0
    blender.cycles.use_denoising = False
    blender.render.resolution_x = lidar.azimuths
    blender.render.pixel_aspect_x, blender.render.pixel_aspect_y = 1.0, 1.0
    has_ids, layer.use_pass_object_index = layer.use_pass_object_index, True
    lens.type, lens.panorama_type = "PANO", "EQUIRECTANGULAR"
    lens.shift_x = lens.shift_y = 0.0
    # The screen of the camera's lens.
    for item in blender.objects:
        item.hide_render = item.pass_index == SCREEN_ID
    lens.longitude_min, lens.longitude_max = -np.pi, np.pi
    try:
        runs = [_run(camera, lidar.elevations_rad[start:end]) for start, end in even_runs(lidar.elevations_rad)]
    finally:
        lens.type, layer.use_pass_object_index = "PERSP", has_ids
    range_m, semantic, instance = (np.concatenate(rows) for rows in zip(*runs, strict=True))
    measured = (range_m >= lidar.min_range_m) & (range_m <= lidar.max_range_m)
    return Sweep(
        lidar,
        np.where(measured, range_m, np.float32(NO_HIT_DEPTH_M)),
        np.where(measured, semantic, 0).astype(np.uint8),
        np.where(measured, instance, 0).astype(np.uint16),
    )


def even_runs(elevations_rad: Sequence[float]) -> Iterator[tuple[int, int]]:
    """Start and end of runs of evenly spaced beams; what is too short for an image, or reaches beyond the poles with
    the half row above or below it, comes beam by beam."""
    start = 0
    while start < len(elevations_rad):
        step, end = _step(elevations_rad[start : start + 2]), start + 1
        while (
            end < len(elevations_rad)
            and abs(elevations_rad[start] - (end - start) * step - elevations_rad[end]) < EVEN_RAD
        ):
            end += 1
        farthest = max(elevations_rad[start], -elevations_rad[end - 1]) + step / 2
        if end - start < MIN_ROWS or farthest > np.pi / 2:
            end = start + 1
        yield start, end
        start = end


def _step(elevations_rad: Sequence[float]) -> float:
    return elevations_rad[0] - elevations_rad[1] if len(elevations_rad) > 1 else SPARE_ROWS_RAD


def _run(camera: bpy.types.Object, elevations_rad: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ranges, semantic and instance ids of evenly spaced beams, a row for each."""
    n, step = len(elevations_rad), _step(elevations_rad)
    rows = max(n, MIN_ROWS)
    bpy.context.scene.render.resolution_y = rows
    top_rad = elevations_rad[0] + (0.5 - ABOVE_MIDDLE) * step
    camera.data.latitude_max, camera.data.latitude_min = top_rad, top_rad - rows * step
    passes = run_cycles()
    return distances(passes)[:n], passes["IndexMA"][:n, :, 0], passes["IndexOB"][:n, :, 0]
