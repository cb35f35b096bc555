"""Drives in KITTI's and Argoverse 2's layouts, written by `road` from the formats' definitions, against the truth."""

import numpy as np
import pyarrow as pa
import pytest

from synth3dlanes.geometry.frames import invert, transform
from synth3dlanes.recorded.drives.drive import Drive
from synth3dlanes.recorded.drives.open import open_drive
from synth3dlanes.system.errors import FormatError
from tests.drives import road as made

FLU_FROM_OURS = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])


def check_points(drive: Drive, truth: made.Road, local_from_lidar: np.ndarray, off_m: float) -> None:
    """Every scan, moved by the drive's poses into the lidar's frame at the first one, is where the truth says."""
    first = drive.frames[0].scan()
    assert first is not None
    lidar_from_world = invert(first.world_from_host @ drive.host_from_lidar)
    for number, frame in enumerate(drive.frames):
        scan = frame.scan()
        assert scan is not None
        found = transform(lidar_from_world @ scan.world_from_host @ drive.host_from_lidar, scan.xyz_lidar)
        seen = truth.seen(number)[:, :3].astype(float)
        at = np.linalg.inv(truth.lidar_poses[0]) @ truth.lidar_poses[number]
        expected = seen @ at[:3, :3].T + at[:3, 3]
        expected = expected @ local_from_lidar[:3, :3].T + local_from_lidar[:3, 3]
        assert np.abs(found @ FLU_FROM_OURS.T - expected).max() < off_m, number


def check_pixels(drive: Drive, img_from_lidar: np.ndarray, truth: made.Road, lidar_from_local: np.ndarray) -> None:
    """What the lidar sees is where the camera's projection matrix has it, half a pixel from our corner."""
    scan = drive.frames[0].scan()
    assert scan is not None
    cam_from_lidar = invert(drive.camera.host_from_cam) @ drive.host_from_lidar
    found = drive.camera.lens.project(drive.camera.img_from_cam, transform(cam_from_lidar, scan.xyz_lidar))
    seen = truth.seen(0)[:, :3].astype(float)
    homogeneous = np.column_stack([seen, np.ones(len(seen))]) @ img_from_lidar.T
    ahead = homogeneous[:, 2] > 1
    expected = homogeneous[ahead, :2] / homogeneous[ahead, 2:] + 0.5
    assert ahead.sum() > 100
    assert np.abs(found[ahead] - expected).max() < 0.01


@pytest.fixture(scope="module")
def truth() -> made.Road:
    return made.road()


def test_a_sequence_of_kitti_odometry(tmp_path, truth):
    drive = open_drive(str(made.write_sequence(tmp_path, truth)))
    assert len(drive.frames) == len(truth.lidar_poses)
    assert (drive.camera.width_px, drive.camera.height_px) == made.SIZE
    check_points(drive, truth, np.eye(4), 1e-4)
    check_pixels(drive, made.P2 @ made.CAM_FROM_VELO, truth, np.eye(4))
    assert drive.frames[3].time_s == pytest.approx(0.3)
    assert drive.frames[3].load_image is not None
    assert drive.frames[3].load_image().startswith(b"\x89PNG")
    assert drive.frames[0].scan().intensity == pytest.approx(0.25)


def test_kitti_raw_data_have_an_east_north_world(tmp_path, truth):
    drive = open_drive(str(made.write_raw(tmp_path, truth)))
    check_points(drive, truth, np.eye(4), 5e-3)
    check_pixels(drive, made.P2 @ made.CAM_FROM_VELO, truth, np.eye(4))
    forward = drive.frames[0].world_from_host[:2, 1]
    assert forward == pytest.approx([np.cos(0.4), np.sin(0.4)], abs=1e-6), "turned left from east by 0.4"
    moved = drive.frames[-1].world_from_host[:3, 3] - drive.frames[0].world_from_host[:3, 3]
    assert moved == pytest.approx(truth.lidar_poses[-1][:3, 3] - truth.lidar_poses[0][:3, 3], abs=5e-3)


def test_the_cars_motion_within_a_turn_is_undone(tmp_path, truth):
    """64 steps of a turn leave 2 cm of 70."""
    drive = open_drive(str(made.write_raw(tmp_path, truth, is_twisted=True)))
    seen = made.twisted(truth.seen(5), truth.lidar_poses, 5)[:, :3]
    found = drive.frames[5].scan().xyz_lidar @ FLU_FROM_OURS.T
    expected = truth.seen(5)[:, :3]
    assert np.abs(seen - expected).max() > 0.3
    # Of what is straight behind, it is not known at which end of the turn it was seen.
    beside = np.abs(expected[:, 1]) > 1
    assert np.abs(found - expected)[beside].max() < 0.02


