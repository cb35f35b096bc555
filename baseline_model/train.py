"""Training: one loop, exact resume, one or several GPUs (torchrun).

All randomness in step s follows from (seed, s), so that a killed run resumes with identical results.
"""

import time
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from synth3dlanes.labels import Labels

from . import checkpoint as checkpoints
from .anchors import encode
from .augment import Augmented, augment, generator_for, lane_masks, noisy
from .config import TrainConfig
from .data import ResidentData, Samples, describe, load
from .inference import layout_of, mixed_precision, predictions_of, run
from .loss import loss
from .metrics import Evaluation, MetricConfig, Report
from .model import LaneNet, Output
from .progress import Line, Log
from .projection import cell_centres, invert_rigid, road_from_cam
from .report import to_document
from .run_state import Process, Run, fits, prepare, save, start_process
from .sources import training_and_validation

SAVE_EVERY_S = 300.0


class Diverged(FloatingPointError):
    """The loss or a gradient became NaN or infinite; the message names the step and the samples."""


def train(config: TrainConfig, data_dir: str | Path, out_dir: str | Path) -> Path:
    """Train on DIR/train, validate on DIR/val, return the best checkpoint's path. Resumes a run found in `out_dir`."""
    train_samples, val_samples = training_and_validation(
        str(data_dir), config.train_split, config.val_split, config.max_images
    )
    return train_on(config, train_samples, val_samples, Path(out_dir))


