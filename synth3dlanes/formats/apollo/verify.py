"""The self-check of an Apollo export."""

from collections.abc import Iterator
from pathlib import Path

from synth3dlanes.formats.apollo.convention import ROOT
from synth3dlanes.formats.apollo.read import ApolloFrame, parse
from synth3dlanes.formats.apollo.score import RULES, prune, score
from synth3dlanes.formats.line_score import Line3d
from synth3dlanes.formats.reading import first_lines
from synth3dlanes.formats.self_check import Benchmark3d, Verification, image_problems, verify_3d

BENCHMARK = Benchmark3d(score, prune, RULES.missing_m)


def verify(out: Path, size_px: tuple[int, int], most_frames: int) -> Iterator[Verification]:
    """Lane lines and centre lines of every list."""
    for path in sorted((out / "data_splits").glob("*/*.json")):
        name = str(path.relative_to(out))
        lines = enumerate(first_lines(path, most_frames), start=1)
        frames = [parse(line, f"{path}:{number}") for number, line in lines]
        if not frames:
            continue
        problems = image_problems([out / ROOT / frame.raw_file for frame in frames], size_px)
        for kind in ("lane", "center"):
            true = [_lines(frame, is_center=kind == "center") for frame in frames]
            yield verify_3d(f"{name} {kind} lines", true, problems, BENCHMARK)


def _lines(frame: ApolloFrame, is_center: bool) -> list[Line3d]:
    lines = (frame.lane_lines_apollo, frame.lane_lines_visible)
    centers = (frame.center_lines_apollo, frame.center_lines_visible)
    return [Line3d(points, visible) for points, visible in zip(*(centers if is_center else lines), strict=True)]
