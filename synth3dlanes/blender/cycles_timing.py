"""Seconds per stage of a render, from Cycles' status messages (bpy.app.handlers.render_stats).

Cycles reports the start of each stage, so a stage lasts until the next one starts. Recording costs microseconds.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import bpy

# How the message at the start of each stage begins, in order; "after" is copying the result.
BEGINNINGS = {"Updating Scene": "bvh", "Sample 0/": "tracing", "Finished": "after"}


@contextmanager
def cycles_stages() -> Iterator[dict[str, float]]:
    """Time the first render inside the block; the seconds are set when the block ends: `sync` (Blender's scene to
    Cycles'), `bvh` (search trees, textures, the rest of the device's scene), `tracing` (samples and denoiser),
    `after`."""
    marks: dict[str, float] = {}
    stages: dict[str, float] = {}

    def begin(_: object, __: object) -> None:
        marks.setdefault("sync", time.perf_counter())

    def mark(status: str) -> None:
        words = status.rpartition("ViewLayer | ")[2]
        for beginning, stage in BEGINNINGS.items():
            if words.startswith(beginning):
                marks.setdefault(stage, time.perf_counter())

    def end(_: object, __: object) -> None:
        marks.setdefault("end", time.perf_counter())

    handlers = bpy.app.handlers
    hooks = [(handlers.render_init, begin), (handlers.render_stats, mark), (handlers.render_post, end)]
    for hook, function in hooks:
        hook.append(function)
    try:
        yield stages
    finally:
        for hook, function in hooks:
            hook.remove(function)
    stages |= {stage: marks[later] - marks[stage] for stage, later in pairwise(("sync", *BEGINNINGS.values(), "end"))}
