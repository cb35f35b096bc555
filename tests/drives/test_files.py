"""The files of a drive: poses, 2D lanes, marks, points, drive.yaml; bad ones are named in a line."""

import io
import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.recorded.drives.checks import drive_findings
from synth3dlanes.recorded.drives.clouds import lzf, read_cloud
from synth3dlanes.recorded.drives.drive import MarkedLane
from synth3dlanes.recorded.drives.lines import read_lines_of
from synth3dlanes.recorded.drives.marks import marks_document, read_marks, read_review
from synth3dlanes.recorded.drives.open import open_drive
from synth3dlanes.recorded.drives.pages import top_view
from synth3dlanes.recorded.drives.poses import read_kitti_poses, read_pose_feather, read_pose_json, read_tum
from synth3dlanes.system.errors import FormatError, InputError
from tests.drives import road as made
from tests.hostile import damaged, files, mutated, refused_or_read

OURS_FROM_FLU = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


@pytest.fixture(scope="module")
def truth() -> made.Road:
    return made.road(5)


def test_every_form_of_poses_gives_the_same_track(tmp_path, truth):
    poses, times_s = truth.lidar_poses, np.arange(5) * 0.1
    xyzw = [made.quaternion(at[:3, :3]) for at in poses]
    rows = [[t, *at[:3, 3], *q] for t, at, q in zip(times_s, poses, xyzw, strict=True)]
    (tmp_path / "tum.txt").write_text("# a comment\n" + "\n".join(" ".join(map(repr, map(float, row))) for row in rows))
    (tmp_path / "kitti.txt").write_text("\n".join(made.words(at[:3]) for at in poses))
    names = ("timestamp_ns", "tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
    columns["timestamp_ns"] = [round(t * 1e9) for t in times_s]
    made.write_feather(tmp_path / "poses.feather", columns)
    ours = []
    for t, at in zip(times_s, poses, strict=True):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = at[:3, :3] @ OURS_FROM_FLU.T, at[:3, 3]
        ours.append({"time_s": t, "world_from_host": matrix.tolist()})
    (tmp_path / "ours.json").write_text(json.dumps({"format": "synth3dlanes.poses", "version": 1, "poses": ours}))

    expected = [pose["world_from_host"] for pose in ours]
    for track in (
        read_tum(tmp_path / "tum.txt", "flu"),
        read_pose_feather(tmp_path / "poses.feather"),
        read_pose_json(tmp_path / "ours.json"),
    ):
        assert np.abs(track.at(times_s) - expected).max() < 1e-9
    kitti = read_kitti_poses(tmp_path / "kitti.txt", times_s, "flu").at(times_s)
    assert np.abs(kitti - expected).max() < 1e-9
    # Of a camera that looks ahead: in a world with z up, and in the frame that the first camera had, whose y is down.
    cameras = poses @ np.block([[made.CAMERA_FLU.T, np.zeros((3, 1))], [0, 0, 0, 1]])
    for world in (np.eye(4), np.block([[made.CAMERA_FLU, np.zeros((3, 1))], [0, 0, 0, 1]])):
        (tmp_path / "camera.txt").write_text("\n".join(made.words((world @ at)[:3]) for at in cameras))
        found = read_kitti_poses(tmp_path / "camera.txt", times_s, "rdf").at(times_s)
        turned = np.eye(4) if world[2, 2] == 1 else made.pose(np.pi / 2, 0, 0, 0)
        assert np.abs(found - turned @ expected).max() < 1e-9


def test_between_poses_the_car_drives_straight_and_turns_evenly(tmp_path):
    (tmp_path / "p.txt").write_text("10 0 0 0 0 0 0 1\n10.5 4 2 0 0 0 0.70710678 0.70710678\n13 9 9 0 0 0 0 1\n")
    track = read_tum(tmp_path / "p.txt", "flu")
    pose = track.at(np.array([10.25]))[0]
    assert pose[:3, 3] == pytest.approx([2, 1, 0])
    assert pose[:3, 1] == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0]), "forward, half of a quarter turn to the left"
    known = track.knows(np.array([9.9, 9.99, 10.3, 10.51, 11.7, 12.99, 13.1]))
    assert known.tolist() == [False, True, True, True, False, True, False], "2.5 s apart is too far"


