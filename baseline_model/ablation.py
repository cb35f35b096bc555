"""Train every row of the paper's Table 1 alike and print it beside the paper's numbers."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from baseline_model.config import ABLATIONS, train_config
from baseline_model.evaluate import evaluate_checkpoint, evaluate_flat_ground
from baseline_model.metrics import Report
from baseline_model.report import table_1, to_document
from baseline_model.train import train

ROWS = ("full", "image_view", "top_view", "early_ipm", "late_ipm", "horizon", "fixed_position")


def ablation(
    data_dir: str | Path,
    out_dir: str | Path,
    model: str = "compact",
    rows: Sequence[str] = ROWS,
    overrides: dict[str, Any] | None = None,
    test_split: str = "test",
) -> dict[str, Report]:
    """Same seed, schedule, epochs and start for all (paper, 4.3). Finished rows are not trained again; writes
    `table.txt` and `table.json`."""
    unknown = [row for row in rows if row not in ABLATIONS]
    configs = {row: train_config(model, overrides, row) for row in [*unknown, *rows]}
    out, test = Path(out_dir), f"{data_dir}/{test_split}"
    reports: dict[str, Report] = {}
    for row, config in configs.items():
        best = train(config, data_dir, out / row)
        reports[row] = evaluate_checkpoint(best, test, device=config.device)
        if row == "full":
            reports |= evaluate_flat_ground(best, test, device=config.device)
        (out / "table.txt").write_text(table_1(reports) + "\n", encoding="utf-8")
        document = {name: to_document(report) for name, report in reports.items()}
        (out / "table.json").write_text(json.dumps(document), encoding="utf-8")
    return reports
