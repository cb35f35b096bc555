"""What a person says of lifted lanes and frames is what the next lift does."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synth3dlanes.dataset.read import Reader
from synth3dlanes.geometry.frames import transform
from synth3dlanes.recorded.drives.drive import MarkedLane, RejectedLane
from synth3dlanes.recorded.drives.marks import lifted_marks, with_review
from synth3dlanes.recorded.lift.precision import NO_ERROR
from synth3dlanes.recorded.lift.run import lifted_frames
from synth3dlanes.recorded.lift.write import lift_to
from synth3dlanes.system.errors import InputError
from tests.lift import hill


def review_file(path: Path, drive: str = "hill", frames=(), lanes=()) -> Path:
    """A file of verdicts as the page saves it, written by hand."""
    document = {"format": "synth3dlanes.review", "version": 1, "source": "lifted/train", "drive": drive}
    path.write_text(json.dumps({**document, "frames": list(frames), "lanes": list(lanes)}))
    return path


def aside_of(found) -> dict[str, float]:
    """Where each delimiter of a frame is beside the middle of the hill's road."""
    labels = found.labels
    return {
        lane.id: float(
            np.median((xy := transform(labels.camera.world_from_cam, lane.xyz_cam))[:, 0] - hill.aside(xy[:, 1]))
        )
        for lane in labels.lanes
        if lane.kind == "delimiter"
    }


def line(off: float, start: float = 0.0, end: float = 60.0) -> np.ndarray:
    y = np.arange(start, end, 2.0)
    return np.column_stack([hill.aside(y) + off, y])


def test_rejected_frames_and_lanes_are_left_out_and_the_rest_keeps_its_ids(tmp_path: Path) -> None:
    drive = hill.drive(6)
    before = next(iter(lifted_frames(drive, NO_ERROR)))
    asides = aside_of(before)
    (wrong,) = (id_ for id_, off in asides.items() if abs(off + 5.25) < 0.5)
    verdicts = review_file(
        tmp_path / "review.json",
        frames=[
            {"name": "00000002", "time_s": 0.4, "verdict": "rejected"},
            {"name": "00000001", "time_s": 0.2, "verdict": "accepted"},
        ],
        lanes=[
            {"id": "line_77", "xy": line(-5.25).tolist(), "verdict": "rejected"},
            {"id": "line_78", "xy": line(-1.75).tolist(), "verdict": "accepted"},
            {"id": "line_79", "xy": line(14.0).tolist(), "verdict": "rejected"},
        ],
    )
    reviewed = with_review(drive, verdicts)
    report = lift_to(reviewed, tmp_path / "out", precision=NO_ERROR)
    assert (report.frames, report.not_found) == (5, ("line_79",))
    reader = Reader(f"{tmp_path}/out/train")
    assert [reader.labels(i).time_s for i in range(5)] == [0.0, 0.2, 0.6, 0.8, 1.0]
    for i in range(5):
        ids = {lane.id for lane in reader.labels(i).lanes if lane.kind == "delimiter"}
        assert ids == set(asides) - {wrong}
        centres = [lane for lane in reader.labels(i).lanes if lane.kind == "centerline"]
        assert [{lane.left, lane.right} for lane in centres] == [ids]
    assert any("1 frame rejected: left out" in note for note in reviewed.notes)
    # A rerun with the same verdicts keeps every byte; with others it is refused.
    tar = (tmp_path / "out/train/00000.tar").read_bytes()
    lift_to(reviewed, tmp_path / "out", precision=NO_ERROR)
    assert (tmp_path / "out/train/00000.tar").read_bytes() == tar
    with pytest.raises(InputError, match="inputs: expected"):
        lift_to(replace(reviewed, rejected=()), tmp_path / "out", precision=NO_ERROR)


def test_verdicts_that_are_out_of_date_are_told(tmp_path: Path) -> None:
    drive = hill.drive(3)
    path = tmp_path / "review.json"
    late = {"name": "00000009", "time_s": 99.0, "verdict": "rejected"}
    notes = with_review(drive, review_file(path, frames=[late])).notes
    assert notes == (f"{path}: 1 verdict on frames that the drive has not, such as 00000009",)
    with pytest.raises(InputError, match="expected verdicts on the drive hill, got some on monday"):
        with_review(drive, review_file(path, drive="monday"))
    every = [{"name": str(i), "time_s": round(0.2 * i, 9), "verdict": "rejected"} for i in range(3)]
    with pytest.raises(InputError, match="expected a frame that is not rejected"):
        with_review(drive, review_file(path, frames=every))


def test_a_corrected_lane_takes_the_place_of_what_pictures_show(tmp_path: Path) -> None:
    """Lifted lanes become marks; one is moved by 1.2 m, another by 10 cm under a new name."""
    drive = hill.drive(6)
    lift_to(drive, tmp_path / "out", precision=NO_ERROR)
    marks = {
        round(float(np.median(lane.xy_world[:, 0] - hill.aside(lane.xy_world[:, 1]))), 1): lane
        for lane in lifted_marks(Reader(f"{tmp_path}/out/train"), drive)
    }
    assert len(marks) == 3
    for off, lane in marks.items():
        ends = lane.xy_world[[0, -1], 1]
        assert np.abs(lane.xy_world[:, 0] - hill.aside(lane.xy_world[:, 1]) - off).max() < 0.1
        assert ends[0] < 12
        assert ends[1] > 35
    left, middle, _ = (marks[off] for off in sorted(marks))
    moved = replace(left, xy_world=left.xy_world - [1.2, 0])
    drawn = MarkedLane("mine", middle.xy_world + np.array([0.1, 0.0]), color="yellow")
    found = next(iter(lifted_frames(replace(drive, marked=(moved, drawn)), NO_ERROR)))
    asides = aside_of(found)
    assert len(asides) == 3
    assert abs(asides[left.id] + 6.45) < 0.05
    assert abs(asides["mine"] + 1.65) < 0.05
    assert {lane.color for lane in found.labels.lanes if lane.id == "mine"} == {"yellow"}
    with pytest.raises(InputError, match="expected a split that was lifted from hill2, got hill"):
        lifted_marks(Reader(f"{tmp_path}/out/train"), replace(drive, name="hill2"))


@pytest.mark.thorough
def test_a_marked_lane_is_rejected_as_any_other() -> None:
    drive = replace(hill.drive(4), marked=(MarkedLane("mine", line(1.75)),))
    gone = replace(drive, rejected=(RejectedLane("mine", line(1.75)),))
    assert "mine" in aside_of(next(iter(lifted_frames(drive, NO_ERROR))))
    assert len(aside_of(next(iter(lifted_frames(gone, NO_ERROR))))) == 2
