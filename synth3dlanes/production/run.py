"""Many samples: plan, resume, supervise, report.

What is done is what lies on disk (`dataset.write`): a run looks for the samples that are nowhere, deals them to worker
processes one by one, and joins a shard once all its samples are there. The workers write their finished samples
themselves, whole or not at all, so nothing that anyone holds in memory matters: killing a worker, this process or the
machine costs the samples at hand and no other, and running again continues. Bytes depend on the recipe and the index
alone, so whoever makes a sample, and when, makes the same one.

A sample that fails three times (or whose worker others kill twenty times) is set aside under DIR/failed with its scene
and the worker's last words; its shard is joined without it, and the next run tries it again. Ten in a row mean that
the machine is at fault, and stop the run, as do missing files and libraries. A full disk makes it wait. SIGINT and
SIGTERM let the samples at hand finish. `part` i of n takes the shards whose number is i - 1 modulo n, so parts never
meet: they may share a folder (each shard has its lock) or have their folders copied together.
"""

import math
import re
import shutil
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from synth3dlanes.dataset.folder import claim
from synth3dlanes.dataset.format import key_of, recipe_text
from synth3dlanes.dataset.write import Shard, write_whole
from synth3dlanes.errors import InputError
from synth3dlanes.production.devices import WorkerSlots, n_cores, resolve_device
from synth3dlanes.production.events import Event, duration
from synth3dlanes.production.progress import Forecast, Meter, forecast, open_log
from synth3dlanes.production.recipe import Made, Recipe, make_part, make_sample, scene_json
from synth3dlanes.production.signals import stopping_on_signals
from synth3dlanes.production.workers import DISK_FULL, Limits, Outcome, Pool

SHARD_SIZE = 1000
SPLIT = re.compile(r"[A-Za-z0-9_-]+")
MAX_FAILURES, MAX_KILLS, MAX_IN_A_ROW = 3, 20, 10
# How long the samples at hand may take once the run is to stop.
GRACE_S = 20.0
POLL_S = 0.5
FREE_MARK_SHARE, FREE_MARK_BYTES = 0.01, 1 << 30


@dataclass(frozen=True)
class Plan:
    """Samples 0 to n - 1 of the recipe's split, in `out`. `workers` 0 is one for each core; `part` counts from 1."""

    out: Path
    n: int
    recipe: Recipe
    workers: int = 0
    part: tuple[int, int] = (1, 1)
    limits: Limits = field(default_factory=Limits)
    slots: WorkerSlots = field(default_factory=WorkerSlots)
    shard_size: int = SHARD_SIZE
    maker: Callable[[Recipe, int], Made] = make_sample

    def __post_init__(self) -> None:
        (part, parts), split = self.part, self.recipe.split
        problems = [
            *([] if self.n >= 0 else [f"n: expected 0 or more, got {self.n}"]),
            *([] if self.workers >= 0 else [f"workers: expected 0 or more, got {self.workers}"]),
            *([] if SPLIT.fullmatch(split) else [f"split: expected letters, digits, - and _, got {split!r}"]),
            *([] if 1 <= part <= parts else [f"part: expected i/n with 1 <= i <= n, got {part}/{parts}"]),
        ]
        if problems:
            raise InputError(*problems)

    def shards(self) -> list[int]:
        """The numbers of this part's shards."""
        part, parts = self.part
        return list(range(part - 1, math.ceil(self.n / self.shard_size), parts))

    def only(self, number: int) -> "Plan":
        """The plan for one shard alone."""
        return replace(self, part=(number + 1, math.ceil(self.n / self.shard_size)))

    def layout(self, root: Path) -> dict[int, Shard]:
        """This part's shards by number, in the data set at `root`."""
        folder, names, recipe = root / self.recipe.split, self.recipe.names, recipe_text(self.description())
        return {number: Shard(folder, number, self.shard_size, names, recipe) for number in self.shards()}

    def description(self) -> dict[str, Any]:
        """What `dataset.json` says about the recipe and the layout."""
        return {**self.recipe.description(), "shard_size": self.shard_size}

    def settled(self) -> "Plan":
        """The plan with this machine's device and workers; raise InputError without Blender or that device."""
        if self.maker is not make_sample:
            return self
        recipe, slots = resolve_device(self.recipe)
        return replace(self, recipe=recipe, slots=slots, workers=self.workers or slots.workers)

    def n_workers(self, n_tasks: int) -> int:
        """How many workers there is work and room for."""
        return max(1, min(self.workers or n_cores(), n_tasks))


