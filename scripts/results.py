"""Generated parts of docs/benchmarks.md, and docs/models.md: from the weights, the benchmarks and docs/results.yaml."""

import re
from pathlib import Path
from typing import Any

import yaml
from synth3dlanes_baseline.checkpoint import Checkpoint, load, place
from synth3dlanes_cli.networks import SHIPPED

from scripts.latency import rows as latency_rows
from synth3dlanes.production.benchmarks import benchmark_names, load_benchmark

RESULTS = Path(__file__).parents[1] / "docs/results.yaml"
FIGURES = ("centerline_ap", "delimiter_ap", "near_cm", "far_cm")
MODELS_HEAD = """# Models

A card for each file of weights in the package, `baseline_model/weights`. `train --init NAME`, `predict NAME` and
`evaluate --checkpoint NAME` take them by name.
"""


def results() -> dict[str, Any]:
    """The figures that were measured."""
    found: dict[str, Any] = yaml.safe_load(RESULTS.read_text())
    return found


def with_benchmarks(page: str) -> str:
    """The page of the benchmarks with its two tables."""
    for mark, table in (("benchmarks", benchmark_table()), ("scores", score_table())):
        before, after = re.split(rf"(?<=<!-- {mark} -->\n).*?(?=\n\n\S)", page, maxsplit=1, flags=re.DOTALL)
        page = f"{before}\n{table}{after}"
    return page


def benchmark_table() -> str:
    """What each benchmark is, and its test split's digest."""
    rows = ["| name | | recipe | samples: train, val, test | digest of the test labels |", "|---|---|---|---|---|"]
    for name in benchmark_names():
        found = load_benchmark(name)
        recipe = [f"`{found.params}`", *(f"`{change}`" for change in found.changes), f"seed {found.seed}"]
        recipe += [f"clips of {found.frames} frames, {found.fps:g} a second"] if found.frames > 1 else []
        sizes = ", ".join(f"{split.n:,}" for split in found.splits.values())
        digest = f"`{found.splits['test'].labels[:16]}...`"
        rows.append(f"| `{name}` | {found.title}. {found.about} | {', '.join(recipe)} | {sizes} | {digest} |")
    return "\n".join(rows)


def score_table() -> str:
    """A row for each network and benchmark."""
    rows = ["| network | benchmark | centre lines | delimiters | near | far |", "|---|---|---:|---:|---:|---:|"]
    for network in results()["scores"]:
        rows += [f"| [{network['network']}]({network['link']}) {row}" for row in score_rows(network)]
    return "\n".join(rows)


def score_rows(network: dict[str, Any]) -> list[str]:
    """The scores of a network on every benchmark that it has some on."""
    found = []
    for name in filter(network.__contains__, benchmark_names()):
        lines, delimiters, near_cm, far_cm = (network[name][figure] for figure in FIGURES)
        found.append(f"| `{name}` | {lines:.3f} | {delimiters:.3f} | {near_cm:.0f} cm | {far_cm:.0f} cm |")
    return found


def models_page() -> str:
    """The cards of all weights in the package."""
    measured = results()
    by_name = {network["network"].strip("`"): network for network in measured["scores"]}
    cards = [card(name, about, by_name[name]) for name, about in measured["models"].items()]
    return "\n".join([MODELS_HEAD, *cards])


def card(name: str, about: dict[str, Any], network: dict[str, Any]) -> str:
    """What one file of weights is, and what it is not for."""
    path = place(name)
    found = load(path)
    config, batch = found.config, found.about.get("batch", found.config.batch)
    facts = {
        "for": SHIPPED[name],
        "file": f"`{path.name}`, {path.stat().st_size / 1e6:.1f} MB, float16, no code in it",
        "network": f"3D-LaneNet, {about['network']}, {n_weights(found):,} numbers",
        "input": f"RGB, scaled to {config.model.image_width_px}x{config.model.image_height_px} px, and the intrinsics",
        "output": "centre lines and delimiters in 3D with confidences, height and pitch of the camera",
        "data": about["data"],
        "training": f"{found.about['step']:,} steps of {batch} images in the last run; {about['made']}",
        "licence": "weights: MIT, as the code; all images are CC0-1.0, made by this program, without a photograph",
        "latency": f"{latency_words(name)} of one thread for an image ([all networks](baseline.md#speed))",
    }
    rows = "\n".join(["| | |", "|---|---|", *(f"| {key} | {text.strip()} |" for key, text in facts.items())])
    limits, figures = ("\n".join(f"- {line.strip()}" for line in about[part]) for part in ("limits", "figures"))
    head = "| benchmark | centre lines | delimiters | near | far |\n|---|---:|---:|---:|---:|"
    scores = "\n".join([head, *score_rows(network)])
    return (
        f"## {name}\n\n{rows}\n\nIts limits:\n\n{limits}\n\nIts scores on the [benchmarks](benchmarks.md#scores):\n\n"
        f"{scores}\n\nElsewhere:\n\n{figures}\n"
    )


def latency_words(name: str) -> str:
    """What the network of these weights costs."""
    costs = {(row["by"], row["numbers"]): f"{row['cpu_ms']:.0f} ms" for row in latency_rows() if row["model"] == name}
    by_onnx = f"{costs['onnxruntime', 'float32']} with ONNX Runtime, {costs['onnxruntime', 'int8']} in int8"
    return f"{costs['torch', 'float32']} with PyTorch, {by_onnx}"


def n_weights(found: Checkpoint) -> int:
    """How many numbers a checkpoint has."""
    return sum(value.numel() for value in found.model.values())
