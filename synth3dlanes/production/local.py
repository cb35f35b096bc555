"""Make samples on this machine, with supervised worker processes.

The state of a run is what is on disk (`dataset.write`). Each missing sample is given to a worker; a shard is joined
when all its samples are there. A worker writes its finished sample itself, whole or not at all. So killing a worker,
this process or the machine costs the samples in progress and no other.

A sample that fails three times, or whose worker is killed from outside twenty times, is set aside under DIR/failed with
its scene and the worker's last words; at once, if its scene cannot be drawn. Its shard is joined without it, and the
next run tries it again. Ten failures in a row mean that the machine or the parameters are at fault, and stop the run,
as do missing files and libraries. While the disk is full, the run waits.
"""

import os
import time
from collections import Counter, deque
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path, PurePath
from typing import Any

from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.format import key_of
from synth3dlanes.dataset.patience import LIMIT_S, Patience
from synth3dlanes.dataset.write import Shard
from synth3dlanes.production.forecast import Room, forecast, is_full, patience_s
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import make_part, scene_json
from synth3dlanes.production.tally import RunTally
from synth3dlanes.production.workers import Limits, Outcome, Pool
from synth3dlanes.system.errors import DrawError, FormatError, LinkError, OutageError, told
from synth3dlanes.system.files import Folder

MAX_FAILURES, MAX_KILLS, MAX_IN_A_ROW = 3, 20, 10
POLL_S = 0.5
# Files beside one per worker: the folders of a shard, its tar and its index.
FILES_OF_A_SHARD = 4


def make_here(plan: Plan, tally: RunTally) -> None:
    """Make the samples that a plan's destination lacks; for a store, one shard after the other.

    Raises DiskFullError if there is no room to begin, LinkError if a link is in the way.
    """
    destination, shards = plan.destination, plan.shards()
    if not destination.is_store:
        here = {number: shard.within(destination.folder) for number, shard in shards.items()}
        _Run(plan, destination.folder, here, tally).go()
        return
    patience = Patience(LIMIT_S, tally.tell, lambda: tally.is_stopping)
    left = set(destination.spooled(plan.recipe.scenes.split, recipe_text(plan.description())))
    try:
        for number in sorted(left | shards.keys()):
            # All that an earlier run left of a shard of another part is put, too.
            n = plan.n if number in shards else (number + 1) * plan.shard_size
            asked = partial(destination.missing, plan.shard(number), n)
            missing = patience.insist(destination.place, asked, "what is finished is there")
            if (missing or number in left) and not tally.is_stopping:
                _make_for_store(plan, number, n, missing, tally, patience)
    except OutageError as error:
        if tally.stop_signal:
            tally.tell("pause", str(error))
        else:
            tally.problem = str(error)


def _make_for_store(plan: Plan, number: int, n: int, missing: list[int], tally: RunTally, patience: Patience) -> None:
    """Make what a store lacks of the samples below `n` of a shard; of another part's, put what is made already."""
    is_ours = number in plan.shards()
    try:
        with plan.destination.working_copy(plan.shard(number), patience) as shard:
            found = sorted(set(missing) - set(shard.missing(n)))
            if found:
                told = f"shard {number}: {len(found)} finished samples of an earlier run are in {shard.folder.parent}"
                tally.tell("resume", f"{told}, and are put into the store", shard=number, found=found)
            if is_ours:
                _Run(plan, shard.folder.parent, {number: shard}, tally).go()
            if shard.needs_join(n):
                shard.claimed().join(n)
    except OutageError as error:
        tally.tell("shard", str(error), shard=number, lost=missing if is_ours else [])
        raise


