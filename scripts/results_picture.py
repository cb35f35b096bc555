"""Pictures of tables in the documentation: `python -m scripts.results_picture` (`make pictures`) draws them anew."""

import re
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from synth3dlanes.figures import colors

DOCS = Path(__file__).parents[1] / "docs"
PICTURES = DOCS / "pictures"
CENTER, DELIMITER, PHOTOGRAPH = "#2f6f4f", "#b5541c", "#3b6ea5"
PAPER_TEST, PAPER_TRAINING = 0.952, 0.966
Row = dict[str, str]


def table(page: str, header: str) -> list[Row]:
    """The rows of the page's table whose header begins so, by the names of its columns."""
    lines = iter((DOCS / page).read_text().splitlines())
    for line in lines:
        if line.startswith(f"| {header} |"):
            names = cells(line)
            next(lines)
            break
    else:
        raise ValueError(f"{page}: expected a table that begins with {header}, got none")
    rows = []
    for line in lines:
        if not line.startswith("|"):
            break
        rows.append(dict(zip(names, cells(line), strict=True)))
    return rows


def cells(line: str) -> list[str]:
    """The cells of a line of a table."""
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def numbers(cell: str) -> list[float]:
    """The numbers in a cell, thousands with commas."""
    return [float(number.replace(",", "")) for number in re.findall(r"\d[\d,]*\.?\d*", cell.replace(", ", " "))]


def content() -> Figure:
    """What leaving out a kind of content costs: the means of the seeds as bars, each seed as a dot."""
    rows = table("real_images.md", "left out")
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    columns = {"centre lines": CENTER, "delimiters": DELIMITER, "photographs": PHOTOGRAPH}
    for axes, (name, color) in zip(panels, columns.items(), strict=True):
        with_all = sum(numbers(rows[0][name])) / 2
        for place, row in enumerate(rows):
            seeds = numbers(row[name])
            axes.barh(place, sum(seeds) / len(seeds) - with_all, color=color, alpha=0.5)
            axes.plot([seed - with_all for seed in seeds], [place] * len(seeds), "o", color=color, markersize=4)
        axes.axvline(0, color=colors.INK, linewidth=0.8)
        what = "accuracy on photographs" if name == "photographs" else f"AP of {name}"
        axes.set(title=what, xlabel="gained by leaving it out", xlim=(-0.08, 0.08))
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(range(len(rows)), [re.sub(r" \(`.*", "", row["left out"]) for row in rows])
    panels[0].invert_yaxis()
    panels[0].set_ylabel("left out")
    return figure


def training() -> Figure:
    """AP of centre lines on test images, with its interval, and on images of the training, by training samples."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes: Axes = figure.add_subplot()
    for row in table("baseline_results.md", "network"):
        (samples,) = numbers(row["samples"])
        ap, low, high = numbers(row["AP, centre lines"])
        axes.errorbar(samples, ap, [[ap - low], [high - ap]], fmt="o", color=CENTER, capsize=3)
        if "not seen" not in row["on 200 of its images"]:
            axes.plot(samples, numbers(row["on 200 of its images"])[0], "o", color=CENTER, fillstyle="none")
        name = row["network"].replace("`", "").partition(":")[0]
        text = f"{name}, {row['multiply-adds']}MAC"
        axes.annotate(text, (samples, ap), (6, -4), textcoords="offset points", fontsize=9)
    for ap, style, what in ((PAPER_TEST, "-", "test images"), (PAPER_TRAINING, "--", "training images")):
        axes.axhline(ap, color=colors.INK, linewidth=0.8, linestyle=style, label=f"paper, {what}")
    axes.plot([], [], "o", color=CENTER, label="test images, 95 % interval")
    axes.plot([], [], "o", color=CENTER, fillstyle="none", label="200 of its training images")
    axes.set(xscale="log", xlabel="training samples", ylabel="AP of centre lines", xlim=(1e5, 1.2e6), ylim=(0.8, 1.0))
    axes.set_xticks([1e5, 2e5, 5e5, 1e6], ["100,000", "200,000", "500,000", "1,000,000"])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False)
    return figure


def main() -> None:
    """Draw all pictures."""
    training().savefig(PICTURES / "training.png", dpi=100)
    content().savefig(PICTURES / "content.png", dpi=100)


if __name__ == "__main__":
    main()