def train_on(config: TrainConfig, train_samples: Samples, val_samples: Samples, out_dir: Path) -> Path:
    """Train and validate on any samples."""
    process = start_process(config)
    size_px = (config.model.image_height_px, config.model.image_width_px)
    mode = config.model.pose_target
    with Line("decoding", len(train_samples), is_shown=process.rank == 0) as line:
        data = load(train_samples, size_px, mode, config.storage, fov_mask=config.fov_mask, on_progress=line.update)
    val = load(val_samples, size_px, mode, config.storage)
    val_labels = [val_samples[i].labels for i in range(len(val_samples))]
    if process.device.type == "cuda" and fits(data, process.device):
        data = data.to(process.device)
    about = {"train": describe(data), "val": describe(val), "torch": str(torch.__version__)}
    trainee = prepare(config, process, out_dir, about)
    if process.device.type == "cuda" and config.compile:
        trainee.model.compile()
    network = DistributedDataParallel(trainee.model) if process.world > 1 else trainee.model

    steps_per_epoch = -(-len(data) // config.batch)
    n_steps = max(1, round(config.epochs * steps_per_epoch))
    validate_every = max(1, round(config.validate_every_epochs * steps_per_epoch))
    saved_at = time.monotonic()
    with Log(out_dir, n_steps, trainee.step, config.batch, is_shown=process.rank == 0) as log:
        while trainee.step < n_steps:
            rate = trainee.schedule.rate(trainee.step, n_steps, steps_per_epoch, config)
            terms = _step(trainee, network, data, rate, n_steps)
            trainee.step += 1
            log.step(trainee.step, rate, terms)
            if trainee.step % validate_every == 0 or trainee.step == n_steps:
                report = _validate(trainee, val, val_labels)
                log.validation(trainee.step, report)
                _note(trainee, report, steps_per_epoch, out_dir, about)
            elif time.monotonic() - saved_at > SAVE_EVERY_S:
                save(trainee, out_dir, about)
                saved_at = time.monotonic()
    if process.world > 1:
        torch.distributed.barrier()
        torch.distributed.destroy_process_group()
    return out_dir / "best.pt"


@lru_cache(maxsize=1)
def sample_order(n: int, seed: int, epoch: int) -> Int[Tensor, " n"]:
    """The order of one epoch."""
    return torch.randperm(n, generator=torch.Generator().manual_seed(seed * 1_000_003 + epoch))


def batch_index(n: int, step: int, config: TrainConfig, process: Process) -> Int[Tensor, " b"]:
    """The samples of a step on this process; an epoch's last batch is filled up from the epoch's start."""
    steps_per_epoch = -(-n // config.batch)
    epoch, at = divmod(step, steps_per_epoch)
    places = (at * config.batch + torch.arange(config.batch)) % n
    return sample_order(n, config.seed, epoch)[places][process.rank :: process.world]


def _step(
    trainee: Run, network: nn.Module, data: ResidentData, rate: float, n_steps: int
) -> dict[str, Float[Tensor, ""]]:
    """One optimiser step; returns the mean of each loss term."""
    config, process, step = trainee.config, trainee.process, trainee.step
    index = batch_index(len(data), step, config, process)
    generator = generator_for(config.seed, step, process.rank, process.device)
    augmented = augment(data.batch(index, process.device), config.augmentation, generator)
    batch = augmented.batch
    warp_pose = None
    if step < config.label_pose_fraction * n_steps:
        warp_pose = noisy(batch.target_pose, config.label_pose_noise_deg, config.label_pose_noise_m, generator)
    for group in trainee.optimizer.param_groups:
        group["lr"] = rate
    network.train()
    trainee.optimizer.zero_grad(set_to_none=True)
    with mixed_precision(process.device, config.precision):
        output: Output = network(batch.image, batch.intrinsics, warp_pose, augmented.top_from_road)
    terms = step_loss(trainee.model, output, augmented, config)
    if not bool(torch.isfinite(terms["total"]).all()):
        raise Diverged(f"step {step}: {_blame(trainee, data, augmented, warp_pose)}")
    terms["total"].mean().backward()  # type: ignore[no-untyped-call]
    norm = nn.utils.clip_grad_norm_(trainee.model.parameters(), config.clip_norm)
    if not bool(torch.isfinite(norm)):
        names = ", ".join(data.keys[int(i)] for i in index)
        raise Diverged(f"step {step}: expected a finite gradient, got {float(norm)} from samples {names}")
    trainee.optimizer.step()
    trainee.average.update(trainee.model, step)
    return {name: value.detach().mean() for name, value in terms.items()}


def step_loss(model: LaneNet, output: Output, augmented: Augmented, config: TrainConfig) -> dict[str, Tensor]:
    """The loss terms against targets in the frame given by `target_frame`."""
    batch = augmented.batch
    pose = output.pose if model.pose is None else batch.target_pose
    if config.target_frame == "grid":
        top_from_cam = invert_rigid(output.cam_from_top.detach())
    else:
        top_from_cam = augmented.top_from_road @ road_from_cam(pose)
    targets, _ = encode(batch.curves, top_from_cam, config.model)
    bev_target = None
    if output.bev_logit is not None:
        points_top = cell_centres(config.model.grid, 1).to(output.logit.device)
        bev_target = lane_masks(batch.curves, top_from_cam, points_top)
    return loss(output, targets, pose, bev_target, config.model.types, config.loss)


def _blame(trainee: Run, data: ResidentData, augmented: Augmented, warp_pose: Float[Tensor, "b 2"] | None) -> str:
    """Find the samples with a non-finite loss. Batch norm mixes a batch, so the model is evaluated in eval mode."""
    batch, model = augmented.batch, trainee.model.eval()
    with torch.no_grad():
        output: Output = model(batch.image, batch.intrinsics, warp_pose, augmented.top_from_road)
        terms = step_loss(model, output, augmented, trainee.config)
    keys = [data.keys[int(i)] for i in batch.places]
    bad = torch.nonzero(~torch.isfinite(terms["total"]))[:, 0].tolist() or list(range(len(keys)))
    values = {name: float(value[bad[0]]) for name, value in terms.items()}
    return f"expected a finite loss, got {values} from sample {', '.join(keys[i] for i in bad)}"


def _validate(trainee: Run, val: ResidentData, val_labels: list[Labels]) -> Report | None:
    if trainee.process.rank != 0:
        return None
    model, device = trainee.average.model, trainee.process.device
    evaluation = Evaluation(MetricConfig(alternatives=(), bootstraps=0))
    for start in range(0, len(val), trainee.config.batch):
        index = torch.arange(start, min(start + trainee.config.batch, len(val)))
        batch = val.batch(index, device)
        output = run(model, batch.image, batch.intrinsics)
        keys = [val.keys[int(i)] for i in index]
        for i, prediction in enumerate(predictions_of(keys, output, layout_of(model))):
            evaluation.add(val_labels[start + i], prediction)
    return evaluation.report()


def _note(trainee: Run, report: Report | None, steps_per_epoch: int, out_dir: Path, about: dict[str, Any]) -> None:
    """After a validation: update the schedule on every process, and save the best weights on rank 0."""
    score = float("nan") if report is None else float(np.nanmean([kind.ap for kind in report.kinds.values()]))
    if trainee.process.world > 1:
        shared = torch.tensor([score], device=trainee.process.device)
        torch.distributed.broadcast(shared, src=0)
        score = float(shared)
    trainee.schedule.validated(score, trainee.step, steps_per_epoch, trainee.config)
    if report is None:
        return
    trainee.history.append({"step": trainee.step, "score": score, **to_document(report)})
    if score > trainee.best or not (out_dir / "best.pt").exists():
        trainee.best = score
        weights = trainee.average.model.state_dict()
        about = {**about, "step": trainee.step, "score": score}
        checkpoints.save(out_dir / "best.pt", checkpoints.Checkpoint(trainee.config, about, weights, None))
    save(trainee, out_dir, about)
