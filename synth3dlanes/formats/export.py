"""Export a whole dataset to a foreign format: streaming, parallel, resumable.

Frames go in chunks. A chunk writes its images and own label files, then its mark in `OUT/.parts`, whose existence
means that the chunk is done. The files that many frames share (lists, JSON lines, README) are put together from the
marks at the end, so a run that was killed, or a dataset that has grown, only needs the missing chunks.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from multiprocessing import get_context
from pathlib import Path
from typing import IO, Any

import numpy as np

from synth3dlanes import scene as scene_format
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.remove_roll import labels_without_roll
from synth3dlanes.dataset.write import write_whole
from synth3dlanes.errors import InputError
from synth3dlanes.formats.apollo import write as apollo
from synth3dlanes.formats.culane import write as culane
from synth3dlanes.formats.curvelanes import write as curvelanes
from synth3dlanes.formats.lines import scene_tags
from synth3dlanes.formats.once import write as once
from synth3dlanes.formats.openlane import write as openlane
from synth3dlanes.formats.plan import Chunk, open_reader, plan
from synth3dlanes.formats.resample import fitting_pinhole, resample
from synth3dlanes.formats.summary import Summary, readme, summarize
from synth3dlanes.formats.tusimple import write as tusimple
from synth3dlanes.formats.writing import Format, Frame, Part, Pinhole
from synth3dlanes.labels import Labels
from synth3dlanes.scene import Scene

LAYOUT = 2
"""Exports of an earlier layout are not continued."""
FRAMES_PER_SPLIT = 10**8
JPEG_QUALITY = 95
EXPOSURE_STEPS = (5 / 3, 7 / 3)  # thirds of the paper's range 1..3
NO_LINES = "no lane line is left, which the benchmark cannot score"
NARROW = "its field of view is narrower than the format's one camera"

FORMATS: dict[str, Format] = {
    "apollo": apollo.FORMAT,
    "openlane": openlane.FORMAT,
    "once": once.FORMAT,
    "tusimple": tusimple.FORMAT,
    "culane": culane.FORMAT,
    "curvelanes": curvelanes.FORMAT,
}


def export(
    source: str,
    out: Path,
    format_name: str,
    workers: int,
    progress: Callable[[int, int], None],
    size_px: tuple[int, int] | None = None,
    cameras: Sequence[str] = (),
) -> Summary:
    """Export every split under `source`, or the one that it names; `progress` gets (frames done, frames in all).
    `size_px` is the images' width and height, by default the format's. `cameras` names those of a rig whose frames are
    wanted; by default those that look ahead."""
    foreign = FORMATS[format_name]
    camera = _camera(foreign, format_name, size_px)
    chunks = plan(source, cameras)
    splits = {chunk.split.name: chunk.split.part for chunk in chunks}
    size = [camera.width_px, camera.height_px]
    options = {"format": format_name, "layout": LAYOUT, "size_px": size, "source": source, "splits": splits}
    _claim(out, options | ({"cameras": list(cameras)} if cameras else {}))
    marks = out / ".parts"
    for stale in {path.name for path in marks.iterdir()} - {chunk.mark for chunk in chunks}:
        _remove(out, marks / stale)
    waiting = [chunk for chunk in chunks if not (marks / chunk.mark).exists()]
    total = sum(len(chunk.places) for chunk in chunks)
    done = total - sum(len(chunk.places) for chunk in waiting)
    progress(done, total)
    for n_frames in _run(waiting, out, format_name, camera, workers):
        done += n_frames
        progress(done, total)
    for link, target in foreign.links.items():
        if not (out / link).is_symlink():
            (out / link).symlink_to(target)
    paths = [marks / chunk.mark for chunk in chunks]
    _write_shared(out, paths, foreign.lists)
    summary = summarize(_records(paths), camera)
    text = readme(source, format_name, foreign.readme, [chunk.split for chunk in chunks], summary)
    (out / "README.md").write_text(text)
    return summary


def _camera(foreign: Format, format_name: str, size_px: tuple[int, int] | None) -> Pinhole:
    own_px = (foreign.camera.width_px, foreign.camera.height_px)
    if size_px is None or size_px == own_px:
        return foreign.camera
    if not foreign.is_size_free:
        free = ", ".join(name for name, other in FORMATS.items() if other.is_size_free)
        expected = f"{own_px[0]}x{own_px[1]}, which the tools of {format_name} assume (other sizes: {free})"
        raise InputError(f"size: expected {expected}, got {size_px[0]}x{size_px[1]}")
    return foreign.camera.resized(*size_px)


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


def _run(chunks: Sequence[Chunk], out: Path, format_name: str, camera: Pinhole, workers: int) -> Iterator[int]:
    if workers == 1 or len(chunks) < 2:
        for chunk in chunks:
            yield _export_chunk(chunk, out, format_name, camera)
        return
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        for future in as_completed([pool.submit(_export_chunk, chunk, out, format_name, camera) for chunk in chunks]):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _export_chunk(chunk: Chunk, out: Path, format_name: str, camera: Pinhole) -> int:
    reader, foreign = open_reader(chunk.url), FORMATS[format_name]
    records = [_export_frame(reader, place, chunk, out, foreign, camera) for place in chunk.places]
    write_whole(out / ".parts" / chunk.mark, "\n".join(map(json.dumps, records)).encode())
    return len(records)


def _export_frame(
    reader: Reader, index: int, chunk: Chunk, out: Path, foreign: Format, camera: Pinhole
) -> dict[str, Any]:
    sample = reader[index]
    where = f"{chunk.url}:{sample.key}"
    scene, labels = scene_format.from_json(sample.scene_json, where), labels_without_roll(sample.labels)
    part = chunk.split.part_of(int(reader.scene_of[index]))
    record = {"split": chunk.split.name, "part": part}
    pinhole = fitting_pinhole(sample.labels.camera, camera)
    if pinhole != camera and not foreign.is_f_free:
        return {**record, "left_out": NARROW}
    annotation = foreign.annotate(labels, _frame(sample.key, chunk, part, pinhole, scene, labels))
    if annotation is None:
        return {**record, "left_out": NO_LINES}
    image = out / annotation.image
    image.parent.mkdir(parents=True, exist_ok=True)
    resample(sample.image, sample.labels.camera, pinhole, where).save(image, quality=JPEG_QUALITY)
    for path, content in annotation.files.items():
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_bytes(content if isinstance(content, bytes) else content.encode())
    return {
        **record,
        "left_out": None,
        "f_px": pinhole.f_px,
        "enlarged": pinhole.f_px / float(sample.labels.camera.img_from_cam[0, 0]),
        "n_lines": annotation.n_lines,
        "dropped": annotation.dropped,
        "files": [annotation.image, *annotation.files],
        "shared": annotation.shared,
    }


def _frame(key: str, chunk: Chunk, part: Part, pinhole: Pinhole, scene: Scene, labels: Labels) -> Frame:
    return Frame(
        split=chunk.split.name,
        key=key,
        number=chunk.split.number * FRAMES_PER_SPLIT + int(key),
        part=part,
        parts=chunk.parts,
        pinhole=pinhole,
        tags=scene_tags(labels, pinhole),
        illumination=int(np.digitize(scene.light.exposure, EXPOSURE_STEPS)),
    )


def _remove(out: Path, mark: Path) -> None:
    """Undo a chunk whose frames have changed; the lists that name them are written anew at the end."""
    for record in _records([mark]):
        lists = (path for _, paths in record.get("shared", ()) for path in paths)
        for path in (*record.get("files", ()), *lists):
            (out / path).unlink(missing_ok=True)
    mark.unlink()


def _records(marks: Sequence[Path]) -> Iterator[dict[str, Any]]:
    for mark in marks:
        with mark.open() as file:
            for line in file:
                yield json.loads(line)


def _write_shared(out: Path, marks: Sequence[Path], lists: Sequence[str]) -> None:
    # Frames with lines come first: Anchor3DLane fails on a list whose first frame has none. No newline at the end
    # of a file: the evaluators trip over a blank last line.
    with ExitStack() as stack:
        files: dict[str, IO[str]] = {}

        def opened(path: str) -> IO[str]:
            if path not in files:
                (out / path).parent.mkdir(parents=True, exist_ok=True)
                files[path] = stack.enter_context((out / f"{path}.tmp").open("w"))
            return files[path]

        for path in lists:
            opened(path)
        for with_lines in (True, False):
            for record in _records(marks):
                if record["left_out"] or (record["n_lines"] > 0) != with_lines:
                    continue
                for text, paths in record["shared"]:
                    for path in paths:
                        file = opened(path)
                        file.write(f"\n{text}" if file.tell() else text)
    for path in files:
        os.replace(out / f"{path}.tmp", out / path)
