"""Files of numbers that the readers of drives share: lines of text, and tables in feather files, within bounds."""

import io
import re
from array import array
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Shaped

from synth3dlanes.formats.reading import read_file
from synth3dlanes.system.columnar import DAMAGED, TableBounds, read_arrow
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import shown

# A pose every 10 ms for three hours takes 100 MB as text.
MAX_TEXT_BYTES, MAX_TABLE_BYTES = 128 << 20, 256 << 20
# A point of Argoverse 2 takes 24 bytes, a pose 64.
BOUNDS = TableBounds(most_rows=1 << 23, row_bytes=128, base_bytes=16 << 20)


def matching(folder: Path, pattern: str, most: int) -> list[Path]:
    """The files of a folder whose paths in it fit a pattern, with `**` for folders of any depth. Raises InputError for
    another pattern; ends after `most` + 1 files."""
    where = folder / pattern
    if pattern.split("/").count("**") > 1:
        # Each one more goes through all folders for each folder.
        raise InputError(f"{where}: expected ** at most once in a pattern of files")
    try:
        return list(islice(folder.glob(pattern), most + 1))
    except (ValueError, NotImplementedError, re.error) as error:
        raise InputError(f"{where}: expected a pattern of files, got {error}") from None


def read_lines(path: Path) -> Iterator[tuple[str, str]]:
    """The lines of a text file that are neither empty nor comments (#), each after the place where it is. Raises
    FormatError at the first where the file cannot be read."""
    # One by one: short lines take many times their bytes as texts.
    text = io.TextIOWrapper(io.BytesIO(read_file(path, MAX_TEXT_BYTES)), encoding="utf-8-sig")
    try:
        for number, line in enumerate(text, start=1):
            if line.strip() and not line.lstrip().startswith("#"):
                yield f"{path}:{number}", line.strip()
    except UnicodeDecodeError:
        raise FormatError(f"{path}: expected text in UTF-8, got other bytes") from None


def read_rows(path: Path, columns: int, what: str) -> Float[np.ndarray, "n c"]:
    """The numbers of a text file, `columns` in each line, between spaces or commas; `what` names them."""
    found = array("d")
    for where, line in read_lines(path):
        found.extend(floats(line.replace(",", " "), where, columns, what))
    if not found:
        raise FormatError(f"{path}: expected lines of {what}, got none")
    return np.frombuffer(found).reshape(-1, columns)


def floats(text: str, where: str, count: int, what: str) -> list[float]:
    """`count` finite numbers in a text; raise FormatError for others."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise FormatError(f"{where}: expected {count} numbers ({what}), got {shown(text)}")
    return values


def read_feather(
    path: Path, columns: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, Shaped[np.ndarray, " n"]]:
    """Columns of a feather file (Arrow's own format, version 2), by name; raise FormatError where one of `columns` is
    missing, or has no value in a row."""
    data = read_file(path, MAX_TABLE_BYTES)
    try:
        with pa.ipc.open_file(pa.BufferReader(data)) as file:
            known = file.schema.names
        missing = [name for name in columns if name not in known]
        if missing:
            raise FormatError(f"{path}: expected a column {missing[0]}, got {', '.join(known)[:80] or 'none'}")
        table = read_arrow(data, str(path), BOUNDS, (*columns, *optional))
        found = {name: table[name] for name in table.column_names}
        if any(column.null_count for column in found.values()):
            raise FormatError(f"{path}: expected a value in every row, got an empty one")
        return {name: column.to_numpy() for name, column in found.items()}
    except FormatError:
        raise
    except (*DAMAGED, MemoryError):
        raise FormatError(f"{path}: expected a feather file (Arrow IPC), got other or damaged bytes") from None


def numeric(values: Shaped[np.ndarray, " n"], where: str) -> Float[np.ndarray, " n"]:
    """A column as floats; raise FormatError where it holds anything but numbers."""
    if values.dtype.kind not in "fiu":
        raise FormatError(f"{where}: expected numbers, got {values.dtype}")
    # A signalling NaN of a damaged file warns where it is cast.
    with np.errstate(invalid="ignore"):
        return values.astype(float)
