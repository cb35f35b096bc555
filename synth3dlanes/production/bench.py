"""Measure how fast this machine makes samples, where the time goes, and how good the pictures are.

The samples are made by the workers that `generate` uses. The "floor" is the time of path tracing and denoising alone,
which no other code can lower. Seconds depend on the machine and its load. Ratios to the floor do not, so they can be
compared with stored results of another machine.
"""

import os
import resource
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np
import psutil
from jaxtyping import Float, UInt8
from pydantic import BaseModel, PositiveFloat
from scipy.ndimage import gaussian_filter

from synth3dlanes.dataset.format import decode_image
from synth3dlanes.dataset.write import Shard
from synth3dlanes.production.recipe import Recipe, make_part, make_sample
from synth3dlanes.production.workers import Limits, Pool, ask
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.files import read_bounded
from synth3dlanes.system.schema import MAX_BYTES, parse
from synth3dlanes.system.scratch import scratch
from synth3dlanes.system.words import counted

WARM_UP = 2
REFERENCE_SAMPLES, REFERENCE_SCENES = 1024, 3
# Samples per pixel that a user may set who finds Blender's 4096 too slow.
NAIVE_SAMPLES, NAIVE_SCENES = 128, 2
SLOW = Limits(seconds=24 * 3600.0)


@dataclass(frozen=True)
class Quality:
    """The picture at default settings compared with a converged one, by scene."""

    psnr_db: list[float]
    ssim: list[float]


@dataclass(frozen=True)
class DefaultTiming:
    """Seconds that a worker takes for an image with Blender's default settings, at our number of samples per pixel and
    at `samples`."""

    seconds_same_samples: float
    samples: int
    seconds: float


