"""Files of lidar points: KITTI's .bin, numpy's .npy, PCL's .pcd, and feather. numpy and pyarrow alone.

PCL's, versions 0.6 and 0.7, are text, binary, or compressed: two numbers (bytes compressed, bytes plain; uint32) and an
LZF stream, of one field after the other. https://pcl.readthedocs.io/projects/tutorials/en/latest/pcd_file_format.html
"""

import io
from pathlib import Path
from tokenize import TokenError
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

from synth3dlanes.formats.reading import read_file
from synth3dlanes.recorded.drives.tables import numeric, read_feather
from synth3dlanes.system.arrays import Points3, Scalars
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import shown

MAX_HEADER_BYTES, MAX_FIELDS, MAX_COUNT = 1 << 16, 64, 4096
KINDS = {"F": ("f", (4, 8)), "I": ("i", (1, 2, 4, 8)), "U": ("u", (1, 2, 4, 8))}
# The shortest references of an LZF stream copy three bytes.
SHORTEST_COPY = 3


def read_pcd(data: bytes, where: str, max_points: int) -> dict[str, Shaped[np.ndarray, " n"]]:
    """The fields of one number of a cloud, by their names in lower case; raise FormatError, whose message begins with
    `where`."""
    header, kind, body = _header(data, where)
    dtype = _dtype(header, where)
    n = _count(header, where)
    if n > max_points:
        raise FormatError(f"{where}: expected at most {max_points:,} points, got {n:,}")
    if kind == "ascii":
        return _of_text(body, dtype, n, where)
    if kind == "binary_compressed":
        return _of_compressed(body, dtype, n, where)
    if len(body) < n * dtype.itemsize:
        raise FormatError(f"{where}: expected {n * dtype.itemsize:,} bytes of points, got {len(body):,}")
    rows = np.frombuffer(body[: n * dtype.itemsize], dtype)
    return {name: rows[name] for name in _names(dtype)}


def _header(data: bytes, where: str) -> tuple[dict[str, list[str]], str, bytes]:
    """The words of each line of the header by the first one, the kind of data, and what follows."""
    stream = io.BytesIO(data)
    header: dict[str, list[str]] = {}
    while stream.tell() < MAX_HEADER_BYTES and (line := stream.readline(MAX_HEADER_BYTES)):
        words = line.decode("ascii", "replace").split("#")[0].split()
        if not words:
            continue
        if words[0] == "DATA":
            kind = words[1] if len(words) == 2 else ""
            if kind not in ("ascii", "binary", "binary_compressed"):
                raise FormatError(f"{where}: DATA: expected ascii, binary or binary_compressed, got {shown(kind)}")
            return header, kind, data[stream.tell() :]
        header[words[0]] = words[1:]
    raise FormatError(f"{where}: expected the header of a .pcd file up to its line DATA, got none")


def _dtype(header: dict[str, list[str]], where: str) -> np.dtype:
    """One point as the header describes it; fields of several numbers, and those without a name (_), are bytes."""
    names, sizes, kinds = (header.get(key, []) for key in ("FIELDS", "SIZE", "TYPE"))
    counts = header.get("COUNT", ["1"] * len(names))
    if not 0 < len(names) <= MAX_FIELDS or not len(names) == len(sizes) == len(kinds) == len(counts):
        raise FormatError(f"{where}: FIELDS, SIZE, TYPE, COUNT: expected as many values in each, got others")
    fields: list[tuple[str, str]] = []
    for number, (name, size, kind, count) in enumerate(zip(names, sizes, kinds, counts, strict=True)):
        letter, allowed = KINDS.get(kind, ("", ()))
        if not (size.isdecimal() and count.isdecimal() and len(count) < 6) or int(size[:3]) not in allowed:
            raise FormatError(
                f"{where}: {name[:40]}: expected a number of 1 to 8 bytes, got {shown((kind, size, count))}"
            )
        if not 1 <= int(count) <= MAX_COUNT:
            raise FormatError(f"{where}: {name[:40]}: expected 1 to {MAX_COUNT} numbers, got {count}")
        is_one = count == "1" and name != "_" and name.lower() not in dict(fields)
        fields.append((name.lower(), f"<{letter}{size}") if is_one else (f"_{number}", f"V{int(size) * int(count)}"))
    return np.dtype(fields)


def _names(dtype: np.dtype) -> list[str]:
    return [name for name in dtype.names or () if dtype[name].kind != "V"]


