"""Argoverse 2: its files against the labels by the API's own formulas, and what its self-check finds."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from pyarrow import feather
from scipy.spatial.transform import Rotation

from synth3dlanes.dataset.read import Reader
from synth3dlanes.formats.argoverse2 import write as annotate
from synth3dlanes.formats.comparing_maps import goes_back, on_line
from synth3dlanes.formats.export import Export
from synth3dlanes.formats.lane_map import _is_against
from synth3dlanes.formats.verify import verify
from synth3dlanes.geometry.frames import transform
from synth3dlanes.geometry.polylines import thinned
from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels.labels import LidarLabel
from synth3dlanes.truth.ground_truth import ground_truth
from tests.formats.drives import frame_of, make_clips, problems_after
from tests.formats.planting import other, swapped_tracks
from tests.scenes import FLAT
from tests.thorough import first

TWO = ("ring_front_center", "ring_rear_left")


@pytest.fixture(scope="session")
def clips(tmp_path_factory):
    root = tmp_path_factory.mktemp("clips") / "data"
    make_clips(root, "argoverse2", TWO)
    return root


@pytest.fixture(scope="session")
def exported(clips, tmp_path_factory):
    job = Export(str(clips), tmp_path_factory.mktemp("argoverse2") / "out", "argoverse2")
    job.write()
    return job


def table(path):
    return feather.read_table(path).to_pylist()


def pose(row):
    """As the API makes it: a rotation and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat([row["qx"], row["qy"], row["qz"], row["qw"]]).as_matrix()
    matrix[:3, 3] = [row[key] for key in ("tx_m", "ty_m", "tz_m")]
    return matrix


def test_a_clip_is_a_log_that_its_self_check_finds_right(exported, clips):
    (result,) = verify(exported)
    assert result.problems == ()
    assert (result.name, result.n_frames) == ("test", 8)
    worst = {measure.unit: measure.worst for measure in result.measures}
    assert worst["px"] < 1e-3
    assert worst["m"] < 0.03
    out = exported.out
    assert (out / "val").readlink().name == "test"
    stamps = [int(path.stem) for path in out.glob("test/*/sensors/lidar/*.feather")]
    assert len({*stamps}) == 4, "tools name frames by timestamps alone"
    assert {len(str(stamp)) for stamp in stamps} == {19}
    for log in (out / "test").iterdir():
        assert len(table(log / "city_SE3_egovehicle.feather")) == 2
        first, second = sorted(int(path.stem) for path in log.glob("sensors/cameras/ring_front_center/*.jpg"))
        assert second - first == 500_000_000
        assert log.name in next(log.glob("map/log_map_archive_*.json")).name