@dataclass(frozen=True)
class Bench:
    """The result of `bench`. Seconds are one worker's for one image. Clips have `frames` frames, worlds `views` views;
    `map` is the name of the given map, if there is one. `memory_mib` is the mean of each quarter of the run."""

    params: str
    frames: int
    scenes: int
    workers: int
    device: str
    samples: int
    size_px: tuple[int, int]
    images_per_hour: float
    images_per_hour_per_worker: float
    seconds_per_image: float
    core_seconds_per_image: float
    floor_seconds_per_image: float
    ratio: float
    stages: dict[str, float]
    peak_memory_mib: float
    memory_mib: list[float]
    quality: Quality | None = None
    naive: DefaultTiming | None = None
    views: int = 1
    map: str = ""

    def document(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class SampleTiming:
    """The times of one sample, and the memory of its worker after it. `ended` is on the machine's monotonic clock."""

    worker: int
    ended: float
    core_seconds: float
    stages: dict[str, float]
    rss_bytes: int
    peak_bytes: int


def bench(
    params: str, recipe: Recipe, n: int, workers: int, masks: list[dict[str, str]], notify: Callable[[str], None]
) -> Bench:
    """Make `n` samples of the recipe with the parameters `params` with warm workers, measure them, and delete them."""
    with scratch() as folder:
        shard = Shard(folder, 0, 1 << 30, recipe.names)
        with Pool(workers, SLOW, masks=masks) as pool:
            timed = _time_samples(pool, recipe, shard, n, notify)
            notify("the denoiser")
            denoise = ask(pool, time_denoiser, recipe).result("bench")
        start = time.perf_counter()
        shard.join(1 << 30)
        join = (time.perf_counter() - start) / len(shard.joined())
    per_image = _seconds_between(timed) + join
    timed = timed[-n:]
    stages = {name: mean(sample.stages[name] for sample in timed) for name in timed[0].stages}
    stages["path tracing"], floor = stages["path tracing"] - denoise, stages["path tracing"]
    stages |= {"denoise": denoise, "join": join, "waiting": max(0.0, per_image - sum(stages.values()) - denoise - join)}
    camera = recipe.scenes.params.camera
    quarters = np.array_split(_memory_mib(timed), 4)
    return Bench(
        params,
        recipe.scenes.shots.frames,
        n,
        workers,
        recipe.settings.device,
        recipe.settings.samples,
        (int(camera.width_px.draw(0.5)), int(camera.height_px.draw(0.5))),
        3600 * workers / per_image,
        3600 / per_image,
        per_image,
        mean(sample.core_seconds for sample in timed) + join,
        floor,
        per_image / floor,
        stages,
        max(sample.peak_bytes for sample in timed) / 2**20,
        [float(quarter.mean()) for quarter in quarters if quarter.size],
        views=recipe.scenes.shots.views,
        map=recipe.scenes.map.map.source if recipe.scenes.map else "",
    )


def measure_quality(recipe: Recipe, notify: Callable[[str], None]) -> Quality:
    """Compare three fixed scenes with their references. Takes minutes."""
    recipe = replace(recipe, scenes=replace(recipe.scenes, split="quality"), image_format="png")
    converged = replace(recipe, settings=replace(recipe.settings, samples=REFERENCE_SAMPLES, passes=()))
    psnr_db, ssims = [], []
    with Pool(1, SLOW, pinned=False) as pool:
        for index in range(REFERENCE_SCENES):
            notify(f"reference {index + 1} of {REFERENCE_SCENES}")
            made = ask(pool, make_sample, recipe, index).result("bench")
            image = decode_image(made.members["png"], "bench")
            truth = ask(pool, make_reference, converged, index).result("bench")
            psnr_db.append(psnr(image, truth))
            ssims.append(ssim(image, truth))
    return Quality(psnr_db, ssims)


def measure_naive(recipe: Recipe, notify: Callable[[str], None]) -> DefaultTiming:
    """Time scenes of the same split with Blender's default settings, in one worker that is pinned like the others."""
    seconds: dict[int, list[float]] = {recipe.settings.samples: [], NAIVE_SAMPLES: []}
    with Pool(1, SLOW) as pool:
        for index in range(NAIVE_SCENES):
            for samples, times in seconds.items():
                notify(f"naively: scene {index + 1} of {NAIVE_SCENES} at {counted(samples, 'sample')}")
                times.append(ask(pool, time_naive, recipe, index, samples).result("bench"))
    return DefaultTiming(mean(seconds[recipe.settings.samples]), NAIVE_SAMPLES, mean(seconds[NAIVE_SAMPLES]))


def time_sample(recipe: Recipe, shard: Shard, index: int) -> SampleTiming:
    """In a worker: make and write a sample, and record the stages of Cycles."""
    # Loaded here, as in `generate`: only workers carry Blender.
    from synth3dlanes.blender.cycles_timing import cycles_stages
    from synth3dlanes.blender.render import studio

    studio(recipe.library)
    start = time.process_time()
    with cycles_stages() as inside:
        stages: dict[str, float] = make_part(make_sample, recipe, shard, index)["stages"]  # type: ignore[assignment]
    core_seconds = time.process_time() - start
    named = {"path tracing" if name == "tracing" else name: inside[name] for name in inside if name != "after"}
    stages |= {**named, "call": stages.pop("cycles") - sum(named.values())}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return SampleTiming(os.getpid(), time.monotonic(), core_seconds, stages, psutil.Process().memory_info().rss, peak)


def time_denoiser(recipe: Recipe) -> float:
    """In a worker: the seconds that the denoiser takes."""
    from synth3dlanes.blender.benchmark_renders import denoise_seconds

    return denoise_seconds(recipe.scene(0), recipe.settings, recipe.library)


def time_naive(recipe: Recipe, index: int, samples: int) -> float:
    """In a worker: the seconds of a render with Blender's default settings."""
    from synth3dlanes.blender.benchmark_renders import naive_seconds

    return naive_seconds(recipe.scene(index), recipe.library, samples)


def make_reference(recipe: Recipe, index: int) -> UInt8[np.ndarray, "h w 3"]:
    """In a worker: a converged picture."""
    from synth3dlanes.blender.benchmark_renders import reference

    return reference(recipe.scene(index), recipe.settings, recipe.library)


def psnr(image: UInt8[np.ndarray, "h w 3"], truth: UInt8[np.ndarray, "h w 3"]) -> float:
    """Peak signal to noise in dB of 8-bit pictures."""
    error = ((image.astype(float) - truth) ** 2).mean()
    return float(10 * np.log10(255**2 / error)) if error else float("inf")


def ssim(image: UInt8[np.ndarray, "h w 3"], truth: UInt8[np.ndarray, "h w 3"]) -> float:
    """Structural similarity (Wang et al. 2004) with their Gaussian window of 1.5 px, mean over pixels and channels."""

    def blur(values: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
        return np.asarray(gaussian_filter(values, (1.5, 1.5, 0), truncate=3.5))

    x, y = image.astype(float), truth.astype(float)
    mean_x, mean_y = blur(x), blur(y)
    var_x, var_y, cov = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2, blur(x * y) - mean_x * mean_y
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    return float(
        ((2 * mean_x * mean_y + c1) * (2 * cov + c2) / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))).mean()
    )


