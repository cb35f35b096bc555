"""Files of cameras, our own and others', and of lidars; every mistake is a line. Sweeps and their bytes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given

from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.format import read_sweep, write_passes, write_sweep
from synth3dlanes.draw.sample import Scenes, sample_scene, with_lidar
from synth3dlanes.geometry.frames import transform
from synth3dlanes.imaging.sweep import Sweep, directions
from synth3dlanes.params.camera_files import load_camera, read_camera
from synth3dlanes.params.cameras import CameraSpec, black_pictures
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.lidars import LidarSpec
from synth3dlanes.params.params import load_params, preset_names
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import clips
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.truth.ground_truth import ground_truth
from synth3dlanes.validate.run import validate
from synth3dlanes.world.camera import rays_of_pixels
from tests.hostile import mutated, refused_or_read
from tests.scenes import FLAT

OWN = "width_px: 640\nheight_px: 480\n"
# What cv2.FileStorage writes.
OPENCV = """%YAML:1.0
---
image_width: 1280
image_height: 720
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 700., 0., 640., 0., 690., 350., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.34999999999999998, 0.14999999999999999, 0.001,
       -0.00069999999999999999, -0.029999999999999999 ]
avg_reprojection_error: 1.2223406580161311e-01
"""
KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [461.6, 460.3, 362.7, 248.1]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: omni
"""
ROS = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix: {rows: 3, cols: 3, data: [400, 0, 320, 0, 401, 240, 0, 0, 1]}
distortion_model: rational_polynomial
distortion_coefficients: {rows: 1, cols: 8, data: [1, 2, 3, 4, 5, 6, 7, 8]}
"""
# As those of KITTI-360's fisheyes.
MEI = """%YAML:1.0
---
model_type: MEI
camera_name: image_02
image_width: 1400
image_height: 1400
mirror_parameters:
   xi: 2.2
distortion_parameters:
   k1: 0.017
   k2: 1.65
   p1: 0.0004
   p2: 0.0005
projection_parameters:
   gamma1: 1336.3
   gamma2: 1335.8
   u0: 716.9
   v0: 705.8