def test_every_form_of_2d_lanes_gives_the_same_lines(tmp_path):
    line = [[300.5, 700.0], [420.25, 500.0], [500.0, 400.0]]
    (tmp_path / "ours.json").write_text(
        json.dumps({"format": "synth3dlanes.lines", "version": 1, "images": {"clips/a/1.jpg": [line]}})
    )
    frame = {
        "raw_file": "clips/a/1.jpg",
        "h_samples": [300, 400, 500, 600, 700],
        "lanes": [[-2, 500, 420.25, -2, 300.5]],
    }
    other = frame | {"raw_file": "clips/b/1.jpg", "lanes": []}
    (tmp_path / "tusimple.json").write_text(f"{json.dumps(frame)}\n{json.dumps(other)}\n")
    image = tmp_path / "clips" / "a" / "1.jpg"
    image.parent.mkdir(parents=True)
    image.with_name("1.lines.txt").write_text("300.5 700 420.25 500 500 400\n5 5\n")
    for source in (tmp_path / "ours.json", tmp_path / "tusimple.json", tmp_path / "clips"):
        (found,) = read_lines_of(source).of(image)
        assert found.tolist() == line
        assert read_lines_of(source).of(tmp_path / "clips" / "c" / "9.jpg") == ()
    assert read_lines_of(tmp_path / "tusimple.json").names == ("clips/a/1.jpg", "clips/b/1.jpg")


def test_a_described_drive_has_its_lanes_and_marks(tmp_path, truth):
    drive = open_drive(str(made.write_described(tmp_path, truth) / "drive.yaml"))
    assert (drive.name, len(drive.frames), drive.camera.name) == ("monday", 5, "front")
    assert [line.tolist() for line in drive.frames[2].lanes_px] == made.lanes_px()
    (lane,) = drive.marked
    assert (lane.id, lane.color, lane.xy_world.tolist()) == ("marked1", "yellow", [[0, 1], [10, 5.5], [20, 10]])
    # The lanes of the level camera, cast on the ground, are the straight lanes beside the host.
    rays = drive.camera.lens.rays(drive.camera.img_from_cam, drive.frames[2].lanes_px[1])
    ground = rays * (-made.CAMERA_HEIGHT_M / rays[:, 2])[:, None]
    assert ground[:, 0] == pytest.approx(-made.LANES_M[1], abs=1e-6), "left is x < 0"
    assert drive.host_from_lidar[:3, 3] == pytest.approx([0, 0.5, 1.73])


def test_a_drive_of_lanes_without_images(tmp_path, truth):
    folder = made.write_described(tmp_path, truth)
    for path in (folder / "front").iterdir():
        path.unlink()
    drive = open_drive(str(folder))
    assert len(drive.frames) == 5
    assert drive.frames[1].load_image is None
    assert len(drive.frames[1].lanes_px) == 3


def test_an_image_that_a_link_has_lost_is_no_image_that_never_was(tmp_path, truth):
    folder = made.write_described(tmp_path, truth)
    (folder / "front/0001.png").unlink()
    (folder / "front/0001.png").symlink_to("nowhere")
    with pytest.raises(FormatError, match=r"0001\.png: cannot be read: No such file"):
        open_drive(str(folder)).frames[1].load_image()


def test_another_camera_than_the_only_one_is_refused(tmp_path, truth):
    folder = made.write_described(tmp_path, truth)
    assert open_drive(str(folder), camera="front").camera.name == "front"
    with pytest.raises(InputError, match=r"camera: expected front, which .* has, got left"):
        open_drive(str(folder), camera="left")


