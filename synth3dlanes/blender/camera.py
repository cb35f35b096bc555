"""Set Blender's camera: the only axis flip of the project. Blender cameras look along -z with y up."""

import bpy
import mathutils
import numpy as np

from synth3dlanes.scene.host import HostCamera
from synth3dlanes.system.arrays import Matrix4

CAM_FROM_BLENDER = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
CLIP_M = (0.05, 2e4)


def set_camera(camera_object: bpy.types.Object, camera: HostCamera, world_from_cam: Matrix4) -> None:
    """Set the camera's pose and intrinsics; unequal focal lengths are set as pixel aspect."""
    camera_object.matrix_world = mathutils.Matrix((world_from_cam @ CAM_FROM_BLENDER).tolist())
    lens = camera_object.data
    lens.sensor_fit = "HORIZONTAL"
    lens.sensor_width = 36.0
    lens.lens = camera.fx_px * lens.sensor_width / camera.width_px
    lens.clip_start, lens.clip_end = CLIP_M
    aspect = camera.fx_px / camera.fy_px
    # Shifts are fractions of the sensor's width; Blender's centre is (W/2, H/2) too.
    lens.shift_x = (camera.width_px / 2 - camera.cx_px) / camera.width_px
    lens.shift_y = (camera.cy_px - camera.height_px / 2) * aspect / camera.width_px
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y = camera.width_px, camera.height_px
    render.resolution_percentage = 100
    render.pixel_aspect_x, render.pixel_aspect_y = 1.0, 1.0
    if aspect >= 1:
        render.pixel_aspect_y = aspect
    else:
        render.pixel_aspect_x = 1 / aspect
