"""Files of points: every kind gives the same points; damaged and hostile ones give one line."""

import io
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth3dlanes.recorded.drives.clouds import lzf, read_cloud
from synth3dlanes.system.errors import FormatError
from tests.drives.road import write_feather
from tests.hostile import damaged, files, refused_or_read

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


def feather(path, intensity: np.ndarray) -> None:
    write_feather(path, {**{axis: values for axis, values in zip("xyz", XYZ.T, strict=True)}, "intensity": intensity})


FILES = {
    "kitti.bin": lambda: np.column_stack([XYZ, SHARE]).astype("<f4").tobytes(),
    "rows.npy": lambda: npy(np.column_stack([XYZ, SHARE])),
    "columns.npy": lambda: npy(np.asfortranarray(np.column_stack([XYZ, SHARE]))),
    "fields.npy": lambda: npy(rows()[["x", "y", "z"]]),
    "ascii.pcd": lambda: pcd("ascii"),
    "binary.pcd": lambda: pcd("binary"),
    "compressed.pcd": lambda: pcd("binary_compressed"),
}


@pytest.mark.parametrize("name", [*FILES, "sweep.feather"])
def test_every_kind_of_file_gives_the_same_points(tmp_path, name):
    path = tmp_path / name
    if name == "sweep.feather":
        feather(path, np.round(SHARE * 255).astype(np.uint8))
    else:
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
BAD = {
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
        read_cloud(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert len(str(caught.value).splitlines()) == 1


def test_a_folder_a_pipe_and_nothing_are_no_files_of_points(tmp_path):
    (tmp_path / "a.bin").mkdir()
    for path in (tmp_path / "a.bin", tmp_path / "none.pcd"):
        with pytest.raises(FormatError, match=path.name):
            read_cloud(path)


@files
@given(data=st.data(), name=st.sampled_from([*FILES, "sweep.feather"]))
def test_damaged_files_are_refused_or_read(tmp_path, data, name):
    path = tmp_path / name
    if name == "sweep.feather":
        feather(path, SHARE)
        good = path.read_bytes()
    else:
        good = FILES[name]()
    path.write_bytes(data.draw(damaged(good)))
    cloud = refused_or_read(lambda: read_cloud(path), str(path))
    if cloud is not None:
        assert np.isfinite(cloud.xyz).all()
        assert ((cloud.intensity >= 0) & (cloud.intensity <= 1)).all()