class _Run:
    """The making of some shards in the data set at `root`: what is to do, what has failed how often."""

    def __init__(self, plan: Plan, root: Path, shards: dict[int, Shard], tally: RunTally) -> None:
        self.plan, self.root, self.tally = plan, root, tally
        self.folder = root.stat()
        self.shards = {number: shard.claimed() for number, shard in shards.items()}
        missing = {number: shard.missing(plan.n) for number, shard in self.shards.items()}
        self.left = {number: len(indices) for number, indices in missing.items()}
        self.todo = deque(("make", index) for indices in missing.values() for index in indices)
        self.joins: dict[int, Future[dict[int, str]]] = {}
        self.unjoined: list[int] = []  # shards that the disk had no room for
        self.scenes: dict[int, int] = {}  # that workers have, by worker
        self.failures: Counter[int] = Counter()
        self.kills: Counter[int] = Counter()
        self.opened: set[Shard] = set()
        self.given_up: set[int] = set()
        self.in_a_row = 0
        self.n_workers = plan.n_workers(len(self.todo))
        self.room = Room(root, self.n_workers + FILES_OF_A_SHARD)
        self.expected = forecast(plan.recipe, len(self.todo), self.n_workers)
        self.n_pauses = 0
        self.begun: dict[tuple[str, int], int] = {}  # the pauses there had been when a task began

    def go(self) -> None:
        self.expected.require_room(self.root, self.room.mark)
        try:
            self._loop()
        except (OSError, FormatError) as error:
            # A join during which the data set's folder is moved away finds half a shard.
            if self._has_moved():
                self.tally.problem = f"{self.root}: the folder is gone"
            elif isinstance(error, OSError):
                self.tally.problem = f"{self.root}: {told(error)}"
            else:
                raise
        finally:
            for shard in self.opened:
                with suppress(OSError, LinkError):
                    shard.close()

    def _has_moved(self) -> bool:
        """Whether the data set's folder is no longer where it was."""
        try:
            return not os.path.samestat(self.folder, self.root.stat())
        except OSError:
            return True

    def _loop(self) -> None:
        plan, tally = self.plan, self.tally
        limits = plan.limits or Limits(patience_s(plan.recipe))
        workers = Pool(self.n_workers, limits, masks=plan.slots.masks)
        with ThreadPoolExecutor(1) as self.joiner, workers as pool:
            for number, shard in self.shards.items():
                if not self.left[number] and shard.needs_join(plan.n):
                    self._join(number)
            while ((self.todo or self.unjoined) and not tally.is_stopping) or pool.busy or self.joins:
                while self.unjoined and not tally.is_stopping and self._has_room():
                    self._join(self.unjoined.pop())
                while self.todo and not tally.is_stopping and pool.idle and self._has_room():
                    slot = pool.idle[0]
                    self._start(pool, slot, *self._next(slot))
                # A pool without tasks sleeps for as long as it is asked to wait.
                if self.joins and not pool.busy:
                    wait(self.joins.values(), POLL_S, FIRST_COMPLETED)
                else:
                    for outcome in pool.wait(POLL_S):
                        self._handle(outcome)
                tally.acknowledge()
                for number in [number for number, join in self.joins.items() if join.done()]:
                    self._joined(number, self.joins.pop(number))
                if time.monotonic() > tally.stop_by:
                    break

    def _next(self, slot: int) -> tuple[str, int]:
        """The next task for a worker: of the scene that it made last, else of a scene that no other worker makes. What
        a worker has drawn and built serves all pictures of a scene."""
        shots, others = self.plan.recipe.scenes.shots, {scene for at, scene in self.scenes.items() if at != slot}
        scenes = [shots.place(index).scene for _, index in islice(self.todo, (len(others) + 1) * shots.per_scene + 1)]
        free = (at for at, scene in enumerate(scenes) if scene not in others)
        at = scenes.index(self.scenes[slot]) if self.scenes.get(slot) in scenes else next(free, 0)
        self.scenes[slot], task = scenes[at], self.todo[at]
        del self.todo[at]
        return task

    def _start(self, pool: Pool, slot: int, kind: str, index: int) -> None:
        recipe = self.plan.recipe
        self.begun[kind, index] = self.n_pauses
        if kind == "make":
            shard = self.shards[index // self.plan.shard_size]
            try:
                shard.open()
            except OSError as error:
                if not is_full(error):
                    raise
                self.todo.appendleft((kind, index))
                self._full(told(error), self._sample_bytes())
                return
            self.opened.add(shard)
            pool.start((kind, index), _make_part, self.plan.maker, recipe, shard, index, slot=slot)
        else:
            pool.start((kind, index), scene_json, recipe, index, slot=slot)

    def _handle(self, outcome: Outcome) -> None:
        kind, index = outcome.task
        if kind == "scene":
            if outcome.status == "done":
                Folder(self.root).write(self._failed(index) / "scene.json", f"{outcome.value}\n".encode())
            self._finished(index)
        elif isinstance(outcome.value, LinkError):
            raise outcome.value
        elif isinstance(outcome.value, DrawError):
            self._set_aside(index, str(outcome.value))
            self._finished(index)
        elif outcome.status == "done":
            self.in_a_row = 0
            self.room.has_been_of_use()
            Folder(self.root).remove_tree(self._failed(index))
            self.tally.tell("sample", key_of(index), index=index, **outcome.value)
            self._finished(index)
        elif outcome.status in ("full", "broken"):
            self.todo.appendleft((kind, index))
            if outcome.status == "full":
                self._ended_full(outcome.task, outcome.reason, self._sample_bytes())
            else:
                self.tally.problem = self.tally.problem or outcome.reason
        else:
            self._retry(index, outcome)

    def _retry(self, index: int, outcome: Outcome) -> None:
        (self.kills if outcome.status == "killed" else self.failures)[index] += 1
        self.tally.tell("restart", f"{key_of(index)}: {outcome.reason}", index=index, stderr=outcome.stderr)
        if self.failures[index] < MAX_FAILURES and self.kills[index] < MAX_KILLS:
            self.todo.appendleft(("make", index))
            return
        self._set_aside(index, outcome.reason, outcome.stderr)
        self.todo.appendleft(("scene", index))

    def _set_aside(self, index: int, reason: str, stderr: str = "") -> None:
        self.given_up.add(index)
        self.in_a_row += 1
        folder = self._failed(index)
        Folder(self.root).make(folder)
        Folder(self.root).write(folder / "stderr.txt", f"{stderr}\n{reason}\n".lstrip().encode())
        self.tally.tell("set_aside", f"{key_of(index)}: {reason}; see {self._place(self.root / folder)}", index=index)
        if self.in_a_row >= MAX_IN_A_ROW:
            self.tally.problem = f"{MAX_IN_A_ROW} scenes in a row failed, the last with: {reason}"

    def _finished(self, index: int) -> None:
        number = index // self.plan.shard_size
        self.left[number] -= 1
        if not self.left[number]:
            self._join(number)

    def _join(self, number: int) -> None:
        self.begun["join", number] = self.n_pauses
        self.joins[number] = self.joiner.submit(_join_shard, self.shards[number], self.plan.n)

    def _joined(self, number: int, join: Future[dict[int, str]]) -> None:
        """Join a shard. A broken part is made again, with as many tries as a failed one. A full disk is waited for."""
        error = join.exception()
        if error is not None and is_full(error):
            self.unjoined.append(number)
            self._ended_full(("join", number), told(error), self._shard_bytes(self.shards[number]))
            return
        lost = {index: reason for index, reason in join.result().items() if index not in self.given_up}
        self.left[number] = len(lost)
        self.tally.tell("shard", self._place(self.shards[number].path("tar")), shard=number, lost=list(lost))
        for index, reason in reversed(lost.items()):
            self._retry(index, Outcome(("make", index), "failed", reason=reason))

    def _ended_full(self, task: tuple[str, int], reason: str, n_bytes: int) -> None:
        """Pause where a task found the disk full, unless it began before the latest pause: there may be room since."""
        if self.begun[task] == self.n_pauses:
            self._full(reason, n_bytes)

    def _full(self, reason: str, n_bytes: int) -> None:
        self.n_pauses += 1
        self.room.wait(n_bytes)
        self.tally.tell("pause", f"{reason}; waiting for room on {self.root}")

    def _has_room(self) -> bool:
        if self.room.is_waiting and self.room.is_back():
            self.tally.tell("resume", f"there is room on {self.root} again")
        if not self.room.is_waiting and self.room.is_low:
            self._full(f"only {self.room.free >> 20} MiB free", self._sample_bytes())
        return not self.room.is_waiting

    def _sample_bytes(self) -> int:
        """About how many bytes the samples in progress take."""
        return self.n_workers * self.expected.bytes_kept // max(1, self.expected.samples)

    def _shard_bytes(self, shard: Shard) -> int:
        """The bytes that a shard takes beside its parts while it is joined."""
        return sum(path.stat().st_size for path in (*shard.parts().values(), shard.path("tar")) if path.exists())

    def _failed(self, index: int) -> PurePath:
        """The folder of the data set for what is known about a failed sample."""
        return PurePath("failed") / self.plan.recipe.scenes.split / key_of(index)

    def _place(self, path: Path) -> str:
        """The path of a file at the destination, for messages."""
        return f"{self.plan.destination.place.rstrip('/')}/{path.relative_to(self.root).as_posix()}"


def _join_shard(shard: Shard, n: int) -> dict[int, str]:
    """The samples that the shard lacks, and why."""
    unread = shard.join(n)
    return {index: unread.get(index, "its file is gone") for index in shard.missing(n)}


def _make_part(*args: Any) -> Any:
    """Like `make_part`, but returns the problem if a link is in the way, which every other worker would meet too, or if
    the scene cannot be drawn, which no other try changes."""
    try:
        return make_part(*args)
    except (DrawError, LinkError) as error:
        return error