"""


def read(text: str, folder: Path) -> CameraSpec:
    path = folder / "mine.yaml"
    path.write_text(text)
    return load_camera(str(path))


def middle(spec: CameraSpec) -> dict[str, object]:
    return spec.drawn(lambda: 0.5)


@pytest.fixture
def problems(tmp_path: Path) -> Callable[[str], list[str]]:
    def found(text: str) -> list[str]:
        with pytest.raises(InputError) as error:
            read(text, tmp_path)
        where = f"{tmp_path / 'mine.yaml'}: "
        assert all(line.startswith(where) for line in error.value.problems)
        return [line.removeprefix(where) for line in error.value.problems]

    return found


def test_every_form_of_a_value(tmp_path: Path) -> None:
    text = "fx: 500 +- 20\ncx: [300, 340]\ncy: {240: 1, 250: 3}\nheight_m: 1.4 ± 0.1\nyaw_deg: 5\nroll_deg: 0 +/- 1e0"
    spec = read(OWN + text, tmp_path)
    low, high = (spec.drawn(lambda u=u: u) for u in (0.0, 1 - 1e-12))
    assert (low["fx_px"], high["fx_px"]) == (480, 520)
    assert (low["fy_px"], high["fy_px"]) == (480, 520)
    assert (low["cx_px"], high["cx_px"], low["cy_px"], high["cy_px"]) == (300, 340, 240, 250)
    assert (low["height_m"], high["height_m"]) == (1.3, 1.5)
    assert low["yaw_rad"] == pytest.approx(np.radians(5), abs=1e-6)
    assert (low["roll_rad"], high["roll_rad"]) == (-0.017453, 0.017453)


FX = ("fx_px", "fy_px", "cx_px", "cy_px")
ZEROS = [0.0] * 14
OMNI = KALIBR.replace("pinhole", "omni").replace("[461.6", "[1.5, 461.6").replace("equidistant", "radtan")
FOUR_CV = OPENCV.replace("cols: 5", "cols: 4").replace(",\n       -0.00069999999999999999", "")
# Prisms, and at last two angles by which the sensor is tilted.
TILTED = [round(0.01 * i, 2) for i in range(1, 15)]


def tilted(values: list[float]) -> str:
    matrix = [500, 0, 320, 0, 500, 240, 0, 0, 1]
    return f"image_width: 640\nimage_height: 480\ncamera_matrix: {matrix}\ndistortion_coefficients: {values}"


@pytest.mark.parametrize(
    ("text", "size", "matrix", "model", "coefficients"),
    [
        # (0, 0) is the centre of the first pixel of others.
        (OPENCV, (1280, 720), [700, 690, 640.5, 350.5], "opencv", [-0.35, 0.15, 0.001, -0.0007, -0.03]),
        (FOUR_CV + "fisheye_model: 1\n", (1280, 720), [700, 690, 640.5, 350.5], "fisheye", [-0.35, 0.15, 0.001, -0.03]),
        (KALIBR, (752, 480), [461.6, 460.3, 363.2, 248.6], "fisheye", [-0.01, 0.02, -0.003, 0.0004]),
        (KALIBR.replace("equidistant", "radtan"), (752, 480), [461.6, 460.3, 363.2, 248.6], "opencv",
         [-0.01, 0.02, -0.003, 0.0004]),
        (OMNI, (752, 480), [461.6, 460.3, 363.2, 248.6], "omni", [1.5, -0.01, 0.02, -0.003, 0.0004]),
        (MEI, (1400, 1400), [1336.3, 1335.8, 717.4, 706.3], "omni", [2.2, 0.017, 1.65, 0.0004, 0.0005]),
        (ROS, (640, 480), [400, 401, 320.5, 240.5], "opencv", [1, 2, 3, 4, 5, 6, 7, 8]),
        (tilted(TILTED[:12]), (640, 480), [500, 500, 320.5, 240.5], "opencv", TILTED[:12]),
        (tilted(TILTED[:8] + ZEROS[:4]), (640, 480), [500, 500, 320.5, 240.5], "opencv", TILTED[:8]),
        (tilted(TILTED), (640, 480), [500, 500, 320.5, 240.5], "opencv", TILTED),
        (f"{OWN}K: [[500, 0, 322], [0, 505, 239], [0, 0, 1]]", (640, 480), [500, 505, 322, 239], "pinhole", []),
        (f"{OWN}K: [500, 0, 322, 0, 505, 239, 0, 0, 1]", (640, 480), [500, 505, 322, 239], "pinhole", []),
    ],
)  # fmt: skip
def test_files_of_others(
    text: str, size: tuple[int, int], matrix: list[float], model: str, coefficients: list[float], tmp_path: Path
) -> None:
    found = middle(read(text, tmp_path))
    assert (found["width_px"], found["height_px"]) == size
    assert [found[name] for name in FX] == matrix
    lens = found["lens"]
    assert lens.model == model
    assert list(lens.coefficients) == (coefficients + ZEROS)[: len(lens.coefficients)]
    assert (found["height_m"], found["pitch_rad"], found["right_m"]) == (1.5, 0, 0)


def test_a_calibration_gets_its_place_from_an_own_file(tmp_path: Path) -> None:
    (tmp_path / "calibration.yaml").write_text(OPENCV)
    found = middle(read("calibration: calibration.yaml\nheight_m: 1.2\nright_m: -0.3\npitch_deg: 2", tmp_path))
    assert (found["fx_px"], found["height_m"], found["right_m"]) == (700, 1.2, -0.3)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (OWN, "expected either fx (or K) or horizontal_fov_deg"),
        (f"{OWN}fx: 500\nhorizontal_fov_deg: 60", "expected either fx (or K) or horizontal_fov_deg"),
        (f"{OWN}fx: 500\nfocal: 3", "focal: unknown key"),
        (f"{OWN}fx: 500\nhieght_m: 3", "hieght_m: unknown key; did you mean height_m?"),
        (f"{OWN}fx: 500\nheight_m: 30", "height_m: expected numbers in [0.3, 10]"),
        (f"{OWN}fx: 500\npitch_deg: [5, 1]", "pitch_deg: expected [low, high] with low <= high, got [5, 1]"),
        (f"{OWN}fx: 500 +- ", "fx_px: expected numbers in [1, 100000]"),
        (f"{OWN}fx: 500\nk1: 0.1", "expected no coefficients for the model pinhole, got k1"),
        (f"{OWN}fx: 500\nmodel: fisheye\np1: 0.1", "expected k1 k2 k3 k4 for the model fisheye, got p1"),
        (f"{OWN}fx: 500\nmodel: ftheta", "model: expected 'pinhole', 'opencv', 'fisheye' or 'omni', got 'ftheta'"),
        (f"{OWN}fx: 500\nmodel: omni\nk3: 1", "expected xi k1 k2 p1 p2 for the model omni, got k3"),
        (f"{OWN}fx: 500\nmodel: fisheye\nxi: 1", "expected k1 k2 k3 k4 for the model fisheye, got xi"),
        (f"{OWN}fx: 500\nmodel: omni\nxi: -1", "xi: expected numbers in [0, 10000]"),
        (f"{OWN}fx: 500\nmodel: opencv\ntau_x: 0.6", "tau_x: expected numbers in [-0.5, 0.5]"),
        (MEI.replace("xi: 2.2", "eta: 2"), "mirror_parameters: expected the numbers xi, got"),
        (f"{OWN}K: [[1, 0], [0, 1]]", "K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got"),
        (f"{OWN}horizontal_fov_deg: 181", "horizontal_fov_deg: expected less than the lens's 180, got 181"),
        (f"{OWN}model: opencv\nk1: -0.3333333\nhorizontal_fov_deg: 120", "horizontal_fov_deg: expected less than the"),
        ("width_px: 640\nfx: 500", "height_px: missing"),
        ("- 3", "expected keys of a camera such as width_px, got [3]"),
        ("", "expected keys of a camera such as width_px, got None"),
        ("a: [", "line 1: not YAML"),
        (OPENCV.replace("image_width", "breadth"), "image_width: missing key"),
        (OPENCV.replace("700., ", ""), "camera_matrix: expected 9 numbers, got"),
        (OPENCV.replace("-0.34999999999999998, ", "0, 0, "), "distortion: expected 4, 5, 8, 12 or 14 coefficients"),
        (KALIBR.replace("pinhole", "ds"), "camera_model: expected pinhole or omni, got 'ds'"),
        (KALIBR.replace("pinhole", "omni"), "expected intrinsics [xi, fx, fy, cx, cy] and resolution"),
        (KALIBR.replace("equidistant", "fov"), "distortion_model: expected one of none, radtan, equidistant, got"),
        ("calibration: none.yaml", "calibration none.yaml: cannot read: No such file"),
    ],
)  # fmt: skip
def test_each_mistake_has_its_line(text: str, expected: str, problems: Callable[[str], list[str]]) -> None:
    assert any(line.startswith(expected) for line in problems(text)), problems(text)


def test_all_mistakes_are_reported(problems: Callable[[str], list[str]]) -> None:
    assert len(problems(f"{OWN}fx: 500\nheight_m: 30\npitch_deg: x\nfocal: 3")) == 3


NARROW = {"width_px": 480, "height_px": 360, "fx": 200, "model": "opencv", "k1": -0.5}


def test_the_black_part_of_a_picture_is_told_before_rendering_and_after(tmp_path: Path) -> None:
    """Against the rays of every pixel of a scene's camera, and a circle of the radius where the lens turns back."""
    spec = read_camera(NARROW, "mine.yaml", Path())
    scene = sample_scene(Scenes(load_params("appendix_i"), shots=clips(1, 10.0, (spec,))), 0)
    exact = np.isnan(rays_of_pixels(scene.camera)).any(axis=-1).mean()
    end = 1 / np.sqrt(1.5)
    radius_px = 200 * end * (1 - 0.5 * end**2)
    assert exact == pytest.approx(1 - np.pi * radius_px**2 / (480 * 360), abs=0.003)
    assert spec.black_share() == pytest.approx(exact, abs=0.01)
    share = f"{spec.black_share():.0%}"
    assert black_pictures([spec]) == [
        f"{share} of the picture is black, beyond the lens's field: it ends inside the image"
    ]
    plan = Plan("d", 1, Recipe(Scenes(load_params("tiny"), shots=clips(1, 10.0, (spec,))), RenderSettings(), "jpg"))
    assert black_pictures([spec])[0] in plan.text()
    with claim(tmp_path / "d", plan.description(), "train", 0, []):
        pass
    assert validate(tmp_path / "d", 1, None, lambda done, total: None).notes == black_pictures([spec])


def test_no_ready_camera_has_a_black_part() -> None:
    ready = [load_camera(name) for name in preset_names("cameras")]
    rigs = [camera for name in preset_names("rigs") for camera in load_rig(name)]
    assert black_pictures([*ready, *rigs]) == []


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
