"""Shards as tasks of a Ray cluster, each made on one node by the workers that a run on one machine has.

Blender stays in those workers: Ray's own process only supervises. A task whose node dies is made again elsewhere; on a
shared folder it goes on where it was. The truth is in the folder or store, never in a task's answer, so executors may
follow one another on the same data set.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from synth3dlanes.dataset.folder import Claimed, claim
from synth3dlanes.errors import InputError
from synth3dlanes.production import store
from synth3dlanes.production.devices import WORKERS_PER_GPU, resolve_device
from synth3dlanes.production.events import Event
from synth3dlanes.production.progress import Meter, forecast
from synth3dlanes.production.recipe import make_sample
from synth3dlanes.production.run import GRACE_S, Plan, Report
from synth3dlanes.production.run import generate as generate_here
from synth3dlanes.production.signals import stopping_on_signals

# More workers would wait for the last sample of a shard, fewer for shards: the cores that one task asks for at most.
MAX_WORKERS = 8
MAX_NODE_DEATHS = 20
# The lock of a task whose node died can outlive it on a network file system.
CLAIM_PATIENCE_S = 300.0
POLL_S = 1.0


class Board:
    """Where tasks post what happens, for the driver to take. An actor on the driver's own node."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str, dict[str, Any]]] = []

    def post(self, kind: str, message: str, details: dict[str, Any]) -> None:
        """Add an event."""
        self.events.append((kind, message, details))

    def take(self) -> list[tuple[str, str, dict[str, Any]]]:
        """All events since the last time."""
        events, self.events = self.events, []
        return events


def generate_on_ray(plan: Plan, url: str, address: str, notify: Callable[[Event], None]) -> Report:
    """Make what is missing at the URL, or where there is none in the plan's folder, which the nodes must share."""
    try:
        ray.init(address=address, log_to_driver=False, logging_level="error")
    except ConnectionError as error:
        raise InputError(f"address: expected a Ray cluster, got {error}") from None
    try:
        plan = _on_cluster(plan)
        if url:
            store.announce(plan, url)
            return _Driver(plan, url, notify).go()
        with claim(plan.out, plan.description(), plan.recipe.split, plan.n, plan.shards()):
            pass  # Whoever works there without Ray is found out now; its tasks claim their shards one by one.
        with claim(plan.out, plan.description(), plan.recipe.split, plan.n, plan.shards(), is_driver=True):
            return _Driver(plan, url, notify).go()
    finally:
        ray.shutdown()


def make_shard(plan: Plan, number: int, url: str, board: Any) -> Report:
    """A task: make one shard, on this node."""

    def tell(event: Event) -> None:
        if event.kind not in ("start", "end"):
            board.post.remote(event.kind, event.message, event.details)

    if url:
        return store.make_shard(plan, number, url, tell)
    return _generate_patiently(plan.only(number), tell)


def _generate_patiently(plan: Plan, tell: Callable[[Event], None]) -> Report:
    until = time.monotonic() + CLAIM_PATIENCE_S
    while True:
        try:
            return generate_here(plan, tell)
        except Claimed:
            if time.monotonic() > until:
                raise
            time.sleep(POLL_S)


def _on_cluster(plan: Plan) -> Plan:
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


class _Driver:
    """The state of one run on the cluster: tasks under way, and what became of the others."""

    def __init__(self, plan: Plan, url: str, notify: Callable[[Event], None]) -> None:
        self.plan, self.url, self.notify = plan, url, notify
        self.before = self._missing()
        asked = sum(len(shard.indices(plan.n)) for shard in plan.layout(plan.out).values())
        self.meter = Meter(asked, sum(map(len, self.before.values())))
        self.seen: set[int] = set()
        self.problem = ""
        self.restarts = 0
        self.interrupted = False
        self.stop_by = float("inf")

    def go(self) -> Report:
        plan, n_gpus = self.plan, int(self.plan.recipe.settings.device != "cpu")
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        self.board = ray.remote(Board).options(num_cpus=0, scheduling_strategy=here).remote()
        task = ray.remote(make_shard).options(num_cpus=plan.workers, num_gpus=n_gpus, max_retries=MAX_NODE_DEATHS)
        shards = plan.layout(plan.out)
        todo = [
            number
            for number, indices in self.before.items()
            if indices or (not self.url and shards[number].needs_join(plan.n))
        ]
        cores = int(ray.cluster_resources().get("CPU", 1))
        expected = forecast(plan.recipe, self.meter.missing, max(1, min(cores, len(todo) * plan.workers)))
        self._tell("start", expected.text(), vars(expected))
        with stopping_on_signals(self._interrupt):
            self.tasks = {task.remote(plan, number, self.url, self.board): number for number in todo}
            while self.tasks and time.monotonic() < self.stop_by:
                self._step()
        self._hear()
        left = sum(map(len, self._missing().values()))
        self._tell("end", self.problem or "interrupted" * self.interrupted or "complete", {})
        asked, made = self.meter.asked, sum(map(len, self.before.values())) - left
        set_aside = tuple(sorted(self.meter.set_aside))
        seconds = self.meter.seconds
        return Report(made, asked - left, asked, set_aside, self.interrupted, self.problem, self.restarts, seconds)

    def _step(self) -> None:
        ready, _ = ray.wait(list(self.tasks), timeout=POLL_S)
        self._hear()
        for reference in ready:
            number = self.tasks.pop(reference)
            try:
                problem = ray.get(reference).problem
            except ray.exceptions.TaskCancelledError:
                continue
            except ray.exceptions.RayError as error:
                problem = str(getattr(error, "cause", None) or error)
            if problem and not self.problem:
                self.problem = f"shard {number}: {problem}"
        if (self.interrupted or self.problem) and self.stop_by == float("inf"):
            self.stop_by = time.monotonic() + GRACE_S + 2 * POLL_S
            # Tasks under way finish their samples at hand; the others are not begun.
            for reference in self.tasks:
                ray.cancel(reference, force=False)

    def _interrupt(self) -> None:
        self.interrupted = True

    def _hear(self) -> None:
        for kind, message, details in ray.get(self.board.take.remote()):
            index = details.get("index")
            if kind == "sample" and index not in self.seen:
                self.seen.add(index)
                self.meter.sample()
            elif kind == "restart":
                self.restarts += 1
            elif kind == "set_aside":
                self.meter.set_aside.append(index)
            self._tell(kind, message, details)

    def _tell(self, kind: str, message: str, details: dict[str, Any]) -> None:
        self.notify(self.meter.event(kind, message, details))

    def _missing(self) -> dict[int, list[int]]:
        if self.url:
            return store.missing(self.plan, self.url)
        shards = self.plan.layout(self.plan.out)
        return {number: shard.missing(self.plan.n) for number, shard in shards.items()}
