"""What an export holds, and the README that says so."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synth3dlanes.formats.format import Format, PinholeFormat
from synth3dlanes.formats.plan import DEALT_EVERY, ExportSplit, parts_of
from synth3dlanes.formats.writing import PARTS, Pinhole

MOST_ENLARGED = 1.5


@dataclass(frozen=True)
class ExportSummary:
    """The widest camera, None if images keep their own; frames by part (train, val, test) and by split; frames left out
    and lanes dropped by reason; focal lengths; how many times images were enlarged at most; frames in each of the
    format's lists."""

    camera: Pinhole | None
    n_frames: Counter[str]
    n_of_split: Counter[tuple[str, str]]
    left_out: Counter[str]
    n_lines: int
    dropped: Counter[str]
    f_px: tuple[float, ...]
    enlarged: float
    n_of_list: dict[str, int]

    def text(self, counted: str) -> str:
        """In lines; `counted` is what a line is called."""
        frames = ", ".join(f"{self.n_frames[part]} {part}" for part in PARTS)
        left_out = (f"left out {count} frames: {reason}" for reason, count in self.left_out.items())
        return "\n".join([f"{frames} frames, {self.n_lines} {counted}", *left_out])

    def document(self) -> dict[str, Any]:
        frames = {part: self.n_frames[part] for part in PARTS}
        return {"frames": frames, "lines": self.n_lines, "left_out": dict(self.left_out), "dropped": dict(self.dropped)}


def summarize(records: Iterable[dict[str, Any]], foreign: Format) -> ExportSummary:
    """Count what the chunks' records say of their frames."""
    camera = foreign.camera if isinstance(foreign, PinholeFormat) else None
    n_of_list = dict.fromkeys(foreign.lists, 0)
    n_frames, left_out, dropped = Counter[str](), Counter[str](), Counter[str]()
    n_of_split, n_lines, f_px, enlarged = Counter[tuple[str, str]](), 0, set[float](), 0.0
    for record in records:
        if record["left_out"]:
            left_out[record["left_out"]] += 1
            continue
        n_frames[record["part"]] += 1
        n_of_split[record["split"], record["part"]] += 1
        n_lines += record["n_lines"]
        dropped.update(record["dropped"])
        for path in {path for _, paths in record["shared"] for path in paths if path in n_of_list}:
            n_of_list[path] += 1
        if camera is not None:
            f_px.add(record["f_px"] or camera.f_px)
            enlarged = max(enlarged, record["enlarged"] or 0.0)
    return ExportSummary(
        camera, n_frames, n_of_split, left_out, n_lines, dropped, tuple(sorted(f_px)), enlarged, n_of_list
    )


def warnings(out: Path, foreign: Format, summary: ExportSummary) -> tuple[str, ...]:
    """What a user should know of the export before training on it."""
    found = []
    words = [word for word in foreign.replaced_words if word in str(out.absolute())]
    if words:
        found.append(f"{out.absolute()}: tools of this format replace {', '.join(words)} in the whole path: move it")
    if summary.enlarged > MOST_ENLARGED:
        advice = "render larger ones" + (
            ", or choose a smaller size" if isinstance(foreign, PinholeFormat) and foreign.is_size_free else ""
        )
        found.append(f"{out}: images were enlarged {summary.enlarged:.1f} times{_size(summary, 'to')}: {advice}")
    return tuple(found)


def readme(
    source: str, format_name: str, foreign: Format, splits: Sequence[ExportSplit], summary: ExportSummary
) -> str:
    """`OUT/README.md`."""
    dropped = [f"| lane: {reason} | {count} |" for reason, count in summary.dropped.most_common()]
    left_out = [f"| frame: {reason} | {count} |" for reason, count in summary.left_out.most_common()]
    lines = [
        f"# {format_name} export of {source}",
        "",
        foreign.readme,
        f"{sum(summary.n_frames.values())} frames{_size(summary, 'of')} with {summary.n_lines} {foreign.counted}"
        f"{_focal_lengths(summary)}.",
        "",
        "| split of the data set | used as | frames |",
        "|---|---|---|",
        *(f"| {split} | {part} | {count} |" for (split, part), count in sorted(summary.n_of_split.items())),
        "",
        *_how_parts_were_made(splits, summary),
        "| left out because | count |",
        "|---|---|",
        *(left_out + dropped or ["| (nothing was left out) | 0 |"]),
        "",
        *_lists(summary),
        f"`synth3dlanes export {source} --format {format_name} --out FOLDER --verify` compares it with the labels.",
        "",
    ]
    return "\n".join(lines)


def _lists(summary: ExportSummary) -> list[str]:
    if not summary.n_of_list:
        return []
    rows = [f"| `{path}` | {count} |" for path, count in summary.n_of_list.items()]
    return ["| list | frames |", "|---|---|", *rows, ""]


def _size(summary: ExportSummary, word: str) -> str:
    return "" if summary.camera is None else f" {word} {summary.camera.width_px}x{summary.camera.height_px}"


def _focal_lengths(summary: ExportSummary) -> str:
    if not summary.f_px:
        return ""
    shortest, longest = summary.f_px[0], summary.f_px[-1]
    return f", f = {shortest:g} px" if shortest == longest else f", f = {shortest:g} to {longest:g} px"


def _how_parts_were_made(splits: Sequence[ExportSplit], summary: ExportSummary) -> list[str]:
    has_test = summary.n_frames["test"] > 0
    parts, sentences = parts_of(splits, has_test), []
    if any(split.is_dealt for split in splits):
        ends = " and ".join(str(end) for end in range(DEALT_EVERY - 1, 10, DEALT_EVERY))
        fifth = f"those of every fifth scene (numbers that end in {ends})"
        is_so = f"{fifth} were made test frames." if has_test else f"with more scenes, {fifth} become test frames."
        sentences.append(f"The data set has neither val nor test frames: {is_so}")
    for lacking, other in (("val", "test"), ("test", "val")):
        if lacking not in parts and other in parts:
            sentences.append(f"It has no {lacking} frames: tools that open {lacking} find the {other} frames.")
    return [*sentences, ""] if sentences else []
