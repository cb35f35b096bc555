"""Reading the indices of shards. Every reader of a shard's parquet comes through here; `columns` says what is in it."""

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from synth3dlanes.dataset.format import COLUMN_OF_MEMBER
from synth3dlanes.errors import FormatError

# Where the metadata of an index has the recipe that its samples were made from.
RECIPE = b"synth3dlanes.recipe"


def read_index(source: Any, where: str, columns: Sequence[str] = ()) -> pa.Table:
    """The index in `source` (a path or an open file), or these columns of it.

    Raises FormatError, its message beginning with `where`, where it is no parquet, or lacks one of the columns.
    """
    try:
        table = pq.read_table(source, columns=list(columns) or None)
    except (pa.ArrowException, OSError) as error:
        raise FormatError(f"{where}: expected the index of a shard, got {error}") from None
    require_columns(table, columns, where)
    return table


def read_indices(source: Any, where: str) -> set[int]:
    """The indices of the samples in a shard, by its index; raise FormatError as `read_index` does."""
    return set(read_index(source, where, ["index"])["index"].to_pylist())


def require_columns(table: pa.Table, columns: Sequence[str], where: str) -> None:
    """Raise FormatError where an index lacks a column, or has no value for it in some row."""
    for column in columns:
        if column not in table.column_names:
            raise FormatError(f"{where}: expected a column {column}, got {', '.join(table.column_names) or 'none'}")
        if table[column].null_count:
            raise FormatError(f"{where}: expected a column {column} without gaps, got {table[column].null_count} gaps")


def place_columns(names: Sequence[str]) -> list[str]:
    """The columns that say where these members of each sample lie in the tar: offset and size of each."""
    return [f"{COLUMN_OF_MEMBER[name]}_{what}" for name in names for what in ("offset", "size")]


def read_recipe(source: Any) -> str:
    """The recipe that a shard was made from, by its index; "" where it does not say."""
    return recipe_of(pq.read_schema(source).metadata)


def recipe_of(metadata: Mapping[bytes, bytes] | None) -> str:
    """`read_recipe` from the metadata of an index that has been read."""
    return (metadata or {}).get(RECIPE, b"").decode("utf-8", "replace")