def test_lanes_of_other_images_are_refused(tmp_path, truth):
    folder = made.write_described(tmp_path, truth)
    (tmp_path / "of_none").mkdir()
    (tmp_path / "of_others.json").write_text((folder / "lanes.json").read_text().replace("front/", "rear/r"))
    for name in ("of_none", "of_others.json"):
        with pytest.raises(FormatError, match=f"{name}: expected lanes in the images of this drive, got none"):
            open_drive(str(folder), lanes=str(tmp_path / name))
    (tmp_path / "of_none/0001.lines.txt").write_text("300.5 700 420.25 500")
    (line,) = open_drive(str(folder), lanes=str(tmp_path / "of_none")).frames[1].lanes_px
    assert line.tolist() == [[300.5, 700], [420.25, 500]]


def test_texts_may_begin_with_a_byte_order_mark_and_have_lines_of_windows(tmp_path, truth):
    folder = made.write_described(tmp_path, truth)
    before = open_drive(str(folder))
    for name in ("drive.yaml", "camera.yaml", "poses.txt", "times.txt", "lanes.json", "lanes.geojson"):
        text = (folder / name).read_bytes()
        (folder / name).write_bytes(b"\xef\xbb\xbf" + text.replace(b"\n", b"\r\n"))
    after = open_drive(str(folder))
    assert [frame.time_s for frame in after.frames] == [frame.time_s for frame in before.frames]
    assert len(after.frames[2].lanes_px) == len(before.frames[2].lanes_px) == 3


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        (
            "drive.yaml",
            "axes: flu",
            "axes: ned",
            r"drive\.yaml: lidar\.axes: expected 'rfu', 'flu' or 'rdf', got 'ned'",
        ),
        ("drive.yaml", "files: lidar", "file: lidar", r"lidar\.files: missing"),
        ("drive.yaml", r"lidar/\*.npy", "nothing/*.npy", "expected 1 to .* scans, got none"),
        ("drive.yaml", r"lidar/\*.npy", "../*.npy", "expected a path below the folder"),
        ("drive.yaml", "camera: camera.yaml", "camera: kamera", "kamera"),
        ("drive.yaml", "poses.txt", "posen.txt", r"posen\.txt: cannot be read: No such file"),
        ("times.txt", r"0\.400\n", "", r"times\.txt: expected a time for each of 5 images, got 4"),
        ("times.txt", r"0\.200", "0.100", r"times of images that increase, got 0\.100000 s after 0\.100000 s"),
        ("camera.yaml", "width_px: 640", "width_px: 800", "expected the size of its camera, 800x400, got 640x400"),
        ("lanes.json", "version", "verson", "lanes"),
        ("lanes.geojson", "LineString", "Point", "LineString"),
        ("poses.txt", r"(?m)^0\.", "1000.", "expected poses around the frames of monday"),
    ],
)
def test_bad_files_of_a_described_drive_are_told(tmp_path, truth, name, old, new, message):
    folder = made.write_described(tmp_path, truth)
    text = (folder / name).read_text()
    assert re.search(old, text)
    (folder / name).write_text(re.sub(old, new, text))
    with pytest.raises((FormatError, InputError), match=message) as caught:
        open_drive(str(folder))
    assert len(str(caught.value).splitlines()) <= 3


def test_names_whose_numbers_are_in_another_order_are_refused(tmp_path, truth):
    """`times` go with names in their order: 10.png is before 3.png as text."""
    folder = made.write_described(tmp_path, truth)
    (folder / "drive.yaml").write_text(made.DRIVE_YAML.replace("lanes: lanes.json\n", ""))
    for number, name in enumerate(("0.1.png", "0.15.png", "0.2.png", "3.png", "10.png")):
        (folder / f"front/{number:04d}.png").rename(folder / f"front/{name}")
    with pytest.raises(FormatError, match=r"front: .*, got 10\.png before 3\.png: write numbers with leading zeros"):
        open_drive(str(folder))
    (folder / "front/10.png").rename(folder / "front/4.png")
    assert [frame.name for frame in open_drive(str(folder)).frames] == ["0.1", "0.15", "0.2", "3", "4"]


