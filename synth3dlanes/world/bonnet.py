"""The host's own bonnet: one shape, moved down from the camera until it fills the share of the picture that it should.

Camera frame but for the height: x right, y ahead, z up from the bonnet's highest point, metres.
"""

import numpy as np

from synth3dlanes.geometry.frames import turned
from synth3dlanes.scene.host import HostCamera
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.things import FIRST_OF
from synth3dlanes.system.arrays import Matrix4, Numbers
from synth3dlanes.world.camera import rays
from synth3dlanes.world.meshes import Mesh, grid

KIND, ID = FIRST_OF["bonnet"], instance_id("bonnet", 0)
HALF_WIDTH_M, FROM_M, TO_M = 0.78, 0.02, 1.6
# It falls towards the nose and the sides; two folds run along it.
NOSE, SIDES, FOLD_M, FOLD_AT_M, FOLD_WIDTH_M = (0.05, 0.07, 0.10), (0.05, 0.12), 0.012, 0.42, 0.05
SHAPE = (40, 48)
# For wide lenses, whose share of the picture would need a bonnet down in the road: the steepest view of its edge, its
# least height over the road, and its least distance below the camera.
WIDEST, LOWEST_M, NEAREST_M = 20.0, 0.8, 0.25


def surface_m(x_m: Numbers, y_m: Numbers) -> Numbers:
    """The height of the bonnet, 0 at its highest."""
    along, aside = np.clip((y_m - FROM_M) / (TO_M - FROM_M), 0, 1), np.abs(x_m) / HALF_WIDTH_M
    nose = NOSE[0] * along + NOSE[1] * along**2 + NOSE[2] * along**12
    fold = FOLD_M * (1 + np.tanh((np.abs(x_m) - FOLD_AT_M) / FOLD_WIDTH_M)) / 2
    return np.asarray(fold - nose - SIDES[0] * aside**2 - SIDES[1] * aside**8)


def bonnet() -> Mesh:
    """The surface of the bonnet."""
    n_along, n_across = SHAPE
    y_m, x_m = np.meshgrid(
        np.linspace(FROM_M, TO_M, n_along), np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, n_across), indexing="ij"
    )
    points = np.stack([x_m, y_m, surface_m(x_m, y_m)], axis=-1)
    return grid(points, points[..., :2], np.zeros(n_across - 1, dtype=int))


def cam_from_bonnet(camera: HostCamera, share: float) -> Matrix4:
    """The pose at which the bonnet fills this share of the image's height in the middle of its width, or more of it in
    that of a wide lens: along the host's middle, whatever the camera's yaw and place."""
    y_m = np.linspace(FROM_M, TO_M, SHAPE[0])
    edge = (camera.cy_px - camera.height_px * (1 - share)) / camera.fy_px
    if not camera.lens.is_pinhole:
        _, ahead, up = rays(camera, np.array([camera.cx_px, camera.height_px * (1 - share)]))
        edge = float(up / ahead) if ahead > 0 else -WIDEST
    below_m = float((surface_m(np.zeros(SHAPE[0]), y_m) - edge * y_m).max())
    if not camera.lens.is_pinhole:
        below_m = min(below_m, max(camera.height_m - LOWEST_M, NEAREST_M))
    pose = turned(-camera.yaw_rad) @ turned(0.0, -camera.right_m)
    pose[2, 3] = -below_m
    return np.asarray(pose)
