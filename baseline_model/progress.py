"""The output of a training run: a progress line, `history.jsonl`, TensorBoard."""

import importlib.util
import json
import os
import time
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Any

from jaxtyping import Float
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor

from synth3dlanes.system.files import Folder, read_bounded

from .metrics import EvaluationReport
from .report import summary_line, to_document

WRITE_EVERY_S = 2.0
LINE_EVERY_S = 30.0
MOST_HISTORY = 1 << 30
"""Bytes of `history.jsonl`: a line of 300 every two seconds for months."""


class ProgressLine(ExitStack):
    """Progress and remaining time: a progress bar on a terminal, which goes with the end, otherwise a new line every
    LINE_EVERY_S."""

    def __init__(self, what: str, total: int, done: int = 0, *, is_shown: bool) -> None:
        super().__init__()
        self.console, self.is_shown, self.printed_at = Console(stderr=True), is_shown, time.monotonic()
        columns = (
            TextColumn(f"{what} {{task.completed:.0f}}/{{task.total:.0f}}"),
            BarColumn(),
            TextColumn("{task.fields[note]}"),
            TimeRemainingColumn(compact=True),
            TextColumn("left"),
        )
        self.what, is_bar = what, is_shown and self.console.is_terminal
        bar = Progress(*columns, console=self.console, get_time=time.monotonic, transient=True, disable=not is_bar)
        self.bar = self.enter_context(bar)
        self.task = self.bar.add_task("", total=total, completed=done, note="")

    def update(self, done: int, total: int, note: str | None = None) -> None:
        """Set the progress to `done` of `total`, with a new note unless it is None."""
        note = self.bar.tasks[0].fields["note"] if note is None else note
        self.bar.update(self.task, completed=done, total=total, note=note)
        # The end has a line of its own.
        is_due = time.monotonic() - self.printed_at > LINE_EVERY_S and done < total
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

    def __init__(
        self, out_dir: Path, n_steps: int, steps_per_epoch: int, step: int, batch: int, *, is_shown: bool
    ) -> None:
        super().__init__()
        self.out_dir, self.batch, self.is_shown = out_dir, batch, is_shown
        self.n_steps, self.steps_per_epoch = n_steps, steps_per_epoch
        self._loss: Float[Tensor, ""] | None = None
        self._steps_of_loss = 0
        # `history.jsonl` has the same numbers.
        has_board = is_shown and importlib.util.find_spec("tensorboard") is not None
        self.board = BoardLog(out_dir, step) if has_board else None
        self.line = self.enter_context(ProgressLine("step", n_steps, step, is_shown=is_shown))
        self.first_step, self.started_at, self.written_at = step, time.monotonic(), 0.0

    def step(self, step: int, learning_rate: float, terms: dict[str, Float[Tensor, ""]]) -> None:
        """Log an optimiser step, every two seconds and at the end: reading values from the GPU waits for it."""
        # Summed where it is: reading it would wait for the GPU.
        self._loss = terms["total"] if self._loss is None else self._loss + terms["total"]
        self._steps_of_loss += 1
        now = time.monotonic()
        self.line.update(step, self.n_steps)
        if not self.is_shown or (now - self.written_at < WRITE_EVERY_S and step < self.n_steps):
            return
        self.written_at = now
        speed = self._images_per_s(step)
        values = {name: float(value) for name, value in terms.items()}
        self.line.update(step, self.n_steps, f"{speed:.1f} images/s  loss {values['total']:.4g}")
        scalars = {f"loss/{name}": value for name, value in values.items()}
        scalars |= {"learning_rate": learning_rate, "samples_per_s": speed}
        self._write(step, {"step": step, **scalars}, scalars)

    def validation(self, step: int, report: EvaluationReport | None) -> None:
        """Log a validation, which no process but the first has."""
        if report is None:
            return
        document = to_document(report)
        values = {f"val/{kind}/{name}": value for kind in report.kinds for name, value in document[kind].items()}
        scalars = {name: value for name, value in values.items() if isinstance(value, float)}
        self._write(step, {"step": step, "val": document}, scalars)

    def epoch(self, step: int, report: EvaluationReport | None) -> None:
        """Print the line of an epoch, or of a part of one that ends in a validation: the mean loss since the last line,
        the validation, the speed and the time left."""
        if self._loss is None or not self.is_shown:
            return
        loss, self._loss = float(self._loss) / self._steps_of_loss, None
        self._steps_of_loss = 0
        of, speed = self.steps_per_epoch, self._images_per_s(step)
        left = timedelta(seconds=round((self.n_steps - step) * self.batch / speed))
        told = [
            f"loss {loss:.4g}",
            *([summary_line(report)] if report else []),
            f"{speed:.1f} images/s",
            *([f"{left} left"] if step < self.n_steps else []),
        ]
        self.line.say(f"epoch {step / of:.3g}/{self.n_steps / of:.3g}: {', '.join(told)}")

    def _images_per_s(self, step: int) -> float:
        return max(step - self.first_step, 1) * self.batch / max(time.monotonic() - self.started_at, 1e-6)

    def _write(self, step: int, document: dict[str, Any], scalars: dict[str, float]) -> None:
        with Folder(self.out_dir).append("history.jsonl") as file:
            file.write(f"{json.dumps(document)}\n".encode())
        if self.board is not None:
            self.board.add(scalars, step)


