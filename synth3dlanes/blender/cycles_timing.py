"""Seconds per stage of a render, from Cycles' status messages (bpy.app.handlers.render_stats).

Cycles reports the start of each step, so a step lasts until the next one starts. Recording costs microseconds.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import bpy

# The stages of steps by the beginnings of their messages, of which the first that fits counts. Steps without one belong
# to the stage before.
STEPS = {"Updating Images": "textures", "Updating": "bvh", "Sample 0/": "tracing", "Finished": "after"}


@contextmanager
def cycles_stages() -> Iterator[dict[str, float]]:
    """Time the first render inside the block; the seconds are set when the block ends: `sync` (Blender's scene to
    Cycles'), `textures` (their files and the sky), `bvh` (search trees, the rest of the device's scene), `tracing`
    (samples and denoiser), `after` (copying the result)."""
    steps: list[tuple[str, float]] = []
    stages = dict.fromkeys(("sync", *STEPS.values()), 0.0)

    def begin(stage: str) -> None:
        # The first render alone.
        if not steps or steps[-1][0] != "end":
            steps.append((stage, time.perf_counter()))

    def mark(status: str) -> None:
        words = status.rpartition("ViewLayer | ")[2]
        stage = next((stage for beginning, stage in STEPS.items() if words.startswith(beginning)), None)
        if stage is not None:
            begin(stage)

    handlers = bpy.app.handlers
    hooks = [
        (handlers.render_init, lambda *_: begin("sync")),
        (handlers.render_stats, mark),
        (handlers.render_post, lambda *_: begin("end")),
    ]
    for hook, function in hooks:
        hook.append(function)
    try:
        yield stages
    finally:
        for hook, function in hooks:
            hook.remove(function)
    for (stage, start), (_, end) in pairwise(steps):
        stages[stage] += end - start