def test_lanes_and_boxes_are_in_the_pixels_of_the_labels_by_the_apis_formulas(exported, clips):
    reader = Reader(f"{clips}/test")
    for index in range(8):
        labels, log = reader.labels(index), exported.out / "test" / f"{index // 4 * 4:09d}"
        name = labels.camera.name
        stamp = sorted(int(p.stem) for p in log.glob("sensors/lidar/*"))[index // 2 % 2]
        city_from_ego = pose(next(r for r in table(log / "city_SE3_egovehicle.feather") if r["timestamp_ns"] == stamp))
        sensors = {row["sensor_name"]: pose(row) for row in table(log / "calibration/egovehicle_SE3_sensor.feather")}
        lens = next(r for r in table(log / "calibration/intrinsics.feather") if r["sensor_name"] == name)
        cam_from_city = np.linalg.inv(city_from_ego @ sensors[name])
        assert 1.3 < sensors[name][2, 3] < 1.5, "cameras are on the roof, the rear axle is 0.3 m over the road"
        boxes = [row for row in table(log / "annotations.feather") if row["timestamp_ns"] == stamp]
        assert len(boxes) == len(labels.objects) == 4
        places = [transform(labels.camera.world_from_cam, lane.xyz_cam[lane.in_image]) for lane in labels.lanes]
        expected = [labels.camera.project(lane.xyz_cam[lane.in_image]) for lane in labels.lanes]
        for item, box in zip(labels.objects, boxes, strict=True):
            x, y, z = (box[key] / 2 for key in ("length_m", "width_m", "height_m"))
            front = transform(city_from_ego @ pose(box), np.array([[x, 0, -z], [x, y, z]]))
            places.append(front)
            lower, upper = item.corners_cam[2:4].mean(axis=0), item.corners_cam[0]
            expected.append(labels.camera.project(np.stack([lower, upper])))
        x, y, z = transform(cam_from_city, np.concatenate(places)).T
        uv = np.column_stack([lens["fx_px"] * x / z + lens["cx_px"], lens["fy_px"] * y / z + lens["cy_px"]])[z > 0]
        wanted = np.concatenate(expected)[z > 0] - 0.5
        assert np.abs(uv - wanted)[~np.isnan(wanted)].max(initial=0) < 0.05


def test_maps_have_links_neighbours_paint_and_crossings(exported):
    for path in exported.out.glob("test/*/map/log_map_archive_*.json"):
        document = json.loads(path.read_text())
        lanes = {lane["id"]: lane for lane in document["lane_segments"].values()}
        for lane in lanes.values():
            assert all(lane["id"] in lanes[other]["predecessors"] for other in lane["successors"])
            if lane["right_neighbor_id"] is not None:
                assert lanes[lane["right_neighbor_id"]]["left_neighbor_id"] // 1000 == lane["id"] // 1000
            left = np.array([[point["x"], point["y"]] for point in lane["left_lane_boundary"]])
            assert np.linalg.norm(np.diff(left, axis=0), axis=1).sum() < 36, (
                "30 m along the middle: the API cuts each in ten"
            )
        pairs = [
            (lane, lanes[lane["left_neighbor_id"]]) for lane in lanes.values() if lane["left_neighbor_id"] is not None
        ]
        across = [a for a, b in pairs if (b["left_neighbor_id"] or 0) // 1000 == a["id"] // 1000]
        assert len(across) >= 2, "lanes of both directions beside one line"
        assert {lane["left_lane_mark_type"] for lane in across} & {"NONE"} == set()
        assert any(lane["successors"] for lane in lanes.values())
        assert len(document["pedestrian_crossings"]) == 1
        assert 2 <= len(document["drivable_areas"]) <= 3


def test_a_single_frame_of_a_clip_has_its_map_too(clips, tmp_path):
    job = Export(f"{clips}/test:6", tmp_path / "one", "argoverse2")
    job.write()
    assert [problem for result in verify(job) for problem in result.problems] == []
    assert sorted(path.parent.name for path in job.out.glob("test/*/sensors/cameras/*/*.jpg")) == sorted(TWO)


def rows(path, change):
    """Other rows in the tables of the first log."""
    return other(f"test/*/{path}", change)


def each(**changes):
    """Rows with other values."""
    return lambda rows: [{**row, **{key: change(row) for key, change in changes.items()}} for row in rows]


def in_map(change):
    """Another map of the first log."""
    return other("test/*/map/log_map_archive_*.json", change)


def of_lanes(**changes):
    """Other values of every lane segment."""

    def change(document):
        for lane in document["lane_segments"].values():
            lane |= {key: made({**lane}) for key, made in changes.items()}

    return in_map(change)


def heights(change):
    """Other heights of the ground."""
    return other("test/*/map/*.npy", change)


def crossings(document):
    for crossing in document["pedestrian_crossings"].values():
        for point in (*crossing["edge1"], *crossing["edge2"]):
            point["y"] += 0.5


POSES, SENSORS = "city_SE3_egovehicle.feather", "calibration/egovehicle_SE3_sensor.feather"
LENSES, BOXES = "calibration/intrinsics.feather", "annotations.feather"
TURN = np.cos(np.radians(1)), np.sin(np.radians(1))
FAULTS = {
    "a vehicle 10 cm on": (rows(POSES, each(tx_m=lambda row: row["tx_m"] + 0.1)), "px off"),
    "vehicle from city": (rows(POSES, each(qx=lambda row: -row["qx"], qz=lambda row: -row["qz"])), "px off"),
    "cameras whose w is last": (
        rows(SENSORS, each(qw=lambda row: row["qx"], qx=lambda row: row["qw"])),
        "camera ring_front_center: expected it as in the labels",
    ),
    "pixels from the corner": (rows(LENSES, each(cx_px=lambda row: row["cx_px"] + 0.5)), "got it 0.5 px off"),
    "another size": (rows(LENSES, each(width_px=lambda row: 100)), "expected a size of"),
    "boxes 10 cm aside": (rows(BOXES, each(ty_m=lambda row: row["ty_m"] + 0.1)), "got it 0.1 m off"),
    "boxes turned by 2 degrees": (
        rows(BOXES, each(
            qw=lambda r: TURN[0] * r["qw"] - TURN[1] * r["qz"], qz=lambda r: TURN[0] * r["qz"] + TURN[1] * r["qw"],
            qx=lambda r: TURN[0] * r["qx"] - TURN[1] * r["qy"], qy=lambda r: TURN[0] * r["qy"] + TURN[1] * r["qx"],
        )),
        "m off",
    ),
    "length for width": (rows(BOXES, each(length_m=lambda r: r["width_m"], width_m=lambda r: r["length_m"])), "m off"),
    "another class": (rows(BOXES, each(category=lambda row: "PEDESTRIAN")), "got PEDESTRIAN"),
    "a box is missing": (rows(BOXES, lambda rows: rows[1:]), "got it in no row"),
    "points on a box": (rows(BOXES, each(num_interior_pts=lambda row: 7)), "expected the number of points 0, got 7"),
    "swapped tracks": (rows(BOXES, swapped_tracks("timestamp_ns", "track_uuid")), "as before, got object"),
    "no poses": (rows(POSES, lambda rows: []), "expected a pose at"),
    "sides": (
        of_lanes(
            left_lane_boundary=lambda lane: lane["right_lane_boundary"],
            right_lane_boundary=lambda lane: lane["left_lane_boundary"],
        ),
        "on that side, got -",
    ),
    "paint": (of_lanes(left_lane_mark_type=lambda lane: "SOLID_BLUE"), "is painted, got SOLID_BLUE"),
    "no links": (of_lanes(successors=lambda lane: []), "got none"),
    "no neighbours": (of_lanes(right_neighbor_id=lambda lane: None), "on its right, got None"),
    "crossings": (in_map(crossings), "pedestrian crossing: expected one on a crosswalk, got none nearer than 0.5"),
    "no areas": (in_map(lambda document: document.update(drivable_areas={})), "expected it in the drivable area, got"),
    "higher ground": (heights(lambda found: found + 1), "expected the ground at its height, got it 1 m away"),
    "ground turned about": (heights(lambda found: found[::-1]), "expected the ground at its height"),
}  # fmt: skip


# Of cameras, boxes and the map.
QUICK = ("cameras whose w is last", "boxes turned by 2 degrees", "crossings")


@pytest.mark.parametrize("name", first(len(QUICK), sorted(FAULTS, key=lambda name: name not in QUICK)))
def test_faults_are_found(exported, tmp_path, name):
    plant, words = FAULTS[name]
    found = problems_after(plant, exported, tmp_path)
    assert any(words in problem for problem in found), found


def test_points_of_a_sweep_are_in_the_vehicle_frame():
    labels = ground_truth(FLAT)
    # Straight ahead of a lidar 2 m over the road, in the middle of the host, and straight to its right.
    cam_from_lidar = np.linalg.inv(labels.camera.road_from_cam)
    cam_from_lidar[:3, 3] = transform(cam_from_lidar, np.array([0.0, 0.0, 2.0]))
    lidar = LidarLabel("", (0.0,), 16, 1.0, 100.0, cam_from_lidar)
    ranges = np.full((1, 16), np.inf, np.float32)
    ranges[0, [7, 8]] = 10
    ids = np.zeros((1, 16), np.uint8)
    sweep = Sweep(lidar, ranges, ids, ids.astype(np.uint16))
    written = annotate(frame_of(replace(labels, lidar=lidar), sweep=sweep))
    (name,) = (path for path in written.files if "/lidar/" in path)
    found = feather.read_table(io.BytesIO(written.files[name])).to_pydict()
    ahead, aside = 10 * np.cos(np.pi / 16), 10 * np.sin(np.pi / 16)
    np.testing.assert_allclose(found["x"], [1.3 + ahead] * 2, atol=1e-5)
    np.testing.assert_allclose(found["y"], [aside, -aside], atol=1e-5)
    np.testing.assert_allclose(found["z"], [1.7] * 2, atol=1e-5)


def test_a_boundary_has_the_paint_of_a_line_along_it_not_of_one_that_it_meets():
    s = np.linspace(0, 40, 200)
    boundary = np.column_stack([s, 0 * s, 0 * s])
    parting = np.column_stack([s, 0.1 * np.maximum(s - 4, 0) ** 2, 0 * s])
    assert len(on_line(boundary, parting)) < 25, "it is beside the first 4 m of 40, as where a turn lane opens"
    assert len(on_line(boundary, boundary + np.array([0, 0.02, 0]))) == 200
    assert len(on_line(boundary, boundary + np.array([0, 0.2, 0]))) == 0


@pytest.mark.parametrize("length_m", [0.03, 3.0, 30.0])
def test_a_boundary_goes_with_or_against_the_paint_that_it_runs_along(length_m):
    # A bend of 286 degrees; a section of a map may be a few centimetres long, and lie at the end of the paint.
    at = np.linspace(0, 5, 41)
    paint = 8.0 * np.column_stack([np.cos(at), np.sin(at), 0 * at])
    on = np.linspace(5 - length_m / 8.0, 5, 60)
    boundary = 8.0 * np.column_stack([np.cos(on), np.sin(on), 0 * on])
    for points, is_back in ((boundary, False), (boundary[::-1], True)):
        assert goes_back(points, paint) is is_back
        assert _is_against(paint[:, :2], points) is is_back


def test_thinned_lines_stay_within_the_limit():
    angle = np.linspace(0, 1, 400)
    lines = np.stack([np.column_stack([r * np.cos(angle), r * np.sin(angle), 0 * angle]) for r in (50, 53.5)], axis=1)
    kept = thinned(lines, 0.005)
    assert len(kept) < 100
    for side in (0, 1):
        radius = (50, 53.5)[side]
        middles = (kept[1:, side] + kept[:-1, side]) / 2
        assert np.abs(np.linalg.norm(middles, axis=1) - radius).max() <= 0.0051
