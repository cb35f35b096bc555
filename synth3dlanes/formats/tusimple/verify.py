"""The self-check of a tuSimple export."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.self_check import SHIFT_M, Verified, image_problems, moved_aside, read_sidecars
from synth3dlanes.formats.tusimple.convention import ROWS_PX
from synth3dlanes.formats.tusimple.read import TusimpleFrame, parse
from synth3dlanes.formats.tusimple.score import TusimpleScore, score, score_frame


def verify(out: Path, size_px: tuple[int, int], most_frames: int) -> Iterator[Verified]:
    """The lines of every label file."""
    sidecars = read_sidecars(out)
    for path in sorted(out.glob("*label*.json")):
        with path.open() as file:
            frames = [parse(line, path.name) for line in islice(file, most_frames)]
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
        yield Verified(path.name, len(frames), sum(map(len, true)), asdict(perfect), asdict(shifted), tuple(problems))


def _score_shifted(frames: Sequence[TusimpleFrame], sidecars: dict[str, dict[str, Any]]) -> TusimpleScore:
    """Every line alone and moved, scored on its own rows, by which it counts.

    The official score takes rows where both lines are absent for right, so over all rows nobody can miss a short line.
    """
    scores, weights = [], []
    for frame in frames:
        moved_u_px = _moved_rows(frame.lanes_u_px, sidecars[frame.raw_file])
        for true, moved in zip(frame.lanes_u_px, moved_u_px, strict=True):
            own = true >= 0
            scores.append(astuple(score_frame(true[None, own], moved[None, own], frame.rows_px[own].astype(float))))
            weights.append(np.count_nonzero(own))
    return TusimpleScore(*np.average(scores, axis=0, weights=weights))


def _moved_rows(lanes_u_px: Float[np.ndarray, "l r"], sidecar: dict[str, Any]) -> Float[np.ndarray, "l r"]:
    points_img = np.stack(np.broadcast_arrays(lanes_u_px, ROWS_PX.astype(float)), axis=-1)
    return np.where(lanes_u_px >= 0, moved_aside(points_img, sidecar)[..., 0], lanes_u_px)
