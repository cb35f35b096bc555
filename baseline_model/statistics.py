"""Statistics of a dataset's training targets, and the best score that their representation allows. No network."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels.labels import Labels, LaneKind
from synth3dlanes.system.words import counted

from .anchors import (
    CENTERLINE,
    DELIMITER,
    DROPPED,
    IGNORED,
    KEPT,
    Targets,
    anchor_positions_m,
    encode,
    spread_m,
)
from .config import COMPACT, ModelConfig
from .curves import MEAN_POSE, Pose, cam_from_road, road_from_cam
from .data import annotation_of, pack
from .lanes import DENSE_Y_M, Detection, Prediction, interpolate
from .metrics import Evaluation, EvaluationReport, MetricConfig
from .report import to_document as report_document
from .sources import labels_at, open_split


@dataclass(frozen=True, eq=False)
class TargetStatistics:
    """Counts of curves by kind and status, standard deviations of the targets, and the metric of decoded targets."""

    n_images: int
    counts: dict[str, dict[str, int]]
    visible_share: dict[float, float]
    x_sd_m: dict[float, float]
    z_sd_m: dict[float, float]
    expected_x_sd_m: tuple[float, ...]
    ceiling: EvaluationReport


def statistics_of(labels: Iterable[Labels], model: ModelConfig = COMPACT) -> TargetStatistics:
    """Statistics of given labels."""
    names = {KEPT: "kept", IGNORED: "ignored", DROPPED: "dropped"}
    kinds = {CENTERLINE: "centerline", DELIMITER: "delimiter"}
    counts = {kind: dict.fromkeys(names.values(), 0) for kind in kinds.values()}
    evaluation = Evaluation(MetricConfig())
    x_m, z_m, visible = [], [], []
    for index, of_image in enumerate(labels):
        targets, status, kind, pose = _targets(of_image, model)
        for fate, name in names.items():
            for code, kind_name in kinds.items():
                counts[kind_name][name] += int(((status == fate) & (kind == code)).sum())
        x_m.append(torch.where(targets.visible, targets.x_m, torch.nan)[targets.assigned].numpy())
        z_m.append(torch.where(targets.visible, targets.z_m, torch.nan)[targets.assigned].numpy())
        visible.append(targets.visible[targets.assigned].numpy())
        evaluation.add(of_image, decode_targets(str(index), targets, pose, model))
    knots = model.knots_y_m
    return TargetStatistics(
        n_images=len(visible),
        counts=counts,
        visible_share=_by_knot(knots, np.concatenate(visible).mean(0)),
        x_sd_m=_by_knot(knots, np.nanstd(np.concatenate(x_m), axis=0)),
        z_sd_m=_by_knot(knots, np.nanstd(np.concatenate(z_m), axis=0)),
        expected_x_sd_m=tuple(round(float(v), 2) for v in spread_m(model)[0]),
        ceiling=evaluation.report(),
    )


def decode_targets(key: str, targets: Targets, pose: Pose, model: ModelConfig) -> Prediction:
    """The prediction of a network without error: splines through the knots that the lanes reach."""
    anchors, knots = np.array(anchor_positions_m(model)), np.array(model.knots_y_m)
    lanes = []
    for _, lane_type, anchor in torch.nonzero(targets.assigned).tolist():
        reached = targets.in_range[0, lane_type, anchor].numpy()
        x_m = targets.x_m[0, lane_type, anchor].double().numpy() + anchors[anchor]
        xz_m = np.stack([x_m, targets.z_m[0, lane_type, anchor].double().numpy()], axis=-1)
        dense = interpolate(knots[reached], xz_m[reached], DENSE_Y_M, model.spline)
        xyz_road = np.stack([dense[:, 0], DENSE_Y_M, dense[:, 1]], axis=-1)
        kind: LaneKind = "delimiter" if model.types[lane_type] == "d" else "centerline"
        lanes.append(Detection(kind, 1.0, transform(cam_from_road(pose), xyz_road)))
    return Prediction(key, tuple(lanes), pose)


def to_text(statistics: TargetStatistics) -> str:
    """The statistics as text."""
    lines = [counted(statistics.n_images, "image")]
    for kind, counts in statistics.counts.items():
        lines.append(f"{kind:11}" + "".join(f"  {name} {n}" for name, n in counts.items()))
    lines.append(f"{'knot [m]':>10}{'visible':>9}{'sd x [m]':>10}{'sd z [m]':>10}")
    for knot, share in statistics.visible_share.items():
        lines.append(f"{knot:10.0f}{share:9.1%}{statistics.x_sd_m[knot]:10.2f}{statistics.z_sd_m[knot]:10.2f}")
    for kind, report in statistics.ceiling.kinds.items():
        at = report.at_threshold
        lines.append(
            f"ceiling, {kind}: AP {report.ap:.4f}, recall {at.recall:.4f}, near {at.near_1sigma_cm:.1f} / "
            f"{at.near_2sigma_cm:.1f} cm, far {at.far_1sigma_cm:.1f} / {at.far_2sigma_cm:.1f} cm"
        )
    return "\n".join(lines)


def to_document(statistics: TargetStatistics) -> dict[str, Any]:
    """The statistics as JSON values."""
    document = {name: value for name, value in vars(statistics).items() if name != "ceiling"}
    return document | {"ceiling": report_document(statistics.ceiling)}


def describe_targets(data_dir: str | Path, *, as_json: bool = False) -> str:
    """Statistics and ceiling of a split (`DIR/train`), as text or JSON; images are not read."""
    samples = open_split(data_dir)
    statistics = statistics_of(labels_at(samples, index) for index in range(len(samples)))
    return json.dumps(to_document(statistics)) if as_json else to_text(statistics)


def _targets(labels: Labels, model: ModelConfig) -> tuple[Targets, torch.Tensor, torch.Tensor, Pose]:
    size_px = (labels.camera.height_px, labels.camera.width_px)
    annotation = annotation_of("", labels, size_px, model.pose_target)
    pose = MEAN_POSE if model.pose_target == "fixed" else annotation.target
    packed = pack([annotation])
    top_from_cam = torch.from_numpy(road_from_cam(pose)).float()[None]
    targets, status = encode(packed, top_from_cam, model)
    return targets, status, packed.kind, pose


def _by_knot(knots_y_m: tuple[float, ...], values: np.ndarray) -> dict[float, float]:
    return {knot: float(value) for knot, value in zip(knots_y_m, values, strict=True)}
