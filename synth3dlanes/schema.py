"""Validation of files that people may edit: strict pydantic models, and one line per problem."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

Unit = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]


class Part(BaseModel):
    """A frozen part of a document; unknown keys, missing keys, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def validation_problems(error: ValidationError, where: str) -> list[str]:
    """One line per problem: where, what was expected, what was found."""
    lines = []
    for problem in error.errors():
        path = ".".join(str(step) for step in problem["loc"])
        if problem["type"] == "value_error":
            lines.append(f"{where}: {problem['ctx']['error']}")
            continue
        found = "" if problem["type"] == "missing" else f", got {problem['input']!r:.60}"
        lines.append(f"{where}: {path + ': ' if path else ''}{problem['msg']}{found}")
    return lines
