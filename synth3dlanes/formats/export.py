"""Export a whole dataset to a foreign format: streaming, parallel, resumable.

Frames go in chunks. A chunk writes its images and own label files, then its mark in `OUT/.parts`, whose existence
means that the chunk is done. The files that many frames share (lists, JSON lines, README) are put together from the
marks at the end, so a run that was killed, or a dataset that has grown, only needs the missing chunks. Unfinished files
that are renamed when they are whole are in `OUT/.parts` too, from where the next run removes them.
A README says what the export holds.
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePath
from typing import Any

from pydantic import RootModel

from synth3dlanes.dataset.description import is_lifted
from synth3dlanes.dataset.locks import LOCK_FILE, locks
from synth3dlanes.formats.format import Format, PinholeFormat, SampleFormat, open_format
from synth3dlanes.formats.one_frame import write_as_it_is, write_resampled
from synth3dlanes.formats.plan import DEALT_EVERY, Chunk, ExportSplit, open_reader, parts_of, plan
from synth3dlanes.formats.reading import json_lines, json_object, read_text
from synth3dlanes.formats.writing import PARTS, Part, Pinhole
from synth3dlanes.system.arguments import checked
from synth3dlanes.system.errors import ClaimedError, FormatError, InputError
from synth3dlanes.system.files import Draft, Folder
from synth3dlanes.system.processes import n_workers, process_pool
from synth3dlanes.system.schema import Excerpt, PathBelow, parse

MOST_ENLARGED = 1.5


@dataclass(frozen=True)
class ExportSummary:
    """The widest camera, None if images keep their own; frames by part (train, val, test) and by split; frames left out
    and lanes dropped by reason; focal lengths; how many times images were enlarged at most; frames in each of the
    format's lists."""

    camera: Pinhole | None
    n_frames: Counter[str]
    n_of_split: Counter[tuple[str, str]]
    left_out: Counter[str]
    n_lines: int
    dropped: Counter[str]
    f_px: tuple[float, ...]
    enlarged: float
    n_of_list: dict[str, int]

    def text(self, counted: str) -> str:
        """In lines; `counted` is what a line is called."""
        frames = ", ".join(f"{self.n_frames[part]} {part}" for part in PARTS)
        left_out = (f"left out {count} frames: {reason}" for reason, count in self.left_out.items())
        return "\n".join([f"{frames} frames, {self.n_lines} {counted}", *left_out])

    def document(self) -> dict[str, Any]:
        frames = {part: self.n_frames[part] for part in PARTS}
        return {"frames": frames, "lines": self.n_lines, "left_out": dict(self.left_out), "dropped": dict(self.dropped)}


def summarize(records: Iterable[dict[str, Any]], foreign: Format) -> ExportSummary:
    """Count what the chunks' records say of their frames."""
    camera = foreign.camera if isinstance(foreign, PinholeFormat) else None
    n_of_list = dict.fromkeys(foreign.lists, 0)
    n_frames, left_out, dropped = Counter[str](), Counter[str](), Counter[str]()
    n_of_split, n_lines, f_px, enlarged = Counter[tuple[str, str]](), 0, set[float](), 0.0
    for record in records:
        if record["left_out"]:
            left_out[record["left_out"]] += 1
            continue
        n_frames[record["part"]] += 1
        n_of_split[record["split"], record["part"]] += 1
        n_lines += record["n_lines"]
        dropped.update(record["dropped"])
        for path in {path for _, paths in record["shared"] for path in paths if path in n_of_list}:
            n_of_list[path] += 1
        if camera is not None:
            f_px.add(record["f_px"] or camera.f_px)
            enlarged = max(enlarged, record["enlarged"] or 0.0)
    return ExportSummary(
        camera, n_frames, n_of_split, left_out, n_lines, dropped, tuple(sorted(f_px)), enlarged, n_of_list
    )


