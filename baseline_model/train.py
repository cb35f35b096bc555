"""Training: one loop, exact resume, one or several GPUs (torchrun).

All randomness in step s follows from (seed, s), so that a killed run resumes with identical results.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from synth3dlanes.system.errors import Synth3dlanesError
from synth3dlanes.system.files import Folder
from synth3dlanes.system.words import counted

from . import checkpoint as checkpoints
from .augment import AugmentedBatch, augment, generator_for
from .config import CustomModel, TrainConfig
from .data import Batch, Samples
from .devices import Process, choose_device, start_process
from .evaluate import score
from .inference import Detector
from .loading import ANNOTATIONS, Decoding, decoding_of, open_examples, training_batches
from .loss import Terms, task_of
from .metrics import EvaluationReport, MetricConfig
from .model import LaneNet
from .progress import TrainingLog, trim_history
from .report import to_document
from .run_state import TrainingRun, claimed, last_saved, prepare, save
from .sources import describe, focal_lengths, training_and_validation

SAVE_EVERY_S = 300.0


@dataclass(frozen=True)
class RunLength:
    """How long a run is, in steps."""

    steps_per_epoch: int
    n_steps: int
    validate_every: int

    @classmethod
    def of(cls, config: TrainConfig, n_images: int) -> "RunLength":
        """The length of `epochs` passes over `n_images` images."""
        steps_per_epoch = -(-n_images // config.batch)
        return cls(
            steps_per_epoch,
            max(1, round(config.epochs * steps_per_epoch)),
            max(1, round(config.validate_every_epochs * steps_per_epoch)),
        )


class DivergenceError(Synth3dlanesError, FloatingPointError):
    """The loss or a gradient became NaN or infinite; the message names the step and the samples."""


def train(config: TrainConfig, data_dirs: str | Sequence[str], out_dir: str | Path) -> Path:
    """Train on DIR/train of one data set or of several, validate on DIR/val, return the best checkpoint's path. Resumes
    a run found in `out_dir`."""
    return train_on(config, *_splits(config, data_dirs), Path(out_dir))


def plan(config: TrainConfig, data_dirs: str | Sequence[str], out_dir: str | Path) -> list[str]:
    """What `train` would do, in lines; nothing is written."""
    return plan_on(config, *_splits(config, data_dirs), Path(out_dir))


def plan_on(config: TrainConfig, train_samples: Samples, val_samples: Samples, out_dir: Path) -> list[str]:
    """What `train_on` would do."""
    process = Process(0, 1, choose_device(config.device))
    decoding = decoding_of(len(train_samples), config, process)
    return _plan(prepare(config, process, out_dir, {}), decoding, describe(val_samples))


def train_on(config: TrainConfig, train_samples: Samples, val_samples: Samples, out_dir: Path) -> Path:
    """Train and validate on any samples."""
    process = start_process(config)
    about: dict[str, Any] = {
        "train": {"n_images": len(train_samples), "focal_px": [*focal_lengths(train_samples, config.model.size_px)]},
        "val": {"n_images": len(val_samples)},
        "torch": str(torch.__version__),
    }
    found = last_saved(out_dir)
    trainee = prepare(config, process, out_dir, about)
    with claimed(out_dir, process, found):
        _run(trainee, train_samples, val_samples)
    if process.world > 1:
        torch.distributed.destroy_process_group()
    return out_dir / "best.pt"


def _run(trainee: TrainingRun, train_samples: Samples, val_samples: Samples) -> None:
    """The steps that are left of a run, in its own folder."""
    config, process, out_dir = trainee.config, trainee.process, trainee.out_dir
    decoding = decoding_of(len(train_samples), config, process)
    examples = open_examples(train_samples, decoding, config, process, out_dir)
    length = RunLength.of(config, len(examples))
    task = task_of(trainee.model, config)
    if process.device.type == "cuda" and config.compile and isinstance(trainee.model, LaneNet):
        trainee.model.compile()
    distributed = DistributedDataParallel(task) if process.world > 1 else task
    saved_at = time.monotonic()
    if process.rank == 0:
        trim_history(out_dir, trainee.saved_step, Fraction(trainee.saved_batch, config.batch))
    steps = (length.n_steps, length.steps_per_epoch, trainee.step)
    with TrainingLog(out_dir, *steps, config.batch, is_shown=process.rank == 0) as log:
        for line in _plan(trainee, decoding, describe(val_samples)):
            log.line.say(line)
        for batch in training_batches(examples, config, process, trainee.step, length.n_steps):
            rate = trainee.schedule.rate(trainee.step, length.n_steps, length.steps_per_epoch, config)
            terms = _step(trainee, distributed, task, batch, rate, trainee.step / length.n_steps)
            trainee.step += 1
            log.step(trainee.step, rate, terms)
            report = None
            if trainee.step % length.validate_every == 0 or trainee.step == length.n_steps:
                report = _validate(trainee, val_samples)
                log.validation(trainee.step, report)
                _note(trainee, report, length.steps_per_epoch)
            elif time.monotonic() - saved_at > SAVE_EVERY_S:
                save(trainee, trainee.about)
                saved_at = time.monotonic()
            if report is not None or trainee.step % length.steps_per_epoch == 0:
                log.epoch(trainee.step, report)
    if process.world > 1:
        torch.distributed.barrier()
    Folder(out_dir).remove(ANNOTATIONS)


def _splits(config: TrainConfig, data_dirs: str | Sequence[str]) -> tuple[Samples, Samples]:
    return training_and_validation(data_dirs, config.train_split, config.val_split, config.max_images)


def _plan(trainee: TrainingRun, decoding: Decoding, validation: str) -> list[str]:
    """What this run is going to do, in lines."""
    config, process = trainee.config, trainee.process
    length = RunLength.of(config, decoding.n_images)
    parameters = sum(parameter.numel() for parameter in trainee.model.parameters()) / 1e6
    name = config.model.build if isinstance(config.model, CustomModel) else config.model.name
    processes = f" in {process.world} processes" if process.world > 1 else ""
    start = f", from step {trainee.step:,}" if trainee.step else ""
    return [
        f"{name} ({parameters:.1f} M parameters) on {process.device}{processes}, seed {config.seed}",
        f"training: {decoding.text()}",
        f"validation: {validation}",
        f"{counted(length.n_steps, 'step')} of {counted(config.batch, 'image')}, {config.epochs:g} "
        f"epoch{'s' * (config.epochs != 1)}{start}",
    ]


def _step(
    trainee: TrainingRun, distributed: nn.Module, task: nn.Module, batch: Batch, rate: float, done: float
) -> dict[str, Float[Tensor, ""]]:
    """One optimiser step, when the share `done` of training is over; returns the mean of each loss term."""
    config, process, step = trainee.config, trainee.process, trainee.step
    generator = generator_for(config.seed, step, process.rank, process.device)
    augmented = augment(batch.to(process.device), config.augmentation, generator)
    for group in trainee.optimizer.param_groups:
        group["lr"] = rate
    distributed.train()
    trainee.optimizer.zero_grad(set_to_none=True)
    terms: Terms = distributed(augmented, done)
    terms["total"].mean().backward()  # type: ignore[no-untyped-call]
    norm = nn.utils.clip_grad_norm_(trainee.model.parameters(), config.clip_norm)
    has_loss = torch.isfinite(terms["total"]).all()
    # One question for both, as the answer waits for the GPU.
    if not bool(has_loss & torch.isfinite(norm)):
        if not bool(has_loss):
            raise DivergenceError(f"step {step}: {_blame(task, augmented, done)}")
        raise DivergenceError(
            f"step {step}: expected a finite gradient, got {float(norm)} from {', '.join(batch.keys)}"
        )
    trainee.optimizer.step()
    trainee.average.update(trainee.model, step)
    return {name: value.detach().mean() for name, value in terms.items()}


def _blame(task: nn.Module, augmented: AugmentedBatch, done: float) -> str:
    """Find the samples with a non-finite loss. Batch norm mixes a batch, so the network is asked in evaluation mode."""
    with torch.no_grad():
        terms: Terms = task.eval()(augmented, done)
    keys = augmented.batch.keys
    bad = torch.nonzero(~torch.isfinite(terms["total"]))[:, 0].tolist() or list(range(len(keys)))
    values = {name: float(value[bad[0]]) for name, value in terms.items()}
    return f"expected a finite loss, got {values} from sample {', '.join(keys[i] for i in bad)}"


def _validate(trainee: TrainingRun, samples: Samples) -> EvaluationReport | None:
    if trainee.process.rank != 0:
        return None
    detector = Detector(trainee.average.model, trainee.config.model.size_px)
    found = detector.in_samples(samples, trainee.config.batch, trainee.config.workers)
    return score(found, MetricConfig(alternatives=(), bootstraps=0))


def _note(trainee: TrainingRun, report: EvaluationReport | None, steps_per_epoch: int) -> None:
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
    best, about = trainee.out_dir / "best.pt", trainee.about
    if score > trainee.best or not best.exists():
        trainee.best = score
        about = {**about, "step": trainee.step, "score": score}
        weights = trainee.average.model.state_dict()
        checkpoints.save(best, checkpoints.Checkpoint(trainee.config, about, weights, None))
    save(trainee, about)
