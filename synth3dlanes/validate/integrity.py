"""Check shards against their indices: no byte unaccounted for, every sample once. Paths may be URLs."""

import hashlib
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any, NamedTuple

import pyarrow as pa

from synth3dlanes import __version__
from synth3dlanes.dataset.address import connect, read_file, translate_store_errors
from synth3dlanes.dataset.columns import SCHEMA, index_row
from synth3dlanes.dataset.description import DESCRIPTION
from synth3dlanes.dataset.folder import COMPANIONS
from synth3dlanes.dataset.format import BLOCK, key_of, tar_end, tar_members
from synth3dlanes.dataset.index import ADDED_SCHEMA, place_columns, read_index, recipe_of, require_columns
from synth3dlanes.labels.labels import Labels
from synth3dlanes.scene.scene import Scene
from synth3dlanes.system.errors import FormatError
from synth3dlanes.validate.findings import Finding, Problem, differences, some

NAMED_AT_MOST = 5
CANNOT_BE_READ = "cannot be read"
KEY = re.compile("[0-9]{8}")


@dataclass(frozen=True)
class Entry:
    """A sample according to the index: its row, its tar, the offset and size of each member, and the digest of its
    bytes."""

    split: str
    index: int
    tar: str
    row: int
    members: dict[str, tuple[int, int]]
    sha256: str

    @property
    def name(self) -> str:
        """The sample's name for `synth3dlanes inspect`: `train:00000017`."""
        return f"{self.split}:{key_of(self.index)}"

    @property
    def end(self) -> int:
        """End of the sample's last block in the tar."""
        end = max(offset + size for offset, size in self.members.values())
        return end + -end % BLOCK

    def parts(self) -> set[tuple[str, int, int]]:
        """The expected members of the tar: name, offset, size."""
        return {(f"{key_of(self.index)}.{name}", *place) for name, place in self.members.items()}


class ShardCheck(NamedTuple):
    """The problems of a shard, its intact samples, all sample indices in its index, and the recipe that it was made
    from ("" if not recorded)."""

    problems: list[Problem]
    entries: Sequence[Entry] = ()
    indices: frozenset[int] = frozenset()
    recipe: str = ""


def check_shard(parquet: str, names: Sequence[str], shard_size: int) -> ShardCheck:
    """Compare the index of a shard with its tar, member by member."""
    try:
        if not _stem(parquet).isdecimal():
            raise FormatError("expected the number of a shard, as in 00000.parquet, got another name")
        # The cache may hold an earlier validation's index.
        _read_index.cache_clear()
        table = _read_index(parquet)
        entries, problems = _entries(table, parquet, names)
    except FormatError as error:
        return ShardCheck([Problem(_place(parquet), "", str(error).removeprefix(f"{_place(parquet)}: "))])
    tar = f"{parquet.removesuffix('.parquet')}.tar"
    found, fault = walk(tar)
    if found and not fault:
        end = max(offset + size + -size % BLOCK for _, offset, size in found)
        expected, size = end + len(tar_end(end)), _size(tar)
        fault = "" if size == expected else f"expected {expected} bytes, got {size}"
    problems += [Problem(_place(tar), "", fault)] if fault else []
    numbers = [entry.index for entry in entries]
    if numbers != sorted(numbers):
        first = next(i for i, (one, other) in enumerate(zip(numbers, sorted(numbers), strict=True)) if one != other)
        reason = f"expected rows in the order of their samples, got {key_of(numbers[first])} in row {first}"
        problems.append(Problem(_place(parquet), "", reason))
    got = "a cut or changed tar" if found or CANNOT_BE_READ not in fault else f"one that {CANNOT_BE_READ}"
    rows, members = Counter(numbers), Counter(name for name, _, _ in found)
    for key in sorted({name.partition(".")[0] for name in members} - set(map(key_of, rows))):
        where = f"{_place(tar).partition('/')[0]}:{key}"
        problems.append(Problem(where, "", f"in {_place(tar)}, but not in its index"))
    start, whole = int(_stem(parquet)) * shard_size, {}
    for entry in {entry.index: entry for entry in entries}.values():
        missing = sorted(entry.parts() - set(found))
        copies = {
            f"the index {_place(parquet)}": rows[entry.index],
            _place(tar): max(members[name] for name, _, _ in entry.parts()),
        }
        reasons = [f"expected this key once in {place}, got {n}" for place, n in copies.items() if n > 1]
        if missing:
            name, offset, size = missing[0]
            reasons.append(f"expected {size} bytes of {name} at byte {offset} of {_place(tar)}, got {got}")
        elif not start <= entry.index < start + shard_size:
            last = start + shard_size - 1
            reasons.append(f"expected samples {start} to {last} in {_place(parquet)}, got this one")
        else:
            whole[entry.index] = entry
        problems += [Problem(entry.name, "", reason) for reason in reasons]
    return ShardCheck(problems, list(whole.values()), frozenset(numbers), recipe_of(table.schema.metadata))


def check_companions(place: str, description: Mapping[str, Any]) -> Iterator[Problem]:
    """Problems of README.md and croissant.json that are not what dataset.json gives; what a user has made their own, or
    another version wrote, may be any."""
    files, root = connect(place)
    for name, (make, mark) in COMPANIONS.items():
        with translate_store_errors(place):
            found = files.cat_file(f"{root}/{name}") if files.exists(f"{root}/{name}") else b""
        if mark.encode() in found and description["generator"] == __version__ and found != make(description):
            reason = f"expected what {DESCRIPTION} gives, got another text: remove {mark!r} from it to keep it"
            yield Problem(name, "", reason)