class StoredDefaultTiming(BaseModel):
    """The part of a stored `DefaultTiming` that is compared."""

    seconds_same_samples: PositiveFloat
    seconds: PositiveFloat


class StoredBench(BaseModel):
    """The part of a stored `Bench` that is compared."""

    params: str = ""
    frames: int = 1
    views: int = 1
    map: str = ""
    samples: int
    ratio: PositiveFloat
    seconds_per_image: PositiveFloat
    floor_seconds_per_image: PositiveFloat
    stages: dict[str, float]
    naive: StoredDefaultTiming | None = None


class StoredRows(BaseModel):
    """Stored results of several recipes."""

    rows: list[StoredBench]


def read_bench(path: Path, params: str, samples: int, frames: int, views: int = 1, map_name: str = "") -> StoredBench:
    """A stored `Bench.document`, or of `rows` of these the one with these parameters, samples, frames and views, on
    this map; raise FormatError with a line for each problem."""
    data, what = read_bounded(path, MAX_BYTES), "a result of bench --json"
    if b'"rows"' not in data:
        return parse(StoredBench, data, str(path), what)
    rows = parse(StoredRows, data, str(path), what).rows
    wanted = params, samples, frames, views, map_name
    among = {(row.params, row.samples, row.frames, row.views, row.map): row for row in reversed(rows)}
    if wanted not in among:
        told = [
            f"{name}, {counted(n, 'sample')}, frames {of_clip}{f', views {of_world}' * (of_world > 1)}"
            f"{f', map {file}' * bool(file)}"
            for name, n, of_clip, of_world, file in (wanted, *reversed(among))
        ]
        raise FormatError(f"{path}: expected a row of {told[0]}, found {'; '.join(told[1:])}")
    return among[wanted]


def compare(now: Bench, stored: StoredBench) -> list[tuple[str, float, float]]:
    """Name, current value and stored value of each share of the floor; these do not depend on the machine."""
    pairs = [("end to end", now.ratio, stored.ratio)]
    for name, seconds in now.stages.items():
        share = stored.stages.get(name, 0.0) / stored.floor_seconds_per_image
        pairs.append((name, seconds / now.floor_seconds_per_image, share))
    if now.naive and stored.naive:
        for name in ("seconds_same_samples", "seconds"):
            ours, theirs = getattr(now.naive, name), getattr(stored.naive, name)
            pairs.append((f"naive {name}", ours / now.seconds_per_image, theirs / stored.seconds_per_image))
    return pairs


def _time_samples(
    pool: Pool, recipe: Recipe, shard: Shard, n: int, notify: Callable[[str], None]
) -> list[SampleTiming]:
    """The last warm-up sample of every worker and the `n` samples that follow; all workers stay busy to the end."""
    indices, seen = count(), Counter[int]()
    timed: dict[int, SampleTiming] = {}
    warm: list[SampleTiming] = []
    while len(warm) < pool.n + n:
        while pool.busy < pool.n:
            index = next(indices)
            pool.start(index, time_sample, recipe, shard, index)
        for outcome in pool.wait(1.0):
            sample: SampleTiming = outcome.result("bench")
            seen[sample.worker] += 1
            if warm or (len(seen) == pool.n and min(seen.values()) >= WARM_UP):
                warm = warm or [other for worker, other in timed.items() if worker != sample.worker]
                warm.append(sample)
                notify(f"sample {max(0, len(warm) - pool.n)} of {n}")
            timed[sample.worker] = sample
    while pool.busy:
        for outcome in pool.wait(1.0):
            outcome.result("bench")
    return warm[: pool.n + n]


def _seconds_between(timed: list[SampleTiming]) -> float:
    """The mean time from the end of one sample to the end of the next by the same worker, which includes what happens
    between them."""
    ends: dict[int, list[float]] = {}
    for sample in timed:
        ends.setdefault(sample.worker, []).append(sample.ended)
    return sum(max(times) - min(times) for times in ends.values()) / (len(timed) - len(ends))


def _memory_mib(timed: list[SampleTiming]) -> Float[np.ndarray, " n"]:
    """Resident memory of the first worker after each of its samples."""
    return np.array([sample.rss_bytes / 2**20 for sample in timed if sample.worker == timed[0].worker])
