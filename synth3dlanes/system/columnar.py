"""Tables of parquet and Arrow files (feather), whose decoded sizes are bounded before anything is decoded.

One stored value may stand for a million rows, and one compressed kilobyte may decode to a megabyte. Arrow allocates the
memory that a file announces, so the announced sizes are read first: from the headers of parquet's pages (Thrift's
compact protocol) and of Arrow's batches (FlatBuffers).
"""

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from synth3dlanes.system.errors import FormatError

# A page's encoding that stores values by how they continue those before them.
DELTA_BYTE_ARRAY = 7
# Thrift's compact protocol.
TRUE, FALSE, BYTE, INTEGERS, DOUBLE, BINARY, LISTS, STRUCT = 1, 2, 3, (4, 5, 6), 7, 8, (9, 10), 12
MOST_NESTED = 8
# What reading damaged bytes raises.
DAMAGED = (
    AttributeError,
    IndexError,
    KeyError,
    OverflowError,
    TypeError,
    ValueError,
    struct.error,
    pa.ArrowException,
    OSError,
)
# Decoded bytes of a value that is no text.
VALUE_BYTES = 8
INCOMPRESSIBLE = -1


@contextmanager
def reading_table(where: str, columns: Sequence[str]) -> Iterator[None]:
    """Turns what damaged bytes of a table with these columns raise into a FormatError that begins with `where`."""
    try:
        yield
    except FormatError:
        raise
    except DAMAGED as error:
        reason = " ".join(str(error).split())[:120]
        raise FormatError(f"{where}: expected a table of {', '.join(columns)}, got {reason}") from None


@dataclass(frozen=True)
class TableBounds:
    """What a table may take: rows, and bytes of all columns that are read."""

    most_rows: int
    row_bytes: int
    base_bytes: int = 1 << 20

    def check_rows(self, rows: int, where: str) -> None:
        """Raise FormatError for too many rows."""
        if not 0 <= rows <= self.most_rows:
            raise FormatError(f"{where}: expected at most {self.most_rows:,} rows, got {rows:,}")

    def check_bytes(self, size: int, rows: int, where: str) -> None:
        """Raise FormatError for more bytes than this number of rows may have."""
        most = self.base_bytes + rows * self.row_bytes
        if not 0 <= size <= most:
            raise FormatError(f"{where}: expected at most {most:,} bytes in {rows:,} rows, got {size:,}")


def read_parquet(data: bytes, where: str, bounds: TableBounds, columns: Sequence[str] | None = None) -> pa.Table:
    """A table with all of its columns, or with those of `columns` that exist. Raises FormatError for more rows or bytes
    than the bounds allow, an error of DAMAGED for damaged bytes."""
    # By this thread and from memory: a process that ends while Arrow's threads hold its files is aborted.
    with pq.ParquetFile(pa.BufferReader(data)) as file:
        metadata, known = file.metadata, file.schema_arrow.names
    groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
    rows = sum(group.num_rows for group in groups)
    bounds.check_rows(metadata.num_rows, where)
    if rows != metadata.num_rows:
        raise FormatError(f"{where}: expected {metadata.num_rows:,} rows in its groups, got {rows:,}")
    chosen = [name for name in columns if name in known] if columns is not None else None
    texts, size, n_values = set[str](), 0, 0
    for group in groups:
        for number in range(group.num_columns):
            chunk = group.column(number)
            if chosen is not None and chunk.path_in_schema.partition(".")[0] not in chosen:
                continue
            for page in _pages(data, chunk, where):
                size, n_values = size + page.n_bytes, n_values + page.n_values
            if chunk.physical_type in ("BYTE_ARRAY", "FIXED_LEN_BYTE_ARRAY"):
                texts.add(chunk.path_in_schema)
    bounds.check_bytes(size, rows, where)
    bounds.check_bytes(n_values * VALUE_BYTES, rows, where)
    # Text as dictionaries, which hold each value once, however many rows have it.
    with pq.ParquetFile(pa.BufferReader(data), read_dictionary=sorted(texts)) as file:
        table = file.read(columns=chosen, use_threads=False)
    return _decoded(table, where, bounds)