def trim_history(out_dir: Path, step: int, scale: Fraction) -> None:
    """Keep of `history.jsonl` what was written up to the step, of the batch before, from which a run goes on. A killed
    run leaves later lines, and a part of one. `scale` are steps of now per step of then."""
    folder = Folder(out_dir)
    if not folder.exists("history.jsonl"):
        return
    folder.expect_file("history.jsonl")
    kept = dict[tuple[int, bool], bytes]()
    data = read_bounded(out_dir / "history.jsonl", MOST_HISTORY)
    for line in data.splitlines():
        try:
            entry = json.loads(line)
            found, is_validation = int(entry["step"]), "val" in entry
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            continue
        if found <= step:
            entry["step"] = int(found * scale)
            kept[entry["step"], is_validation] = f"{json.dumps(entry)}\n".encode()
    trimmed = b"".join(kept.values())
    if trimmed != data:
        folder.write("history.jsonl", trimmed)


class BoardLog:
    """A log for TensorBoard, written as it is told, in records of TensorFlow's format."""

    def __init__(self, out_dir: Path, step: int) -> None:
        from tensorboard.compat.proto import event_pb2, summary_pb2  # type: ignore[import-untyped,import-not-found,unused-ignore]
        from tensorboard.summary.writer.record_writer import RecordWriter  # type: ignore[import-untyped,import-not-found,unused-ignore]

        self._events, self._summary, self._writer, self._folder = (
            event_pb2,
            summary_pb2.Summary,
            RecordWriter,
            Folder(out_dir),
        )
        self._folder.make("tensorboard")
        now = datetime.now(UTC).timestamp()
        self._path = f"tensorboard/events.out.tfevents.{now:.0f}.{os.uname().nodename}.{os.getpid()}"
        self._add(file_version="brain.Event:2")
        if step:
            # What an earlier process told of later steps does not hold.
            self._add(step=step + 1, session_log=event_pb2.SessionLog(status=event_pb2.SessionLog.START))

    def add(self, scalars: dict[str, float], step: int) -> None:
        """Log values."""
        values = [self._summary.Value(tag=name, simple_value=value) for name, value in scalars.items()]
        self._add(step=step, summary=self._summary(value=values))

    def _add(self, **content: Any) -> None:
        record = BytesIO()
        event = self._events.Event(wall_time=datetime.now(UTC).timestamp(), **content)
        self._writer(record).write(event.SerializeToString())
        with self._folder.append(self._path) as file:
            file.write(record.getvalue())
