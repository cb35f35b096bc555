"""Lanes from the outputs of an exported network. Needs numpy alone, so that the file can be copied to a device.

    session = onnxruntime.InferenceSession("best.onnx")
    arrays = session.run(None, {"image": image, "intrinsics": intrinsics})
    outputs = dict(zip([output.name for output in session.get_outputs()], arrays))
    lanes = decode(outputs, session.get_modelmeta().custom_metadata_map)

`image` is float32 (batch, 3, height, width), RGB in 0..1; `intrinsics` float32 (batch, 4), fx, fy, cx, cy in pixels of
the image. Frames: knots are in the road frame of the predicted pose, lanes in camera coordinates (x right, y forward,
z up).
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

Y_M = np.arange(101.0)
"""A lane has a point at each of these distances along the road."""
MIN_SCORE = 0.01
SAME_LANE_M, SAME_LANE_TO_M = 1.0, 40.0
"""Lanes of one type are the same if they are less than this apart, on average over the knots up to that distance."""


def decode(
    outputs: Mapping[str, np.ndarray], metadata: Mapping[str, str], min_score: float = MIN_SCORE
) -> list[list[dict[str, Any]]]:
    """The lanes of each image of a batch, as in a line of `predictions.jsonl`: `kind`, `score`, `xyz_cam` (101 x 3)
    and, if the network predicts it, `visibility` (101).

    `outputs` has the arrays by name: `x_m` and `z_m` (batch, types, anchors, knots), `score` (batch, types, anchors),
    `pose` (batch, 2) and optionally `visibility`, shaped like `x_m`. `metadata` is the model's `custom_metadata_map`.
    Raises ValueError for a network with another spline than the natural cubic one.
    """
    spline = json.loads(metadata["config"])["spline"]
    if spline != "natural":
        raise ValueError(f"spline: expected natural, got {spline}")
    kinds = ["delimiter" if name == "d" else "centerline" for name in metadata["types"].split(",")]
    knots_y_m = np.array(json.loads(metadata["knots_y_m"]))
    values = {name: np.asarray(array, dtype=float) for name, array in outputs.items()}
    images = []
    for image, score in enumerate(values["score"]):
        lanes: list[dict[str, Any]] = []
        x_knots_m, z_knots_m = values["x_m"][image], values["z_m"][image]
        for t, a in distinct_lanes(score, x_knots_m, z_knots_m, knots_y_m, min_score):
            x_m = natural_spline(knots_y_m, x_knots_m[t, a], Y_M)
            z_m = natural_spline(knots_y_m, z_knots_m[t, a], Y_M)
            xyz_cam = _to_camera(np.stack([x_m, Y_M, z_m], axis=-1), *values["pose"][image])
            lane = {"kind": kinds[t], "score": float(score[t, a]), "xyz_cam": xyz_cam}
            if "visibility" in values:
                lane["visibility"] = np.interp(Y_M, knots_y_m, values["visibility"][image, t, a])
            lanes.append(lane)
        images.append(lanes)
    return images


def distinct_lanes(
    score: np.ndarray, x_m: np.ndarray, z_m: np.ndarray, knots_y_m: np.ndarray, min_score: float = MIN_SCORE
) -> np.ndarray:
    """The (type, anchor) of each lane, sorted. `score` is (types, anchors), `x_m` and `z_m` (types, anchors, knots) in
    one frame. Of those that are the same lane (SAME_LANE_M) the most confident is kept, of equal ones the left one."""
    near = knots_y_m <= max(SAME_LANE_TO_M, knots_y_m[0])
    points_m = np.stack([x_m[..., near], z_m[..., near]], axis=-1)
    apart_m = np.linalg.norm(points_m[:, :, None] - points_m[:, None], axis=-1).mean(-1)
    kept: list[tuple[int, int]] = []
    for t, scores in enumerate(score):
        lanes: list[int] = []
        for a in np.argsort(-scores, kind="stable")[: np.count_nonzero(scores >= min_score)]:
            if (apart_m[t, a, lanes] >= SAME_LANE_M).all():
                lanes.append(int(a))
        kept += [(t, a) for a in sorted(lanes)]
    return np.array(kept, dtype=int).reshape(-1, 2)


def natural_spline(knots: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The natural cubic spline through the values, one row a knot; its end pieces continue beyond the knots."""
    step, n = np.diff(knots), len(knots)
    matrix, right = np.eye(n), np.zeros(values.shape)
    for i in range(1, n - 1):
        matrix[i, i - 1 : i + 2] = step[i - 1], 2 * (step[i - 1] + step[i]), step[i]
        right[i] = 6 * ((values[i + 1] - values[i]) / step[i] - (values[i] - values[i - 1]) / step[i - 1])
    curvature = np.linalg.solve(matrix, right.reshape(n, -1)).reshape(values.shape)
    piece = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, n - 2)
    each = (-1,) + (1,) * (values.ndim - 1)
    after, width = ((at - knots[piece]) / step[piece]).reshape(each), step[piece].reshape(each)
    before = 1 - after
    bend = (before**3 - before) * curvature[piece] + (after**3 - after) * curvature[piece + 1]
    return np.asarray(before * values[piece] + after * values[piece + 1] + bend * width**2 / 6)


def _to_camera(xyz_road: np.ndarray, pitch_rad: float, height_m: float) -> np.ndarray:
    x, y, z = xyz_road.T - np.array([[0.0], [0.0], [height_m]])
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    return np.stack([x, c * y - s * z, s * y + c * z], axis=-1)