def read_arrow(data: bytes, where: str, bounds: TableBounds, columns: Sequence[str]) -> pa.Table:
    """The columns among these that an Arrow file has. Raises as `read_parquet` does."""
    with pa.ipc.open_file(pa.BufferReader(data)) as file:
        schema = file.schema
        known = [schema.get_field_index(name) for name in columns if schema.get_field_index(name) >= 0]
        rows, size = 0, 0
        for batch in _batches(data):
            rows, size = rows + batch.n_values, size + batch.n_bytes
        bounds.check_rows(rows, where)
        bounds.check_bytes(size, rows, where)
    for at in known:
        kind = schema.field(at).type
        kind = kind.value_type if pa.types.is_dictionary(kind) else kind
        if not (pa.types.is_primitive(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind)):
            raise FormatError(f"{where}: expected numbers or text in {schema.field(at).name}, got {kind!s:.40}")
    options = pa.ipc.IpcReadOptions(included_fields=known, use_threads=False)
    with pa.ipc.open_file(pa.BufferReader(data), options=options) as file:
        table = file.read_all() if known else pa.table({})
    table.validate(full=True)
    return _decoded(table, where, bounds)


def _decoded(table: pa.Table, where: str, bounds: TableBounds) -> pa.Table:
    """The table with plain columns instead of dictionaries."""
    coded = {
        name: table[name]
        for name in dict.fromkeys(table.column_names)
        if pa.types.is_dictionary(table.field(name).type)
    }
    size = sum(_plain_bytes(chunk) for column in coded.values() for chunk in column.chunks)
    bounds.check_bytes(size, table.num_rows, where)
    for name, column in coded.items():
        place = table.schema.get_field_index(name)
        table = table.set_column(place, name, column.cast(column.type.value_type))
    return table


def _plain_bytes(chunk: pa.DictionaryArray) -> int:
    """The bytes of a dictionary's values as often as the rows say them."""
    kind = chunk.dictionary.type
    if pa.types.is_primitive(kind):
        return len(chunk) * VALUE_BYTES
    lengths = pc.fill_null(pc.binary_length(chunk.dictionary), 0).to_numpy(zero_copy_only=False)
    return int(lengths.astype(np.int64)[chunk.indices.drop_null().to_numpy(zero_copy_only=False)].sum())


@dataclass(frozen=True)
class _Piece:
    """A part of a table that is decoded at once."""

    n_bytes: int
    n_values: int


def _pages(data: bytes, chunk: Any, where: str) -> Iterator[_Piece]:
    """The pages of a column's chunk in a parquet file, by their headers."""
    at = chunk.data_page_offset
    if chunk.has_dictionary_page and 0 < chunk.dictionary_page_offset < at:
        at = chunk.dictionary_page_offset
    end, seen = at + chunk.total_compressed_size, 0
    if not 0 <= at <= end <= len(data):
        raise ValueError("pages beyond the end of the file")
    while at < end and seen < chunk.num_values:
        try:
            header, at = _struct(data, at)
            # The header of a data page of version 1, of version 2, or of a dictionary page.
            about = header.get(5) or header.get(8) or header.get(7) or {}
            n_bytes, n_stored, n_values = header[2], header[3], about.get(1, 0)
            encoding = about.get(4 if 8 in header and 5 not in header else 2)
        except DAMAGED:
            raise ValueError("damaged headers of pages") from None
        if min(n_bytes, n_stored, n_values) < 0 or at + n_stored > len(data):
            raise ValueError("pages beyond the end of the file")
        if encoding == DELTA_BYTE_ARRAY:
            raise FormatError(f"{where}: expected texts as they are or in a dictionary, got differences between them")
        if 7 not in header:
            seen += n_values
        at += n_stored
        yield _Piece(n_bytes, n_values)


def _struct(data: bytes, at: int, depth: int = 0) -> tuple[dict[int, Any], int]:
    """The fields of a Thrift struct by their numbers, and where it ends."""
    if depth > MOST_NESTED:
        raise ValueError("too deep")
    fields, number = dict[int, Any](), 0
    while data[at]:
        kind, step = data[at] & 15, data[at] >> 4
        at += 1
        if step:
            number += step
        else:
            number, at = _zigzag(data, at)
        fields[number], at = _value(data, at, kind, depth)
    return fields, at + 1


