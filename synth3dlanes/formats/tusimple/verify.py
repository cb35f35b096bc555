"""The self-check of a tuSimple export."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple
from pathlib import Path

import numpy as np
from jaxtyping import Float

from synth3dlanes.errors import FormatError
from synth3dlanes.formats.reading import first_lines
from synth3dlanes.formats.self_check import SHIFT_M, Sidecar, Sidecars, Verification, image_problems, moved_aside
from synth3dlanes.formats.tusimple.convention import ROWS_PX
from synth3dlanes.formats.tusimple.read import TusimpleFrame, parse
from synth3dlanes.formats.tusimple.score import TusimpleScore, score, score_frame
from synth3dlanes.schema import shown


def verify(out: Path, size_px: tuple[int, int], most_frames: int) -> Iterator[Verification]:
    """The lines of every label file."""
    sidecars = Sidecars(out)
    for path in sorted(out.glob("*label*.json")):
        lines = enumerate(first_lines(path, most_frames), start=1)
        frames = [_parse(line, f"{path}:{number}") for number, line in lines]
        if not frames:
            continue
        true = [frame.lanes_u_px for frame in frames]
        perfect = score([(lanes, lanes.copy()) for lanes in true], ROWS_PX.astype(float))
        shifted = _score_shifted(frames, sidecars)
        problems = image_problems([out / frame.raw_file for frame in frames], size_px)
        if perfect != TusimpleScore(1.0, 0.0, 0.0):
            problems.append(f"{path.name}: expected ground truth to score 1, 0, 0, got {perfect}")
        if shifted.false_negative < 0.95:
            problems.append(f"{path.name}: expected lines moved {SHIFT_M} m aside to be missed, got {shifted}")
        yield Verification(
            path.name, len(frames), sum(map(len, true)), asdict(perfect), asdict(shifted), tuple(problems)
        )


def _parse(line: str, where: str) -> TusimpleFrame:
    frame = parse(line, where)
    if not np.array_equal(frame.rows_px, ROWS_PX):
        raise FormatError(
            f"{where}: h_samples: expected the rows of the benchmark, got {shown(frame.rows_px.tolist())}"
        )
    return frame


def _score_shifted(frames: Sequence[TusimpleFrame], sidecars: Sidecars) -> TusimpleScore:
    """Every line alone and moved, scored on its own rows, by which it counts.

    The official score takes rows where both lines are absent for right, so over all rows nobody can miss a short line.
    """
    scores, weights = [], []
    for frame in frames:
        moved_u_px = _moved_rows(frame.lanes_u_px, sidecars[frame.raw_file])
        for true, moved in zip(frame.lanes_u_px, moved_u_px, strict=True):
            own = true >= 0
            if not own.any():
                continue
            scores.append(astuple(score_frame(true[None, own], moved[None, own], frame.rows_px[own].astype(float))))
            weights.append(np.count_nonzero(own))
    if not scores:
        return TusimpleScore(0.0, 1.0, 1.0)
    return TusimpleScore(*np.average(scores, axis=0, weights=weights))


def _moved_rows(lanes_u_px: Float[np.ndarray, "l r"], sidecar: Sidecar) -> Float[np.ndarray, "l r"]:
    points_img = np.stack(np.broadcast_arrays(lanes_u_px, ROWS_PX.astype(float)), axis=-1)
    return np.where(lanes_u_px >= 0, moved_aside(points_img, sidecar)[..., 0], lanes_u_px)
