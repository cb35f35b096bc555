"""Lifting a drive over a hill in closed form: ground, lines of sight, lanes, and what is said of them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from synth3dlanes.geometry.frames import transform
from synth3dlanes.recorded.drives.drive import Drive
from synth3dlanes.recorded.lift import tracks as lifted_tracks
from synth3dlanes.recorded.lift.cast import cast, seen_over
from synth3dlanes.recorded.lift.curves import SeenLine, smooth
from synth3dlanes.recorded.lift.ground import GroundMap, fit_ground
from synth3dlanes.recorded.lift.path import path_of
from synth3dlanes.recorded.lift.precision import NO_ERROR, Precision
from synth3dlanes.recorded.lift.run import lifted_frames
from synth3dlanes.recorded.lift.tracks import Track, scans_along, unplaced
from synth3dlanes.system.errors import InputError
from tests.lift import hill


@pytest.fixture(scope="module")
def drive() -> Drive:
    return hill.drive()


@pytest.fixture(scope="module")
def ground(drive: Drive) -> GroundMap:
    return ground_of(drive)


def ground_of(drive: Drive) -> GroundMap:
    frames = list(drive.frames)
    path = path_of([frame.world_from_host for frame in frames])
    return fit_ground(scans_along(drive, frames, path), path, NO_ERROR)


def off_road(ground: GroundMap, y: np.ndarray) -> np.ndarray:
    """How far the ground is from the hill at three lanes of these y."""
    xy = np.concatenate([np.column_stack([hill.aside(y) + off, y]) for off in hill.LANES_M])
    return ground.at(xy)[0] - hill.height(xy)


def test_the_ground_is_that_of_the_hill(ground: GroundMap) -> None:
    off = off_road(ground, np.arange(2.0, 45.0, 0.7))
    assert np.isfinite(off).all()
    assert np.quantile(np.abs(off), 0.95) < 0.005
    assert np.abs(off).max() < 0.02


def test_there_is_no_ground_that_nothing_has_seen(drive: Drive, ground: GroundMap) -> None:
    assert np.isnan(ground.at(np.array([[0.0, 300.0], [500.0, 0.0]]))[0]).all()

    def holed(frame):
        def load():
            scan = frame.scan()
            places = transform(frame.world_from_host @ drive.host_from_lidar, scan.xyz_lidar)
            inside = (np.abs(places[:, 0] - 1) < 4) & (np.abs(places[:, 1] - 30) < 4)
            return replace(scan, xyz_lidar=scan.xyz_lidar[~inside], intensity=scan.intensity[~inside])

        return replace(frame, load_scan=load)

    found = ground_of(replace(drive, frames=[holed(frame) for frame in drive.frames]))
    assert np.isnan(found.at(np.array([[1.0, 30.0]]))[0]).all()
    assert np.isfinite(found.at(np.array([[1.0, 20.0], [1.0, 40.0]]))[0]).all()


def test_cars_that_stand_and_drive_are_no_ground() -> None:
    def cars(number: int) -> np.ndarray:
        return np.concatenate([hill.box(3.5, 25.0), hill.box(-3.5, 15.0 + 3 * number)])

    off = off_road(ground_of(hill.drive(things=cars)), np.arange(5.0, 50.0, 0.5))
    assert np.nanmax(np.abs(off)) < 0.03


def test_lines_of_sight_meet_the_ground_where_they_meet_the_hill(ground: GroundMap) -> None:
    eye = hill.pose(2)[:3, 3] + [0, 0, hill.CAMERA_M]
    targets = np.concatenate([line[30:110:4] for line in hill.lanes_world()])
    rays = (targets - eye) / np.linalg.norm(targets - eye, axis=1)[:, None]
    expected, found = hill.met(eye, rays), cast(ground, eye, rays).xyz_world
    known = np.isfinite(found[:, 0]) & np.isfinite(expected[:, 0])
    assert known.sum() > 0.8 * len(rays)
    assert np.quantile(np.linalg.norm(found - expected, axis=1)[known], 0.9) < 0.05


def test_the_crest_hides_what_is_behind_it(ground: GroundMap) -> None:
    low = hill.pose(0)[:3, 3] + [0, 0, 0.6]
    points = np.array([[hill.aside(y), y, 0.0] for y in np.arange(4.0, 90.0, 2.0)])
    points[:, 2] = hill.height(points[:, :2])
    expected, found = hill.seen(low, points), seen_over(ground, low, points)
    assert expected[:10].all()
    assert not expected[-5:].any()
    assert (expected == found).mean() > 0.9


@pytest.fixture(scope="module")
def lifted(drive: Drive) -> list:
    return list(lifted_frames(drive, NO_ERROR))


def offsets(labels) -> np.ndarray:
    """Of all visible points of delimiters up to 40 m: how far from the nearest delimiter, and from the hill."""
    rows = []
    for lane in labels.lanes:
        near = lane.visible & (lane.xyz_cam[:, 1] < 40)
        points = transform(labels.camera.world_from_cam, lane.xyz_cam[near])
        if lane.kind == "delimiter":
            across = np.abs(points[:, 0] - hill.aside(points[:, 1]) - np.array(hill.LANES_M)[:, None]).min(axis=0)
            rows.append(np.column_stack([across, np.abs(points[:, 2] - hill.height(points[:, :2]))]))
    return np.concatenate(rows)


def test_lanes_are_where_they_are(lifted: list) -> None:
    off = np.concatenate([offsets(found.labels) for found in lifted])
    assert len(off) > 500
    across, up = np.quantile(off, 0.95, axis=0)
    assert across < 0.03
    assert up < 0.02
    # On the crest the plane that touches the ground is a little below it.
    heights_m = [found.labels.camera.height_m for found in lifted[1:5]]
    np.testing.assert_allclose(heights_m, hill.CAMERA_M, atol=0.05)


def test_three_lines_bound_two_lanes_with_the_same_names_in_every_frame(lifted: list) -> None:
    for found in lifted[:8]:
        kinds = {lane.id: lane for lane in found.labels.lanes}
        centres = [lane for lane in kinds.values() if lane.kind == "centerline"]
        assert (len(centres), len(kinds)) == (2, 5)
        for centre in centres:
            assert kinds[centre.left].right == centre.id == kinds[centre.right].left
            assert np.median(kinds[centre.left].xyz_cam[:, 0]) < np.median(kinds[centre.right].xyz_cam[:, 0])
    assert len({frozenset(lane.id for lane in found.labels.lanes) for found in lifted[:8]}) == 1


def test_names_last_from_stretch_to_stretch() -> None:
    found = list(lifted_frames(hill.drive(14), NO_ERROR, around=3))
    for before, after in pairwise(found):
        for lane in before.labels.lanes:
            same = [other for other in after.labels.lanes if other.id == lane.id]
            if lane.kind == "delimiter" and same:
                ours, theirs = (
                    transform(labels.camera.world_from_cam, line.xyz_cam)
                    for labels, line in ((before.labels, lane), (after.labels, same[0]))
                )
                aside = [np.median(line[:, 0] - hill.aside(line[:, 1])) for line in (ours, theirs)]
                assert abs(aside[0] - aside[1]) < 0.3
    assert found[6].labels.lanes
    assert found[6].stretch is not found[5].stretch


def test_a_mirrored_world_is_told_from_the_lanes(drive: Drive) -> None:
    """Scans of a mirrored lidar lie where no lane and no ground fits."""
    flipped = replace(drive, host_from_lidar=drive.host_from_lidar @ np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(InputError, match="expected"):
        list(lifted_frames(flipped, NO_ERROR))


def test_noisy_poses_make_lanes_less_certain(lifted: list) -> None:
    rng = np.random.default_rng(1)

    def shaken(pose: np.ndarray) -> np.ndarray:
        moved = pose.copy()
        moved[:3, 3] += 0.03 * rng.standard_normal(3)
        return moved

    poses = [shaken(hill.pose(number)) for number in range(12)]
    numbers = {tuple(hill.pose(number)[:3, 3]): number for number in range(12)}
    noisy = hill.drive(wrong=lambda pose: poses[numbers[tuple(pose[:3, 3])]])
    worse = [found.labels for found in lifted_frames(noisy, replace(NO_ERROR, pose_m=0.03))]
    before = np.median(np.concatenate([lane.std_m for found in lifted for lane in found.labels.lanes]))
    after = np.median(np.concatenate([lane.std_m for labels in worse for lane in labels.lanes]))
    assert after > 3 * before


def test_standard_deviations_hold() -> None:
    """Lines of 20 pictures around a known curve, each off by known amounts: as a whole, and every four metres."""
    inside, total = 0, 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        lines = []
        for picture in range(20):
            s = np.arange(2.0 * picture, 2.0 * picture + 50)
            grown = 0.002 * (s - s[0] + 5)
            sight_m = np.column_stack([np.ones(len(s)), np.zeros(len(s))])
            shifts = np.column_stack([grown, np.zeros(len(s)), np.zeros(len(s))])
            own = np.repeat(rng.standard_normal(13), 4)[: len(s)] * 0.5 * grown
            off = rng.standard_normal() * grown + own
            truth = 1.75 + 0.5 * np.sin(s / 40)
            lines.append(SeenLine(s, truth + off, sight_m, 0.5 * grown, shifts, picture))
        found = smooth(lines)
        off = np.abs(found.d - 1.75 - 0.5 * np.sin(found.s / 40))
        inside, total = inside + (off < found.std).sum(), total + len(off)
    assert 0.6 < inside / total < 0.97


def test_a_wrong_precision_is_told() -> None:
    with pytest.raises(InputError, match=r"precision: expected numbers from 0 to 1000 for lanes_px, .*, got pose=1"):
        Precision.of({"pose": 1.0})


S = np.arange(0.0, 120.0)


def track(name: str, d: np.ndarray) -> Track:
    return Track(name, S, d, unplaced(len(S)), np.full((len(S), 1), 0.02))


@pytest.mark.parametrize(("narrow_m", "has_second"), [(6.0, False), (30.0, True)])
def test_a_centre_line_is_where_a_lane_is_not_where_lines_meet(narrow_m: float, has_second: bool) -> None:
    """The right line of a lane leaves after 60 m, and comes near again for some metres."""
    apart = np.where(S < 60, 3.5, 8.0)
    apart[(S >= 90) & (90 + narrow_m > S)] = 4.0
    found = lifted_tracks._between(track("line_0", np.zeros(len(S))), track("line_1", apart), ())
    assert found is not None
    np.testing.assert_allclose(found.d, np.where(found.s < 60, 1.75, 2.0))
    assert found.s[0] == 0
    assert bool((found.s >= 90).any()) == has_second
    assert (np.diff(found.s) == 1).sum() == len(found.s) - 1 - has_second