def test_marks_are_written_as_they_are_read(tmp_path):
    lanes = (
        MarkedLane("a", np.array([[0.0, 1.0], [5.125, 2.0]]), "centerline", "none", None, "oncoming"),
        MarkedLane("b", np.array([[1e6, 5e6], [1e6 + 0.001, 5e6]]), "delimiter", "dashed", "yellow"),
    )
    (tmp_path / "m.geojson").write_text(json.dumps(marks_document(lanes, "monday")))
    read = read_marks(tmp_path / "m.geojson")
    assert [vars(lane) | {"xy_world": lane.xy_world.tolist()} for lane in read] == [
        vars(lane) | {"xy_world": lane.xy_world.tolist()} for lane in lanes
    ]


def test_marks_of_another_program_are_read(tmp_path):
    deep, twice = [[0, 1, 9], [2, 3, 9]], [[0, 1], [0, 1], [2, 3]]
    features = [
        {"type": "Feature", "geometry": {"type": "LineString", "coordinates": points}, **rest}
        for points, rest in ((deep, {"id": 7, "properties": {"fid": 1}}), (twice, {"properties": None}))
    ]
    document = {"type": "FeatureCollection", "crs": {"type": "name"}, "features": features}
    (tmp_path / "m.geojson").write_text(json.dumps(document))
    assert [(lane.id, lane.xy_world.tolist()) for lane in read_marks(tmp_path / "m.geojson")] == [
        ("7", [[0, 1], [2, 3]]),
        ("marked2", [[0, 1], [2, 3]]),
    ]
    document["features"][1]["id"] = "7"
    (tmp_path / "m.geojson").write_text(json.dumps(document))
    with pytest.raises(FormatError, match="expected every id once, got 7 twice"):
        read_marks(tmp_path / "m.geojson")


LINES = json.dumps({"format": "synth3dlanes.lines", "version": 1, "images": {"1.jpg": [[[1, 2], [3, 4]]]}}).encode()
REVIEW = b'{"format": "synth3dlanes.review", "version": 1, "source": "d", "frames": {"1": "accepted"}}'
MARKS = json.dumps(marks_document([MarkedLane("a", np.array([[0.0, 1.0], [5.0, 2.0]]))], "monday")).encode()
READERS = {
    "lines.json": (LINES, read_lines_of),
    "review.json": (REVIEW, read_review),
    "marks.geojson": (MARKS, read_marks),
    "tum.txt": (b"1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", lambda path: read_tum(path, "flu")),
    "kitti.txt": (b"1 0 0 0 0 1 0 0 0 0 1 0\n" * 2, lambda path: read_kitti_poses(path, np.arange(2.0), "rdf")),
}


@pytest.mark.parametrize("source", ["nothing", "x.yaml", "", "a:b", "nothing/train:0"])
def test_what_is_no_drive_is_told_in_one_line(tmp_path, monkeypatch, source):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.yaml").write_text("{a: 1")
    with pytest.raises((InputError, FormatError)) as caught:
        open_drive(source)
    assert len(str(caught.value).splitlines()) == 1


@pytest.fixture(scope="module")
def drives(tmp_path_factory) -> dict[str, Path]:
    short = made.road(4)
    short.world = short.world[::20]
    return {name: write(tmp_path_factory.mktemp(name), short) for name, write in made.WRITERS.items()}


def parts(root: Path) -> list[Path]:
    """One file of each kind: of many scans and images the first."""
    found = sorted(path for path in root.rglob("*") if path.is_file())
    return list({(path.parent, path.suffix): path for path in reversed(found)}.values())


def read(folder: Path) -> None:
    drive = open_drive(str(folder))
    assert all(np.isfinite(frame.world_from_host).all() for frame in drive.frames)
    assert all("\n" not in line for line in drive_findings(drive))
    top_view(drive)


@pytest.mark.thorough
@files
@given(data=st.data(), name=st.sampled_from(list(made.WRITERS)))
def test_a_damaged_file_is_refused_or_read(drives, data, name):
    folder = drives[name]
    root = folder.parents[1] if name in ("sequence", "raw") else folder
    path = data.draw(st.sampled_from(parts(root)))
    good = path.read_bytes()
    try:
        path.write_bytes(data.draw(damaged(good)))
        refused_or_read(lambda: read(folder), str(root), "monday", "frames", error=(FormatError, InputError))
    finally:
        path.write_bytes(good)


RNG = np.random.default_rng(3)
XYZ = np.round(RNG.uniform(-50, 50, (300, 3)), 3).astype(np.float32)
SHARE = (RNG.integers(0, 256, 300) / 255).astype(np.float32)
HEADER = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
FIELDS = "FIELDS x y z _ intensity\nSIZE 4 4 4 1 1\nTYPE F F F U U\nCOUNT 1 1 1 4 1\n"
ORGANIZED = "WIDTH 100\nHEIGHT 3\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 300\n"
ROW = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("pad", "V4"), ("i", "u1")])


