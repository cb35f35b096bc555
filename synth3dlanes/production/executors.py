"""Where a plan is carried out: on this machine, or on a Ray cluster."""

import importlib.util
from collections.abc import Callable

from synth3dlanes.dataset.address import is_url
from synth3dlanes.errors import InputError
from synth3dlanes.production import run
from synth3dlanes.production.events import Event
from synth3dlanes.production.run import Plan, Report
from synth3dlanes.production.store import generate_into_store

EXECUTORS = ("local", "ray")


def generate(plan: Plan, out: str, executor: str, address: str, notify: Callable[[Event], None]) -> Report:
    """`run.generate` with either executor; `out` may be a URL that fsspec knows."""
    url = out if is_url(out) else ""
    if executor == "local":
        return generate_into_store(plan, url, notify) if url else run.generate(plan, notify)
    if importlib.util.find_spec("ray") is None:
        raise InputError("executor ray: expected Ray, got none: pip install 'synth3dlanes[cluster]'")
    from synth3dlanes.production.ray import generate_on_ray

    return generate_on_ray(plan, url, address, notify)
