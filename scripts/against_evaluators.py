"""Labels of an export as detections, in the public evaluators of KITTI, Argoverse 2 and nuScenes:
`python -m scripts.against_evaluators kitti OUT CODE`, `... argoverse2 OUT`, `... nuscenes OUT`.

OUT is a folder that `synth3dlanes export` wrote, with people, riders and cars; for the last two with
a lidar. CODE is a checkout of traveller59/kitti-object-eval-python. Each needs packages in an environment beside this
project's: kitti `numba scikit-image scipy shapely`, argoverse2 `av2`, nuscenes `nuscenes-devkit`. Boxes are
scored as they are, and moved aside by metres.
"""

import importlib
import json
import sys
import tempfile
import types
from pathlib import Path
from typing import Any

import click
import numpy as np
from PIL import Image

# What a detector of people would be off by to find nobody: KITTI's overlap, and the widest limit of the others.
KITTI_PX, REPEATED = 1242, 8
SPLITS = ("train", "val", "test")
MOVED_M = {"kitti": (0.0, 2.0), "argoverse2": (0.0, 2.0, 5.0), "nuscenes": (0.0, 2.0, 5.0)}


def corners(box: np.ndarray) -> np.ndarray:
    """The corners of rectangles (x, y, length, width, angle), as KITTI's evaluation turns them."""
    x, y, length, width, angle = box
    at = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * (length / 2, width / 2)
    cos, sin = np.cos(angle), np.sin(angle)
    turned: np.ndarray = at @ np.array([[cos, -sin], [sin, cos]]) + (x, y)
    return turned


def overlaps(boxes: np.ndarray, others: np.ndarray, criterion: int = -1, device_id: int = 0) -> np.ndarray:
    """The shares of areas in common, which KITTI's evaluation computes on a GPU: of both together with criterion -1, of
    the first or of the second one with 0 and 1, or the area with 2."""
    import shapely

    one, two = (np.array([shapely.Polygon(corners(box)) for box in each]) for each in (boxes, others))
    common = shapely.area(shapely.intersection(one[:, None], two[None]))
    first, second = (shapely.area(each) for each in (one[:, None], two[None]))
    whole = {-1: first + second - common, 0: first, 1: second, 2: np.ones_like(common)}[criterion]
    return np.asarray(common / whole)


def kitti(out: Path, code: Path) -> None:
    """AP at three levels of difficulty, in the image, from above and in 3D."""
    name = "second.core.non_max_suppression.nms_gpu"
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].rotate_iou_gpu_eval = overlaps  # type: ignore[attr-defined]
    sys.path.insert(0, str(code))
    common, evaluation = importlib.import_module("kitti_common"), importlib.import_module("eval")
    # It fails on fewer frames than it has parts, and fewer boxes than its 41 recalls cannot score 100.
    evaluation.get_split_parts = lambda n_frames, n_parts: [1] * n_frames
    paths = sorted((out / "training/label_2").glob("*.txt")) * REPEATED
    with Image.open(next((out / "training/image_2").glob(f"{paths[0].stem}.*"))) as image:
        # Its levels of difficulty are heights in pixels of KITTI's images.
        scale = KITTI_PX / image.width
    for moved_m in MOVED_M["kitti"]:
        truth = [common.get_label_anno(path) for path in paths]
        for frame in truth:
            frame["bbox"] = scale * frame["bbox"]
        found = [{key: np.array(value) for key, value in frame.items()} for frame in truth]
        for frame in found:
            frame["location"] = frame["location"] + (moved_m, 0.0, 0.0)
            frame["score"] = np.ones(len(frame["name"]))
        for number, category in ((0, "Car"), (1, "Pedestrian"), (2, "Cyclist")):
            n = sum(int((frame["name"] == category).sum()) for frame in truth)
            click.echo(f"{category}, {n} boxes, moved by {moved_m:g} m:")
            click.echo(evaluation.get_official_eval_result(truth, found, number))