def _count(header: dict[str, list[str]], where: str) -> int:
    words = header.get("POINTS") or header.get("WIDTH") or [""]
    if len(words) != 1 or not words[0].isdecimal() or len(words[0]) > 12:
        raise FormatError(f"{where}: POINTS: expected a number of points, got {shown(' '.join(words))}")
    return int(words[0])


def _of_text(body: bytes, dtype: np.dtype, n: int, where: str) -> dict[str, Shaped[np.ndarray, " n"]]:
    """Points of a line each; a field without a name has a word for each of its numbers."""
    if any(dtype[name].kind == "V" for name in dtype.names or ()):
        raise FormatError(f"{where}: expected fields of one number each in text, got others; save it as binary")
    words = body.split()
    columns = dtype.names or ()
    if len(words) != n * len(columns):
        raise FormatError(f"{where}: expected {n:,} points of {len(columns)} numbers, got {len(words):,} numbers")
    try:
        numbers = np.array(words, dtype="S32").astype(float).reshape(n, len(columns))
    except ValueError:
        raise FormatError(f"{where}: expected numbers, got other text") from None
    with np.errstate(over="ignore"):
        return {name: _typed(numbers[:, at], dtype[name], where) for at, name in enumerate(columns)}


def _typed(values: Shaped[np.ndarray, " n"], dtype: np.dtype, where: str) -> Shaped[np.ndarray, " n"]:
    """Numbers of text in the type that the header gives; integers decide how intensities are scaled."""
    if dtype.kind == "f":
        return values
    limits = np.iinfo(dtype)
    if not ((values >= limits.min) & (values <= limits.max)).all():
        raise FormatError(f"{where}: expected numbers of the type {dtype.name}, got others")
    return values.astype(dtype)


def _of_compressed(body: bytes, dtype: np.dtype, n: int, where: str) -> dict[str, Shaped[np.ndarray, " n"]]:
    size = n * dtype.itemsize
    packed, plain = (int(number) for number in np.frombuffer(body[:8], "<u4")) if len(body) >= 8 else (0, 0)
    if plain != size or len(body) - 8 < packed:
        raise FormatError(
            f"{where}: expected {size:,} bytes of points, compressed, got {len(body):,} bytes for {plain:,}"
        )
    data, columns, start = lzf(body[8 : 8 + packed], size, where), {}, 0
    for name in dtype.names or ():
        end = start + n * dtype[name].itemsize
        if dtype[name].kind != "V":
            columns[name] = np.frombuffer(data[start:end], dtype[name])
        start = end
    return columns


