"""A lifted drive is a data set as any other, and what a person says of it is what the next lift does."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from rich.console import Console
from synth3dlanes_cli.main import main

from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.rearrange import split_dataset
from synth3dlanes.formats.export import Export
from synth3dlanes.geometry.frames import transform
from synth3dlanes.labels import labels as labels_format
from synth3dlanes.labels.labels import Labels
from synth3dlanes.recorded.drives.drive import MarkedLane, RejectedLane
from synth3dlanes.recorded.drives.marks import lifted_marks, with_review
from synth3dlanes.recorded.lift.precision import NO_ERROR
from synth3dlanes.recorded.lift.run import lifted_frames
from synth3dlanes.recorded.lift.write import LiftReport, lift_to
from synth3dlanes.system.errors import FormatError, InputError
from synth3dlanes.validate.evidence import Evidence
from synth3dlanes.validate.findings import Finding
from synth3dlanes.validate.integrity import Entry
from synth3dlanes.validate.labels import check_shape
from synth3dlanes.validate.report import ValidationReport
from synth3dlanes.validate.run import validate
from tests.drives.road import road, write_described
from tests.lift import hill
from tests.validate.examining import examine, findings


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, LiftReport]:
    out = tmp_path_factory.mktemp("lifted") / "set"
    return out, lift_to(hill.drive(8), out, precision=NO_ERROR)


def test_it_has_every_frame_with_its_lanes(made: tuple[Path, LiftReport]) -> None:
    out, report = made
    reader = Reader(f"{out}/train")
    assert (len(reader), report.frames, report.frames_without_lanes) == (8, 8, 0)
    assert reader.clip(0) == list(range(8))
    for sample in reader:
        assert sample.image.shape == (720, 1280, 3)
        assert all(
            lane.std_m is not None and lane.std_m.shape == (len(lane.xyz_cam), 2) for lane in sample.labels.lanes
        )
    description = json.loads((out / "dataset.json").read_text())
    assert "license" not in description
    assert description["derived"]["lifted"] == "hill"
    for name in ("README.md", "croissant.json"):
        text = (out / name).read_text()
        assert "real drive" in text
        assert "synthetic" not in text.lower()


def test_validate_says_what_it_could_not_ask_of_a_drive(made: tuple[Path, LiftReport]) -> None:
    report = validate(made[0], 1, None, lambda done, total: None)
    assert not report.problems
    asked = {name: check["samples"] for name, check in report.document()["checks"].items()}
    assert {name for name, n in asked.items() if n} == {"index", "form", "frame", "ridges", "moving"}
    assert all("scene" in check["lacks"] for name, check in report.document()["checks"].items() if not asked[name])
    console = Console(width=200, record=True)
    console.print(report.text())
    assert "no scene: labels, bonnet, " in console.export_text()
    with pytest.raises(InputError, match="rerender: expected a data set of scenes, got one lifted"):
        validate(made[0], 1, None, lambda done, total: None, rerender=1)


def test_a_pose_that_is_off_and_a_black_picture_are_found_in_their_frame(made: tuple[Path, LiftReport]) -> None:
    def evidence(i: int, aside_m: float = 0.0) -> Evidence:
        sample = Reader(f"{made[0]}/train")[i]
        pose = sample.labels.camera.world_from_cam + np.pad([[aside_m]], ((0, 3), (3, 0)))
        camera = replace(sample.labels.camera, world_from_cam=pose)
        entry = Entry("train", i, "", i, {}, "")
        return Evidence(None, replace(sample.labels, camera=camera), sample.image, entry=entry, numbers=(0, i, 0))

    def problems(*pictures: Evidence) -> list[str]:
        report = ValidationReport()
        for number, picture in enumerate(pictures):
            report.sample(f"train:{number}", examine(picture, "moving", "frame"))
        return [problem.where for problem in report.problems]

    assert problems(*(evidence(i) for i in range(4))) == []
    assert set(problems(evidence(0), evidence(1, 0.3), evidence(2))) == {"train:1", "train:2"}
    assert problems(evidence(0), replace(evidence(1), image=np.zeros((720, 1280, 3), np.uint8))) == ["train:1"]


def test_it_is_split_after_its_description_was_edited_too(made: tuple[Path, LiftReport], tmp_path: Path) -> None:
    """The recipe in its index is another one then, and no shard takes it over."""
    edited, source = tmp_path / "edited", Reader(f"{made[0]}/train")
    shutil.copytree(made[0], edited)
    text = (edited / "dataset.json").read_text()
    (edited / "dataset.json").write_text(text.replace('"lifted": "hill"', '"lifted": "a hill"'))
    for root, name in ((made[0], "hill"), (edited, "a hill")):
        out = tmp_path / name
        split_dataset(Reader(f"{root}/train"), {"test": 1.0}, 0, str(out))
        found = Reader(f"{out}/test")
        assert found.clip(0) == list(range(8))
        assert found[3].scene_json is None
        assert found.raw(3) == source.raw(3)
        assert f"lifted the drive {name}" in " ".join((out / "README.md").read_text().split())
    assert not validate(tmp_path / "hill", 1, None, lambda done, total: None).problems


def test_openlane_takes_it(made: tuple[Path, LiftReport], tmp_path: Path) -> None:
    summary = Export(str(made[0]), tmp_path / "openlane", "openlane").write(1)
    assert sum(summary.n_frames.values()) == 8
    assert summary.n_lines >= 8


def test_formats_that_say_more_than_lanes_do_not_take_it(made: tuple[Path, LiftReport], tmp_path: Path) -> None:
    """They say more than is known of a real drive."""
    for name in ("argoverse2", "coco", "kitti", "lanelet2", "masks", "nuscenes", "opendrive", "openlane_v2", "yolo"):
        with pytest.raises(InputError, match=f"expected a data set of scenes for {name}, got one that was lifted"):
            Export(str(made[0]), tmp_path / name, name).write(1)


@pytest.mark.thorough
def test_its_samples_have_no_scene_and_no_command_tells_of_one(made: tuple[Path, LiftReport], tmp_path: Path) -> None:
    """What is not known is absent: no member, no value in the index, no sun in words, no road in pictures."""
    place, page, report = str(made[0]), tmp_path / "sample.html", tmp_path / "report.html"
    reader = Reader(f"{place}/train")
    assert reader[0].scene_json is None
    assert set(reader.raw(0)) == {"png", "labels.json"} or set(reader.raw(0)) == {"jpg", "labels.json"}
    row = reader.index.slice(3, 1).to_pylist()[0]
    assert (row["scene"], row["frame"], row["camera"], row["camera_width_px"]) == (0, 3, 0, 1280)
    unknown = (
        "sun_zenith_rad",
        "marking_dash_cycle_m",
        "n_lanes",
        "n_cars",
        "junction",
        "visibility_m",
        "weather_kind",
    )
    assert [row[name] for name in unknown if name in row] == [None] * sum(name in row for name in unknown)
    for words in (
        ("inspect", f"{place}/train:3", "--out", str(tmp_path / "sample.png")),
        ("inspect", f"{place}/train:3", "--html", str(page)),
        ("inspect", f"{place}/train:3", "--out", str(tmp_path / "sample.png"), "--json"),
        ("stats", place, "--out", str(tmp_path / "stats.png")),
        ("stats", place, "--json"),
        ("report", place, "--html", str(report)),
        ("gallery", place, "--out", str(tmp_path / "gallery.png")),
        ("clip", f"{place}/train:0", "--out", str(tmp_path / "clip.webp")),
        ("info", place),
    ):
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 0, (words, result.output)
        assert not {"sun", "dashes", "visibility", "topology", "own"} & set(result.stdout.lower().split()), words
    assert "scene.json" not in page.read_text()
    assert "topologies" not in report.read_text()
    for words in (
        ("render", f"{place}/train:0", "--out", str(tmp_path / "again.png")),
        ("twins", place, "--vary", "light.exposure=1,2", "--out", str(tmp_path / "twins")),
    ):
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 2, words
        assert "expected a sample with a scene, got one that was lifted from a real drive" in result.stderr, words


def test_faults_of_measured_labels_are_found(made: tuple[Path, LiftReport]) -> None:
    labels = Reader(f"{made[0]}/train").labels(0)
    lane = labels.lanes[0]

    def told(labels: Labels) -> list[Finding]:
        return [*check_shape(labels, None), *findings(Evidence(None, labels), "form")]

    assert not told(labels)
    turned = labels.camera.world_from_cam @ np.diag([-1.0, 1, 1, 1])
    faults = {
        "std_m: expected how certain": replace(lane, std_m=None),
        "in_image: expected the mask": replace(lane, in_image=~lane.in_image),
        "expected points that advance": replace(lane, xyz_cam=lane.xyz_cam[np.r_[1, 0, 2 : len(lane.xyz_cam)]]),
    }
    for words, wrong in faults.items():
        found = told(replace(labels, lanes=(wrong, *labels.lanes[1:])))
        assert any(words in finding.reason for finding in found), words
    mirrored = replace(labels, camera=replace(labels.camera, world_from_cam=turned))
    assert any("world_from_cam: expected a rotation" in finding.reason for finding in told(mirrored))


def test_how_certain_points_are_lasts(made: tuple[Path, LiftReport]) -> None:
    labels = Reader(f"{made[0]}/train").labels(0)
    text = labels_format.to_json(labels)
    again = labels_format.from_json(text, "labels")
    assert labels_format.to_json(again) == text
    document = json.loads(text)
    del document["lanes"][0]["std_m"][0]
    with pytest.raises(FormatError, match="std_m: expected a pair for each of"):
        labels_format.from_json(json.dumps(document), "labels")


def test_the_command_lifts_a_drive_of_ones_own_files(tmp_path: Path) -> None:
    """A level road with lanes 1.75 m to both sides, written without our code."""
    drive = write_described(tmp_path, road(n=14, turn=0.0))
    (drive / "drive.yaml").write_text((drive / "drive.yaml").read_text().replace("marked: lanes.geojson\n", ""))
    # A camera on its side: 6 says that pixels are to be shown turned by 90 degrees clockwise.
    shown, exif = np.zeros((400, 640, 3), np.uint8), Image.Exif()
    shown[:, :320], exif[0x0112] = 200, 6
    for name in ("0000", "0002"):
        Image.fromarray(np.rot90(shown).copy()).save(drive / f"front/{name}.png", exif=exif)
    out = tmp_path / "out"
    words = ["lift", str(drive), "--out", str(out), "--json", "--unchecked"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout.splitlines()[-1])["frames"] == 14
    asides = []
    for i in (0, 2):
        assert (Reader(f"{out}/train").image(i) == shown).all()
    for i in range(4):
        labels = Reader(f"{out}/train").labels(i)
        assert abs(labels.camera.height_m - 1.5) < 0.03
        asides += [np.median(lane.xyz_cam[:, 0]) for lane in labels.lanes if lane.kind == "delimiter"]
    nearest = np.abs(np.array(asides)[:, None] + np.array([-1.75, 1.75, 5.25])).min(axis=1)
    assert len(asides) >= 8
    assert nearest.max() < 0.1


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
    with pytest.raises(InputError, match="precision"):
        lift_to(reviewed, tmp_path / "out", precision=replace(NO_ERROR, lanes_px=3.0))
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
