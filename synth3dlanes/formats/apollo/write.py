"""Write Apollo Sim-3D / Gen-LaneNet: JSON lines, points in the ground frame (`_apollo`), image 1920x1080."""

import json
from collections import Counter
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from synth3dlanes.formats.apollo.convention import CAMERA, ROOT, apollo_from_cam, cam_height_m
from synth3dlanes.formats.lines import NEAR_START_M, LaneAhead, keep_lines, lines_ahead
from synth3dlanes.formats.writing import CV_FROM_CAM, DECIMALS, FrameAnnotation, PinholeFrame
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import CameraLabel, Labels, LaneKind

MAX_LINES = 6
HALF_WIDTH_M = 10.0
EVALUATED_Y_M = np.arange(3.0, 103.0)
HELD_OUT_ILLUMINATION = 0

README = f"""Apollo Sim-3D / Gen-LaneNet layout.

- `{ROOT}/` is the `dataset_dir`; `images/NN/` holds 1920x1080 images at fx = fy = 2015, cx = 960, cy = 540
  (pixel corners at whole numbers), which their tools hard-code.
- NN = 6 steep + 2 illumination + bent: steep = 1 where the road rises above the camera (their flat-ground
  coordinates are singular there); illumination 0 (dark) to 2 (bright); bent = 1 on curves, exits and merges.
- `data_splits/standard`: everything. `rare_subset`: the same training set, tested on NN >= 06.
  `illus_chg`: trained without illumination 0 (NN 00, 01, 06, 07), tested on it alone.
- `data_lists/<split>/*.txt`: the same frames by name. Files begin with frames that have lanes.
- `cam_pitch` in radians, positive = down. `cam_height` = true height / cos(pitch), which makes their projection
  exact and z = 0 the local road plane; `sidecar.jsonl` holds the true height, road_from_cam, the intrinsics, our
  keys and lane ids, and `max_z_over_h`.
- Visibility is a prefix: terrain hides lanes, cars do not. Lines are ordered from the car outwards.
- The evaluator charges 1.5 m where a line has no near (to 40 m) or no far part: so ground truth as prediction has F = 1
  but errors of some centimetres near and decimetres far.
- LATR explodes the lists into its own folders: delete those after exporting again.
"""


def annotate(frame: PinholeFrame) -> FrameAnnotation:
    """The frame's label line, the lists that it belongs to and its sidecar line."""
    labels, camera, dropped = frame.labels, frame.labels.camera, Counter[str]()
    raw_file = image_path(frame)
    groups: dict[LaneKind, tuple[LaneAhead, ...]] = {
        "delimiter": _kept(labels, "delimiter", MAX_LINES, dropped),
        "centerline": _kept(labels, "centerline", len(labels.lanes), dropped),
    }
    document: dict[str, object] = {
        "raw_file": raw_file,
        "cam_height": cam_height_m(camera.height_m, camera.pitch_rad),
        "cam_pitch": camera.pitch_rad,
    }
    for name, kind in (("laneLines", "delimiter"), ("centerLines", "centerline")):
        lines = groups["delimiter" if kind == "delimiter" else "centerline"]
        points = [np.round(apollo_from_cv(line.points_cv, camera), DECIMALS).tolist() for line in lines]
        document |= {name: points, f"{name}_visibility": [line.visible.astype(float).tolist() for line in lines]}
    is_rare, is_held_out = "steep" in frame.tags, frame.illumination == HELD_OUT_ILLUMINATION
    splits = _splits(frame.is_train, is_rare, is_held_out)
    # Tools open train and test; val is for people.
    parts = {frame.part, "test"} if frame.serves_as("test") else {frame.part}
    return FrameAnnotation(
        image=f"{ROOT}/{raw_file}",
        n_lines=len(groups["delimiter"]),
        dropped=dropped,
        shared=(
            (json.dumps(document), _lists("data_splits", splits, parts, "json")),
            (raw_file, _lists("data_lists", splits, parts, "txt")),
            (_sidecar(labels, frame, raw_file, groups), ("sidecar.jsonl",)),
        ),
    )


