"""Read an export back and compare it with the labels of the data set: `export --verify`."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.comparing import Comparison, SourceSample
from synth3dlanes.formats.export import Export, Written, written
from synth3dlanes.formats.format import FrameList, PinholeFormat, ReadFrame
from synth3dlanes.formats.plan import open_reader
from synth3dlanes.formats.reading import image_header
from synth3dlanes.words import counted

MOST_PROBLEMS = 20


@dataclass(frozen=True)
class DistanceMeasure:
    """How far the lines of some frames are from those of the labels; `unit` is m or px."""

    unit: str
    worst: float
    median: float
    tolerance: float


@dataclass(frozen=True)
class Verification:
    """Some frames of an export, compared with the labels; `problems` is empty where the export is right."""

    name: str
    n_frames: int
    n_lines: int
    n_matched: int
    measures: tuple[DistanceMeasure, ...]
    problems: tuple[str, ...]

    def text(self) -> str:
        """The result as lines of text."""
        frames, compared = counted(self.n_frames, "frame"), counted(self.n_lines, "line")
        lines = [f"{self.name}: {frames}, {self.n_matched} of {compared} as in the labels"]
        lines += (
            f"  worst {measure.worst:.4f} {measure.unit}, median {measure.median:.4f} {measure.unit}"
            f" (at most {measure.tolerance:g} {measure.unit})"
            for measure in self.measures
        )
        return "\n".join(lines)

    def document(self) -> dict[str, Any]:
        """The result as JSON values."""
        measures = {measure.unit: {k: v for k, v in vars(measure).items() if k != "unit"} for measure in self.measures}
        return {**vars(self), "measures": measures, "problems": list(self.problems)}


@dataclass
class _Tally:
    """What is known of the frames of a list so far."""

    n_frames: int = 0
    n_lines: int = 0
    n_matched: int = 0
    gaps: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    tracks: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def add(self, where: str, found: Comparison, tolerances: dict[str, float]) -> None:
        self.n_frames += 1
        self.n_lines += found.n_lines
        self.problems += [f"{where}: {problem}" for problem in found.problems]
        off = {gap.lane for gap in found.gaps if not gap.worst <= tolerances[gap.unit]}
        # A line may be compared in metres and in pixels.
        self.n_matched += len({gap.lane for gap in found.gaps} - off)
        for gap in found.gaps:
            self.gaps.setdefault(gap.unit, []).append((gap.worst, gap.median))
        for track, lane in found.tracks.items():
            if self.tracks.setdefault(track, lane) != lane:
                self.problems.append(f"{where}: track {track}: expected {self.tracks[track]} as before, got {lane}")


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
    if not any(result.n_lines for result in verified):
        problems.append(f"{job.out}: expected {job.format.counted} to compare, found none")
    return (*verified, *([Verification("lists", 0, 0, 0, (), _shortened(problems))] if problems else []))


def _verified(job: Export, frames: FrameList, marks: Written, seen: set[str]) -> Verification:
    foreign, tally = job.format, _Tally()
    for frame in frames.frames:
        if frame.file not in marks.samples:
            raise FormatError(f"{frame.where}: expected a frame of this export, got {frame.file}")
        seen.add(frame.file)
        url, place = marks.samples[frame.file]
        truth = SourceSample(open_reader(url), place)
        tally.problems += _image_problems(job, frame, truth)
        tally.add(frame.where, foreign.verify(frame, truth), dict(foreign.tolerances))
    measures = tuple(
        DistanceMeasure(
            unit,
            max(worst for worst, _ in gaps),
            float(np.median([median for _, median in gaps])),
            foreign.tolerances[unit],
        )
        for unit, gaps in tally.gaps.items()
    )
    counts = tally.n_frames, tally.n_lines, tally.n_matched
    return Verification(frames.name, *counts, measures, _shortened(tally.problems))


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
