"""Read an export back and compare it with the labels of the data set: `export --verify`."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from synth3dlanes.formats.comparing import Comparison, SourceSample
from synth3dlanes.formats.export import Export, Written, written
from synth3dlanes.formats.format import FrameList, PinholeFormat, ReadFrame
from synth3dlanes.formats.plan import open_reader
from synth3dlanes.formats.reading import image_header
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.words import counted

MOST_PROBLEMS = 20


@dataclass(frozen=True)
class DistanceMeasure:
    """How far the things of some frames are from those of the labels; `unit` is m or px."""

    unit: str
    worst: float
    median: float
    tolerance: float


@dataclass(frozen=True)
class Compared:
    """How many things of one kind an export has: those that were compared, those of them that are as in the labels, and
    those outside, which the labels do not reach."""

    n: int
    n_matched: int
    n_outside: int


@dataclass(frozen=True)
class Verification:
    """Some frames of an export, compared with the labels: what was compared by its word. `frame` is what one is called;
    `problems` is empty where the export is right."""

    name: str
    frame: str
    n_frames: int
    compared: Mapping[str, Compared]
    measures: tuple[DistanceMeasure, ...]
    problems: tuple[str, ...]

    @property
    def n(self) -> int:
        return sum(of.n for of in self.compared.values())

    @property
    def n_matched(self) -> int:
        """How many of them are as in the labels."""
        return sum(of.n_matched for of in self.compared.values())

    def text(self) -> str:
        things = ", ".join(
            f"{of.n_matched:,} of {counted(of.n, *_noun(word))}" for word, of in self.compared.items() if of.n
        )
        lines = [f"{self.name}: {counted(self.n_frames, self.frame)}; as in the labels: {things or 'nothing'}"]
        lines += (
            f"  not compared: {counted(of.n_outside, *_noun(word))} that the labels do not reach"
            for word, of in self.compared.items()
            if of.n_outside
        )
        lines += (
            f"  worst {measure.worst:.4f} {measure.unit}, median {measure.median:.4f} {measure.unit}"
            f" (at most {measure.tolerance:g} {measure.unit})"
            for measure in self.measures
        )
        return "\n".join(lines)

    def document(self) -> dict[str, Any]:
        measures = {measure.unit: {k: v for k, v in vars(measure).items() if k != "unit"} for measure in self.measures}
        compared = {_noun(word)[1]: vars(of) for word, of in self.compared.items()}
        return {
            "name": self.name,
            "n_frames": self.n_frames,
            "compared": compared,
            "measures": measures,
            "problems": list(self.problems),
        }


def _noun(word: str) -> tuple[str, str]:
    return word, f"{word}es" if word.endswith("x") else f"{word}s"


def verify(job: Export, most_frames: int = 500) -> tuple[Verification, ...]:
    """Compare at most the first `most_frames` frames of every list of a finished export with the labels."""
    marks = written(job)
    seen, verified = set[str](), list[Verification]()
    for frames in job.format.read(job.out, most_frames):
        verified.append(_verified(job, frames, marks, seen))
    gone = [path for path in marks.shared if not (job.out / path).is_file()]
    problems = [f"{job.out / path}: expected a list, got no file" for path in gone]
    if all(result.n_frames < most_frames for result in verified):
        unlisted = [files for files in marks.frames if seen.isdisjoint(files)]
        problems += [f"{job.out}: expected {files[0]} in a list, got it in none" for files in unlisted]
    if not any(result.n for result in verified):
        problems.append(f"{job.out}: expected {job.format.counted} to compare, found none")
    return (*verified, *([Verification("lists", "frame", 0, {}, (), _shortened(problems))] if problems else []))


def _verified(job: Export, frames: FrameList, marks: Written, seen: set[str]) -> Verification:
    foreign, found = job.format, list[Comparison]()
    problems, tracks = list[str](), dict[str, str]()
    for frame in frames.frames:
        if frame.file not in marks.samples:
            raise FormatError(f"{frame.where}: expected a frame of this export, got {frame.file}")
        seen |= {frame.file, *frame.more_images}
        url, place = marks.samples[frame.file]
        truth = SourceSample(open_reader(url), place)
        problems += _image_problems(job, frame, truth)
        compared = foreign.verify(frame, truth)
        problems += (f"{frame.where}: {problem}" for problem in compared.problems)
        for track, lane in compared.tracks.items():
            if tracks.setdefault(track, lane) != lane:
                problems.append(f"{frame.where}: track {track}: expected {tracks[track]} as before, got {lane}")
        found.append(compared)
    apart = dict[str, list[tuple[float, float]]]()
    n, n_matched, n_outside = Counter[str](), Counter[str](), Counter[str]()
    for compared in found:
        # A line may be compared in metres and in pixels.
        things = {(gap.word, gap.name) for gap in compared.gaps}
        off = {(gap.word, gap.name) for gap in compared.gaps if not gap.worst <= foreign.tolerances[gap.unit]}
        n += Counter(word for word, _ in things) + compared.strange
        n_matched += Counter(word for word, _ in things - off)
        n_outside += compared.outside
        for gap in compared.gaps:
            apart.setdefault(gap.unit, []).append((gap.worst, gap.median))
    measures = tuple(
        DistanceMeasure(
            unit, max(worst for worst, _ in gaps), float(np.median([m for _, m in gaps])), foreign.tolerances[unit]
        )
        for unit, gaps in apart.items()
    )
    words = {word: Compared(n[word], n_matched[word], n_outside[word]) for word in sorted(n | n_outside)}
    return Verification(frames.name, frames.word, len(found), words, measures, _shortened(problems))


def _image_problems(job: Export, frame: ReadFrame, truth: SourceSample) -> Iterator[str]:
    """Findings where the image is missing, or of another width, height or kind."""
    if frame.image is None:
        return
    camera = job.format.camera if isinstance(job.format, PinholeFormat) else truth.labels.camera
    path, expected = job.out / frame.image, f"{camera.width_px}x{camera.height_px}"
    if not path.is_file():
        yield f"{frame.where}: expected the image {path}, found no file"
        return
    width_px, height_px, kind = image_header(path)
    if (width_px, height_px) != (camera.width_px, camera.height_px) or kind not in ("JPEG", "PNG"):
        yield f"{path}: expected a picture of {expected}, got {kind} of {width_px}x{height_px}"


def _shortened(problems: list[str]) -> tuple[str, ...]:
    kept = list(Counter(problems))
    more = len(kept) - MOST_PROBLEMS
    return (*kept[:MOST_PROBLEMS], *([f"and {more} more problems"] if more > 0 else []))
