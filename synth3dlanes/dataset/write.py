"""One shard on disk: finished samples are kept one by one, then joined into a tar and its index.

    DIR/train/00000.parts/00000017.tar   a finished sample of a shard in progress; appears whole, by rename
    DIR/train/00000.parts/1b7c.run/      the unfinished ones of one run
    DIR/train/00000.tar, 00000.parquet   the finished shard; the parquet, written last, says that it is one

Every sample is its own file until the shard is joined. So any number of workers can work on one shard, in any order,
and whoever is killed, whenever, takes with him only the sample at hand. A worker that outlives its run adds nothing to
the next one's: its run's folder is gone. Joining sorts by index, so the bytes do not depend on any of that; it reads
only what is on disk and may be killed and repeated at any point. Samples of a finished shard take part again when it is
joined anew, so a larger n continues it. Nobody but the holder of the shard's lock (`folder.claim`) joins it.
"""

import hashlib
import json
import os
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import pyarrow.parquet as pq

from synth3dlanes.dataset.address import MAX_READ_BYTES
from synth3dlanes.dataset.columns import index_row, table
from synth3dlanes.dataset.description import differences, numbers_of_lifted
from synth3dlanes.dataset.format import BLOCK, LABELS, SCENE, key_of, tar_bytes, tar_end, tar_members
from synth3dlanes.dataset.index import place_columns, read_index, read_recipe
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.scene import scene as scene_module
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.files import Folder, encoded, open_regular, read_bounded

# Only of a shard of this very recipe that was read and found damaged: following it costs nothing that is whole.
REMEDY = "remove this shard's tar and parquet and run again to make it anew"