@dataclass(frozen=True)
class Report:
    """What a run has done: samples made by it, samples there are now of those asked for, and what went wrong.
    `restarts` counts workers that were replaced for a fault."""

    made: int
    done: int
    asked: int
    set_aside: tuple[int, ...]
    interrupted: bool
    problem: str
    restarts: int
    seconds: float

    def text(self) -> str:
        """What a person wants to know of it, in a line."""
        pace = f" in {duration(self.seconds)} ({3600 * self.made / self.seconds:,.0f} images/h)" if self.made else ""
        faults = {"restarts of workers": self.restarts, "samples set aside": len(self.set_aside)}
        told = "".join(f", {count} {what}" for what, count in faults.items() if count)
        return f"{self.done} of {self.asked} samples, {self.made} made now{pace}{told}"

    @property
    def exit_code(self) -> int:
        """0 all is there; 130 stopped by a signal; 1 something is missing."""
        if self.problem or self.set_aside:
            return 1
        return 130 if self.interrupted else 0


def generate(plan: Plan, notify: Callable[[Event], None]) -> Report:
    """Make what is missing of a plan's samples; `notify` hears of everything that happens.

    Raises InputError where it cannot start: no Blender, no such device, no room, another run or another recipe in the
    folder.
    """
    plan = plan.settled()
    with claim(plan.out, plan.description(), plan.recipe.split, plan.n, plan.shards()) as folder:
        return _Run(plan, folder, notify).go()


