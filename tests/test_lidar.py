"""Lidar files, sweeps and their bytes: what needs no render."""

import numpy as np
import pytest
from hypothesis import given

from synth3dlanes.dataset.format import read_sweep, write_passes, write_sweep
from synth3dlanes.draw.sample import with_lidar
from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.imaging.sweep import Sweep, directions
from synth3dlanes.labels.labels import from_json, to_json
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import preset_names
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.truth.ground_truth import ground_truth
from tests.dataset.test_hostile import mutated, refused_or_read
from tests.scenes import FLAT

WHERE = "x.lidar.exr"
FOUR = LidarSpec(
    elevations_deg=[-30.0, 10.0, 0.0, -4.0], azimuths=16, min_range_m=1.0, max_range_m=80.0, height_m=2.0, forward_m=0.5
)
LABEL = ground_truth(with_lidar(FLAT, FOUR)).lidar


def sweep(**changes) -> Sweep:
    rng = np.random.default_rng(0)
    arrays = {
        "range_m": np.where(rng.random((4, 16)) < 0.5, rng.uniform(1, 80, (4, 16)), np.inf).astype(np.float32),
        "semantic": rng.integers(0, 15, (4, 16)).astype(np.uint8),
        "instance": rng.integers(0, 10_001, (4, 16)).astype(np.uint16),
    }
    return Sweep(LABEL, **arrays | changes)


def test_beams_go_from_the_top_down_and_azimuths_clockwise_from_the_rear():
    rays = directions(np.radians([10.0, -30.0]), 360)
    elevations = np.degrees(np.arcsin(rays[..., 2]))
    assert np.allclose(elevations[0], 10)
    assert np.allclose(elevations[1], -30)
    # Compass bearings: 0 is forward, 90 right.
    bearings = np.degrees(np.arctan2(rays[..., 0], rays[..., 1]))
    assert np.allclose(bearings, np.arange(360) - 179.5)
    assert np.allclose(np.linalg.norm(rays, axis=-1), 1)


def test_points_keep_their_ranges_and_numbers_and_are_in_the_frame_of_the_camera_too():
    one = sweep(range_m=np.full((4, 16), np.inf, np.float32))
    one.range_m[2, 11] = 7.0
    points = one.points()
    assert (points.beam.tolist(), points.azimuth.tolist(), points.range_m.tolist()) == ([2], [11], [7.0])
    assert (points.semantic[0], points.instance[0]) == (one.semantic[2, 11], one.instance[2, 11])
    # Beam 2 of 10, 0, -4 and -30 degrees; azimuth 11 of 16 is 78.75 degrees to the right of forward.
    down, aside = np.radians(4), np.radians(11.5 * 22.5 - 180)
    expected = 7 * np.array([np.cos(down) * np.sin(aside), np.cos(down) * np.cos(aside), -np.sin(down)])
    assert points.xyz_lidar[0] == pytest.approx(expected)
    # The lidar is 2 m above the road and 0.5 m ahead of the camera's foot; FLAT's camera is 1.6 m above it.
    labels = ground_truth(with_lidar(FLAT, FOUR))
    on_road = transform(labels.camera.road_from_cam, points.xyz_cam)
    assert on_road[0] == pytest.approx(expected + np.array([0, 0.5, 2.0]))


def test_yaw_turns_the_lidar_to_the_left_and_pitch_down():
    def forward(**angles):
        spec = LidarSpec.model_validate({**FOUR.model_dump(mode="json"), **angles})
        labels = ground_truth(with_lidar(FLAT, spec))
        return (labels.camera.road_from_cam @ labels.lidar.cam_from_lidar)[:3, 1]

    assert forward(yaw_deg=90) == pytest.approx([-1, 0, 0], abs=1e-6)
    assert forward(pitch_deg=30) == pytest.approx([0, np.cos(np.pi / 6), -0.5], abs=1e-6)


