"""Export a whole dataset to a foreign format: streaming, parallel, resumable.

Frames go in chunks. A chunk writes its images and own label files, then its part in `OUT/.parts`, whose existence
means that the chunk is done. The files that many frames share (lists, JSON lines, README) are put together from the
parts at the end, so a run that was killed, or a dataset that has grown, only needs the missing chunks.
"""

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import IO, Any

import fsspec
import numpy as np

from synth3dlanes import scene as scene_format
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.upright import upright_labels
from synth3dlanes.dataset.write import write_whole
from synth3dlanes.errors import InputError
from synth3dlanes.formats.apollo import write as apollo
from synth3dlanes.formats.lines import scene_tags
from synth3dlanes.formats.once import write as once
from synth3dlanes.formats.openlane import write as openlane
from synth3dlanes.formats.resample import resample
from synth3dlanes.formats.tusimple import write as tusimple
from synth3dlanes.formats.writing import Format, Frame

FRAMES_PER_CHUNK = 50
FRAMES_PER_SPLIT = 10**8
JPEG_QUALITY = 95
EXPOSURE_STEPS = (5 / 3, 7 / 3)  # thirds of the paper's range 1..3
NO_LINES = "no lane line is left, which the benchmark cannot score"


FORMATS: dict[str, Format] = {
    "apollo": apollo.FORMAT,
    "openlane": openlane.FORMAT,
    "once": once.FORMAT,
    "tusimple": tusimple.FORMAT,
}


@dataclass(frozen=True)
class Chunk:
    """Frames `start` to `stop` of one split. `every_fifth_tests`: the dataset has no split of its own for tests.
    `part` names the done mark after the frames, so that a chunk that has got others is a new one."""

    source: str
    split: str
    split_number: int
    every_fifth_tests: bool
    start: int
    stop: int
    part: str


@dataclass(frozen=True)
class Summary:
    """What an export holds."""

    n_train: int
    n_test: int
    n_left_out: int
    n_lines: int
    dropped: Counter[str]


def export(source: str, out: Path, format_name: str, workers: int, progress: Callable[[int, int], None]) -> Summary:
    """Export every split under `source`; `progress` gets (frames done, frames in all)."""
    chunks = _plan(source)
    _claim(out, {"format": format_name, "source": source, "splits": sorted({chunk.split for chunk in chunks})})
    parts = out / ".parts"
    for stale in {path.name for path in parts.iterdir()} - {chunk.part for chunk in chunks}:
        (parts / stale).unlink()
    waiting = [chunk for chunk in chunks if not (parts / chunk.part).exists()]
    total = sum(chunk.stop - chunk.start for chunk in chunks)
    done = total - sum(chunk.stop - chunk.start for chunk in waiting)
    progress(done, total)
    for n_frames in _run(waiting, out, format_name, workers):
        done += n_frames
        progress(done, total)
    for link, target in FORMATS[format_name].links.items():
        if not (out / link).is_symlink():
            (out / link).symlink_to(target)
    _write_shared(out, [parts / chunk.part for chunk in chunks])
    summary = _summary([parts / chunk.part for chunk in chunks])
    (out / "README.md").write_text(_readme(source, format_name, summary))
    return summary


def _plan(source: str) -> list[Chunk]:
    filesystem, root = fsspec.url_to_fs(source)
    splits = sorted({path.rsplit("/", 2)[-2] for path in filesystem.glob(f"{root.rstrip('/')}/*/*.parquet")})
    if not splits:
        raise InputError(f"{source}: expected a dataset with finished shards (split/00000.parquet), found none")
    source = source.rstrip("/")
    chunks = []
    for number, split in enumerate(splits):
        reader = _reader(f"{source}/{split}")
        for start in range(0, len(reader), FRAMES_PER_CHUNK):
            stop = min(start + FRAMES_PER_CHUNK, len(reader))
            part = f"{number}-{reader.key(start)}-{reader.key(stop - 1)}-{stop - start}.jsonl"
            chunks.append(Chunk(source, split, number, len(splits) == 1, start, stop, part))
    return chunks


def _claim(out: Path, options: dict[str, Any]) -> None:
    """Make `out` this export's folder, or check that it is."""
    mark = out / "export.json"
    if mark.exists():
        found = json.loads(mark.read_text())
        if found != options:
            raise InputError(f"{out}: expected an empty folder or the export {options}, got the export {found}")
    elif out.exists() and any(out.iterdir()):
        raise InputError(f"{out}: expected an empty folder or an unfinished export, got a folder with other files")
    (out / ".parts").mkdir(parents=True, exist_ok=True)
    write_whole(mark, json.dumps(options).encode())


