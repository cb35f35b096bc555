"""What people see of a training run: a progress line, `history.jsonl`, TensorBoard."""

import json
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from jaxtyping import Float
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor

from baseline_model.metrics import Report
from baseline_model.report import summary_line, to_document

WRITE_EVERY_S = 2.0


class Log:
    """Only the process of rank 0 shows and writes anything."""

    def __init__(self, out_dir: Path, n_steps: int, step: int, batch: int, *, is_shown: bool) -> None:
        self.out_dir, self.batch, self.is_shown = out_dir, batch, is_shown
        columns = (
            TextColumn("step {task.completed:.0f}/{task.total:.0f}"),
            BarColumn(),
            TextColumn("{task.fields[rate]:.1f} samples/s  loss {task.fields[loss]:.3f}"),
            TimeRemainingColumn(),
        )
        self.bar = Progress(*columns, console=Console(stderr=True), disable=not is_shown)
        self.task = self.bar.add_task("", total=n_steps, completed=step, rate=0.0, loss=float("nan"))
        self.board = _tensorboard(out_dir) if is_shown else None
        self.first_step, self.started_at, self.written_at = step, time.monotonic(), 0.0

    def __enter__(self) -> "Log":
        self.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.stop()
        if self.board is not None:
            self.board.close()

    def step(self, step: int, learning_rate: float, terms: dict[str, Float[Tensor, ""]]) -> None:
        """After an optimiser step; written every two seconds and at the end, since reading a GPU value waits for it."""
        now = time.monotonic()
        is_last = step == self.bar.tasks[0].total
        if not self.is_shown or (now - self.written_at < WRITE_EVERY_S and not is_last):
            return
        self.written_at = now
        speed = (step - self.first_step) * self.batch / max(now - self.started_at, 1e-6)
        values = {name: float(value) for name, value in terms.items()}
        self.bar.update(self.task, completed=step, rate=speed, loss=values["total"])
        scalars = {**{f"loss/{name}": value for name, value in values.items()}}
        scalars |= {"learning_rate": learning_rate, "samples_per_s": speed}
        self._write(step, {"step": step, **scalars}, scalars)

    def validation(self, step: int, report: Report | None) -> None:
        """After a validation."""
        if report is None:
            return
        document = to_document(report)
        scalars = {
            f"val/{kind}/{name}": value
            for kind in report.kinds
            for name, value in document[kind].items()
            if isinstance(value, float)
        }
        self._write(step, {"step": step, "val": document}, scalars)
        self.bar.console.print(f"step {step}: {summary_line(report)}", highlight=False, soft_wrap=True)

    def _write(self, step: int, document: dict[str, Any], scalars: dict[str, float]) -> None:
        with (self.out_dir / "history.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(document) + "\n")
        if self.board is not None:
            for name, value in scalars.items():
                self.board.add_scalar(name, value, step)


def _tensorboard(out_dir: Path) -> Any:
    """A writer, or None where tensorboard is not installed: `history.jsonl` holds the same numbers."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(out_dir / "tensorboard"))
