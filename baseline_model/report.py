"""Write a report as JSON, text and plots."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from synth3dlanes.figures.colors import KIND_WORDS, KINDS, hexadecimal
from synth3dlanes.system.files import encoded, write
from synth3dlanes.system.words import counted

from .curves import HALF_WIDTH_M, METRIC_Y_M, SHORTEST_M, Y_REF_M
from .metrics import Errors, EvaluationReport, KindReport

Cells = list[list[str]]
COLUMNS = ("AP", "near 1s", "near 2s", "far 1s", "far 2s")
PAPER_DELIMITERS = (0.971, 12.9, 33.0, 30.0, 106.0)
PAPER_TABLE_1: dict[str, tuple[float, float, float, float, float]] = {
    "full": (0.952, 13.3, 34.4, 33.1, 122.0),
    "image_view": (0.819, 20.3, 50.0, 74.7, 241.0),
    "top_view": (0.929, 17.5, 39.6, 49.5, 208.0),
    "early_ipm": (0.934, 13.7, 35.5, 43.5, 189.0),
    "late_ipm": (0.948, 14.5, 37.2, 37.4, 139.0),
    "horizon": (0.949, 14.8, 40.4, 36.7, 132.0),
    "fixed_position": (0.948, 13.6, 37.3, 35.4, 139.0),
    "flat_ground": (0.566, 46.9, 114.0, 99.0, 289.0),
}
"""AP, near 1 and 2 sigma, far 1 and 2 sigma in cm, centre lines of synthetic-3D-lanes."""


def to_document(report: EvaluationReport) -> dict[str, Any]:
    """The report as JSON values (docs/baseline.md); NaN becomes null."""
    document: dict[str, Any] = {name: _kind_document(kind) for name, kind in report.kinds.items()}
    document["pose"] = {
        "pitch_median_deg": _plain(report.pitch_median_deg),
        "height_median_cm": _plain(report.height_median_cm),
    }
    document["settings"] = {
        "n_images": report.n_images,
        "weights": report.config.weights,
        "threshold": report.config.threshold,
        "frame": report.config.frame,
        "match_m": 1.5,
    }
    if report.tusimple is not None:
        document["tusimple"] = dict(zip(("accuracy", "fp", "fn"), report.tusimple, strict=True))
    return document


def samples_document(report: EvaluationReport) -> list[dict[str, Any]]:
    """The score of each image as JSON values, the worst first."""
    return [{"key": one.key, "f1": one.f1, "error_cm": _plain(one.error_cm)} for one in report.samples]


def summary_line(report: EvaluationReport) -> str:
    """One line for a log; without errors where no detection matched a label, "-" where none did at that distance."""
    parts = []
    for name, kind in report.kinds.items():
        near, far = _cm(kind.at_threshold.near_1sigma_cm), _cm(kind.at_threshold.far_1sigma_cm)
        errors = "" if near == far == "-" else f" near {near} far {far} cm"
        parts.append(f"{name} AP {kind.ap:.3f}{errors}")
    return ", ".join([*parts, *([f"pose {pose}"] if (pose := _pose(report)) else [])])


def _pose(report: EvaluationReport) -> str:
    """The errors of the predicted pose, "" where none was predicted."""
    if math.isnan(report.pitch_median_deg):
        return ""
    return f"{report.pitch_median_deg:.2f} deg {report.height_median_cm:.1f} cm"


def to_text(report: EvaluationReport) -> str:
    """The report as text, with every choice that the paper leaves open."""
    config = report.config
    lines = [
        f"{counted(report.n_images, 'image')}; errors in cm, at confidence >= {config.threshold}; "
        f"frame {config.frame}; weights {config.weights}; match below 1.5 m",
        f"{'':14}{'AP':>7}{'95 % interval':>17}{'near 1s':>9}{'near 2s':>9}{'far 1s':>9}{'far 2s':>9}"
        f"{'recall':>8}{'precision':>10}",
    ]
    papers = {"centerline": PAPER_TABLE_1["full"], "delimiter": PAPER_DELIMITERS}
    for name, kind in report.kinds.items():
        low, high = kind.ap_interval
        errors = kind.at_threshold
        cells = "".join(f"{_cm(value):>9}" for value in _four(errors))
        lines.append(
            f"{name:14}{kind.ap:7.3f}{f'{low:.3f}..{high:.3f}':>17}{cells}{errors.recall:8.3f}{errors.precision:10.3f}"
        )
        if why := _why_no_errors(errors):
            lines.append(f"  no errors: {why}")
        ap, *paper = papers[name]
        lines.append(f"{'  paper':14}{ap:7.3f}{'':>17}" + "".join(f"{_cm(value):>9}" for value in paper))
    lines.append(f"pose: {f'median {pose}' if (pose := _pose(report)) else 'not predicted'} (paper: 0.09 deg, 2.4 cm)")
    if report.tusimple is not None:
        accuracy, fp, fn = report.tusimple
        lines.append(f"tuSimple: accuracy {accuracy:.4f}, FP {fp:.4f}, FN {fn:.4f} (paper: accuracy 0.951)")
    for name, kind in report.kinds.items():
        lines += _appendix(name, kind)
    return "\n".join(lines)


def table_1_cells(rows: dict[str, EvaluationReport]) -> Cells:
    """The paper's Table 1 (centre lines) beside ours; `paper / ours` in each cell."""
    cells = [["paper / ours", *COLUMNS]]
    for name, report in rows.items():
        paper = PAPER_TABLE_1.get(name.split(":")[0])
        theirs = ["-"] * 5 if paper is None else _row(*paper)
        cells.append([name, *(f"{a} / {b}" for a, b in zip(theirs, _ours(report), strict=True))])
    return cells


