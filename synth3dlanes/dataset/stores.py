"""Data sets at a URL (fsspec: s3://, gs://, sftp://, ...). A shard exists once its parquet file does.

A store is no file system: nothing there is locked or continued in place. A shard is fetched, continued on this
machine's own disk (`spool`), and put back whole: the tar first, the index last. Two runs that make the same shard put
the same bytes; if one has more samples, it keeps them.
"""

import os
import secrets
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from synth3dlanes.dataset.address import (
    MAX_READ_BYTES,
    connect,
    kinds,
    listed_splits,
    read_file,
    translate_store_errors,
)
from synth3dlanes.dataset.description import DESCRIPTION, updated_description
from synth3dlanes.dataset.folder import COMPANIONS, updated_companions
from synth3dlanes.dataset.index import read_indices
from synth3dlanes.dataset.write import Shard, scan
from synth3dlanes.system.errors import InputError, OutageError
from synth3dlanes.system.files import Folder, open_regular, read_bounded

# Stores whose objects appear whole, as do those in memory. In others a file is written beside, and renamed.
ATOMIC = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "oci", "cos", "obs", "tos", "memory"}
# How often what was written is read again and, if another run has written in between, mended.
MAX_ROUNDS = 20
# Two runs that begin together have read the same before either writes. The wait after writing is longer than from
# reading to writing: at least SETTLE_S, and SLOWER times what this run took, as others may be slower.
SETTLE_S, SLOWER = 0.5, 4


def announce(url: str, recipe: dict[str, Any], split: str, n: int) -> None:
    """Write `dataset.json` and its companions; raise InputError where the store holds another recipe's samples.

    Runs that begin together each read and write it. So what was written is read again after a while, until it says
    what this run asks for beside what others do. Equal runs write equal bytes.
    """
    files, root = connect(url)
    for _ in range(MAX_ROUNDS):
        began = time.monotonic()
        with translate_store_errors(url):
            before = _description(files, url, root)
            after = updated_description(before, recipe, split, n, f"{url}/{DESCRIPTION}")
            beside = {name: read_file(files, f"{root}/{name}") for name in COMPANIONS}
            asked = {DESCRIPTION: after, **updated_companions(beside, after, f"{url}/{DESCRIPTION}")}
        there = {DESCRIPTION: before, **beside}
        if there == asked:
            return
        for name, data in asked.items():
            if data != there[name]:
                put_bytes(url, name, data)
        settle_s = max(SETTLE_S, SLOWER * (time.monotonic() - began))
        time.sleep(settle_s * (1 + secrets.randbelow(100) / 100))
    raise OutageError(f"{url}/{DESCRIPTION}: other runs change it all the time")


def indices(url: str, shard: Shard) -> set[int]:
    """The indices of the samples of a shard in the store; none if the shard does not exist."""
    data = _index(url, shard)
    return set() if data is None else read_indices(data, f"{url}/{_names(shard)[1]}")


def take(url: str, shard: Shard) -> None:
    """Copy what the store has of a shard into `shard` on this machine, beside the samples that are here."""
    theirs, index = _index(url, shard), shard.path("parquet")
    if theirs is None or (index.exists() and read_bounded(index, MAX_READ_BYTES) == theirs):
        return
    tar, name = _names(shard)
    unjoin(shard, shard, read_indices(theirs, f"{url}/{name}"))
    here = Folder(shard.folder)
    for suffix in ("parquet", "tar"):
        here.remove(shard.path(suffix).name)
    files, root = connect(url)
    temporary = shard.path(f"{secrets.token_hex(8)}.tmp")
    try:
        with translate_store_errors(f"{url}/{tar}"):
            files.get_file(f"{root}/{tar}", str(temporary))
        os.replace(temporary, shard.path("tar"))
    finally:
        temporary.unlink(missing_ok=True)
    here.write(index.name, theirs)


def put_shard(url: str, shard: Shard) -> None:
    """Copy a shard to the store: the old index is removed before the new tar is put, and the new index is put last.
    Samples that another run has put meanwhile are kept."""
    files, root = connect(url)
    tar, name = _names(shard)
    for _ in range(MAX_ROUNDS):
        theirs, ours = _index(url, shard), read_bounded(shard.path("parquet"), MAX_READ_BYTES)
        if theirs == ours and _size(url, tar) == shard.path("tar").stat().st_size:
            return
        if theirs is not None:
            others, own = (read_indices(data, f"{url}/{name}") for data in (theirs, ours))
            if others > own:
                return
            if others - own:
                take(url, shard)
                shard.join(max(others | own) + 1)
            with translate_store_errors(f"{url}/{name}"), suppress(FileNotFoundError):
                files.rm_file(f"{root}/{name}")
        put(url, [tar, name], shard.folder.parent)
    raise OutageError(f"{url}/{tar}: other runs change it all the time")


def unjoin(shard: Shard, into: Shard, but: set[int]) -> None:
    """Write the samples of a shard's tar as parts of `into`, except those with some indices."""
    tar = shard.path("tar")
    if not tar.exists():
        return
    with open_regular(tar) as stream:
        for number, place in scan(tar, shard.names)[0].items():
            if number in but:
                continue
            members = {}
            for member, (offset, size) in place.members.items():
                stream.seek(offset)
                members[member] = stream.read(size)
            replace(into, run="").write_part(number, members)


def put(url: str, names: list[str], folder: Path) -> None:
    """Copy files of a folder in this order. Each appears whole."""
    for name in names:
        _put(url, name, lambda files, path, source=folder / name: files.put_file(str(source), path))


def put_bytes(url: str, name: str, data: bytes) -> None:
    """Write a file. It appears whole."""
    _put(url, name, lambda files, path: files.pipe_file(path, data))


def _put(url: str, name: str, write: Any) -> None:
    files, root = connect(url)
    path = f"{root}/{name}"
    with translate_store_errors(f"{url}/{name}"):
        # Elsewhere a path begins with a bucket, which would be made without a word; folders need no making there.
        if root.startswith("/"):
            files.makedirs(path.rpartition("/")[0], exist_ok=True)
        if ATOMIC & kinds(files):
            write(files, path)
            return
        beside = PurePosixPath(path).with_name(f".{PurePosixPath(path).name}.{secrets.token_hex(8)}.tmp")
        try:
            write(files, str(beside))
            files.mv(str(beside), path)
        except BaseException:
            with suppress(Exception):
                files.rm_file(str(beside))
            raise


def _description(files: Any, url: str, root: str) -> bytes | None:
    """The current `dataset.json`, None for a new store."""
    found = read_file(files, f"{root}/{DESCRIPTION}")
    if found is None:
        files.invalidate_cache()
        if listed_splits(files, root):
            # Perhaps of a run that has written both since.
            found = read_file(files, f"{root}/{DESCRIPTION}")
            if found is None:
                raise InputError(f"{url}/{DESCRIPTION}: missing, but there are shards beside it")
    return found


def _index(url: str, shard: Shard) -> bytes | None:
    """The current index of a shard in the store, None if the shard does not exist."""
    files, root = connect(url)
    name = _names(shard)[1]
    with translate_store_errors(f"{url}/{name}"):
        return read_file(files, f"{root}/{name}")


def _size(url: str, name: str) -> int | None:
    files, root = connect(url)
    with translate_store_errors(f"{url}/{name}"):
        files.invalidate_cache()
        with suppress(FileNotFoundError):
            return int(files.size(f"{root}/{name}"))
    return None


def _names(shard: Shard) -> tuple[str, str]:
    tar, index = (f"{shard.folder.name}/{shard.path(suffix).name}" for suffix in ("tar", "parquet"))
    return tar, index
