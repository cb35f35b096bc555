"""The output of a training run: a progress line, `history.jsonl`, TensorBoard."""

import json
import time
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any

from jaxtyping import Float
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor

from synth3dlanes.files import Folder

from .metrics import EvaluationReport
from .report import summary_line, to_document

WRITE_EVERY_S = 2.0
LINE_EVERY_S = 30.0


class ProgressLine(ExitStack):
    """Progress and remaining time: a progress bar on a terminal, otherwise a new line every LINE_EVERY_S."""

    def __init__(self, what: str, total: int, done: int = 0, *, is_shown: bool) -> None:
        super().__init__()
        self.console, self.is_shown, self.printed_at = Console(stderr=True), is_shown, time.monotonic()
        columns = (
            TextColumn(f"{what} {{task.completed:.0f}}/{{task.total:.0f}}"),
            BarColumn(),
            TextColumn("{task.fields[note]}"),
            TimeRemainingColumn(),
        )
        self.what, is_bar = what, is_shown and self.console.is_terminal
        bar = Progress(*columns, console=self.console, get_time=time.monotonic, disable=not is_bar)
        self.bar = self.enter_context(bar)
        self.task = self.bar.add_task("", total=total, completed=done, note="")

    def update(self, done: int, total: int, note: str = "") -> None:
        """Set the progress to `done` of `total`."""
        self.bar.update(self.task, completed=done, total=total, note=note)
        is_due = time.monotonic() - self.printed_at > LINE_EVERY_S
        if self.is_shown and self.bar.disable and is_due:
            self.printed_at = time.monotonic()
            left_s = self.bar.tasks[0].time_remaining
            left = "" if left_s is None else f"  {timedelta(seconds=round(left_s))} left"
            self.say(f"{self.what} {done}/{total}  {note}{left}")

    def say(self, text: str) -> None:
        """Print a permanent line."""
        if self.is_shown:
            self.console.print(text, highlight=False, markup=False, soft_wrap=True)


class TrainingLog(ExitStack):
    """The training log. Only the process of rank 0 prints and writes."""

    def __init__(self, out_dir: Path, n_steps: int, step: int, batch: int, *, is_shown: bool) -> None:
        super().__init__()
        self.out_dir, self.batch, self.is_shown, self.n_steps = out_dir, batch, is_shown, n_steps
        self.line = self.enter_context(ProgressLine("step", n_steps, step, is_shown=is_shown))
        self.board = _tensorboard(out_dir) if is_shown else None
        if self.board is not None:
            self.callback(self.board.close)
        self.first_step, self.started_at, self.written_at = step, time.monotonic(), 0.0

    def step(self, step: int, learning_rate: float, terms: dict[str, Float[Tensor, ""]]) -> None:
        """Log an optimiser step, every two seconds and at the end: reading values from the GPU waits for it."""
        now = time.monotonic()
        if not self.is_shown or (now - self.written_at < WRITE_EVERY_S and step < self.n_steps):
            return
        self.written_at = now
        speed = (step - self.first_step) * self.batch / max(now - self.started_at, 1e-6)
        values = {name: float(value) for name, value in terms.items()}
        self.line.update(step, self.n_steps, f"{speed:.1f} samples/s  loss {values['total']:.3f}")
        scalars = {f"loss/{name}": value for name, value in values.items()}
        scalars |= {"learning_rate": learning_rate, "samples_per_s": speed}
        self._write(step, {"step": step, **scalars}, scalars)

    def validation(self, step: int, report: EvaluationReport | None) -> None:
        """Log a validation."""
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
        self.line.say(f"step {step}: {summary_line(report)}")

    def _write(self, step: int, document: dict[str, Any], scalars: dict[str, float]) -> None:
        with Folder(self.out_dir).append("history.jsonl") as file:
            file.write(f"{json.dumps(document)}\n".encode())
        if self.board is not None:
            for name, value in scalars.items():
                self.board.add_scalar(name, value, step)


def _tensorboard(out_dir: Path) -> Any:
    """A writer, or None if tensorboard is not installed; `history.jsonl` has the same numbers."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    Folder(out_dir).make("tensorboard")
    return SummaryWriter(str(out_dir / "tensorboard"))