def lzf(data: bytes, size: int, where: str) -> bytes:
    """The `size` bytes that an LZF stream stands for: runs of up to 32 bytes, and copies of up to 264 bytes that lie up
    to 8192 back. Raises FormatError for another size."""
    found, at, end = bytearray(), 0, len(data)
    while at < end and len(found) <= size:
        control = data[at]
        at += 1
        if control < 32:
            found += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7 and at < end:
            length += data[at]
            at += 1
        back = ((control & 31) << 8) + (data[at] if at < end else 0) + 1
        at += 1
        length += SHORTEST_COPY - 1
        if back > len(found):
            raise FormatError(f"{where}: expected compressed points, got damaged bytes")
        start = len(found) - back
        # A copy may reach into what it writes: it repeats.
        piece = found[start : start + length]
        found += piece if len(piece) == length else (piece * (length // back + 1))[:length]
    if len(found) != size or at > end:
        raise FormatError(f"{where}: expected compressed points, got damaged bytes")
    return bytes(found)


# A turn of a lidar of 128 beams and 4096 azimuths has half a million points.
MAX_POINTS, MAX_CLOUD_BYTES = 1 << 23, 256 << 20
# Beyond any lidar, in whichever unit.
MAX_COORDINATE = 1e7
ENDINGS = (".bin", ".npy", ".pcd", ".feather")
# The names that files give to what a point reflects.
INTENSITIES = ("intensity", "i", "reflectance", "reflectivity", "remission")
# What numpy raises for broken headers. It takes some of them for headers of Python 2, and warns.
HEADER_ERRORS = (
    ValueError,
    TypeError,
    SyntaxError,
    RecursionError,
    MemoryError,
    OverflowError,
    TokenError,
    UserWarning,
)
# Full scale of bytes, and of floats of which any is more than 1.
BYTE = 255.0


class Cloud(NamedTuple):
    """The points of a file in its own axes and unit, and how strongly they reflect, from 0 to 1 (all 0 where the file
    does not say). Returns without a place (NaN, infinity, or the origin) are left out."""

    xyz: Points3
    intensity: Scalars


def read_cloud(path: Path) -> Cloud:
    """The points of a file, by its ending. Raises FormatError, one line that names the file, for other endings, damaged
    bytes, and more than 8 million points."""
    reader = {".bin": _read_bin, ".npy": _read_npy, ".pcd": _read_pcd, ".feather": _read_feather}.get(path.suffix)
    if reader is None:
        raise FormatError(f"{path}: expected a file of points ({', '.join(ENDINGS)}), got another ending")
    columns = reader(path)
    missing = [axis for axis in "xyz" if axis not in columns]
    if missing:
        raise FormatError(f"{path}: expected fields x, y and z, got {', '.join(columns)[:80] or 'none'}")
    if len(columns["x"]) > MAX_POINTS:
        raise FormatError(f"{path}: expected at most {MAX_POINTS:,} points, got {len(columns['x']):,}")
    xyz = np.stack([numeric(columns[axis], f"{path}: {axis}") for axis in "xyz"], axis=-1)
    told = next((columns[name] for name in INTENSITIES if name in columns), np.zeros(len(xyz), np.uint8))
    # A product of NaN or infinity is no number either, and comparing it is False.
    with np.errstate(invalid="ignore"):
        kept = (np.abs(xyz) < MAX_COORDINATE).all(axis=1) & (xyz != 0).any(axis=1)
    return Cloud(xyz[kept], _shares(told, f"{path}: intensity")[kept])


def _shares(values: Shaped[np.ndarray, " n"], where: str) -> Scalars:
    """Intensities from 0 to 1: integers are parts of 255, or of 65535 where one is more; floats are already so, or
    parts of 255."""
    numbers = np.nan_to_num(numeric(values, where), nan=0.0, posinf=0.0, neginf=0.0)
    most = numbers.max(initial=0.0)
    if values.dtype.kind == "f":
        full = 1.0 if most <= 1 else max(BYTE, most)
    else:
        full = BYTE if most <= BYTE else max(65535.0, most)
    return np.clip(numbers / full, 0, 1)


def _read_bin(path: Path) -> dict[str, Shaped[np.ndarray, " n"]]:
    """KITTI: x, y, z and reflectance of each point in turn, as float32, little-endian."""
    data = read_file(path, MAX_CLOUD_BYTES)
    if len(data) % 16 or not data:
        raise FormatError(f"{path}: expected four float32 for each point (16 bytes), got {len(data):,} bytes")
    return _columns(np.frombuffer(data, "<f4").reshape(-1, 4))


def _read_npy(path: Path) -> dict[str, Shaped[np.ndarray, " n"]]:
    """An array of n rows of x, y, z and perhaps intensity, or one with such fields. Its header is checked against the
    file's size before an array is made."""
    stream = io.BytesIO(read_file(path, MAX_CLOUD_BYTES))
    try:
        numpy_format: Any = np.lib.format
        version = numpy_format.read_magic(stream)
        is_first = version == (1, 0)
        read = numpy_format.read_array_header_1_0 if is_first else numpy_format.read_array_header_2_0
        shape, is_fortran, dtype = read(stream)
    except HEADER_ERRORS:
        raise FormatError(f"{path}: expected an array of numpy, got other or damaged bytes") from None
    data = stream.getvalue()[stream.tell() :]
    size = dtype.itemsize
    for length in shape:
        size *= length
    if dtype.hasobject or size != len(data):
        raise FormatError(f"{path}: expected the {size:,} bytes of numbers that its header tells, got {len(data):,}")
    array = np.frombuffer(data, dtype)
    if dtype.names and len(shape) == 1:
        return {name.lower(): array[name] for name in dtype.names if array[name].ndim == 1}
    if dtype.names or len(shape) != 2 or shape[1] < 3:
        raise FormatError(f"{path}: expected n rows of x, y, z and perhaps intensity, got {shape} of {dtype}"[:300])
    return _columns(array.reshape(shape, order="F" if is_fortran else "C"))


def _columns(rows: Shaped[np.ndarray, "n c"]) -> dict[str, Shaped[np.ndarray, " n"]]:
    return dict(zip(("x", "y", "z", "intensity"), rows.T, strict=False))


def _read_pcd(path: Path) -> dict[str, Shaped[np.ndarray, " n"]]:
    return read_pcd(read_file(path, MAX_CLOUD_BYTES), str(path), MAX_POINTS)


def _read_feather(path: Path) -> dict[str, Shaped[np.ndarray, " n"]]:
    return read_feather(path, "xyz", INTENSITIES)
