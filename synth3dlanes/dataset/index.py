"""Read the indices of shards. Every reader of a shard's parquet file uses this module; `columns` defines its
content."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import get_args

import numpy as np
import pyarrow as pa

from synth3dlanes.dataset.format import BLOCK, COLUMN_OF_MEMBER, key_of
from synth3dlanes.scene.settings import MAX_SHARD_SIZE
from synth3dlanes.scene.things import ThingKind
from synth3dlanes.system.columnar import DAMAGED, TableBounds, read_parquet
from synth3dlanes.system.errors import FormatError

# Where the metadata of an index has the recipe that its samples were made from.
RECIPE = b"synth3dlanes.recipe"
# Columns of data sets with several pictures of each scene: the numbers of the scene as drawn, the frame, the camera.
SHOT_COLUMNS = ("scene", "frame", "camera")
# Columns that were added later, and what they are in older shards: the defaults of `scene.json`.
ADDED: dict[str, int | float | bool | str] = {
    "n_oncoming": 0,
    "n_traffic_elements": 0,
    **{f"n_{kind}s": 0 for kind in get_args(ThingKind)},
    "median_m": 0.0,
    "divider_dashed": False,
    "marking_dots": False,
    "marking_left_pair": "same",
    "tar": 0.0,
    "joint": 0.0,
    "ghost_lines": 0.0,
    "camera_name": "",
    "camera_right_m": 0.0,
    "camera_forward_m": 0.0,
    "camera_yaw_rad": 0.0,
    "flare": 0.0,
    "dirt": 0.0,
    "drops": 0.0,
    "jpeg_quality": 95,
    "weather_kind": "any",
    "weather_daytime": "any",
    "weather_rain": 0.0,
    "weather_snowfall": 0.0,
    "weather_snow": 0.0,
    "weather_snow_on_road": 0.0,
    "weather_headlights": False,
    "host_bonnet": 0.0,
    "host_gray": 0.0,
    "host_gloss": 0.0,
    "translucency": 0.0,
    "grass_m": 0.0,
    "n_symbols": 0,
    "n_rails": 0,
    "n_posts": 0,
    "n_crossings": 0,
    "n_buildings": 0,
    "works": "none",
    "works_lines": "none",
    "vignette": 0.0,
}
ARROW_TYPES: dict[object, pa.DataType] = {int: pa.int64(), float: pa.float64(), bool: pa.bool_(), str: pa.string()}
ADDED_SCHEMA = pa.schema([(column, ARROW_TYPES[type(default)]) for column, default in ADDED.items()])
# Types of the columns that may be required and are no integers.
TYPES = {"key": pa.string(), "sha256": pa.string(), "camera_roll_rad": pa.float64()} | dict(
    zip(ADDED_SCHEMA.names, ADDED_SCHEMA.types, strict=True)
)
# Far above any tar; sums of such numbers do not overflow.
MAX_TAR_BYTES = 1 << 50
# A row of 111 columns takes 1 KB, decoded or in pages.
BOUNDS = TableBounds(most_rows=MAX_SHARD_SIZE, row_bytes=2048)


def read_index(data: bytes, where: str, columns: Sequence[str] = ()) -> pa.Table:
    """The index, or some columns of it, from the bytes of a parquet file. Columns that older versions lack get their
    defaults.

    Raises FormatError, whose message begins with `where`, for bytes that are no parquet file, for more rows than a
    shard may have, and for a missing column.
    """
    try:
        table = read_parquet(data, where, BOUNDS, columns or None)
        for field in ADDED_SCHEMA:
            if field.name not in table.column_names and (field.name in columns or not columns):
                default = pa.scalar(ADDED[field.name], field.type)
                table = table.append_column(field, pa.repeat(default, table.num_rows))
        table.validate(full=True)
    except DAMAGED as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{where}: expected the index of a shard, got {_first_line(error)}") from None
    require_columns(table, columns, where)
    return table


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [""])[0][:200]


def read_indices(data: bytes, where: str) -> set[int]:
    """The indices of the samples in a shard, by its index; raise FormatError as `read_index` does."""
    return set(read_index(data, where, ["index"])["index"].to_pylist())


def require_columns(table: pa.Table, columns: Sequence[str], where: str) -> None:
    """Raise FormatError where an index lacks a column, has it twice or of another type, or has no value for it in some
    row."""
    for column in columns:
        count = table.column_names.count(column)
        if count != 1:
            found = f"{count} of them" if count else ", ".join(table.column_names)[:200] or "none"
            raise FormatError(f"{where}: expected a column {column}, got {found}")
        kind = TYPES.get(column, pa.int64())
        if table.schema.field(column).type != kind:
            raise FormatError(f"{where}: expected a column {column} of {kind}, got {table.schema.field(column).type}")
        if table[column].null_count:
            raise FormatError(f"{where}: expected a column {column} without gaps, got {table[column].null_count} gaps")


def check_places(table: pa.Table, names: Sequence[str], numbers: range, where: str) -> None:
    """Raise FormatError unless the rows are samples with these numbers, in order, and the members of each lie one after
    the other, as `format.tar_bytes` puts them."""
    indices = table["index"].to_numpy()
    if len(indices) and not (
        indices[0] >= numbers.start and indices[-1] < numbers.stop and (np.diff(indices) > 0).all()
    ):
        raise FormatError(f"{where}: expected samples from {numbers.start} to {numbers.stop - 1} in order, got others")
    if table["key"].to_pylist() != [key_of(index) for index in indices.tolist()]:
        raise FormatError(f"{where}: expected keys of eight digits that are the index, got others")
    places = [(table[offset].to_numpy(), table[size].to_numpy()) for offset, size in map(_place_columns, names)]
    is_placed = np.ones(len(indices), bool)
    for offset, size in places:
        is_placed &= (offset >= BLOCK) & (offset < MAX_TAR_BYTES) & (size >= 0) & (size < MAX_TAR_BYTES)
    for (offset, size), (following, _) in pairwise(places):
        is_placed &= following == offset + size + -size % BLOCK + BLOCK
    if not is_placed.all():
        key = key_of(int(indices[is_placed.argmin()]))
        raise FormatError(f"{where}: {key}: expected its members one after the other in the tar, got other offsets")


def place_columns(names: Sequence[str]) -> list[str]:
    """The columns that say where these members of each sample lie in the tar: offset and size of each."""
    return [column for name in names for column in _place_columns(name)]


def _place_columns(name: str) -> tuple[str, str]:
    return f"{COLUMN_OF_MEMBER[name]}_offset", f"{COLUMN_OF_MEMBER[name]}_size"


def read_recipe(data: bytes, where: str) -> str:
    """The recipe of a shard, from its index; "" if the index has none. Raises FormatError like `read_index`."""
    return recipe_of(read_index(data, where, ["index"]).schema.metadata)


def recipe_of(metadata: Mapping[bytes, bytes] | None) -> str:
    """The recipe from the metadata of an index that has been read."""
    return (metadata or {}).get(RECIPE, b"").decode("utf-8", "replace")
