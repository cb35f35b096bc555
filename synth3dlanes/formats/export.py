"""Export a whole dataset to a foreign format: streaming, parallel, resumable.

Frames go in chunks. A chunk writes its images and own label files, then its mark in `OUT/.parts`, whose existence
means that the chunk is done. The files that many frames share (lists, JSON lines, README) are put together from the
marks at the end, so a run that was killed, or a dataset that has grown, only needs the missing chunks.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

from pydantic import RootModel

from synth3dlanes.errors import InputError
from synth3dlanes.files import Draft, Folder
from synth3dlanes.formats.apollo import write as apollo
from synth3dlanes.formats.coco import write as coco
from synth3dlanes.formats.culane import write as culane
from synth3dlanes.formats.curvelanes import write as curvelanes
from synth3dlanes.formats.masks import write as masks
from synth3dlanes.formats.once import write as once
from synth3dlanes.formats.one_frame import write_as_it_is, write_resampled
from synth3dlanes.formats.opendrive import write as opendrive
from synth3dlanes.formats.openlane import write as openlane
from synth3dlanes.formats.openlane_v2 import write as openlane_v2
from synth3dlanes.formats.plan import Chunk, open_reader, plan
from synth3dlanes.formats.reading import json_lines, json_object, read_text
from synth3dlanes.formats.sample_format import SampleFormat
from synth3dlanes.formats.summary import ExportSummary, readme, summarize
from synth3dlanes.formats.tusimple import write as tusimple
from synth3dlanes.formats.writing import Format, Part, PinholeFormat
from synth3dlanes.formats.yolo import write as yolo
from synth3dlanes.processes import process_pool
from synth3dlanes.schema import Excerpt, PathBelow, parse

MARKS = ".parts"
LAYOUT = 3
"""Exports of an earlier layout are not continued."""

FORMATS: dict[str, PinholeFormat | SampleFormat] = {
    "apollo": apollo.FORMAT,
    "openlane": openlane.FORMAT,
    "once": once.FORMAT,
    "tusimple": tusimple.FORMAT,
    "culane": culane.FORMAT,
    "curvelanes": curvelanes.FORMAT,
    "openlane_v2": openlane_v2.FORMAT,
    "opendrive": opendrive.FORMAT,
    "coco": coco.FORMAT,
    "masks": masks.FORMAT,
    "yolo": yolo.FORMAT,
}


def export(
    source: str,
    out: Path,
    format_name: str,
    workers: int,
    progress: Callable[[int, int], None],
    size_px: tuple[int, int] | None = None,
    cameras: Sequence[str] = (),
) -> ExportSummary:
    """Export every split under `source`, or the one split or sample that it names; `progress` gets (frames done, frames
    in all). `size_px` is the images' width and height, by default the format's. `cameras` names those of a rig whose
    frames are wanted; by default those that look ahead, and all where the format takes images as they are."""
    foreign = _sized(format_name, size_px)
    camera = foreign.camera if isinstance(foreign, PinholeFormat) else None
    is_per_scene = isinstance(foreign, SampleFormat) and foreign.is_per_scene
    chunks = plan(source, cameras, is_per_scene, isinstance(foreign, SampleFormat))
    if isinstance(foreign, SampleFormat):
        _require_passes(foreign, format_name, chunks)
    splits = {chunk.split.name: chunk.split.part for chunk in chunks}
    size = None if camera is None else [camera.width_px, camera.height_px]
    options = {"format": format_name, "layout": LAYOUT, "size_px": size, "source": source, "splits": splits}
    folder = Folder(out)
    _claim(folder, options | ({"cameras": list(cameras)} if cameras else {}))
    marks = out / MARKS
    for stale in set(folder.names(MARKS)) - {chunk.mark for chunk in chunks}:
        _remove(folder, stale)
    waiting = [chunk for chunk in chunks if not (marks / chunk.mark).exists()]
    total = sum(len(chunk.places) for chunk in chunks)
    done = total - sum(len(chunk.places) for chunk in waiting)
    progress(done, total)
    for n_frames in _run(waiting, out, foreign, workers):
        done += n_frames
        progress(done, total)
    for link, target in foreign.links.items():
        folder.link(link, target)
    paths = [marks / chunk.mark for chunk in chunks]
    _write_shared(folder, paths, foreign)
    summary = summarize(_records(paths), foreign)
    text = readme(source, format_name, foreign, [chunk.split for chunk in chunks], summary)
    folder.write("README.md", text.encode())
    return summary


def _sized(format_name: str, size_px: tuple[int, int] | None) -> PinholeFormat | SampleFormat:
    """The format with images of this size."""
    foreign = FORMATS[format_name]
    kept = "that of the data set's images"
    if isinstance(foreign, PinholeFormat):
        own_px = (foreign.camera.width_px, foreign.camera.height_px)
        if size_px is None or size_px == own_px:
            return foreign
        if foreign.is_size_free:
            return replace(foreign, camera=foreign.camera.resized(*size_px))
        kept = f"{own_px[0]}x{own_px[1]}, which the tools of {format_name} assume"
    elif size_px is None:
        return foreign
    free = ", ".join(name for name, other in FORMATS.items() if isinstance(other, PinholeFormat) and other.is_size_free)
    raise InputError(f"size: expected {kept} (other sizes: {free}), got {size_px[0]}x{size_px[1]}")


def _require_passes(foreign: SampleFormat, format_name: str, chunks: Sequence[Chunk]) -> None:
    for url in dict.fromkeys(chunk.url for chunk in chunks):
        found = open_reader(url).description["render"]["passes"]
        if set(foreign.passes) - set(found):
            needed, given = ", ".join(foreign.passes), ", ".join(found) or "none"
            raise InputError(f"{url}: expected the passes {needed} (generate --passes) for {format_name}, got {given}")


def _claim(folder: Folder, options: dict[str, Any]) -> None:
    """Make this export's folder, or check that it is."""
    out, mark = folder.root, folder.root / "export.json"
    if mark.exists():
        found = json_object(read_text(mark), str(mark))
        if found != options:
            raise InputError(f"{out}: expected an empty folder or the export {options}, got the export {found}")
    elif out.exists() and any(out.iterdir()):
        raise InputError(f"{out}: expected an empty folder or an unfinished export, got a folder with other files")
    folder.make(MARKS)
    folder.write("export.json", json.dumps(options).encode())


