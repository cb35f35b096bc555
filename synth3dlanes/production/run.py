"""A run: make the missing samples of a plan, on this machine or on a Ray cluster, and report.

The state of a run is what is at the destination, so running again continues it, with either executor. The bytes of a
sample depend on the recipe and its index alone, not on the process or the time. SIGINT, SIGTERM and SIGHUP let the
samples in progress finish. `part` i of n takes the shards whose number is i - 1 modulo n, so parts never overlap: they
may share a folder (each shard has its lock), or their folders may be merged.
"""

from collections.abc import Callable
from typing import Literal

from synth3dlanes.production.events import Event
from synth3dlanes.production.local import make_here
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.signals import stopping_on_signals
from synth3dlanes.production.tally import RunReport, RunTally, log_name
from synth3dlanes.system.machine import renderers_here

Executor = Literal["local", "ray"]


def generate(
    plan: Plan, notify: Callable[[Event], None], executor: Executor = "local", address: str = "auto"
) -> RunReport:
    """Make the missing samples of a plan. `notify` is called with every event. `address` names the Ray cluster.

    Raises if the run cannot start: MissingPackageError without Blender or Ray, DiskFullError without room, InputError
    without the device or the cluster, or if the destination has samples of another recipe, ClaimedError if another run
    makes one of the shards.
    """
    if executor == "local":
        plan = plan.resolved()
        return _run(plan, notify, make_here, plan.workers or renderers_here())
    # Loaded here: Ray is an extra.
    from synth3dlanes.production.ray import connected, count_cores, make_on_ray, resolved_on_ray

    with connected(address):
        return _run(resolved_on_ray(plan), notify, make_on_ray, count_cores(), is_driver=True)


def _run(
    plan: Plan,
    notify: Callable[[Event], None],
    make: Callable[[Plan, RunTally], None],
    n_workers: int,
    is_driver: bool = False,
) -> RunReport:
    """Lock the shards, make the samples, report. `n_workers` is the total number of workers. A driver's workers are on
    other machines, which lock their shards themselves."""
    destination, split = plan.destination, plan.recipe.scenes.split
    # Checked first, so that a refused run leaves nothing behind.
    expected = plan.expected(n_workers)
    with destination.claim(plan.description(), split, plan.n, plan.shards(), is_driver):
        missing = [index for indices in plan.missing().values() for index in indices]
        with destination.log(log_name(split)) as log:
            tally = RunTally(plan.n_asked(), missing, notify, log)
            device, names = plan.recipe.settings.device, plan.slots.names
            tally.tell(
                "start", f"{plan.text()}; {expected.text()}", **vars(expected), device=device, device_names=names
            )
            with stopping_on_signals(tally.interrupt):
                make(plan, tally)
            tally.tell("end", tally.problem or ("interrupted" if tally.stop_signal else "complete"))
    return tally.report()