def argoverse2(out: Path) -> None:
    """AP of each class with boxes."""
    import pandas as pd
    from av2.evaluation.detection.eval import evaluate
    from av2.evaluation.detection.utils import DetectionCfg

    paths = sorted(out.glob("*/*/annotations.feather"))
    truth = pd.concat([pd.read_feather(path).assign(log_id=path.parent.name) for path in paths], ignore_index=True)
    truth = truth[truth.num_interior_pts > 0].reset_index(drop=True)
    counts = truth.category.value_counts()
    settings = DetectionCfg(
        categories=tuple(counts.index), eval_only_roi_instances=False, max_num_dts_per_category=1000
    )
    for moved_m in MOVED_M["argoverse2"]:
        found = truth.assign(score=1.0, ty_m=truth.ty_m + moved_m)
        _, _, metrics = evaluate(found, truth.copy(), settings, n_jobs=1)
        click.echo(f"moved by {moved_m:g} m:\n{metrics.drop('AVERAGE_METRICS').assign(boxes=counts)}")


def nuscenes(out: Path) -> None:
    """Mean AP of each class with boxes."""
    from nuscenes import NuScenes  # type: ignore[import-not-found]
    from nuscenes.eval.common.config import config_factory  # type: ignore[import-not-found]
    from nuscenes.eval.detection.evaluate import DetectionEval  # type: ignore[import-not-found]
    from nuscenes.eval.detection.utils import category_to_detection_name  # type: ignore[import-not-found]
    from nuscenes.utils.splits import create_splits_scenes  # type: ignore[import-not-found]

    (version,) = [path.name for path in out.iterdir() if path.name.startswith("v1.0")]
    tables = NuScenes(version, str(out), verbose=False)
    splits = create_splits_scenes()
    (split,) = [name for name in SPLITS if tables.scene[0]["name"] in splits[name]]
    used = dict.fromkeys(("use_camera", "use_lidar", "use_radar", "use_map", "use_external"), False)
    for moved_m in MOVED_M["nuscenes"]:
        results: dict[str, list[dict[str, Any]]] = {sample["token"]: [] for sample in tables.sample}
        for item in tables.sample_annotation:
            name = category_to_detection_name(item["category_name"])
            # The evaluation leaves boxes without points out of the truth, but not out of detections.
            if name is not None and item["num_lidar_pts"]:
                at, attributes = item["translation"], item["attribute_tokens"]
                results[item["sample_token"]].append(
                    {
                        "sample_token": item["sample_token"],
                        "translation": [at[0] + moved_m, *at[1:]],
                        "size": item["size"],
                        "rotation": item["rotation"],
                        "velocity": np.nan_to_num(tables.box_velocity(item["token"])[:2]).tolist(),
                        "detection_name": name,
                        "detection_score": 1.0,
                        "attribute_name": tables.get("attribute", attributes[0])["name"] if attributes else "",
                    }
                )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "results.json"
            path.write_text(json.dumps({"meta": used, "results": results}))
            scored = DetectionEval(
                tables, config_factory("detection_cvpr_2019"), str(path), split, folder, verbose=False
            )
            metrics, _ = scored.evaluate()
        counts = {
            name: sum(box.detection_name == name for box in scored.gt_boxes.all) for name in metrics.mean_dist_aps
        }
        found = {name: round(ap, 3) for name, ap in metrics.mean_dist_aps.items() if counts[name]}
        click.echo(f"moved by {moved_m:g} m: {found}, boxes {counts}")


@click.command()
@click.argument("name", type=click.Choice([*MOVED_M]))
@click.argument("out", type=click.Path(path_type=Path, exists=True))
@click.argument("code", type=click.Path(path_type=Path, exists=True), required=False)
def main(name: str, out: Path, code: Path | None) -> None:
    """Print what an evaluator says of an export's labels as detections."""
    if name == "kitti":
        if code is None:
            raise click.UsageError("kitti: expected the folder of its evaluation after OUT, got none")
        kitti(out, code)
    else:
        {"argoverse2": argoverse2, "nuscenes": nuscenes}[name](out)


if __name__ == "__main__":
    main()