def _run(chunks: Sequence[Chunk], out: Path, foreign: PinholeFormat | SampleFormat, workers: int) -> Iterator[int]:
    if workers == 1 or len(chunks) < 2:
        for chunk in chunks:
            yield _export_chunk(chunk, out, foreign)
        return
    with process_pool(workers) as pool:
        for future in as_completed([pool.submit(_export_chunk, chunk, out, foreign) for chunk in chunks]):
            yield future.result()


def _export_chunk(chunk: Chunk, out: Path, foreign: PinholeFormat | SampleFormat) -> int:
    reader = open_reader(chunk.url)
    records = [
        write_resampled(reader, place, chunk, out, foreign)
        if isinstance(foreign, PinholeFormat)
        else write_as_it_is(reader, place, chunk, out, foreign)
        for place in chunk.places
    ]
    Folder(out).write(f"{MARKS}/{chunk.mark}", "\n".join(map(json.dumps, records)).encode())
    return len(records)


def _remove(folder: Folder, mark: str) -> None:
    """Undo a chunk whose frames have changed; the lists that name them are written anew at the end. An unfinished mark
    names no frames."""
    if not mark.endswith(".tmp"):
        for record in _records([folder.root / MARKS / mark]):
            lists = (path for _, paths in record.get("shared", ()) for path in paths)
            for path in (*record.get("files", ()), *lists):
                folder.remove(path)
    folder.remove(f"{MARKS}/{mark}")


class _LeftOut(Excerpt):
    split: str
    part: Part
    left_out: str


class _Written(Excerpt):
    split: str
    part: Part
    left_out: None
    n_lines: int
    dropped: dict[str, int]
    files: tuple[PathBelow, ...]
    shared: tuple[tuple[str, tuple[PathBelow, ...]], ...]
    f_px: float | None = None
    enlarged: float | None = None


class _Record(RootModel[_LeftOut | _Written]):
    """What a mark says of a frame. The files that it names are removed or written."""


def shared_files(out: Path, format_name: str) -> list[str]:
    """The lists and other files that an export has of many frames, by its marks."""
    found = dict.fromkeys(FORMATS[format_name].lists)
    for record in _records(sorted((out / ".parts").glob("*.jsonl"))):
        found |= dict.fromkeys(path for _, paths in record.get("shared", ()) for path in paths)
    return sorted(found)


def _records(marks: Sequence[Path]) -> Iterator[dict[str, Any]]:
    for mark in marks:
        for number, line in enumerate(json_lines(mark), start=1):
            yield parse(_Record, line, f"{mark}:{number}", "a frame of an export").root.model_dump()


def _write_shared(folder: Folder, marks: Sequence[Path], foreign: Format) -> None:
    # Frames with lines come first: Anchor3DLane fails on a list whose first frame has none. Every line ends in a
    # newline, also the last: tools join files, and read them by line.
    with ExitStack() as stack:
        files: dict[str, Draft] = {}

        def opened(path: str) -> Draft:
            if path not in files:
                folder.make(PurePath(path).parent)
                folder.remove_unfinished(path)
                files[path] = stack.enter_context(folder.draft(path))
            return files[path]

        for path in foreign.lists:
            opened(path)
        for with_lines in (True, False):
            for record in _records(marks):
                if record["left_out"] or (record["n_lines"] > 0) != with_lines:
                    continue
                for text, paths in record["shared"]:
                    for path in paths:
                        opened(path).stream.write(f"{text}\n".encode())
        for path, draft in files.items():
            if foreign.document is None:
                draft.appear()
                continue
            draft.stream.flush()
            with folder.replacing(path) as document:
                document.writelines(text.encode() for text in foreign.document(path, draft.path))
