"""Which frames a person accepted and rejected: the file that the review page saves."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from synth3dlanes.drives.tables import read_bytes
from synth3dlanes.schema import MAX_BYTES, DocumentPart, parse

REVIEW_FORMAT, REVIEW_VERSION = "synth3dlanes.review", 1

Verdict = Literal["accepted", "rejected"]
_Name = Annotated[str, Field(max_length=200)]


class Review(DocumentPart):
    """Verdicts by the names of frames; frames that nobody looked at have none. `source` is the drive or data set."""

    format: Literal["synth3dlanes.review"]
    version: Literal[1]
    source: Annotated[str, Field(max_length=1000)]
    frames: dict[_Name, Verdict]

    @property
    def rejected(self) -> frozenset[str]:
        """The names of the frames that were rejected."""
        return frozenset(name for name, verdict in self.frames.items() if verdict == "rejected")


def read_review(path: Path) -> Review:
    """Read such a file. Raises FormatError with a line for each problem."""
    what = f"{REVIEW_FORMAT} version {REVIEW_VERSION}"
    return parse(Review, read_bytes(path, MAX_BYTES), str(path), what)
