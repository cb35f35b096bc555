"""Rows trained alike, the learning curve, and scripts that measure what the documents report."""

import json

import numpy as np
import pytest
from synth3dlanes_baseline import checkpoint
from synth3dlanes_baseline.ablation import ablation, learning_curve
from synth3dlanes_baseline.curves import Pose
from synth3dlanes_baseline.data import img_from_cam
from synth3dlanes_baseline.lanes import Detection, Prediction

from scripts.error_sources import matched, unseen_part
from scripts.real_labels import HEIGHT_M, INTRINSICS, labels_on_plane
from synth3dlanes.formats.tusimple import ROWS_PX, TusimpleFrame
from synth3dlanes.geometry.frames import project
from synth3dlanes.system.errors import InputError
from tests.baseline import roads

SIZES = {"train": 4, "val": 2, "test": 3}
FEW = {"batch": 2, "epochs": 1.0, "device": "cpu"}


@pytest.fixture
def drawn_splits(behind_splits):
    behind_splits({name: roads.samples(np.random.default_rng(n), n, (160, 120)) for name, n in SIZES.items()})


def _steps(folder):
    return checkpoint.load(folder / "best.pt").about["step"]


@pytest.mark.thorough
def test_rows_stand_beside_the_papers_and_are_trained_once(drawn_splits, tmp_path):
    reports = ablation("d", tmp_path, "tiny", ("full", "top_view"), FEW)
    assert set(reports) == {"full", "flat_ground:plane", "flat_ground:horizon", "top_view"}
    table = (tmp_path / "table.txt").read_text()
    assert all(number in table for number in ("0.952", "0.929", "0.566"))
    assert set(json.loads((tmp_path / "table.json").read_text())) == set(reports)
    written = (tmp_path / "table.json").read_text()
    trained_at = (tmp_path / "full" / "best.pt").stat().st_mtime_ns
    ablation("d", tmp_path, "tiny", ("full", "top_view"), FEW)
    assert (tmp_path / "full" / "best.pt").stat().st_mtime_ns == trained_at
    assert (tmp_path / "table.json").read_text() == written


def test_sizes_of_the_learning_curve_train_for_equally_many_steps(drawn_splits, tmp_path):
    learning_curve("d", tmp_path, [2, 4], "tiny", FEW)
    assert _steps(tmp_path / "2") == _steps(tmp_path / "4") == 2
    assert (tmp_path / "curve.png").exists()
    with pytest.raises(InputError, match="d/train: expected at least 5 images, got 4"):
        learning_curve("d", tmp_path, [5], "tiny", FEW)


@pytest.mark.parametrize("pitch_deg", [2.5, 3.5, 4.5])
@pytest.mark.parametrize("bend", [0.0, 0.0004])
def test_lines_of_an_image_become_the_lanes_of_the_plane_that_makes_them_parallel(pitch_deg, bend):
    # Independent of the script: tangents of a camera that looks down, written out.
    pitch, (fx, fy, cx, cy) = np.radians(pitch_deg), INTRINSICS
    down = (ROWS_PX - cy) / fy
    y_m = HEIGHT_M * (np.cos(pitch) - down * np.sin(pitch)) / (down * np.cos(pitch) + np.sin(pitch))
    depth_m = y_m * np.cos(pitch) + HEIGHT_M * np.sin(pitch)
    x_m = np.array([-5.4, -1.8, 1.8, 5.4])[:, None] + bend * y_m**2
    u_px = np.rint(cx + fx * x_m / depth_m)
    u_px[:, (y_m < 0) | (y_m > 90)] = -2
    u_px[(u_px < 0) | (u_px >= 1280)] = -2
    labels = labels_on_plane(TusimpleFrame("frame", ROWS_PX, u_px))
    assert np.degrees(labels.camera.pitch_rad) == pytest.approx(pitch_deg, abs=0.1)
    assert len(labels.lanes) == 4
    for lane, columns_px in zip(labels.lanes, u_px, strict=True):
        uv_px = project(img_from_cam(INTRINSICS), lane.xyz_cam)
        assert uv_px[0, 1] > 720  # the lane begins below the image
        seen = columns_px >= 0
        found_px = np.interp(ROWS_PX[seen], uv_px[::-1, 1], uv_px[::-1, 0])
        inside = ROWS_PX[seen] > uv_px[-1, 1]
        assert np.abs(found_px - columns_px[seen])[inside].max() < 3.0


@pytest.mark.parametrize("share", [0.97, 1.02])
def test_an_error_of_scale_is_what_the_image_does_not_show(share):
    labels = roads.labels([lambda y_m, x_m=x_m: (x_m + 4e-4 * y_m**2, 1e-4 * y_m**2) for x_m in (0.0, 3.6)])
    lanes = tuple(Detection(lane.kind, 0.9, lane.xyz_cam * share) for lane in labels.lanes)
    pose = Pose(labels.camera.pitch_rad, labels.camera.height_m * share)
    errors, unseen = matched(labels, Prediction("a", lanes, pose))
    known = ~np.isnan(errors).any(-1)
    assert known.sum() > 50
    size_m = np.linalg.norm(errors, axis=-1)[known]
    shown_m = np.linalg.norm(errors - unseen_part(errors, unseen), axis=-1)[known]
    assert size_m.max() > 0.02
    assert shown_m.max() < 0.1 * size_m.max()
