"""Measure rendering on the GPU of this machine: `python -m scripts.gpu OUT.jsonl [--device optix] [--minutes 14]`.

A line of JSON is written as soon as it is known, the most useful first: the card; how long the first start takes, in
which the driver may compile kernels, and the second one; the device that `auto` chooses; pixels beside those of the
CPU; a run that is killed and resumed; then images an hour, by workers, samples, parameters and size. What fails is a
line too, with its message, and the next measurement goes on. `--device cpu` is a dry run, whose figures mean nothing.
"""

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from synth3dlanes.dataset.read import Reader
from synth3dlanes.production.bench import psnr
from synth3dlanes.system.scratch import scratch

COMMAND = [sys.executable, "-c", "from synth3dlanes_cli.entry import run; run()"]
LARGE = ("camera.width_px=1920", "camera.height_px=1080")
# Parameters, samples per pixel, size, workers; each row is one run of `bench`.
ROWS: tuple[tuple[str, int, Sequence[str], int], ...] = (
    *(("appendix_i", 4, (), workers) for workers in (1, 4, 8, 2)),
    *(("appendix_i", samples, (), 4) for samples in (1, 16)),
    *(("streets", samples, (), 4) for samples in (4, 1, 16)),
    *((name, 4, LARGE, 4) for name in ("appendix_i", "streets")),
)
SMI = ["nvidia-smi", "--format=csv,noheader,nounits"]
KEPT = ("images_per_hour", "core_seconds_per_image", "ratio", "peak_memory_mib", "stages")


class Log:
    """Writes what is measured, a line each, here and to a file."""

    def __init__(self, path: Path) -> None:
        self.file = path.open("a", encoding="utf-8")

    def add(self, what: str, **values: Any) -> None:
        """Write a line."""
        line = json.dumps({"what": what, **values})
        for stream in (self.file, sys.stdout):
            stream.write(f"{line}\n")
            stream.flush()


class Load:
    """What nvidia-smi says once a second while something runs: the share of time in which the GPU is busy, and its
    memory. Nothing where there is no nvidia-smi."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, float]] = []
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> "Load":
        if shutil.which(SMI[0]):
            self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()

    def _watch(self) -> None:
        while not self.ended.wait(1.0):
            text = _said([*SMI, "--query-gpu=utilization.gpu,memory.used"])
            numbers = [float(part) for part in text.splitlines()[0].split(",")] if text else []
            if len(numbers) == len(("busy", "memory")):
                self.seen.append((numbers[0], numbers[1]))

    def figures(self) -> dict[str, float]:
        """The median share and the greatest memory."""
        if not self.seen:
            return {}
        busy, memory = zip(*self.seen, strict=True)
        return {"gpu_busy_percent": float(np.median(busy)), "gpu_memory_mib": max(memory)}


def measurements(log: Log, device: str, folder: Path) -> Iterator[None]:
    """All measurements, one after the other."""
    log.add("card", name=_said([*SMI, "--query-gpu=name,driver_version,memory.total"]), cores=os.cpu_count())
    yield
    for start in ("first", "second"):
        log.add(f"{start} start of one image", **_timed(log, _generate(folder / start, device, n=1)))
        yield
    log.add("device auto", **_timed(log, _generate(folder / "auto", "auto", n=2)))
    yield
    for kind in dict.fromkeys((device, "cpu")):
        _timed(log, _generate(folder / kind, kind, n=6, image="png"))
    log.add("pixels beside the CPU's", psnr_db=_psnr(folder / device, folder / "cpu"))
    yield
    log.add("killed and resumed", **_resumed(log, folder, device))
    yield
    for params, samples, changes, workers in ROWS:
        row = {"params": params, "samples": samples, "size": "1920x1080" if changes else "480x360", "workers": workers}
        n = 8 * workers if changes else 20 * workers
        with Load() as load:
            found = _timed(log, _bench(params, samples, changes, workers, device, n))
        document = json.loads(found.pop("said") or "{}")
        log.add("bench", **row, **found, **{key: document.get(key) for key in KEPT}, **load.figures())
        yield


def _bench(params: str, samples: int, changes: Sequence[str], workers: int, device: str, n: int) -> list[str]:
    sets = [part for change in changes for part in ("--set", change)]
    fixed = ["--params", params, "--samples", str(samples), "--workers", str(workers), "--device", device]
    return [*COMMAND, "bench", "--json", "--n", str(n), *fixed, *sets]


def _generate(out: Path, device: str, n: int, image: str = "jpg") -> list[str]:
    return [*COMMAND, "generate", "--n", str(n), "--out", str(out), "--device", device, "--image-format", image]


def _timed(log: Log, command: list[str]) -> dict[str, Any]:
    """Run a command: how long it took and what it said; of one that fails, its last words are a line of the log."""
    began = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        words = " ".join((done.stderr or done.stdout).split())[-600:]
        log.add("failed", command=" ".join(command[3:]), code=done.returncode, words=words)
    return {"seconds": round(time.monotonic() - began, 1), "said": "" if done.returncode else done.stdout}


def _psnr(one: Path, other: Path) -> list[float]:
    """The PSNR in dB of each image of a data set to the same image of another; 99 where they are equal."""
    if not (one.is_dir() and other.is_dir()):
        return []
    pairs = zip(Reader(f"{one}/train"), Reader(f"{other}/train"), strict=True)
    return [round(min(float(psnr(a.image, b.image)), 99.0), 2) for a, b in pairs]


def _resumed(log: Log, folder: Path, device: str) -> dict[str, Any]:
    """Kill a run after its first samples and run it again: whether the bytes are those of a run that was left alone."""
    alone, killed = folder / "alone", folder / "killed"
    _timed(log, _generate(alone, device, n=12))
    run = subprocess.Popen(_generate(killed, device, n=12), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 120
    while (
        time.monotonic() < until and run.poll() is None and len([*killed.rglob("*.jpg"), *killed.rglob("*.tar*")]) < 2
    ):
        time.sleep(0.2)
    run.send_signal(signal.SIGKILL)
    run.wait()
    again = _timed(log, _generate(killed, device, n=12))
    digests = [
        hashlib.sha256(b"".join(path.read_bytes() for path in sorted(made.rglob("*.tar")))).hexdigest()
        for made in (alone, killed)
    ]
    return {"seconds": again["seconds"], "equal_bytes": digests[0] == digests[1]}


def _said(command: list[str]) -> str:
    """What a program says; "" where it fails or is not there."""
    if shutil.which(command[0]) is None:
        return ""
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def main() -> None:
    """Measure until all is measured or the time is up."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", default="optix")
    parser.add_argument("--minutes", type=float, default=14.0)
    given = parser.parse_args()
    log, ends = Log(given.out), time.monotonic() + 60 * given.minutes
    with scratch() as folder:
        for _ in measurements(log, given.device, folder):
            if time.monotonic() > ends:
                log.add("time is up")
                return


if __name__ == "__main__":
    main()