def curve_cells(rows: dict[str, EvaluationReport]) -> Cells:
    """One row per number of training images (centre lines), and the paper's 300,000."""
    ours = [[f"{int(name):,}", *_ours(report)] for name, report in rows.items()]
    return [["images", *COLUMNS], *ours, ["300,000 (paper)", *_row(*PAPER_TABLE_1["full"])]]


def text(cells: Cells) -> str:
    """The table as plain text."""
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))])
        for row in cells
    )


def markdown(cells: Cells) -> str:
    """The table as Markdown."""
    head, *rows = ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join([head, "|---" + "|---:" * (len(cells[0]) - 1) + "|", *rows])


def save_curve(rows: dict[str, EvaluationReport], path: Path) -> None:
    """Plot AP with its 95 % interval, and near and far errors, against the number of training images."""
    sizes = [int(name) for name in rows]
    with _two_plots(path, (9, 4.0)) as (left, right):
        for kind, rgb in KINDS.items():
            colour, words = hexadecimal(rgb), f"{KIND_WORDS[kind]}s"
            found = [report.kinds[kind] for report in rows.values()]
            errors = [k.at_threshold for k in found]
            left.plot(sizes, [k.ap for k in found], "o-", color=colour, label=words)
            left.fill_between(sizes, *zip(*(k.ap_interval for k in found), strict=True), color=colour, alpha=0.2)
            right.plot(sizes, [at.near_1sigma_cm for at in errors], "o-", color=colour, label=f"{words}, near")
            right.plot(sizes, [at.far_1sigma_cm for at in errors], "o:", color=colour, label=f"{words}, far")
        left.set(ylabel="AP", ylim=(0, 1))
        right.set(ylabel="error, 1 sigma [cm]")
        right.set_ylim(bottom=0)
        for axes in (left, right):
            axes.set(xlabel="training images", xscale="log", xticks=sizes, xticklabels=sizes)
            axes.minorticks_off()


def save_plots(report: EvaluationReport, path: Path) -> None:
    """Plot precision against recall, and error against distance."""
    from matplotlib.ticker import LogFormatter

    with _two_plots(path, (10, 4.6)) as (left, right):
        for name, rgb in KINDS.items():
            kind, colour, words = report.kinds[name], hexadecimal(rgb), f"{KIND_WORDS[name]}s"
            left.plot(kind.recalls, kind.precisions, color=colour, label=f"{words}, AP {kind.ap:.3f}")
            for errors_cm, sigmas, style in zip(kind.error_by_y_cm, (1, 2), "-:", strict=True):
                right.plot(METRIC_Y_M, errors_cm, style, color=colour, label=f"{words}, {sigmas} sigma")
        left.set(xlabel="recall", ylabel="precision", xlim=(0, 1.02), ylim=(0, 1.02))
        right.set(xlabel="distance [m]", ylabel="error [cm]", yscale="log")
        right.yaxis.set_major_formatter("{x:g}")
        right.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 1)))


