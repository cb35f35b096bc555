"""The reader beside other loaders, on the same pictures: `python -m scripts.against_loaders DATA/SPLIT`.

Needs `pip install mosaicml-streaming`. Pictures and labels per second of wall time, by torch's DataLoader with two
processes: ours and Mosaic's streaming at random, webdataset as the tars have them. The split needs no passes, because
webdataset reads whole tars. Rounds take turns; the first round of each is not counted.
"""

import io
import json
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click
import numpy as np
import webdataset
from PIL import Image
from torch.utils.data import DataLoader, Dataset

from synth3dlanes import Reader

WORKERS, SAMPLES = 2, 2000


class Lanes(Dataset[Any]):
    """Samples of a split by number, again and again."""

    def __init__(self, url: str) -> None:
        self.reader = Reader(url)

    def __len__(self) -> int:
        return SAMPLES

    def __getitem__(self, i: int) -> Any:
        sample = self.reader[i % len(self.reader)]
        return sample.image, [lane.xyz_cam for lane in sample.labels.lanes]


def as_it_is(sample: Any) -> Any:
    """The sample, without tensors."""
    return sample


def of_json(sample: dict[str, Any]) -> Any:
    """A picture and the points of its lanes, from decoded members."""
    return np.asarray(sample["jpg"]), [np.array(lane["xyz_cam"]) for lane in sample["labels.json"]["lanes"]]


def ours(url: str) -> Iterable[Any]:
    """At random, by the index."""
    return DataLoader(Lanes(url), batch_size=None, shuffle=True, num_workers=WORKERS, collate_fn=as_it_is)


def tars(url: str) -> Iterable[Any]:
    """In the order of the tars, shuffled within a buffer of 100 samples."""
    paths = sorted(str(path) for path in Path(url).glob("*.tar"))
    split = webdataset.split_by_worker if len(paths) >= WORKERS else webdataset.shardlists.single_node_only
    found = webdataset.WebDataset(paths, shardshuffle=False, workersplitter=split, empty_check=False)
    samples = found.shuffle(100).decode("rgb8").map(of_json).repeat().with_epoch(SAMPLES // WORKERS)
    return DataLoader(samples, batch_size=None, num_workers=WORKERS, collate_fn=as_it_is)


def mosaic(folder: str) -> Iterable[Any]:
    """At random, from shards of Mosaic's own format."""
    from streaming import StreamingDataset  # type: ignore[import-not-found]

    class Mosaic(StreamingDataset):  # type: ignore[misc]
        def __getitem__(self, at: int) -> Any:
            return of_json(super().__getitem__(at))

    samples = Mosaic(local=folder, shuffle=True, batch_size=1, epoch_size=SAMPLES)
    return DataLoader(samples, batch_size=None, num_workers=WORKERS, collate_fn=as_it_is)


def write_mosaic(url: str, folder: str) -> None:
    """The same JPEG files and labels as Mosaic's shards."""
    from streaming import MDSWriter

    reader = Reader(url)
    with MDSWriter(out=folder, columns={"jpg": "jpeg", "labels.json": "json"}) as writer:
        for i in range(len(reader)):
            labels = json.loads(reader.member(i, "labels.json"))
            writer.write({"jpg": Image.open(io.BytesIO(reader.member(i, "jpg"))), "labels.json": labels})


def per_second(loader: Iterable[Any]) -> float:
    """Samples a second, after the first of every process."""
    samples = iter(loader)
    for _ in range(2 * WORKERS):
        next(samples)
    start, n = time.perf_counter(), sum(1 for _ in samples)
    return n / (time.perf_counter() - start)


@click.command()
@click.argument("url")
@click.option("--rounds", default=3, help="Rounds that are counted.")
def main(url: str, rounds: int) -> None:
    """Print samples per second, and each loader's over ours in the same round."""
    with tempfile.TemporaryDirectory() as folder:
        write_mosaic(folder)
        makers: dict[str, Callable[[], Iterable[Any]]] = {
            "ours": lambda: ours(url),
            "webdataset": lambda: tars(url),
            "streaming": lambda: mosaic(url, folder),
        }
        found = [{name: per_second(make()) for name, make in makers.items()} for _ in range(1 + rounds)][1:]
    for name in makers:
        rates = [row[name] for row in found]
        ratios = [row[name] / row["ours"] for row in found]
        spread = f"{min(ratios):.2f} to {max(ratios):.2f}"
        click.echo(f"{name}: {np.median(rates):.0f} a second, {np.median(ratios):.2f} times ours ({spread})")


if __name__ == "__main__":
    main()