def test_a_log_of_argoverse_2(tmp_path, truth):
    drive = open_drive(str(made.write_argoverse(tmp_path, truth)))
    assert len(drive.frames) == len(truth.lidar_poses)
    assert drive.origin_m == tuple(
        np.round(made.CITY_M + (truth.lidar_poses[0] @ np.linalg.inv(made.EGO_FROM_LIDAR))[:3, 3])
    )
    check_points(drive, truth, np.eye(4), 0.03)
    assert drive.host_from_lidar[:3, 3] == pytest.approx([0, 1.35, 1.35])
    scan = drive.frames[4].scan()
    assert scan.intensity == pytest.approx(0.2)
    # A frame is at its image's time, 7 ms after its scan.
    assert drive.frames[4].time_s - scan.time_s == pytest.approx(0.007, abs=1e-6)
    apart = drive.frames[4].world_from_host[:3, 3] - scan.world_from_host[:3, 3]
    assert np.linalg.norm(apart) == pytest.approx(0.007 * made.SPEED_M_S, rel=0.05)
    # The camera looks ahead from 1.43 m over the rear axle.
    assert drive.camera.host_from_cam[:3, 3] == pytest.approx([0, 1.63, 1.43], abs=1e-6)
    assert drive.camera.host_from_cam[:3, 1] == pytest.approx([-0.02, 1, -0.01], abs=1e-3)


def test_a_drive_of_any_length_is_read_frame_by_frame(tmp_path, truth):
    """Only the files of the frame that is asked for are read: the others may be damaged."""
    sequence = made.write_sequence(tmp_path, truth)
    for path in sorted((sequence / "velodyne").iterdir())[1:]:
        path.write_bytes(b"damaged")
    frames = open_drive(str(sequence)).frames
    assert len(frames[0].scan().xyz_lidar) > 1000
    with pytest.raises(FormatError, match=r"000004\.bin: expected four float32 for each point"):
        frames[4].scan()
    assert [frame.name for frame in frames[2:4]] == ["000002", "000003"]
    with pytest.raises(IndexError, match=r"expected a frame in 0\.\.7, got 8"):
        frames[8]


def without_line(number: int):
    return lambda text: "".join(line for at, line in enumerate(text.splitlines(True)) if at != number)


def times(factors: np.ndarray):
    """Each row of numbers, times these."""
    return lambda text: "\n".join(made.words(np.array(line.split(), float) * factors) for line in text.splitlines())


FAULTS = {
    "a pose is missing": ("poses/07.txt", without_line(3), r"07\.txt: expected a pose for each of 8 times, got 7"),
    "times go back": (
        "sequences/07/times.txt",
        lambda text: "\n".join([*text.split()[:5], *text.split()[2:5]]),
        r"expected times of images that increase, got",
    ),
    "a time is missing": ("sequences/07/times.txt", without_line(7), r"000007\.png: expected the number of one of 7"),
    "an axis is mirrored": (
        "poses/07.txt",
        times(np.repeat([-1, 1], [4, 8])),
        r"07\.txt:1: expected a rotation, got a mirror: one axis points the other way",
    ),
    "a pose is scaled": (
        "poses/07.txt",
        times(np.full(12, 1000)),
        r"expected a rotation, got a matrix that is none \(its scale is 1000\)",
    ),
    "a pose is no number": ("poses/07.txt", lambda text: text.replace("e", "x", 1), r"07\.txt:1: expected 12 numbers"),
    "calibration has no Tr": (
        "sequences/07/calib.txt",
        without_line(4),
        r"Tr_velo_to_cam: expected 12 numbers, got no",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_a_sequence_is_named_in_one_line(tmp_path, truth, fault):
    made.write_sequence(tmp_path, truth)
    name, change, message = FAULTS[fault]
    (tmp_path / name).write_text(change((tmp_path / name).read_text()))
    with pytest.raises(FormatError, match=message) as caught:
        open_drive(str(tmp_path / "sequences" / "07"))
    assert len(str(caught.value).splitlines()) == 1


def test_another_camera_or_size_of_images_than_the_calibration_has(tmp_path, truth):
    drive = made.write_raw(tmp_path, truth)
    made.image(drive / "image_02" / "data" / "0000000000.png", (1392, 512))
    with pytest.raises(FormatError, match="expected the size of its calibration, 1242x375, got 1392x512"):
        open_drive(str(drive))
    log = str(made.write_argoverse(tmp_path, truth))
    with pytest.raises(FormatError, match="expected the sensor ring_rear_left, got ring_front_center"):
        open_drive(log, camera="ring_rear_left")


def test_frames_without_a_pose_are_left_out_and_told(tmp_path, truth):
    log = made.write_argoverse(tmp_path, truth)
    path = log / "city_SE3_egovehicle.feather"
    poses = pa.ipc.open_file(path.read_bytes()).read_all().to_pydict()
    made.write_feather(path, {name: values[:30] for name, values in poses.items()})
    drive = open_drive(str(log))
    assert len(drive.frames) == 6
    assert "2 of 8 frames left out" in drive.notes[0]
    made.write_feather(path, poses | {"timestamp_ns": [time + 10**12 for time in poses["timestamp_ns"]]})
    with pytest.raises(
        FormatError, match=r"city_SE3_egovehicle\.feather: expected poses around the frames of .* s, got"
    ):
        open_drive(str(log))
