"""Apollo Sim-3D / Gen-LaneNet: JSON lines, points in their ground frame (`_apollo`), metres, image 1920x1080.

Their ground frame is x right, y forward, z up, but its origin is not the camera's foot: the projection that all of
their tools share puts the camera at (0, h sin p, h cos p). With the field h = true height / cos p the reprojection
is exact and the local road plane is z = 0, the plane of their inverse perspective mapping.
"""

import json
from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from synth3dlanes.errors import FormatError
from synth3dlanes.export.lines import DECIMALS, NEAR_START_M, Annotation, Frame, Line, View, keep_lines, lines_ahead
from synth3dlanes.labels import CameraLabel, Kind, Labels

VIEW = View(1920, 1080, 2015.0)
MAX_LINES = 6
HALF_WIDTH_M = 10.0
EVALUATED_Y_M = np.arange(3.0, 103.0)
ROOT = "Apollo_Sim_3D_Lane_Release"
LINKS = {"images": f"{ROOT}/images"}
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
- LATR explodes the lists into its own folders: delete those after exporting again.
"""


@dataclass(frozen=True, eq=False)
class ApolloFrame:
    """One line of a label file as plain arrays; visibilities as flags."""

    raw_file: str
    cam_height_m: float
    cam_pitch_rad: float
    lane_lines_apollo: tuple[Float[np.ndarray, "_ 3"], ...]
    lane_lines_visible: tuple[Bool[np.ndarray, " _"], ...]
    center_lines_apollo: tuple[Float[np.ndarray, "_ 3"], ...]
    center_lines_visible: tuple[Bool[np.ndarray, " _"], ...]


def annotate(labels: Labels, frame: Frame) -> Annotation:
    """The frame's label line, the lists that it belongs to and its sidecar line."""
    camera, dropped = labels.camera, Counter[str]()
    raw_file = image_path(frame)
    groups: dict[Kind, tuple[Line, ...]] = {
        "delimiter": _kept(labels, "delimiter", MAX_LINES, dropped),
        "centerline": _kept(labels, "centerline", len(labels.lanes), dropped),
    }
    document: dict[str, object] = {
        "raw_file": raw_file,
        "cam_height": cam_height_m(camera),
        "cam_pitch": camera.pitch_rad,
    }
    for name, kind in (("laneLines", "delimiter"), ("centerLines", "centerline")):
        lines = groups["delimiter" if kind == "delimiter" else "centerline"]
        points = [np.round(apollo_from_cv(line.points_cv, camera), DECIMALS).tolist() for line in lines]
        document |= {name: points, f"{name}_visibility": [line.visible.astype(float).tolist() for line in lines]}
    is_rare, is_held_out = "steep" in frame.tags, frame.illumination == HELD_OUT_ILLUMINATION
    splits = _splits(frame.is_train, is_rare, is_held_out)
    part = "train" if frame.is_train else "test"
    return Annotation(
        image=f"{ROOT}/{raw_file}",
        n_lines=len(groups["delimiter"]),
        dropped=dropped,
        shared=(
            (json.dumps(document), tuple(f"data_splits/{split}/{part}.json" for split in splits)),
            (raw_file, tuple(f"data_lists/{split}/{part}.txt" for split in splits)),
            (_sidecar(labels, frame, raw_file, groups), ("sidecar.jsonl",)),
        ),
    )


def image_path(frame: Frame) -> str:
    """`images/NN/name.jpg`: exactly three components, unique over all splits."""
    bent = not frame.tags.isdisjoint(("curve", "merge_split"))
    folder = 6 * ("steep" in frame.tags) + 2 * frame.illumination + bent
    return f"images/{folder:02d}/{frame.split}_{frame.key}.jpg"


def cam_height_m(camera: CameraLabel) -> float:
    """The field `cam_height`."""
    return float(camera.height_m / np.cos(camera.pitch_rad))


def apollo_from_cv(points_cv: Float[np.ndarray, "n 3"], camera: CameraLabel) -> Float[np.ndarray, "n 3"]:
    """Their ground coordinates: the inverse of their own projection (formats note, 1.2)."""
    c, s = np.cos(camera.pitch_rad), np.sin(camera.pitch_rad)
    x_m, y_m, z_m = points_cv.T
    below_m = y_m - cam_height_m(camera)
    return np.column_stack([x_m, -s * below_m + c * z_m, -c * below_m - s * z_m])


def cv_from_apollo(
    points_apollo: Float[np.ndarray, "n 3"], height_m: float, pitch_rad: float
) -> Float[np.ndarray, "n 3"]:
    """Camera coordinates of what a label line holds; `height_m` is its field `cam_height`."""
    c, s = np.cos(pitch_rad), np.sin(pitch_rad)
    x_m, y_m, z_m = points_apollo.T
    return np.column_stack([x_m, height_m - s * y_m - c * z_m, c * y_m - s * z_m])


def read(line: str, where: str) -> ApolloFrame:
    """Parse one line of a label file."""
    try:
        document = json.loads(line)
        groups = [
            tuple(np.array(points, dtype=float).reshape(-1, 3) for points in document[name])
            for name in ("laneLines", "centerLines")
        ]
        flags = [
            tuple(np.array(values, dtype=float) > 0 for values in document[f"{name}_visibility"])
            for name in ("laneLines", "centerLines")
        ]
        lane_lines, center_lines = groups
        lane_flags, center_flags = flags
        return ApolloFrame(
            document["raw_file"], document["cam_height"], document["cam_pitch"],
            lane_lines, lane_flags, center_lines, center_flags,
        )  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(f"{where}: not an Apollo label line: {type(error).__name__}: {error}") from None


def _kept(labels: Labels, kind: Kind, most: int, dropped: Counter[str]) -> tuple[Line, ...]:
    near = []
    for line in lines_ahead(labels, VIEW, kind):
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


def _sidecar(labels: Labels, frame: Frame, raw_file: str, groups: dict[Kind, tuple[Line, ...]]) -> str:
    camera = labels.camera
    heights_m = [
        apollo_from_cv(line.points_cv[line.visible], camera)[:, 2] for lines in groups.values() for line in lines
    ]
    highest_m = float(np.max(np.concatenate(heights_m))) if heights_m else 0.0
    document = {
        "raw_file": raw_file,
        "source": f"{frame.split}/{frame.key}",
        "tags": sorted(frame.tags),
        "cv_img_from_cam": VIEW.img_from_cv.tolist(),
        "camera_height_m": camera.height_m,
        "camera_pitch_rad": camera.pitch_rad,
        "road_from_cam": camera.road_from_cam.tolist(),
        "max_z_over_h": round(highest_m / camera.height_m, 4),
        "laneLines_ids": [line.id for line in groups["delimiter"]],
        "centerLines_ids": [line.id for line in groups["centerline"]],
        "starts_beyond_20_m": [bool(line.points_cv[0, 2] > NEAR_START_M) for line in groups["delimiter"]],
    }
    return json.dumps(document)
