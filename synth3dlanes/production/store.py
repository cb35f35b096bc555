"""Shards made for a store (`dataset.stores`): each on this machine's own disk, then copied out whole."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from synth3dlanes.dataset import stores
from synth3dlanes.production.events import Event
from synth3dlanes.production.progress import Meter, forecast
from synth3dlanes.production.run import Plan, Report, generate


def announce(plan: Plan, url: str) -> None:
    """Write `dataset.json`; raise InputError where the store holds another recipe's samples."""
    stores.announce(url, plan.description(), plan.recipe.split, plan.n)


def missing(plan: Plan, url: str) -> dict[int, list[int]]:
    """By shard the indices of the plan's samples that the store does not hold."""
    shards = plan.layout(plan.out)
    there = {number: stores.indices(url, plan.recipe.split, number) for number in shards}
    return {number: sorted(set(shards[number].indices(plan.n)) - there[number]) for number in shards}


def make_shard(plan: Plan, number: int, url: str, notify: Callable[[Event], None]) -> Report:
    """Make what a shard lacks; copy it out with failed scenes and logs, also where the run has ended early."""
    with TemporaryDirectory(prefix="synth3dlanes-") as folder:
        root = Path(folder)
        scratch = replace(plan.only(number), out=root)
        shard = scratch.layout(root)[number]
        stores.fetch_shard(url, shard)
        report = generate(scratch, notify)
        if shard.needs_join(plan.n):
            shard.join(plan.n)
        files = (path for kind in ("failed", "logs") for path in sorted((root / kind).rglob("*")) if path.is_file())
        stores.put(url, [str(path.relative_to(root)) for path in files], root)
        if report.made and shard.path("parquet").exists():
            stores.put_shard(url, shard)
        return report


def generate_into_store(plan: Plan, url: str, notify: Callable[[Event], None]) -> Report:
    """Make what is missing at the URL on this machine, one shard after the other."""
    plan = plan.settled()
    announce(plan, url)
    todo = {number: indices for number, indices in missing(plan, url).items() if indices}
    asked = sum(len(shard.indices(plan.n)) for shard in plan.layout(plan.out).values())
    meter, reports = Meter(asked, sum(map(len, todo.values()))), list[Report]()

    def tell(kind: str, message: str, details: dict[str, Any]) -> None:
        notify(meter.event(kind, message, details))

    def hear(event: Event) -> None:
        if event.kind == "sample":
            meter.sample()
        elif event.kind == "set_aside":
            meter.set_aside.append(event.details["index"])
        if event.kind not in ("start", "end"):
            tell(event.kind, event.message, event.details)

    expected = forecast(plan.recipe, meter.missing, plan.n_workers(meter.missing))
    tell("start", expected.text(), vars(expected))
    for number in todo:
        reports.append(make_shard(plan, number, url, hear))
        if reports[-1].problem or reports[-1].interrupted:
            break
    problem, interrupted = (reports[-1].problem, reports[-1].interrupted) if reports else ("", False)
    tell("end", problem or "interrupted" * interrupted or "complete", {})
    set_aside = tuple(sorted(meter.set_aside))
    restarts = sum(report.restarts for report in reports)
    return Report(meter.made, meter.done, asked, set_aside, interrupted, problem, restarts, meter.seconds)