def rows() -> np.ndarray:
    found = np.zeros(300, ROW)
    for axis, values in zip("xyz", XYZ.T, strict=True):
        found[axis] = values
    found["i"] = np.round(SHARE * 255)
    return found


def compress(data: bytes) -> bytes:
    """An LZF stream, by its definition: copies where three bytes were seen before, else runs."""
    found, run, seen, at = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for start in range(0, len(run), 32):
            piece = run[start : start + 32]
            found.extend([len(piece) - 1, *piece])
        run.clear()

    while at < len(data):
        key = data[at : at + 3]
        back = at - seen.get(key, -10_000)
        seen[key] = at
        if len(key) == 3 and back <= 8192:
            length = 3
            while at + length < len(data) and length < 264 and data[at + length] == data[at - back + length]:
                length += 1
            flush()
            code, far = length - 2, back - 1
            head = [(code << 5) | (far >> 8)] if code < 7 else [(7 << 5) | (far >> 8), code - 7]
            found.extend([*head, far & 255])
            at += length
        else:
            run.append(data[at])
            at += 1
    flush()
    return bytes(found)


def pcd(kind: str) -> bytes:
    if kind == "ascii":
        text = (
            HEADER + "FIELDS x y z intensity\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 1\n" + ORGANIZED + "DATA ascii\n"
        )
        lines = (f"{x} {y} {z} {i}\n" for (x, y, z), i in zip(XYZ, rows()["i"], strict=True))
        return (text + "".join(lines)).encode()
    head = (HEADER + FIELDS + ORGANIZED + f"DATA {kind}\n").encode()
    if kind == "binary":
        return head + rows().tobytes()
    plain = b"".join(rows()[name].tobytes() for name in ROW.names)
    packed = compress(plain)
    return head + struct.pack("<II", len(packed), len(plain)) + packed