def check_presence(split: str, n: int, indices: Set[int]) -> Iterator[Problem]:
    """Problems unless a split has exactly the samples 0 to n - 1."""
    n_missing = n - sum(0 <= index < n for index in indices)
    if n_missing:
        absent = (index for index in range(n) if index not in indices)
        named = [key_of(index) for index in islice(absent, min(n_missing, NAMED_AT_MOST))]
        more = f" and {n_missing - NAMED_AT_MOST} more" if n_missing > NAMED_AT_MOST else ""
        yield Problem(split, "", f"expected {n} samples, {n_missing} missing: {', '.join(named)}{more}")
    for index in sorted(index for index in indices if not 0 <= index < n):
        yield Problem(f"{split}:{key_of(index)}", "", f"expected indices below {n} by dataset.json, got this one")


def read_sample(entry: Entry) -> tuple[dict[str, bytes], str]:
    """A sample's members by name, and the fault of its bytes ("" for none)."""
    start = min(offset for offset, _ in entry.members.values()) - BLOCK
    files, path = connect(entry.tar)
    with translate_store_errors(entry.tar):
        data = files.cat_file(path, start=start, end=entry.end)
    members = {name: data[offset - start :][:size] for name, (offset, size) in entry.members.items()}
    digest = hashlib.sha256(data).hexdigest()
    fault = "" if digest == entry.sha256 else f"expected bytes of SHA-256 {entry.sha256:.12}..., got {digest:.12}..."
    return members, fault


def check_row(
    entry: Entry, scene: Scene | None, labels: Labels, numbers: tuple[int, int, int] | None = None
) -> Iterator[Finding]:
    """Finding if a sample's row in the index differs from its scene, labels and offsets."""
    parquet = f"{entry.tar.removesuffix('.tar')}.parquet"
    found = _read_index(parquet).slice(entry.row, 1).to_pylist()[0]
    expected = index_row(key_of(entry.index), entry.members, entry.sha256, scene, labels, numbers)
    wrong = list(differences(expected, {name: found.get(name) for name in dict.fromkeys([*SCHEMA.names, *expected])}))
    if wrong:
        yield Finding("", f"{_place(parquet)}: {some(wrong)}")


def walk(tar: str) -> tuple[list[tuple[str, int, int]], str]:
    """Name, offset and size of each complete member of a tar up to its first fault, and that fault ("" for none)."""
    found: list[tuple[str, int, int]] = []
    files, path = connect(tar)
    try:
        with translate_store_errors(_place(tar), CANNOT_BE_READ):
            if not files.exists(path):
                return [], "expected a whole tar, got none"
            with files.open(path, "rb") as stream:
                for member in tar_members(stream, _size(tar)):
                    found.append(member)
    except FormatError as error:
        return found, f"expected a whole tar: {error}"
    return found, "" if found else "expected a whole tar, got no members"


def _place(place: str) -> str:
    """A file's path from the folder of its split on, e.g. `train/00000.tar`."""
    return "/".join(place.split("/")[-2:])


def _stem(place: str) -> str:
    return place.rpartition("/")[2].partition(".")[0]


def _size(place: str) -> int:
    files, path = connect(place)
    return int(files.size(path))


@lru_cache(maxsize=1)
def _read_index(parquet: str) -> pa.Table:
    """The index of a shard; raise FormatError if it is not one. Samples are read in order, so one index is cached."""
    files, path = connect(parquet)
    with translate_store_errors(_place(parquet), "cannot be read"):
        data = read_file(files, path)
        if data is None:
            raise FormatError("expected the index of a shard, got none")
        table = read_index(data, _place(parquet))
    for field in [*SCHEMA, *ADDED_SCHEMA]:
        if table.column_names.count(field.name) != 1:
            raise FormatError(f"expected one column {field.name}, got {table.column_names.count(field.name)}")
        found = table.schema.field(field.name).type
        if found != field.type:
            raise FormatError(f"expected a column {field.name} of {field.type}, got {found}")
    return table


def _entries(table: pa.Table, parquet: str, names: Sequence[str]) -> tuple[list[Entry], list[Problem]]:
    """The rows of an index; raise FormatError if it lacks the columns of offsets."""
    places = {name: place_columns([name]) for name in names}
    columns = ["key", "index", "sha256", *place_columns(names)]
    require_columns(table, columns, _place(parquet))
    split, tar = _place(parquet).partition("/")[0], f"{parquet.removesuffix('.parquet')}.tar"
    entries, problems = [], []
    for number, row in enumerate(table.select(columns).to_pylist()):
        key, expected = row["key"], key_of(row["index"])
        if key != expected:
            reason = f"expected key {expected} for index {row['index']}, got {key!r:.40} in {_place(parquet)}"
            problems.append(Problem(f"{split}:{key if KEY.fullmatch(key) else expected}", "", reason))
            continue
        members = {name: (row[offset], row[size]) for name, (offset, size) in places.items()}
        entries.append(Entry(split, row["index"], tar, number, members, row["sha256"]))
    return entries, problems
