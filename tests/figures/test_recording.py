"""Recordings for Rerun, read back by Rerun: their cameras see the lanes where the cameras of the labels do."""

import numpy as np
import pytest
import rerun as rr

from synth3dlanes.dataset.read import Reader
from synth3dlanes.figures.recording import sample_recording
from synth3dlanes.geometry.frames import transform
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.rig_files import load_rig
from synth3dlanes.params.shots import Shots
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.run import generate
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import InputError
from tests import fake_samples

RIG = """
left: {width_px: 160, height_px: 90, fx: 120, cx: 70, cy: 40, height_m: 1.5, yaw_deg: 20, pitch_deg: 3, roll_deg: 5}
wide: {width_px: 160, height_px: 90, fx: 120, model: opencv, k1: -0.2, k2: 0.02, height_m: 1.5}
"""


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """Two frames of a scene by a camera without a lens and one with a lens, and a lidar."""
    folder = tmp_path_factory.mktemp("recording")
    (folder / "rig.yaml").write_text(RIG)
    shots = Shots(frames=2, fps=2, cameras=load_rig(str(folder / "rig.yaml")), lidar=load_lidar("vlp_32c"))
    recipe = fake_samples.recipe(shots=shots, settings=RenderSettings(passes=("depth", "instance", "lidar")))
    plan = Plan(str(folder / "data"), 4, recipe, 1, maker=fake_samples.make_with_passes)
    assert not generate(plan, lambda event: None).problem
    return Reader(f"{folder}/data/train")


@pytest.fixture(scope="module")
def recording(reader, tmp_path_factory):
    path = tmp_path_factory.mktemp("rrd") / "clip.rrd"
    path.write_bytes(sample_recording(f"{reader.url}:00000002"))
    return rr.dataframe.load_recording(path)


def read(recording, entity, frame):
    """What an entity is at a frame: its values by component."""
    row = recording.view(index="time", contents=entity).select().read_all().to_pylist()[frame]
    return {name.rpartition(":")[2]: value for name, value in row.items() if name.startswith(entity)}


@pytest.mark.parametrize("frame", [0, 1])
def test_the_camera_sees_the_lanes_where_the_labels_say(reader, recording, frame):
    labels = reader.labels(2 * frame)
    camera = read(recording, "/world/cameras/left", frame)
    turn = np.reshape(camera["TransformMat3x3"], (3, 3)).T
    strips = read(recording, "/world/centerlines", frame)["LineStrip3D"]
    lanes = [lane for lane in labels.lanes if lane.kind == "centerline"]
    assert len(strips) == len(lanes) > 0
    for strip, lane in zip(strips, lanes, strict=True):
        points = (np.array(strip) - camera["Translation3D"]) @ turn
        ahead = points[:, 2] > 1
        # Rerun stores matrices column by column.
        uvw = points[ahead] @ np.reshape(camera["PinholeProjection"], (3, 3))
        expected = labels.camera.project(lane.xyz_cam)[ahead]
        np.testing.assert_allclose(uvw[:, :2] / uvw[:, 2:], expected, atol=0.01)


def test_boxes_stand_where_the_labels_say_and_keep_their_places_beside_the_lanes(reader, recording):
    labels = reader.labels(0)
    boxes = read(recording, "/world/objects", 0)
    corners = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    for at, item in enumerate(labels.objects):
        x, y, z, w = boxes["PoseRotationQuat"][at]
        sides, axis = corners * boxes["HalfSize3D"][at], np.array([x, y, z])
        turned = sides + 2 * np.cross(axis, np.cross(axis, sides) + w * sides)
        found = turned + boxes["PoseTranslation3D"][at]
        expected = transform(labels.camera.world_from_cam, item.corners_cam)
        gaps = np.linalg.norm(found[:, None] - expected, axis=-1).min(axis=0)
        assert gaps.max() < 1e-3, f"object {item.id} is {gaps.max():.3f} m off"


def test_a_lens_has_its_image_alone_and_the_lidar_all_its_points(reader, recording):
    entities = {column.entity_path for column in recording.schema().component_columns()}
    assert "/images/wide/image" in entities
    assert not any(name.startswith("/world/cameras/wide") for name in entities)
    assert len(read(recording, "/world/lidar", 1)["Position3D"]) == len(reader.lidar(2).points().range_m)


def test_of_several_views_of_a_scene_a_recording_has_the_one_asked_for(tmp_path):
    recipe = fake_samples.recipe(shots=Shots(views=2))
    plan = Plan(str(tmp_path / "data"), 2, recipe, 1, maker=fake_samples.make_labelled)
    assert not generate(plan, lambda event: None).problem
    reader, path = Reader(f"{tmp_path}/data/train"), tmp_path / "view.rrd"
    for i in range(2):
        path.write_bytes(sample_recording(f"{reader.url}:0000000{i}"))
        camera = read(rr.dataframe.load_recording(path), "/world/cameras/camera", 0)
        place = reader.labels(i).camera.world_from_cam[:3, 3]
        np.testing.assert_allclose(camera["Translation3D"][0], place, atol=1e-4)


def test_what_is_no_sample_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a sample of a data set"):
        sample_recording(str(tmp_path / "scene.json"))
