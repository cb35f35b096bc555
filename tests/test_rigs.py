"""Rigs: files, one world for all cameras, and what training and exports take of them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synth3dlanes_baseline.sources import UprightSamples, training_and_validation

from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import Scenes, sample_scene, sample_world
from synth3dlanes.formats.plan import plan as export_plan
from synth3dlanes.geometry.frames import invert, project, transform
from synth3dlanes.labels import labels as labels_format
from synth3dlanes.params.cameras import CameraSpec
from synth3dlanes.params.params import load_params
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.scene.host import MAX_BEHIND_M
from synth3dlanes.system.errors import InputError
from synth3dlanes.truth.ground_truth import label
from synth3dlanes.world.world import resolve
from tests import fake_samples

NUSCENES = load_rig("nuscenes")
# Rows of nuScenes' calibrated_sensor table: translation, rotation (w, x, y, z) and (f, cx, cy), in its axes: the
# vehicle's x forward, y left, z up from the rear axle, the camera's x right, y down, z forward.
TABLE = {
    "CAM_FRONT": ((1.7008, 0.0159, 1.5110), (0.49980, -0.50303, 0.49978, -0.49737), (1266.42, 816.27, 491.51)),
    "CAM_FRONT_RIGHT": ((1.5508, -0.4934, 1.4957), (0.20603, -0.20269, 0.68245, -0.67136), (1260.85, 807.97, 495.33)),
    "CAM_BACK": ((0.0283, 0.0035, 1.5791), (0.50379, -0.49740, -0.49419, 0.50455), (809.22, 829.22, 481.78)),
    "CAM_BACK_LEFT": ((1.0357, 0.4848, 1.5910), (0.69242, -0.70316, -0.11648, 0.11203), (1256.74, 792.11, 492.78)),
}
AXLE_TO_MIDDLE_M = 1.4


@pytest.mark.parametrize("name", TABLE)
def test_nuscenes_cameras_see_what_the_table_says(name):
    """What lies around the car is in the same pixels as by the data set's own numbers."""
    place, (w, x, y, z), (f, cx, cy) = TABLE[name]
    points_host = np.random.default_rng(0).uniform([-30, -30, 0], [30, 30, 3], (400, 3))
    vehicle = np.column_stack([points_host[:, 1] + AXLE_TO_MIDDLE_M, -points_host[:, 0], points_host[:, 2]])
    seen = (vehicle - place) @ Rotation.from_quat([x, y, z, w]).as_matrix()
    index = [spec.name for spec in NUSCENES].index(name)
    scene = sample_scene(Scenes(load_params("appendix_i"), shots=Shots(cameras=NUSCENES)), index)
    view = resolve(scene).view
    points_cam = transform(invert(view.world_from_cam) @ view.world_from_host, points_host)
    uv = project(view.img_from_cam, points_cam)
    ahead = seen[:, 2] > 5
    expected = np.column_stack([cx + f * seen[:, 0] / seen[:, 2], cy + f * seen[:, 1] / seen[:, 2]]) + 0.5
    inside = ahead & ((expected > 0) & (expected < [1600, 900])).all(axis=1)
    assert inside.sum() > 20
    assert np.abs(uv - expected)[inside].max() < 6


def test_lanes_boxes_and_signs_are_at_one_place_of_the_world_by_every_camera():
    params, shots = load_params("streets", ["roadside.n_gantries=1", "roadside.n_signs=6"]), Shots(cameras=NUSCENES)
    n_signs = 0
    for index in (0, 3):
        found = []
        for camera in range(6):
            world = sample_world(Scenes(params, 2, "train", shots=shots), 6 * index + camera)
            read = labels_format.from_json(labels_format.to_json(label(world, world.view)), "labels")
            pose = read.camera.world_from_cam
            lanes = {lane.id: transform(pose, lane.xyz_cam) for lane in read.lanes}
            boxes = {item.id: pose @ item.cam_from_object for item in read.objects}
            signs = {item.id: transform(pose, item.corners_cam) for item in read.traffic_elements}
            assert (read.camera.name, read.horizon is None) == (NUSCENES[camera].name, camera > 0)
            found.append((lanes, boxes, signs))
        (lanes, boxes, signs), *others = found
        for its_lanes, its_boxes, its_signs in others:
            assert (its_lanes.keys(), its_boxes.keys()) == (lanes.keys(), boxes.keys())
            assert max(np.abs(its_lanes[id_] - lanes[id_]).max() for id_ in lanes) < 0.001
            assert max(np.abs(its_boxes[id_] - boxes[id_]).max() for id_ in boxes) < 0.001
            for id_ in signs.keys() & its_signs.keys():  # some come within 200 m, or leave
                np.testing.assert_allclose(its_signs[id_], signs[id_], atol=0.001)
                n_signs += 1
    assert n_signs > 20


def test_the_scenes_of_a_rig_differ_in_camera_and_shot_alone():
    params, shots = load_params("appendix_i"), Shots(cameras=NUSCENES)
    alone = sample_scene(Scenes(params, 1, "train"), 4)
    for camera in range(6):
        scene = sample_scene(Scenes(params, 1, "train", shots=shots), 24 + camera)
        assert (scene.shot.camera, scene.shot.n_cameras, scene.shot.behind_m) == (camera, 6, MAX_BEHIND_M)
        assert scene.model_copy(update={"camera": alone.camera, "shot": alone.shot}) == alone
    assert Shots(cameras=NUSCENES[:1]).behind_m == 0, "no camera sees what is behind"