def _value(data: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    if kind in (TRUE, FALSE):
        return kind == TRUE, at
    if kind == BYTE:
        return data[at], at + 1
    if kind in INTEGERS:
        return _zigzag(data, at)
    if kind == DOUBLE:
        return None, at + 8
    if kind == BINARY:
        size, at = _varint(data, at)
        return None, at + size
    if kind == STRUCT:
        return _struct(data, at, depth + 1)
    if kind in LISTS:
        of, size = data[at] & 15, data[at] >> 4
        at += 1
        if size == 15:
            size, at = _varint(data, at)
        for _ in range(size):
            # A truth value has a byte of its own here.
            _, at = (None, at + 1) if of in (TRUE, FALSE) else _value(data, at, of, depth + 1)
        return None, at
    raise ValueError("an unknown kind of value")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        value |= (data[at] & 127) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 128:
            return value, at
        if shift > 63:
            raise ValueError("an endless number")


def _zigzag(data: bytes, at: int) -> tuple[int, int]:
    value, at = _varint(data, at)
    return (value >> 1) ^ -(value & 1), at


def _batches(data: bytes) -> Iterator[_Piece]:
    """The batches of an Arrow file, dictionary batches included, by their headers."""
    (size,) = struct.unpack_from("<i", data, len(data) - 10)
    start = len(data) - 10 - size
    if not 0 <= size <= start:
        raise ValueError("expected a footer within the file")
    footer = _Table(data[start : start + size])
    for slot, is_dictionary in ((2, True), (3, False)):
        for block in footer.structs(slot, "<qi4xq"):
            place, about, _ = block
            if min(place, about) < 0 or place + about > len(data):
                raise ValueError("expected batches within the file")
            skip = 8 if data[place : place + 4] == b"\xff\xff\xff\xff" else 4
            batch = _Table(data[place + skip : place + about]).table(2)
            if is_dictionary:
                batch = batch.table(1)
            n_rows = batch.integer(0)
            if n_rows < 0:
                raise ValueError("expected rows in a batch")
            buffers, n_bytes = batch.structs(2, "<qq"), 0
            for offset, length in buffers:
                n_bytes += length
                if batch.place(3) and length > 0:
                    (told,) = struct.unpack_from("<q", data, _within(place + about + offset, data))
                    n_bytes += 0 if told == INCOMPRESSIBLE else _positive(told)
            yield _Piece(n_bytes, 0 if is_dictionary else n_rows)


def _within(at: int, data: bytes) -> int:
    return at if 0 <= at < len(data) else len(data)


def _positive(size: int) -> int:
    if size < 0:
        raise ValueError("expected a size")
    return size


class _Table:
    """A table of a FlatBuffer; by default the first."""

    def __init__(self, data: bytes, at: int | None = None) -> None:
        self._data = data
        self._at = struct.unpack_from("<I", data)[0] if at is None else at

    def place(self, slot: int) -> int:
        """Where a field is; 0 where the table has none."""
        (back,) = struct.unpack_from("<i", self._data, self._at)
        fields = _within(self._at - back, self._data)
        (size,) = struct.unpack_from("<H", self._data, fields)
        if 4 + 2 * slot >= size:
            return 0
        (offset,) = struct.unpack_from("<H", self._data, fields + 4 + 2 * slot)
        return self._at + offset if offset else 0

    def integer(self, slot: int) -> int:
        """A whole number of 64 bits, by default 0."""
        at = self.place(slot)
        return int(struct.unpack_from("<q", self._data, at)[0]) if at else 0

    def table(self, slot: int) -> "_Table":
        """The table in a field."""
        at = self.place(slot)
        if not at:
            raise ValueError("expected a table")
        return _Table(self._data, at + struct.unpack_from("<I", self._data, at)[0])

    def structs(self, slot: int, form: str) -> list[tuple[int, ...]]:
        """The structs of a field."""
        at = self.place(slot)
        if not at:
            return []
        at += struct.unpack_from("<I", self._data, at)[0]
        (count,) = struct.unpack_from("<I", self._data, at)
        if count * struct.calcsize(form) > len(self._data):
            raise ValueError("expected structs within the file")
        return [struct.unpack_from(form, self._data, at + 4 + n * struct.calcsize(form)) for n in range(count)]