def npy(values: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


FILES = {
    "kitti.bin": lambda: np.column_stack([XYZ, SHARE]).astype("<f4").tobytes(),
    "rows.npy": lambda: npy(np.column_stack([XYZ, SHARE])),
    "columns.npy": lambda: npy(np.asfortranarray(np.column_stack([XYZ, SHARE]))),
    "fields.npy": lambda: npy(rows()[["x", "y", "z"]]),
    "ascii.pcd": lambda: pcd("ascii"),
    "binary.pcd": lambda: pcd("binary"),
    "compressed.pcd": lambda: pcd("binary_compressed"),
    "sweep.feather": lambda: made.feather(dict(zip("xyz", XYZ.T, strict=True)) | {"intensity": rows()["i"]}),
}


@pytest.mark.parametrize("name", FILES)
def test_every_kind_of_file_gives_the_same_points(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(FILES[name]())
    cloud = read_cloud(path)
    assert np.abs(cloud.xyz - XYZ).max() < 1e-5
    assert np.abs(cloud.intensity - (0 if name == "fields.npy" else SHARE)).max() < 1e-3


@given(data=st.binary(max_size=600), times=st.integers(1, 40))
def test_lzf_is_the_inverse_of_compression(data, times):
    plain = data * times
    assert lzf(compress(plain), len(plain), "x") == plain


def test_returns_without_a_place_are_left_out(tmp_path):
    points = np.array([[1, 2, 3, 0.5], [np.nan, 0, 0, 1], [0, 0, 0, 1], [np.inf, 1, 1, 1], [4, 5, 6, np.nan]], "<f4")
    (tmp_path / "a.bin").write_bytes(points.tobytes())
    cloud = read_cloud(tmp_path / "a.bin")
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert cloud.intensity.tolist() == [0.5, 0]


HUGE = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {kind}\n"
POSES = "expected lines of time, x, y, z, qx, qy, qz, qw, got none"
BAD = {
    "back.tum": (b"1 0 0 0 0 0 0 1\n0.5 0 0 0 0 0 0 1", r"got 0\.500000 s after 1\.000000 s \(pose 2\)"),
    "long.tum": (b"1 0 0 0 1 1 0 1", r"expected unit quaternions, got one of length 1\.732"),
    "nan.tum": (b"1 0 0 0 0 0 0 nan", "1: expected 8 numbers"),
    "none.tum": (b"", POSES),
    "a.bin": (b"12345", "expected four float32 for each point"),
    "b.las": (b"LASF", "expected a file of points"),
    "huge.pcd": (HUGE.format(n=10**11, kind="binary").encode(), "expected at most 8,388,608 points"),
    "bomb.pcd": (
        HUGE.format(n=10**6, kind="binary_compressed").encode()
        + struct.pack("<II", 9, 12 * 10**6)
        + b"\0a\xff\xff\0\xff\xff\0\0",
        "expected compressed points, got damaged bytes",
    ),
    "short.pcd": (HUGE.format(n=100, kind="binary").encode(), "expected 1,200 bytes of points, got 0"),
    "words.pcd": (HUGE.format(n=1, kind="ascii").encode() + b"1 2 x", "expected numbers, got other text"),
    "none.pcd": (b"\x00" * 100, "expected the header of a .pcd file"),
    "kind.pcd": (HUGE.format(n=1, kind="zipped").encode(), "DATA: expected ascii, binary or binary_compressed"),
    "axes.pcd": (HUGE.format(n=0, kind="binary").replace("x y z", "a b c").encode(), "expected fields x, y and z"),
    "object.npy": (npy(np.array([{}], dtype=object)), "expected the"),
    "flat.npy": (npy(np.arange(9.0)), "expected n rows of x, y, z"),
    "text.npy": (npy(np.array([["a", "b", "c"]])), "x: expected numbers"),
    "huge.npy": (
        npy(np.zeros((1, 4))).replace(b"(1, 4), }" + b" " * 12, b"(999999999999, 4), } "),
        "bytes of numbers that its header tells",
    ),
    "none.feather": (b"ARROW1\0\0" * 4, "expected a feather file"),
    "empty.npy": (b"", "expected an array of numpy"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_told_in_one_line(tmp_path, name):
    data, message = BAD[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FormatError, match=message) as caught:
        read_tum(tmp_path / name, "flu") if name.endswith("tum") else read_cloud(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert len(str(caught.value).splitlines()) == 1


@files
@given(data=st.data(), name=st.sampled_from([*READERS, *FILES]))
def test_damaged_files_are_refused_or_read(tmp_path, data, name):
    good, read = READERS[name] if name in READERS else (FILES[name](), read_cloud)
    path = tmp_path / name
    path.write_bytes(data.draw(mutated(good, name.endswith("json"))))
    found = refused_or_read(lambda: read(path), str(path), error=(FormatError, InputError))  # type: ignore[arg-type]
    if read is read_cloud and found is not None:
        assert np.isfinite(found.xyz).all()
        assert ((found.intensity >= 0) & (found.intensity <= 1)).all()
