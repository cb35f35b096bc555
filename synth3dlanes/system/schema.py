"""JSON documents that people may have edited: read by one schema with bounds, and one line per problem."""

import codecs
import difflib
import re
import reprlib
from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from synth3dlanes.system.errors import FormatError

# The most bytes of a document, far above ours: labels take 30 kB, a scene with 5000 trees 1 MB.
MAX_BYTES = 16 << 20
# The most commas and brackets of a document: each takes 110 bytes. Ten hours of 2D lanes have 4 million.
MOST_VALUES = 6_000_000
# The most lines of problems that are shown, and the most that are looked at.
MAX_PROBLEMS, MOST_PROBLEMS = 8, 100_000
# An image's longest side.
MAX_PX = 8192
# A camera turned by no more than this looks ahead.
AHEAD_DEG = 30.0

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)

MAX_NUMBER = 1e6
Number = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Metres = Annotated[float, Field(ge=-1000, le=1000)]
Unit = Annotated[float, Field(ge=0, le=1)]
Color = tuple[Unit, Unit, Unit]
Positive = Annotated[float, Field(gt=0, le=1e6)]
PixelCount = Annotated[int, Field(ge=1, le=MAX_PX)]
Seed = Annotated[int, Field(ge=0, le=2**128)]
Name = Annotated[str, Field(max_length=64, pattern=r"^[\w.-]*$")]
# Paint that bounds no lane.
SymbolKind = Literal[
    "arrow_straight",
    "arrow_left",
    "arrow_right",
    "arrow_straight_left",
    "arrow_straight_right",
    "stop_line",
    "give_way_line",
    "crosswalk",
    "gore",
]


def _below(path: str) -> str:
    if PurePosixPath(path).is_absolute() or ".." in PurePosixPath(path).parts or "\0" in path:
        raise ValueError(f"expected a path below the folder, got {shown(path)}")
    return path


# The path of a file below the folder of the document that names it.
PathBelow = Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(_below)]

Document = TypeVar("Document", bound=BaseModel)

# What was expected, as text, by the start of pydantic's error type. The rest of the type's name is a key of the error's
# context.
EXPECTED = {
    "missing": "missing",
    "extra_forbidden": "unknown key",
    "unexpected_keyword_argument": "unknown key",
    "json_invalid": "expected JSON: {error}",
    "value_error": "{error}",
    "finite_number": "expected a finite number",
    "float_type": "expected a number",
    "float_parsing": "expected a number",
    "int_type": "expected a whole number",
    "int_parsing": "expected a whole number",
    "int_from_float": "expected a whole number",
    "int_parsing_size": "expected a smaller number",
    "string_type": "expected text",
    "string_unicode": "expected text",
    "string_too_short": "expected at least {min_length} characters",
    "string_too_long": "expected at most {max_length} characters",
    "string_pattern_mismatch": "expected text of the form {pattern}",
    "bool_type": "expected true or false",
    "bool_parsing": "expected true or false",
    "literal_error": "expected {expected}",
    "greater_than": "expected more than {gt:g}",
    "greater_than_equal": "expected at least {ge:g}",
    "less_than": "expected less than {lt:g}",
    "less_than_equal": "expected at most {le:g}",
    "too_short": "expected at least {min_length} values",
    "too_long": "expected at most {max_length} values",
    "list_type": "expected a list",
    "tuple_type": "expected a list",
    "is_instance_of": "expected a {class}",
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type", "dataclass_type"), "expected an object"),
}
WITHOUT_VALUE = ("missing", "extra_forbidden", "unexpected_keyword_argument", "json_invalid", "value_error")


class DocumentPart(BaseModel):
    """A frozen part of a document; unknown keys, missing keys, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Excerpt(DocumentPart):
    """What we need of a document that has more; other keys are left alone."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


def parse(model: type[Document], data: str | bytes, where: str, what: str, most_bytes: int = MAX_BYTES) -> Document:
    """Read a JSON document of at most `most_bytes`; `what` names it, as in "synth3dlanes.scene version 1".

    Raises FormatError with a line for each problem, beginning with `where`; with one line for another document.
    """
    if len(data) > most_bytes:
        raise FormatError(f"{where}: expected {what} of at most {most_bytes >> 20} MiB, got {len(data) >> 20} MiB")
    n_values = sum(data.count(mark) if isinstance(data, str) else data.count(mark.encode()) for mark in ",[{")
    if n_values > MOST_VALUES:
        raise FormatError(f"{where}: expected {what} of at most {MOST_VALUES:,} values, got {n_values:,}")
    # Some editors begin UTF-8 with a byte order mark.
    data = data.removeprefix("\ufeff") if isinstance(data, str) else data.removeprefix(codecs.BOM_UTF8)
    try:
        return model.model_validate_json(data, strict=True)
    except ValidationError as error:
        n_problems = error.error_count()
        found = f"one with {n_problems:,} problems" if n_problems > MOST_PROBLEMS else _other(error)
        if found:
            raise FormatError(f"{where}: expected {what}, got {found}") from None
        raise FormatError("\n".join(validation_problems(error, where))) from None


def _other(error: ValidationError) -> str:
    """What a document is that is no object, or has another format or version, or no key of ours; "" for one of ours."""
    problems = error.errors(include_url=False)
    for problem in problems:
        if problem["loc"] in (("format",), ("version",)) and problem["type"] != "missing":
            return f"{problem['loc'][0]} {shown(problem['input'])}"
        if not problem["loc"] and problem["type"].endswith("_type"):
            return shown(problem["input"])
    missing = {problem["loc"] for problem in problems if problem["type"] == "missing"}
    is_bare = len(missing) == len(problems) > 2 and all(len(place) == 1 for place in missing)
    return "another document" if is_bare or missing & {("format",), ("version",)} else ""


def validation_problems(error: ValidationError, where: str) -> list[str]:
    """One line per problem: where, the key, what was expected, what was found; of many problems the first."""
    problems = error.errors(include_url=False)
    more = len(problems) - MAX_PROBLEMS
    lines = [f"{where}: {problem_line(problem)}" for problem in problems[:MAX_PROBLEMS]]
    return lines + ([f"{where}: and {more} more problems"] if more > 0 else [])


def problem_line(problem: ErrorDetails) -> str:
    """The key, what was expected there and what was found."""
    key = ".".join(str(step) for step in problem["loc"])
    kind, context = problem["type"], problem.get("ctx", {})
    text = EXPECTED[kind].format(**context) if kind in EXPECTED else problem["msg"]
    if kind in ("too_short", "too_long"):
        text += f", got {context['actual_length']}"
    elif kind not in WITHOUT_VALUE:
        text += f", got {shown(problem['input'])}"
    return f"{key}: {text}" if key else text


def shown(value: Any) -> str:
    """A value as a short text on one line, whatever its size."""
    return reprlib.repr(value)[:60]


def unknown_key(key: str, known: Iterable[str]) -> str:
    """The message for an unknown key, with the most similar known key."""
    return f"unknown key{did_you_mean(key, known)}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """A question for the known word that is close to one, has it as initials (`lr`), or has the same letters and
    digits (`hdl64e`); "" where there is none."""
    known, plain = list(known), _plain(word)
    same = [name for name in known if plain in (_plain(name), "".join(part[:1] for part in name.split("_")))]
    close = same or difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close and plain else ""


def _plain(word: str) -> str:
    return re.sub(r"[\W_]", "", word.lower())


def is_none(value: object) -> bool:
    """Whether a field that may be left out is left out."""
    return value is None


def is_empty(value: tuple[object, ...]) -> bool:
    """Whether a field that may be left out is left out."""
    return not value
