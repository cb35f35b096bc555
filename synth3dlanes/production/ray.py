"""Shards as tasks of a Ray cluster. One node makes each shard, with the workers that a run on one machine has.

Blender stays in those workers; Ray's own process only supervises them. If the node of a task dies, another node makes
the shard; in a shared folder it continues where the first one was. The state of a run is what is at the destination,
never the answer of a task, so different executors may continue the same data set. Progress reports of tasks may be
lost: at the end, samples are counted at the destination.
"""

import math
import os
import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import Any

from synth3dlanes.dataset.patience import LIMIT_S, Patience, since
from synth3dlanes.production.devices import WORKERS_PER_GPU, resolve_device
from synth3dlanes.production.events import Event
from synth3dlanes.production.local import make_here
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import make_sample
from synth3dlanes.production.signals import stopping_on_signals
from synth3dlanes.production.tally import GRACE_S, RunTally
from synth3dlanes.system.errors import ClaimedError, InputError, MissingPackageError, OutageError, how_to_install

try:
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    from synth3dlanes.production.cluster import Cluster
    from synth3dlanes.production.cluster import connected as connected
except ModuleNotFoundError as error:
    raise MissingPackageError(f"Ray is not installed: {how_to_install('cluster')}") from error

# The most cores that one task asks for. More workers would idle while the last sample of a shard is made.
MAX_WORKERS = 8
MAX_NODE_DEATHS = 20
# The lock of a task whose node died can outlive it on a network file system.
CLAIM_PATIENCE_S = 300.0
POLL_S = 1.0
# Seconds that the board may take to answer; seconds without a running task until the run says what it waits for.
BOARD_S, IDLE_S = 5.0, 10.0
BEGUN = "begun"

BoardMessage = tuple[str, str, dict[str, Any]]


class Board:
    """A Ray actor on the driver's node, where tasks post events for the driver."""

    def __init__(self) -> None:
        self.posts: list[BoardMessage] = []

    def post(self, kind: str, message: str, details: dict[str, Any]) -> None:
        self.posts.append((kind, message, details))

    def take(self) -> list[BoardMessage]:
        posts, self.posts = self.posts, []
        return posts