def test_cameras_of_a_file_are_own_ready_or_in_other_files(tmp_path):
    (tmp_path / "mine.yaml").write_text("width_px: 640\nheight_px: 480\nhorizontal_fov_deg: 90\n")
    (tmp_path / "rig.yaml").write_text(
        "left: {width_px: 320, height_px: 240, fx: 200, yaw_deg: 90 +- 2}\nfront: tusimple\nback.1: mine.yaml\n"
    )
    rig = load_rig(str(tmp_path / "rig.yaml"))
    assert [spec.name for spec in rig] == ["left", "front", "back.1"]
    assert (rig[0].yaw_deg.low, rig[0].yaw_deg.high) == (88, 92)
    assert rig[1].width_px.values == (1280,)
    assert rig[2].horizontal_fov_deg.values == (90,)


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("[1, 2]", ["expected 1 to 64 cameras by name, got [1, 2]"]),
        ("{}", ["expected 1 to 64 cameras by name, got {}"]),
        ("a: {width_px: 640}\nb: nowhere\n", ["a: height_px: missing", "b: nowhere: expected one of"]),
        ("a/b: tusimple\n", ["expected a camera's name of letters, digits, _ . and -, got 'a/b'"]),
    ],
)
def test_mistakes_in_a_rig_are_lines_that_name_the_camera(tmp_path, text, lines):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_rig(str(path))
    for line in lines:
        assert any(problem.startswith(f"{path}: ") and line in problem for problem in caught.value.problems)
    with pytest.raises(InputError, match=r"waymo: expected one of argoverse2, nuscenes, or the path of a \.yaml file"):
        load_rig("waymo")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two scenes by six cameras."""
    folder = tmp_path_factory.mktemp("rig") / "data"
    recipe = fake_samples.recipe(shots=Shots(cameras=NUSCENES))
    assert not generate(Plan(str(folder), 12, recipe, workers=1, maker=fake_samples.make), lambda event: None).problem
    return folder


def test_samples_of_some_cameras_are_found_by_their_names(data):
    reader = Reader(f"{data}/train", columns=())
    assert reader.taken_by().tolist() == [0, 6]
    assert reader.taken_by(["CAM_BACK", "CAM_FRONT_LEFT"]).tolist() == [3, 5, 9, 11]
    with pytest.raises(InputError, match=r"cameras: expected some of CAM_FRONT, CAM_FRONT_RIGHT, .*, got CAM_TOP"):
        reader.taken_by(["CAM_TOP"])


def test_training_and_exports_take_the_cameras_that_look_ahead(data):
    samples, _ = training_and_validation([str(data)], "train", "val", None)
    assert len(samples) == 2
    upright = UprightSamples(Reader(f"{data}/train", columns=("camera_roll_rad",)))
    assert [upright.key(i) for i in range(len(upright))] == ["00000000", "00000006"]
    assert [place for chunk in export_plan(str(data)) for place in chunk.places] == [0, 6]
    assert [place for chunk in export_plan(str(data), ["CAM_BACK"]) for place in chunk.places] == [3, 9]
    (everything,) = export_plan(str(data), takes_rigs=True)
    assert everything.places == tuple(range(12))


def test_a_single_picture_is_exported_by_whatever_camera_or_with_its_moment(data):
    assert export_plan(f"{data}/train:9")[0].places == (9,)
    assert export_plan(f"{data}/train:9", takes_rigs=True)[0].places == tuple(range(6, 12))
    assert export_plan(f"{data}/train:9", ["CAM_BACK"])[0].places == (9,)
    with pytest.raises(InputError, match="cameras: expected that of the sample, got CAM_FRONT for 00000009 by CAM_B"):
        export_plan(f"{data}/train:9", ["CAM_FRONT"])


def test_a_rig_that_only_looks_back_has_nothing_to_train_on(tmp_path):
    back = tuple(spec for spec in NUSCENES if spec.name.startswith("CAM_BACK"))
    recipe = fake_samples.recipe(shots=Shots(cameras=back))
    generate(Plan(str(tmp_path / "d"), 3, recipe, workers=1, maker=fake_samples.make), lambda event: None)
    with pytest.raises(InputError, match="expected a camera within 30 degrees of the driving direction, got none"):
        len(UprightSamples(Reader(f"{tmp_path}/d/train")))


def test_a_fisheye_that_is_turned_ahead_sees_what_is_beside_and_is_exported_without_its_name() -> None:
    sizes = {"width_px": 360, "height_px": 300, "fx_px": 115, "fy_px": 115, "cx_px": 180, "cy_px": 150, "height_m": 1.5}
    fisheye = CameraSpec.model_validate({**sizes, "model": "fisheye", "yaw_deg": 20})
    assert fisheye.is_turned_ahead
    assert not fisheye.looks_ahead
    aside = CameraSpec.model_validate({**sizes, "model": "fisheye", "yaw_deg": 60})
    assert not aside.is_turned_ahead
