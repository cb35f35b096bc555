"""Score predictions for an export by the rule of its benchmark: `evaluate --format`."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from synth3dlanes.formats.format import FrameList, Rates, ReadFrame
from synth3dlanes.formats.reading import json_lines
from synth3dlanes.formats.registry import open_format
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.system.schema import Excerpt, parse

EVERY = 10**9

Prediction = TypeVar("Prediction")
Line = TypeVar("Line", bound=Excerpt)


def score_predictions(out: Path, format_name: str, predictions: Path) -> tuple[Rates, ...]:
    """The rates of each list of an export that the predictions, a file or a folder as the benchmark takes it, are for.
    Raises InputError for a format that has no benchmark, FormatError for predictions that cannot be read or that lack
    a frame."""
    foreign = open_format(format_name)
    if foreign.score is None:
        raise InputError(f"format_name: expected a format with a benchmark that can be scored here, got {format_name}")
    found = tuple(foreign.score(out, predictions))
    if not found:
        raise FormatError(f"{predictions}: expected predictions for the frames of {out}, got none")
    return found


def predicted(
    lists: Iterable[FrameList], find: Callable[[ReadFrame], Prediction | None], predictions: Path
) -> Iterator[tuple[str, list[tuple[ReadFrame, Prediction]]]]:
    """The frames of each list with their predictions. Lists of which no frame has any are left out; one without them in
    another list is a FormatError."""
    for frames in lists:
        found = [(frame, find(frame)) for frame in frames.frames]
        both = [(frame, prediction) for frame, prediction in found if prediction is not None]
        if both and len(both) < len(found):
            lacking = next(frame.file for frame, prediction in found if prediction is None)
            expected = f"predictions for the {len(found)} frames of {frames.name}"
            raise FormatError(f"{predictions}: expected {expected}, got {len(both)}, none for {lacking}")
        if both:
            yield frames.name, both


def scored(
    lists: Iterable[FrameList],
    of_frame: Callable[[ReadFrame], Prediction | None],
    benchmark: Callable[[list[Prediction]], Any],
    predictions: Path,
) -> Iterator[Rates]:
    """The rates of each list: `benchmark` makes a dataclass of numbers of what `of_frame` gives for its frames, such as
    the true and the predicted lines; None for a frame without a prediction."""
    for name, frames in predicted(lists, of_frame, predictions):
        yield rates(name, frames, benchmark([found for _, found in frames]))


def lines_by(path: Path, model: type[Line], key: str) -> dict[str, Line]:
    """The documents of a JSON-lines file of predictions, by one of their values."""
    found = [parse(model, line, f"{path}:{i}", "a prediction") for i, line in enumerate(json_lines(path), start=1)]
    return {getattr(line, key): line for line in found}


def rates(name: str, frames: list[Any], score: Any) -> Rates:
    """What a score, a dataclass of numbers, says of these frames; without what the benchmark does not have."""
    return Rates(name, len(frames), {key: value for key, value in asdict(score).items() if value == value})