def warnings(out: Path, foreign: Format, summary: ExportSummary) -> tuple[str, ...]:
    """What a user should know of the export before training on it."""
    found = []
    words = [word for word in foreign.replaced_words if word in str(out.absolute())]
    if words:
        found.append(f"{out.absolute()}: tools of this format replace {', '.join(words)} in the whole path: move it")
    if summary.enlarged > MOST_ENLARGED:
        advice = "render larger ones" + (
            ", or choose a smaller size" if isinstance(foreign, PinholeFormat) and foreign.is_size_free else ""
        )
        found.append(f"{out}: images were enlarged {summary.enlarged:.1f} times{_size(summary, 'to')}: {advice}")
    return tuple(found)


def readme(
    source: str, format_name: str, foreign: Format, splits: Sequence[ExportSplit], summary: ExportSummary
) -> str:
    """`OUT/README.md`."""
    dropped = [f"| lane: {reason} | {count} |" for reason, count in summary.dropped.most_common()]
    left_out = [f"| frame: {reason} | {count} |" for reason, count in summary.left_out.most_common()]
    lines = [
        f"# {format_name} export of {source}",
        "",
        foreign.readme,
        f"{sum(summary.n_frames.values())} frames{_size(summary, 'of')} with {summary.n_lines} {foreign.counted}"
        f"{_focal_lengths(summary)}.",
        "",
        "| split of the data set | used as | frames |",
        "|---|---|---|",
        *(f"| {split} | {part} | {count} |" for (split, part), count in sorted(summary.n_of_split.items())),
        "",
        *_how_parts_were_made(splits, summary),
        "| left out because | count |",
        "|---|---|",
        *(left_out + dropped or ["| (nothing was left out) | 0 |"]),
        "",
        *_lists(summary),
        f"`synth3dlanes export {source} --format {format_name} --out FOLDER --verify` compares it with the labels.",
        "",
    ]
    return "\n".join(lines)


def _lists(summary: ExportSummary) -> list[str]:
    if not summary.n_of_list:
        return []
    rows = [f"| `{path}` | {count} |" for path, count in summary.n_of_list.items()]
    return ["| list | frames |", "|---|---|", *rows, ""]


def _size(summary: ExportSummary, word: str) -> str:
    return "" if summary.camera is None else f" {word} {summary.camera.width_px}x{summary.camera.height_px}"


def _focal_lengths(summary: ExportSummary) -> str:
    if not summary.f_px:
        return ""
    shortest, longest = summary.f_px[0], summary.f_px[-1]
    return f", f = {shortest:g} px" if shortest == longest else f", f = {shortest:g} to {longest:g} px"


def _how_parts_were_made(splits: Sequence[ExportSplit], summary: ExportSummary) -> list[str]:
    has_test = summary.n_frames["test"] > 0
    parts, sentences = parts_of(splits, has_test), []
    if any(split.is_dealt for split in splits):
        ends = " and ".join(str(end) for end in range(DEALT_EVERY - 1, 10, DEALT_EVERY))
        fifth = f"those of every fifth scene (numbers that end in {ends})"
        is_so = f"{fifth} were made test frames." if has_test else f"with more scenes, {fifth} become test frames."
        sentences.append(f"The data set has neither val nor test frames: {is_so}")
    for lacking, other in (("val", "test"), ("test", "val")):
        if lacking not in parts and other in parts:
            sentences.append(f"It has no {lacking} frames: tools that open {lacking} find the {other} frames.")
    return [*sentences, ""] if sentences else []


