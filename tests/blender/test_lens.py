"""Renders through lenses: what every pixel shows is what the lens's own ray of it meets."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("bpy")

from synth3dlanes.geometry.frames import transform
from synth3dlanes.geometry.lens import Lens
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.world.camera import rays_of_pixels
from synth3dlanes.world.world import resolve
from tests.lenses import LENSES
from tests.scenes import changed
from tests.thorough import first
from tests.validate.examining import findings

pytestmark = pytest.mark.render

SETTINGS = RenderSettings(samples=1, passes=("depth", "normal", "semantic", "instance"))
BENDS = {"offset_m50_m": 6.0, "offset_p50_m": -5.0}


def scene_through(lens, f_px):
    camera = {"fx_px": f_px, "fy_px": 0.96 * f_px, "cx_px": 251.0, "cy_px": 172.0, "roll_rad": 0.05, "lens": lens}
    return changed(road=BENDS, camera=camera)


@pytest.fixture(scope="module", params=first(1, sorted(LENSES, key=lambda name: name != "fisheye")))
def shot(request):
    f_px, lens = LENSES[request.param]
    scene = scene_through(lens, f_px)
    return scene, take_picture(resolve(scene), SETTINGS)


def test_labels_lie_on_the_paint_and_the_passes_on_the_road(shot):
    scene, picture = shot
    sample = Evidence(resolve(scene), picture.labels, picture.image, picture.passes)
    assert findings(sample, "points", "pavement", "normals") == []
    marked = np.argwhere(picture.passes["semantic"] == SEMANTIC_IDS["marking"])[:, ::-1] + 0.5
    solid = [lane for lane in picture.labels.lanes if lane.marking == "solid"]
    uv = np.concatenate([picture.labels.camera.project(lane.xyz_cam[lane.visible][:12]) for lane in solid])
    outside_px = np.clip(np.abs(uv - marked[cKDTree(marked).query(uv)[1]]) - 0.5, 0, None)
    assert len(uv) > 15
    assert np.hypot(*outside_px.T).max() < 1


def test_every_pixel_shows_what_its_ray_meets(shot):
    """The flat road is the plane z = 0 of the world: depth along the lens's rays must reach it, exactly."""
    scene, picture = shot
    camera = picture.labels.camera
    rays_world = rays_of_pixels(scene.camera) @ camera.world_from_cam[:3, :3].T
    is_road = picture.passes["semantic"] == SEMANTIC_IDS["road"]
    away_m = -camera.world_from_cam[2, 3] / rays_world[is_road][:, 2]
    along = rays_of_pixels(scene.camera)[is_road][:, 1]
    # Where a fisheye looks aside at a right angle, depth y says nothing about the distance.
    near = (away_m > 0) & (away_m < 60) & (np.abs(along) > 0.01)
    assert near.sum() > 10_000
    np.testing.assert_allclose(picture.passes["depth"][is_road][near], (away_m * along)[near], rtol=1e-3, atol=2e-3)
    v, u = np.nonzero(is_road)
    points_cam = camera.points(np.column_stack([u, v]) + 0.5, picture.passes["depth"][v, u].astype(float))
    points_world = transform(camera.world_from_cam, points_cam)
    assert np.abs(points_world[near][:, 2]).max() < 0.03


def test_a_fisheye_is_black_out_of_its_field_and_its_passes_are_empty():
    # Turns back at 1 rad.
    ending = Lens(model="fisheye", coefficients=(-1 / 3, 0, 0, 0))
    scene = scene_through(ending, 200.0)
    sensor = {"motion_blur_m": 0.5, "flare": 0.5, "dirt": 0.5, "drops": 0.5, "noise": 0.05}
    scene = changed(scene, sensor=sensor, weather={"kind": "rain", "rain": 1.0}, air={"visibility_m": 500.0})
    picture = take_picture(resolve(scene), SETTINGS)
    empty = np.isnan(rays_of_pixels(scene.camera)).any(axis=-1)
    assert 0.3 < empty.mean() < 0.9
    assert picture.image[empty].max() == 0
    assert np.isinf(picture.passes["depth"][empty]).all()
    for name in ("semantic", "instance", "normal"):
        assert not picture.passes[name][empty].any()
    assert picture.image[~empty].mean() > 40
    for lane in picture.labels.lanes:
        assert np.isfinite(picture.labels.camera.project(lane.xyz_cam[lane.in_image])).all()