@dataclass(frozen=True)
class TarSpan:
    """The bytes of a sample in a tar, from `offset` to `end`, and the offset and size of each member."""

    path: Path
    offset: int
    end: int
    members: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Shard:
    """Shard `number` of the split in `folder`. `names` are the members of each sample, in order. `recipe` is the
    samples' recipe (`description.recipe_text`) for the index, or "". `run` names the run that makes the shard, if
    workers write its parts. `frames` are a clip's frames, which number samples without a scene. `within` turns a
    folder that is relative to a data set into a path."""

    folder: Path
    number: int
    size: int
    names: tuple[str, ...]
    recipe: str = ""
    run: str = ""
    frames: int = 1

    def within(self, root: Path) -> "Shard":
        """The same shard in the data set at `root`."""
        return replace(self, folder=root / self.folder)

    def path(self, suffix: str) -> Path:
        """The shard's file or folder with this suffix."""
        return self.folder / f"{self.number:05d}.{suffix}"

    def indices(self, n: int) -> range:
        """The indices of the samples in this shard of a split of `n`."""
        return range(self.number * self.size, max(self.number * self.size, min(n, (self.number + 1) * self.size)))

    def claimed(self) -> "Shard":
        """The shard for a new run, which holds its lock. From now on no worker of another run can add to it, because
        workers write through the folder of their run."""
        for name in self._data_set.names(self._at("parts")):
            if name.endswith(".run"):
                self._remove(self._at("parts") / name)
        return replace(self, run=uuid.uuid4().hex)

    def open(self) -> None:
        """Allow the workers of this run to write parts."""
        self._data_set.make_in(self._at("parts"))
        if self.run:
            self._data_set.make_in(self._unfinished)

    def close(self) -> None:
        """Remove unfinished files of workers that have ended."""
        if self.run:
            self._data_set.remove_tree(self._unfinished)
        self._data_set.remove_empty(self._at("parts"))

    def write_part(self, index: int, members: Mapping[str, bytes]) -> int:
        """Keep one finished sample; return its size in bytes. Raises FileNotFoundError where another run has claimed
        the shard."""
        assert tuple(members) == self.names, f"expected members {self.names}, got {tuple(members)}"
        if not self.run:
            self.open()
        data = tar_bytes(key_of(index), members)
        self._data_set.write(self._at("parts") / f"{key_of(index)}.tar", data, self._unfinished)
        return len(data)

    def parts(self) -> dict[int, Path]:
        """The samples that are stored as single files."""
        names = map(PurePath, self._data_set.names(self._at("parts")))
        return {int(name.stem): self.path("parts") / name for name in names if _is_part(name)}

    def joined(self) -> set[int]:
        """The indices of the samples in the tar."""
        return self._joined_by_index() if self.path("parquet").exists() else set(self._places_in_tar())

    def needs_join(self, n: int) -> bool:
        """Whether there are samples below `n` outside the tar, a tar without an index, or files that a killed join
        left."""
        parts = self.parts()
        is_left_over = any(index < n for index in parts) or (not parts and self._data_set.exists(self._at("parts")))
        return is_left_over or (self.path("tar").exists() and not self.path("parquet").exists())

    def join(self, n: int) -> dict[int, str]:
        """Join the tar and the parts below `n`. A sample that cannot be read is left out and stays missing; in a
        finished shard it raises FormatError. Returns why, by index."""
        places = self._places_in_tar()
        parts = {index: path for index, path in self.parts().items() if index < n and index not in places}
        rows, unread, is_finished = [], dict[int, str](), self.path("parquet").exists()
        self.open()
        data_set, beside = self._data_set, self._unfinished
        with data_set.draft(self._at("tar"), beside) as tar, data_set.draft(self._at("parquet"), beside) as index:
            for number in sorted([*places, *parts]):
                try:
                    place = places[number] if number in places else self._place_of_part(number, parts[number])
                    data, row = self._read(number, place, tar.stream.tell())
                except FormatError as error:
                    if number in places and is_finished:
                        raise FormatError(f"{error}; {REMEDY}") from None
                    if number in parts:
                        data_set.remove(self._at("parts") / parts[number].name)
                    unread[number] = str(error)
                    continue
                tar.stream.write(data)
                rows.append(row)
            tar.stream.write(tar_end(tar.stream.tell()))
            rows_of = table(rows, self.recipe)
            index.stream.write(encoded(lambda stream: pq.write_table(rows_of, stream)))
            tar.sync()
            index.sync()
            if rows:
                # Without its index there is no shard, so nobody meets a tar and an index that do not fit.
                data_set.remove(self._at("parquet"))
                data_set.sync(self.folder.name)
                tar.appear()
                index.appear()
        self.clean()
        return unread

    def clean(self) -> None:
        """Remove what a finished or killed join left. Parts that are not in the tar are kept."""
        joined = self.joined()
        for name in map(PurePath, self._data_set.names(self._at("parts"))):
            if not _is_part(name) or int(name.stem) in joined:
                self._remove(self._at("parts") / name)
        self._data_set.remove_empty(self._at("parts"))

    def adopt(self, theirs: "Shard") -> None:
        """Take over the files of a finished shard, as hard links where the file system allows it, else as copies."""
        for suffix in ("tar", "parquet"):
            self._data_set.remove_unfinished(self._at(suffix))
            self._data_set.take(self._at(suffix), theirs.path(suffix))

    def missing(self, n: int) -> list[int]:
        """The indices below `n` of samples that are neither in the tar nor a part."""
        found = self.joined() | self.parts().keys()
        return [index for index in self.indices(n) if index not in found]

    @property
    def _data_set(self) -> Folder:
        return Folder(self.folder.parent)

    @property
    def _unfinished(self) -> PurePath:
        """The folder, in the data set, for files that are being written."""
        return self._at("parts") / (f"{self.run}.run" if self.run else "")

    def _at(self, suffix: str) -> PurePath:
        """The shard's file or folder with this suffix, in the data set."""
        return PurePath(self.folder.name, self.path(suffix).name)

    def _remove(self, path: PurePath) -> None:
        if self._data_set.is_folder(path):
            self._data_set.remove_tree(path)
        else:
            self._data_set.remove(path)

    def _joined_by_index(self) -> set[int]:
        path, places = self.path("parquet"), place_columns(self.names[-1:])
        data = read_bounded(path, MAX_READ_BYTES)
        try:
            rows = read_index(data, str(path), ["index", *places])
        except FormatError as error:
            self._expect_recipe(data)
            raise FormatError(f"{error}; {REMEDY}") from None
        end = max((sum(place) for place in zip(*(rows[name].to_pylist() for name in places), strict=True)), default=0)
        tar = self.path("tar")
        size = tar.stat().st_size if tar.exists() else 0
        if size < end:
            raise FormatError(f"{tar}: expected at least {end} bytes, got {size}; {REMEDY}")
        return set(rows["index"].to_pylist())

    def _expect_recipe(self, index: bytes) -> None:
        """Raise InputError if the shard was made with another recipe."""
        try:
            found, path = read_recipe(index, str(self.path("parquet"))), self.path("parquet")
            lines = list(differences(json.loads(found), json.loads(self.recipe))) if found and self.recipe else []
        except ValueError:
            return
        if lines:
            raise InputError(*(f"{path}: {line.replace('in this dataset', 'in this shard')}" for line in lines))

    def _places_in_tar(self) -> dict[int, TarSpan]:
        tar = self.path("tar")
        places, problem = scan(tar, self.names) if tar.exists() else ({}, "")
        if problem and self.path("parquet").exists():
            raise FormatError(f"{problem}; {REMEDY}")
        return places

    def _place_of_part(self, index: int, path: Path) -> TarSpan:
        places, problem = scan(path, self.names)
        if problem or list(places) != [index]:
            raise FormatError(problem or f"{path}: expected sample {index}, got {list(places)}")
        return places[index]

    def _read(self, index: int, place: TarSpan, offset: int) -> tuple[bytes, dict[str, Any]]:
        """A sample's bytes and its row of the index, once they stand at `offset`."""
        with open_regular(place.path) as stream:
            stream.seek(place.offset)
            data = stream.read(place.end - place.offset)
        where = f"{place.path}: {key_of(index)}"
        empty = [name for name, (_, size) in place.members.items() if not size]
        if empty:
            raise FormatError(f"{where}.{empty[0]}: expected a file with contents, got an empty one")
        moved = {name: (start - place.offset + offset, size) for name, (start, size) in place.members.items()}
        return data, index_row(
            key_of(index),
            moved,
            hashlib.sha256(data).hexdigest(),
            scene_module.from_json(_member(data, place, SCENE), f"{where}.{SCENE}") if SCENE in self.names else None,
            labels_module.from_json(_member(data, place, LABELS), f"{where}.{LABELS}"),
            None if SCENE in self.names else numbers_of_lifted(self.frames, index),
        )


