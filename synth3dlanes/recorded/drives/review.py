"""Verdicts of a person on the frames and the lanes of a data set: the file that the review page saves, and what it says
of a drive (docs/drives.md)."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from synth3dlanes.recorded.drives.drive import Drive, RejectedLane
from synth3dlanes.recorded.drives.tables import MAX_TEXT_BYTES, read_bytes
from synth3dlanes.system.errors import InputError
from synth3dlanes.system.schema import DocumentPart, parse
from synth3dlanes.system.words import counted

REVIEW_FORMAT, REVIEW_VERSION = "synth3dlanes.review", 1

Verdict = Literal["accepted", "rejected"]
_Name = Annotated[str, Field(max_length=1000)]
_Value = Annotated[float, Field(ge=-1e8, le=1e8)]


class FrameVerdict(DocumentPart):
    """The verdict on a frame: its name, and the time by which it is known whatever its name (None for a picture that is
    of no clip)."""

    name: _Name
    time_s: Annotated[float, Field(ge=0, le=1e11)] | None = None
    verdict: Verdict


class LaneVerdict(DocumentPart):
    """The verdict on a lane: its id, and the places by which it is known whatever its id, as a drive's poses have
    them."""

    id: _Name
    xy: list[tuple[_Value, _Value]]
    verdict: Verdict


class Review(DocumentPart):
    """Verdicts; frames and lanes that nobody looked at have none. `source` is the split, `drive` the name of the drive
    that it was lifted from, empty where it is of scenes."""

    format: Literal["synth3dlanes.review"]
    version: Literal[1]
    source: _Name
    drive: _Name = ""
    frames: Annotated[list[FrameVerdict], Field(default_factory=list)]
    lanes: Annotated[list[LaneVerdict], Field(default_factory=list)]


def read_review(path: Path) -> Review:
    """Read such a file. Raises FormatError with a line for each problem."""
    what = f"{REVIEW_FORMAT} version {REVIEW_VERSION}"
    return parse(Review, read_bytes(path, MAX_TEXT_BYTES), str(path), what, MAX_TEXT_BYTES)


def with_review(drive: Drive, path: Path) -> Drive:
    """The drive without what a file of verdicts rejects. Verdicts on frames that the drive has not are noted. Raises
    FormatError as `read_review` does, InputError for verdicts on another drive."""
    review = read_review(path)
    if review.drive != drive.name:
        told = f"on {review.drive}" if review.drive else "on a data set that is of no drive"
        raise InputError(f"{path}: expected verdicts on the drive {drive.name}, got some {told}")
    known = {drive.label_time(frame) for frame in drive.frames}
    rejected_s = {frame.time_s for frame in review.frames if frame.verdict == "rejected" and frame.time_s is not None}
    lost = [frame.name for frame in review.frames if frame.time_s not in known]
    notes = [f"{path}: {counted(len(rejected_s & known), 'frame')} rejected: left out"] if rejected_s & known else []
    if lost:
        notes.append(f"{path}: {counted(len(lost), 'verdict')} on frames that the drive has not, such as {lost[0]}")
    if rejected_s >= known:
        raise InputError(f"{path}: expected a frame that is not rejected, got none")
    origin = np.array(drive.origin_m[:2])
    lanes = tuple(
        RejectedLane(lane.id, np.array(lane.xy).reshape(-1, 2) - origin)
        for lane in review.lanes
        if lane.verdict == "rejected"
    )
    return replace(drive, rejected=lanes, rejected_s=frozenset(rejected_s & known), notes=(*drive.notes, *notes))
