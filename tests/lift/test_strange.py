"""Strange drives are lifted, or end in one line that says what is wrong; a lift that is killed goes on."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.recorded.drives.drive import Drive, DriveFrame, MarkedLane
from synth3dlanes.recorded.drives.marks import marks_document
from synth3dlanes.recorded.drives.open import open_drive
from synth3dlanes.recorded.lift import tracks
from synth3dlanes.recorded.lift.path import path_of
from synth3dlanes.recorded.lift.precision import NO_ERROR
from synth3dlanes.recorded.lift.run import lifted_frames
from synth3dlanes.recorded.lift.write import lift_to
from synth3dlanes.system.errors import InputError
from tests.drives import road as made
from tests.lift import hill
from tests.power_cut import survive
from tests.thorough import first


def emptied(frame: DriveFrame) -> DriveFrame:
    def load():
        scan = frame.scan()
        return replace(scan, xyz_lidar=scan.xyz_lidar[:0], intensity=scan.intensity[:0])

    return replace(frame, load_scan=load)


def changed(change: Callable[[int, DriveFrame], DriveFrame]) -> Drive:
    drive = hill.drive(4)
    return replace(drive, frames=[change(number, frame) for number, frame in enumerate(drive.frames)])


FAR = np.pad([[3e5], [3e5]], ((0, 2), (3, 0)))
LIFTED = {
    "a scan without points": lambda n, frame: emptied(frame) if n == 1 else frame,
    "a frame without a scan": lambda n, frame: replace(frame, load_scan=None) if n == 2 else frame,
    "lines without length": lambda n, frame: replace(frame, lanes_px=(*frame.lanes_px, np.full((3, 2), 400.0))),
    "lines in the sky and outside": lambda n, frame: replace(
        frame, lanes_px=(*frame.lanes_px, np.array([[10.0, 5], [900, 40]]), np.array([[-4e4, 700.0], [9e4, 1e5]]))
    ),
}
REFUSED = {
    "no scan has points": (
        lambda n, frame: emptied(frame),
        "expected scans with points near the host's path, got none",
    ),
    "no scans": (lambda n, frame: replace(frame, load_scan=None), "expected scans with points"),
    "a pose is no number": (
        lambda n, frame: replace(frame, world_from_host=frame.world_from_host * np.nan) if n == 3 else frame,
        "poses: expected finite numbers",
    ),
    "the host stands": (lambda n, frame: replace(frame, world_from_host=hill.pose(0)), "expected a host that moves"),
    "a pose is far away": (
        lambda n, frame: replace(frame, world_from_host=hill.pose(0) + FAR) if n == 3 else frame,
        "expected",
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", LIFTED)
def test_a_strange_drive_is_lifted(name: str) -> None:
    found = list(lifted_frames(changed(LIFTED[name]), NO_ERROR))
    assert len(found) == 4
    assert all(len(one.labels.lanes) >= 3 for one in found[:2])


@pytest.mark.parametrize("name", REFUSED)
def test_a_drive_that_cannot_be_lifted_is_refused_in_one_line_and_leaves_no_sample(name: str, tmp_path: Path) -> None:
    change, message = REFUSED[name]
    with pytest.raises(InputError, match=message) as caught:
        lift_to(changed(change), tmp_path / "out", precision=NO_ERROR)
    assert len(str(caught.value).splitlines()) == 1
    assert str(caught.value).startswith("hill: ")
    assert not [path for path in tmp_path.glob("out/train/*") if path.suffix in (".tar", ".parquet")]


@pytest.mark.parametrize("n_cuts", first(1, [3, 20]))
def test_a_lift_comes_to_the_same_bytes_after_a_power_cut(tmp_path: Path, n_cuts: int) -> None:
    drive = hill.drive(3)
    survive(lambda out: lift_to(drive, out, precision=NO_ERROR), tmp_path, n_cuts)


def test_the_points_of_all_scans_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = hill.drive(6)
    path = path_of([frame.world_from_host for frame in drive.frames])
    whole = tracks.scans_along(drive, drive.frames, path)
    most = len(whole.scan) // 3
    monkeypatch.setattr(tracks, "MOST_POINTS", most)
    fewer = tracks.scans_along(drive, drive.frames, path)
    assert most / 2 < len(fewer.scan) <= most
    assert np.bincount(fewer.scan).min() > most / len(drive.frames) / 3, "of all scans"


def test_lanes_marked_in_a_drive_of_kitti_are_where_its_projection_matrix_has_them(tmp_path: Path) -> None:
    """From files in KITTI's raw layout to labels: the pixels of lines on a level road, by P2 and the calibration."""
    truth = made.road(n=12, turn=0.0)
    folder = made.write_raw(tmp_path, truth)
    along, aside = np.arange(0.0, 40.0, 0.5), {"left": 1.75, "right": -1.75}
    c, s = np.cos(0.4), np.sin(0.4)
    lines = {name: np.column_stack([along * c - off * s, along * s + off * c]) for name, off in aside.items()}
    origin = (truth.lidar_poses[0] @ made.VELO_FROM_IMU)[:2, 3]
    marks = tmp_path / "marks.geojson"
    marks.write_text(json.dumps(marks_document([MarkedLane(name, xy - origin) for name, xy in lines.items()], "kitti")))
    drive = open_drive(str(folder), marked=str(marks))
    lift_to(drive, tmp_path / "out", precision=NO_ERROR)
    reader, checked = Reader(f"{tmp_path}/out/train"), 0
    for i in (0, 4):
        labels = reader.labels(i)
        img_from_world = made.P2 @ made.CAM_FROM_VELO @ np.linalg.inv(truth.lidar_poses[i])
        for lane in labels.lanes:
            if lane.kind != "delimiter":
                continue
            xy = lines[lane.id]
            places = np.column_stack([xy, np.zeros(len(xy)), np.ones(len(xy))]) @ img_from_world.T
            ahead = places[:, 2] > 4
            expected = places[ahead, :2] / places[ahead, 2:] + 0.5
            found = labels.camera.project(lane.xyz_cam[lane.in_image & (lane.xyz_cam[:, 1] > 8)])
            u = np.interp(found[:, 1], expected[::-1, 1], expected[::-1, 0])
            assert np.abs(u - found[:, 0]).max() < 3
            checked += len(found)
    assert checked > 40


def test_a_lift_that_is_killed_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    drive = hill.drive(4)

    def killed(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        lift_to(drive, tmp_path / "killed", precision=NO_ERROR, progress=killed)
    assert not list((tmp_path / "killed/train").glob("*.tar"))
    for out in ("killed", "whole"):
        lift_to(drive, tmp_path / out, precision=NO_ERROR)
    tars = [(tmp_path / out / "train/00000.tar").read_bytes() for out in ("killed", "whole")]
    assert tars[0] == tars[1]