def _lists(folder: str, splits: Iterable[str], parts: Iterable[str], suffix: str) -> tuple[str, ...]:
    return tuple(f"{folder}/{split}/{part}.{suffix}" for split in splits for part in sorted(parts))


def image_path(frame: PinholeFrame) -> str:
    """`images/NN/name.jpg`: exactly three components, unique over all splits."""
    bent = not frame.tags.isdisjoint(("curve", "merge_split"))
    folder = 6 * ("steep" in frame.tags) + 2 * frame.illumination + bent
    return f"images/{folder:02d}/{frame.split}_{frame.key}.jpg"


def apollo_from_cv(points_cv: Float[np.ndarray, "n 3"], camera: CameraLabel) -> Float[np.ndarray, "n 3"]:
    """Their ground coordinates: the inverse of their own projection."""
    ground_from_cam = apollo_from_cam(cam_height_m(camera.height_m, camera.pitch_rad), camera.pitch_rad)
    return transform(ground_from_cam, points_cv @ CV_FROM_CAM)


def _kept(labels: Labels, kind: LaneKind, most: int, dropped: Counter[str]) -> tuple[LaneAhead, ...]:
    near = []
    for line in lines_ahead(labels, CAMERA, kind):
        if line.visible.sum() >= 2 and not _is_evaluated(apollo_from_cv(line.points_cv[line.visible], labels.camera)):
            dropped["its visible part is never within 10 m beside the camera's axis, 3 to 102 m ahead"] += 1
        else:
            near.append(line)
    return keep_lines(near, dropped, most, f"beyond the {most} nearest (cap of LATR, PersFormer, Anchor3DLane)")


def _is_evaluated(points_apollo: Float[np.ndarray, "n 3"]) -> bool:
    # The evaluator counts a line that it cannot match, so at least two of its own samples must be on the line,
    # and the loaders want two of the line's points in the same band.
    x_m, y_m, _ = points_apollo.T
    start_m, end_m = y_m[0], y_m[-1]
    sampled_y_m = EVALUATED_Y_M[(start_m <= EVALUATED_Y_M) & (end_m >= EVALUATED_Y_M)]
    in_band = np.abs(np.interp(sampled_y_m, y_m, x_m)) <= HALF_WIDTH_M
    return bool(np.count_nonzero(in_band) >= 2 and np.count_nonzero(np.abs(x_m) < HALF_WIDTH_M) >= 2)


def _splits(is_train: bool, is_rare: bool, is_held_out: bool) -> tuple[str, ...]:
    splits = ["standard"]
    if is_train or is_rare:
        splits.append("rare_subset")
    if is_train != is_held_out:
        splits.append("illus_chg")
    return tuple(splits)


def _sidecar(labels: Labels, frame: PinholeFrame, raw_file: str, groups: dict[LaneKind, tuple[LaneAhead, ...]]) -> str:
    camera = labels.camera
    heights_m = [
        apollo_from_cv(line.points_cv[line.visible], camera)[:, 2] for lines in groups.values() for line in lines
    ]
    highest_m = float(np.max(np.concatenate(heights_m))) if heights_m else 0.0
    document = {
        "raw_file": raw_file,
        "source": f"{frame.split}/{frame.key}",
        "tags": sorted(frame.tags),
        "cv_img_from_cam": CAMERA.img_from_cv.tolist(),
        "camera_height_m": camera.height_m,
        "camera_pitch_rad": camera.pitch_rad,
        "road_from_cam": camera.road_from_cam.tolist(),
        "max_z_over_h": round(highest_m / camera.height_m, 4),
        "laneLines_ids": [line.id for line in groups["delimiter"]],
        "centerLines_ids": [line.id for line in groups["centerline"]],
        "starts_beyond_20_m": [bool(line.points_cv[0, 2] > NEAR_START_M) for line in groups["delimiter"]],
    }
    return json.dumps(document)
