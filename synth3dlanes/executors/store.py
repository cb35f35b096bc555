"""Finished shards at a URL (fsspec: s3://, gs://, sftp://, ...). A shard is done once its parquet is there.

A store is no file system: nothing there is locked or continued in place. A shard is fetched, continued on a node's own
disk, and put back whole. Two runs that make the same shard put the same bytes.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import fsspec
import pyarrow.parquet as pq

from synth3dlanes.dataset.folder import claim
from synth3dlanes.run import Plan


def is_url(out: str) -> bool:
    """Whether this names a store, not a folder."""
    return "://" in out


def announce(plan: Plan, url: str) -> None:
    """Write `dataset.json`; raise ParamsError where the store holds another recipe's samples."""
    with TemporaryDirectory() as folder:
        fetch(url, ["dataset.json"], Path(folder))
        with claim(Path(folder), plan.description(), plan.recipe.split, plan.n, []):
            put(url, ["dataset.json"], Path(folder))


def missing(plan: Plan, url: str) -> dict[int, list[int]]:
    """By shard the indices of the plan's samples that the store does not hold."""
    system, root = fsspec.url_to_fs(url)
    found: dict[int, list[int]] = {}
    for number, shard in plan.layout(Path(root)).items():
        path, present = str(shard.path("parquet")), set[int]()
        if system.exists(path):
            with system.open(path, "rb") as stream:
                present = set(pq.read_table(stream, columns=["index"])["index"].to_pylist())
        found[number] = [index for index in shard.indices(plan.n) if index not in present]
    return found


def fetch(url: str, names: list[str], folder: Path) -> None:
    """Copy files into a folder; those that the store lacks are left out."""
    system, root = fsspec.url_to_fs(url)
    for name in names:
        if system.exists(f"{root}/{name}"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            system.get_file(f"{root}/{name}", str(folder / name))


def put(url: str, names: list[str], folder: Path) -> None:
    """Copy files out of a folder, in this order. Each appears by renaming, for stores that show half a file."""
    system, root = fsspec.url_to_fs(url)
    for name in names:
        system.makedirs(f"{root}/{name}".rpartition("/")[0], exist_ok=True)
        system.put_file(str(folder / name), f"{root}/{name}.tmp")
        system.mv(f"{root}/{name}.tmp", f"{root}/{name}")


def put_shard(plan: Plan, url: str, number: int, folder: Path) -> None:
    """Copy out one shard, its failed scenes and logs: the index last, and the old one gone before the new tar comes."""
    system, root = fsspec.url_to_fs(url)
    shard = plan.layout(folder)[number]
    tar, index = (str(shard.path(suffix).relative_to(folder)) for suffix in ("tar", "parquet"))
    others = [
        str(path.relative_to(folder))
        for kind in ("failed", "logs")
        for path in sorted((folder / kind).rglob("*"))
        if path.is_file()
    ]
    put(url, others, folder)
    if (folder / index).exists():
        if system.exists(f"{root}/{index}"):
            system.rm_file(f"{root}/{index}")
        put(url, [tar, index], folder)
