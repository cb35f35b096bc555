"""Train networks alike and test them on the same images: the rows of the paper's Table 1, or sizes of data set."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from synth3dlanes.system.errors import InputError
from synth3dlanes.system.files import Folder, write

from .config import TrainConfig, train_config
from .evaluate import evaluate_checkpoint, evaluate_flat_ground
from .metrics import EvaluationReport
from .report import Cells, curve_cells, markdown, save_curve, table_1_cells, text, to_document
from .sources import open_split
from .train import train

ROWS = ("full", "image_view", "top_view", "early_ipm", "late_ipm", "horizon", "fixed_position")


def ablation(
    data_dir: str | Path,
    out_dir: str | Path,
    model: str = "compact",
    rows: Sequence[str] = ROWS,
    overrides: dict[str, Any] | None = None,
    test_split: str = "test",
) -> dict[str, EvaluationReport]:
    """Train and score each row with the same seed, schedule, epochs and initialisation (paper, 4.3). `full` also gives
    `flat_ground`."""
    configs = {row: train_config(model, overrides, row) for row in rows}
    return _compare(configs, str(data_dir), Path(out_dir), test_split, table_1_cells)


def learning_curve(
    data_dir: str | Path,
    out_dir: str | Path,
    sizes: Sequence[int],
    model: str = "nano",
    overrides: dict[str, Any] | None = None,
    test_split: str = "test",
) -> dict[str, EvaluationReport]:
    """Train on the first N images of the training split for each N in `sizes`. All train for the same number of steps:
    `epochs` counts passes over the largest N."""
    whole = train_config(model, overrides)
    n_images = len(open_split(f"{data_dir}/{whole.train_split}"))
    if max(sizes) > n_images:
        raise InputError(f"{data_dir}/{whole.train_split}: expected at least {max(sizes)} images, got {n_images}")
    configs = {}
    for size in sorted(set(sizes)):
        longer = max(sizes) / size
        passes = {"epochs": whole.epochs * longer, "validate_every_epochs": whole.validate_every_epochs * longer}
        configs[str(size)] = whole.model_copy(update={"max_images": size, **passes})
    reports = _compare(configs, str(data_dir), Path(out_dir), test_split, curve_cells)
    save_curve(reports, Path(out_dir) / "curve.png")
    return reports


def _compare(
    configs: dict[str, TrainConfig],
    data_dir: str,
    out_dir: Path,
    test_split: str,
    cells: Callable[[dict[str, EvaluationReport]], Cells],
) -> dict[str, EvaluationReport]:
    """Train each into a folder of its name and write `table.txt`, `.md` and `.json` after each. Finished trainings are
    not repeated."""
    test = f"{data_dir}/{test_split}"
    open_split(test)  # fail now, not after hours of training
    reports: dict[str, EvaluationReport] = {}
    for name, config in configs.items():
        Folder(out_dir).make(name)
        best = train(config, [str(data_dir)], out_dir / name)
        reports[name] = evaluate_checkpoint(best, test, device=config.device)
        if name == "full":
            reports |= evaluate_flat_ground(best, test, device=config.device)
        document = {row: to_document(report) for row, report in reports.items()}
        write(out_dir / "table.json", json.dumps(document).encode())
        write(out_dir / "table.txt", f"{text(cells(reports))}\n".encode())
        write(out_dir / "table.md", f"{markdown(cells(reports))}\n".encode())
    return reports
