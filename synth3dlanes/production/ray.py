"""Shards as tasks of a Ray cluster, each made on one node by the workers that a run on one machine has.

Blender stays in those workers: Ray's own process only supervises. A task whose node dies is made again elsewhere; on a
shared folder it goes on where it was. The truth is at the destination, never in a task's answer, so executors may
follow one another on the same data set.
"""

import math
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

from synth3dlanes.errors import ClaimedError, InputError, MissingPackageError
from synth3dlanes.production.devices import WORKERS_PER_GPU, resolve_device
from synth3dlanes.production.events import Event
from synth3dlanes.production.local import make_here
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import make_sample
from synth3dlanes.production.signals import stopping_on_signals
from synth3dlanes.production.tally import GRACE_S, Tally

try:
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
except ModuleNotFoundError as error:
    raise MissingPackageError("Ray is not installed: pip install 'synth3dlanes[cluster]'") from error

# More workers would wait for the last sample of a shard, fewer for shards: the cores that one task asks for at most.
MAX_WORKERS = 8
MAX_NODE_DEATHS = 20
# The lock of a task whose node died can outlive it on a network file system.
CLAIM_PATIENCE_S = 300.0
POLL_S = 1.0

Post = tuple[str, str, dict[str, Any]]


class Board:
    """Where tasks post what happens, for the driver to take. An actor on the driver's own node."""

    def __init__(self) -> None:
        self.posts: list[Post] = []

    def post(self, kind: str, message: str, details: dict[str, Any]) -> None:
        """Add an event."""
        self.posts.append((kind, message, details))

    def take(self) -> list[Post]:
        """All events since the last time."""
        posts, self.posts = self.posts, []
        return posts


@contextmanager
def connected(address: str) -> Iterator[None]:
    """While this process is part of the cluster at `address`; raise InputError where there is none."""
    try:
        ray.init(address=address, log_to_driver=False, logging_level="error")
    except ConnectionError as error:
        raise InputError(f"address: cannot connect to a Ray cluster at {address}: {error}") from None
    try:
        yield
    finally:
        ray.shutdown()


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
    """A task: make the one shard of a plan on this node; returns why it could not go on, "" for nothing."""

    def post(event: Event) -> None:
        board.post.remote(event.kind, event.message, {**event.details, "node": os.uname().nodename})

    plan = plan.resolved()
    with ExitStack() as stack:
        until = time.monotonic() + CLAIM_PATIENCE_S
        while True:
            try:
                stack.enter_context(
                    plan.destination.claim(plan.description(), plan.recipe.scenes.split, plan.n, plan.shards())
                )
                break
            except ClaimedError:
                if time.monotonic() > until:
                    raise
                time.sleep(POLL_S)
        tally = Tally(plan.n_asked(), [], post)
        with stopping_on_signals(tally.interrupt):
            make_here(plan, tally)
    return tally.problem


def make_on_ray(plan: Plan, tally: Tally) -> None:
    """Make what a plan's destination lacks; a folder must be shared by all nodes."""
    n_gpus = int(plan.recipe.settings.device != "cpu")
    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    board = ray.remote(Board).options(num_cpus=0, scheduling_strategy=here).remote()
    task = ray.remote(make_shard).options(num_cpus=plan.workers, num_gpus=n_gpus, max_retries=MAX_NODE_DEATHS)
    shards, destination = plan.shards(), plan.destination
    todo = [
        number
        for number, indices in plan.missing().items()
        if indices or destination.needs_join(shards[number], plan.n)
    ]
    tasks = {task.remote(plan.only(number), board): number for number in todo}
    stop_by = math.inf
    while tasks and time.monotonic() < stop_by:
        ready, _ = ray.wait(list(tasks), timeout=POLL_S)
        _pass_on(board, tally)
        tally.acknowledge()
        for reference in ready:
            number, problem = tasks.pop(reference), _problem(reference)
            if problem and not tally.problem:
                tally.problem = f"shard {number}: {problem}"
        if tally.is_stopping and stop_by == math.inf:
            stop_by = time.monotonic() + GRACE_S + 2 * POLL_S
            # Tasks under way finish their samples at hand; the others are not begun.
            for reference in tasks:
                ray.cancel(reference, force=False)
    _pass_on(board, tally)
    tally.recount(index for indices in plan.missing().values() for index in indices)


def _pass_on(board: Any, tally: Tally) -> None:
    for kind, message, details in ray.get(board.take.remote()):
        tally.tell(kind, message, **details)


def _problem(reference: Any) -> str:
    """What a task that has ended says, or what ended it; "" for one that was cancelled."""
    try:
        return str(ray.get(reference))
    except ray.exceptions.TaskCancelledError:
        return ""
    except ray.exceptions.RayError as error:
        return str(getattr(error, "cause", None) or error)
