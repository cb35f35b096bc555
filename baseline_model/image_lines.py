"""Detected lanes as lines in the image, and tuSimple's score of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from synth3dlanes.formats.tusimple import ABSENT, CAMERA, TusimpleScore, TusimpleSplit, mean_score, score_frame
from synth3dlanes.geometry.frames import project

from .lanes import Detection, Prediction

BESIDE_M = 10.0
"""Distance at which the lines to the left and right of the host are chosen."""
MOST_LINES = 4
"""tuSimple asks for at most four lines, those of the host's lane and of the lanes beside it."""
NEAREST_M = 0.5
VISIBLE = 0.5


def delimiters(prediction: Prediction, threshold: float) -> list[Detection]:
    """The delimiters of at least this confidence, the most confident first."""
    kept = [lane for lane in prediction.lanes if lane.kind == "delimiter" and lane.score >= threshold]
    return sorted(kept, key=lambda lane: -lane.score)


def right_of_host_m(lane: Detection) -> float:
    """How far right of the camera the lane is, BESIDE_M ahead."""
    return float(np.interp(BESIDE_M, lane.xyz_cam[:, 1], lane.xyz_cam[:, 0]))


def asked_for(prediction: Prediction, threshold: float) -> list[Detection]:
    """The delimiters that tuSimple asks for: the MOST_LINES nearest the host."""
    lanes = delimiters(prediction, threshold)
    return sorted(lanes, key=lambda lane: abs(right_of_host_m(lane)))[:MOST_LINES]


def columns_of(
    lane: Detection, img_from_cam: Float[np.ndarray, "3 3"], rows_px: Float[np.ndarray, " r"]
) -> Float[np.ndarray, " r"]:
    """The lane's column at each row, where it is visible and does not turn back in the image; NaN elsewhere."""
    xyz_cam = lane.xyz_cam
    if lane.visibility is not None:
        seen = np.flatnonzero(lane.visibility >= VISIBLE)
        xyz_cam = xyz_cam[: seen[-1] + 1 if len(seen) else 0]
    u_px, v_px = project(img_from_cam, xyz_cam[xyz_cam[:, 1] > NEAREST_M]).T
    v_px = v_px.round(6)  # a line that ends at a row reaches it
    turns = np.flatnonzero(np.diff(v_px) >= 0)
    n = int(turns[0]) + 1 if len(turns) else len(v_px)
    if n < 2:
        return np.full(len(rows_px), np.nan)
    return np.interp(rows_px, v_px[:n][::-1], u_px[:n][::-1], left=np.nan, right=np.nan)


def tusimple_line(
    lane: Detection, img_from_cam: Float[np.ndarray, "3 3"], rows_px: Float[np.ndarray, " r"]
) -> Int[np.ndarray, " r"]:
    """The lane as in tuSimple's files: the column at each row in whole pixels, ABSENT outside the image."""
    columns_px = np.rint(columns_of(lane, img_from_cam, rows_px))
    is_inside = (columns_px >= 0) & (columns_px < CAMERA.width_px)
    return np.where(is_inside, columns_px, ABSENT).astype(int)


def tusimple_score(
    found: Sequence[Prediction], split: TusimpleSplit, img_from_cam: Float[np.ndarray, "3 3"], threshold: float
) -> TusimpleScore:
    """The official score of a prediction for each frame: of its lines that tuSimple asks for, projected with the matrix
    of the images at the rows of the labels."""
    scores = []
    for index, prediction in enumerate(found):
        frame = split.frame(index)
        rows_px = frame.rows_px.astype(float)
        lines = [tusimple_line(lane, img_from_cam, rows_px) for lane in asked_for(prediction, threshold)]
        predicted = np.array(lines, dtype=float).reshape(-1, len(rows_px))
        score = score_frame(frame.lanes_u_px, predicted, rows_px)
        # Where two labelled lines lie together, one line finds both, and less than none is in excess.
        scores.append(replace(score, false_positive=max(0.0, score.false_positive)))
    return mean_score(scores)