def _run(chunks: Sequence[Chunk], out: Path, format_name: str, workers: int) -> Iterator[int]:
    if workers == 1 or len(chunks) < 2:
        for chunk in chunks:
            yield _export_chunk(chunk, out, format_name)
        return
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        for future in as_completed([pool.submit(_export_chunk, chunk, out, format_name) for chunk in chunks]):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


@lru_cache(maxsize=8)
def _reader(url: str) -> Reader:
    return Reader(url)


def _export_chunk(chunk: Chunk, out: Path, format_name: str) -> int:
    reader = _reader(f"{chunk.source}/{chunk.split}")
    foreign, indices = FORMATS[format_name], range(chunk.start, chunk.stop)
    records = [_export_frame(reader, index, chunk, out, foreign) for index in indices]
    write_whole(out / ".parts" / chunk.part, "\n".join(map(json.dumps, records)).encode())
    return len(records)


def _export_frame(reader: Reader, index: int, chunk: Chunk, out: Path, foreign: Format) -> dict[str, Any]:
    sample = reader[index]
    where = f"{chunk.source}/{chunk.split}:{sample.key}"
    scene, labels = scene_format.from_json(sample.scene_json, where), upright_labels(sample.labels)
    frame = Frame(
        split=chunk.split,
        key=sample.key,
        number=chunk.split_number * FRAMES_PER_SPLIT + int(sample.key),
        is_train=int(sample.key) % 5 != 4 if chunk.every_fifth_tests else chunk.split == "train",
        tags=scene_tags(labels, foreign.camera),
        illumination=int(np.digitize(scene.light.exposure, EXPOSURE_STEPS)),
    )
    annotation = foreign.annotate(labels, frame)
    if annotation is None:
        return {"is_left_out": True}
    image = out / annotation.image
    image.parent.mkdir(parents=True, exist_ok=True)
    resample(sample.image, sample.labels.camera, foreign.camera, where).save(image, quality=JPEG_QUALITY)
    for path, text in annotation.files.items():
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_text(text)
    return {
        "is_left_out": False,
        "is_train": frame.is_train,
        "n_lines": annotation.n_lines,
        "dropped": annotation.dropped,
        "shared": annotation.shared,
    }


def _records(parts: Sequence[Path]) -> Iterator[dict[str, Any]]:
    for part in parts:
        with part.open() as file:
            for line in file:
                yield json.loads(line)


def _write_shared(out: Path, parts: Sequence[Path]) -> None:
    # Frames with lines come first: Anchor3DLane fails on a list whose first frame has none. No newline at the end
    # of a file: the evaluators trip over a blank last line.
    with ExitStack() as stack:
        files: dict[str, IO[str]] = {}
        for with_lines in (True, False):
            for record in _records(parts):
                if record["is_left_out"] or (record["n_lines"] > 0) != with_lines:
                    continue
                for text, paths in record["shared"]:
                    for path in paths:
                        if path in files:
                            files[path].write("\n")
                        else:
                            (out / path).parent.mkdir(parents=True, exist_ok=True)
                            files[path] = stack.enter_context((out / f"{path}.tmp").open("w"))
                        files[path].write(text)
    for path in files:
        os.replace(out / f"{path}.tmp", out / path)


def _summary(parts: Sequence[Path]) -> Summary:
    counts, dropped = Counter[str](), Counter[str]()
    for record in _records(parts):
        if record["is_left_out"]:
            counts["left_out"] += 1
            continue
        counts["train" if record["is_train"] else "test"] += 1
        counts["lines"] += record["n_lines"]
        dropped.update(record["dropped"])
    return Summary(counts["train"], counts["test"], counts["left_out"], counts["lines"], dropped)


def _readme(source: str, format_name: str, summary: Summary) -> str:
    reasons = [f"| {reason} | {count} |" for reason, count in summary.dropped.most_common()]
    if summary.n_left_out:
        reasons.append(f"| whole frame: {NO_LINES} | {summary.n_left_out} |")
    lines = [
        f"# {format_name} export of {source}",
        "",
        FORMATS[format_name].readme,
        f"{summary.n_train} training and {summary.n_test} test frames with {summary.n_lines} lane lines.",
        "",
        "| dropped because | lanes |",
        "|---|---|",
        *(reasons or ["| (nothing was dropped) | 0 |"]),
        "",
        f"`synth3dlanes export {source} --format {format_name} --out FOLDER --verify` scores the ground truth.",
        "",
    ]
    return "\n".join(lines)