class _Run:
    """The state of one run: what is to do, what has failed how often, and why it is to stop."""

    def __init__(self, plan: Plan, folder: Path, notify: Callable[[Event], None]) -> None:
        self.plan = plan
        self.notify = notify
        self.shards = plan.layout(plan.out)
        missing = {number: shard.missing(plan.n) for number, shard in self.shards.items()}
        self.left = {number: len(indices) for number, indices in missing.items()}
        self.todo = deque(("make", index) for indices in missing.values() for index in indices)
        self.meter = Meter(sum(len(shard.indices(plan.n)) for shard in self.shards.values()), len(self.todo))
        self.failures: Counter[int] = Counter()
        self.kills: Counter[int] = Counter()
        self.in_a_row = self.restarts = 0
        self.interrupted = False
        self.problem = ""
        self.stop_by = math.inf
        usage = shutil.disk_usage(folder)
        self.free_mark = min(FREE_MARK_BYTES, int(usage.total * FREE_MARK_SHARE))
        self.room_needed = self.free_mark

    def go(self) -> Report:
        expected = forecast(self.plan.recipe, len(self.todo), self.plan.n_workers(len(self.todo)))
        self._check_room(expected)
        self.log = open_log(self.plan.out / "logs", self.plan.recipe.split)
        with self.log:
            device, names = self.plan.recipe.settings.device, self.plan.slots.names
            self._tell("start", expected.text(), **vars(expected), device=device, device_names=names)
            try:
                self._loop()
            except OSError as error:
                self.problem = f"{self.plan.out}: {type(error).__name__}: {error}"
            self._tell("end", self.problem or "interrupted" * self.interrupted or "complete")
        meter = self.meter
        return Report(
            meter.made,
            meter.done,
            meter.asked,
            tuple(sorted(meter.set_aside)),
            self.interrupted,
            self.problem,
            self.restarts,
            meter.seconds,
        )

    def _loop(self) -> None:
        n_workers = self.plan.n_workers(len(self.todo))
        workers = Pool(n_workers, self.plan.limits, masks=self.plan.slots.masks)
        with stopping_on_signals(self._interrupt), ThreadPoolExecutor(1) as self.joiner, workers as pool:
            self.joins: dict[int, Future[list[int]]] = {}
            for number, shard in self.shards.items():
                if not self.left[number] and shard.needs_join(self.plan.n):
                    self._join(number)
            while (self.todo and not self._stopping) or pool.busy or self.joins:
                while self.todo and not self._stopping and pool.busy < pool.n and self._has_room():
                    self._start(pool, *self.todo.popleft())
                for outcome in pool.wait(POLL_S):
                    self._handle(outcome)
                for number in [number for number, join in self.joins.items() if join.done()]:
                    self._joined(number, self.joins.pop(number))
                if time.monotonic() > self.stop_by:
                    break

    @property
    def _stopping(self) -> bool:
        return self.interrupted or bool(self.problem)

    def _start(self, pool: Pool, kind: str, index: int) -> None:
        recipe = self.plan.recipe
        if kind == "make":
            pool.start((kind, index), make_part, self.plan.maker, recipe, self._shard(index), index)
        else:
            pool.start((kind, index), scene_json, recipe, index)

    def _handle(self, outcome: Outcome) -> None:
        kind, index = outcome.task
        if kind == "scene":
            if outcome.status == "done":
                write_whole(self._failed(index) / "scene.json", f"{outcome.value}\n".encode())
            self._finished(index)
        elif outcome.status == "done":
            self.in_a_row = 0
            self.meter.sample()
            if self._failed(index).exists():
                shutil.rmtree(self._failed(index))
            self._tell("sample", key_of(index), index=index, **outcome.value)
            self._finished(index)
        elif outcome.status in ("full", "broken"):
            self.todo.appendleft((kind, index))
            if outcome.status == "full":
                self._full(outcome.reason)
            else:
                self.problem = self.problem or outcome.reason
        else:
            self._retry(index, outcome)

    def _retry(self, index: int, outcome: Outcome) -> None:
        self.restarts += 1
        (self.kills if outcome.status == "killed" else self.failures)[index] += 1
        self._tell("restart", f"{key_of(index)}: {outcome.reason}", index=index, stderr=outcome.stderr)
        if self.failures[index] < MAX_FAILURES and self.kills[index] < MAX_KILLS:
            self.todo.appendleft(("make", index))
            return
        self.meter.set_aside.append(index)
        self.in_a_row += 1
        folder = self._failed(index)
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "stderr.txt", f"{outcome.stderr}\n{outcome.reason}\n".encode())
        self.todo.appendleft(("scene", index))
        self._tell("set_aside", f"{key_of(index)}: {outcome.reason}; see {folder}", index=index)
        if self.in_a_row >= MAX_IN_A_ROW:
            self.problem = f"{MAX_IN_A_ROW} scenes in a row failed, the last with: {outcome.reason}"

    def _finished(self, index: int) -> None:
        number = index // self.plan.shard_size
        self.left[number] -= 1
        if not self.left[number]:
            self._join(number)

    def _join(self, number: int) -> None:
        self.joins[number] = self.joiner.submit(_join_shard, self.shards[number], self.plan.n)

    def _joined(self, number: int, join: Future[list[int]]) -> None:
        """A part that was found broken is missing again; a full disk is waited for."""
        error = join.exception()
        if isinstance(error, OSError) and error.errno in DISK_FULL and not self._stopping:
            self._full(str(error))
            self._join(number)
            return
        missing = [index for index in join.result() if index not in self.meter.set_aside]
        self.left[number] = len(missing)
        self.meter.lose(len(missing))
        self.todo.extendleft(("make", index) for index in reversed(missing))
        self._tell("shard", str(self.shards[number].path("tar")), shard=number)

    def _full(self, reason: str) -> None:
        free = shutil.disk_usage(self.plan.out).free
        self.room_needed = max(2 * self.free_mark, free + (1 << 20))
        self._tell("pause", f"{reason}; waiting for {self.room_needed >> 20} MiB free on {self.plan.out}")
        time.sleep(POLL_S)

    def _has_room(self) -> bool:
        free = shutil.disk_usage(self.plan.out).free
        if free < self.room_needed and self.room_needed == self.free_mark:
            self._full(f"only {free >> 20} MiB free")
        elif free >= self.room_needed > self.free_mark:
            self.room_needed = self.free_mark
            self._tell("resume", f"{free >> 20} MiB free")
        return free >= self.room_needed

    def _check_room(self, expected: Forecast) -> None:
        free = shutil.disk_usage(self.plan.out).free
        if self.todo and free < expected.bytes_needed + self.free_mark:
            needed, there = ((size / 1e9) for size in (expected.bytes_needed + self.free_mark, free))
            raise InputError(
                f"out {self.plan.out}: expected {needed:.3g} GB free for {len(self.todo)} samples, got {there:.3g} GB"
            )

    def _interrupt(self) -> None:
        self.interrupted = True
        self.stop_by = time.monotonic() + GRACE_S

    def _tell(self, kind: str, message: str, **details: Any) -> None:
        event = self.meter.event(kind, message, details)
        # A full disk may cost lines of the log, not the run.
        with suppress(OSError):
            self.log.write(event.line().encode())
        self.notify(event)

    def _shard(self, index: int) -> Shard:
        return self.shards[index // self.plan.shard_size]

    def _failed(self, index: int) -> Path:
        return self.plan.out / "failed" / self.plan.recipe.split / key_of(index)


def _join_shard(shard: Shard, n: int) -> list[int]:
    shard.join(n)
    return shard.missing(n)
