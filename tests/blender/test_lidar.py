"""A lidar's sweep against closed forms, and against the passes of the same scene."""

from dataclasses import replace

import numpy as np
import pytest

from synth3dlanes.blender.lidar import even_runs
from synth3dlanes.draw.sample import Scenes, sample_scene, with_lidar
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import load_params
from synth3dlanes.production.recipe import take_picture
from synth3dlanes.scene.instance_ids import instance_id
from synth3dlanes.scene.scene import Car
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.scene.things import SEMANTIC_IDS
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.seen import PAVEMENT
from synth3dlanes.world.world import resolve
from tests.scenes import changed
from tests.validate.examining import findings, reasons

pytestmark = pytest.mark.render

ONE_SAMPLE = RenderSettings(samples=1, passes=("depth", "semantic", "instance"))
# A picture that is soon made, and whose middle is not its optical axis.
SMALL = {"width_px": 160, "height_px": 120, "fx_px": 138.6, "fy_px": 138.6, "cx_px": 83, "cy_px": 50}
# Even beams, then two that are not.
UNEVEN = LidarSpec.model_validate(
    {
        "elevations_deg": [5, 0, -5, -10, -15, -17, -28],
        "azimuths": 500,
        "max_range_m": 100,
        "height_m": 1.9,
        "right_m": 0.4,
        "forward_m": -0.6,
        "yaw_deg": 20,
    }
)


def test_ranges_on_a_flat_road_are_those_of_the_beams_to_a_tenth_of_a_millimetre():
    scene = with_lidar(changed(camera=SMALL), UNEVEN)
    sweep = take_picture(resolve(scene), ONE_SAMPLE).sweep
    for elevation_deg, ranges, ids in zip(UNEVEN.elevations_deg, sweep.range_m, sweep.semantic, strict=True):
        on_road = ids == SEMANTIC_IDS["road"]
        if elevation_deg > -5:
            assert not on_road.any()
        else:
            assert on_road.sum() > 50
            assert np.abs(ranges[on_road] - 1.9 / np.sin(np.radians(-elevation_deg))).max() < 1e-4


def test_points_of_a_car_are_inside_it_and_it_is_on_the_right():
    car = Car(model=1, scale=1.0, color=(0.5, 0.5, 0.5), gloss=0.5, lane="main_3", s_m=-43.0)
    scene = with_lidar(changed(camera=SMALL).model_copy(update={"cars": (car,)}), UNEVEN)
    world = resolve(scene)
    points = take_picture(world, ONE_SAMPLE).sweep.points()
    hit = points.instance == instance_id("car", 0)
    assert hit.sum() > 20
    assert (points.semantic[hit] == SEMANTIC_IDS["car"]).all()
    xyz_world = transform(world.view.world_from_lidar, points.xyz_lidar[hit])
    xyz_car = transform(invert(world.view.world_from_cars[0]), xyz_world)
    model = scene.assets.car_models[0]
    half_m = np.array([model.width_m / 2, model.length_m / 2]) + 0.01
    assert (np.abs(xyz_car[:, :2]) < half_m).all()
    assert (xyz_car[:, 2] > -0.01).all()
    assert (points.xyz_cam[hit, 0] > 1).all()


@pytest.mark.thorough
def test_the_picture_beside_a_sweep_and_passes_is_that_without():
    scene = sample_scene(Scenes(load_params("tiny")), 1)
    settings = replace(ONE_SAMPLE, passes=("depth", "normal", "semantic", "instance"))
    alone, beside = (take_picture(resolve(one), settings) for one in (scene, with_lidar(scene, UNEVEN)))
    bare = take_picture(resolve(scene), replace(settings, passes=()))
    assert alone.sweep is None
    assert beside.sweep is not None
    assert np.array_equal(bare.image, alone.image)
    assert np.array_equal(beside.image, alone.image)
    assert all(np.array_equal(beside.passes[name], alone.passes[name]) for name in settings.passes)


def test_sweeps_agree_with_the_passes_and_mirrored_or_turned_ones_do_not():
    scene = with_lidar(sample_scene(Scenes(load_params("appendix_i")), 17), load_lidar("hdl_32e"))
    world = resolve(scene)
    picture = take_picture(world, ONE_SAMPLE)
    sweep = picture.sweep
    sample = Evidence(world, picture.labels, picture.image, picture.passes, sweep)
    assert findings(sample, "lidar") == []
    paved = sample.swept.at(np.isin(sample.swept.ids["semantic"], [SEMANTIC_IDS[name] for name in PAVEMENT]))
    assert len(paved) > 5000
    assert np.quantile(np.abs(paved.pavement.above_m[paved.is_near]), 0.99) < 0.01

    def spoilt(change):
        arrays = {name: change(getattr(sweep, name)) for name in ("range_m", "semantic", "instance")}
        return findings(replace(sample, sweep=replace(sweep, **arrays)), "lidar")

    assert spoilt(lambda values: values[:, ::-1])
    assert spoilt(lambda values: values[::-1])
    assert spoilt(lambda values: np.roll(values, 3, axis=1))
    assert spoilt(lambda values: np.roll(values, 1, axis=0))
    assert spoilt(lambda values: (values * 1.01).astype(values.dtype) if values.dtype == np.float32 else values)
    assert spoilt(lambda values: values + np.uint16(1) if values.dtype == np.uint16 else values)
    is_paint = sweep.semantic == SEMANTIC_IDS["marking"]
    next_line = replace(sweep, instance=sweep.instance + (is_paint & (sweep.instance > 0)).astype(np.uint16))
    assert "lidar: expected paint where the line" in reasons(replace(sample, sweep=next_line), "lidar")
    ahead_m = scene.camera.y_m + 9
    lane = scene.paper_road.segments_at(ahead_m)[0]
    unseen = scene.cars[0].model_copy(update={"s_m": ahead_m, "lane": lane})
    other = replace(sample, known_world=resolve(scene.model_copy(update={"cars": (*scene.cars, unseen)})))
    assert "lidar: expected beams to end at cars" in reasons(other, "lidar")


def test_even_beams_are_rendered_at_once_and_others_alone():
    elevations = [0.3, 0.2, 0.1, 0.0, -0.1, -0.15, -0.2, -0.4, -0.5, -0.6, -0.7]
    assert list(even_runs(elevations)) == [(0, 5), (5, 6), (6, 7), (7, 11)]
    # Half a step above the top one the zenith is passed.
    assert list(even_runs([1.5, 0.5, -0.5, -1.5])) == [(0, 1), (1, 2), (2, 3), (3, 4)]
