"""Files of lidar points: KITTI's .bin, numpy's .npy, PCL's .pcd, and feather. numpy and pyarrow alone."""

import io
from pathlib import Path
from tokenize import TokenError
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

from synth3dlanes.recorded.drives.pcd import read_pcd
from synth3dlanes.recorded.drives.tables import numeric, read_bytes, read_feather
from synth3dlanes.system.arrays import Points3, Scalars
from synth3dlanes.system.errors import FormatError

# A turn of a lidar of 128 beams and 4096 azimuths has half a million points.
MAX_POINTS, MAX_CLOUD_BYTES = 1 << 23, 256 << 20
# Beyond any lidar, in whichever unit.
MAX_COORDINATE = 1e7
ENDINGS = (".bin", ".npy", ".pcd", ".feather")
# The names that files give to what a point reflects.
INTENSITIES = ("intensity", "i", "reflectance", "reflectivity", "remission")
# What numpy raises for headers that are none; it takes some for those of Python 2, and warns of them.
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
# What floats between 0 and more than 1 are parts of.
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
    data = read_bytes(path, MAX_CLOUD_BYTES)
    if len(data) % 16 or not data:
        raise FormatError(f"{path}: expected four float32 for each point (16 bytes), got {len(data):,} bytes")
    return _columns(np.frombuffer(data, "<f4").reshape(-1, 4))


def _read_npy(path: Path) -> dict[str, Shaped[np.ndarray, " n"]]:
    """An array of n rows of x, y, z and perhaps intensity, or one with such fields. Its header is checked against the
    file's size before an array is made."""
    stream = io.BytesIO(read_bytes(path, MAX_CLOUD_BYTES))
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
    return read_pcd(read_bytes(path, MAX_CLOUD_BYTES), str(path), MAX_POINTS)


def _read_feather(path: Path) -> dict[str, Shaped[np.ndarray, " n"]]:
    return read_feather(path, "xyz", INTENSITIES)
