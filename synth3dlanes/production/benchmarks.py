"""Named benchmarks (docs/benchmarks.md): recipes with the digests of their labels, so that all have the same data."""

import hashlib
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from synth3dlanes.dataset.description import SplitName
from synth3dlanes.dataset.read import Reader
from synth3dlanes.draw.sample import sample_world
from synth3dlanes.labels.labels import CameraLabel, Labels, Lane, SymbolLabel
from synth3dlanes.params.camera_files import read_as
from synth3dlanes.params.params import find_preset, preset_names
from synth3dlanes.production.job import Job
from synth3dlanes.scene.settings import MAX_SAMPLES
from synth3dlanes.system.schema import DocumentPart, Seed
from synth3dlanes.truth.ground_truth import label

KIND = "benchmarks"
LANE_KEYS = ("id", "kind", "road", "marking", "color", "double", "pair", "direction", "left", "right")


class BenchmarkSplit(DocumentPart):
    """How many samples a split has, and the digest of their labels; "" where it is not fixed yet."""

    n: Annotated[int, Field(ge=1, le=MAX_SAMPLES)]
    labels: Annotated[str, Field(pattern="^([0-9a-f]{64})?$")] = ""


class Benchmark(DocumentPart):
    """A recipe: a preset with changes as of `--set`, a seed, clips of `frames`, and its splits."""

    title: str
    about: str
    params: str
    changes: tuple[str, ...] = ()
    seed: Seed
    frames: int = 1
    fps: float = 10.0
    splits: dict[SplitName, BenchmarkSplit]

    def job(self, split: str, out: str | Path | None = None) -> Job:
        """The job that makes a split in the data set `out`."""
        clip = {"frames": self.frames, "fps": self.fps} if self.frames > 1 else {}
        chosen = {"params": self.params, "set": self.changes, "seed": self.seed, **clip}
        return Job(n=self.splits[split].n, split=split, out=out, **chosen)

    def drawn_digest(self, split: str) -> str:
        """The digest of a split's labels, drawn without Blender."""
        scenes = self.job(split).recipe().scenes
        worlds = (sample_world(scenes, index) for index in range(self.splits[split].n))
        return labels_digest(label(world, world.view) for world in worlds)

    def problems(self, split: str, out: str | Path) -> Iterator[str]:
        """A line where the labels of a split in the data set `out` differ from the benchmark's."""
        reader, expected = Reader(f"{out}/{split}"), self.splits[split]
        if len(reader) != expected.n:
            yield f"{reader.url}: expected {expected.n} samples, got {len(reader)}"
            return
        found = labels_digest(reader.labels(i) for i in range(len(reader)))
        if found != expected.labels != "":
            yield (
                f"{reader.url}: expected labels of digest {expected.labels}, got {found}: they are not "
                "those of the benchmark, so its scores do not compare"
            )


def benchmark_names() -> list[str]:
    """The names of the benchmarks in the package."""
    return preset_names(KIND)


def load_benchmark(source: str) -> Benchmark:
    """Read a benchmark of the package (by name) or a YAML file; raise InputError with a line for every problem."""
    return read_as(Benchmark, *find_preset(source, KIND), "benchmark")


def labels_digest(labels: Iterable[Labels]) -> str:
    """The SHA-256 of what all machines agree on in labels: lanes, symbols and camera, but nothing rendered.

    Points are rounded to whole centimetres, because the last digits of `labels.json` may differ between machines.
    """
    digest = hashlib.sha256()
    for one in labels:
        lanes = [[*(getattr(lane, key) for key in LANE_KEYS), *_curve(lane)] for lane in one.lanes]
        symbols = [[symbol.kind, *_curve(symbol)] for symbol in one.symbols]
        line = json.dumps([_camera(one.camera), lanes, symbols], separators=(",", ":"))
        digest.update(f"{line}\n".encode())
    return digest.hexdigest()


def _curve(of: Lane | SymbolLabel) -> list[list[int]]:
    points_cm = np.rint(np.round(of.xyz_cam, 4) * 100)
    return [
        points_cm.astype(int).ravel().tolist(),
        *(mask.astype(int).tolist() for mask in (of.in_image, of.terrain_visible)),
    ]


def _camera(camera: CameraLabel) -> list[int]:
    thousandths = np.rint(np.round(camera.img_from_cam, 6) * 1000).astype(int).ravel().tolist()
    return [camera.width_px, camera.height_px, *thousandths]