def resolved_on_ray(plan: Plan) -> Plan:
    """The plan with the device that the cluster has, and the workers that a task takes."""
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    with_gpus = [node for node in nodes if node.get("GPU")]
    asked = plan.recipe.settings.device
    if asked == "cpu" or (asked == "auto" and not with_gpus) or plan.maker is not make_sample:
        if plan.maker is make_sample:
            settings = replace(plan.recipe.settings, device="cpu")
            plan = replace(plan, recipe=replace(plan.recipe, settings=settings))
        room = min((int(node["CPU"]) for node in nodes if node.get("CPU", 0) >= 1), default=1)
        return replace(plan, workers=plan.workers or max(1, min(MAX_WORKERS, room)))
    if not with_gpus:
        raise InputError(f"device: expected {asked} in the Ray cluster, found {len(nodes)} nodes without a GPU")
    recipe, _ = ray.get(ray.remote(resolve_device).options(num_gpus=1).remote(plan.recipe))
    room = min(int(node.get("CPU", 1) // node["GPU"]) for node in with_gpus)
    return replace(plan, recipe=recipe, workers=plan.workers or max(1, min(WORKERS_PER_GPU, room)))


def count_cores() -> int:
    """The cores of the cluster."""
    return int(ray.cluster_resources().get("CPU", 1))


def make_shard(plan: Plan, board: Any) -> str:
    """A Ray task: make the one shard of a plan on this node. Returns the problem that stopped it, or ""."""

    def post(event: Event) -> None:
        board.post.remote(event.kind, event.message, {**event.details, "node": os.uname().nodename})

    board.post.remote(BEGUN, "", {"shard": next(iter(plan.shards()))})
    plan = plan.resolved()
    with ExitStack() as stack:
        until = time.monotonic() + CLAIM_PATIENCE_S
        while True:
            try:
                stack.enter_context(
                    plan.destination.claim(plan.description(), plan.recipe.scenes.split, plan.n, plan.shards())
                )
                break
            except (ClaimedError, OutageError):
                if time.monotonic() > until:
                    raise
                time.sleep(POLL_S)
        tally = RunTally(plan.n_asked(), [], post)
        with stopping_on_signals(tally.interrupt):
            make_here(plan, tally)
    return tally.problem


def make_on_ray(plan: Plan, tally: RunTally) -> None:
    """Make the samples that a plan's destination lacks. All nodes must share the destination if it is a folder."""
    patience = Patience(LIMIT_S, tally.tell, lambda: tally.is_stopping)
    try:
        shards, destination = plan.shards(), plan.destination
        missing = patience.insist(destination.place, plan.missing, "nothing is begun")
        todo = [n for n, indices in missing.items() if indices or destination.needs_join(shards[n], plan.n)]
        _Tasks(plan, tally, todo).go()
        missing = patience.insist(destination.place, plan.missing, "what is finished is counted then")
    except OutageError as error:
        tally.problem = tally.problem or str(error)
        return
    tally.recount(index for indices in missing.values() for index in indices)


class _Tasks:
    """The tasks of a run under way: which shard each makes, and which have begun."""

    def __init__(self, plan: Plan, tally: RunTally, todo: list[int]) -> None:
        self.plan, self.tally = plan, tally
        self.cluster = Cluster()
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        self.board = ray.remote(Board).options(num_cpus=0, max_restarts=-1, scheduling_strategy=here).remote()
        self.n_gpus = int(plan.recipe.settings.device != "cpu")
        task = ray.remote(make_shard)
        task = task.options(num_cpus=plan.workers, num_gpus=self.n_gpus, max_retries=MAX_NODE_DEATHS)
        self.tasks = {task.remote(plan.only(number), self.board): number for number in todo}
        self.begun = set[int]()
        self.idle_since, self.is_waiting = time.monotonic(), False

    def go(self) -> None:
        """Wait for all tasks, or until the run is to stop."""
        tally, stop_by = self.tally, math.inf
        while self.tasks and time.monotonic() < stop_by:
            ready, _ = ray.wait(list(self.tasks), timeout=POLL_S)
            lost = self.cluster.lost()
            if lost:
                tally.problem = f"{lost}; what is finished stays, and a run on a new cluster continues it"
                return
            self._pass_on()
            tally.acknowledge()
            for reference in ready:
                self._ended(reference)
            self._tell_of_waiting()
            if tally.is_stopping and stop_by == math.inf:
                stop_by = time.monotonic() + GRACE_S + 2 * POLL_S
                # Tasks under way finish their samples at hand; the others are not begun.
                for reference in self.tasks:
                    with suppress(ray.exceptions.RayError):
                        ray.cancel(reference, force=False)
        self._pass_on()

    def _ended(self, reference: Any) -> None:
        number, problem = self.tasks.pop(reference), _problem(reference)
        self.begun.discard(number)
        if problem and not self.tally.problem:
            self.tally.problem = f"shard {number}: {problem}"

    def _pass_on(self) -> None:
        """Pass on the events that tasks have posted. If the board is lost, Ray restarts it if it can; until then events
        are lost."""
        try:
            posts: list[BoardMessage] = ray.get(self.board.take.remote(), timeout=BOARD_S)
        except ray.exceptions.RayError:
            return
        for kind, message, details in posts:
            if kind == BEGUN:
                self.begun.add(details["shard"])
            else:
                self.tally.tell(kind, message, **details)

    def _tell_of_waiting(self) -> None:
        """Report what the run waits for if no task has run for a while, and report when one runs again."""
        is_idle = not self.begun & set(self.tasks.values()) or not self.cluster.uses(self.plan.workers)
        if not is_idle:
            self.idle_since = time.monotonic()
        if is_idle and self.tasks and not self.is_waiting and time.monotonic() - self.idle_since > IDLE_S:
            self.is_waiting = True
            wanted = f"{self.plan.workers} cores{' and a GPU' * self.n_gpus} free on one node (--workers)"
            self.tally.tell("pause", f"waiting {since(self.idle_since)} for {wanted}; {self.cluster.text()}")
        elif self.is_waiting and not is_idle:
            self.is_waiting = False
            self.tally.tell("resume", "the cluster has room")


def _problem(reference: Any) -> str:
    """The problem that an ended task reports, or that ended it; "" for a cancelled task."""
    try:
        return str(ray.get(reference))
    except ray.exceptions.TaskCancelledError:
        return ""
    except ray.exceptions.RayError as error:
        return str(getattr(error, "cause", None) or error)
