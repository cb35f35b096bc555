"""The self-check of an OpenLane-V2 export."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.openlane_v2.convention import CENTERLINE_POINTS, ROOT
from synth3dlanes.formats.openlane_v2.read import TopologyFrame, frames, parse
from synth3dlanes.formats.openlane_v2.score import LanePolylines, LaneScore, LaneTopology, score
from synth3dlanes.formats.reading import image_size, read_text
from synth3dlanes.formats.self_check import TOLERANCE_M, Verification

# The benchmark matches lanes up to 3 m apart, far ones up to 6 m; up, where no lane is, a move leads to no other one.
RAISED_M = np.array([0.0, 0.0, 7.0])
SCORED_POINTS = 10


def verify(out: Path, most_frames: int) -> Iterator[Verification]:
    """The lanes of every part: its centre lines, then its lane segments."""
    for part, paths in frames(out).items():
        for name, suffix in ((part, ""), (f"{part}, lane segments", "-ls")):
            files = [path.with_name(f"{path.stem}{suffix}.json") for path in paths[:most_frames]]
            yield _verified(out, name, [(str(path), parse(read_text(path), str(path))) for path in files])


def _verified(out: Path, name: str, found: list[tuple[str, TopologyFrame]]) -> Verification:
    true = [LaneTopology(tuple(map(_scored, frame.lanes_ego)), frame.follows) for _, frame in found]
    raised = [
        LaneTopology(tuple(tuple(line + RAISED_M for line in lane) for lane in frame.lanes), frame.follows)
        for frame in true
    ]
    perfect = score([(frame, frame) for frame in true])
    moved = score(list(zip(true, raised, strict=True)))
    problems = [problem for where, frame in found for problem in _problems(out, where, frame)]
    if perfect != LaneScore(1.0, 1.0):
        problems.append(f"{name}: expected ground truth to score 1, got {perfect}")
    if moved.det_l > 0:
        problems.append(f"{name}: expected lanes moved {RAISED_M[2]:g} m up to score 0, got {moved}")
    return Verification(
        name, len(found), sum(len(frame.lanes) for frame in true), asdict(perfect), asdict(moved), tuple(problems)
    )


def _scored(lane: tuple[np.ndarray, ...]) -> LanePolylines:
    """The points of a lane that the devkit keeps: every 20th of a centre line, ten of a lane segment."""
    step = (CENTERLINE_POINTS - 1) // SCORED_POINTS
    if len(lane) == 1:
        return (lane[0][::step],)
    return tuple(line[np.linspace(0, len(line) - 1, SCORED_POINTS).round().astype(int)] for line in lane)


def _problems(out: Path, where: str, frame: TopologyFrame) -> Iterator[str]:
    for image in frame.images.values():
        try:
            image_size(out / ROOT / image)
        except FormatError as error:
            yield f"{where}: expected the image {image}: {error}"
    for i, j in np.argwhere(frame.follows):
        gap_m = float(np.linalg.norm(frame.lanes_ego[i][0][-1] - frame.lanes_ego[j][0][0]))
        if gap_m > TOLERANCE_M:
            yield f"{where}: expected lane {j} to begin where lane {i} ends, got a gap of {gap_m:.3f} m"