MARKS = ".parts"
MOST_OPEN = 200
"""Shared files that are written at a time."""
FRAMES_A_START = 10
"""Frames that are written in the time that another process takes to start."""
LAYOUT = 3
"""Exports of an earlier layout are not continued."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Export:
    """What is exported where: every split under `source`, or the one split or sample that it names, to folder `out`.

    `size_px` is the images' width and height, by default the format's. `cameras` names those of a rig whose frames are
    wanted; by default those that look ahead, and all where the format takes images as they are. Raises InputError for
    a format, size or pass that is not there.
    """

    source: str
    out: Path
    format_name: str
    size_px: tuple[int, int] | None
    cameras: tuple[str, ...]

    @checked
    def __init__(
        self,
        source: str | Path,
        out: str | Path,
        format_name: str,
        size_px: tuple[int, int] | None = None,
        cameras: str | Sequence[str] = (),
    ) -> None:
        names = (cameras,) if isinstance(cameras, str) else tuple(cameras)
        size = None if size_px is None else (size_px[0], size_px[1])
        given = {"source": str(source), "out": Path(out), "format_name": format_name, "size_px": size, "cameras": names}
        for name, value in given.items():
            object.__setattr__(self, name, value)

    @cached_property
    def format(self) -> Format:
        """The format with images of this size."""
        foreign = open_format(self.format_name)
        kept = "that of the data set's images"
        if isinstance(foreign, PinholeFormat):
            own_px = (foreign.camera.width_px, foreign.camera.height_px)
            if self.size_px is None or self.size_px == own_px:
                return foreign
            if foreign.is_size_free:
                return replace(foreign, camera=foreign.camera.resized(*self.size_px))
            kept = f"{own_px[0]}x{own_px[1]}, which the tools of {self.format_name} assume"
        elif self.size_px is None:
            return foreign
        got = f"{self.size_px[0]}x{self.size_px[1]}"
        raise InputError(f"size: expected {kept} (`list formats` names those of any size), got {got}")

    @cached_property
    def chunks(self) -> list[Chunk]:
        """The frames of the data set, in chunks."""
        foreign = self.format
        if not isinstance(foreign, SampleFormat):
            return plan(self.source, self.cameras)
        chunks = plan(self.source, self.cameras, foreign.is_per_scene, takes_rigs=True)
        for url in dict.fromkeys(chunk.url for chunk in chunks):
            description = open_reader(url).description
            if is_lifted(description):
                told = "one that was lifted from a real drive, of which only the lanes are known"
                raise InputError(f"{url}: expected a data set of scenes for {self.format_name}, got {told}")
            found = description["render"]["passes"]
            if set(foreign.passes) - set(found):
                needed, given = ", ".join(foreign.passes), ", ".join(found) or "none"
                raise InputError(
                    f"{url}: expected the passes {needed} (generate --passes) for {self.format_name}, got {given}"
                )
        return chunks

    @property
    def options(self) -> dict[str, Any]:
        camera = self.format.camera if isinstance(self.format, PinholeFormat) else None
        return {
            "format": self.format_name,
            "layout": LAYOUT,
            "size_px": None if camera is None else [camera.width_px, camera.height_px],
            "source": self.source,
            "splits": {chunk.split.name: chunk.split.part for chunk in self.chunks},
            **({"cameras": list(self.cameras)} if self.cameras else {}),
        }

    @checked
    def write(self, workers: int = 1, progress: Progress = lambda done, total: None) -> ExportSummary:
        """Write it, or what is missing of it, by `workers` processes (0: one per core, fewer for few frames);
        `progress` gets (frames done, frames in all). Raises ClaimedError while another process or thread writes it."""
        if workers < 0:
            raise InputError(f"workers: expected 0 or more, got {workers}")
        foreign, chunks, folder = self.format, self.chunks, Folder(self.out)
        with _claimed(folder, self.options):
            for stale in set(folder.names(MARKS)) - {chunk.mark for chunk in chunks} - {LOCK_FILE}:
                _remove(folder, stale)
            folder.sync(MARKS)
            marks = [folder.root / MARKS / chunk.mark for chunk in chunks]
            waiting = [chunk for chunk, mark in zip(chunks, marks, strict=True) if not mark.exists()]
            total = sum(len(chunk.places) for chunk in chunks)
            done = total - sum(len(chunk.places) for chunk in waiting)
            progress(done, total)
            for n_frames in _run(waiting, self.out, foreign, workers):
                done += n_frames
                progress(done, total)
            for link, target in foreign.links.items():
                if folder.exists(target) and not folder.is_folder(link):
                    folder.link(link, target)
            _write_shared(folder, marks, foreign)
            summary = summarize(_records(marks), foreign)
            text = readme(self.source, self.format_name, foreign, [chunk.split for chunk in chunks], summary)
            folder.write("README.md", text.encode(), MARKS)
        return summary

    def warnings(self, summary: ExportSummary) -> tuple[str, ...]:
        """What a user should know of it before training on it."""
        return warnings(self.out, self.format, summary)


@contextmanager
def _claimed(folder: Folder, options: dict[str, Any]) -> Iterator[None]:
    """This export's folder, made or checked, while nobody else writes it. What the export cannot have (an error of the
    data set) before any chunk is done leaves the folder as it was."""
    made = [path for path in (folder.root, *folder.root.parents) if not path.exists()]
    if not folder.exists("export.json") and set(folder.names()) - {MARKS}:
        raise InputError(
            f"{folder.root}: expected an empty folder or an unfinished export, got a folder with other files"
        )
    folder.make(MARKS)
    with locks(folder, MARKS) as held:
        # One that is refused removes its lock file.
        if not held.take(0) or not folder.exists(f"{MARKS}/{LOCK_FILE}"):
            raise ClaimedError(f"{folder.root}: expected no other export at work here, got one; wait until it is done")
        is_new = not folder.exists("export.json")
        if not is_new:
            _require_options(folder.root, options, "an empty folder or the export")
        folder.write("export.json", json.dumps(options).encode(), MARKS)
        try:
            yield
        except (InputError, FormatError):
            if is_new and folder.names(MARKS) == [LOCK_FILE]:
                _remove_refused(folder, made)
            raise


def _remove_refused(folder: Folder, made: Sequence[Path]) -> None:
    """Remove what is left of an export none of whose frames is kept: its folders, which are empty, those that were
    `made` for it, and its marks."""
    for path in sorted(folder.root.rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink():
            folder.remove_empty(path.relative_to(folder.root))
    if set(folder.names()) == {MARKS, "export.json"}:
        for name in (f"{MARKS}/{LOCK_FILE}", "export.json"):
            folder.remove(name)
        folder.remove_empty(MARKS)
        for path in made:
            Folder(path.parent).remove_empty(path.name)


def _require_options(out: Path, options: dict[str, Any], expected: str = "the export") -> None:
    about = out / "export.json"
    found = json_object(read_text(about), str(about))
    if found != options:
        keys = [key for key in {**options, **found} if options.get(key) != found.get(key)]
        wanted, got = (", ".join(f"{key} {side.get(key)}" for key in keys) for side in (options, found))
        raise InputError(f"{out}: expected {expected} of {wanted}, got that of {got}; choose another folder")


def _run(chunks: Sequence[Chunk], out: Path, foreign: Format, workers: int) -> Iterator[int]:
    n_frames = sum(len(chunk.places) for chunk in chunks)
    workers = n_workers(workers, min(len(chunks), math.ceil(n_frames / FRAMES_A_START)))
    if workers == 1 or len(chunks) < 2:
        for chunk in chunks:
            yield _export_chunk(chunk, out, foreign)
        return
    with process_pool(workers) as pool:
        for future in as_completed([pool.submit(_export_chunk, chunk, out, foreign) for chunk in chunks]):
            yield future.result()


def _export_chunk(chunk: Chunk, out: Path, foreign: Format) -> int:
    reader = open_reader(chunk.url)
    assert isinstance(foreign, PinholeFormat | SampleFormat)
    folder, records = Folder(out), list[dict[str, Any]]()
    try:
        for place in chunk.places:
            if isinstance(foreign, PinholeFormat):
                records.append(write_resampled(reader, place, chunk, out, foreign))
            else:
                records.append(write_as_it_is(reader, place, chunk, out, foreign))
    except (InputError, FormatError):
        for path in _files(records):
            folder.remove(path)
        raise
    paths = list(_files(records))
    for path in paths:
        folder.sync_file(path)
    for above in {parent for path in paths for parent in PurePath(path).parents}:
        folder.sync(above)
    folder.write(f"{MARKS}/{chunk.mark}", "\n".join(map(json.dumps, records)).encode())
    return len(records)


def _remove(folder: Folder, mark: str) -> None:
    """Undo a chunk whose frames have changed; the lists that name them are written anew at the end. An unfinished mark
    names no frames."""
    if not mark.endswith(".tmp"):
        records = list(_records([folder.root / MARKS / mark]))
        for path in (*_files(records), *_shared(records)):
            folder.remove(path)
    folder.remove(f"{MARKS}/{mark}")


def _files(records: Iterable[dict[str, Any]]) -> Iterator[str]:
    """The files that frames have for themselves."""
    return (path for record in records for path in record.get("files", ()))


def _shared(records: Iterable[dict[str, Any]]) -> dict[str, None]:
    """The files that frames share."""
    return dict.fromkeys(path for record in records for _, paths in record.get("shared", ()) for path in paths)


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


@dataclass(frozen=True)
class Written:
    """What the marks of an export say: the chunk and the place of the sample of each file that a frame has for itself,
    and the files that many frames share."""

    samples: dict[str, tuple[str, int]]
    frames: tuple[tuple[str, ...], ...]
    shared: tuple[str, ...]


def written(job: Export) -> Written:
    """Read the marks of a finished export. Raises FormatError for frames that it lacks, InputError for another
    export."""
    _require_options(job.out, job.options)
    samples, frames, shared = dict[str, tuple[str, int]](), list[tuple[str, ...]](), dict.fromkeys(job.format.lists)
    for chunk in job.chunks:
        for place, record in zip(chunk.places, _records([job.out / MARKS / chunk.mark]), strict=True):
            files = tuple(record.get("files", ()))
            samples |= {path: (chunk.url, place) for path in files}
            frames += [files] if files else []
            shared |= _shared([record])
    return Written(samples, tuple(frames), tuple(sorted(shared)))


def _records(marks: Sequence[Path]) -> Iterator[dict[str, Any]]:
    for mark in marks:
        for number, line in enumerate(json_lines(mark), start=1):
            yield parse(_Record, line, f"{mark}:{number}", "a frame of an export").root.model_dump()


def _write_shared(folder: Folder, marks: Sequence[Path], foreign: Format) -> None:
    found = dict.fromkeys(foreign.lists) | _shared(_records(marks))
    for start in range(0, len(found), MOST_OPEN):
        _write_some(folder, marks, foreign, list(found)[start : start + MOST_OPEN])


def _write_some(folder: Folder, marks: Sequence[Path], foreign: Format, shared: Sequence[str]) -> None:
    # Frames with lines come first: Anchor3DLane fails on a list whose first frame has none. Every line ends in a
    # newline, also the last: tools join files, and read them by line.
    with ExitStack() as stack:
        files: dict[str, Draft] = {}
        for path in shared:
            folder.make(PurePath(path).parent)
            files[path] = stack.enter_context(folder.draft(path, MARKS))
        for with_lines in (True, False):
            for record in _records(marks):
                if record["left_out"] or (record["n_lines"] > 0) != with_lines:
                    continue
                for text, paths in record["shared"]:
                    for path in files.keys() & paths:
                        files[path].stream.write(f"{text}\n".encode())
        for path, draft in files.items():
            if foreign.document is None:
                draft.appear()
                continue
            draft.stream.flush()
            with folder.replacing(path, MARKS) as document:
                pieces = foreign.document(path, draft.path)
                document.writelines(piece.encode() if isinstance(piece, str) else piece for piece in pieces)