def scan(path: Path, names: tuple[str, ...]) -> tuple[dict[int, TarSpan], str]:
    """The whole samples of a tar up to the first fault, by index, and the fault in words ("" for none). Raises OSError
    for a tar that cannot be read."""
    places: dict[int, TarSpan] = {}
    group: list[tuple[str, int, int]] = []
    try:
        with open_regular(path) as tar:
            for member in tar_members(tar, os.fstat(tar.fileno()).st_size):
                group.append(member)
                if len(group) == len(names):
                    index, place = _place(path, names, group)
                    places[index] = place
                    group = []
        if group or not places:
            raise FormatError(f"expected samples of {len(names)} members, got {len(group)} more members")
    except FormatError as error:
        return places, f"{path}: not a whole tar: {error}"
    return places, ""


def _place(path: Path, names: tuple[str, ...], group: Sequence[tuple[str, int, int]]) -> tuple[int, TarSpan]:
    """The index and the bytes of a sample, from its members in a tar. Raises FormatError for unexpected members."""
    found = [name for name, _, _ in group]
    key = found[0].partition(".")[0]
    if not key.isdecimal() or found != [f"{key_of(int(key))}.{name}" for name in names]:
        raise FormatError(f"expected {', '.join(names)} of one sample, got {', '.join(found):.80}")
    where = {name: (offset, size) for name, (_, offset, size) in zip(names, group, strict=True)}
    end = sum(where[names[-1]])
    return int(key), TarSpan(path, where[names[0]][0] - BLOCK, end + -end % BLOCK, where)


def _member(data: bytes, place: TarSpan, name: str) -> bytes:
    start, size = place.members[name]
    return data[start - place.offset : start - place.offset + size]


def _is_part(name: PurePath) -> bool:
    return name.suffix == ".tar" and name.stem.isdecimal()