def test_sweeps_come_back_exactly_from_equal_bytes():
    before = sweep()
    data = write_sweep(before)
    assert data == write_sweep(before)
    after = read_sweep(data, WHERE, LABEL)
    for name in ("range_m", "semantic", "instance"):
        assert np.array_equal(getattr(after, name), getattr(before, name))
        assert getattr(after, name).dtype == getattr(before, name).dtype


def test_the_lidar_of_labels_comes_back():
    read = from_json(to_json(ground_truth(with_lidar(FLAT, FOUR))), "x")
    assert read.lidar.elevations_rad == LABEL.elevations_rad == tuple(np.radians([10, 0, -4, -30]).round(9).tolist())
    assert np.allclose(invert(read.lidar.cam_from_lidar) @ LABEL.cam_from_lidar, np.eye(4))
    assert from_json(to_json(ground_truth(FLAT)), "x").lidar is None


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (write_sweep(sweep(range_m=np.full((4, 16), np.nan, np.float32))), "range: expected 1 to 80 m or infinity"),
        (write_sweep(sweep(range_m=np.full((4, 16), 81, np.float32))), "range: expected 1 to 80 m or infinity"),
        (write_sweep(sweep(range_m=np.full((4, 16), -2, np.float32))), "range: expected 1 to 80 m or infinity"),
        (write_passes({"range": np.ones((16, 4), np.float32)}), "expected 16x4 pixels, got 4x16"),
        (write_passes({"range": np.ones((4, 16), np.float32)}), "expected channels range, semantic, instance"),
        (b"", "expected an OpenEXR image"),
    ],
)  # fmt: skip
def test_what_no_lidar_measures_is_refused(data, told):
    with pytest.raises(FormatError, match=rf"^{WHERE}: {told}"):
        read_sweep(data, WHERE, LABEL)


@given(mutated(write_sweep(sweep())))
def test_damaged_sweeps(data):
    refused_or_read(lambda: read_sweep(data, WHERE, LABEL), WHERE)


def test_the_ready_lidars_have_the_beams_of_their_manuals():
    specs = {name: load_lidar(name) for name in preset_names("lidars")}
    assert {name: len(spec.elevations_deg) for name, spec in specs.items()} == {
        "hdl_32e": 32, "hdl_64e": 64, "vlp_32c": 32
    }  # fmt: skip
    steps = np.diff(specs["hdl_32e"].elevations_deg)
    assert np.allclose(steps, -41.34 / 31)
    # 26.33 degrees from the top beam to the lowest; 1/3 degree apart above, 1/2 below.
    elevations = np.array(specs["hdl_64e"].elevations_deg)
    assert elevations[0] - elevations[-1] == pytest.approx(26.33)
    assert np.allclose(np.diff(elevations)[:31], -1 / 3)
    assert np.allclose(np.diff(elevations)[32:], -0.5)


def test_every_problem_of_a_lidar_file_is_a_line(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("elevations_deg: {beams: 1, top: 0, bottom: 1}\nazimuths: 3\nmax_range_m: 50\nheigth_m: 2\n")
    with pytest.raises(InputError) as caught:
        load_lidar(str(path))
    told = {line.removeprefix(f"{path}: ").partition(":")[0] for line in caught.value.problems}
    assert told == {"elevations_deg", "azimuths", "height_m", "heigth_m"}
    path.write_text("elevations_deg: [1, 1]\nazimuths: 16\nmax_range_m: 50\nheight_m: 2\n")
    with pytest.raises(InputError, match="elevations_deg: expected each elevation once"):
        load_lidar(str(path))
    with pytest.raises(InputError, match="hdl: expected one of hdl_32e, hdl_64e, vlp_32c"):
        load_lidar("hdl")


def test_places_may_be_ranges_drawn_for_each_scene():
    spec = LidarSpec.model_validate({**FOUR.model_dump(mode="json"), "height_m": [1.8, 2.2]})
    scenes = [with_lidar(FLAT.model_copy(update={"index": index}), spec) for index in range(20)]
    heights = {scene.lidar.height_m for scene in scenes}
    assert len(heights) == 20
    assert min(heights) >= 1.8
    assert max(heights) < 2.2