@contextmanager
def _two_plots(path: Path, size_inches: tuple[float, float]) -> Iterator[tuple[Any, Any]]:
    """Axes beside each other, written to a PNG file in the end."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inches, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    yield left, right
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False)
    write(path, encoded(lambda stream: figure.savefig(stream, dpi=120)))


def _kind_document(kind: KindReport) -> dict[str, Any]:
    at = kind.at_threshold
    document: dict[str, Any] = {"ap": kind.ap, "precision": at.precision, "recall": at.recall}
    document |= {name: value for name, value in vars(at).items() if name.endswith("sigma_cm")}
    document |= {name: value for name, value in vars(at).items() if name not in document}
    document |= {"ap_101_points": kind.ap_101_points}
    document |= {"n_truth": kind.n_truth, "n_ignored": kind.n_ignored}
    document |= {"n_detections": kind.n_detections, "n_outside": kind.n_outside}
    document = {name: _plain(value) for name, value in document.items()}
    document["ap_interval"] = [_plain(value) for value in kind.ap_interval]
    document["ap_by_weights"] = {name: _plain(value) for name, value in kind.ap_by_weights.items()}
    for name, errors in (("at_best_f1", kind.at_best_f1), ("at_all", kind.at_all)):
        document[name] = {key: _plain(value) for key, value in vars(errors).items()}
    return document


def _appendix(name: str, kind: KindReport) -> list[str]:
    other = ", ".join(f"{weights} {ap:.3f}" for weights, ap in kind.ap_by_weights.items())
    lines = [
        f"{name}: {kind.n_truth} lanes, {kind.n_ignored} ignored, {kind.n_detections} detections; "
        f"AP by weights: {other}; 101 points {kind.ap_101_points:.3f}",
        f"  {counted(kind.n_outside, 'detection')} not judged: more than {HALF_WIDTH_M:g} m beside the camera at "
        f"{Y_REF_M:g} m, or shorter than {SHORTEST_M:g} m",
    ]
    for label, errors in (("best F1", kind.at_best_f1), ("all", kind.at_all)):
        cells = " / ".join(_cm(value) for value in _four(errors))
        lines.append(
            f"  {label} (>= {errors.threshold:.2f}): F1 {errors.f1:.3f}, precision {errors.precision:.3f}, "
            f"recall {errors.recall:.3f}; near, far: {cells}"
        )
    at = kind.at_threshold
    lines.append(
        f"  medians |dx|, |dz|: near {_cm(at.near_median_abs_dx_cm)}, {_cm(at.near_median_abs_dz_cm)}; "
        f"far {_cm(at.far_median_abs_dx_cm)}, {_cm(at.far_median_abs_dz_cm)}; "
        f"bias {_cm(at.bias_dx_cm)}, {_cm(at.bias_dz_cm)}"
    )
    return lines


def _why_no_errors(errors: Errors) -> str | None:
    """In words, if there are no errors because no lane was detected or matched."""
    if math.isnan(errors.precision):
        return f"no lane that counts reaches confidence {errors.threshold:g}"
    if errors.precision == 0:
        return f"no lane that reaches confidence {errors.threshold:g} matches a label"
    return None


def _four(errors: Errors) -> tuple[float, float, float, float]:
    return errors.near_1sigma_cm, errors.near_2sigma_cm, errors.far_1sigma_cm, errors.far_2sigma_cm


def _ours(report: EvaluationReport) -> list[str]:
    kind = report.kinds["centerline"]
    return _row(kind.ap, *_four(kind.at_threshold))


def _row(ap: float, *errors_cm: float) -> list[str]:
    return [f"{ap:.3f}", *(_cm(value) for value in errors_cm)]


def _cm(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1f}"


def _plain(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return None if math.isnan(value) else float(value)
    return value
