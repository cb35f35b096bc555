"""One shard on disk: finished samples are kept one by one, then joined into a tar and its index.

    DIR/train/00000.parts/00000017.tar   a finished sample of a shard in progress; appears whole, by rename
    DIR/train/00000.tar, 00000.parquet   the finished shard; the parquet, written last, says that it is one

Every sample is its own file until the shard is joined. So any number of workers can work on one shard, in any order,
and whoever is killed, whenever, takes with him only the sample at hand. Joining sorts by index, so the bytes do not
depend on any of that; it reads only what is on disk and may be killed and repeated at any point. Samples of a finished
shard take part again when it is joined anew, so a larger n continues it. Nobody but the holder of the shard's lock
(`folder.claim`) joins it.
"""

import os
import tarfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from synth3dlanes import labels as labels_module
from synth3dlanes import scene as scene_module
from synth3dlanes.dataset.format import LABELS, SCENE, key_of, tar_bytes, tar_end
from synth3dlanes.dataset.index import index_row, table
from synth3dlanes.errors import FormatError


@dataclass(frozen=True)
class Place:
    """Where a sample lies: the bytes `offset` to `end` of a tar, and offset and size of each member."""

    path: Path
    offset: int
    end: int
    members: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Shard:
    """Shard `number` of the split in `folder`; `names` are the members of each of its samples, in order."""

    folder: Path
    number: int
    size: int
    names: tuple[str, ...]

    def path(self, suffix: str) -> Path:
        """The shard's file or folder with this suffix."""
        return self.folder / f"{self.number:05d}.{suffix}"

    def indices(self, n: int) -> range:
        """The indices of the samples in this shard of a split of `n`."""
        return range(self.number * self.size, max(self.number * self.size, min(n, (self.number + 1) * self.size)))

    def write_part(self, index: int, members: Mapping[str, bytes]) -> int:
        """Keep one finished sample; return its size in bytes."""
        assert tuple(members) == self.names, f"expected members {self.names}, got {tuple(members)}"
        parts = self.path("parts")
        parts.mkdir(exist_ok=True)
        data = tar_bytes(key_of(index), members)
        write_whole(parts / f"{key_of(index)}.tar", data)
        return len(data)

    def parts(self) -> dict[int, Path]:
        """The samples kept one by one."""
        return {int(path.stem): path for path in self.path("parts").glob("*.tar")}

    def joined(self) -> set[int]:
        """The indices of the samples in the tar."""
        if not self.path("parquet").exists():
            return set(self._places_in_tar())
        rows = self._rows()
        self._check_tar(rows)
        return set(rows["index"].to_pylist())

    def needs_join(self, n: int) -> bool:
        """Whether there are samples below `n` outside the tar, or a tar without its index."""
        has_parts = any(index < n for index in self.parts())
        return has_parts or (self.path("tar").exists() and not self.path("parquet").exists())

    def join(self, n: int) -> None:
        """Join the tar and the parts below `n`. A part that cannot be read is removed: its sample is missing still."""
        places = self._places_in_tar()
        parts = {index: path for index, path in self.parts().items() if index < n and index not in places}
        tar, index = self.path("tar.tmp"), self.path("parquet.tmp")
        rows = []
        with tar.open("wb") as stream:
            for number in sorted([*places, *parts]):
                try:
                    place = places[number] if number in places else self._place_of_part(number, parts[number])
                    data, row = self._read(number, place, stream.tell())
                except FormatError:
                    if number in places:
                        raise
                    parts.pop(number).unlink()
                    continue
                stream.write(data)
                rows.append(row)
            stream.write(tar_end(stream.tell()))
            _sync(stream.fileno())
        with index.open("wb") as stream:
            pq.write_table(table(rows), stream)
            _sync(stream.fileno())
        if rows:
            # Without its index there is no shard, so nobody meets a tar and an index that do not fit.
            self.path("parquet").unlink(missing_ok=True)
            os.replace(tar, self.path("tar"))
            os.replace(index, self.path("parquet"))
            _sync_folder(self.folder)
        self.clean(n)

    def clean(self, n: int) -> None:
        """Remove what a finished or killed join has left over; parts from `n` on stay for a run that wants them."""
        for suffix in ("tar.tmp", "parquet.tmp"):
            self.path(suffix).unlink(missing_ok=True)
        parts = self.path("parts")
        if not parts.is_dir():
            return
        joined = self.joined()
        for path in parts.iterdir():
            if path.suffix != ".tar" or int(path.stem) in joined:
                path.unlink()
        if not any(parts.iterdir()):
            parts.rmdir()

    def _rows(self) -> pa.Table:
        path = self.path("parquet")
        try:
            return pq.read_table(path, columns=["index", f"{self._last_member}_offset", f"{self._last_member}_size"])
        except (pa.ArrowException, OSError, KeyError) as error:
            raise FormatError(f"{path}: expected the index of a shard, got {error}") from None
