"""Measure the latency and memory of every network: `python -m scripts.latency [MODEL ...]` writes docs/latency.json,
from which `make docs` makes the table in docs/baseline.md.

Every number is of a process of its own: one image, its lanes not decoded, the best of REPEATS; peak memory of the whole
process. CPU time is that of one thread; the wall-clock time on two threads is only worth something on idle cores.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from synth3dlanes.system.files import write
from synth3dlanes.system.scratch import scratch

FILE = Path(__file__).parents[1] / "docs/latency.json"
MODELS = ("nano", "streets", "small", "compact", "paper", "tusimple")
REPEATS = 8
HEAD = "| network | run by | numbers | one thread | two threads | peak memory |\n|---|---|---|---:|---:|---:|"
UNITS = {"cpu_ms": "ms", "wall_ms": "ms", "memory_mib": "MiB"}


def rows() -> list[dict[str, Any]]:
    """What docs/latency.json has."""
    found: list[dict[str, Any]] = json.loads(FILE.read_text())["rows"] if FILE.is_file() else []
    return found


def table() -> str:
    """The table of the costs as Markdown."""
    lines = [HEAD]
    for row in rows():
        cells = [row["model"], row["by"], row["numbers"]]
        cells += [f"{row[key]:.0f} {unit}" for key, unit in UNITS.items()]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main(models: list[str]) -> None:
    """Measure, and replace the rows of these models."""
    kept = rows()
    for model in models:
        kept = [row for row in kept if row["model"] != model]
        with scratch() as folder:
            for numbers, by in (("float32", "torch"), ("float32", "onnxruntime"), ("int8", "onnxruntime")):
                file = str(folder / f"{numbers}.onnx")
                if by == "onnxruntime":
                    _in_a_process("export", model, numbers, file)
                one, two = (_in_a_process(by, model, str(threads), file) for threads in (1, 2))
                row = {"model": model, "by": by, "numbers": numbers, "cpu_ms": one["cpu_ms"]}
                kept.append(row | {"wall_ms": two["wall_ms"], "memory_mib": one["memory_mib"]})
                sys.stdout.write(f"{kept[-1]}\n")
                sys.stdout.flush()
    kept.sort(key=lambda row: MODELS.index(row["model"]))
    write(FILE, f"{json.dumps({'rows': kept}, indent=1)}\n".encode())


def _in_a_process(*words: str) -> dict[str, float]:
    command = [sys.executable, "-W", "ignore", "-m", "scripts.latency", "one", *words]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def one(by: str, model: str, what: str, file: str) -> dict[str, float]:
    """Export a network, or measure it."""
    if by == "export":
        return _export(model, what, file)
    pixels = np.random.default_rng(0).random((1, 3, 360, 480), dtype=np.float32)
    intrinsics = np.array([[415.7, 415.7, 240, 180]], dtype=np.float32)
    run = (_torch if by == "torch" else _onnxruntime)(model, int(what), file)
    measured = []
    for _ in range(REPEATS):
        cpu, wall = time.process_time(), time.perf_counter()
        run(pixels, intrinsics)
        measured.append((time.process_time() - cpu, time.perf_counter() - wall))
    cpu_s, wall_s = np.min(measured, axis=0)
    peak_kib = int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
    found = {"cpu_ms": 1000 * cpu_s, "wall_ms": 1000 * wall_s, "memory_mib": peak_kib / 1024}
    return {key: round(number, 1) for key, number in found.items()}


def _network(model: str) -> Any:
    """`nano`, `compact` and `streets` as in the package; the others with random weights, which cost the same."""
    import torch
    from synth3dlanes_baseline import checkpoint
    from synth3dlanes_baseline.config import train_config
    from synth3dlanes_baseline.model import LaneNet

    if model in ("nano", "compact", "streets"):
        return checkpoint.load_lane_net(model, torch.device("cpu"))[1]
    return LaneNet(train_config(model, {}).model).eval().to(memory_format=torch.channels_last)


def _torch(model: str, threads: int, _: str) -> Callable[[np.ndarray, np.ndarray], Any]:
    import torch
    from synth3dlanes_baseline.inference import run

    torch.set_num_threads(threads)
    network = _network(model)
    layout = torch.channels_last
    return lambda pixels, intrinsics: run(
        network, torch.from_numpy(pixels).contiguous(memory_format=layout), torch.from_numpy(intrinsics)
    )


def _onnxruntime(_: str, threads: int, file: str) -> Callable[[np.ndarray, np.ndarray], Any]:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    names = [one.name for one in session.get_inputs()]
    return lambda *inputs: session.run(
        None, {name: value for name, value in zip(("image", "intrinsics"), inputs, strict=True) if name in names}
    )


def _export(model: str, numbers: str, file: str) -> dict[str, float]:
    """Export a network; to int8 from the float32 file beside it, with ranges of an image of noise, which do not change
    the cost."""
    from synth3dlanes_baseline.data import CameraImage
    from synth3dlanes_baseline.inference import Detector
    from synth3dlanes_baseline.onnx_export import exported, quantised

    if numbers == "float32":
        proto = exported(_network(model))
    else:
        import onnx

        proto = onnx.load(Path(file).with_name("float32.onnx"))
        noise = np.random.default_rng(0).integers(0, 255, (360, 480, 3), dtype=np.uint8)
        images = [CameraImage("0", noise, (415.7, 415.7, 240, 180))]
        proto = quantised(proto, images, Detector(_network(model), (360, 480)))
    write(Path(file), proto.SerializeToString())
    return {}


if __name__ == "__main__":
    if sys.argv[1:2] == ["one"]:
        sys.stdout.write(f"{json.dumps(one(*sys.argv[2:]))}\n")
    else:
        main(sys.argv[1:] or list(MODELS))
