"""Data sets at a URL (fsspec: s3://, gs://, sftp://, ...). A shard is there once its parquet is.

A store is no file system: nothing there is locked or continued in place. A shard is fetched, continued on this
machine's own disk, and put back whole: the tar first, the index last. Two runs that make the same shard put the same
bytes.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from synth3dlanes.dataset.address import connect, translate_store_errors
from synth3dlanes.dataset.card import CARD, updated_card
from synth3dlanes.dataset.description import DESCRIPTION, updated_description
from synth3dlanes.dataset.index import read_indices
from synth3dlanes.dataset.write import Shard
from synth3dlanes.errors import InputError


def announce(url: str, recipe: dict[str, Any], split: str, n: int) -> None:
    """Write `dataset.json` and its card; raise InputError where the store holds another recipe's samples."""
    files, root = connect(url)
    with translate_store_errors(url):
        where = f"{root}/{DESCRIPTION}"
        before = files.cat_file(where) if files.exists(where) else None
        if before is None and files.glob(f"{root}/*/*.parquet"):
            raise InputError(f"{url}/{DESCRIPTION}: missing, but there are shards beside it")
        after = updated_description(before, recipe, split, n, f"{url}/{DESCRIPTION}")
        card_before = files.cat_file(f"{root}/{CARD}") if files.exists(f"{root}/{CARD}") else None
        card_after = updated_card(card_before, after, f"{url}/{DESCRIPTION}")
        with TemporaryDirectory() as folder:
            for name, old, new in ((DESCRIPTION, before, after), (CARD, card_before, card_after)):
                if new != old:
                    (Path(folder) / name).write_bytes(new)
                    put(url, [name], Path(folder))


def indices(url: str, shard: Shard) -> set[int]:
    """The indices of the samples that a store has in a shard; none where there is no such shard."""
    files, root = connect(url)
    where = shard.path("parquet").as_posix()
    with translate_store_errors(f"{url}/{where}"):
        if not files.exists(f"{root}/{where}"):
            return set()
        return read_indices(files.cat_file(f"{root}/{where}"), f"{url}/{where}")


def fetch_shard(url: str, shard: Shard) -> None:
    """Copy a finished shard, if there is one, to where `shard` has it on this machine, with `dataset.json`."""
    root = shard.folder.parent
    tar, index = _names(shard)
    fetch(url, [index], root)
    if shard.path("parquet").exists():
        fetch(url, [tar, DESCRIPTION], root)


def put_shard(url: str, shard: Shard) -> None:
    """Copy out a shard: the index last, and the old one gone before the new tar comes."""
    files, root = connect(url)
    tar, index = _names(shard)
    with translate_store_errors(f"{url}/{index}"):
        if files.exists(f"{root}/{index}"):
            files.rm_file(f"{root}/{index}")
    put(url, [tar, index], shard.folder.parent)


def fetch(url: str, names: list[str], folder: Path) -> None:
    """Copy files into a folder; those that the store lacks are left out."""
    files, root = connect(url)
    for name in names:
        with translate_store_errors(f"{url}/{name}"):
            if files.exists(f"{root}/{name}"):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                files.get_file(f"{root}/{name}", str(folder / name))


def put(url: str, names: list[str], folder: Path) -> None:
    """Copy files out of a folder, in this order. Each appears by renaming, for stores that show half a file."""
    files, root = connect(url)
    for name in names:
        with translate_store_errors(f"{url}/{name}"):
            # Elsewhere a path begins with a bucket, which would be made without a word; folders need no making there.
            if root.startswith("/"):
                files.makedirs(f"{root}/{name}".rpartition("/")[0], exist_ok=True)
            files.put_file(str(folder / name), f"{root}/{name}.tmp")
            files.mv(f"{root}/{name}.tmp", f"{root}/{name}")


def _names(shard: Shard) -> tuple[str, str]:
    tar, index = (f"{shard.folder.name}/{shard.path(suffix).name}" for suffix in ("tar", "parquet"))
    return tar, index
